"""Which recordings a diagnosis can use, and what a run cannot tell: reported before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.plant import SimulationModel, Statable

SHORTEST_S = 3.0


def suitable(plant: SimulationModel, run: Run) -> tuple[list[str], list[Recording]]:
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
            "no validation recording: how far the gap shrinks is not known; hold a sweep and a staircase out "
            '(role = "validation"), at other operating points'
        )
    points = {tuple(sorted(r.info.operating_point.items())) for r in estimation}
    if len(points) == 1:
        notes += _one_point(plant, estimation)
    if len(estimation) == 1:
        notes.append("one estimation recording: intervals by leaving recordings out do not exist; record more")
    return notes, usable


def comparable(plant: SimulationModel, run: Run, baseline: Run) -> tuple[list[str], Run]:
    """Notes and the baseline's recordings that can be followed; refuses one that was not recorded as the run was."""
    if not isinstance(plant, Statable):
        raise WrongUseError(
            "a baseline states the floor of a machine of your own", f"the plant {plant.name}",
            "name your model (--model model.toml), or leave the baseline out",
        )  # fmt: skip
    if plant.stated >= plant.units.keys():
        raise WrongUseError(
            f"a baseline states what a good model leaves, and so does leaves of {', '.join(sorted(plant.stated))}",
            "both", "leave one of them out",
        )  # fmt: skip
    lacking = [[c for c in plant.needs if c not in r.columns] for r in baseline.recordings]
    if lacking and all(lacking):
        raise WrongUseError(
            f"a baseline has the columns of the run, in the same units: {', '.join(plant.needs)}",
            f"no {', '.join(lacking[0])} in {baseline.recordings[0].info.file}", "record them on the good machine too",
        )  # fmt: skip
    rates = {r.rate_hz for r in run.recordings}
    if other := [r for r in baseline.recordings if r.rate_hz not in rates]:
        known = ", ".join(f"{rate:g}" for rate in sorted(rates))
        raise WrongUseError(
            "a baseline is recorded at the rate of the run",
            f"{other[0].info.file} at {other[0].rate_hz:g} Hz, the run at {known} Hz",
            "record it at that rate, or bring it to it: loopshape import with resample = true",
        )  # fmt: skip
    notes: list[str] = []
    usable = tuple(r for r in baseline.recordings if _usable(plant, baseline, r, notes))
    if not usable:
        raise BadSignalError(
            f"no recording of the baseline can be followed on {plant.name}", "; ".join(notes) or "no recording",
            f"record at least {SHORTEST_S:g} s of the machine known to be good",
        )  # fmt: skip
    if same := [r.info.file for r in usable for other in run.recordings if _same(plant, r, other)]:
        raise WrongUseError(
            "a baseline is another run than the one to diagnose", f"{same[0]} in both", "name a run of the good machine"
        )
    notes = [f"baseline, {note}" for note in notes] + _livelier(plant, run.recordings, usable)
    return notes, replace(baseline, recordings=usable)


def _livelier(plant: SimulationModel, recordings: Sequence[Recording], baseline: Sequence[Recording]) -> list[str]:
    """Which columns vary far more than on the baseline, whose floor may then be too low."""

    def varying(column: str, of: Sequence[Recording]) -> float:
        return float(np.sqrt(np.mean([np.var(r.column(column)) for r in of if column in r.columns])))

    out = []
    livelier = 1.5  # rms of a column about its mean over that on the baseline
    for c in plant.needs:
        here, there = varying(c, recordings), varying(c, baseline)
        if here > livelier * there > 0.0:
            out.append(
                f"{c} varies {here / there:.2g} times as much as on the baseline: a good model may leave more than "
                "the floor; record the good machine with as much motion"
            )
    return out


def _same(plant: SimulationModel, one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same values."""
    return all(c in other.columns and np.array_equal(one.column(c), other.column(c)) for c in plant.needs)


@runtime_checkable
class Moving(Protocol):
    """A followed plant that can say which positions it was seen at."""

    def stays(self, recordings: Sequence[Recording]) -> Mapping[str, tuple[float, float]]:
        """Positions, by column, that were seen about one point alone, with their range."""


def _one_point(plant: SimulationModel, recordings: Sequence[Recording]) -> list[str]:
    """What recordings at one operating point cannot tell; nothing where positions themselves cover a range."""
    keys = " or ".join(recordings[0].info.operating_point)
    where, differ = "", keys or "operating point"
    if isinstance(plant, Moving):
        stays = plant.stays(recordings)
        if not stays:
            return []
        ranges = [f"{name} from {low:.3g} to {high:.3g}" for name, (low, high) in stays.items()]
        where, differ = f" ({', '.join(ranges)})", " or ".join(stays)
    return [
        f"one operating point{where}: effects that differ only by {differ} stay together in the ambiguity set; "
        "record at two more"
    ]


def _usable(plant: SimulationModel, run: Run, recording: Recording, notes: list[str]) -> bool:
    try:
        fault = _fault(plant, run, recording)
    except BadSignalError as error:
        fault = f"left out: {error}"
    if fault:
        notes.append(f"{recording.info.file}: {fault}" if fault.startswith("left out") else fault)
    return not fault


def _fault(plant: SimulationModel, run: Run, recording: Recording) -> str:
    """What keeps a recording from being used, in a sentence; empty where nothing does."""
    file, missing = recording.info.file, [c for c in plant.needs if c not in recording.columns]
    if missing:
        return f"{file} has no {', '.join(missing)}: it is left out; record them"
    values = {c: recording.column(c) for c in plant.needs}
    seconds = len(values[plant.needs[0]]) / recording.rate_hz
    if seconds < SHORTEST_S:
        return f"{file} lasts {seconds:.2g} s: too short, left out; record at least {SHORTEST_S:g} s"
    if not plant.stays_in_range(recording, run):
        return f"{file} leaves the model's range: it is left out; keep inside what the model describes"
    outputs = {c for loop in run.loops for c in sum_terms(loop.output)} & set(plant.needs)
    saturated = 0.02  # share of samples at a measured signal's ends
    for column in sorted(outputs):
        if np.ptp(values[column]) == 0.0:
            return f"{file}: {column} never moves: a dead sensor, left out"
        stuck = at_its_ends(values[column])
        if stuck > saturated:
            return f"{file}: {column} rests at its end in {stuck:.0%} of the samples: saturated, left out"
    return ""


def at_its_ends(values: Array) -> float:
    """Share of samples in runs of at least ten equal values at the largest or smallest.

    0 where as many such runs lie elsewhere: then it is a coarse sensor and not a saturated one.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1])
    lengths = np.diff(np.concatenate([starts, [values.size]]))
    long = lengths >= 10  # equal samples in a row
    ends = np.isin(values[starts], (values.min(), values.max()))
    there, elsewhere = int(lengths[long & ends].sum()), int(lengths[long & ~ends].sum())
    return there / values.size if there > elsewhere else 0.0
