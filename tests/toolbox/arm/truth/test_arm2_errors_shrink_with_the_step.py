"""How fast the 2-DoF arm's steps converge when four pulses end inside them, and that DOP853 agrees between edges."""

from itertools import pairwise

import numpy as np
import pytest
from arm2_cases import numbers, open_loop
from scipy.integrate import solve_ivp

from loopshape.toolbox.arm.dynamics.equilibrium2 import rest2
from loopshape.toolbox.arm.dynamics.model2 import derivatives2

C = numbers()
START = rest2(C, 2.0, 5.0, 0.5, 0.45, 0.9e5)  # p_c far from p_in and above all muscles: no flow reverses
SCALE = np.array([1e5] * 5 + [1.0] * 4)


@pytest.mark.parametrize("z", [(0.11, 0.337, 0.1, 0.3), (-0.2, 0.1, 0.513, -0.0377), (0.3, -0.23, 0.05, 0.45)])
def test_split_steps_have_order_4_where_no_flow_reverses(z):
    drive = {"tick_s": 4e-3, "period_ticks": 5}  # coarse ticks, so that all four errors stand above rounding
    z = np.tile(z, (25, 1))
    _, fine = open_loop(C, START, z, steps=128, **drive)
    assert fine[0] < 0.95e5  # the stretch is what it is meant to be
    errors = [np.abs((open_loop(C, START, z, steps=s, **drive)[1] - fine) / SCALE)[1:].max() for s in (1, 2, 4, 8)]
    assert errors[0] > 1e-8
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 4.0, atol=0.35)


def test_split_steps_agree_with_dop853_between_edges():
    z1, z2, z_a, z_c = 0.107, 0.227, 0.12, 0.31
    u = np.array([z2 + z_a, -z2, z_c - z1, z1])
    x, period_s = START, 0.02
    for _ in range(4):
        edges = np.unique([0.0, *(np.abs(u) * period_s), period_s])
        for left, right in pairwise(edges):
            is_open = np.abs(u) * period_s > left
            valves = (*(is_open & (u > 0)), *(is_open & (u < 0)))

            def rhs(_, x, valves=valves):
                return derivatives2(C, x, valves)

            x = solve_ivp(rhs, (left, right), x, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    at_1_ms, at_an_eighth = (open_loop(C, START, np.tile([z1, z2, z_a, z_c], (80, 1)), steps=s)[1] for s in (1, 8))
    assert np.degrees(np.abs(at_1_ms - x)[5:7]).max() < 1e-6
    np.testing.assert_allclose(at_an_eighth, x, rtol=1e-9)
