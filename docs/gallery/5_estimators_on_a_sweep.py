"""
Estimators on a sweep
=====================

A resonant axis is swept in closed loop while a disturbance acts on it. The direct estimator, output over plant input, is
pulled towards the inverse of the controller where the loop's noise exceeds the excitation; the estimators that use the
excitation are not.
"""

from dataclasses import replace

import control
import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import chirp

import loopshape as ls

RATE_HZ, GAIN = 1000.0, 2.0
w = 2.0 * np.pi * 30.0
plant = control.c2d(control.tf([4.0 * np.pi * w**2], [1.0, 0.2 * w, w**2, 0.0]), 1.0 / RATE_HZ)
noise = control.c2d(control.tf([1.0], [1.0 / (2.0 * np.pi * 3.0), 1.0]), 1.0 / RATE_HZ)
S = control.ss(control.feedback(control.tf([1.0], [1.0], 1.0 / RATE_HZ), GAIN * plant))
T = control.ss(control.feedback(GAIN * plant, control.tf([1.0], [1.0], 1.0 / RATE_HZ)))

rng = np.random.default_rng(1)
t_s = np.arange(60_000) / RATE_HZ
n = chirp(t_s, 0.5, t_s[-1], 100.0, phi=-90.0)
d = control.forced_response(noise, t_s, 1.5 * rng.standard_normal(t_s.size)).outputs
y = control.forced_response(T, t_s, n).outputs + control.forced_response(S, t_s, d).outputs
run = ls.Run.from_arrays(u=GAIN * (n - y), y=y, excitation=n, rate_hz=RATE_HZ)
(recording,) = run.recordings
run = replace(run, recordings=(replace(recording, info=replace(recording.info, kind="sweep")),))

# %%
# The same record by three estimators. Segments have frequencies 2 Hz apart and round the resonance off; local fits have
# hundreds of frequencies, each with more noise. The error is that of the complex value, relative to the plant.

figure, (above, below) = plt.subplots(
    2, 1, figsize=(6.5, 5.0), layout="constrained", sharex=True
)
ways = {
    "local fits, reference": {},
    "Welch, reference": {"method": "welch", "resolution_hz": 2.0},
    "Welch, direct": {"method": "welch", "resolution_hz": 2.0, "estimator": "direct"},
}
for (words, how), colour in zip(ways.items(), ("#0072B2", "#009E73", "#D55E00"), strict=True):
    P = ls.frf(run, **how).between(1.0, 80.0)
    true = plant(np.exp(2j * np.pi * P.frequency_hz / RATE_HZ))
    above.loglog(P.frequency_hz, np.abs(P.siso), color=colour, linewidth=1.0, label=words)
    below.loglog(P.frequency_hz, np.abs(P.siso / true - 1.0), color=colour, linewidth=1.0)
f_hz = np.geomspace(1.0, 80.0, 800)
above.loglog(
    f_hz,
    np.abs(plant(np.exp(2j * np.pi * f_hz / RATE_HZ))),
    "k--",
    linewidth=1.0,
    label="truth",
)
above.set(ylabel="|P|")
below.set(xlabel="frequency [Hz]", ylabel="relative error", xlim=(1.0, 80.0))
above.legend()
