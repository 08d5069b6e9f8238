# %% [markdown]
"""
A rig
=====

A target is the real-time computer at a machine: it closes the loops at its own rate, keeps the limits, and streams
what it measured. Here the target is an emulator (the reference firmware in C99, compiled on the first call) with the
simulated arm behind it; a serial port or a TCP address of your own target takes its place.
"""

# %% [markdown]
# The study says what is recorded and which limits are kept. An emulator on a busy computer gets a longer watchdog than the
# 250 ms of a machine.

# %%
from pathlib import Path
from tempfile import mkdtemp

import loopshape as ls

folder = Path(mkdtemp())
study = folder / "study.toml"
given = Path("../../examples/rig/study.toml").read_text()
study.write_text(given.replace("watchdog_ms = 250", "watchdog_ms = 5000"))

# %% [markdown]
# Without ``arm`` nothing moves: the target is asked who it is, the study is compared with what it can do, and that is
# refused in a sentence.

# %%
with ls.rig.emulator() as port:
    try:
        ls.rig.measure(study, folder / "run", port=port)
    except ls.LoopshapeError as refused:
        print(refused)

# %% [markdown]
# Arming is explicit. From here on the machine may move; whatever ends the measurement early vents it, and
# every finished recording is kept.

# %%
with ls.rig.emulator() as port:
    run = ls.rig.measure(study, folder / "run", port=port, arm=True)
assert all(r.info.ended_early is None for r in run.recordings)
run

# %% [markdown]
# What was recorded on a target is a run like any other.

# %%
P = ls.frfs(run)
ls.plot.frf(P[0])
