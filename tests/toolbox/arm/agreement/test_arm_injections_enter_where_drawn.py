"""What is injected into the arm's loops enters where `loop.loop` draws it, with its sign and its unit."""

import numpy as np
import pytest

ROWS = 600
RNG = np.random.default_rng(6)
ANGLE_RAD = 0.02 * np.sin(0.02 * np.arange(ROWS))
PRESSURE_BAR = 0.03 * np.sin(0.013 * np.arange(ROWS))


@pytest.fixture(scope="module")
def run(arm, arm_experiment, quiet):
    """A recording at (10 deg, 1.1 bar) with (n_theta, n_p) injected, or with references moved."""

    def simulate(injection, injected=None, moved=None):
        fields = {} if injected is None else {"injected": np.column_stack(injected)}
        if moved is not None:
            fields["references"] = np.array([np.radians(10.0), 1.1]) + np.column_stack(moved)
        return arm.simulate([arm_experiment((10.0, 1.1), ROWS, injection=injection, **fields)], changes=quiet)[0]

    return simulate


NOTHING = np.zeros(ROWS)


@pytest.mark.parametrize("pair", [(ANGLE_RAD, NOTHING), (NOTHING, PRESSURE_BAR), (ANGLE_RAD, PRESSURE_BAR)])
def test_at_the_controller_s_input_it_acts_as_a_moved_reference(run, pair):
    injected, moved = run("controller_input", injected=pair), run("reference", moved=pair)
    for column in ("theta2_rad", "p_a_bar", "p_b_bar", "z_theta2_v", "z_p_v"):
        size = np.ptp(moved.column(column))
        assert size > 0.0
        # e + n against (r + n) - y: a rounding apart in each tick
        np.testing.assert_allclose(injected.column(column), moved.column(column), rtol=0.0, atol=1e-9 * size)
    np.testing.assert_array_equal(injected.column("n_theta2_rad"), pair[0])
    np.testing.assert_array_equal(injected.column("n_p_ab_bar"), pair[1])


def test_at_the_plant_s_input_it_adds_to_z_behind_the_controller(run):
    n_theta, n_p = RNG.uniform(-0.2, 0.2, (2, ROWS))
    r = run("plant_input", injected=(n_theta, n_p))
    z_theta, z_p = r.column("z_theta2_v"), r.column("z_p_v")
    np.testing.assert_allclose(r.column("u_a_v"), (z_theta + n_theta) + (z_p + n_p), atol=1e-15)
    np.testing.assert_allclose(r.column("u_b_v"), -(z_theta + n_theta) + (z_p + n_p), atol=1e-15)
    # z itself answers to the measured signals alone: nothing at the first row, where the arm stands on its setpoint
    assert abs(z_theta[0]) < 1e-12
    assert abs(z_p[0]) < 1e-12
    np.testing.assert_array_equal(r.column("n_theta2_v"), n_theta)


def test_z_is_the_controller_s_answer_to_the_logged_error(run, arm):
    """Closed by hand: the logged r, n and y through the controller give the logged z."""
    from scipy import signal

    r = run("controller_input", injected=(ANGLE_RAD, PRESSURE_BAR))
    errors = (
        r.column("r_theta2_rad") - r.column("theta2_rad") + r.column("n_theta2_rad"),
        r.column("r_p_ab_bar") - r.output("p_a_bar + p_b_bar") + r.column("n_p_ab_bar"),
    )
    for controller, e, z in zip(arm.default_controllers(1000.0), errors, ("z_theta2_v", "z_p_v"), strict=True):
        expected = signal.sosfilt(np.insert(controller.biquads(), 3, 1.0, axis=1), e)
        np.testing.assert_allclose(r.column(z), expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_with_open_loops_it_is_z_itself(run):
    n_theta, n_p = RNG.uniform(-0.05, 0.05, (2, ROWS))
    r = run("control", injected=(n_theta, n_p))
    np.testing.assert_array_equal(r.column("z_theta2_v"), n_theta)
    np.testing.assert_array_equal(r.column("z_p_v"), n_p)
    np.testing.assert_array_equal(r.column("n_theta2_rad"), 0.0)  # nothing was injected besides
    np.testing.assert_allclose(r.column("u_b_v"), n_p - n_theta, atol=1e-16)
    assert not r.info.closed_loop
