"""
Before the controller runs
==========================

The sensitivity of a loop under a controller that has not run yet, with the 95 % band that the error of the measured
response leaves, against the truth.
"""

import matplotlib.pyplot as plt
import numpy as np

import loopshape as ls

F_HZ, RATE_HZ = np.geomspace(0.3, 300.0, 250), 1000.0


def true_plant(f_hz):
    """A damped oscillator at 8 Hz with hold and one period of delay."""
    s = 2j * np.pi * f_hz
    w = 2.0 * np.pi * 8.0
    return (
        w**2
        / (s**2 + 0.8 * w * s + w**2)
        * np.exp(-1.5 * s / RATE_HZ)
        * np.sinc(f_hz / RATE_HZ)
    )


rng = np.random.default_rng(4)
error = (
    0.08 * (rng.standard_normal(F_HZ.size) + 1j * rng.standard_normal(F_HZ.size)) / np.sqrt(2.0)
)
P = ls.FRF.from_arrays(
    F_HZ, true_plant(F_HZ) * (1.0 + error), relative_std=0.08, rate_hz=RATE_HZ
)
C = ls.controller(ls.gain(1.2), ls.lead_lag(10.0, 80.0), ls.pi(0.6), rate_hz=RATE_HZ)
(found,) = ls.predict(P, C)

# %%
# A response with errors of 8 % predicts the sensitivity within the band shown.

S = found.sensitivity
size, radius = np.abs(S.siso), np.sqrt(3.0 * S.variance[:, 0, 0])
true = 1.0 / np.abs(1.0 + C.response(S.frequency_hz) * true_plant(S.frequency_hz))
figure, ax = plt.subplots(figsize=(6.5, 3.4), layout="constrained")
ax.fill_between(
    S.frequency_hz,
    np.maximum(size - radius, 1e-4),
    size + radius,
    color="#0072B2",
    alpha=0.3,
    linewidth=0.0,
)
ax.loglog(S.frequency_hz, size, color="#0072B2", label="predicted |S|, 95 %")
ax.loglog(S.frequency_hz, true, "k--", linewidth=1.0, label="truth")
ax.set(xlabel="frequency [Hz]", ylabel="|S|", xlim=(0.3, 300.0))
ax.legend()
