"""A parameter at its neutral value, given explicitly, leaves every bit of a recording as it is."""

import numpy as np
import pytest

from loopshape.toolbox.arm.effect.effects import FORMS
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS

#: every neutral row, and a value that must show
MOVED = {
    "gas_absolute_share": 1.0,
    "polytropic_exponent": 1.4,
    "compression_exponent": 1.4,
    "stiffness_factor_a": 1.05,
    "stiffness_factor_b": 0.95,
    "loop_delay_ms": 5.0,
    "pulse_delay_ms": 5.0,
    "valve_opening_delay_ms": 4.0,
    "valve_ramp_ms": 2.0,
    "supply_drop_bar": 0.1,
    "supply_droop_bar": 0.1,
    "splitter_droop_bar": 0.1,
    "critical_ratio": 0.4,
    "hose_length_m": 3.0,
    "hose_lag_ms": 10.0,
    "leak_a_mm": 0.2,
    "leak_b_mm": 0.2,
    "dead_volume_a_ml": 40.0,
    "dead_volume_b_ml": 40.0,
    "stiffness_error": 0.15,
    "stiffness_mismatch": 0.15,
    "nominal_length_a_mm": 4.0,
    "nominal_length_b_mm": 4.0,
    "creep_share": 0.2,
    "braid_force_n": 4.0,
    "coulomb_nm": 0.1,
    "presliding_nm": 0.1,
    "hose_stiffness_nm_rad": 2.0,
    "hose_cubic_nm_rad3": 100.0,
    "payload_kg": 0.05,
    "flexible_share": 0.3,
    "base_tilt_deg": 5.0,
    "angle_lag_ms": 10.0,
    "pressure_lag_ms": 30.0,
    "backlash_deg": 0.5,
}
ROWS = ARM1_PARAMETERS.rows
NEUTRAL = {row.name: row.value for row in ROWS if row.source.startswith("neutral")}
SHAPES = [row for row in ROWS if row.source.startswith("shapes")]


def between(share):
    """All that only shapes another parameter, at a share of the way between its bounds."""
    return {row.name: row.low + share * (row.high - row.low) for row in SHAPES}


@pytest.fixture(scope="module")
def experiment(arm_experiment):
    return arm_experiment((5.0, 0.9), 1000, setpoint=(12.0, 1.3), seed=4)


@pytest.fixture(scope="module")
def nominal(arm, experiment):
    return arm.simulate([experiment], states=True)[0]


@pytest.fixture(scope="module")
def moved_by(arm, experiment, nominal):
    """Columns of the recording that these changes move, and the most in noise's rms of the sensors' columns."""

    def run(changes):
        (r,) = arm.simulate([experiment], changes=changes, states=True)
        n = min(len(r.columns["t_s"]), 1000)
        columns = [name for name in nominal.columns if not np.array_equal(r.columns[name], nominal.columns[name])]
        rms = {"theta2_rad": np.radians(0.02), "p_a_bar": 1e-3, "p_b_bar": 1e-3}
        return columns, max(np.abs(r.columns[k][:n] - nominal.columns[k][:n]).max() / s for k, s in rms.items())

    return run


def test_every_neutral_row_is_moved_below():
    assert set(MOVED) == set(NEUTRAL)
    assert all(MOVED[name] != value for name, value in NEUTRAL.items())


def test_every_effect_s_row_is_neutral_or_shapes_one_that_is():
    of_effects = {name for form in FORMS for name in form.moves([f.starts[0] for f in form.free])}
    assert of_effects <= set(NEUTRAL) | {row.name for row in SHAPES}


@pytest.mark.parametrize("changes", [{n: v} for n, v in NEUTRAL.items()] + [NEUTRAL])
def test_neutral_values_are_the_identity_bit_for_bit(moved_by, changes):
    assert moved_by(changes) == ([], 0.0)


@pytest.mark.parametrize("share", [0.0, 0.31, 0.77, 1.0])
def test_what_shapes_a_neutral_parameter_does_nothing(moved_by, share):
    assert moved_by(NEUTRAL | between(share)) == ([], 0.0)


@pytest.mark.parametrize("row", SHAPES, ids=lambda row: row.name)
def test_nor_does_any_of_them_alone(moved_by, row):
    for value in (row.low, row.high):
        assert moved_by({row.name: value}) == ([], 0.0)


@pytest.mark.parametrize("name", MOVED)
def test_moved_values_are_not(moved_by, name):
    columns, size = moved_by({name: MOVED[name]})
    assert {"theta2_rad", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v"} <= set(columns)
    assert size > 3.0


@pytest.mark.parametrize("form", FORMS, ids=lambda form: f"{form.effect}: {form.form}")
def test_each_form_shows_and_is_the_identity_at_nought(moved_by, form):
    first = form.free[0]
    effect = form.at(form.scale * first.starts[0])
    assert moved_by(dict(effect.moves))[1] > 3.0
    if first.low <= 0.0 <= first.high:
        assert moved_by(form.moves([NEUTRAL.get(f.parameter, f.starts[0]) for f in form.free])) == ([], 0.0)


def test_changes_of_one_experiment_overrule_those_of_all(arm, arm_experiment, nominal, experiment):
    e = arm_experiment((5.0, 0.9), 1000, setpoint=(12.0, 1.3), seed=4, parameters={"stiffness_factor_a": 1.0})
    (r,) = arm.simulate([e], changes={"stiffness_factor_a": 1.05}, states=True)
    # the start is the changed arm's too, so every bit is the nominal one's
    np.testing.assert_array_equal(r.columns["true_theta2_rad"], nominal.columns["true_theta2_rad"])
