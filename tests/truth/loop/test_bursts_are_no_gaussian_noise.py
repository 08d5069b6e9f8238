"""A disturbance of shocks: intervals of rms and peaks hold what further records under another controller do.

Truth is the loop's own difference equation, by scipy, on further draws of the shocks.
"""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import loopshape as ls

RATE, SECONDS, SETTLED = 500.0, 60.0, 2000


def shocks(rng):
    """White noise and a shock of normal size every two seconds in the mean, each over in some ten samples."""
    n = round(SECONDS * RATE) + SETTLED
    hits = (rng.random(n) < 0.5 / RATE) * 20.0 * rng.standard_normal(n)
    return 0.3 * rng.standard_normal(n) + lfilter([1.0], [1.0, -0.9], hits)


def closed(num, den, gain, d):
    """Error and input of a loop under a gain, with d at the plant's output, once it has settled."""
    error = -lfilter(den, np.polyadd(den, gain * num), d)[SETTLED:]
    return error, gain * error


@pytest.mark.long
def test_intervals_of_shocks_hold_what_other_records_do():
    held, peaks = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        w = 2.0 * np.pi * 10.0 ** rng.uniform(0.0, 1.0)
        num, den, _ = cont2discrete(([1.0], [1.0 / w, 1.0]), 1.0 / RATE, "zoh")
        num = np.atleast_1d(num.squeeze())
        f = np.arange(0.1, 200.0, 0.1)
        z = np.exp(2j * np.pi * f / RATE)
        P = ls.FRF.from_arrays(
            f, np.polyval(num, z) / np.polyval(den, z), relative_std=0.01, rate_hz=RATE, open_loop=True
        )
        old, new = rng.uniform(0.5, 8.0, 2)
        error, control = closed(num, den, old, shocks(rng))
        C0, C1 = (ls.controller(ls.gain(float(x)), rate_hz=RATE) for x in (old, new))
        D = ls.Disturbance.from_arrays(error, RATE, recorded_under=C0, control=control)
        R = ls.Requirements(error_rms=1.0, control_peak=1.0, control_rate=1.0, integrators=0, unstable_poles=0)
        (m,) = ls.check(P, C1, R, disturbance=D).margins.values()
        others = [closed(num, den, new, shocks(rng)) for _ in range(8)]
        rms = np.sqrt(np.mean([np.mean(e**2) for e, _ in others]))
        held.append(m["error_rms"].ends[0] <= rms <= m["error_rms"].ends[1])
        found = [(np.abs(u).max(), np.abs(np.diff(u)).max() * RATE) for _, u in others]
        ends = np.array([m[name].ends for name in ("control_peak", "control_rate")])
        peaks += [ends[:, 0] <= x for x in found] + [x <= ends[:, 1] for x in found]
    assert np.mean(held) >= 0.85  # two standard errors below 95 % of 40
    assert 2.0 * np.mean(peaks) - 1.0 >= 0.85
    assert np.mean(held) < 1.0 or 2.0 * np.mean(peaks) - 1.0 < 1.0  # nor as wide as one likes
