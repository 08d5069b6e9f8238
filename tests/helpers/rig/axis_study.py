"""A study for the target in Python: motor axes without a plant, described by the study itself."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from bench_nouns import LoopSetup
from python_target import Board, Target
from python_target_machine import Axes

import loopshape as ls
from loopshape.cli.output import Output
from loopshape.toolbox.gap.noise import start_state
from loopshape.toolbox.rig.described import DescribedRig
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import experiment as experiment_of
from loopshape.toolbox.rig.simulated import plan
from loopshape.toolbox.rig.verbs.machine import ended_early, measure
from loopshape.toolbox.schedules import gain_scheduled, kernel

RATE_HZ = 1000.0
LOOP = """
[[loop]]
name = "axis{k}"
output = "angle{k}_rad"
control = "z{k}_v"
controller = [
  {{ kind = "gain", gain = {gain} }},
  {{ kind = "lead_lag", f1_hz = {corner}, f2_hz = {pole} }},
  {{ kind = "low_pass", order = 1, f_hz = 200.0 }},
]
"""
EXPERIMENT = """
[[experiment]]
name = "{name}"
excites = "axis1"
injection = "{injection}"
{more}
[experiment.excitation]
kind = "multisine"
f_low_hz = 2.0
f_high_hz = 60.0
period_s = {period_s}
periods = {periods}
amplitude_{unit} = {amplitude}
ramp_s = 0.1
crest_iterations = 0
"""


def experiment(
    name: str = "one",
    injection: str = "controller_input",
    unit: str = "rad",
    amplitude: float = 0.02,
    more: str = "",
    period_s: float = 0.5,
    periods: int = 2,
) -> str:
    return EXPERIMENT.format(
        name=name, injection=injection, unit=unit, amplitude=amplitude, more=more, period_s=period_s, periods=periods
    )


def study_text(
    *experiments: str,
    count: int = 1,
    target: Sequence[str] = (),
    angle: str = "low_rad = -3.0, high_rad = 3.0",
    drive: str = "low_v = -40.0, high_v = 40.0",
    point: float = 0.1,
) -> str:
    """A study of `count` axes; `target` are further lines of [target]."""
    axes = range(1, count + 1)
    settings = {"watchdog_ms": "1000", "soft_start_s": "0.0", "settle_s": "0.0"}
    settings |= dict(line.split(" = ", 1) for line in target)
    return "\n".join(
        [
            'format = "loopshape-study/1"',
            'rig = "target"',
            "seed = 3",
            "operating_points = [{ " + ", ".join(f"axis{k}_rad = {point}" for k in axes) + " }]",
            "[target]",
            *(f"{key} = {value}" for key, value in settings.items()),
            "[target.commands]",
            *(f"drive{k}_v = {{ axis{k} = 1.0 }}" for k in axes),
            "[limits]",
            *(f"angle{k} = {{ {angle} }}\ndrive{k} = {{ {drive} }}" for k in axes),
            *(LOOP.format(k=k, gain=8.0 + k, corner=4.0 + k, pole=60.0 + k) for k in axes),
            *(experiments or (experiment(),)),
        ]
    )


def write_study(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def target(count: int = 1, coupling: float = 0.1, **board: object) -> Target:
    return Target(Axes(count, coupling=coupling), Board(**board))  # type: ignore[arg-type]


def measured(study: Path, out: Path, port: str, *, arm: bool = True) -> list[str]:
    """`loopshape measure` without its FRFs: what ended early."""
    return ended_early(measure(study, out, port=port, arm=arm, watch=Output(quiet=True)))


def simulated(study: Path, name: str, count: int = 1, coupling: float = 0.1) -> dict[str, np.ndarray]:
    """The columns that a recording must have: the same machine and controllers in one loop, without any target."""
    read = read_study(study)
    plant = DescribedRig(read.loops)
    planned = next(one for one in plan(read, plant) if one.name == name)
    e = experiment_of(read, plant, planned)
    machine = Axes(count, coupling=coupling)
    machine.noise.state = start_state(e.seed)
    machine.place(e.references[0].tolist())
    loops, controllers = range(count), [controller_of(loop, [one.name for one in e.loops]) for loop in e.loops]
    rows = []
    for k in range(e.samples):
        s, r, n = machine.read(), e.references[k].tolist(), e.injected[k].tolist()
        z = []
        for i in loops:
            x = r[i] - s[i]
            if e.injection == "controller_input":
                x = x + n[i]
            z.append(controllers[i]([*r, *s], x))
        if e.injection == "control":
            z = n
        u = [z[i] + n[i] if e.injection == "plant_input" else z[i] for i in loops]
        rows.append([*r, *n, *z, *s, *u])
        machine.move(u)
    table = np.array(rows)
    kinds = ("r", "n", "z", "s", "u")
    return {f"{kind}{i + 1}": table[:, j * count + i] for j, kind in enumerate(kinds) for i in loops}


def controller_of(loop: LoopSetup, names: list[str]) -> Callable[[list[float], float], float]:
    """From references and outputs of all loops, and this one's error, to its z, tick by tick."""
    if loop.schedule is not None:
        tables = loop.schedule.tables([(name, what) for what in gain_scheduled.Follows for name in names])

        def scheduled_step(signals: list[float], x: float) -> float:
            kernel.follow(tables, np.array(signals))
            return kernel.step(tables, x)

        return scheduled_step
    sections = loop.controller.biquads().tolist()
    state = [[0.0, 0.0] for _ in sections]

    def step(signals: list[float], x: float) -> float:
        for (b0, b1, b2, a1, a2), w in zip(sections, state, strict=True):
            x, w[0], w[1] = section(b0, b1, b2, a1, a2, w, x)
        return x

    return step


def section(b0: float, b1: float, b2: float, a1: float, a2: float, w: list[float], x: float) -> tuple[float, ...]:
    y = b0 * x + w[0]
    return y, b1 * x - a1 * y + w[1], b2 * x - a2 * y


def table(run: Path, name: str, injection: str = "controller_input", count: int = 1) -> dict[str, np.ndarray]:
    """A recording's columns under the names of `simulated`."""
    columns = ls.read(run).recording(name).columns
    unit = "v" if injection == "plant_input" else "rad"
    names = {"r": "r_axis{}_rad", "n": f"n_axis{{}}_{unit}", "z": "z{}_v", "s": "angle{}_rad", "u": "drive{}_v"}
    return {f"{k}{i}": np.asarray(columns[name.format(i)]) for k, name in names.items() for i in range(1, count + 1)}
