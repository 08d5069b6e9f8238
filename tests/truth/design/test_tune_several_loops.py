"""Several loops tuned in turn: as each alone where they do not meet; where they do, a point that none improves on."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block
from two_axes import RATE, WHOLE, WISHES, F, matrix

import loopshape as ls
from loopshape.design.tune import Search, tune
from loopshape.design.turns import tune_loops

START = 2 * (ls.Controller("a", (Block("gain", {"gain": 20.0}),), RATE),)
FEW = {"search": Search(starts=4, draws=20), "together": WHOLE}


def test_loops_that_do_not_meet_are_tuned_as_each_alone():
    found = ls.tune(matrix(0.0), WISHES, starts=4, together=WHOLE)
    assert found.converged
    assert found.feasible
    assert [turn.round for turn in found.turns] == [1, 1, 2, 2]
    for k, wish in enumerate(WISHES):
        own = matrix(0.0)
        part = ls.FRF(
            F, own.response[:, k : k + 1, k : k + 1], own.covariance[:, :1, :1], own.valid, ("z",), ("y",), "known",
            "one", wish.loop, RATE,
        )  # fmt: skip
        alone = tune([part], replace(wish, unstable_poles=0), search=Search(starts=4, draws=20))
        assert found.tunings[wish.loop].bandwidth_hz == pytest.approx(alone.bandwidth_hz, rel=1e-3)


@pytest.fixture(scope="module")
def coupled():
    frfs = [matrix(1.0), matrix(1.1, (0.005, 0.006), "two")]
    return frfs, tune_loops(frfs, WISHES, **FEW)


def test_coupled_loops_come_to_rest_and_pass_together(coupled):
    frfs, found = coupled
    assert found.converged
    assert found.feasible
    assert ls.check(frfs, found.controllers, WISHES, together=WHOLE).passed
    moved = [turn.moved for turn in found.turns if turn.round > 1]
    assert moved[-1] < 3e-3 < moved[0]


def test_tuned_alone_they_fail_together(coupled):
    frfs, _ = coupled
    alone = tune_loops([matrix(0.0), matrix(0.0, (0.005, 0.006), "two")], WISHES, **FEW)
    assert not ls.check(frfs, alone.controllers, WISHES).passed


def test_at_rest_no_loop_improves_alone(coupled):
    frfs, found = coupled
    again = tune_loops(frfs, WISHES, found.controllers, search=Search(rounds=1, starts=1))
    for turn in again.turns:
        assert turn.tuning.bandwidth_hz == pytest.approx(found.tunings[turn.loop].bandwidth_hz, rel=3e-3)


@pytest.mark.long
def test_same_seed_same_controllers(coupled):
    frfs, found = coupled
    again = tune_loops(frfs, WISHES, **FEW)
    blocks = [[b.parameters for c in one.controllers for b in c.blocks] for one in (found, again)]
    assert blocks[0] == blocks[1]


def test_a_loop_without_wishes_stays_closed_as_it_is():
    still = ls.Controller("b", (Block("gain", {"gain": 20.0}),), RATE)
    found = tune_loops([matrix(0.6)], WISHES[:1], [still], **FEW)
    assert {turn.others for turn in found.turns} == {("b",)}
    assert [c.loop for c in found.controllers] == ["a", "b"]
    assert found.controllers[1] is still


def test_one_structure_may_serve_all_loops(coupled):
    frfs, _ = coupled
    bare = [replace(one, structure=()) for one in WISHES]
    again = ls.tune(frfs, bare, WISHES[0].structure, starts=4, together=WHOLE)
    for own, other in zip(again.controllers, ls.tune(frfs, WISHES, starts=4, together=WHOLE).controllers, strict=True):
        np.testing.assert_allclose(own.response(F), other.response(F), rtol=1e-9)


STILL = [ls.Disturbance.from_spectrum([1.0, 9.0], [1.0, 1.0], loop="a")]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"R": WISHES, "disturbance": STILL}, r"no start for a, b"),
        ({"R": WISHES[0], "start": START}, r"a search begins at one controller a loop; received a, a"),
    ],
)
def test_what_is_not_asked_of_several(asked, words):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        ls.tune(matrix(0.0), **asked)
