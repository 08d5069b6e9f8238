"""What robustness costs, where it is known: integrators of different gain under one gain."""

import numpy as np
import pytest
from bench_nouns import TransferFunction
from bound_cases import frf_of, gain

import loopshape as ls
from loopshape.toolbox.limits.bound import bound
from loopshape.toolbox.schedules.schedule import schedule

DELAY = 0.02
GAINS = (1.0, 4.0)
ASKED = ls.Requirements.from_table({
    "name": "one", "integrators": 1, "unstable_poles": 0, "phase_margin_deg": 45.0, "sensitivity_peak_db": 8.0,
    "structure": [{"kind": "gain", "gain": {"min": 0.01, "max": 1000.0}}],
})  # fmt: skip


@pytest.fixture(scope="module")
def frfs():
    return [frf_of(TransferFunction([k], [1.0, 0.0], DELAY), f"gain {k:g}", lines=1500) for k in GAINS]


@pytest.fixture(scope="module")
def found(frfs):
    robust = ls.tune(frfs, ASKED).controller
    return schedule(frfs, ASKED, robust)


def test_each_alone_crosses_where_its_phase_allows_and_the_weak_one_pays(found):
    # k g exp(-s d)/s has 45 deg of margin at w = pi/(4 d), whatever k; one g for both leaves the weak one a quarter
    alone = 0.25 * np.pi / DELAY / (2.0 * np.pi)
    weak, strong = found.points
    assert [weak.own_hz, strong.own_hz, strong.robust_hz] == pytest.approx([alone] * 3, rel=5e-3)
    assert weak.robust_hz == pytest.approx(alone / 4.0, rel=5e-3)
    assert weak.cost_hz == pytest.approx(0.75 * alone, rel=5e-3)
    assert (found.own_hz, found.robust_hz) == pytest.approx((alone, alone / 4.0), rel=5e-3)
    assert weak.ratio == pytest.approx(0.25, rel=5e-3)


def test_the_gain_is_scheduled_as_the_plants_are(found):
    (values,) = found.parameters().values()
    assert values[0] / values[1] == pytest.approx(GAINS[1] / GAINS[0], rel=5e-3)


def test_no_bandwidth_exceeds_its_bound(found):
    for point in found.points:
        assert point.robust_hz <= point.own_hz <= point.bound_hz < np.inf


def test_own_is_never_worse_than_robust(frfs):
    # a robust controller that is better than what the search may choose is its own
    narrow = ls.Requirements.from_table({
        "name": "one", "integrators": 1, "unstable_poles": 0, "phase_margin_deg": 45.0,
        "structure": [{"kind": "gain", "gain": {"min": 1.0, "max": 2.0}}],
    })  # fmt: skip
    (point, _) = schedule(frfs, narrow, gain(5.0), bounds=False).points
    assert not point.tuned
    assert point.own_hz == point.robust_hz


@pytest.mark.long
def test_the_bound_of_a_controller_says_how_far_it_is_at_every_point(frfs):
    told = []
    found = bound(frfs, gain(5.0), ASKED, step=told.append)
    assert told == [frf.recording for frf in frfs] * 2
    assert found.found_hz == pytest.approx(5.0 / (2.0 * np.pi), rel=1e-2)
    assert found.found_hz < found.bound_hz <= min(one.bound_hz for one in found.alone)
    assert found.ratio == pytest.approx(found.found_hz / found.bound_hz)
    assert found.counted == ("sensitivity_peak_db",)
    assert found.left_out == ("phase_margin_deg",)
    assert found.reached.bandwidth_hz <= found.least_alone.bound_hz


def test_a_controller_of_another_structure_is_refused(frfs):
    other = ls.Requirements.from_table({
        "name": "one", "integrators": 1, "unstable_poles": 0, "phase_margin_deg": 45.0,
        "structure": [{"kind": "low_pass", "order": 1, "f_hz": {"min": 1.0, "max": 2.0}}],
    })  # fmt: skip
    with pytest.raises(ls.errors.WrongUseError, match="not of the structure"):
        schedule(frfs, other, gain(5.0))
