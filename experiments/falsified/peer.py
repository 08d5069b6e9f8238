"""The peer: plain least squares, all numbers free; its name is the number that changed most.

It is given what the diagnosis has: recordings, windows, initial states that answer, noise floors, tolerances; and
several starts. A change is measured in tolerances, and by what it does to the outputs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.own.following import Followed
from loopshape.toolbox.gap.own.plant import OwnMachine

SHARE, LATE_MS = 0.05, 1.0  # tolerance of what has none: a share of its scale, a delay
ORDINARY, PLAIN = 1.5, 1.0  # tolerances (as in the package's catalogue), and floors, below which a change is no name
HOLD = 30.0  # floors for one tolerance: of numbers that do each other's work the one that has to move least moves
MOST = 1e4  # floors: a simulation that is further off has run away
ROUNDS = 20  # evaluations a start
SEED, STARTS, SPREAD = 2031, 2, 1.0  # starts, all but the first drawn up to so many tolerances off
STEP = 0.05  # tolerances, for slopes
INSIDE = 0.1  # tolerances, where a number starts that has one sign
SLIDES = 0.01  # of a port's speed, where dry friction changes its sign


class Number(NamedTuple):
    """A number that is free: its name, the move, one tolerance, its ends in tolerances, its value at the start."""

    effect: str
    key: str
    tolerance: float
    low: float = -np.inf
    high: float = np.inf
    start: float = 0.0


@dataclass(frozen=True)
class Problem:
    """What is left of recordings in floors, as a function of changes x (n,) in tolerances."""

    plant: OwnMachine
    parts: Sequence[Followed]
    table: Sequence[Number]
    fixed: Mapping[str, float]

    def moves(self, x: np.ndarray) -> dict[str, float]:
        """The moves of the package."""
        pairs = zip(self.table, x, strict=True)
        return {**self.fixed, **{n.key: n.start + n.tolerance * float(v) for n, v in pairs if v or n.start}}

    def misfit(self, x: np.ndarray) -> np.ndarray:
        """Measured less simulated (values,), initial states answering."""
        return self._joined([self.plant.residuals(f, self.moves(x)) for f in self.parts])

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Slopes (values, n), by steps that are no rounding."""
        near = self.moves(x)

        def beside(y: np.ndarray) -> np.ndarray:
            return self._joined([self.plant.nearby(f, near, self.moves(y)) for f in self.parts])

        base = beside(x)
        return np.stack([(beside(x + row) - base) / STEP for row in STEP * np.eye(x.size)], axis=1)

    def _joined(self, left: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray:
        rows = [
            values / self.plant.floors(f)[name]
            for f, own in zip(self.parts, left, strict=True) for name, values in own.items()
        ]  # fmt: skip
        return np.clip(np.nan_to_num(np.concatenate(rows), nan=MOST), -MOST, MOST)


def least_squares_name(plant: OwnMachine, run: Run, renamed: Mapping[str, str] | None = None) -> dict:
    """An answer in the form of a gap report's: names by their change in tolerances, with sizes and intervals.

    `by_outputs` has the names by what their change does to the outputs. With `renamed`, the names of parameters that
    have no effect of their own, the numbers of actuators and cables are free as well.
    """
    ready, cut, pieces = plant.readied(run, [r.info.name for r in run.recordings if r.info.role == "estimation"])
    assert isinstance(ready, OwnMachine)
    fit, held_out = (
        [ready.prepare(r, cut, None) for r in cut.recordings if (r.info.name in pieces) == chosen]
        for chosen in (True, False)
    )
    table, fixed = numbers(ready, fit, renamed)
    problem, checked = (Problem(ready, parts, table, fixed) for parts in (fit, held_out))
    x = fitted(problem)
    slopes = problem.slopes(x)
    held = np.concatenate([slopes, HOLD * np.eye(x.size)])
    left = np.sqrt(np.mean(problem.misfit(x) ** 2))
    spread = left * np.sqrt(np.diag(np.linalg.pinv(held.T @ held)))
    before, after = (float(np.sqrt(np.mean(checked.misfit(y) ** 2))) for y in (0.0 * x, x))
    felt = np.abs(x) * np.sqrt(np.mean(slopes**2, axis=0))
    answer = named(table, x, spread, np.abs(x), ORDINARY)
    return answer | {"gap": {"before": before, "after": after}, "by_outputs": named(table, x, spread, felt, PLAIN)}


def fitted(problem: Problem) -> np.ndarray:
    """Changes in tolerances (n,) with the least robust sum of squares, the best of some starts."""

    def held(x: np.ndarray) -> np.ndarray:
        return np.concatenate([problem.misfit(x), HOLD * x])

    def slopes(x: np.ndarray) -> np.ndarray:
        return np.concatenate([problem.slopes(x), HOLD * np.eye(x.size)])

    low, high = np.array([(n.low, n.high) for n in problem.table]).T
    first, rng, best = np.where(low == 0.0, INSIDE, 0.0), np.random.default_rng(SEED), None
    size = float(np.median(np.abs(problem.misfit(first)))) + 1.0
    for k in range(STARTS):
        start = np.clip(first + SPREAD * (k > 0) * rng.uniform(-1, 1, first.size), low + INSIDE, high - INSIDE)
        found = least_squares(
            held, start, bounds=(low, high), loss="soft_l1", f_scale=size, jac=slopes, x_scale=1.0, max_nfev=ROUNDS,
        )  # fmt: skip
        best = found if best is None or found.cost < best.cost else best
    assert best is not None
    return np.asarray(best.x)


def named(table: Sequence[Number], x: np.ndarray, spread: np.ndarray, moved: np.ndarray, least: float) -> dict:
    """Names in the order of their change; where the largest is below `least` the verdict is `none`."""
    best: dict[str, dict] = {}
    for n, value, s, own in sorted(zip(table, x, spread, moved, strict=True), key=lambda row: -row[3]):
        low, high = sorted(float(n.start + n.tolerance * (value + k * s)) for k in (-2, 2))
        size = float(n.start + n.tolerance * value)
        row = {"effect": n.effect, "magnitude": size, "unit": "", "interval": (low, high), "moved": float(own)}
        best.setdefault(n.effect, row)
    ranking = list(best.values())
    total = sum(r["moved"] for r in ranking) or 1.0
    for r in ranking:
        r["probability"] = r["moved"] / total
    verdict = ranking[0]["effect"] if ranking[0]["moved"] > least else "none"
    return {"verdict": verdict, "ranking": ranking, "where": {}, "ambiguity_set": []}


def numbers(
    plant: OwnMachine, parts: Sequence[Followed], renamed: Mapping[str, str] | None = None
) -> tuple[list[Number], dict[str, float]]:
    """All numbers that may move, and moves that stay fixed.

    A tolerance that the model does not state is a share of the scale: of a range, of what a sensor reads, for forces of
    the rms of the largest command, for drag and cables of that over the port's speed and travel.
    """
    model, more = plant.model, renamed is not None
    u, y, starts = (np.concatenate([getattr(f, name) for f in parts]) for name in ("u", "y", "start"))
    push = SHARE * float(np.sqrt(np.mean(u**2, axis=0)).max())
    out = []
    for p in model.parameters:
        if p.value or p.range:
            name = p.effect if p.effect != "none" else (renamed or {}).get(p.name, f"parameter_error@{p.name}")
            least = push if name.startswith("force_offset@") else 0.0  # a share of an offset near 0 is no tolerance
            own = p.tolerance * abs(p.value) or SHARE * max(map(abs, p.range or (p.value,)))
            out.append(Number(name, f"change.{p.name}", max(own, least)))
    for k, i in enumerate(model.inputs):
        if i.column:
            at, peak = f"input.{i.name}", float(np.abs(u[:, k]).max())
            out.append(Number(f"actuator_gain_error@{i.name}", f"{at}.gain", i.tolerance or SHARE))
            out.append(Number(f"actuator_delay@{i.name}", f"{at}.delay_ms", LATE_MS, 0.0))
            if more:
                out.append(Number(f"actuator_lag@{i.name}", f"{at}.lag_ms", LATE_MS, 0.0))
                out.append(Number(f"dead_zone@{i.name}", f"{at}.dead", push, 0.0))
                limit = Number(f"actuator_saturation@{i.name}", f"{at}.limit", -SHARE * peak, 0.0, 0.9 / SHARE, peak)
                out.append(limit)
    for k, o in enumerate(model.outputs):
        at, largest = f"output.{o.name}", float(np.abs(y[:, k]).max())
        out.append(Number(f"sensor_gain@{o.name}", f"{at}.gain", SHARE))
        if not more:  # late is late where one actuator and one sensor are: two numbers would share it
            out.append(Number(f"sensor_delay@{o.name}", f"{at}.delay_ms", LATE_MS, 0.0))
        out.append(Number(f"sensor_offset@{o.name}", f"{at}.offset", SHARE * largest))
    taken, fixed = {n.effect for n in out}, {}
    for q in model.ports:
        at = f"port.{q.name}"
        place, speed = (starts[:, model.states.index(s)] for s in (q.position, q.speed))
        fixed[f"{at}.coulomb_speed"] = SLIDES * float(np.std(speed))
        free = [Number(f"coulomb_friction@{q.name}", f"{at}.coulomb", push, 0.0),
                Number(f"viscous_error@{q.name}", f"{at}.viscous", push / float(np.std(speed)))]  # fmt: skip
        if more:
            travel, cable = float(np.ptp(place)), f"cable_stiffness@{q.name}"
            free += [Number(cable, f"{at}.stiffness", push / travel, 0.0),
                     Number(cable, f"{at}.rest", travel, start=float(np.median(place)))]  # fmt: skip
        free.append(Number(f"force_offset@{q.name}", f"{at}.offset", push))
        out += [n for n in free if n.effect not in taken and n.effect.partition("@")[0] not in model.without]
    return out, fixed
