"""What a bound and a schedule refuse, and what they say."""

import numpy as np
import pytest
from bench_nouns import TransferFunction
from bound_cases import frf_of, gain, limits, loop_of

import loopshape as ls
from loopshape.toolbox.limits.bound import bound, excluded
from loopshape.toolbox.schedules.schedule import schedule


def test_a_plant_whose_integrators_are_not_known():
    between = TransferFunction([1.0], [1.0, 2.0 * np.pi * 0.05])  # the lowest lines look like half an integrator
    with pytest.raises(ls.errors.WrongUseError, match="number of integrators"):
        bound([frf_of(between)], gain(), limits(sensitivity_peak_db=6.0))


def test_an_unstable_plant_under_a_controller_that_does_not_hold_it():
    model = TransferFunction([1.0], [1.0 / (2.0 * np.pi), -1.0], 0.01)
    loop = loop_of(model, gain(0.5), 0, 1)
    with pytest.raises(ls.errors.WrongUseError, match="known to stabilise"):
        excluded(loop, [loop], limits(sensitivity_peak_db=6.0))


def test_limits_that_differ_between_operating_points():
    own = [{"where": {"load_kg": [0.0, 1.0]}, "sensitivity_peak_db": 9.0}]
    with pytest.raises(ls.errors.WrongUseError, match="one operating point alone"):
        bound([frf_of(TransferFunction([1.0], [1.0, 0.0]))], gain(), limits(sensitivity_peak_db=6.0, at=own))


def test_nothing_to_schedule():
    with pytest.raises(ls.errors.WrongUseError, match="no FRF"):
        schedule([], limits(sensitivity_peak_db=6.0), gain())


@pytest.mark.parametrize(
    "asked",
    [{}, {"phase_margin_deg": 45.0}, {"bandwidth_hz": 1.0}, {"delay_margin_s": 0.001}, {"gain_margin_db": 0.0}],
)
def test_limits_that_a_bound_does_not_count_exclude_no_bandwidth(asked):
    found = bound(
        [frf_of(TransferFunction([1.0], [1.0, 0.0]))], gain(), limits(integrators=1, unstable_poles=0, **asked)
    )
    assert (found.answer, found.bound_hz) == ("these limits exclude no bandwidth", np.inf)
    assert (found.reached.bandwidth_hz, found.counted) == (0.0, ())


@pytest.mark.parametrize(
    "asked",
    [{"sensitivity_peak_db": 0.0}, {"sensitivity_peak_db": -5.0}, {"modulus_margin": 1.0}, {"disk_margin": 2.0}],
)
def test_limits_that_no_controller_meets(asked):
    plants = [frf_of(TransferFunction([k], [1.0, 0.0]), f"gain-{k:g}") for k in (1.0, 3.0)]
    found = bound(plants, gain(), limits(integrators=1, unstable_poles=0, **asked))
    assert found.answer == "no controller meets these limits"
    assert found.impossible == tuple(asked)
    assert any(f"no controller with a bandwidth meets {found.impossible[0]} = " in note for note in found.notes)
    assert {one.bound_hz for one in (*found.alone, found.together)} == {found.together.first_hz}
    assert found.reached.bandwidth_hz == 0.0


@pytest.mark.long
def test_a_limit_just_above_what_none_meets_is_bounded():
    found = bound(
        [frf_of(TransferFunction([1.0], [1.0, 0.0]))],
        gain(),
        limits(integrators=1, unstable_poles=0, modulus_margin=0.99),
    )
    assert (found.answer, found.impossible) == ("bounded", ())
