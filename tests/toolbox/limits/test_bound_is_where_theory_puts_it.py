"""Bounds where the best possible is known, and high-order controllers that come close to them."""

import numpy as np
import pytest
from bench_nouns import TransferFunction
from bound_cases import limits, loop_of
from conversions import TWO_PI, db

from loopshape.toolbox.limits.bound import excluded
from loopshape.toolbox.limits.bound_nodes import weights
from loopshape.toolbox.limits.bound_reach import achieved


@pytest.mark.long
@pytest.mark.parametrize("peak", [1.5, 2.0, 3.0])
def test_a_zero_in_the_right_half_plane_excludes_what_the_two_constants_theorem_excludes(peak):
    # S(z) = 1 at a zero z. With |S| <= 2^-1/2 below f and <= M above, ln 1 <= a ln 2^-1/2 + (1 - a) ln M with the
    # harmonic measure a = (2/pi) atan(f/z) (Freudenberg and Looze, IEEE Trans. Automatic Control 30(6), 1985)
    z_hz = 1.0
    z = TWO_PI * z_hz
    share = np.log(peak) / (np.log(peak) + 0.5 * np.log(2.0))
    limit_hz = z_hz * np.tan(0.5 * np.pi * share)
    loop = loop_of(TransferFunction([-1.0, z], [1.0, z]), low_hz=0.01, high_hz=300.0, lines=500)
    for factor, possible in ((0.96, True), (1.04, False)):
        asked = limits(sensitivity_peak_db=float(db(peak)), sensitivity_bandwidth_hz=factor * limit_hz)
        found = excluded(loop, [loop], asked)
        assert (found.bound_hz > found.first_hz) is possible


def test_a_limit_on_cs_alone_is_bracketed_by_a_constant_and_by_each_frequency():
    # P = 1/(s + 1), |CS| <= m. CS = m gives Re T = m/(1 + w^2) >= 1/2 up to w^2 = 2 m - 1; at one frequency
    # |T| <= m/|s + 1| reaches 1/2 no further than w^2 = 4 m^2 - 1
    m = 4.0
    loop = loop_of(TransferFunction([1.0], [1.0, 1.0]), low_hz=0.01, high_hz=30.0)
    asked = limits(control_peak_db=float(db(m)))
    bound = excluded(loop, [loop], asked)
    assert np.sqrt(2.0 * m - 1.0) < TWO_PI * bound.bound_hz < 1.02 * np.sqrt(4.0 * m**2 - 1.0)
    assert achieved(loop, asked, bound.bound_hz).bandwidth_hz > 0.85 * bound.bound_hz


def test_twice_the_delay_halves_the_bound():
    # 1/s with a delay d depends on f d alone where |CS| does not matter
    asked = limits(sensitivity_peak_db=6.0, control_peak_db=60.0)
    found = [
        excluded(loop, [loop], asked).bound_hz
        for delay in (0.05, 0.1)
        for loop in [loop_of(TransferFunction([1.0], [1.0, 0.0], delay), integrators=1)]
    ]
    assert found[0] == pytest.approx(2.0 * found[1], rel=0.06)


@pytest.mark.long
def test_a_high_order_controller_reaches_most_of_the_bound_and_is_stable():
    model = TransferFunction([3.0], np.polymul([1.0, 0.0], [1 / 900.0, 0.1 / 30.0, 1.0]), 0.01)
    loop = loop_of(model, integrators=1)
    asked = limits(sensitivity_peak_db=6.0, control_peak_db=30.0)
    bound = excluded(loop, [loop], asked)
    found = achieved(loop, asked, bound.bound_hz)
    assert 0.8 * bound.bound_hz < found.bandwidth_hz <= bound.bound_hz
    lines = (found.f >= loop.frequency_hz[0]) & (found.f <= loop.frequency_hz[-1])
    S = 1.0 / (1.0 + found.L)
    assert db(S[lines]).max() < 6.0 + 1e-6
    assert db(found.C * S).max() < 30.0 + 1e-6
    assert np.abs(found.L[lines & (found.f < found.bandwidth_hz)]).min() >= 1.0 - 1e-9
    # CS is stable: orthogonal to stable functions that fall as 1/s^2, and not to unstable ones
    s = loop.controller.s_at(found.f)
    _, dw = weights(s)
    for pole in TWO_PI * np.array([0.3, 3.0, 30.0]):
        for sign, stable in ((1.0, True), (-1.0, False)):
            h = 1.0 / ((s + sign * pole) * (s + 2.0 * pole))
            share = abs(dw @ np.real(h * found.C * S)) / (dw @ np.abs(h * found.C * S))
            assert bool(share < 2e-3) is stable


def test_limits_that_leave_nothing_put_the_bound_at_the_first_line():
    loop = loop_of(TransferFunction([1.0], [1.0, 1.0]))
    found = excluded(loop, [loop], limits(control_peak_db=-10.0))
    assert found.bound_hz == found.first_hz


def test_limits_that_are_not_convex_exclude_nothing():
    loop = loop_of(TransferFunction([1.0], [1.0, 1.0]))
    assert excluded(loop, [loop], limits(phase_margin_deg=60.0)).bound_hz == np.inf
