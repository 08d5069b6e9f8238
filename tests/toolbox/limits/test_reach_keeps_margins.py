"""Half-planes that are enough for phase, gain and delay margins: convex designs keep them, by their definitions."""

import itertools

import numpy as np
import pytest
from bench_nouns import TransferFunction
from bound_cases import limits, loop_of
from conversions import db

from loopshape.toolbox.limits.bound_nodes import nodes
from loopshape.toolbox.limits.bound_reach import half_planes, reached_at

MODEL = TransferFunction([3.0], np.polymul([1.0, 0.0], [1 / 900.0, 0.1 / 30.0, 1.0]), 0.01)


def crossings(f, L):
    """Frequencies and phase margins in degrees at |L| = 1, L straight in ln f between the nodes."""
    share = np.linspace(0.0, 1.0, 50, endpoint=False)
    fine = np.concatenate([a * (b / a) ** share for a, b in itertools.pairwise(L)])
    at = np.concatenate([a * (b / a) ** share for a, b in itertools.pairwise(f)])
    k = np.flatnonzero((np.abs(fine[:-1]) - 1.0) * (np.abs(fine[1:]) - 1.0) < 0.0)
    return at[k], np.degrees(np.abs(np.angle(-fine[k])))


@pytest.mark.long
@pytest.mark.parametrize("what", [{"phase_margin_deg": 50.0}, {"delay_margin_s": 0.08}])
def test_a_design_with_margins_crosses_once_and_with_its_margin(what):
    loop = loop_of(MODEL, integrators=1)
    bare = limits(sensitivity_peak_db=8.0, control_peak_db=30.0)
    asked = limits(sensitivity_peak_db=8.0, control_peak_db=30.0, **what)
    found = {}
    for margins in (False, True):
        one = reached_at(loop, asked if margins else bare, 3.0, margins=margins)
        lines = (one.f >= loop.frequency_hz[0]) & (one.f <= loop.frequency_hz[-1])
        found[margins] = crossings(one.f[lines], one.L[lines])
    f, phase = found[True]
    assert f.size == 1
    assert f[0] == pytest.approx(3.0, rel=0.02)
    required = what.get("phase_margin_deg", 360.0 * f[0] * what.get("delay_margin_s", 0.0))
    assert phase[0] >= required - 0.5
    assert found[False][1].min() < required - 2.0  # without them it is missed


def test_what_the_half_planes_leave_has_the_gain_margins_both_ways():
    loop = loop_of(MODEL, integrators=1)
    asked = limits(sensitivity_peak_db=12.0, gain_margin_db=6.5, gain_reduction_margin_db=9.0)
    rows = [(s[0], v[0]) for s, v, where in half_planes(nodes(loop, asked), 3.0, asked) if where.size]
    L = -np.concatenate([np.linspace(0.01, 0.99, 500), np.linspace(1.01, 9.0, 3000)])
    S = 1.0 / (1.0 + L)
    gains = [all(s * (x - v) <= 0.0 for s, v in rows if v not in (0.5,)) for x in S]
    margin = np.abs(db(np.abs(L)))
    needed = np.where(np.abs(L) < 1.0, 6.5, 9.0)
    np.testing.assert_array_equal(gains, margin >= needed)


def test_on_the_half_plane_s_edge_the_phase_margin_is_that_of_the_ceiling():
    phase = np.radians(np.linspace(5.0, 170.0, 40))
    S = 1.0 / (1.0 - np.exp(1j * phase))  # L = exp(j (pi + phase))
    np.testing.assert_allclose(S.real, 0.5, rtol=1e-12)
    np.testing.assert_allclose(np.abs(S), 0.5 / np.sin(0.5 * phase), rtol=1e-12)
