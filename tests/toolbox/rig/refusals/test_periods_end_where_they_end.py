"""A ramp or a tail as long as a period would be counted as one: such a study is refused before anything moves."""

import pytest
from simulated_machines import Arm1
from study_signals import Multisine

import loopshape as ls
from loopshape.toolbox.rig.simulated import plan
from loopshape.toolbox.rig.study import ExperimentTemplate


def study(ramp_s, tail_s):
    signal = Multisine(1.0, 5.0, 2.0, 0.01, periods=2, ramp_s=ramp_s)
    template = ExperimentTemplate("m", "multisine", "controller_input", "theta2", signal, tail_s=tail_s)
    return ls.rig.Study("simulated", "arm-1dof", (template,), ({"theta2_deg": 0.0, "p_ab_bar": 1.0},))


@pytest.mark.parametrize(("ramp_s", "tail_s"), [(2.0, 0.0), (0.0, 2.0), (1.0, 1.0), (5.0, 0.0)])
def test_as_much_again_after_the_periods_is_refused(ramp_s, tail_s):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"would be taken for a period; received ramp_s \+ tail_s = .* shorten"
    ):
        plan(study(ramp_s, tail_s), Arm1())


def test_less_than_a_period_is_taken():
    assert len(plan(study(1.0, 0.9), Arm1())) == 1
