"""The next experiment: of what the rig can do within its limits, what separates two fitted hypotheses most.

Every candidate is done on the model under both hypotheses in closed loop, and once more under the first with other
noise. Its separation is the rms difference of the outputs over the rms difference that noise alone makes; 1 parts
nothing. It is an upper bound: neither hypothesis is fitted anew to what the other one gives.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from loopshape.core.errors import LoopshapeError
from loopshape.core.units import Array, rad
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.data.signal.experiment import Experiment, LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose.evidence import Moves
from loopshape.toolbox.gap.nouns.gap_report import Proposal
from loopshape.toolbox.gap.nouns.plant import Plant
from loopshape.toolbox.gap.recordings.probing import Habits, habits, sampled
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.excitation.setpoints import Staircase
from loopshape.toolbox.rig.study import ExperimentTemplate, Study

PERIOD_S, RAMP_S, LEAD_S, PERIODS = 10.0, 1.0, 1.0, 2
STAIR_S = (1.0, 4.0, 7.0, 10.0)
SEEDS = (11, 12)
MOST_CLIPPED = 0.02  # share of samples in which the PWM may be saturated

Point = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Candidate:
    """An experiment that might be done: its template at a point, and how large it is in words."""

    template: ExperimentTemplate
    point: Point
    what: str


def propose(
    plant: Plant, run: Run, first: tuple[str, Moves], second: tuple[str, Moves], threads: int | None = None
) -> Proposal | None:
    """The candidate that separates two hypotheses (name, moved parameters) most; None where none can be done.

    A candidate that leaves the range, or saturates the PWM more than the run did, under either hypothesis is dropped.
    None also where a loop has no controller or reference: then the rig cannot be driven on the model.
    """
    if (
        first[0] == second[0]
        or not run.recordings
        or any(loop.controller is None or loop.reference is None for loop in run.loops)
    ):
        return None
    own = dict(run.extra.get("parameters", {}))
    many = (own | dict(first[1]), own | dict(second[1]))
    try:
        tried = [(c, e) for c in candidates(plant, run, many) if (e := experiment(run, c)) is not None]
        most = max([MOST_CLIPPED, *(clipped(r) for r in run.recordings)])
        values = separations(plant, [e for _, e in tried], many, most, threads)
    except LoopshapeError:  # a recording that does not tell how it was made, a plant that cannot do it
        return None
    good = sorted((k for k in range(len(tried)) if values[k] > 0.0), key=lambda k: -values[k])
    if not good:
        return None
    chosen = [tried[good[0]][0]]
    if chosen[0].template.excitation is None:  # then `measure` would have no FRF to estimate
        chosen += [tried[k][0] for k in good if tried[k][0].template.excitation is not None][:1]
    return _proposal(plant, run, chosen, (first[0], second[0]), values[good[0]])


def candidates(plant: Plant, run: Run, many: Sequence[Moves]) -> list[Candidate]:
    """Multisines and staircases of each loop, open-loop pulses if the run has some, at points that all models hold."""
    usual = habits(run)
    return [
        Candidate(template, point, what)
        for k, point in enumerate(points(plant, run, many))
        for template, what in _templates(run, usual, point, pulses=k < 2)
    ]


def points(plant: Plant, run: Run, many: Sequence[Moves]) -> list[dict[str, float]]:
    """The run's operating points, then a few others: the corners of their box farthest from all of them."""
    own: list[dict[str, float]] = []
    for p in (dict(r.info.operating_point) for r in run.recordings):
        if p not in own and (not own or p.keys() == own[0].keys()) and _stands(plant, p, many):
            own.append(p)
    if not own:
        return []
    spans = {key: _span([p[key] for p in own]) for key in own[0]}
    corners = [dict(zip(spans, values, strict=True)) for values in product(*spans.values())]

    def far(corner: Point) -> float:
        return min(sum(((corner[k] - p[k]) / max(spans[k][-1] - spans[k][0], 1e-9)) ** 2 for k in spans) for p in own)

    others = sorted((c for c in corners if c not in own and _stands(plant, c, many)), key=far, reverse=True)
    own_points, other_points = 4, 2
    return own[:own_points] + others[:other_points]


def _span(values: Sequence[float]) -> tuple[float, ...]:
    """Least and largest; a fifth to both sides of a single value."""
    low, high = min(values), max(values)
    return (low, high) if high > low else tuple(sorted({0.8 * low, 1.2 * low}))


def _stands(plant: Plant, point: Point, many: Sequence[Moves]) -> bool:
    try:
        for moves in many:
            plant.check_operating_point(point, moves)
    except LoopshapeError:
        return False
    return True


def _templates(run: Run, usual: Habits, point: Point, *, pulses: bool) -> Iterator[tuple[ExperimentTemplate, str]]:
    """What to do at one operating point, with the amplitude in words."""
    for loop, (amplitude, injection, band) in usual.injected.items():
        for share in (0.4, 1.0, 2.0):  # of the run's own amplitudes
            signal = Multisine(*band, PERIOD_S, share * amplitude, PERIODS, ramp_s=RAMP_S, seed=1)
            name = f"next-multisine-{loop}"
            made = ExperimentTemplate(name, "multisine", injection, loop, signal, lead_s=LEAD_S)
            yield made, f"a multisine of {loop} at {_times(share)}"
    stair_shares = (0.4, 1.0)
    for loop, size in usual.moved.items():
        rest = _reference(run.loop(loop), point)
        if rest is None:
            continue
        for share in stair_shares:
            values = tuple(rest + share * size * k for k in (1.0, 0.0, -1.0, 0.0))
            made = ExperimentTemplate(
                f"next-staircase-{loop}", "staircase", "reference", references={loop: Staircase(STAIR_S, values)},
                duration_s=STAIR_S[-1] + 3.0,
            )  # fmt: skip
            yield made, f"a slow staircase of {loop} at {_times(share)}"
    for loop, (level, width_s) in usual.driven.items() if pulses else ():
        signal_ = Staircase((0.5, 0.5 + width_s, 2.0, 2.0 + width_s), (level, 0.0, -level, 0.0))
        made = ExperimentTemplate(
            f"next-pulses-{loop}", "open_loop", "control", control={loop: signal_}, duration_s=4.0
        )  # fmt: skip
        yield made, f"two pulses of {loop} in open loop at the run's own height"


def _times(share: float) -> str:
    return "the run's own amplitude" if share == 1.0 else f"{share:g} times the run's own amplitude"


def _reference(loop: LoopSetup, point: Point) -> float | None:
    """The loop's reference at an operating point, by the key that begins with its name; None where there is none."""
    key = next((k for k in point if k.startswith(f"{loop.name}_")), None)
    return None if key is None else float(rad(point[key])) if key.endswith("_deg") else float(point[key])


def experiment(run: Run, candidate: Candidate) -> Experiment | None:
    """The candidate with its signals, periodic ones for one period; None where they cannot be made."""
    template, rest = candidate.template, [_reference(loop, candidate.point) for loop in run.loops]
    if any(value is None for value in rest):
        return None
    try:
        references, injected = sampled(run, template, np.array(rest, dtype=float))
    except LoopshapeError:
        return None
    return Experiment(
        name=template.name,
        kind=template.kind,
        loops=run.loops,
        rate_hz=run.rate_hz,
        references=references,
        injected=injected,
        injection=template.injection,
        operating_point=dict(candidate.point),
        excites=template.excites,
        closed_loop=template.injection != "control",
        seed=SEEDS[0],
        pwm=run.pwm,
    )


def separations(
    plant: Plant, experiments: Sequence[Experiment], many: Sequence[Moves], most_clipped: float, threads: int | None
) -> list[float]:
    """Rms difference of the outputs over what noise alone makes, for each experiment; 0 where it breaks a limit."""
    again = [replace(e, seed=SEEDS[1]) for e in experiments]
    one = plant.simulate([*experiments, *again], changes=many[0], threads=threads)
    other = plant.simulate(again, changes=many[1], threads=threads)
    n = len(experiments)
    outputs = [list(dict.fromkeys(c for loop in e.loops for c in sum_terms(loop.output))) for e in experiments]
    out = []
    for columns, *three in zip(outputs, one[:n], one[n:], other, strict=True):
        kept = all(r.info.ended_early is None and clipped(r) <= most_clipped for r in three)
        out.append(_separation(columns, *three) if kept else 0.0)
    return out


def _separation(outputs: Sequence[str], first: Recording, again: Recording, second: Recording) -> float:
    ratios = []
    finest = 1e-4  # of an output's span: noise below it counts as so much
    for column in outputs:
        a, b, c = (r.column(column) for r in (first, again, second))
        noise = max(_rms(a - b), finest * float(np.ptp(a)), 1e-12)
        ratios.append(_rms(a - c) / noise)
    return _rms(np.array(ratios))


def clipped(recording: Recording) -> float:
    """Largest share of samples in which a PWM command (`u_..._v`) asks for more than a whole period."""
    shares = [np.mean(np.abs(recording.column(c)) > 1.0) for c in recording.columns if c[:2] == "u_" and c[-2:] == "_v"]
    return float(max(shares, default=0.0))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _proposal(plant: Plant, run: Run, chosen: Sequence[Candidate], parts: tuple[str, str], value: float) -> Proposal:
    """The study of the best candidate, and of the best that gives an FRF where it gives none; and its sentence."""
    best, t = chosen[0], chosen[0].template
    also = f"; the study also holds {chosen[1].what}" if len(chosen) > 1 else ""
    seconds = t.duration_s if t.excitation is None else t.lead_s + t.excitation.duration_s + t.tail_s
    where = ", ".join(f"{v:g} {k.rsplit('_', 1)[-1]}" for k, v in best.point.items())
    does = f"{best.what} at ({where}), {seconds:g} s"
    verb = f"parts {parts[0]} from {parts[1]} by {value:.2g} noise floors"
    nothing = 2.0
    if value < nothing:
        verb = (
            f"is the best that was found, yet it separates {parts[0]} from {parts[1]} by {value:.2g} noise floors only"
        )
    controllers = {loop.name: loop.controller.blocks for loop in run.loops if loop.controller is not None}
    study = Study(
        rig="simulated",
        plant=plant.name,
        experiments=tuple(replace(c.template, operating_points=(dict(c.point),)) for c in chosen),
        operating_points=(dict(best.point),),
        rate_hz=run.rate_hz,
        solver=plant.solvers[0],
        changes=dict(run.extra.get("parameters", {})),
        pwm={k: float(run.pwm[k]) for k in ("frequency_hz", "dead_zone") if k in run.pwm},
        controllers=controllers,
        extra={"units": {c.template.name: _units(run, c.template) for c in chosen}},
    )
    return Proposal(t.name, parts, value, study, f"{does}, {verb}{also}")


def _units(run: Run, t: ExperimentTemplate) -> dict[str, Any]:
    """Stored unit of each of the template's signals, as a study file's reader gives them."""

    def unit(column: str | None) -> str | None:
        return None if column is None else Channel.from_column(column).unit

    place = None if t.excites is None else run.loop(t.excites).injected
    return {
        "excitation": unit(place),
        "references": {loop: unit(run.loop(loop).reference) for loop in t.references},
        "control": {loop: unit(run.loop(loop).control) for loop in t.control},
    }
