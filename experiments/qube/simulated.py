"""An unstable plant under a known controller, run exactly: what both estimators make of it, by length and noise."""

from __future__ import annotations

import numpy as np
from scipy.signal import cont2discrete, freqz, lfilter

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings

RATE_HZ = 100.0
BAND_HZ = (0.5, 6.0)
B, A, _ = cont2discrete(([40.0], [1.0, 0.0, -25.0]), 1.0 / RATE_HZ)  # 40/(s² - 25): falls over within 0.2 s
B, A = B[0], A
KP, KD, LAG = 2.0, 0.25, np.exp(-60.0 / RATE_HZ)  # y fed back as KP y + KD of its slope, low-passed at 60 rad/s
D = KP * np.array([1.0, -LAG]) + KD * (1.0 - LAG) * RATE_HZ * np.array([1.0, -1.0])
F = np.array([1.0, -LAG])
LOOP = LoopSetup("axis", "n_v", None, "u_v", "y_rad", None)


def plant(frequency_hz: Array) -> ComplexArray:
    """Response (nf,) of the plant, whose poles lie outside the unit circle."""
    return np.asarray(freqz(B, A, worN=TWO_PI * frequency_hz / RATE_HZ)[1])


def minus_inverse_controller(frequency_hz: Array) -> ComplexArray:
    """-1/C (nf,)."""
    return np.asarray(-1.0 / freqz(D, F, worN=TWO_PI * frequency_hz / RATE_HZ)[1])


def recording(length_s: float, noise_rad: float, seed: int) -> Recording:
    """u = n - C (y + v) and y of the loop, n white at the plant's input, v sensor noise that y is logged with."""
    rng = np.random.default_rng(seed)
    n, v = rng.standard_normal((2, round(length_s * RATE_HZ)))
    v = noise_rad * v
    closed = np.convolve(A, F) + np.convolve(B, D)
    assert np.abs(np.roots(closed)).max() < 1.0 < np.abs(np.roots(A)).max()
    u = lfilter(np.convolve(A, F), closed, n) - lfilter(np.convolve(A, D), closed, v)
    y = lfilter(np.convolve(B, F), closed, n) + lfilter(np.convolve(A, F), closed, v)
    info = RecordingInfo("r.parquet", "noise", "reference", excites="axis")
    return Recording(info, RATE_HZ, {"n_v": n, "u_v": u, "y_rad": y})


def estimated(estimator: str, length_s: float, noise_rad: float, seed: int) -> FRF:
    """The plant by one estimator, within the band."""
    settings = Settings(estimator, "welch", resolution_hz=0.25)
    return estimate_frf(recording(length_s, noise_rad, seed), LOOP, settings).between(*BAND_HZ)


def relative_error(estimator: str, length_s: float, noise_rad: float, records: int) -> float:
    """Rms over lines and recordings of the error relative to the plant."""
    found = [estimated(estimator, length_s, noise_rad, 1000 * k + round(length_s)) for k in range(records)]
    errors = [np.abs(frf.siso / plant(frf.frequency_hz) - 1.0) ** 2 for frf in found]
    return float(np.sqrt(np.mean(np.concatenate(errors))))
