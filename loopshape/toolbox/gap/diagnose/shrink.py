"""How far: the gap on recordings that no fit has seen, before and after, with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np

from loopshape.core.units import Array
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose.evidence import Moves
from loopshape.toolbox.gap.nouns.gap_report import BudgetPart, BudgetStep, Shrink, Submodel
from loopshape.toolbox.gap.nouns.plant import SimulationModel
from loopshape.toolbox.gap.tolerances import TOL

METRIC = "rms over the submodels' paths of measured less simulated outputs, each relative to its noise floor"
WINDOWS = 8  # a recording is cut into so many for the bootstrap
DRAWS, SEED = 2000, 1


@dataclass(frozen=True, eq=False)
class Levels:
    """Mean squares relative to the noise floor (recordings, paths, windows) of some recordings under one model."""

    names: tuple[str, ...]
    roles: tuple[str, ...]
    paths: tuple[str, ...]
    squares: Array

    @property
    def size(self) -> float:
        """Root of the mean over all of them."""
        return float(np.sqrt(self.squares.mean()))


def levels(plant: SimulationModel, run: Run, recordings: Sequence[Recording], many: Sequence[Moves]) -> list[Levels]:
    """Levels under each set of moved parameters."""
    prepared = [plant.prepare(r, run, None) for r in recordings]
    with ThreadPoolExecutor() as pool:
        rows = list(pool.map(lambda task: plant.paths(*task), [(p, m) for m in many for p in prepared]))
    names, roles = tuple(r.info.name for r in recordings), tuple(r.info.role for r in recordings)
    out = []
    for k in range(len(many)):
        mine = rows[k * len(prepared) : (k + 1) * len(prepared)]
        squares = np.array([[windows(values) for values in row.values()] for row in mine])
        out.append(Levels(names, roles, tuple(mine[0]), squares))
    return out


def chosen(of: Levels, role: str) -> Levels:
    """The recordings of one role."""
    mine = [k for k, r in enumerate(of.roles) if r == role]
    return Levels(tuple(of.names[k] for k in mine), (role,) * len(mine), of.paths, of.squares[mine])


def windows(values: Array) -> Array:
    """Mean squares of WINDOWS stretches (WINDOWS,); numbers too large for the model's range count as very large."""
    squares = np.minimum(np.nan_to_num(values, nan=_MOST, posinf=_MOST, neginf=-_MOST) ** 2, _MOST**2)
    return np.array([part.mean() for part in np.array_split(squares, WINDOWS)])


_MOST = 1e4


def shrink_of(before: Array, after: Array) -> float | None:
    """(before - after) / (before - 1) of gap sizes, None where there is hardly a gap."""
    b, a = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
    return None if b < TOL.smallest_gap else (b - a) / (b - 1.0)


def summary(
    before: Levels, after: Levels, of: str | None, rival: tuple[str, Levels] | None, files: Sequence[str]
) -> Shrink:
    """The gap before and with an effect `of` (None: no effect) with the shrink's interval."""
    return Shrink(
        metric=METRIC,
        before=before.size,
        after=after.size,
        shrink=shrink_of(before.squares, after.squares),
        interval=interval_of(before.squares, after.squares),
        recordings=tuple(files),
        rival=rival[0] if rival else None,
        rival_after=rival[1].size if rival else None,
        of=of,
    )


def interval_of(before: Array, after: Array) -> tuple[float, float] | None:
    """95 % interval of the shrink: a cluster bootstrap over recordings, then windows; None where there is no gap."""
    if shrink_of(before, after) is None:
        return None
    rows, parts = _picks(before.shape[0], before.shape[2])
    b, a = (np.sqrt(x.mean(axis=1)[rows[:, :, None], parts].mean(axis=(1, 2))) for x in (before, after))
    known = (b - a)[b >= TOL.smallest_gap] / (b - 1.0)[b >= TOL.smallest_gap]
    return float(np.percentile(known, 2.5)), float(np.percentile(known, 97.5))


@cache
def _picks(n: int, w: int) -> tuple[np.ndarray, np.ndarray]:
    """Recordings (DRAWS, n) of n and windows (DRAWS, n, w) of w that the bootstrap draws, always the same."""
    rng, rows, parts = np.random.default_rng(SEED), np.empty((DRAWS, n), int), np.empty((DRAWS, n, w), int)
    for k in range(DRAWS):
        parts[k] = rng.integers(0, w, (n, w))
        rows[k] = [int(rng.integers(0, n)) for _ in range(n)]
    return rows, parts


def budget(before: Array, steps: Sequence[tuple[BudgetPart, tuple[str, ...], Array]]) -> tuple[BudgetStep, ...]:
    """Where a gap goes: mean squares (recordings, paths, windows) before, and with what each step adds."""
    floor = BudgetStep(BudgetPart.FLOOR, (), 1.0, None if shrink_of(before, before) is None else 1.0)
    first = BudgetStep(BudgetPart.BEFORE, (), float(np.sqrt(before.mean())), shrink_of(before, before))
    added = (
        BudgetStep(part, of, float(np.sqrt(x.mean())), shrink_of(before, x), interval_of(before, x))
        for part, of, x in steps
    )
    return (first, *added, floor)


def submodels(before: Levels, after: Levels | None, rival: Levels | None) -> list[Submodel]:
    """One row a recording and path."""

    def size(of: Levels | None, k: int, j: int) -> float | None:
        return None if of is None else float(np.sqrt(of.squares[k, j].mean()))

    return [
        Submodel(name, before.roles[k], path, size(before, k, j) or 0.0, size(after, k, j), size(rival, k, j))
        for k, name in enumerate(before.names)
        for j, path in enumerate(before.paths)
    ]
