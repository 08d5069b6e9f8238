"""Each bad request of the 1-DoF arm, and the sentence that the user gets."""

import pytest
from bench_nouns import Block

import loopshape as ls

NAN, INF = float("nan"), float("inf")


def gain(loop, rate_hz=1000.0):
    return ls.Controller(loop, (Block("gain", {"gain": 1.0}),), rate_hz)


@pytest.mark.parametrize(
    "point",
    [{}, {"theta2_deg": 0.0}, {"theta2_deg": 0.0, "p_ab_bar": 1.0, "p_a_bar": 0.5}, {"theta": 0.0, "p_ab": 1.0}],
)
def test_operating_point_with_other_names(arm, point):
    with pytest.raises(ls.errors.WrongUseError, match="names theta2_deg and p_ab_bar; received"):
        arm.check_operating_point(point)


@pytest.mark.parametrize(
    ("theta", "p_ab"),
    [(0.0, 0.2), (0.0, 2.5), (46.0, 1.0), (-60.0, 1.0), (40.0, 0.8), (NAN, 1.0), (0.0, NAN), (INF, 1.0), (0.0, -1.0)],
)
def test_operating_point_out_of_the_model_s_range(arm, theta, p_ab):
    with pytest.raises(ls.errors.WrongUseError, match=r"cannot stand there.*0\.15 to 1\.2 bar.*choose a point inside"):
        arm.check_operating_point({"theta2_deg": theta, "p_ab_bar": p_ab})


@pytest.mark.parametrize("start", [(0.0, -1.0), (0.0, 0.03), (NAN, 1.0)])
def test_start_without_an_equilibrium(arm, arm_experiment, start):
    e = arm_experiment(start, 10, setpoint=(0.0, 1.0))
    with pytest.raises(ls.errors.WrongUseError, match="no equilibrium there; received theta2"):
        arm.simulate([e])


def test_unknown_solver(arm, arm_experiment):
    with pytest.raises(ls.errors.WrongUseError, match="solver is not known; received 'euler'; use edges or grid"):
        arm.simulate([arm_experiment((0.0, 1.0), 10)], solver="euler")


@pytest.mark.parametrize("steps", [0, -1])
def test_no_steps_at_all(arm, arm_experiment, steps):
    with pytest.raises(ls.errors.WrongUseError, match="one step or more; received"):
        arm.simulate([arm_experiment((0.0, 1.0), 10)], steps_per_tick=steps)


def test_unknown_parameter(arm, arm_experiment):
    with pytest.raises(
        ls.errors.WrongUseError, match="no such parameter; received 'friction'; known are pwm_frequency_hz"
    ):
        arm.simulate([arm_experiment((0.0, 1.0), 10)], changes={"friction": 0.1})


@pytest.mark.parametrize(("name", "value"), [("m2_kg", -1.0), ("supply_bar", NAN), ("pwm_dead_zone", 0.6)])
def test_parameter_out_of_bounds(arm, arm_experiment, name, value):
    with pytest.raises(ls.errors.WrongUseError, match=f"parameter {name} is a number between"):
        arm.simulate([arm_experiment((0.0, 1.0), 10, parameters={name: value})])


@pytest.mark.parametrize("pwm_hz", [30.0, 400.0])
def test_pwm_period_that_is_no_whole_number_of_samples(arm, arm_experiment, pwm_hz):
    with pytest.raises(ls.errors.WrongUseError, match="whole number of controller samples; received"):
        arm.simulate([arm_experiment((0.0, 1.0), 10, pwm={"frequency_hz": pwm_hz})])


@pytest.mark.parametrize("loops", [(), ("theta2",), ("theta2", "theta1"), ("theta2", "p_ab", "theta1")])
def test_controllers_that_do_not_match_the_loops(arm, loops):
    with pytest.raises(ls.errors.WrongUseError, match="a controller for each of its loops theta2 and p_ab"):
        arm.loop_setups([gain(loop) for loop in loops], "reference")


def test_controller_at_another_rate(arm, arm_experiment):
    e = arm_experiment((0.0, 1.0), 10, controllers=[gain("theta2", 500.0), gain("p_ab")])
    with pytest.raises(ls.errors.WrongUseError, match="loop theta2 needs a controller at the rig's rate 1000 Hz"):
        arm.simulate([e])
