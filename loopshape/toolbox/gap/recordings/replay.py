"""Each recording's own experiment done again on the model: the same references, injected signals and controllers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import LoopshapeError
from loopshape.core.units import Array, deg
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose.evidence import Moves
from loopshape.toolbox.gap.nouns.gap_table import GapTable
from loopshape.toolbox.gap.nouns.plant import SimulationModel
from loopshape.toolbox.gap.two_runs.table import compare


def tables(
    plant: SimulationModel,
    run: Run,
    recordings: Sequence[Recording],
    many: Sequence[Moves],
    say: Callable[[str], None],
    notes: list[str],
) -> tuple[GapTable | None, GapTable | None]:
    """The gap table against the nominal model, and against the model with the effect, replayed in closed loop.

    Where the run cannot be replayed there are none, and `notes` says why.
    """
    loops = tuple(loop for name in plant.loops for loop in run.loops if loop.name == name)
    real = replace(run, loops=loops, recordings=tuple(r for r in recordings if r.info.closed_loop))
    why = _cannot(plant, real)
    if why:
        notes.append(f"no closed-loop table: {why}")
        return None, None
    out: list[GapTable | None] = []
    for moves, name in zip(many[:2], ("nominal model", "model with the effect"), strict=True):
        say(f"closed loop, {name}")
        try:
            sim = replayed(plant, real, moves)
            whole = {r.info.file for r in sim.recordings if r.info.ended_early is None}
            mine = replace(real, recordings=tuple(r for r in real.recordings if r.info.file in whole))
            sim = replace(sim, recordings=tuple(r for r in sim.recordings if r.info.file in whole))
            out.append(compare(mine, sim, bands="octave", real_name="recorded", sim_name=name) if whole else None)
        except LoopshapeError as error:
            notes.append(f"no closed-loop table against the {name}: {error}")
            out.append(None)
    return out[0], out[1]


def _cannot(plant: SimulationModel, run: Run) -> str:
    """Why a run cannot be replayed; empty where it can."""
    if not plant.loops:
        return f"{plant.name} is followed with measured inputs, not driven in closed loop"
    if [loop.name for loop in run.loops] != list(plant.loops):
        return f"{plant.name} has the loops {', '.join(plant.loops)}"
    if any(loop.controller is None or loop.reference is None for loop in run.loops):
        return "a loop has no controller, or no reference"
    if not run.recordings:
        return "no closed-loop recording"
    missing = [r.info.file for r in run.recordings for x in run.loops if x.reference not in r.columns]
    if missing:
        return f"{missing[0]} has no reference"
    nowhere = [r.info.file for r in run.recordings if not r.info.operating_point]
    return f"{nowhere[0]} names no operating point" if nowhere else ""


def replayed(plant: SimulationModel, run: Run, moves: Moves) -> Run:
    """The run's closed-loop recordings done on the model; each starts after a lead at its first references."""
    experiments = [_experiment(run, r, k) for k, r in enumerate(run.recordings)]
    done = plant.simulate(experiments, changes=dict(run.extra.get("parameters", {})) | dict(moves))
    lead = _lead(run)
    cut = [_cut(d, r, lead) for d, r in zip(done, run.recordings, strict=True)]
    return replace(run, recordings=tuple(cut))


def _lead(run: Run) -> int:
    ticks = run.rate_hz / run.pwm.get("frequency_hz", run.rate_hz)
    lead_s = 4.0  # the rig was under control before: so long the model stands at the first references
    return round(round(lead_s * run.rate_hz / ticks) * ticks)


def _experiment(run: Run, recording: Recording, seed: int) -> Experiment:
    lead = _lead(run)

    def signal(column: str | None, hold: bool) -> Array:
        n = len(next(iter(recording.columns.values())))
        values = recording.column(column) if column in recording.columns and column is not None else np.zeros(n)
        return np.concatenate([np.full(lead, values[0] if hold else 0.0), values])

    info = recording.info
    first = {loop.name: recording.column(str(loop.reference))[0] for loop in run.loops}
    return Experiment(
        name=info.name,
        kind=info.kind,
        loops=run.loops,
        rate_hz=run.rate_hz,
        references=np.stack([signal(loop.reference, True) for loop in run.loops], axis=1),
        injected=np.stack([signal(loop.injected, False) for loop in run.loops], axis=1),
        injection=info.injection,
        operating_point=_point(info.operating_point, first),
        excites=info.excites,
        role=info.role,
        closed_loop=True,
        seed=seed,
        **info.settings(),
        pwm=run.pwm,
    )


def _point(stated: Moves, first: Moves) -> dict[str, float]:
    """Where the model stands at first: the stated point with the first references in its place, by name and unit."""
    out = dict(stated)
    for name, value in first.items():
        for key in out:
            if key.startswith(f"{name}_"):
                out[key] = float(deg(value)) if key.endswith("_deg") else float(value)
    return out


def _cut(done: Recording, original: Recording, lead: int) -> Recording:
    columns = {name: values[lead:] for name, values in done.columns.items()}
    if "t_s" in columns and columns["t_s"].size:
        columns["t_s"] = columns["t_s"] - columns["t_s"][0]
    info = replace(original.info, ended_early=done.info.ended_early)
    return Recording(info, original.rate_hz, columns)
