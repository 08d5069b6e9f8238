"""Evidence: what a model with given parameters leaves unexplained of each recording, cell by cell.

A cell is one compared channel of one recording. The plant says how its recordings are followed; nothing here
knows which plant it is.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from loopshape.core.units import Array
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.plant import SimulationModel, Statable
from loopshape.toolbox.gap.tolerances import TOL

Moves = Mapping[str, float]


@dataclass(frozen=True)
class Cell:
    """Place of one channel of one recording in the residual vector, and the noise's rms there."""

    recording: str
    channel: str
    start: int
    stop: int
    floor: float

    @property
    def part(self) -> slice:
        """Its part of the vector."""
        return slice(self.start, self.stop)


@dataclass(eq=False)
class Evidence:
    """Recordings of one role, ready to be followed. `residuals` is the only thing that costs time; it counts itself."""

    plant: SimulationModel
    prepared: Sequence[Any]
    threads: int
    cells: tuple[Cell, ...] = ()
    evaluations: int = 0
    known: dict[tuple[tuple[str, float], ...], Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        plant: SimulationModel,
        run: Run,
        names: Sequence[str],
        periodic_s: float,
        threads: int | None = None,
        brief_s: float = float("inf"),
    ) -> Evidence:
        """Evidence of the recordings named: `periodic_s` of those that repeat themselves, `brief_s` of the others."""
        chosen = [run.recording(n) for n in names]
        longest = [min(brief_s, max(periodic_s, r.info.period_s or float("inf"))) for r in chosen]
        prepared = [plant.prepare(r, run, s if np.isfinite(s) else None) for r, s in zip(chosen, longest, strict=True)]
        evidence = cls(plant, prepared, threads or os.cpu_count() or 1)
        evidence.cells = _cells(prepared, plant, [plant.residuals(p, {}) for p in prepared])
        return evidence

    @property
    def recordings(self) -> list[str]:
        """Names of its recordings, in order."""
        return list(dict.fromkeys(c.recording for c in self.cells))

    @property
    def least(self) -> Array:
        """Mean squares (cells,) below which nothing is left to explain; 0 where the floor is noise, and not known."""
        return least(self.plant, [c.channel for c in self.cells])

    @property
    def quiet(self) -> float:
        """What sum log(1 + ms) over the cells is where only noise is left."""
        return len(self.cells) * float(np.log(2.0))

    def residuals(self, many: Sequence[Moves]) -> list[Array]:
        """Residual vectors (n,) for each set of moved parameters, all recordings and sets in parallel."""
        keys = [tuple(sorted(moves.items())) for moves in many]
        new = [k for k in dict.fromkeys(keys) if k not in self.known]
        tasks = [(p, dict(k)) for k in new for p in self.prepared]
        self.evaluations += len(new)
        with ThreadPoolExecutor(self.threads) as pool:
            parts = list(pool.map(lambda task: self.plant.residuals(*task), tasks))
        width = len(self.prepared)
        for j, key in enumerate(new):
            rows = parts[j * width : (j + 1) * width]
            self.known[key] = np.concatenate([values for row in rows for values in row.values()])
        out = [self.known[k] for k in keys]
        remembered = 64
        while len(self.known) > remembered:
            self.known.pop(next(iter(self.known)))
        return out

    def nearby(self, near: Moves, many: Sequence[Moves]) -> list[Array]:
        """Residual vectors for moves beside `near`: what a first look needs.

        A plant that knows no short cut follows each whole.
        """
        short = getattr(self.plant, "nearby", None)
        if short is None:
            return self.residuals(many)
        self.evaluations += len(many)

        def rows(prepared: Any) -> list[dict[str, Array]]:
            return [short(prepared, near, moves) for moves in many]

        with ThreadPoolExecutor(self.threads) as pool:
            parts = list(pool.map(rows, self.prepared))
        return [np.concatenate([x for part in parts for x in part[k].values()]) for k in range(len(many))]

    def mean_squares(self, residual: Array) -> Array:
        """Mean square of each cell relative to its noise floor's, (cells,)."""
        return np.array([np.mean((residual[c.part] / c.floor) ** 2) for c in self.cells])


def least(plant: SimulationModel, channels: Sequence[str]) -> Array:
    """Mean squares (cells,) below which nothing is left to explain, by the cells' channels.

    What a good model leaves has a form that names would take up, and differs from recording to recording: up to
    `smallest_gap` floors it is no evidence. 0 where the floor is noise, which no name takes up.
    """
    stated = plant.stated if isinstance(plant, Statable) else frozenset[str]()
    return np.array([TOL.smallest_gap**2 if channel in stated else 0.0 for channel in channels])


def _cells(prepared: Sequence[Any], plant: SimulationModel, rows: Sequence[Mapping[str, Array]]) -> tuple[Cell, ...]:
    out: list[Cell] = []
    at = 0
    for p, row in zip(prepared, rows, strict=True):
        floors = plant.floors(p)
        for channel, values in row.items():
            out.append(Cell(p.name, channel, at, at + values.size, floors[channel]))
            at += values.size
    return tuple(out)
