"""Which recording of one run answers to which of another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run


@dataclass(frozen=True, eq=False)
class Pair:
    """The same experiment, done twice."""

    real: Recording
    sim: Recording


def check_runs(real: Run, sim: Run) -> tuple[str, ...]:
    """Refuses runs at different rates or without a common loop; gives notes on controllers that differ."""
    if real.rate_hz != sim.rate_hz:
        raise WrongUseError(
            "two runs are compared at one rate",
            f"{real.rate_hz:g} and {sim.rate_hz:g} Hz",
            "import one with resample = true at the rate of the other",
        )
    known = {loop.name: loop for loop in sim.loops}
    common = [loop for loop in real.loops if loop.name in known]
    if not common:
        raise WrongUseError(
            "two runs that share no loop cannot be compared",
            f"loops {_names(real)} and {_names(sim)}",
            "name the loops of both alike in their run.toml",
        )
    apart = [loop.name for loop in common if _differ(loop, known[loop.name])]
    return tuple(
        f"the controllers of loop {name} differ: responses from control to output can be compared, closed-loop time"
        " responses differ for that alone"
        for name in apart
    )


def _differ(one: LoopSetup, two: LoopSetup) -> bool:
    if one.controller is None or two.controller is None:
        return False
    return _runs(one.controller) != _runs(two.controller)


def _runs(controller: Controller) -> tuple[object, ...]:
    """What a controller runs, whatever the rate."""
    return [b.to_table() for b in controller.blocks], controller.prewarp_hz, controller.precision


def _names(run: Run) -> str:
    return ", ".join(loop.name for loop in run.loops) or "none"


def pair_recordings(real: Sequence[Recording], sim: Sequence[Recording]) -> tuple[list[Pair], tuple[str, ...]]:
    """Recordings that are the same experiment, in the real run's order, and a sentence for each left over.

    The same file name pairs two that are alike in kind, injection, excited loop, operating point and settings; what
    is left pairs by those alone, in order.
    """
    by_name = {r.info.name: r for r in sim}
    partner: dict[str, Recording] = {}
    notes = []
    for one in real:
        two = by_name.get(one.info.name)
        if two is not None and (apart := _apart(one.info, two.info)):
            notes.append(f"both runs have a recording {one.info.name}, but they differ in {apart}")
        elif two is not None:
            partner[one.info.name] = two
    taken = {two.info.name for two in partner.values()}
    for one in (r for r in real if r.info.name not in partner):
        fit = next((r for r in sim if r.info.name not in taken and not _apart(one.info, r.info)), None)
        if fit is not None:
            partner[one.info.name] = fit
            taken.add(fit.info.name)
    pairs = [Pair(r, partner[r.info.name]) for r in real if r.info.name in partner]
    notes += [f"{_what(r.info)} of the real run has no counterpart" for r in real if r.info.name not in partner]
    notes += [f"{_what(r.info)} of the simulated run has no counterpart" for r in sim if r.info.name not in taken]
    return pairs, tuple(notes)


def _apart(one: RecordingInfo, two: RecordingInfo) -> str:
    """What separates two experiments, in words; empty where they are alike."""
    words = [
        word
        for word, name in (("kind", "kind"), ("injection", "injection"), ("excited loop", "excites"))
        if getattr(one, name) != getattr(two, name)
    ]
    if not _same(one.operating_point, two.operating_point):
        words.append("operating point")
    if not _same(one.parameters, two.parameters):
        words.append("settings of the rig")
    return " and ".join(words)


def _same(one: Mapping[str, float], two: Mapping[str, float]) -> bool:
    """Whether two tables hold the same numbers."""
    return set(one) == set(two) and all(isclose(one[k], two[k], rel_tol=1e-6, abs_tol=1e-9) for k in one)


def _what(info: RecordingInfo) -> str:
    excited = f" of {info.excites}" if info.excites else ""
    point = ", ".join(f"{k} {v:g}" for k, v in info.operating_point.items())
    return f"recording {info.name} ({info.kind}{excited}{' at ' + point if point else ''})"
