"""
What a limit on the sensitivity peak costs
==========================================

The same structure tuned for the motor bench under one limit after the other: the lower the peak of the sensitivity, the
slower the loop. Each tuning starts at the last one's controller.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import loopshape as ls

BENCH = Path("../../examples/motor_bench")
P = ls.frf(ls.formats.read_table(BENCH / "multisine_type_a.parquet", BENCH / "map.toml"))
model = ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")
(C,), (R,) = (
    ls.read_controllers(BENCH / "controller.toml"),
    ls.read_requirements(BENCH / "requirements.toml"),
)

limits_db, bandwidths_hz = [6.0, 5.0, 4.0, 3.5], []
for limit_db in limits_db:
    asked = replace(R, sensitivity_peak_db=limit_db, bandwidth_hz=None)
    tuned = ls.tune(P, asked, fits=[model], start=C, starts=1)
    C = tuned.controller
    bandwidths_hz.append(tuned.bandwidth_hz)
    print(f"{limit_db:3.1f} dB: {tuned.bandwidth_hz:5.1f} Hz, {tuned.outcome}")

# %%
# A controller is as fast as its requirements allow.

figure, ax = plt.subplots(figsize=(5.5, 3.2), layout="constrained")
ax.plot(limits_db, bandwidths_hz, "o-", color="#0072B2")
ax.set(xlabel="limit on the peak of |S| [dB]", ylabel="bandwidth [Hz]", ylim=(0.0, 40.0))
ax.grid(alpha=0.3)
