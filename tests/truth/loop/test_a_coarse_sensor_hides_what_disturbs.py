"""An encoder at rest: what moves within its step is in no recording. Truth is the loop, sample by sample."""

import numpy as np
import pytest
from scipy.signal import cont2discrete

import loopshape as ls

RATE = 1000.0
NUM, DEN = (np.ravel(x) for x in cont2discrete(([300.0], [1.0, 10.0, 0.0]), 1.0 / RATE, "zoh")[:2])


def controller(gain, low_hz):
    return ls.controller(ls.gain(gain), ls.lead_lag(low_hz, 10.0 * low_hz), rate_hz=RATE)


def simulated(C, std, seed):
    """Error in counts and input, with white noise under the rounding to whole counts."""
    rows = C.biquads()
    b, a = np.prod(rows[:, 0]) * np.array([1.0, *(rows[-1, 1:2] / rows[-1, 0])]), rows[-1, 3]
    d = std * np.random.default_rng(seed).standard_normal(22_000)
    e, u, x = np.zeros((3, d.size))
    for k in range(2, d.size):
        x[k] = NUM[1] * u[k - 1] + NUM[2] * u[k - 2] - DEN[1] * x[k - 1] - DEN[2] * x[k - 2]
        e[k] = -np.round(x[k] + d[k])
        u[k] = b[0] * e[k] + b[1] * e[k - 1] - a * u[k - 1]
    return e[2000:], u[2000:]


def test_a_limit_within_what_rounding_hides_is_undecided():
    """0.027 counts rms were recorded; the new loop leaves 0.04 and a limit of 0.038 had passed."""
    old, new = controller(0.3, 2.0), controller(6.0, 8.0)
    f_hz = np.geomspace(0.3, 480.0, 200)
    z = np.exp(2j * np.pi * f_hz / RATE)
    P = ls.FRF.from_arrays(f_hz, np.polyval(NUM, z) / np.polyval(DEN, z), relative_std=0.002, rate_hz=RATE)
    error, control = simulated(old, 0.15, 1)
    disturbance = ls.Disturbance.from_arrays(error, RATE, recorded_under=old, control=control)
    truth = np.sqrt(np.mean(simulated(new, 0.15, 2)[0] ** 2))
    assert 0.038 < truth < 0.05
    assert disturbance.coarse
    for limit, outcome in ((0.038, "undecided"), (1.0, "passed")):
        R = ls.Requirements(error_rms=limit, unstable_poles=0, integrators=1)
        verdict = ls.check(P, new, R, disturbance=disturbance)
        assert [str(row.outcome) for row in verdict.lines if row.quantity == "error_rms"] == [outcome]
        assert any("sensor's step" in text for text in verdict.warnings)


def test_noise_over_many_counts_is_not_coarse():
    noise = np.round(3.0 * np.random.default_rng(1).standard_normal(4000)) * 0.1
    assert not ls.Disturbance.from_arrays(noise, RATE).coarse
    assert ls.Disturbance.from_arrays(noise, RATE).step == pytest.approx(0.1)


def test_an_error_that_never_changes_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match="never changes"):
        ls.Disturbance.from_arrays(np.full(1000, 0.3), RATE)
