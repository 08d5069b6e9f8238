"""Where the count is undecided the answer names the band that would decide it, where measuring can."""

import numpy as np
import pytest
from bench_nouns import Loop
from conversions import TWO_PI
from drawn_loops import LINES, PLANTS, frf_of, limit_gain, loop_of

from loopshape.loop.stability.stability import closed_loop_stability

PLANT = PLANTS["one integrator"]


def answer(f, gain=1.0, plant=PLANT, integrators=None):
    P = plant.response(f)
    loop = loop_of(plant, frf_of(f, P, 1e-6 * np.abs(P)), gain)
    if integrators is not None:
        loop = Loop(loop.plant, loop.controller, integrators, loop.unstable_poles, raw=loop.raw, scatter=loop.scatter)
    return closed_loop_stability(loop)


def test_below_the_first_line_down_to_the_crossover():
    found = answer(LINES[LINES > 10.0], gain=1.0)
    assert found.outcome == "undecided"
    assert "measure there" in found.reason
    low, high = found.band_hz
    size = np.abs(PLANT.response([low, high]))
    assert size[1] < 1.0 < size[0]
    assert high == pytest.approx(10.1)
    assert answer(np.arange(low, 60.0, 0.1), gain=1.0).outcome == "stable"


def test_above_the_last_line_to_where_l_is_gone():
    found = answer(LINES[LINES < 3.0], gain=1.0)
    assert found.outcome == "undecided"
    assert "measure higher" in found.reason
    low, high = found.band_hz
    assert low == pytest.approx(2.9)
    assert answer(LINES[high > LINES], gain=1.0).outcome == "stable"


def test_below_the_first_line_where_its_phase_does_not_fit():
    found = answer(LINES, integrators=3)
    assert found.outcome == "undecided"
    assert found.band_hz == pytest.approx((0.01, 0.1))


@pytest.mark.parametrize("spacing", [4.0])
def test_between_two_lines_that_bend_too_much(spacing):
    limit = limit_gain(PLANT)
    f = np.concatenate([np.arange(0.5, spacing, 0.5), np.arange(spacing, 90.0, spacing)])
    found = answer(f, gain=0.995 * limit)
    assert found.outcome == "undecided"
    low, high = found.band_hz
    assert high - low == pytest.approx(spacing)
    crossing = np.roots(np.polyadd(PLANT.den, limit * PLANT.num))
    at_hz = np.abs(crossing[np.argmax(crossing.real)].imag) / TWO_PI
    assert low <= at_hz <= high
    for _ in range(3):  # beside fine lines the coarse ones are a hole, and named as well
        f = np.sort(np.concatenate([f, np.linspace(*found.band_hz, 60)[1:-1]]))
        found = answer(f, gain=0.995 * limit)
        if found.outcome != "undecided":
            break
    assert found.outcome == "stable"


def test_measuring_does_not_help_a_wrong_word():
    # two unstable poles are declared that the plant does not have
    P = PLANT.response(LINES)
    loop = loop_of(PLANT, frf_of(LINES, P, 1e-6 * np.abs(P)))
    none = closed_loop_stability(Loop(loop.plant, loop.controller, None, 0))
    assert none.outcome == "undecided"
    assert none.band_hz is None
    wrong = closed_loop_stability(Loop(loop.plant, loop.controller, 1, 2))
    assert wrong.outcome != "stable"


def test_a_decided_answer_has_no_band():
    found = answer(LINES)
    assert (found.outcome, found.band_hz) == ("stable", None)
