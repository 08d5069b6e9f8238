# %% [markdown]
"""
A rig
=====

A target is the real-time computer at a machine: it closes the loops at its own rate, keeps the limits, and streams
what it measured. Here the target is an emulator (the reference firmware in C99, compiled on the first call) with the
simulated arm behind it; a serial port or a TCP address of your own target takes its place.
"""

# %%
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import loopshape as ls
from loopshape.io.study import read_study
from loopshape.model import registry
from loopshape.model.arm.emulated import plant_file
from loopshape.rig.emulator import Emulator, emulated
from loopshape.rig.link import open_link
from loopshape.rig.session import Session
from loopshape.rig.simulated import experiment, header, plan
from loopshape.rig.target import arm, configuration, drive

study = read_study(Path("../../examples/rig/study.toml"))
study = replace(study, operating_points=study.operating_points[:1])
model = registry.plant(study.plant)

# %% [markdown]
# Nothing is armed yet: the target says who it is, and the study is compared with what it can do.

# %%
opened = ExitStack()
port = opened.enter_context(emulated(Emulator(plant_file(None))))
session = Session(opened.enter_context(open_link(port, study.target.baud)))
planned = plan(study, model)
wanted = configuration(
    session.identity, planned[0].loops, study.target, study.rate_hz, dict(study.pwm)
)
print(session.identity.board, "emulated" if session.identity.emulated else "a real machine")
for column, limit in study.target.limits.items():
    print(f"{column:10s} {limit}")

# %% [markdown]
# Arming is a step of its own. From here on the machine may move; whatever ends the block early vents it.

# %%
with opened:
    armed = arm(session, study.target, planned[0].loops, wanted)
    recordings = tuple(drive(armed, (experiment(study, model, one) for one in planned)))
run = replace(header(study, model), recordings=recordings)
assert all(r.info.ended_early is None for r in run.recordings)
run

# %% [markdown]
# What was recorded on a target is a run like any other.

# %%
P = ls.frf(run)
ls.plot.frf(P)
