# %% [markdown]
"""
Why the simulation lies
=======================

An arm is recorded whose gas obeys a law that the nominal model does not have. The diagnosis is given the recordings
and not the cause.
"""

# %%
from pathlib import Path
from tempfile import mkdtemp

import loopshape as ls

run = ls.rig.measure(Path("../../examples/arm/gap.toml"), mkdtemp())
run

# %% [markdown]
# The model is driven by the commands and pressures that were measured. Each effect of the catalogue is fitted in each of
# its forms, together with the manufacturing tolerance, and scored by how well recordings are predicted from the others.

# %%
report = ls.gap(run, table=False)
print(report.sentence)
assert report.verdict == "gas_law"

# %% [markdown]
# Where the gap lies, which effect causes it, how far it shrinks on recordings that no fit has used, and how that looks
# in time.

# %%
ls.plot(report)

# %% [markdown]
# An effect is the most probable cause, with others beside it in the ambiguity set where the recordings do not separate
# them. "none" means that these recordings show no gap, and "unknown" that no effect of the catalogue explains it.

# %%
for one in report.ranking[:4]:
    print(f"{one.effect:24s} {one.probability:6.3f}")
