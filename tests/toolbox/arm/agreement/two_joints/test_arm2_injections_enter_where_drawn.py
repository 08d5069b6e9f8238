"""What is injected into the 2-DoF arm's loops enters where `loop.loop` draws it, with sign and unit."""

import numpy as np
import pytest
from arm2_cases import ARM, QUIET, experiment
from scipy import signal

ROWS = 600
RNG = np.random.default_rng(6)
START = (2.0, 5.0, 0.5, 0.45)
SHAPES = np.array([0.01, 0.02, 0.03, 0.03]) * np.sin(np.outer(np.arange(ROWS), [0.02, 0.017, 0.013, 0.011]))
CONTROLS = ("z_theta1_v", "z_theta2_v", "z_p_a_v", "z_p_c_v")
OUTPUTS = ("theta1_rad", "theta2_rad", "p_a_bar", "p_c_bar")
COMMANDS = ("u_a_v", "u_b_v", "u_c_v", "u_d_v")
#: u_A = z_theta2 + z_pA, u_B = -z_theta2, u_C = -z_theta1 + z_pC, u_D = z_theta1 (ARM.md, section 1)
DECOUPLED = np.array([[0, 1, 1, 0], [0, -1, 0, 0], [-1, 0, 0, 1], [1, 0, 0, 0]])


def recorded(injection, **fields):
    return ARM.simulate([experiment(START, ROWS, injection=injection, **fields)], changes=QUIET)[0]


def table(recording, columns):
    return np.column_stack([recording.column(name) for name in columns])


@pytest.mark.parametrize("loop", [0, 1, 2, 3])
def test_at_the_controller_s_input_it_acts_as_a_moved_reference(loop):
    one = np.zeros((ROWS, 4))
    one[:, loop] = SHAPES[:, loop]
    injected = recorded("controller_input", injected=one)
    moved = recorded("reference", references=np.array(ARM.setpoint(injected.info.operating_point)) + one)
    for column in (*OUTPUTS, "p_b_bar", "p_d_bar", *CONTROLS):
        size = np.abs(moved.column(column)).max()
        # e + n against (r + n) - y: a rounding apart in each tick
        np.testing.assert_allclose(injected.column(column), moved.column(column), rtol=0.0, atol=1e-9 * size)
    assert np.ptp(moved.column(OUTPUTS[loop])) > 1e-3
    np.testing.assert_array_equal(injected.column(f"n_{OUTPUTS[loop]}"), one[:, loop])


def test_at_the_plant_s_input_it_adds_to_z_behind_the_controller():
    n = RNG.uniform(-0.2, 0.2, (ROWS, 4))
    r = recorded("plant_input", injected=n)
    z = table(r, CONTROLS)
    np.testing.assert_allclose(table(r, COMMANDS), (z + n) @ DECOUPLED.T, rtol=0.0, atol=1e-14)
    # z itself answers to the measured signals alone: nothing at the first row, where the arm stands on its setpoint
    assert np.abs(z[0]).max() < 1e-12
    assert np.abs(z).max() > 0.01
    np.testing.assert_array_equal(table(r, ("n_theta1_v", "n_theta2_v", "n_p_a_v", "n_p_c_v")), n)


def test_z_is_the_controller_s_answer_to_the_logged_error():
    """Closed by hand: the logged r, n and y through the controller give the logged z, of each loop."""
    r = recorded("controller_input", injected=SHAPES)
    for controller, y, z in zip(ARM.default_controllers(1000.0), OUTPUTS, CONTROLS, strict=True):
        error = r.column(f"r_{y}") - r.column(y) + r.column(f"n_{y}")
        expected = signal.sosfilt(np.insert(controller.biquads(), 3, 1.0, axis=1), error)
        np.testing.assert_allclose(r.column(z), expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_with_open_loops_it_is_z_itself():
    n = RNG.uniform(-0.05, 0.05, (ROWS, 4))
    r = recorded("control", injected=n)
    np.testing.assert_array_equal(table(r, CONTROLS), n)
    np.testing.assert_allclose(table(r, COMMANDS), n @ DECOUPLED.T, rtol=0.0, atol=1e-16)
    np.testing.assert_array_equal(r.column("n_theta1_rad"), 0.0)  # nothing was injected besides
    assert not r.info.closed_loop


@pytest.mark.parametrize(("loop", "output"), [(0, "theta1"), (1, "theta2"), (2, "p_a"), (3, "p_c")])
def test_a_positive_z_raises_its_output(loop, output):
    """Above all theta1, whose signs the source prints the other way round."""
    n = np.zeros((ROWS, 4))
    n[:100, loop] = 0.1
    (r,) = ARM.simulate(
        [experiment((0.0, 0.0, 0.4, 0.4), ROWS, injection="control", injected=n)], changes=QUIET, states=True
    )
    y = r.column(f"true_{output}_rad" if loop < 2 else f"true_{output}_bar")
    assert y[100:].min() > y[0]
    assert y[20] > y[0]
