# %% [markdown]
"""
Several loops
=============

Two joints, four muscles, one air supply: the four loops of the simulated 2-DoF arm are coupled. Each is excited
in a recording of its own while all are closed; together the recordings give the plant's matrix with its covariance.
"""

# %%
from pathlib import Path
from tempfile import mkdtemp

import loopshape as ls

run = ls.rig.measure(Path("../../examples/arm2/study.toml"), mkdtemp())
run

# %% [markdown]
# The response of each loop with the other three closed is what one loop's recording gives. The matrix takes all four.

# %%
theta1 = ls.frf(run, "theta1")
(P,) = ls.frf_matrices(run)
ls.plot.matrix(P)

# %% [markdown]
# The interaction of both joints, with 95 % bounds from the full covariance: a band is decoupled where every upper bound
# is below the limit, coupled where a lower one is above it, else undecided.

# %%
found = ls.interaction(P, ["theta1", "theta2"])
for one in found.verdicts:
    print(f"{one.band_hz[0]:.2g} to {one.band_hz[1]:.2g} Hz: {one.verdict}")
ls.plot.interaction(found)

# %% [markdown]
# The controllers under which the arm was recorded, checked together: each loop with the others closed, stability of all
# by det(I + L), and the disk margin that all loops have at once.

# %%
own = [loop.controller for loop in run.loops]
asked = [ls.Requirements(c.loop, phase_margin_deg=30.0) for c in own]
verdict = ls.check(P, own, asked, recorded_under=own)
for one in verdict.parts:
    print(one)
(margins,) = verdict.margins.values()
print(f"stable: {margins.stable}; disk margin of all loops at once {margins.disk_margin:.2f}")
