"""Plants with their frequencies shifted, as operating points of a tuning: a controller that holds there stands it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.disturbance import Disturbance
from loopshape.loop.detuning import worst_shift
from loopshape.loop.loop import Loop
from loopshape.loop.shifted import stretched
from loopshape.loop.verdict import verdict_on

#: copies nearer to each other than this share of what is required are one
BESIDE = 0.15
#: an end that does not hold goes farther out first, up to so many times what is required
FARTHEST = 1.1


@dataclass(frozen=True, order=True)
class Copy:
    """Operating point `index` with its frequencies `percent` off."""

    index: int
    percent: float


def copies_for(requirements: Requirements, points: int) -> tuple[Copy, ...]:
    """Each operating point as it is, and where a detuning margin is required both ends of it."""
    # plants are shifted by so many times what is required, to leave the check's own reading of intervals some room
    room = 1.03
    end = room * (requirements.detuning_percent or 0.0)
    return tuple(Copy(k, x) for k in range(points) for x in ((0.0, -end, end) if end else (0.0,)))


def shifted_loops(loops: Sequence[Loop], copies: Sequence[Copy]) -> dict[str, Loop]:
    """The loops of some copies by their names; one that is not shifted keeps its own."""
    out = {}
    for one in copies:
        loop = loops[one.index]
        name = loop.plant.recording or f"frf {one.index + 1}"
        if one.percent:
            name = f"{name} at {one.percent:+.3g} %"
            loop = stretched(loop, one.percent, name)
        out[name] = loop
    return out


def shifted_verdict(
    loops: dict[str, Loop],
    controller: Controller,
    asked: Requirements,
    points: Sequence[int] | None = None,
    disturbances: Mapping[str, Disturbance] | None = None,
) -> Verdict:
    """The verdict on a controller at all copies or some, each held against every limit but the detuning margin.

    `disturbances` tell the rms of the error by the copies' names.
    """
    names = list(loops) if points is None else [list(loops)[k] for k in points]
    mine = {name: replace(loops[name], controllers=(controller,)) for name in names}
    disturbed = {name: one for name, one in (disturbances or {}).items() if name in mine}
    return verdict_on(mine, replace(asked, detuning_percent=None), detuned=False, disturbances=disturbed)[0]


def closer(
    copies: Sequence[Copy],
    asked: Requirements,
    loops: Sequence[Loop],
    controller: Controller,
    requirements: Requirements,
    verdict: Verdict,
) -> tuple[tuple[Copy, ...], Requirements]:
    """More copies and closer limits for the operating points whose detuning margin does not pass.

    Each brings its worst shift. Where a copy stands there already, `check` reads it closer (between lines, or with
    another bias): an end goes a little farther out, and else what is missed is added to the limits `asked` of all.
    """
    required, out = requirements.detuning_percent or 0.0, list(copies)
    limits: dict[str, float] = {}
    for k, (loop, margins) in enumerate(zip(loops, verdict.margins.values(), strict=True)):
        found = margins.detuning
        if found is None or found.interval_percent[0] >= required:
            continue
        own = requirements.of(loop.plant.operating_point)
        percent, missed = worst_shift(replace(loop, controllers=(controller,)), margins, own, required)
        near = [one for one in copies if one.index == k and abs(one.percent - percent) < BESIDE * required]
        nearest = max((abs(one.percent) for one in near), default=0.0)
        if not near:
            out.append(Copy(k, percent))
            continue
        if required <= nearest < FARTHEST * required:
            out = [one for one in out if one not in near]
            out.append(Copy(k, float(np.copysign(min(1.1 * nearest, FARTHEST * required), percent))))
            continue
        for name, limit in missed.items():
            more = limit - getattr(own, name)
            before = limits.get(name, 0.0)
            limits[name] = more if abs(more) > abs(before) else before
    return tuple(sorted(out)), asked.moved(limits)
