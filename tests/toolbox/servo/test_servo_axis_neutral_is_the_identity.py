"""An effect of the servo axis at its neutral value leaves every bit of a recording, and of a residual, as it is."""

import numpy as np
import pytest
from bench_nouns import Experiment

import loopshape as ls
from loopshape.toolbox.servo.axis import ServoAxis
from loopshape.toolbox.servo.parameters import AXIS_PARAMETERS

NEUTRAL = {row.name: row.value for row in AXIS_PARAMETERS.rows if row.source.startswith("neutral")}
MOVED = {
    "coulomb_n": 10.0, "viscous_asymmetry": 0.3, "presliding_n": 10.0, "drag_ns2_m2": 300.0, "cubic_n_m3": 1e5,
    "force_offset_n": 5.0, "force_limit_n": 40.0, "sensor_play_m": 1e-3, "flexible_share": 0.4, "loop_delay_ms": 3.0,
    "force_lag_ms": 3.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def axis():
    return ServoAxis()


@pytest.fixture(scope="module")
def experiment(axis):
    t = np.arange(2000) / 1000.0
    loops = axis.loop_setups(axis.default_controllers(1000.0), "reference")
    reference = 0.05 * (1.0 - np.cos(2 * np.pi * t))[:, None]
    return Experiment(
        "one", "profile", loops, 1000.0, reference, 0 * reference, "reference", {"position_m": 0.0}, seed=3
    )


@pytest.fixture(scope="module")
def nominal(axis, experiment):
    return axis.simulate([experiment], states=True)[0]


def test_every_neutral_parameter_is_moved_here():
    assert set(NEUTRAL) == set(MOVED)
    assert all(value == 0.0 for value in NEUTRAL.values())


@pytest.mark.parametrize("changes", [{n: v} for n, v in NEUTRAL.items()] + [NEUTRAL])
def test_neutral_is_the_identity_bit_for_bit(axis, experiment, nominal, changes):
    (r,) = axis.simulate([experiment], changes=changes, states=True)
    for name in nominal.columns:
        np.testing.assert_array_equal(r.columns[name], nominal.columns[name])


@pytest.mark.parametrize("name", NEUTRAL)
def test_neutral_residuals_are_the_nominal_ones_and_moved_ones_are_not(axis, experiment, nominal, name):
    prepared = axis.prepare(nominal, ls.Run(1000.0, experiment.loops, (nominal,), axis.name), None)
    bare = axis.residuals(prepared, {})["force"]
    np.testing.assert_array_equal(axis.residuals(prepared, {name: NEUTRAL[name]})["force"], bare)
    assert np.abs(axis.residuals(prepared, {name: MOVED[name]})["force"] - bare).max() > 0.05


@pytest.mark.parametrize(
    "form", [f for f in ServoAxis().effects if f.free[0].low <= 0.0], ids=lambda f: f"{f.effect}, {f.form}"
)
def test_a_form_without_magnitude_is_no_effect(axis, experiment, nominal, form):
    effect = form.at(0.0)
    if {"flexible_share", "viscous_asymmetry"} & set(effect.moves):
        pytest.skip("without play a coupling is a flexibility; viscous friction has its sides without Coulomb's")
    (r,) = axis.simulate([experiment], changes=dict(effect.moves), states=True)
    np.testing.assert_allclose(r.columns["force_n"], nominal.columns["force_n"], rtol=0, atol=1e-9)


def test_every_effect_of_the_list_has_a_form():
    listed = {
        "coulomb_friction", "asymmetric_friction", "stribeck_friction", "force_offset", "hardening_stiffness",
        "backlash", "force_saturation", "flexibility", "loop_delay",
    }  # fmt: skip
    assert {f.effect for f in ServoAxis().effects} == listed


def test_the_vector_of_every_form_s_bounds_is_within_the_table(axis):
    for form in axis.effects:
        for values in ([f.low for f in form.free], [f.high for f in form.free]):
            moves = form.moves(values)
            vector = axis.parameters.vector(moves)  # refuses what is out of bounds
            assert all(vector[axis.parameters.index(name)] == value for name, value in moves.items())
