"""The emulated arm under the host of the package, for tests: configured, armed, recorded."""

from __future__ import annotations

from contextlib import contextmanager
from math import inf

import numpy as np
import pytest
from simulated_machines import plant_file

import loopshape as ls
from loopshape.toolbox.rig.emulator import Emulator, compiler, emulated
from loopshape.toolbox.rig.settings import Limit, TargetSettings
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.session import Session
from loopshape.toolbox.rig.target.target import arm, configuration, drive

RANGES = {"theta2_rad": 0.9, "p_a_bar": 1.5, "p_b_bar": 1.5, "u_a_v": 20.0, "u_b_v": 20.0}
COMMANDS = {"u_a_v": {"theta2": 1.0, "p_ab": 1.0}, "u_b_v": {"theta2": -1.0, "p_ab": 1.0}}

#: the same in a study, with the ranges of a running arm
ARM_ON_A_TARGET = """
[target]
watchdog_ms = 5000
soft_start_s = 0.1
settle_s = 0.0
[target.commands]
u_a_v = { theta2 = 1.0, p_ab = 1.0 }
u_b_v = { theta2 = -1.0, p_ab = 1.0 }
[limits]
theta2 = { low_deg = -40.0, high_deg = 40.0 }
p_a = { low_bar = 0.0, high_bar = 1.4 }
p_b = { low_bar = 0.0, high_bar = 1.4 }
u_a = { low_v = -20.0, high_v = 20.0 }
u_b = { low_v = -20.0, high_v = 20.0 }
"""


def settings(**changes):
    """Wide limits, and time enough for a slow machine that runs the tests."""
    limits = {name: Limit(name, -high, high, inf) for name, high in RANGES.items()} | changes.pop("limits", {})
    fields = {"watchdog_ms": 5000, "soft_start_s": 0.1, "settle_s": 0.0}
    return TargetSettings(limits, COMMANDS, **(fields | changes))


def needs_a_compiler():
    """Skip where there is none."""
    try:
        compiler()
    except ls.LoopshapeError as error:
        pytest.skip(str(error))


@contextmanager
def emulator(changes=None, **fields):
    """The port of a running emulator, the arm with these parameters."""
    needs_a_compiler()
    with emulated(Emulator(plant_file(changes), **fields)) as port:
        yield port


def record(port, experiments, **changes):
    """Recordings of the experiments on a target at this port."""
    wanted = settings(**changes)
    with open_link(port, 0) as link:
        session = Session(link)
        one = experiments[0]
        configured = configuration(session.identity, one.loops, wanted, one.rate_hz, {})
        return list(drive(arm(session, wanted, one.loops, configured), experiments))


def excited(arm_experiment, n=3000, injection="controller_input", seed=7, point=(5.0, 1.0), size=1.0):
    """An experiment in which both loops are excited by sines that meet no period of the PWM."""
    t = np.arange(n) / 1000.0
    waves = np.column_stack([np.sin(2 * np.pi * 3.1 * t), np.sin(2 * np.pi * 1.7 * t)])
    sizes = {"controller_input": [0.02, 0.02], "plant_input": [0.03, 0.05], "control": [0.03, 0.02]}[injection]
    injected = size * waves * np.array(sizes)
    return arm_experiment(point, n, injection=injection, injected=injected, seed=seed)
