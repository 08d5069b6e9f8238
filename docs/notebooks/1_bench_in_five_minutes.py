# %% [markdown]
"""
A bench in five minutes
=======================

Twenty seconds of a two-inertia motor bench (University of Tokyo, MIT licence): a multisine from 11 to 250 Hz, repeated
twenty times while the current loop inside was closed. From the table of samples to a controller with a verdict.
"""

# %% [markdown]
# The map says what each column is, in which unit and at which rate; nothing is guessed.

# %%
from pathlib import Path

import loopshape as ls

BENCH = Path("../../examples/motor_bench")
run = ls.formats.read_table(BENCH / "multisine_type_a.parquet", BENCH / "map.toml")
run

# %% [markdown]
# The frequency response, averaged over periods, with the 95 % band of each frequency. The anti-resonance is at
# 53 to 54 Hz and the resonance at 77 Hz, as published for this bench.

# %%
P = ls.frf(run)
ls.plot.frf(P)

# %% [markdown]
# A fourth-order model with delay describes the plant below the lowest measured frequency, where the count of
# encirclements needs it. The recording is so clean that the model leaves more than noise (``sufficient`` is False):
# the check uses the measured response.

# %%
model = ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")
model

# %% [markdown]
# What is required of the loop, and a structure whose parameters are tuned. A pair is the range of a parameter.

# %%
R = ls.Requirements(
    "motor",
    phase_margin_deg=30.0,
    gain_margin_db=5.0,
    sensitivity_peak_db=6.0,
    complementary_peak_db=6.0,
    bandwidth_hz=20.0,
    unstable_poles=0,
)
structure = [
    ls.gain((1.0, 1e5)),
    ls.lead_lag((1.0, 100.0), (10.0, 1000.0)),
    ls.notch((40.0, 120.0)),
    ls.low_pass((30.0, 1000.0), (0.4, 1.5)),
]
C = ls.tune(P, R, structure, fits=[model], starts=2)
C

# %% [markdown]
# The verdict: each requirement at its worst case, with the interval that the data leave.

# %%
v = ls.check(P, C, R, fits=[model])
v

# %%
assert v.outcome is ls.Outcome.PASSED
ls.plot.nichols(P, C, R, verdict=v)

# %% [markdown]
# By hand: with None in place of a file the page of ``shape`` stands in the cell (``pip install 'loopshape[notebook]'``).
# Its controller and requirements are Python's too: move the notch and look at ``w.controller``, or set it and watch.

# %%
w = ls.shape(P, C, R, None, fits=[model])
w

# %%
w.controller, w.check()

# %% [markdown]
# A warning above names a margin that rests on cancelling the resonance: require ``detuning_percent`` to have it kept.
# The next notebook starts from arrays of your own.
