"""A scheduled controller is each node's controller there, and a change of the operating point makes no step."""

from itertools import permutations

import numpy as np
import pytest
from scipy.signal import lfilter

import loopshape as ls
from loopshape.toolbox.schedules import gain_scheduled, kernel

RATE_HZ = 1000.0


def node(gain: float, lead_hz: float, notch_hz: float, low_hz: float = 15.0) -> ls.Controller:
    blocks = (ls.gain(gain), ls.lead_lag(1.0, lead_hz), ls.notch(notch_hz, 0.05, 3.0), ls.low_pass(low_hz, 0.7))
    return ls.controller(*blocks, rate_hz=RATE_HZ, loop="theta")


def over_two(*controllers: ls.Controller, lag_s: float = 0.0) -> ls.schedules.GainScheduled:
    points = [{"theta_deg": t, "p_bar": p} for t in (-30.0, 30.0) for p in (0.8, 1.4)]
    return ls.schedules.gain_scheduled(
        controllers, points, {"theta_deg": "theta", "p_bar": ("p", "output")}, lag_s=lag_s
    )


def tables(C: ls.schedules.GainScheduled) -> kernel.Scheduled:
    return C.tables([("theta", gain_scheduled.Follows.REFERENCE), ("p", gain_scheduled.Follows.OUTPUT)])


def ran(C: ls.schedules.GainScheduled, theta_deg: np.ndarray, p_bar: np.ndarray, error: np.ndarray) -> np.ndarray:
    return kernel.run(tables(C), np.stack([np.radians(theta_deg), p_bar], axis=1), error)


def test_at_a_frozen_point_it_is_the_interpolated_controller():
    """Independent of the kernel: gains and squared time constants by hand, Tustin by the noun, lfilter by scipy."""
    C = over_two(node(10, 15, 5), node(6, 18, 6), node(8, 12, 4.5), node(4, 20, 5.5))
    theta, p = 6.0, 1.25
    a, b = (theta + 30.0) / 60.0, (p - 0.8) / 0.6
    weights = [(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b]
    frozen = C.at({"theta_deg": theta, "p_bar": p})
    assert frozen.blocks[0].section()[0][0] == pytest.approx(np.dot(weights, [10, 6, 8, 4]))
    w2 = [1.0 / (2.0 * np.pi * f) ** 2 for f in (5, 6, 4.5, 5.5)]
    assert frozen.blocks[2].section()[1][2] == pytest.approx(np.dot(weights, w2))
    error = np.random.default_rng(1).standard_normal(3000)
    expected = error
    for b0, b1, b2, a1, a2 in frozen.biquads():
        expected = lfilter([b0, b1, b2], [1.0, a1, a2], expected)
    out = ran(C, np.full(error.size, theta), np.full(error.size, p), error)
    np.testing.assert_allclose(out, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_a_node_is_its_own_controller_and_outside_the_grid_the_edge_holds():
    C = over_two(node(10, 15, 5), node(6, 18, 6), node(8, 12, 4.5), node(4, 20, 5.5))
    for at, one in zip(C.nodes, C.controllers, strict=True):
        assert C.at(at) is one
    assert C.at({"theta_deg": 50.0, "p_bar": 0.1}) is C.controllers[2]


def test_blocks_of_unit_static_gain_change_without_any_step():
    """A constant error, each jump between two operating points: lead, notch, low-pass change, the output does not."""
    C = over_two(node(7, 15, 5), node(7, 18, 6), node(7, 12, 4.5), node(7, 20, 5.5, 30.0))
    n = 8000
    for before, after in permutations(C.nodes, 2):
        jump = np.arange(2 * n) >= n
        theta, p = (np.where(jump, after[k], before[k]) for k in ("theta_deg", "p_bar"))
        out = ran(C, theta, p, np.full(2 * n, 0.3))
        assert np.abs(out[n - 1 :] - 2.1).max() < 1e-9
    assert C.largest_step() < 1e-10


def test_a_changed_gain_steps_by_no_more_than_stated():
    """Direct form II, the usual one, fails this: its states are sums of coefficients times signals."""
    C = over_two(node(10, 15, 5), node(6, 18, 6), node(8, 12, 4.5), node(4, 20, 5.5))
    n, stated = 3000, C.largest_step()
    assert stated < 0.05 * 6.0  # of the change of the gain, as a low-pass follows the gains
    found = 0.0
    for before, after in permutations(C.nodes, 2):
        jump = np.arange(2 * n) >= n
        theta, p = (np.where(jump, after[k], before[k]) for k in ("theta_deg", "p_bar"))
        out = ran(C, theta, p, np.ones(2 * n))
        found = max(found, abs(out[n] - out[n - 1]))
        assert out[-1] == pytest.approx(C.at(after).blocks[0].parameters["gain"], rel=1e-6)
    assert found == pytest.approx(stated, rel=1e-6)


def test_the_lag_makes_the_step_as_much_smaller_as_it_is_longer_than_a_tick():
    nodes = (node(10, 15, 5), node(6, 15, 5), node(10, 15, 5), node(6, 15, 5))
    n, jump = 3000, np.arange(6000) >= 3000
    p = np.where(jump, 1.4, 0.8)
    steps = [
        np.abs(np.diff(ran(over_two(*nodes, lag_s=lag_s), np.zeros(2 * n), p, np.ones(2 * n)))[n - 1])
        for lag_s in (0.0, 0.1)
    ]
    assert steps[1] == pytest.approx(0.01 * steps[0], rel=0.01)


def test_an_integrator_keeps_its_output_when_the_operating_point_jumps():
    def with_pi(gain: float, f_hz: float) -> ls.Controller:
        return ls.controller(ls.gain(gain), ls.pi(f_hz), ls.low_pass(20.0, 0.7), rate_hz=RATE_HZ, loop="theta")

    C = ls.schedules.gain_scheduled(
        [with_pi(2.0, 0.5), with_pi(5.0, 2.0)], [{"p_bar": 0.8}, {"p_bar": 1.4}], {"p_bar": "p"}, lag_s=0.0
    )
    n = 4000
    error = np.where(np.arange(2 * n) < 1000, 1.0, 0.0)  # then the integrator holds
    signals = np.where(np.arange(2 * n) < n, 0.8, 1.4)[:, None]
    out = kernel.run(C.tables([("p", gain_scheduled.Follows.REFERENCE)]), signals, error)
    assert out[n - 1] > 1.0
    np.testing.assert_allclose(out[n - 1 :], out[n - 1], rtol=1e-9)
