"""A notch at the end of the band makes |L| small on the last line and lets it rise above: no stability is claimed."""

import numpy as np
from conversions import TWO_PI

import loopshape as ls

RATE = 1000.0


def sampled(corner_hz):
    """Numerator and denominator in z of a lag behind a hold and two samples of delay, and its response."""
    a = np.exp(-TWO_PI * corner_hz / RATE)
    return np.array([1.0 - a]), np.array([1.0, -a, 0.0, 0.0])


def test_a_loop_that_is_unstable_above_the_lines_is_not_called_stable():
    num, den = sampled(24.3)
    C = ls.controller(
        ls.gain(0.98),
        ls.lead_lag(7.75, 170.0),
        ls.pi(0.19),
        ls.notch(170.0, damping1=0.12, damping2=0.85),
        rate_hz=RATE,
    )
    for b0, b1, b2, a1, a2 in C.biquads():
        num, den = np.polymul(num, [b0, b1, b2]), np.polymul(den, [1.0, a1, a2])
    assert np.abs(np.roots(np.polyadd(num, den))).max() > 1.05  # its closed loop is unstable
    f = np.geomspace(0.2, 170.0, 60)
    z = np.exp(1j * TWO_PI * f / RATE)
    P = ls.FRF.from_arrays(
        f, np.polyval(sampled(24.3)[0], z) / np.polyval(sampled(24.3)[1], z), relative_std=0.01, rate_hz=RATE
    )
    found = ls.check(P, C, ls.Requirements(gain_margin_db=5.0, integrators=0, unstable_poles=0))
    (margins,) = found.margins.values()
    assert margins.stable == "undecided"
    assert found.outcome == "undecided"
    assert "rises above the last line" in margins.stability_reason
