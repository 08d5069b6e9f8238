"""Each bad request of the 2-DoF arm, and the sentence that the user gets."""

import pytest
from arm2_cases import ARM, MIDDLE, experiment, point
from bench_nouns import Block
from simulated_machines import ExperimentTemplate, plan

import loopshape as ls
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.rig import registry

NAN = float("nan")


def gain(loop, rate_hz=1000.0):
    return ls.Controller(loop, (Block("gain", {"gain": 1.0}),), rate_hz)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"theta2_deg": 0.0, "p_ab_bar": 1.0},
        point(MIDDLE) | {"p_b_bar": 0.4},
        {"theta1_deg": 0.0, "theta2_deg": 0.0},
    ],
)
def test_operating_point_with_other_names(wrong):
    with pytest.raises(ls.errors.WrongUseError, match="names theta1_deg, theta2_deg, p_a_bar and p_c_bar; received"):
        ARM.check_operating_point(wrong)


@pytest.mark.parametrize(
    "values",
    [
        (26.0, 0.0, 0.4, 0.4),  # theta1
        (0.0, 46.0, 0.4, 0.4),  # theta2
        (0.0, 0.0, 0.14, 0.4),  # p_A
        (0.0, 0.0, 0.4, 1.21),  # p_C
        (0.0, -20.0, 0.5, 0.4),  # asks for p_B = 1.59
        (20.0, 0.0, 0.4, 0.4),  # asks for p_D = 1.68
        (0.0, -40.0, 0.4, 0.4),  # no p_B at all
        (NAN, 0.0, 0.4, 0.4),
        (0.0, 0.0, NAN, 0.4),
    ],
)
def test_operating_point_out_of_the_model_s_range(values):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"cannot stand there.*0\.15 to 1\.2 bar.*asks for p_A.*choose a point insi"
    ):
        ARM.check_operating_point(point(values))


def test_the_middle_of_the_range_is_not_refused():
    ARM.check_operating_point(point(MIDDLE))


def test_start_without_an_equilibrium():
    e = experiment((0.0, -40.0, 0.4, 0.4), 10, setpoint=MIDDLE)
    with pytest.raises(ls.errors.WrongUseError, match="no equilibrium there; received theta1 0 deg, theta2 -40 deg"):
        ARM.simulate([e])


def test_the_solver_on_a_grid():
    with pytest.raises(ls.errors.WrongUseError, match="solver is not known; received 'grid'; use edges"):
        ARM.simulate([experiment(MIDDLE, 10)], solver="grid")


def test_no_steps_at_all():
    with pytest.raises(ls.errors.WrongUseError, match="one step or more; received 0"):
        ARM.simulate([experiment(MIDDLE, 10)], steps_per_tick=0)


@pytest.mark.parametrize("name", ["coulomb_nm", "payload_kg", "hose_length_m", "compression_exponent"])
def test_parameters_of_the_1_dof_arm_s_effects(name):
    with pytest.raises(
        ls.errors.WrongUseError, match=f"no such parameter; received '{name}'; known are pwm_frequency_hz"
    ):
        ARM.simulate([experiment(MIDDLE, 10)], changes={name: 0.1})


def test_parameter_out_of_bounds():
    with pytest.raises(ls.errors.WrongUseError, match="parameter m1_kg is a number between"):
        ARM.simulate([experiment(MIDDLE, 10, parameters={"m1_kg": -1.0})])


@pytest.mark.parametrize("pwm_hz", [30.0, 400.0])
def test_pwm_period_that_is_no_whole_number_of_samples(pwm_hz):
    with pytest.raises(ls.errors.WrongUseError, match="whole number of controller samples; received"):
        ARM.simulate([experiment(MIDDLE, 10, pwm={"frequency_hz": pwm_hz})])
    with pytest.raises(ls.errors.WrongUseError, match="whole number of controller samples; received"):
        ARM.check_settings(1000.0, {"pwm_frequency_hz": pwm_hz})


@pytest.mark.parametrize("loops", [(), ("theta2", "p_ab"), ("theta1", "theta2", "p_a"), (*ARM.loops, "p_b")])
def test_controllers_that_do_not_match_the_loops(loops):
    with pytest.raises(ls.errors.WrongUseError, match="a controller for each of its loops theta1, theta2, p_a and p_c"):
        ARM.loop_setups([gain(loop) for loop in loops], "reference")


def test_controller_at_another_rate():
    e = experiment(MIDDLE, 10, controllers=[gain(loop, 500.0 if loop == "p_c" else 1000.0) for loop in ARM.loops])
    with pytest.raises(ls.errors.WrongUseError, match="loop p_c needs a controller at the rig's rate 1000 Hz"):
        ARM.simulate([e])


def test_a_diagnosis_of_its_gap():
    """It has no catalogue of effects."""
    assert isinstance(registry.plant("arm-2dof"), Arm2)
    with pytest.raises(
        ls.errors.WrongUseError, match="no catalogue of effects; received 'arm-2dof'; compare two runs instead"
    ):
        registry.diagnosable("arm-2dof")


def test_a_study_with_effects():
    still = ExperimentTemplate(name="still", kind="none", injection="reference", excites=None, duration_s=1.0)
    study = ls.rig.Study("simulated", "arm-2dof", (still,), (point(MIDDLE),), effects={"payload": 0.2})
    with pytest.raises(
        ls.errors.WrongUseError, match=r"the plant arm-2dof has no catalogue of effects; .*leave it out"
    ):
        plan(study, registry.plant("arm-2dof"))
