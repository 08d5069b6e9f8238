"""Both joints (section 5.3): the source's four controllers on the model, and the damping of a pressure loop."""

import numpy as np
import pytest
from arm2_closed import close2
from bench_nouns import Block
from source_controllers import controller

import loopshape as ls
from loopshape.toolbox.arm.dynamics.equilibrium2 import pressures2
from loopshape.toolbox.arm.dynamics.linear2 import linearise2, linearise_pairs2
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.arm.strategies2 import DUAL

NUMBERS = constants2(ARM2_PARAMETERS.vector())
P_A = value("figure_5_8.p_a")
DELAY = 3  # samples, the PWM's


def own():
    """The plant's own four controllers."""
    return [ls.Controller(loop, blocks, 1000.0) for loop, blocks in DUAL.controllers.items()]


def with_gain(controllers, gain):
    """The four with another gain of p_A's loop."""
    held = (Block("gain", {"gain": gain}), Block("low_pass_1", {"f_hz": value("table_5_6.lowpass")}))
    return [*controllers[:2], ls.Controller("p_a", held, 1000.0), controllers[3]]


def overshoot(lin, controllers):
    """Of theta2's linear step, in percent."""
    y = close2(lin, controllers, DELAY).step(1, 10.0)[:, 1]
    return 100.0 * (y.max() - 1.0)


@pytest.mark.parametrize("p_c", ["04", "06", "08"])
def test_the_source_s_four_controllers_do_not_hold_the_model(p_c):
    lin = linearise2(NUMBERS, 0.0, 0.0, P_A, value(f"figure_5_8.p_c_{p_c}"))
    tables = {"theta1": "table_5_4", "theta2": "table_5_5", "p_a": "table_5_6", "p_c": "table_5_6"}
    printed = [controller(table, loop) for loop, table in tables.items()]
    assert not close2(lin, printed, DELAY).stable
    assert close2(lin, own(), DELAY).stable
    for k in (0, 1):  # each of both angles' is enough
        assert not close2(lin, [*own()[:k], printed[k], *own()[k + 1 :]], DELAY).stable


def test_the_model_s_pressure_loops_are_the_source_s():
    for one, blocks in zip(("p_a", "p_c"), own()[2:], strict=True):
        assert [b.parameters for b in blocks.blocks] == [b.parameters for b in controller("table_5_6", one).blocks]


def test_a_pressure_loop_damps_theta2_most_where_both_are_about_as_fast():
    """Against section 5.3.3: towards a slow pressure loop the damping goes, and a fast one gives less too."""
    lin = linearise2(NUMBERS, 0.0, 0.0, P_A, 0.4)
    slow, equal, fast = (overshoot(lin, with_gain(own(), gain)) for gain in (0.05, 5.0, 50.0))
    assert slow > 3.0 * equal
    assert fast > 1.5 * equal


def test_pairs_leave_theta2_alone_at_any_bandwidth_of_the_pressure_loop():
    """With decoupled outputs it does not work: as section 5.3.3 says."""
    four = pressures2(NUMBERS, 0.0, 0.0, P_A, 0.4)
    lin = linearise_pairs2(NUMBERS, 0.0, 0.0, four[0] + four[1], four[2] + four[3])
    found = [overshoot(lin, with_gain(own(), gain)) for gain in (0.05, 5.0, 50.0)]
    assert np.ptp(found) < 0.1
    assert min(found) > 30.0
