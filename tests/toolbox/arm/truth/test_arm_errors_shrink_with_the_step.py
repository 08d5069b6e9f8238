"""How fast the arm's two solvers converge, and what the source's way of seeing valve edges costs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from loopshape.toolbox.arm.dynamics.closed_loop import EDGES, GRID
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.dynamics.model import derivatives

SCALE = np.array([1e5, 1e5, 1e5, 1.0, 1.0])  # bar, rad, rad/s
SUB_STEPS = (1, 2, 4, 8)


def orders(errors):
    return np.log2(np.asarray(errors)[:-1] / np.asarray(errors)[1:])


@pytest.fixture(scope="module")
def below_supply(arm_constants):
    """A state with p_c at 0.9 bar: far from p_in and above both muscles, so that no flow reverses."""
    c = arm_constants()
    return c, rest(c, 10.0, 1.0, 0.9e5)


@pytest.mark.parametrize("z", [(0.11, 0.337), (0.3, 0.337), (0.513, 0.0377)])
def test_split_steps_have_order_4_where_no_flow_reverses(arm_open_loop, below_supply, z):
    c, start = below_supply
    drive = {"tick_s": 4e-3, "period_ticks": 5}  # coarse ticks, so that all four errors stand above rounding
    z = np.tile(z, (50, 1))  # both muscles' pulses end inside a step
    _, fine = arm_open_loop(c, start, z, steps=128, **drive)
    ends = np.array([arm_open_loop(c, start, z, steps=s, **drive)[1] for s in SUB_STEPS])
    assert ends[:, 0].max() < 0.95e5  # the stretch is what it is meant to be
    errors = np.abs(ends - fine)[:, [1, 2, 3]] / SCALE[[1, 2, 3]]
    assert errors[0].max() > 1e-9
    measured = orders(errors.max(axis=1))
    np.testing.assert_allclose(measured, 4.0, atol=0.2)


def test_split_steps_have_order_one_and_a_half_at_the_throttle_s_root(arm_open_loop, arm_constants):
    c = arm_constants()
    z = np.repeat([(0.113, 0.037), (-0.2, 0.11), (0.05, -0.15)], 200, axis=0)
    start = rest(c, 0.0, 1.0, 1e5)  # p_c = p_in: the root of 0 each time the capacity has filled
    fine, _ = arm_open_loop(c, start, z, steps=256)
    errors = [np.abs(arm_open_loop(c, start, z, steps=s)[0] - fine)[:, 11].max() for s in (2, 4, 8, 16)]
    np.testing.assert_allclose(orders(errors), 1.5, atol=0.15)  # ARM.md, section 10
    assert errors[0] < 1e-9 * 1e5  # and tiny: below 1e-9 bar


def test_split_steps_agree_with_dop853_between_edges(arm_open_loop, below_supply):
    c, start = below_supply
    u_a, u_b, period_s, periods = 0.447, 0.227, 0.02, 5
    z = np.tile([(u_a - u_b) / 2.0, (u_a + u_b) / 2.0], (100, 1))
    x = start[:5]
    for _ in range(periods):
        edges = [0.0, u_b * period_s, u_a * period_s, period_s]
        for left, right, valves in zip(edges[:-1], edges[1:], ((1, 1), (1, 0), (0, 0)), strict=True):

            def rhs(_, x, valves=valves):
                d = derivatives(c, tuple(x), (valves[0] == 1, valves[1] == 1, False, False))
                return [*d[:3], x[4], d[3]]

            x = solve_ivp(rhs, (left, right), x, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    at_1_ms, at_an_eighth = (arm_open_loop(c, start, z, steps=s)[1][:5] for s in (1, 8))
    assert abs(np.degrees(at_1_ms[3] - x[3])) < 1e-6  # ARM.md, section 10: 4e-7 deg at 1 ms
    np.testing.assert_allclose(at_an_eighth, x, rtol=1e-10)


def test_grid_has_order_3_when_no_valve_moves(arm_open_loop, arm_constants):
    c = arm_constants()
    start = rest(c, 0.0, 1.2, 0.9e5)
    z = np.tile([1.3, 0.0], (100, 1))  # u_A = 1.3 and u_B = -1.3: open all the time
    _, fine = arm_open_loop(c, start, z, steps=64)
    errors = [np.abs(arm_open_loop(c, start, z, solver=GRID, steps=s)[1] - fine)[:4] / SCALE[:4] for s in SUB_STEPS]
    np.testing.assert_allclose(orders(np.max(errors, axis=1)), 3.0, atol=0.1)


def staircase(u, rows=1600):
    z = np.zeros((rows, 2))
    z[:800, 0] = u
    return z


def test_grid_falls_to_order_1_when_edges_lie_off_it(arm_open_loop, arm_constants):
    c = arm_constants()
    start = rest(c, 0.0, 1.0, 1e5)
    errors = {s: [] for s in SUB_STEPS}
    for u in 0.1 + 0.2 * (0.6180339887 * np.arange(16) % 1.0):  # pulse ends spread evenly over a step
        exact = arm_open_loop(c, start, staircase(u, 400), steps=4)[1][3]
        for s in SUB_STEPS:
            errors[s].append(arm_open_loop(c, start, staircase(u, 400), solver=GRID, steps=s)[1][3] - exact)
    rms = [np.degrees(np.sqrt(np.mean(np.square(e)))) for e in errors.values()]
    np.testing.assert_allclose(orders(rms), 1.0, atol=0.25)  # an edge is missed by a share of the step
    assert 0.1 < rms[0] < 0.4  # measured 0.22 deg after 0.4 s at 1 ms


def test_missed_edges_cost_tenths_of_a_degree_in_open_loop(arm_open_loop, arm_constants):
    c = arm_constants()
    start = rest(c, 0.0, 1.0, 1e5)
    fine, edges, grid = (
        np.degrees(arm_open_loop(c, start, staircase(0.22), solver=solver, steps=steps)[0][:, 7])
        for solver, steps in ((EDGES, 16), (EDGES, 1), (GRID, 1))
    )
    assert np.ptp(fine) > 10.0
    # ARM.md, section 10: 0.6 deg; here 0.75 deg, and 4e-8 deg with exact edges
    assert 0.5 < np.abs(grid - fine).max() < 1.0
    assert np.abs(edges - fine).max() < 1e-5


def test_the_cost_is_the_pulse_that_the_stages_see(arm_open_loop, arm_constants):
    c = arm_constants()
    start = rest(c, 0.0, 1.0, 1e5)
    # a pulse of 4.4 ms is open at the stage at 4.0 ms, weight 2/9, and shut at 4.5 and 4.75: it counts as 4 2/9 ms
    seen = 0.05 * (4.0 + 2.0 / 9.0)
    grid, _ = arm_open_loop(c, start, staircase(0.22), solver=GRID)
    edges, _ = arm_open_loop(c, start, staircase(seen))
    assert np.degrees(np.abs(grid - edges)[:, 7].max()) < 1e-3  # of 0.75 deg; measured 2.6e-4
