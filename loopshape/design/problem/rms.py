"""Rows of the rms of the error that a disturbance makes: root of the sum over frequencies of its power in open loop
times |S|².

Between the lines of the problem |S|² is straight in ln f. Below the first line it falls as the integrators of the loop
make it, above the last one it is 1. What `check` reads otherwise is made up for as with every limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from loopshape.core.units import Array
from loopshape.data.control.loop import Loop
from loopshape.data.signal.disturbance import Disturbance
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.problem import Opened, Problem
from loopshape.design.problem.rows import DenseRows, Tighten, scaled, wished
from loopshape.loop.stability.continued import continued

NAME = "error_rms"


@dataclass(frozen=True, eq=False)
class _OnLines:
    """Mean square of the error at each point: `power` (nf,) times |S|² on the flat lines, and `above` (points,)."""

    power: Array
    above: Array


_ON_LINES: WeakKeyDictionary[Problem, _OnLines] = WeakKeyDictionary()


def rms_rows(e: Evaluation, tighten: Tighten) -> Iterator[DenseRows]:
    """The room under a limit of the rms at each operating point whose disturbance is known."""
    p = e.p
    known = np.flatnonzero([one is not None for one in p.opened])
    if NAME not in p.limits or not known.size:
        return
    if p not in _ON_LINES:
        _ON_LINES[p] = _on_lines(p)
    on = _ON_LINES[p]
    each = on.power * np.exp(2.0 * e.ln_S)
    total = on.above + np.bincount(p.owner, weights=each, minlength=p.points)
    room = scaled(NAME, wished(p, NAME, tighten)) - 0.5 * np.log(np.maximum(total, 1e-300))
    pull = np.zeros((p.points, p.unique_f.size), dtype=complex)
    np.add.at(pull, (p.owner, p.line), each * e.L / (1.0 + e.L) / np.maximum(total, 1e-300)[p.owner])
    largest = np.array([a + each[a:b].argmax() for a, b in zip(p.first[:-1], p.first[1:], strict=True)])
    columns = np.arange(p.unique_f.size)
    yield DenseRows(
        NAME, room[known], largest[known], known, lambda: np.real(pull[known] @ p.slopes(e.values, columns).T)
    )


def _on_lines(p: Problem) -> _OnLines:
    power, above = np.zeros(p.f.size), np.zeros(p.points)
    for k, one in enumerate(p.opened):
        if one is not None:
            a, b = p.first[k] + p.led[k], p.first[k + 1]
            power[a:b], above[k] = _shared(p.f[a:b], one, int(p.integrators[k]))
    return _OnLines(power, above)


def _shared(lines: Array, one: Opened, integrators: int) -> tuple[Array, float]:
    """What each line (n,) has of a spectrum, and what lies above the last."""
    f, power = one
    out = np.zeros(lines.size)
    low, high = f < lines[0], f > lines[-1]
    out[0] += float(power[low] @ (f[low] / lines[0]) ** (2 * max(integrators, 0)))
    f, inside = f[~low & ~high], power[~low & ~high]
    k = np.clip(np.searchsorted(lines, f, side="right") - 1, 0, max(lines.size - 2, 0))
    share = np.log(f / lines[k]) / np.log(lines[k + 1] / lines[k])
    np.add.at(out, k, (1.0 - share) * inside)
    np.add.at(out, k + 1, share * inside)
    return out, float(power[high].sum())


def opened(loop: Loop, disturbance: Disturbance | None, rate_hz: float) -> Opened | None:
    """Frequencies (n,) and power (n,) of what disturbs a loop, as it would be with the loop open; None if unknown."""
    if disturbance is None:
        return None
    rows = (disturbance.frequency_hz > 0.0) & (disturbance.frequency_hz < 0.5 * rate_hz)
    f, power = disturbance.frequency_hz[rows], disturbance.power[rows]
    if disturbance.held_by is None:
        return f, power
    plant = loop.plant if loop.raw is None else loop.raw
    P = continued(plant, f, loop.integrators or 0).response
    return f, power * np.abs(1.0 + disturbance.held_by.response(f) * P) ** 2
