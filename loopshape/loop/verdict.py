"""FRFs, controller and requirements -> Verdict: each requirement at its worst operating point."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import ParamSpec

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import Outcome
from loopshape.core.units import db
from loopshape.data.control.controller import Controller
from loopshape.data.control.scheduled import Scheduled
from loopshape.data.requirement.requirements import LIMITS, TOGETHER, Limit, Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.data.result.verdict_words import detuning_warnings
from loopshape.data.signal.disturbance import Disturbance
from loopshape.loop.detuning import with_detuning
from loopshape.loop.loop import Loop
from loopshape.loop.loops import Closed, closed_loops, equivalent_plants, loops_of, matrix_loops, points_of
from loopshape.loop.margin.disturbed import (
    Disturbed,
    disturbance_warnings,
    made_of,
    of_points,
)
from loopshape.loop.margin.margins import Reader, margins
from loopshape.loop.matrix.disturbed_loops import of_each
from loopshape.loop.matrix.matrix_margins import matrix_margins
from loopshape.loop.order import decided_at_hz, longer, with_orders
from loopshape.loop.points import point_outcome
from loopshape.loop.stability.stability import LOWER

_P = ParamSpec("_P")
#: what a check of a schedule does not show
FROZEN = (
    "the margins are those of frozen operating points: they hold where the point moves slowly beside the loop, which is"
    " not checked"
)


@dataclass(frozen=True, eq=False)
class LoopCheck:
    """Loops that are closed together, one or several, at every operating point: what was checked, and what came out.

    `frfs` are the plants with all their lines, `loops` on those that a check looks at, in the same order. Of several
    loops `each` is the check of one with all others closed (`others_closed`), on the equivalent plant that it meets;
    its stability is that of all.
    """

    verdict: Verdict
    loops: tuple[Loop, ...]
    frfs: tuple[FRF, ...]
    requirements: tuple[Requirements, ...] = ()
    fits: tuple[Fit, ...] = ()
    together: Requirements | None = None
    recorded_under: tuple[Controller, ...] = ()
    each: tuple[LoopCheck, ...] = ()
    others_closed: bool = False

    @property
    def parts(self) -> tuple[LoopCheck, ...]:
        """This check, or of several loops that of each and then that of all together."""
        return (*self.each, replace(self, verdict=replace(self.verdict, each=()))) if self.each else (self,)

    @property
    def required(self) -> Requirements | None:
        """What is required of one loop; None where nothing was given."""
        return (*self.requirements, None)[0]

    def under(self, controllers: Sequence[Controller | Scheduled]) -> Verdict:
        """The verdict on other controllers of the same loops."""
        alone = all(frf.response.shape[1:] == (1, 1) for frf in self.frfs)
        closed = None if alone else [one.loop for one in controllers]
        return check(
            self.frfs, controllers, self.requirements, self.fits, together=self.together, closed=closed,
            recorded_under=self.recorded_under,
        )  # fmt: skip


def check_loops(
    frfs: Sequence[FRF],
    controllers: Controller | Scheduled | Sequence[Controller | Scheduled],
    requirements: Requirements | Sequence[Requirements] = (),
    fits: Sequence[Fit] = (),
    *,
    together: Requirements | None = None,
    closed: Sequence[str] | None = None,
    recorded_under: Sequence[Controller] = (),
    disturbances: Sequence[Disturbance] = (),
) -> LoopCheck:
    """Check controllers against the requirements of each loop and of all together, at every operating point measured.

    Every line holds limit, value with its 95 % interval, slack, and where it is worst. A requirement is passed, failed,
    or not decided by these data. A loop that is unstable, or whose stability the data cannot decide, does not pass.

    `frfs` are n x n, one an operating point, for n controllers, one loop 1 x 1; `closed` names the loops that are
    closed, all by default. Of several each loop's limits are checked on the equivalent plant with all others closed;
    whether that is stable only the count of det(I + L) says. What is required of all `together` holds for one loop as
    well. The count of the loops under `recorded_under` tells the plant's unstable poles where nothing declares them.

    A limit of one loop that breaks where the plant's resonances move by up to 2 % is warned of, unless
    `detuning_percent` is required. `disturbances` tell what `error_rms` and the limits on the plant's input are about,
    at their operating points; one alone serves all. Of several loops they are recordings of all loops at the same time.

    Refuses loops without a controller or an output, requirements of loops that are not there, several rates, what
    disturbs some of several loops alone, limits on singular values where outputs have different units.
    """
    asked = (requirements,) if isinstance(requirements, Requirements) else tuple(requirements)
    every = (controllers,) if isinstance(controllers, Controller | Scheduled) else tuple(controllers)
    if not frfs:
        names = ", ".join(repr(one.loop) for one in asked or every)
        raise WrongUseError(f"there is no FRF of loop {names} to check", "", "measure or import one")
    chosen = closed_loops(frfs, every, closed, recorded_under)
    each: tuple[LoopCheck, ...] = ()
    if len(asked) > 1 or len(chosen.names) > 1:
        _refuse_unknown(asked, chosen.names)
    if len(chosen.names) > 1:
        if disturbances and any(len(frf.inputs) > len(chosen.names) for frf in frfs):
            raise WrongUseError(
                "the errors of several loops follow from those of all", f"{', '.join(chosen.names)} of more loops",
                "close all loops, or leave the disturbance out",
            )  # fmt: skip
        loops, notes = matrix_loops(chosen, whole := (together or Requirements()).of_all())
        found, each = _verdict_on_all(loops, chosen, asked, whole, fits, notes, of_each(loops, disturbances))
    else:
        required = asked[0] if asked else Requirements(chosen.names[0])
        required = required if together is None else required.with_all(together.of_all())
        (own,), under = chosen.controllers, chosen.recorded_under
        plants = [x if x.recorded_under or not under else replace(x, recorded_under=under[0]) for x in chosen.frfs]
        found, loops = _check_one(plants, own, required, fits, disturbances=disturbances)
    kept = _kept(found, chosen)
    return LoopCheck(kept, loops, tuple(frfs), asked, tuple(fits), together, tuple(recorded_under), each)


def _verdict_of(checked: Callable[_P, LoopCheck]) -> Callable[_P, Verdict]:
    return lambda *given, **named: checked(*given, **named).verdict


#: the verdict of `check_loops` alone
check = _verdict_of(check_loops)


def _kept(found: Verdict, closed: Closed) -> Verdict:
    """A verdict, and those that it has of each loop, with the controllers and marks of the data."""
    data = dict(zip(found.margins, map(data_mark, closed.frfs), strict=True))
    each = tuple(replace(one, controllers=closed.controllers, data=data) for one in found.each)
    return replace(found, each=each, controllers=closed.controllers, data=data)


def data_mark(frf: FRF) -> str:
    """A short mark of lines and response to about six figures.

    Unlike `FRF.digest` it survives the last digits, which differ from processor to processor when the same recording
    is estimated again.
    """
    size = np.abs(frf.response)
    turn = np.round(frf.response / np.where(size > 0.0, size, 1.0), 5)
    numbers = (*frf.frequency_hz.tolist(), *size.ravel().tolist())
    turns = (*(turn.real.ravel() + 0.0).tolist(), *(turn.imag.ravel() + 0.0).tolist())  # + 0: no negative zero
    text = " ".join(["%.6g"] * len(numbers) + ["%.5f"] * len(turns)) % (*numbers, *turns)
    return sha256(text.encode()).hexdigest()[:16]


def _check_one(
    frfs: Sequence[FRF],
    controller: Controller | Scheduled,
    requirements: Requirements,
    fits: Sequence[Fit],
    *,
    alone: bool = True,
    disturbances: Sequence[Disturbance] = (),
) -> tuple[Verdict, tuple[Loop, ...]]:
    """The verdict on one loop. Where it is not closed `alone` nothing is noted of open-loop poles and no detuning
    margin is looked for: several loops are counted at once."""
    refuse_too_high(requirements, controller)
    loops, notes = loops_of(frfs, controller, requirements, fits, counted=alone)
    named = dict(zip(points_of(frfs), loops, strict=True))
    disturbed = of_points(named, disturbances)
    found, made = verdict_on(named, requirements, detuned=alone, disturbances=disturbed)
    notes += disturbance_warnings(named, made, requirements)
    if isinstance(controller, Scheduled):
        notes += (FROZEN,)
    found = with_warnings(found, loops, requirements, notes)
    return (with_orders(found, loops, frfs, requirements) if alone else found), tuple(loops)


def _verdict_on_all(
    loops: Sequence[Loop],
    closed: Closed,
    requirements: Sequence[Requirements],
    together: Requirements,
    fits: Sequence[Fit],
    notes: Sequence[str],
    disturbed: Mapping[str, Sequence[Disturbance]],
) -> tuple[Verdict, tuple[LoopCheck, ...]]:
    """The verdict on several loops at once, and the check of each with the others closed."""
    found = {loop.plant.recording: matrix_margins(loop) for loop in loops}
    _refuse_mixed(together, found)
    asked, each = {one.loop: one for one in requirements}, []
    for name, own in zip(closed.names, closed.controllers, strict=True):
        required = replace(asked.get(name, Requirements(name)), integrators=None, unstable_poles=None)
        plants = equivalent_plants(name, loops)
        known = disturbed.get(name, ())
        alone, mine = _check_one(plants, own, required, fits, alone=False, disturbances=known)
        why = "by the count of all loops at once"
        counts = {k: replace(alone.margins[k], stable=m.stable, stability_reason=why) for k, m in found.items()}
        alone = replace(alone, margins={k: replace(m, stability_band_hz=None) for k, m in counts.items()})
        each.append(LoopCheck(alone, mine, plants, (required,) if name in asked else (), others_closed=True))
    warnings = tuple(dict.fromkeys([*notes, *(f"{name}: {text}" for name, m in found.items() for text in m.notes)]))
    lines = worst_lines(dict.fromkeys(found, together), found, TOGETHER)
    return Verdict(" + ".join(closed.names), lines, found, warnings, tuple(one.verdict for one in each)), tuple(each)


def _refuse_unknown(requirements: Sequence[Requirements], names: Sequence[str]) -> None:
    if unknown := [required.loop for required in requirements if required.loop not in names]:
        raise WrongUseError(
            "requirements are of no loop that is closed", ", ".join(unknown), f"loops: {', '.join(names)}"
        )


def _refuse_mixed(together: Requirements, found: Mapping[str, Margins]) -> None:
    """Refuse limits on what is not defined: singular values where the outputs have different units."""
    for name in (limit.name for limit in TOGETHER if getattr(together, limit.name) is not None):
        if any(np.isnan(m[name].value) for m in found.values()):
            raise WrongUseError(
                f"{name} is not defined where outputs have different units",
                f"loops {', '.join(next(iter(found.values())).loops)}",
                "ask for modulus_margin or disk_margin, which do not depend on units",
            )


def refuse_too_high(requirements: Requirements, controller: Controller | Scheduled) -> None:
    """Refuse a high-frequency limit on |CS| that begins where the controller cannot be read any more."""
    from_hz = requirements.control_high_frequency_from_hz
    if from_hz is not None and from_hz >= 0.45 * controller.rate_hz:
        raise WrongUseError(
            f"control_high_frequency_from_hz of loop {requirements.loop!r} must lie below 0.45 of the rate",
            f"{from_hz:g} Hz at {controller.rate_hz:g} Hz",
        )


def with_warnings(found: Verdict, loops: Sequence[Loop], requirements: Requirements, notes: tuple[str, ...]) -> Verdict:
    """A verdict on loops with what had to be assumed of them (`notes`) and what it warns of."""
    unseen = (*outside_warnings(requirements, loops), *crossing_warnings(found.margins, loops, requirements))
    return replace(found, warnings=(*notes, *unseen, *detuning_warnings(found.margins, loops[0].controller)))


def crossing_warnings(
    found: Mapping[str, Margins], loops: Sequence[Loop], requirements: Requirements
) -> tuple[str, ...]:
    """A sentence where |L| crosses 0 dB high and yet hardly reduces the error below, of the worst operating point.

    An integrator with its crossing at f reduces the error by 12.3 dB at f/4; less than 9 dB all the way up to there,
    at two lines and more, is a loop whose |L| stays near 1.
    """
    # a crossing is warned of where the error is reduced by less than this at so many lines and more up to a quarter of
    # it
    least_reduction_db, least_low_lines = 9.0, 2
    reduced = {
        name: (-float(db(np.abs(loop.S[low])).min()), one.bandwidth_hz)
        for (name, one), loop in zip(found.items(), loops, strict=True)
        if np.isfinite(one.bandwidth_hz)
        and np.count_nonzero(low := loop.frequency_hz <= 0.25 * one.bandwidth_hz) >= least_low_lines
    }
    flat = {name: pair for name, pair in reduced.items() if pair[0] < least_reduction_db}
    if requirements.bandwidth_hz is None or not flat:
        return ()
    worst = min(flat, key=lambda name: flat[name][0])
    reduction, bandwidth = flat[worst]
    others = f" and {len(flat) - 1} more" * (len(flat) > 1)
    return (
        f"|L| crosses 0 dB at {bandwidth:.4g} Hz, but up to a quarter of that the error is reduced by"
        f" {reduction:.2g} dB at most, in {worst}{others}: a bandwidth does not tell the error; require |S| by masks,"
        " or error_rms",
    )


def outside_warnings(requirements: Requirements, loops: Sequence[Loop]) -> tuple[str, ...]:
    """Sentences on the parts of masks that lie below the lowest frequency, and on limits of no operating point."""
    out = []
    for loop in loops:
        first_hz = float(loop.frequency_hz[0])
        low = [x for x in requirements.of(loop.plant.operating_point).masks if x.band_hz[0] < first_hz * (1.0 - 1e-9)]
        out += [
            f"the mask on |{x.response}| begins at {x.band_hz[0]:.4g} Hz and is not applied below {first_hz:.4g} Hz,"
            f" the lowest frequency of {loop.plant.recording}"
            for x in low
        ]
    for one in requirements.at:
        if not any(one.holds_at(loop.plant.operating_point) for loop in loops):
            ranges = ", ".join(f"{name} {low:g} to {high:g}" for name, (low, high) in one.where.items())
            out.append(f"limits at {ranges} hold at no operating point that was measured")
    return tuple(out)


def verdict_on(
    loops: Mapping[str, Loop],
    requirements: Requirements,
    *,
    detuned: bool = True,
    disturbances: Mapping[str, Disturbance] | None = None,
) -> tuple[Verdict, dict[str, Disturbed]]:
    """The verdict on loops by the names of their operating points; detuning margins are looked for where `detuned`.

    `disturbances`, by the same names, tell the rms of the error and what the actuator must do; what came of them too.
    """
    found = {k: margins(loop, Reader.of(requirements.of(loop.plant.operating_point))) for k, loop in loops.items()}
    made = made_of(loops, found, requirements, disturbances or {})
    found |= {name: found[name].with_readings(**one.readings) for name, one in made.items()}
    return verdict_from(found, loops, requirements, detuned=detuned), made


def verdict_from(
    found: Mapping[str, Margins], loops: Mapping[str, Loop], requirements: Requirements, *, detuned: bool = True
) -> Verdict:
    """The verdict on loops whose margins are known; detuning margins are looked for where `detuned`."""
    asked = {name: requirements.of(loop.plant.operating_point) for name, loop in loops.items()}
    if detuned or requirements.detuning_percent is not None:
        found = {name: with_detuning(loop, found[name], asked[name]) for name, loop in loops.items()}
    return Verdict(requirements.loop, worst_lines(asked, found), found)


def worst_lines(
    asked: Mapping[str, Requirements], found: Mapping[str, Margins], limits: Sequence[Limit] = LIMITS
) -> tuple[RequirementResult, ...]:
    """Each limit that is asked for, at the worst of the operating points (one at least), of one loop or of several."""
    required = {x: {name: v for name, one in asked.items() if (v := getattr(one, x.name)) is not None} for x in limits}
    return tuple(_worst_line(limit, asks, found) for limit, asks in required.items() if asks)


def _worst_line(limit: Limit, required: Mapping[str, float], found: Mapping[str, Margins]) -> RequirementResult:
    lines = [_line_at(limit, value, name, found[name]) for name, value in required.items()]
    return min(lines, key=lambda line: (-line.outcome.severity, line.slack))


def _to_measure(limit: Limit, required: float, margin: Margins) -> tuple[float | None, float | None]:
    """From where and up to where to measure what a bound leaves open, or below its frequency down to where."""
    at_hz = margin[limit.name].at_hz or 0.0
    if at_hz >= margin.last_hz * (1.0 - 1e-9):
        return None, decided_at_hz(limit.name, required, margin)
    return next((gap for gap in margin.missing_hz if gap[0] < at_hz < gap[1]), (None, LOWER * at_hz))


def _line_at(limit: Limit, required: float, recording: str, margin: Margins) -> RequirementResult:
    """The line of one operating point."""
    read = margin[limit.name]
    bounded, sign = read.bound is not None, limit.sign
    bad, good = read.ends[:: int(sign)]
    outcome = point_outcome(margin, limit.name, required)
    from_hz, to_hz = _to_measure(limit, required, margin) if outcome is Outcome.UNDECIDED and bounded else (None, None)
    return RequirementResult(
        quantity=limit.name,
        unit=limit.unit,
        required=required,
        value=read.value,
        slack=sign * (bad - required),
        outcome=outcome,
        recording=recording,
        at_hz=read.at_hz,
        interval=read.interval,
        longer=longer(read.value, bad, good, required, sign) if outcome is Outcome.UNDECIDED and not bounded else None,
        bound=read.bound,
        measure_to_hz=to_hz,
        beyond=limit.name == "detuning_percent" and margin.detuning is not None and margin.detuning.worst.beyond,
        measure_from_hz=from_hz,
    )
