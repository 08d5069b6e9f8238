"""A structure that grows gains at every step, passes the check of every step, and never loses what it had."""

from dataclasses import replace
from itertools import pairwise

import pytest
from tune_plants import GAIN, LEAD, frf, required, servo
from two_axes import WHOLE, WISHES, matrix

import loopshape as ls

LIMITS = {"sensitivity_peak_db": 6.0, "control_peak_db": 20.0}


@pytest.fixture(scope="module")
def plant():
    return frf(servo(1.0), 60, "one load", 0.5, 1500.0)


@pytest.fixture(scope="module")
def grown(plant):
    return ls.tune(plant, required(GAIN, LEAD, **LIMITS), starts=2, grow=1)


def test_each_step_gains_and_the_first_is_the_tuning_without_growth(plant, grown):
    alone = ls.tune(plant, required(GAIN, LEAD, **LIMITS), starts=2)
    assert grown.growth[0].added == ""
    assert grown.growth[0].bandwidth_hz == alone.bandwidth_hz
    found = [step.bandwidth_hz for step in grown.growth]
    assert all(later > 1.009 * before for before, later in pairwise(found))
    assert grown.growth[-1].order == grown.controller.order() > alone.controller.order() == 1


def test_what_is_grown_passes_a_check_of_its_own(plant, grown):
    verdict = ls.check([plant], grown.controller, required(GAIN, **LIMITS))
    assert verdict.passed
    assert min(m.bandwidth_hz for m in verdict.margins.values()) == pytest.approx(grown.bandwidth_hz, rel=0.05)


def test_growth_stops_below_the_stated_gain(plant):
    found = ls.tune(plant, required(GAIN, LEAD, **LIMITS), starts=2, grow=1, least_gain=50.0)
    assert len(found.growth) == 1
    assert len(found.controller.blocks) == 2


def test_loops_grow_with_the_others_closed():
    """The blocks that pay are added to each loop's structure in the first round, and tuned on in the others."""
    frfs = [matrix(1.0), matrix(1.1, (0.005, 0.006), "two")]
    bare = [replace(one, structure=one.structure[:1]) for one in WISHES]
    few = ls.tune(frfs, bare, starts=2, together=WHOLE)
    grown = ls.tune(frfs, bare, starts=2, grow=1, together=WHOLE)
    assert grown.feasible
    for name in ("a", "b"):
        first = next(turn.tuning for turn in grown.turns if turn.loop == name)
        assert [len(first.growth), len(grown.tunings[name].structure)] == [2, 2]
        assert grown.tunings[name].bandwidth_hz > 1.2 * few.tunings[name].bandwidth_hz
