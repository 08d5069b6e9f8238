"""Real machines: honest models fitted to recordings by output error in short windows, and what makes one false."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.machine import Model
from loopshape.toolbox.gap.own.plant import OwnMachine

HERE = Path(__file__).parent
DATA = Path(os.environ.get("LOOPSHAPE_DATA", HERE.parents[1] / ".." / "shared" / "data"))
KEPT = HERE / "honest.json"
SEED, STARTS, SPREAD = 2031, 3, 0.3  # of a fit: starts, and by which share they are drawn around the first
DIGITS = 6
EARLY_MS = 6.0

Numbers = Mapping[str, float]
Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Case:
    """One number falsified: `change` of the honest numbers, and the exact `label` (kind@place).

    `size` is what has to be added to the false model, in the catalogue's unit; None where a form has no one size.
    `twins` are names that no recording of the machine tells from it, each with its size.
    """

    name: str
    change: Numbers
    label: str
    size: float | None = None
    twins: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def right(self) -> dict[str, float | None]:
        """Names that are right, with their sizes."""
        return {self.label: self.size, **self.twins}


@dataclass(frozen=True)
class Piece:
    """A stretch of a recording (its columns at `rate_hz`) in one regime."""

    name: str
    rate_hz: float
    columns: Columns
    regime: Mapping[str, float]
    held_out: bool = False


@dataclass(frozen=True)
class Real:
    """A real machine.

    `start` are first guesses of the numbers, `fixed` those that are not fitted, `box` (low, high) by name where not
    from a fiftieth to fifty times the guess. Numbers with a dot (`input.drive.delay_ms`) belong to the mapping of the
    recordings: a delay by which a column is moved, a factor, an offset. `model` makes the simulator of the numbers.
    """

    name: str
    folder: str
    model: Callable[[Numbers], Model]
    pieces: Callable[[], Sequence[Piece]]
    start: Numbers
    cases: Callable[[Numbers], Sequence[Case]]
    fixed: tuple[str, ...] = ()
    box: Mapping[str, tuple[float, float]] | None = None

    @property
    def there(self) -> bool:
        """Whether its recordings are."""
        return (DATA / self.folder).is_dir()


def mapped(piece: Piece, numbers: Numbers) -> Recording:
    """The piece as the model takes it: columns moved by `late.COLUMN` ms (linear between samples), plus `plus.COLUMN`.

    A delay that is part of the honest model is undone here, for a model has none of its own.
    """
    columns = dict(piece.columns)
    for key, value in numbers.items():
        kind, _, column = key.partition(".")
        if kind == "late":
            columns[column] = moved(columns[column], 1e-3 * value * piece.rate_hz)
        elif kind == "plus":
            columns[column] = columns[column] + value
    role = "validation" if piece.held_out else "estimation"
    info = RecordingInfo(
        f"{piece.name}.parquet", "profile", "reference", role=role, operating_point=dict(piece.regime)
    )  # fmt: skip
    return Recording(info, piece.rate_hz, columns)


def moved(values: np.ndarray, ticks: float) -> np.ndarray:
    """Values a number of ticks later, earlier where negative; beyond an end the last value stands."""
    at = np.arange(values.size)
    return np.interp(at - ticks, at, values)


def run_of(machine: Real, numbers: Numbers) -> Run:
    """All pieces of a machine as a run, for a model of these numbers."""
    made = tuple(mapped(p, numbers) for p in machine.pieces())
    return Run(made[0].rate_hz, (), made)


def fitted(machine: Real) -> dict[str, float]:
    """Honest numbers: least squares of the misfit in floors, robust, over the pieces that are not held out.

    The best of some starts drawn around the first guess. A delay is fitted as a move of the package's, of columns that
    are `EARLY_MS` early, so that it may come out below 0.
    """
    start = dict(machine.start)
    free = [n for n in start if n not in machine.fixed]
    plant = OwnMachine(machine.model(start))
    run = run_of(machine, {n: -EARLY_MS if n.startswith("late.") else v for n, v in start.items()})
    ready = [plant.prepare(r, run, None) for r in run.recordings if r.info.role == "estimation"]
    late = {f"late.{i.column}": f"input.{i.name}.delay_ms" for i in plant.model.inputs if i.column}
    scale = np.array([abs(start[n]) or 1.0 for n in free])
    box = [(machine.box or {}).get(n) or sorted((start[n] / 50.0, start[n] * 50.0)) for n in free]
    low, high = np.array(box, dtype=float).T

    def misfit(x: np.ndarray) -> np.ndarray:
        moves = {late.get(n, n): float(v) + EARLY_MS * (n in late) for n, v in zip(free, x * scale, strict=True)}
        rows = []
        for f in ready:
            floors = plant.floors(f)
            rows += [values / floors[k] for k, values in plant.residuals(f, moves).items()]
        return np.clip(np.concatenate(rows), -1e4, 1e4)

    rng, best = np.random.default_rng(SEED), None
    first = np.array([start[n] for n in free])
    for k in range(STARTS):
        own = np.clip(first * (1.0 + SPREAD * (k > 0) * rng.uniform(-1, 1, first.size)), low, high)
        size = float(np.median(np.abs(misfit(own / scale)))) + 1.0
        found = least_squares(
            misfit, own / scale, bounds=(low / scale, high / scale), loss="soft_l1", f_scale=size, diff_step=1e-4,
            max_nfev=40,
        )  # fmt: skip
        again = least_squares(
            misfit, found.x, bounds=(low / scale, high / scale), loss="soft_l1", diff_step=1e-4, max_nfev=20,
            f_scale=float(np.median(np.abs(found.fun))) * 2.0 + 1.0,
        )  # fmt: skip
        spread = float(np.sum(np.log1p(again.fun**2)))
        if best is None or spread < best[0]:
            best = (spread, again.x)
    assert best is not None
    found_by = {n: float(f"{v:.{DIGITS}g}") for n, v in zip(free, best[1] * scale, strict=True)}
    return {n: found_by.get(n, v) for n, v in start.items()}


def honest(machine: Real) -> dict[str, float]:
    """The honest numbers, fitted once and kept."""
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    if machine.name not in kept:
        found = fitted(machine)
        kept = {**(json.loads(KEPT.read_text()) if KEPT.exists() else {}), machine.name: found}
        kept = {name: kept[name] for name in sorted(kept)}
        KEPT.write_text(json.dumps(kept, indent=1) + "\n")
    return dict(kept[machine.name])


def left(machine: Real, numbers: Numbers) -> dict[str, dict[str, float]]:
    """Rms left in floors by output, on the pieces fitted and on those held out."""
    plant, run = OwnMachine(machine.model(numbers)), run_of(machine, numbers)
    out: dict[str, dict[str, float]] = {}
    for role in ("estimation", "validation"):
        rows: dict[str, list[np.ndarray]] = {}
        for r in run.recordings:
            if r.info.role == role:
                f = plant.prepare(r, run, None)
                for output, values in plant.paths(f, {}).items():
                    rows.setdefault(output.split("-> ")[1], []).append(values)
        out[role] = {o: float(np.sqrt(np.mean(np.concatenate(v) ** 2))) for o, v in rows.items()}
    return out


def false(machine: Real, numbers: Numbers, case: Case) -> tuple[Model, Run]:
    """The model with one number changed, and the recordings as it takes them."""
    own = {**numbers, **case.change}
    return machine.model(own), run_of(machine, own)


def tolerant(value: float, tolerance: float) -> float:
    """The tolerance of a number, none where the model does not have it."""
    return tolerance if value else 0.0
