# %% [markdown]
"""
Your own arrays
===============

A recording need not come from a file. Three arrays are enough: what the controller put out, what the sensor measured,
and what was injected. Here a known plant plays the machine, so that the answer can be compared with the truth.
"""

# %%
import control
import numpy as np

import loopshape as ls

RATE_HZ = 1000.0
w = 2.0 * np.pi * 8.0
plant = control.c2d(control.tf([w**2], [1.0, 0.8 * w, w**2]), 1.0 / RATE_HZ)

# %% [markdown]
# Two minutes in closed loop under a gain of 0.5: noise is injected at the controller's input and the sensor adds noise
# of its own.

# %%
rng = np.random.default_rng(3)
n = rng.standard_normal(120_000)
t_s = np.arange(n.size) / RATE_HZ
closed = control.feedback(control.tf([0.5], [1.0], 1.0 / RATE_HZ), plant)
u = control.forced_response(closed, t_s, n).outputs
y = control.forced_response(plant, t_s, u).outputs + 1e-3 * rng.standard_normal(n.size)

# %% [markdown]
# The excitation is what makes the estimate right under feedback: without it the ratio of output to input is pulled
# towards the inverse of the controller wherever noise goes round the loop.

# %%
run = ls.Run.from_arrays(u=u, y=y, excitation=n, rate_hz=RATE_HZ)
P = ls.frf(run)
ls.plot.frf(P)

# %% [markdown]
# The error of the estimate in its own standard deviations, over the valid band: one where the stated covariance is
# right.

# %%
valid = P.between(1.0, 100.0)
truth = plant(np.exp(2j * np.pi * valid.frequency_hz / RATE_HZ))
error = np.abs(valid.siso - truth) / np.sqrt(valid.variance[:, 0, 0])
rms = float(np.sqrt(np.mean(error**2)))
assert 0.6 < rms < 1.4
rms

# %% [markdown]
# From the response to a controller and a verdict.

# %%
R = ls.Requirements(
    phase_margin_deg=45.0, sensitivity_peak_db=6.0, unstable_poles=0, integrators=0
)
C = ls.tune(P, R, [ls.gain(), ls.lead_lag(), ls.pi()], starts=4)
v = ls.check(P, C, R)
assert v.outcome is ls.Outcome.PASSED
v

# %%
ls.plot.nichols(P, C, R, verdict=v)

# %% [markdown]
# A complex response from elsewhere goes the same way. Its error is stated once, as a standard deviation, relative or
# not, as a covariance, or by the coherence and the number of averages. Systems of python-control are taken too.

# %%
f_hz = np.geomspace(0.2, 400.0, 200)
exact = ls.FRF.from_control(plant, f_hz)
measured = ls.FRF.from_arrays(f_hz, exact.siso, relative_std=0.02, rate_hz=RATE_HZ)
print(ls.check(measured, C, R))
print(ls.to_control(measured).frdata.shape)
