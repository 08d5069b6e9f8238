"""Two joints driven pair by pair (z_p in both muscles): commands, equilibria, and where it is the dual arm.

With the number `shared` at 0 the kernel is the source's dual strategy, which other tests hold to independent data.
"""

import numpy as np
import pytest
from arm2_cases import ARM, MIDDLE, QUIET, numbers
from arm2_cases import point as dual_point
from arm2_closed import close2
from bench_nouns import Block, Experiment

import loopshape as ls
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.arm.dynamics.equilibrium2 import pair_pressures2, pair_rest2, pressures2
from loopshape.toolbox.arm.dynamics.linear2 import (
    DECOUPLING,
    PAIR_DECOUPLING,
    PAIR_OUTPUTS,
    linearise2,
    linearise_pairs2,
)
from loopshape.toolbox.arm.dynamics.model2 import standing_torques
from loopshape.toolbox.arm.strategies2 import PAIRS
from loopshape.toolbox.rig import registry

PAIR_ARM = Arm2(PAIRS)
CENTRE = (0.0, 0.0, 0.8, 0.8)  # deg, deg, bar, bar
Z = ("z_theta1_v", "z_theta2_v", "z_p_ab_v", "z_p_cd_v")
U = ("u_a_v", "u_b_v", "u_c_v", "u_d_v")


def point(values):
    """An operating point of pairs by its names."""
    return dict(zip(PAIRS.point_keys, values, strict=True))


def asked(arm, start, samples, injection="reference", injected=None, setpoint=None):
    """An experiment at 1 kHz from rest, under the plant's own controllers."""
    return Experiment(
        "one", "none", arm.loop_setups(arm.default_controllers(1000.0), injection), 1000.0,
        references=np.tile(arm.setpoint(start if setpoint is None else setpoint), (samples, 1)),
        injected=np.zeros((samples, 4)) if injected is None else injected, injection=injection,
        operating_point=start, closed_loop=injection != "control", seed=3,
    )  # fmt: skip


def columns(recording, names):
    return np.stack([recording.column(name) for name in names], axis=1)


def test_the_registry_finds_it_and_its_loops():
    arm = registry.plant("arm-2dof-pairs")
    assert (arm.name, arm.loops) == ("arm-2dof-pairs", ("theta1", "theta2", "p_ab", "p_cd"))
    outputs = [loop.output for loop in arm.loop_setups(arm.default_controllers(1000.0), "plant_input")]
    assert outputs == ["theta1_rad", "theta2_rad", "p_a_bar + p_b_bar", "p_c_bar + p_d_bar"]


@pytest.mark.parametrize("injection", ["controller_input", "plant_input"])
def test_commands_are_the_strategy_s_mapping_of_z(injection):
    injected = 0.05 * np.sin(np.outer(np.arange(400), [0.03, 0.02, 0.05, 0.04]))
    (r,) = PAIR_ARM.simulate([asked(PAIR_ARM, point(CENTRE), 400, injection, injected)])
    z = columns(r, Z) + (injected if injection == "plant_input" else 0.0)
    np.testing.assert_allclose(columns(r, U), z @ PAIR_DECOUPLING.T, rtol=0.0, atol=1e-15)
    assert np.abs(z).min(axis=1).max() > 0.01  # all four take part
    assert not np.allclose(columns(r, U), z @ DECOUPLING.T, atol=1e-3)


def test_the_loops_hold_the_sums_that_are_measured():
    """The first sample: the controller's direct feedthrough times what is missing to p_A + p_B and p_C + p_D."""
    (r,) = PAIR_ARM.simulate([asked(PAIR_ARM, point((0.0, 0.0, 0.8, 0.9)), 1, setpoint=point((0.0, 0.0, 1.0, 0.8)))])
    for loop, sums in (("p_ab", ("p_a_bar", "p_b_bar")), ("p_cd", ("p_c_bar", "p_d_bar"))):
        controller = next(c for c in PAIR_ARM.default_controllers(1000.0) if c.loop == loop)
        missing = r.column(f"r_{loop}_bar") - sum(r.column(name) for name in sums)
        assert r.column(f"z_{loop}_v")[0] == pytest.approx(np.prod(controller.biquads()[:, 0]) * missing[0], rel=1e-12)


def test_with_no_pressure_command_it_is_the_dual_arm():
    """The same angles' commands from the same pressures: both strategies differ in z_p alone."""
    injected = np.zeros((2000, 4))
    injected[:, :2] = 0.2 * np.sin(np.outer(np.arange(2000), [0.01, 0.02]))
    four = pressures2(numbers(), *MIDDLE)
    start = point((0.0, 0.0, four[0] + four[1], four[2] + four[3]))
    (dual,) = ARM.simulate([asked(ARM, dual_point(MIDDLE), 2000, "control", injected)], changes=QUIET, states=True)
    (pairs,) = PAIR_ARM.simulate([asked(PAIR_ARM, start, 2000, "control", injected)], changes=QUIET, states=True)
    for name in ("true_theta1_rad", "true_theta2_rad", *(f"true_p_{m}_bar" for m in "abcd"), *U):
        np.testing.assert_allclose(pairs.column(name), dual.column(name), rtol=0.0, atol=1e-9, err_msg=name)
    assert np.ptp(pairs.column("true_theta2_rad")) > 0.01


@pytest.mark.parametrize("values", [CENTRE, (8.0, 15.0, 1.0, 1.0), (-10.0, 0.0, 1.9, 1.2)])
def test_it_stays_at_rest_at_an_equilibrium(values):
    x = pair_rest2(numbers(), *values, 1e5)
    np.testing.assert_allclose(standing_torques(numbers(), x), 0.0, atol=1e-10)
    assert (x[1] + x[2], x[3] + x[4]) == pytest.approx((1e5 * values[2], 1e5 * values[3]), rel=1e-12)
    (r,) = PAIR_ARM.simulate([asked(PAIR_ARM, point(values), 2000, "control")], states=True)
    moved = columns(r, ("true_theta1_rad", "true_theta2_rad")) - x[5:7]
    assert np.abs(moved).max() < 1e-9


@pytest.mark.parametrize("values", [CENTRE, (8.0, 0.0, 0.8, 0.8), (0.0, -15.0, 0.8, 0.8), (0.0, 0.0, 1.9, 0.8)])
def test_its_default_controllers_hold_it(values):
    """From a degree beside; a valve stays shut up to 0.01 V, which leaves 0.1 to 0.14 deg with these gains."""
    start = point(np.add(values, (1.0, 1.0, 0.02, -0.02)))
    (r,) = PAIR_ARM.simulate([asked(PAIR_ARM, start, 15_000, setpoint=point(values))], states=True)
    assert r.info.ended_early is None
    late = np.degrees(columns(r, ("true_theta1_rad", "true_theta2_rad"))[-4000:])
    np.testing.assert_allclose(late.mean(axis=0), values[:2], atol=0.16)
    assert np.ptp(late, axis=0).max() < 0.25


def test_its_linear_angles_are_the_dual_arm_s_and_its_pressures_the_sums():
    c, f = numbers(), np.array([0.3, 1.0, 3.0])
    four = pressures2(c, *MIDDLE)
    dual = linearise2(c, *MIDDLE)
    pairs = linearise_pairs2(c, 0.0, 0.0, four[0] + four[1], four[2] + four[3])
    np.testing.assert_allclose(pairs.dynamics, dual.dynamics, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(pairs.response(f)[:, :2, :2], dual.response(f)[:, :2, :2], rtol=1e-6)
    # the sum of a pair all but misses an angle's command, which drives its muscles against each other (section 5.1)
    assert (np.abs(pairs.response(f)[:, 2, 1]) < 0.1 * np.abs(pairs.response(f)[:, 2, 2])).all()
    assert (np.abs(dual.response(f)[:, 2, 1]) > 0.5 * np.abs(dual.response(f)[:, 2, 2])).all()
    np.testing.assert_allclose(PAIR_OUTPUTS.sum(axis=1), [1.0, 1.0, 2.0, 2.0])


@pytest.mark.parametrize("delay_samples", [0, 4])
def test_the_closed_linear_loop_answers_as_its_frequency_response_says(delay_samples):
    f = np.array([0.2, 1.0, 3.0, 6.0])
    lin = linearise_pairs2(numbers(), *CENTRE)
    controllers = PAIR_ARM.default_controllers(1000.0)
    loop = close2(lin, controllers, delay_samples)
    held = np.sinc(f / 1000.0) * np.exp(-2j * np.pi * f * (0.5 + delay_samples) / 1000.0)  # a zero-order hold
    C = np.stack([one.response(f) for one in controllers], axis=1)
    L = lin.response(f) * held[:, None, None] * C[:, None, :]
    required = np.linalg.solve(np.eye(4) + L, L)
    z = np.exp(2j * np.pi * f / 1000.0)
    got = [loop.outputs @ np.linalg.solve(one * np.eye(len(loop.dynamics)) - loop.dynamics, loop.inputs) for one in z]
    np.testing.assert_allclose(got, required, rtol=0.0, atol=1e-4 * np.abs(required).max())
    assert loop.stable
    assert loop.step(0, 8.0)[-1] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=0.01)


def test_a_closed_linear_loop_of_too_few_controllers():
    with pytest.raises(ls.errors.WrongUseError, match=r"four controllers of one rate.*received 3 of 1000 Hz"):
        close2(linearise_pairs2(numbers(), *CENTRE), PAIR_ARM.default_controllers(1000.0)[:3])


@pytest.mark.parametrize("wrong", [{}, dual_point(MIDDLE), point(CENTRE) | {"p_a_bar": 0.4}])
def test_operating_point_with_other_names(wrong):
    with pytest.raises(ls.errors.WrongUseError, match="names theta1_deg, theta2_deg, p_ab_bar and p_cd_bar; received"):
        PAIR_ARM.check_operating_point(wrong)


@pytest.mark.parametrize(
    "values",
    [
        (26.0, 0.0, 0.8, 0.8),  # theta1
        (0.0, 46.0, 0.8, 0.8),  # theta2
        (0.0, 0.0, 0.25, 0.8),  # A and B at 0.12 bar each
        (0.0, 0.0, 0.8, 2.5),  # C and D above 1.2 bar
        (20.0, 0.0, 0.8, 0.5),  # no share of 0.5 bar holds theta1 there
        (float("nan"), 0.0, 0.8, 0.8),
    ],
)
def test_operating_point_out_of_the_model_s_range(values):
    with pytest.raises(ls.errors.WrongUseError, match=r"cannot stand there.*asks for p_A.*choose a point inside"):
        PAIR_ARM.check_operating_point(point(values))


def test_start_without_an_equilibrium():
    assert np.isnan(pair_pressures2(numbers(), 0.0, 0.0, 0.03, 0.8)[0])
    e = asked(PAIR_ARM, point((0.0, 0.0, 0.03, 0.8)), 10, setpoint=point(CENTRE))
    with pytest.raises(ls.errors.WrongUseError, match=r"no equilibrium there; received theta1 0 deg.*p_AB 0\.03 bar"):
        PAIR_ARM.simulate([e])


def test_controllers_that_do_not_match_the_loops():
    with pytest.raises(ls.errors.WrongUseError, match="for each of its loops theta1, theta2, p_ab and p_cd"):
        PAIR_ARM.loop_setups([ls.Controller("p_a", (Block("gain", {"gain": 1.0}),), 1000.0)], "reference")
