"""Which recordings a diagnosis can use, and what a run cannot tell: said before anything is fitted."""

from __future__ import annotations

import numpy as np

from loopshape.channel import sum_terms
from loopshape.errors import BadSignalError
from loopshape.plant import Followable
from loopshape.recording import Recording
from loopshape.run import Run
from loopshape.units import Array

SHORTEST_S = 3.0
SATURATED = 0.02  # share of samples at a measured signal's ends


def suitable(plant: Followable, run: Run) -> tuple[list[str], list[Recording]]:
    """Notes and the recordings that can be followed; raises BadSignalError where there are none to fit."""
    notes: list[str] = []
    usable = [r for r in run.recordings if _usable(plant, run, r, notes)]
    estimation = [r for r in usable if r.info.role == "estimation"]
    if not estimation:
        why = "; ".join(notes) or "the run has none of role estimation"
        raise BadSignalError(
            f"no recording of this run can be followed on {plant.name}",
            why,
            f"record the columns {', '.join(plant.needs)} for at least {SHORTEST_S:g} s, role estimation",
        )
    if not any(r.info.role == "validation" for r in usable):
        notes.append(
            "no validation recording: how far the gap shrinks cannot be told; hold a sweep and a staircase out "
            '(role = "validation"), at other operating points'
        )
    points = {tuple(sorted(r.info.operating_point.items())) for r in estimation}
    if len(points) == 1:
        notes.append(
            "one operating point: effects that part only by pressure or angle stay together in the ambiguity set; "
            "record at two more angles and another pressure"
        )
    if len(estimation) == 1:
        notes.append("one estimation recording: intervals by leaving recordings out do not exist; record more")
    return notes, usable


def _usable(plant: Followable, run: Run, recording: Recording, notes: list[str]) -> bool:
    file, missing = recording.info.file, [c for c in plant.needs if c not in recording.columns]
    if missing:
        notes.append(f"{file} has no {', '.join(missing)}: it is left out; record them")
        return False
    seconds = len(recording.columns[plant.needs[0]]) / recording.rate_hz
    if seconds < SHORTEST_S:
        notes.append(f"{file} lasts {seconds:.2g} s: too short, left out; record at least {SHORTEST_S:g} s")
        return False
    if not plant.stays_in_range(recording, run):
        notes.append(f"{file} leaves the model's range: it is left out; keep inside what the model describes")
        return False
    for column in (c for loop in run.loops for c in sum_terms(loop.output)):
        stuck = at_its_ends(recording.column(column))
        if stuck > SATURATED:
            notes.append(f"{file}: {column} rests at its end in {stuck:.0%} of the samples: saturated, left out")
            return False
    return True


def at_its_ends(values: Array) -> float:
    """Share of samples in runs of at least ten equal values at the largest or smallest."""
    share = 0.0
    for end in (values.max(), values.min()):
        if values.max() == values.min():
            return 0.0
        there = np.concatenate([[0], (values == end).astype(int), [0]])
        edges = np.flatnonzero(np.diff(there))
        lengths = edges[1::2] - edges[::2]
        share += float(lengths[lengths >= 10].sum()) / values.size
    return share
