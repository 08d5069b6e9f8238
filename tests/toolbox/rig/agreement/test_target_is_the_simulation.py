"""A recording of the emulated target is the simulated rig's, column by column."""

import numpy as np
import pytest
from emulated_cases import emulator, excited, record

from loopshape.toolbox.arm.dynamics.equilibrium import pressures

#: relative to a column's largest value; both round in their own order. Found: 2e-14 at most, in commands.
SAME = 1e-12


@pytest.fixture(scope="module")
def quiet_port(quiet):
    with emulator(quiet) as port:
        yield port


@pytest.fixture(scope="module")
def port():
    with emulator() as port:
        yield port


def same(found, expected, tolerance=SAME):
    assert set(found.columns) == set(expected.columns)
    for name in expected.columns:
        mine, theirs = found.column(name), expected.column(name)
        assert mine.size == theirs.size
        assert np.abs(mine - theirs).max() <= tolerance * max(np.abs(theirs).max(), 1e-3), name


@pytest.mark.parametrize("injection", ["controller_input", "plant_input", "control"])
def test_without_noise_and_converters(arm, arm_experiment, quiet, quiet_port, injection):
    e = excited(arm_experiment, injection=injection, n=600 if injection == "control" else 3000)
    same(record(quiet_port, [e])[0], arm.simulate([e], changes=quiet)[0])


@pytest.mark.parametrize("seed", [0, 7, 2**31])
def test_with_noise_and_converters(arm, arm_experiment, port, seed):
    e = excited(arm_experiment, seed=seed)
    same(record(port, [e])[0], arm.simulate([e])[0])


def test_moving_references_at_several_setpoints(arm, arm_experiment, port):
    made = []
    for point in ((-15.0, 0.9), (0.0, 1.0), (12.0, 1.2)):
        references = np.tile([np.radians(point[0]), point[1]], (2500, 1))
        references[500:, 0] += 0.05
        references[1500:, 1] += 0.04
        made.append(arm_experiment(point, 2500, references=references, seed=len(made)))
    for found, expected in zip(record(port, made), arm.simulate(made), strict=True):
        same(found, expected)


@pytest.mark.parametrize(
    "changes",
    [
        {"payload_kg": 0.1, "base_tilt_deg": 3.0, "stiffness_mismatch": 0.1},
        {"leak_a_mm": 0.3, "dead_volume_b_ml": 20.0, "nominal_length_a_mm": 1.0, "supply_drop_bar": 0.05},
        {"gas_absolute_share": 1.0, "polytropic_exponent": 1.2, "pwm_frequency_hz": 40.0, "pwm_dead_zone": 0.03},
    ],
)
def test_an_arm_with_other_parameters(arm, arm_experiment, changes):
    e = excited(arm_experiment, 1500)
    with emulator(changes) as port:
        same(record(port, [e])[0], arm.simulate([e], changes=changes)[0])


def test_it_stands_where_the_balance_is(arm, arm_experiment, quiet, quiet_port, arm_constants):
    points = [(theta, p_ab) for theta in (-20.0, -7.3, 0.0, 11.0, 25.0) for p_ab in (0.8, 1.0, 1.25)]
    made = [arm_experiment(point, 1) for point in points]
    c = arm_constants(**quiet)
    for point, found in zip(points, record(quiet_port, made), strict=True):
        expected = pressures(c, *point)
        np.testing.assert_allclose([found.column("p_a_bar")[0], found.column("p_b_bar")[0]], expected, rtol=1e-12)
        assert found.column("theta2_rad")[0] == np.radians(point[0])


def test_leaving_the_models_range_ends_it_at_the_same_tick_with_the_same_words(arm, arm_experiment, port):
    references = np.tile([0.0, 1.0], (3000, 1))
    references[300:, 0] = np.radians(60.0)
    e = arm_experiment((0.0, 1.0), 3000, references=references, seed=3)
    found, expected = record(port, [e])[0], arm.simulate([e])[0]
    same(found, expected, 1e-9)
    reason = expected.info.ended_early.split(" at ")[0]
    assert found.info.ended_early == f"machine at tick {expected.column('t_s').size}: {reason}"


def test_four_bytes_a_number_round_and_no_more(arm, arm_experiment, quiet):
    e = excited(arm_experiment, 1000)
    with emulator(quiet, number_bytes=4) as port:
        same(record(port, [e])[0], arm.simulate([e], changes=quiet)[0], 1e-5)


def test_over_tcp_the_same(arm, arm_experiment):
    e = excited(arm_experiment, 1000)
    with emulator(tcp=0) as port:
        same(record(port, [e])[0], arm.simulate([e])[0])
