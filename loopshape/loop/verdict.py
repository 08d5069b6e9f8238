"""FRFs, controller and requirements -> Verdict: each requirement at its worst operating point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import Outcome
from loopshape.core.units import db, from_db
from loopshape.data.control.controller import Controller
from loopshape.data.control.gain_scheduled import GainScheduled
from loopshape.data.control.loop import Loop
from loopshape.data.requirement.requirements import Limit, Requirements
from loopshape.data.response.frf import FRF, Hold
from loopshape.data.response.model import Fit
from loopshape.data.response.smoothed import Scatter
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.data.result.verdict_words import detuning_warnings
from loopshape.data.signal.disturbance import Disturbance
from loopshape.identify.smooth.smoothing import merged, smoothed
from loopshape.loop.detuning import with_detuning
from loopshape.loop.margin.error_rms import error_warnings, of_points, with_error_rms
from loopshape.loop.margin.margins import margins
from loopshape.loop.order import decided_at_hz, longer, with_orders
from loopshape.loop.points import point_outcome
from loopshape.loop.predict.step_response import models_within
from loopshape.loop.stability.low_end import low_order
from loopshape.loop.stability.obstacles import RADIUS_95, Undecided
from loopshape.loop.stability.stability import unstable_count

#: draws of a fit's parameters from which its deviation below the lowest line is taken
DRAWN = 50
#: a crossing is warned of where the error is reduced by less than this at so many lines and more up to a quarter of it
LEAST_REDUCTION_DB, LEAST_LOW_LINES = 9.0, 2
#: lines above the band used are known where their relative deviation is below the first, noise alone above the second
KNOWN_BEYOND, NOISE_ALONE = 0.3, 1.0
#: what a check of a schedule does not show
FROZEN = (
    "the margins are those of frozen operating points: they hold where the point moves slowly beside the loop, which is"
    " not checked"
)


def loops_of(
    frfs: Sequence[FRF],
    scheduled: Controller | GainScheduled,
    requirements: Requirements,
    fits: Sequence[Fit] = (),
    *,
    counted: bool = True,
) -> tuple[list[Loop], tuple[str, ...]]:
    """Loops on the lines that a check looks at, smoothed, and what it had to assume.

    Integrators of the plant come from the requirements, else from a fit of the same recording, else from phase
    and slope of the lowest lines; unstable poles from the requirements, else from the count of the loop that was
    recorded under its own controller, else there are none where the recording was made in open loop, else from a fit
    that leaves nothing but noise; otherwise they are not known. What had to be assumed is noted,
    of poles where they are `counted` here and not elsewhere. A schedule gives each its frozen controller.
    """
    found, notes = [], []
    for measured in frfs:
        controller = scheduled if isinstance(scheduled, Controller) else scheduled.at(measured.operating_point)
        band = requirements.band_hz
        frf, left_out = _without_zeros(measured, band)
        frf, fewer = _merged(frf)
        lines = frf.between(*band) if band else frf.valid_lines()
        if controller.rate_hz != frf.rate_hz and frf.rate_hz > 0.0:
            raise WrongUseError(
                f"the controller of loop {controller.loop} runs at another rate than the recording {frf.recording}",
                f"{controller.rate_hz:g} and {frf.rate_hz:g} Hz",
                "give the controller the recording's rate_hz: its coefficients hold at one rate alone",
            )
        if controller.added_hold and (frf.recorded_under is not None or frf.hold is Hold.INCLUDED):
            raise WrongUseError(
                f"the FRF {frf.recording} contains the hold already", "added_hold = true", "leave that key out"
            )
        fit, unused = _fit_of(fits, frf, measured, requirements)
        beyond, model = beyond_lines(frf, lines), None if fit is None else fit.model
        plant, scatter = smoothed(frf, band)
        integrators, unstable, note = _open_loop_poles(plant, requirements, fit, beyond, lines, scatter)
        found.append(Loop(plant, controller, integrators, unstable, model, beyond, lines, scatter))
        notes += [
            text
            for text in (left_out, fewer, unused, note if counted else "", _narrowed(frf, lines, controller))
            if text
        ]
    return found, tuple(dict.fromkeys(notes))


def _without_zeros(frf: FRF, band: tuple[float, float] | None) -> tuple[FRF, str]:
    """The lines that are not exactly zero, and a note of those left out; refuses an FRF that has no other."""
    lines = frf.between(*band) if band else frf.valid_lines()
    if not lines.siso.any():
        raise WrongUseError(
            f"the FRF of loop {frf.loop}, recording {frf.recording}, is zero: a dead sensor?",
            f"{lines.siso.size} lines of 0",
            "look at its signals, then measure again",
        )
    zero = frf.siso == 0.0
    if not zero.any():
        return frf, ""
    first_hz = frf.frequency_hz[zero][0]
    note = f"lines of {frf.recording} that are exactly zero were left out: {zero.sum()}, the first at {first_hz:.4g} Hz"
    return frf.select(~zero), note


def _merged(frf: FRF) -> tuple[FRF, str]:
    """The FRF on the frequencies that a check reads, and a note where these are fewer than were measured."""
    fewer = merged(frf)
    if fewer is frf:
        return frf, ""
    many, few = frf.frequency_hz.size, fewer.frequency_hz.size
    return fewer, f"{many} frequencies of {frf.recording} were averaged to {few}, where they differ by noise alone"


def _narrowed(frf: FRF, lines: FRF, controller: Controller) -> str:
    """A note where valid lines outside the band used show |S| 1 dB larger than those within; else nothing."""
    outside = frf.valid & ~np.isin(frf.frequency_hz, lines.frequency_hz)
    outside &= frf.frequency_hz < 0.5 * controller.rate_hz
    if not outside.any():
        return ""
    near = np.abs(1.0 + controller.response(frf.frequency_hz[outside]) * frf.siso[outside])
    within = float(np.abs(1.0 + controller.response(lines.frequency_hz) * lines.siso).min())
    k = int(np.argmin(near))
    if near[k] > within / from_db(1.0):
        return ""
    return (
        f"{frf.recording} is used from {lines.frequency_hz[0]:.4g} to {lines.frequency_hz[-1]:.4g} Hz only (band_hz):"
        f" at {frf.frequency_hz[outside][k]:.4g} Hz, a valid frequency, |S| reads {-float(db(near[k])):.3g} dB"
    )


def beyond_lines(frf: FRF, lines: FRF) -> FRF | None:
    """Lines above those used, at the largest that their own 95 % circles allow: a check must not overlook them.

    Not those that are noise alone, known worse than to 100 %, unless lines above them are known to 30 %.
    """
    size = np.maximum(np.linalg.norm(frf.response, axis=(1, 2)), 1e-300)
    relative = np.sqrt(frf.variance.sum(axis=(1, 2))) / size
    above = frf.frequency_hz > lines.frequency_hz[-1]
    known = np.flatnonzero(above & (relative < KNOWN_BEYOND))
    rows = above & (relative <= NOISE_ALONE)
    rows[: known[-1] + 1 if known.size else 0] |= above[: known[-1] + 1 if known.size else 0]
    if not rows.any():
        return None
    found = frf.select(rows)
    return replace(found, response=found.response * (1.0 + RADIUS_95 * relative[rows])[:, None, None])


def _fit_of(fits: Sequence[Fit], frf: FRF, measured: FRF, requirements: Requirements) -> tuple[Fit | None, str]:
    """The fit that may speak for the plant below the measured band, and a note where there is one that may not.

    It was made for this FRF, ended well, leaves nothing but noise, contradicts no declaration, and its covariance tells
    the plant below the lowest line down to a thousandth of it.
    """
    mine = [x for x in fits if (x.recording, x.loop) == (frf.recording, frf.loop)]
    if not mine:
        return None, ""
    fit = mine[0]
    poles = ("unstable poles", requirements.unstable_poles, fit.model.unstable_poles())
    integrators = ("integrators", requirements.integrators, fit.model.integrators())
    against = next((x for x in (poles, integrators) if x[1] is not None and x[1] != x[2]), None)
    if fit.frf_digest not in ("", measured.digest):
        why = "it was made for another FRF"
    elif fit.outcome == "not_converged":
        why = "it did not converge"
    elif not fit.sufficient:
        why = f"it leaves more than noise (misfit {fit.misfit_db:.2g} dB)"
    elif against is not None:
        why = f"it has {against[2]} {against[0]}, and {against[1]} are declared"
    elif _spread_below(fit, float(frf.frequency_hz[0])) > KNOWN_BEYOND:
        why = "its parameters are not known well enough to tell the plant below the lowest frequency"
    else:
        return fit, ""
    return None, f"the fit of {frf.recording} is not used: {why}"


def _spread_below(fit: Fit, first_hz: float) -> float:
    """Largest relative deviation of a fit's response below a frequency in Hz, by its parameters' covariance."""
    f = np.geomspace(1e-3 * first_hz, first_hz, 20)
    drawn = np.array([model.response(f) for model in models_within(fit, DRAWN, 0)])
    return float(np.sqrt(np.mean(np.abs(drawn / fit.model.response(f) - 1.0) ** 2, axis=0)).max())


def _open_loop_poles(
    frf: FRF, requirements: Requirements, fit: Fit | None, beyond: FRF | None, raw: FRF, scatter: Scatter
) -> tuple[int | None, int | None, str]:
    """Integrators and unstable poles of the plant (None: not known), and a note where they were assumed."""
    integrators, note = _integrators(frf, requirements, fit)
    if requirements.unstable_poles is not None:
        return integrators, requirements.unstable_poles, note
    held = _held_poles(frf, integrators, fit, beyond, raw, scatter)
    if held is not None and held < 0:
        note = (
            f"the loop that was recorded at {frf.recording} would be unstable by this FRF: check sign, injection and"
            " integrators"
        )
        return None, None, note
    if held is not None:
        unstable, witness = held, "because the loop that was recorded was stable"
    elif frf.open_loop:
        unstable, witness = 0, "because it was recorded in open loop"
    elif fit is not None and fit.sufficient:
        unstable, witness = fit.model.unstable_poles(), "from its fit"
    else:
        return integrators, None, note
    if unstable:
        word = "pole" if unstable == 1 else "poles"
        note = f"{note + '; ' if note else ''}plant taken to have {unstable} unstable {word}, {witness}"
    return integrators, unstable, note


def _integrators(frf: FRF, requirements: Requirements, fit: Fit | None) -> tuple[int | None, str]:
    """Declared, or the fit's, or what phase and slope of the lowest lines agree on, None where they do not."""
    declared = requirements.integrators
    if fit is not None:
        return fit.model.integrators() if declared is None else declared, ""
    if declared is not None:
        return declared, ""
    by_phase, by_slope = low_order(frf)
    integrators = round(by_phase)
    if abs(by_phase - integrators) > 0.4 or abs(by_slope - integrators) > 0.5 or integrators < 0:
        return (
            None,
            f"the plant's lowest frequencies look like {by_phase:.1f} integrators by phase and {by_slope:.1f} by slope",
        )
    word = "integrator" if integrators == 1 else "integrators"
    if integrators and requirements.unstable_poles:
        return None, (
            f"the plant's lowest frequencies look like {integrators} {word}, or like unstable poles that lie below"
            " them: declare integrators"
        )
    return integrators, (
        f"plant taken to have {integrators} {word}, from its lowest frequencies: {by_phase:.1f} by phase,"
        f" {by_slope:.1f} by slope at {frf.frequency_hz[0]:.3g} Hz; declare integrators if that is not so"
    )


def _held_poles(
    frf: FRF, integrators: int | None, fit: Fit | None, beyond: FRF | None, raw: FRF, scatter: Scatter
) -> int | None:
    """Unstable poles of the plant by the count of the loop that was recorded, which stood; None where it cannot tell.

    A loop that stood has no unstable pole, so the encirclements of -1 by its own controller's L are the
    plant's unstable poles. Negative where no plant fits the count.
    """
    if frf.recorded_under is None or integrators is None or frf.frequency_hz[-1] >= 0.5 * frf.recorded_under.rate_hz:
        return None
    loop = Loop(frf, frf.recorded_under, integrators, 0, None if fit is None else fit.model, beyond, raw, scatter)
    missing = unstable_count(loop)
    return None if isinstance(missing, Undecided) else -missing


def check(
    frfs: Sequence[FRF],
    controller: Controller | GainScheduled,
    requirements: Requirements,
    fits: Sequence[Fit] = (),
    *,
    detuned: bool = True,
    counted: bool = True,
    disturbances: Sequence[Disturbance] = (),
) -> Verdict:
    """Hold a controller against its requirements at every operating point measured.

    Every line holds limit, value with its 95 % interval, slack, and where it is worst. A requirement is passed, failed,
    or not decided by these data. A loop that is unstable, or whose stability the data cannot decide, does not pass.

    A limit that breaks where the plant's resonances move by up to 2 % is warned of, unless `detuning_percent` is
    required; `detuned` false leaves the detuning margin out where it is not required (for thousands of checks).
    `counted` false notes nothing of open-loop poles: they are counted for all loops at once. `disturbances` tell what
    `error_rms` is at their operating points; one alone serves all.
    """
    return check_loops(
        frfs, controller, requirements, fits, detuned=detuned, counted=counted, disturbances=disturbances
    )[0]


def check_loops(
    frfs: Sequence[FRF],
    controller: Controller | GainScheduled,
    requirements: Requirements,
    fits: Sequence[Fit] = (),
    *,
    detuned: bool = True,
    counted: bool = True,
    disturbances: Sequence[Disturbance] = (),
) -> tuple[Verdict, tuple[Loop, ...]]:
    """`check`, and the loops that it looked at, for pictures."""
    if not frfs:
        raise WrongUseError(f"there is no FRF of loop {requirements.loop!r} to check", "", "measure or import one")
    refuse_too_high(requirements, controller)
    loops, notes = loops_of(frfs, controller, requirements, fits, counted=counted)
    named = dict(zip(points_of(frfs), loops, strict=True))
    shaken = of_points(named, disturbances)
    found = verdict_on(named, requirements, detuned=detuned, disturbances=shaken)
    notes += error_warnings(named, shaken, requirements)
    if isinstance(controller, GainScheduled):
        notes += (FROZEN,)
    found = with_warnings(found, loops, requirements, notes)
    return (with_orders(found, loops, frfs, requirements) if counted else found), tuple(loops)


def refuse_too_high(requirements: Requirements, controller: Controller | GainScheduled) -> None:
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
    reduced = {
        name: (-float(db(np.abs(loop.S[low])).min()), one.bandwidth_hz)
        for (name, one), loop in zip(found.items(), loops, strict=True)
        if np.isfinite(one.bandwidth_hz)
        and np.count_nonzero(low := loop.frequency_hz <= 0.25 * one.bandwidth_hz) >= LEAST_LOW_LINES
    }
    flat = {name: pair for name, pair in reduced.items() if pair[0] < LEAST_REDUCTION_DB}
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
) -> Verdict:
    """The verdict on loops by the names of their operating points; detuning margins are looked for where `detuned`.

    `disturbances`, by the same names, tell the rms of the error.
    """
    asked = {name: requirements.of(loop.plant.operating_point) for name, loop in loops.items()}
    from_hz = requirements.control_high_frequency_from_hz
    found = {
        name: margins(loop, high_frequency_from_hz=from_hz, masks=asked[name].masks, weights=asked[name].weights)
        for name, loop in loops.items()
    }
    for name, one in (disturbances or {}).items():
        found[name] = with_error_rms(loops[name], found[name], one)
    return verdict_from(found, loops, requirements, detuned=detuned)


def verdict_from(
    found: Mapping[str, Margins], loops: Mapping[str, Loop], requirements: Requirements, *, detuned: bool = True
) -> Verdict:
    """The verdict on loops whose margins are known; detuning margins are looked for where `detuned`."""
    asked = {name: requirements.of(loop.plant.operating_point) for name, loop in loops.items()}
    if detuned or requirements.detuning_percent is not None:
        found = {name: with_detuning(loop, found[name], asked[name]) for name, loop in loops.items()}
    return Verdict(requirements.loop, worst_lines(asked, found), found)


def points_of(frfs: Sequence[FRF]) -> list[str]:
    """Names of operating points, one an FRF; refuses two of one recording."""
    names = [frf.recording or f"frf {k + 1}" for k, frf in enumerate(frfs)]
    if len(set(names)) != len(names):
        raise WrongUseError("two FRFs of one loop come from the same recording", ", ".join(names))
    return names


def worst_lines(asked: Mapping[str, Requirements], found: Mapping[str, Margins]) -> tuple[RequirementResult, ...]:
    """Each limit that is asked for, at the worst of the operating points (one at least), of one loop or of several."""
    limits = next(iter(asked.values())).limits
    required = {x: {name: v for name, one in asked.items() if (v := getattr(one, x.name)) is not None} for x in limits}
    return tuple(_worst_line(limit, asks, found) for limit, asks in required.items() if asks)


def _worst_line(limit: Limit, required: Mapping[str, float], found: Mapping[str, Margins]) -> RequirementResult:
    lines = [_line_at(limit, value, name, found[name]) for name, value in required.items()]
    return min(lines, key=lambda line: (-line.outcome.severity, line.slack))


def _line_at(limit: Limit, required: float, recording: str, margin: Margins) -> RequirementResult:
    """The line of one operating point."""
    read = margin[limit.name]
    bounded, sign = read.bound is not None, limit.sign
    bad, good = read.ends[:: int(sign)]
    outcome = point_outcome(margin, limit.name, required)
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
        measure_to_hz=decided_at_hz(limit.name, required, margin) if outcome is Outcome.UNDECIDED and bounded else None,
        beyond=limit.name == "detuning_percent" and margin.detuning is not None and margin.detuning.worst.beyond,
    )
