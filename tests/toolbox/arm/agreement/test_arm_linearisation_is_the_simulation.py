"""The linearised arm and the simulated one, for small motions about an equilibrium."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from loopshape.toolbox.arm.dynamics.equilibrium import angle_deg, pressures, rest
from loopshape.toolbox.arm.dynamics.linear import linearise, ripple_gains
from loopshape.toolbox.arm.source import EQUILIBRIA

POINTS = [(0.0, 1.0), (30.0, 0.8), (-15.0, 1.4), (15.0, 1.2)]
GASES = [{}, {"gas_absolute_share": 1.0}, {"gas_absolute_share": 1.0, "polytropic_exponent": 1.4}]


def free_oscillation(t, x):
    """Eigenfrequency in Hz and damping ratio of a decaying oscillation about any level, by least squares."""

    def basis(q):
        decay = np.exp(-q[1] * t)
        return np.column_stack([decay * np.cos(q[0] * t), decay * np.sin(q[0] * t), np.ones_like(t)])

    def misfit(q):
        return x - basis(q) @ np.linalg.lstsq(basis(q), x, rcond=None)[0]

    w, sigma = least_squares(misfit, [30.0, 1.5], x_scale=[30.0, 1.0]).x
    return np.hypot(w, sigma) / (2.0 * np.pi), sigma / np.hypot(w, sigma)


@pytest.mark.parametrize("gas", GASES)
@pytest.mark.parametrize("point", POINTS)
def test_free_oscillation_has_the_linearised_frequency_and_damping(arm_open_loop, arm_constants, point, gas):
    c = arm_constants(**gas)
    start = rest(c, *point, 1e5)
    start[3] += np.radians(0.001)
    log, _ = arm_open_loop(c, start, np.zeros((3000, 2)), dead_zone=0.0)
    f_hz, zeta = free_oscillation(np.arange(3000) / 1000.0, log[:, 7] / np.radians(0.001))
    _, linear_hz, linear_zeta = linearise(c, *point).third_order()
    # what is left is the amplitude of 0.001 deg: measured below 4e-6 and 2e-5
    assert f_hz == pytest.approx(linear_hz, rel=2e-5)
    assert zeta == pytest.approx(linear_zeta, rel=1e-4)


def test_a_large_oscillation_differs_from_the_linearised_one(arm_open_loop, arm_constants):
    """So the bounds above are held by smallness, not by blindness."""
    c = arm_constants()
    start = rest(c, 30.0, 0.8, 1e5)
    start[3] += np.radians(2.0)
    log, _ = arm_open_loop(c, start, np.zeros((3000, 2)), dead_zone=0.0)
    f_hz, _ = free_oscillation(np.arange(3000) / 1000.0, log[:, 7] / np.radians(2.0))
    assert abs(f_hz / linearise(c, 30.0, 0.8).third_order()[1] - 1.0) > 1e-4


@pytest.mark.parametrize("point", POINTS)
def test_averaged_valves_are_what_short_pulses_do(arm_open_loop, arm_constants, point):
    c = arm_constants()
    lin = linearise(c, *point)
    u, period_s = 0.02, 0.02
    for z, column, gain in (
        ((u / 2, u / 2), 9, lin.fill[0]),  # u_A = u, u_B = 0
        ((-u / 2, u / 2), 10, lin.fill[1]),
        ((-u / 2, -u / 2), 9, -lin.exhaust[0]),
        ((u / 2, -u / 2), 10, -lin.exhaust[1]),
    ):
        log, end = arm_open_loop(c, rest(c, *point, 1e5), [z])  # one tick of 1 ms holds the pulse of 0.4 ms
        moved = 1e-5 * (end[column - 8] - log[0, column])
        # the pulse moves the pressures by 4e-4 bar, which changes the flow by about as much
        assert moved == pytest.approx(gain * u * period_s, rel=5e-3)


@pytest.mark.parametrize("point", POINTS)
def test_response_is_the_third_order_model(arm_constants, point):
    lin = linearise(arm_constants(), *point)
    kappa, f_hz, zeta = lin.third_order()
    f = np.geomspace(0.05, 100.0, 50)
    s, w = 2j * np.pi * f, 2.0 * np.pi * f_hz
    # exact: the muscles' gas makes two poles at zero, of which z_theta2 sees one
    np.testing.assert_allclose(lin.response(f)[:, 0, 0], kappa / (s**3 + 2.0 * zeta * w * s**2 + w**2 * s), rtol=1e-7)


def test_response_follows_z_p_at_the_mean_gain(arm_constants):
    """At (0 deg, 1 bar) both muscles are nearly alike: p_AB/z_p integrates the sum of both gains."""
    lin = linearise(arm_constants(), 0.0, 1.0)
    f = np.array([0.05, 1.0, 20.0])
    np.testing.assert_allclose(lin.response(f)[:, 1, 1], lin.mean_gains.sum() / (2j * np.pi * f), rtol=1e-4)


def test_pressures_and_angle_are_each_other_s_inverse(arm_constants):
    c = arm_constants()
    for theta, p_ab in EQUILIBRIA:
        p_a, p_b = pressures(c, theta, p_ab)
        assert p_a + p_b == pytest.approx(p_ab, abs=1e-12)
        assert angle_deg(c, p_a, p_b) == pytest.approx(theta, abs=1e-9)


def test_an_arm_at_rest_stays_at_rest(arm, arm_experiment, quiet):
    for theta, p_ab in EQUILIBRIA:
        (r,) = arm.simulate(
            [arm_experiment((theta, p_ab), 2000, injection="control")], changes=quiet, states=True, threads=1
        )
        assert np.abs(r.column("true_theta2_rad") - np.radians(theta)).max() < 1e-10


def test_gains_of_a_moving_command_are_its_describing_function(arm_constants):
    lin = linearise(arm_constants(), 0.0, 1.0)
    a = np.array([0.1, 0.5])

    def gains(mean, dead_zone):
        return ripple_gains(lin, np.array([mean, mean]), a, dead_zone)

    np.testing.assert_allclose(gains(0.0, 0.0), [lin.mean_gains] * 2, rtol=1e-4)  # half filling, half exhaust
    np.testing.assert_allclose(gains(1.0, 0.0), [lin.fill] * 2, rtol=1e-4)  # always filling
    np.testing.assert_allclose(gains(-1.0, 0.0), [lin.exhaust] * 2, rtol=1e-4)
    # a dead zone d leaves 1 - (2/pi)(arcsin x - x sqrt(1 - x^2)) of the gain, x = d/a
    x = 0.05 / a
    left = 1.0 - 2.0 / np.pi * (np.arcsin(x) - x * np.sqrt(1.0 - x**2))
    np.testing.assert_allclose(gains(0.0, 0.05), left[:, None] * lin.mean_gains, rtol=2e-3)
