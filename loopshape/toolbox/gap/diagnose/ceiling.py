"""The ceiling: what a nameless force or signal at each place would explain of a gap, judged on what is left out.

A place's push is a sum of shapes over what was measured there (`Shapes` of the plant), each answered by the model by
straight lines; their sizes follow by ridge regression (Hoerl and Kennard 1970), whose weight is the one that predicts
recordings best that were left out. What no such push at a place explains, no name at that place can.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.fitting import weights
from loopshape.toolbox.gap.diagnose.shrink import windows
from loopshape.toolbox.gap.nouns.gap_report import Curve
from loopshape.toolbox.gap.nouns.plant import Shapes, SimulationModel

#: ridge weights that are tried, as shares of a shape's own information
RIDGES = 10.0 ** np.arange(-6.0, 2.1)


@dataclass(frozen=True, eq=False)
class Ceiling:
    """What a nameless push at a place leaves: mean squares (cells,) of recordings left out, and its sizes (k,).

    `left_out` (recordings, k) are the sizes without each recording.
    """

    place: str
    squares: Array
    sizes: Array
    left_out: Array

    @property
    def cost(self) -> float:
        """Sum over cells of log(1 + ms), as of a hypothesis."""
        return float(np.sum(np.log1p(self.squares)))


@dataclass(frozen=True, eq=False)
class Nameless:
    """Ceilings by place, the one that leaves least first, and the shapes they are made of."""

    plant: SimulationModel
    shapes: Shapes
    ceilings: tuple[Ceiling, ...]
    moves: Mapping[str, float]

    @property
    def best(self) -> Ceiling:
        """The place where a nameless push explains most."""
        return self.ceilings[0]

    @property
    def reached(self) -> dict[str, float]:
        """Mean squares that are left, by place."""
        return {c.place: float(c.squares.mean()) for c in self.ceilings}

    def held_out(self, prepared: Sequence[Any], moves: Mapping[str, float]) -> dict[str, Array]:
        """What each place's push leaves of recordings that no fit saw: squares (recordings, paths, windows)."""
        plant = self.plant
        off, floors = [plant.paths(one, moves) for one in prepared], [plant.floors(one).values() for one in prepared]
        pushed, out = [self.shapes.columns(one, self.moves) for one in prepared], {}
        for c in self.ceilings:
            rows = []
            for columns, values, floor in zip(pushed, off, floors, strict=True):
                added, at, parts = columns[c.place] @ c.sizes, 0, []
                for x, noise in zip(values.values(), floor, strict=True):
                    parts.append(windows(x - added[at : at + x.size] / noise))
                    at += x.size
                rows.append(parts)
            out[c.place] = np.array(rows)
        return out

    def curves(self, place: str, moves: Mapping[str, float], explains: float | None = None) -> tuple[Curve, ...]:
        """What acts at a place, by quantity that it is over; 95 % intervals by recordings left out (jackknife).

        `moves` are those of the best named effect, which is drawn over it where it acts there.
        """
        c = next(c for c in self.ceilings if c.place == place)
        out, at, n = [], 0, len(c.left_out)
        points = 121  # curves are drawn at so many places
        for axis in self.shapes.axes[place]:
            k = max(axis.knots.size, 1)
            part = slice(at, at + k)
            at += k
            if not axis.knots.size:
                continue
            x = np.linspace(axis.knots[0], axis.knots[-1], points)
            rows = axis.values(x)
            drawn, value = rows @ c.left_out[:, part].T, rows @ c.sizes[part]
            std = np.sqrt((n - 1.0) / n * np.sum((drawn - drawn.mean(axis=1, keepdims=True)) ** 2, axis=1))
            value = value - value.mean()
            named = self.shapes.named(place, axis.over, x, moves)
            named = None if named is None else named - named.mean()
            ends = value - 2.0 * std, value + 2.0 * std
            units = self.shapes.units(place, axis.over)
            out.append(Curve(place, axis.over, units[1], x, value, *ends, units[0], named, explains))
        return tuple(out)


def nameless(evidence: Evidence, moves: Mapping[str, float], residual: Array) -> Nameless | None:
    """Ceilings of every place of a machine under the moves of its healthy fit; None where it has no shapes."""
    shapes = evidence.plant.shapes(evidence.prepared)
    if shapes is None:
        return None
    weight = weights(evidence.mean_squares(residual))
    pushed = [shapes.columns(p, moves) for p in evidence.prepared]
    columns = {place: np.concatenate([of[place] for of in pushed]) for place in shapes.axes}
    found = [_ceiling(evidence, columns[p], shapes.merged(p), residual, weight, p) for p in shapes.axes]
    return Nameless(evidence.plant, shapes, tuple(sorted(found, key=lambda c: c.cost)), dict(moves))


def _ceiling(
    evidence: Evidence, columns: Array, merged: Sequence[Array], residual: Array, weight: Array, place: str
) -> Ceiling:
    """The sizes that leave least of recordings left out, by each way to merge shapes and each ridge."""
    cells = evidence.cells
    all_a = np.stack([_gram(columns[c.part], c.floor) for c in cells])
    all_b = np.stack([columns[c.part].T @ residual[c.part] / (c.floor**2 * (c.stop - c.start)) for c in cells])
    own = np.array([np.mean((residual[c.part] / c.floor) ** 2) for c in cells])
    of = [np.array([c.recording == name for c in cells]) for name in evidence.recordings]
    best: Ceiling | None = None
    for by in merged:
        a, b = by.T @ all_a @ by, all_b @ by
        for ridge in RIDGES:
            without = [_solved(a, b, np.where(mine, 0.0, weight), ridge) for mine in of]
            squares = np.array(own)
            for mine, sizes in zip(of, without, strict=True):
                squares[mine] += (np.einsum("cij,i,j->c", a[mine], sizes, sizes)) - 2.0 * b[mine] @ sizes
            sizes = by @ _solved(a, b, weight, ridge)
            found = Ceiling(place, np.maximum(squares, 0.0), sizes, np.array(without) @ by.T)
            best = found if best is None or found.cost < best.cost else best
    assert best is not None
    return best


def _gram(columns: Array, floor: float) -> Array:
    scaled = columns / floor
    return np.asarray(scaled.T @ scaled / len(columns))


def _solved(a: Array, b: Array, weight: Array, ridge: float) -> Array:
    """Sizes (k,) by cells' products a (cells, k, k) and b (cells, k), held by a share of their own information."""
    h, g = np.tensordot(weight, a, 1), weight @ b
    own = np.diag(h)
    scale = np.sqrt(np.maximum(own, 1e-12 * max(float(own.max(initial=0.0)), 1e-300)))
    solved = np.linalg.solve(h / np.outer(scale, scale) + ridge * np.eye(len(h)), g / scale)
    return np.asarray(solved / scale)
