"""A parameter at its neutral value, given explicitly, leaves every bit of a recording as it is."""

import numpy as np
import pytest

from loopshape.plants.arm.parameters import ARM1_PARAMETERS

NEUTRAL = {
    "gas_absolute_share": 0.0,
    "polytropic_exponent": 1.0,
    "stiffness_factor_a": 1.0,
    "stiffness_factor_b": 1.0,
}
MOVED = {
    "gas_absolute_share": 1.0,
    "polytropic_exponent": 1.4,
    "stiffness_factor_a": 1.05,
    "stiffness_factor_b": 0.95,
}


@pytest.fixture(scope="module")
def experiment(arm_experiment):
    return arm_experiment((9.0, 1.0), 1000, setpoint=(10.0, 1.1), seed=4)


@pytest.fixture(scope="module")
def nominal(arm, experiment):
    return arm.simulate([experiment], states=True)[0]


def test_the_neutral_values_are_the_nominal_ones():
    rows = {row.name: row for row in ARM1_PARAMETERS.rows if row.source.startswith("neutral")}
    assert {name: row.value for name, row in rows.items()} == NEUTRAL


@pytest.mark.parametrize("changes", [{n: v} for n, v in NEUTRAL.items()] + [NEUTRAL])
def test_neutral_values_are_the_identity_bit_for_bit(arm, experiment, nominal, changes):
    (r,) = arm.simulate([experiment], changes=changes, states=True)
    for name in nominal.columns:
        np.testing.assert_array_equal(r.columns[name], nominal.columns[name])


@pytest.mark.parametrize("name", NEUTRAL)
def test_moved_values_are_not(arm, experiment, nominal, name):
    (r,) = arm.simulate([experiment], changes={name: MOVED[name]}, states=True)
    assert np.abs(r.columns["true_theta2_rad"] - nominal.columns["true_theta2_rad"]).max() > np.radians(0.01)


def test_changes_of_one_experiment_overrule_those_of_all(arm, arm_experiment, nominal, experiment):
    e = arm_experiment((9.0, 1.0), 1000, setpoint=(10.0, 1.1), seed=4, parameters={"stiffness_factor_a": 1.0})
    (r,) = arm.simulate([e], changes={"stiffness_factor_a": 1.05}, states=True)
    # the start is the changed arm's too, so every bit is the nominal one's
    np.testing.assert_array_equal(r.columns["true_theta2_rad"], nominal.columns["true_theta2_rad"])
