"""Makes closed_loop.csv: a made-up position axis (mass, friction, one resonance) in closed loop with noise.

    python examples/axis/make.py

The axis: 1/(s (0.02 s + 1)) m per V times a resonance at 22 Hz (damping 0.05), sampled at 500 Hz behind a zero-order
hold; the controller is a gain of 8 V/m; the position carries 5 um rms of noise, the table is in mm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete

RATE_HZ = 500.0
GAIN_V_M = 8.0


def plant() -> tuple[np.ndarray, np.ndarray]:
    """Continuous numerator and denominator from V to m."""
    w = 2.0 * np.pi * 22.0
    den = np.polymul(np.polymul([1.0, 0.0], [0.02, 1.0]), [1.0, 2.0 * 0.05 * w, w * w])
    return np.array([w * w]), den


def main() -> None:
    """Simulate 30 s of band-limited noise in front of the controller and write the table."""
    rng = np.random.default_rng(3)
    num, den, _ = cont2discrete(plant(), 1.0 / RATE_HZ, method="zoh")
    b, a = np.squeeze(num), den
    n = round(30 * RATE_HZ)
    spectrum = np.fft.rfft(rng.standard_normal(n))
    f = np.fft.rfftfreq(n, 1.0 / RATE_HZ)
    spectrum[(f < 0.2) | (f > 60.0)] = 0.0
    injected = np.fft.irfft(spectrum, n)
    injected *= 0.01 / injected.std()
    noise = 5e-6 * rng.standard_normal(n)
    u, x, y = np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(n):
        past = min(k, a.size - 1)
        x[k] = b[1 : past + 1] @ u[k - 1 : k - past - 1 if k > past else None : -1] if past else 0.0
        x[k] -= a[1 : past + 1] @ x[k - 1 : k - past - 1 if k > past else None : -1] if past else 0.0
        y[k] = x[k] + noise[k]
        u[k] = GAIN_V_M * (injected[k] - y[k])
    table = np.column_stack([1e3 * injected, u, 1e3 * y])
    np.savetxt(
        Path(__file__).parent / "closed_loop.csv",
        table,
        fmt=("%.4f", "%.6f", "%.4f"),
        delimiter=",",
        header="injected_mm,drive_V,position_mm",
        comments="",
    )


if __name__ == "__main__":
    main()
