"""A warm start: its blocks find their places, it is never made worse, and alone it is a local improvement."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block
from tune_plants import GAIN, LEAD, LOW_PASS, NOTCH, RATE, problem_of, required, servos

import loopshape as ls
from loopshape.design.search import initial_point
from loopshape.design.tighten import TightenedSolution
from loopshape.design.tune import Search, _no_worse, tune, warm_start

LIMITS = {"sensitivity_peak_db": 6.0, "phase_margin_deg": 30.0, "gain_margin_db": 6.0, "control_peak_db": 10.0}
BLOCKS = (GAIN, LEAD, NOTCH, LOW_PASS)
PLANTS = servos()
ASKED = required(*BLOCKS, **LIMITS)
#: slow and safe, its blocks in another order than the structure's
SLOW = ls.Controller(
    "one",
    (
        Block("low_pass_2", {"f_hz": 300.0, "damping": 0.7}),
        Block("notch", {"f1_hz": 70.0, "f2_hz": 70.0, "damping1": 0.1, "damping2": 1.0}),
        Block("gain", {"gain": 0.1}),
        Block("lead_lag", {"f1_hz": 5.0, "f2_hz": 60.0}),
    ),
    RATE,
)


def slowest(controller):
    return min(m.bandwidth_hz for m in ls.check(PLANTS, controller, ASKED).margins.values())


def test_blocks_find_their_places_by_kind():
    p = problem_of(PLANTS, ASKED)
    x, moved = warm_start(p, SLOW)
    assert moved == ()
    f = PLANTS[0].frequency_hz
    np.testing.assert_allclose(p.controller(x).response(f), SLOW.response(f), rtol=1e-12)


def test_the_kth_of_a_kind_stands_for_the_kth():
    p = problem_of(PLANTS, required(GAIN, LEAD, LEAD, **LIMITS))
    leads = [Block("lead_lag", {"f1_hz": f1, "f2_hz": f2}) for f1, f2 in ((3.0, 40.0), (20.0, 200.0))]
    x, _ = warm_start(p, ls.Controller("one", (*leads, Block("gain", {"gain": 0.5})), RATE))
    np.testing.assert_allclose(np.exp(x), [0.5, 3.0, 40.0, 20.0, 200.0])


def test_alone_it_improves_locally_and_the_same_each_time():
    assert ls.check(PLANTS, SLOW, ASKED).passed
    found, again = (tune(PLANTS, ASKED, start=SLOW, search=Search(starts=1, seed=seed)) for seed in (0, 7))
    assert found.feasible
    assert found.starts == 1
    assert found.bandwidth_hz > 1.5 * slowest(SLOW)
    assert [b.parameters for b in found.controller.blocks] == [b.parameters for b in again.controller.blocks]


@pytest.mark.long
def test_the_best_known_is_never_made_worse():
    best = tune(PLANTS, ASKED).controller
    for starts in (1, 3):
        found = tune(PLANTS, ASKED, start=best, search=Search(starts=starts, draws=4))
        assert found.feasible
        assert found.bandwidth_hz >= slowest(best) * (1.0 - 1e-12)


def test_what_is_worse_than_a_start_that_passes_gives_way_to_it():
    p = problem_of(PLANTS, ASKED)

    def judge(controller):
        return ls.check(PLANTS, controller, ASKED)

    def settled(x):
        return TightenedSolution(initial_point(p, x), judge(p.controller(x)), {})

    slow, _ = warm_start(p, SLOW)
    slower, wild = slow.copy(), slow.copy()
    slower[0] -= 0.5
    wild[0] += 4.0
    assert judge(p.controller(slow)).passed
    assert not judge(p.controller(wild)).passed
    for found in (slower, wild):
        np.testing.assert_array_equal(_no_worse(p, settled(found), slow, judge).result.x, slow)
    for start in (slower, wild):
        np.testing.assert_array_equal(_no_worse(p, settled(slow), start, judge).result.x, slow)


def test_it_runs_as_the_start_runs():
    start = replace(SLOW, prewarp_hz=70.0, computation_delay_s=2e-4, precision="single")
    found = tune(PLANTS, ASKED, start=start, search=Search(starts=1)).controller
    assert (found.prewarp_hz, found.computation_delay_s, found.precision) == (70.0, 2e-4, "single")
    late = replace(SLOW, computation_delay_s=1e-3)
    assert (
        tune(PLANTS, ASKED, start=late, search=Search(starts=1)).bandwidth_hz
        < tune(PLANTS, ASKED, start=SLOW, search=Search(starts=1)).bandwidth_hz
    )


def test_what_does_not_fit_is_moved_and_said():
    fixed = {"kind": "low_pass", "order": 2, "f_hz": 250.0, "damping": {"min": 0.8, "max": 1.5}}
    p = problem_of(PLANTS, required(GAIN, LEAD, NOTCH, fixed, **LIMITS))
    start = replace(SLOW, blocks=(SLOW.blocks[0], replace_notch(80.0), *SLOW.blocks[2:]))
    x, moved = warm_start(p, start)
    assert p.controller(x).blocks[3].parameters == {"f_hz": 250.0, "damping": pytest.approx(0.8)}
    assert [words.split(" of ")[0] for words in moved] == ["f2_hz", "f_hz", "damping"]
    assert "ties it to f1_hz" in moved[0]
    assert "fixes it at 250" in moved[1]
    assert "outside its bounds; started from 0.8" in moved[2]


def replace_notch(f2_hz):
    return Block("notch", {"f1_hz": 70.0, "f2_hz": f2_hz, "damping1": 0.1, "damping2": 1.0})


@pytest.mark.parametrize("blocks", [SLOW.blocks[1:], (*SLOW.blocks, Block("pi", {"f_hz": 1.0}))])
def test_other_blocks_are_refused(blocks):
    with pytest.raises(ls.errors.WrongUseError, match="does not fit the structure of loop 'one'") as caught:
        tune(PLANTS, ASKED, start=replace(SLOW, blocks=blocks))
    assert "the structure has 1 gain, 1 lead_lag, 1 low_pass_2, 1 notch" in str(caught.value)
