"""Joint 1 alone (appendix H.4): table H.1's controller on the model, and the plant that it would fit."""

import numpy as np
import pytest
from arm2_closed import close2
from source_controllers import controller

import loopshape as ls
from loopshape.toolbox.arm.dynamics.linear2 import linearise_pairs2
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.arm.strategies2 import PAIRS

NUMBERS = constants2(ARM2_PARAMETERS.vector())
#: A and B as full as the supply allows, about six working points
POINTS = [(theta1, 0.0, 1.9, p_cd) for theta1 in (-10.0, 0.0, 10.0) for p_cd in (0.8, 1.2)]
DELAY = 3  # samples, the PWM's


def least_damping(point, of):
    """Of the linear loop below 5 Hz, theta1 under this controller and the rest under the plant's own."""
    own = [ls.Controller(loop, blocks, 1000.0) for loop, blocks in PAIRS.controllers.items()]
    return min(zeta for f, zeta in close2(linearise_pairs2(NUMBERS, *point), [of, *own[1:]], DELAY).modes() if f < 5.0)


@pytest.mark.parametrize("point", POINTS)
def test_table_h_1_does_not_hold_the_model_s_joint_1(point):
    assert least_damping(point, controller("table_h_1")) < -0.02


@pytest.mark.parametrize("point", POINTS)
def test_the_plant_s_own_controller_of_the_same_structure_does(point):
    own = ls.Controller("theta1", PAIRS.controllers["theta1"], 1000.0)
    assert [b.kind for b in own.blocks] == [b.kind for b in controller("table_h_1").blocks]
    assert least_damping(point, own) > 0.05


def test_the_model_s_mode_lies_above_the_source_s_notch():
    modes = [linearise_pairs2(NUMBERS, *point).modes()[0] for point in POINTS]
    assert min(f for f, _ in modes) > 1.2 * value("table_h_1.notch")
    assert max(zeta for _, zeta in modes) < 0.5 * value("dissipation")


def peak_and_margin(f_mode_hz, zeta, crossing_hz):
    """Largest |S| in dB, and phase margin in deg, of table H.1 on an integrator and a mode."""
    C, f = controller("table_h_1"), np.geomspace(0.05, 20.0, 6000)
    s, w = 2j * np.pi * f, 2.0 * np.pi * f_mode_hz
    L = C.response(f) / (s * (s * s / w**2 + 2.0 * zeta * s / w + 1.0))
    L /= np.interp(crossing_hz, f, np.abs(L))
    over = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
    turned = np.degrees(np.angle(-L[over]))
    return 20.0 * np.log10(np.abs(1.0 / (1.0 + L)).max()), np.abs(turned).min()


def test_table_h_1_fits_a_plant_with_the_mode_at_its_notch_damped_as_chapter_6_says():
    """Three things must differ from the model: the mode's place, its damping and the gain; then all margins are met."""
    ends = [value(f"table_h_1.bandwidth_{end}") for end in ("low", "high")]
    peak, phase = peak_and_margin(value("table_h_1.notch"), value("dissipation"), float(np.sqrt(np.prod(ends))))
    assert peak < value("required.sensitivity")
    assert phase > value("required.phase_margin")
    peak, _ = peak_and_margin(1.9, 0.014, float(np.sqrt(np.prod(ends))))
    assert peak > 2.0 * value("required.sensitivity")
