"""FRFs and a new controller -> Predictions; a prediction and a measurement under that controller -> Comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import Agreement, ClosedLoop
from loopshape.core.units import db
from loopshape.data.algebra import feedback
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.prediction import Comparison, Prediction, Step, StepComparison
from loopshape.data.signal.channel import unit_of
from loopshape.loop.loop import Loop
from loopshape.loop.loops import closed_loops, equivalent_plants, loops_of, matrix_loops
from loopshape.loop.matrix.determinant import closed_loops_stability
from loopshape.loop.predict.agreement import noticed_db, on_common_lines, paired, tested
from loopshape.loop.predict.step_response import DRAWS, predict_step, step_from_lines
from loopshape.loop.stability.stability import Stability, closed_loop_stability
from loopshape.loop.tolerances import TOL


def predict(
    frfs: Sequence[FRF],
    controllers: Controller | Sequence[Controller],
    fits: Sequence[Fit] = (),
    *,
    integrators: int | None = None,
    unstable_poles: int | None = None,
    draws: int = DRAWS,
    seed: int = 0,
) -> list[Prediction]:
    """What a controller will make of each measured plant of its loop: S from the FRF, the step from a fit of it.

    Without a fit the step comes straight from the lines, where they can carry one (`step_from_lines`).

    S goes over the plant's valid lines with the plant's covariance. **The prediction is of the plant as it was
    measured**: at that amplitude, about where it stood on average, and with the other loops closed by the controllers
    that they had then. A plant that answers larger signals otherwise, or whose loops interact and get new controllers
    together, will contradict it, and that is what a comparison is for. Of several controllers, one a loop of matrix
    FRFs, each loop's S is that with the others closed by theirs, and stable is what det(I + L) says of all.
    """
    every = (controllers,) if isinstance(controllers, Controller) else tuple(controllers)
    if not frfs:
        names = ", ".join(repr(one.loop) for one in every)
        raise WrongUseError(f"there is no FRF of loop {names} to predict from", "", "measure or import one")
    closed = closed_loops(frfs, every)
    declared = Requirements(integrators=integrators, unstable_poles=unstable_poles)
    if len(closed.names) > 1:
        whole, more = matrix_loops(closed, declared)
        counts = [closed_loops_stability(loop) for loop in whole]
        parts = [(own, equivalent_plants(own.loop, whole)) for own in every if own.loop in closed.names]
    else:
        more, counts, parts = [], [], [(every[0], closed.frfs)]
    made = []
    for own, plants in parts:
        loops, notes = loops_of(plants, own, replace(declared, loop=own.loop), fits, counted=len(parts) == 1)
        texts = ("stability: " + "; ".join((*more, *notes)),) if more or notes else ()
        stable = counts if len(parts) > 1 else [closed_loop_stability(loop) for loop in loops]
        for loop, stability, frf in zip(loops, stable, plants, strict=True):
            made.append(_one(loop, stability, fit_of(frf, fits), texts, draws, seed))
    return made


def fit_of(frf: FRF, fits: Sequence[Fit]) -> Fit | None:
    """The fit made for this very FRF."""
    return next((x for x in fits if (x.recording, x.loop, x.frf_digest) == (frf.recording, frf.loop, frf.digest)), None)


def _one(
    loop: Loop, stability: Stability, fit: Fit | None, notes: tuple[str, ...], draws: int, seed: int
) -> Prediction:
    plant = loop.measured  # smoothed lines share errors, which a comparison cannot know
    S = replace(feedback(plant, loop.controller).S_o, recorded_under=loop.controller, loop=plant.loop)
    if stability.outcome is not ClosedLoop.STABLE:
        notes += (f"the loop is {stability.outcome}: {stability.reason}",)
    if fit is None:
        integrates = (loop.integrators or 0) + loop.controller_integrators() > 0
        step, why = _without_fit(S, stability.outcome, 1.0 if integrates else None, seed)
        return Prediction(S, stability.outcome, step, notes + why)
    step = predict_step(fit, loop.controller, draws=draws, seed=seed)
    if step is None:
        return Prediction(S, stability.outcome, None, (*notes, "the fit's loop does not come to rest: no step"))
    return Prediction(S, stability.outcome, _with_doubt(step, S, fit), notes)


def _without_fit(S: FRF, stability: str, final: float | None, seed: int) -> tuple[Step | None, tuple[str, ...]]:
    """The step that the lines carry, or why they carry none."""
    if stability is not ClosedLoop.STABLE:  # lines show no end of it: an unstable loop has no step
        return None, ("no fit of this FRF, and a loop that is not known to be stable: no step",)
    try:
        return step_from_lines(S, final=final, seed=seed), ()
    except WrongUseError as refused:
        return None, (f"no fit of this FRF, and {refused}",)


def _with_doubt(step: Step, S: FRF, fit: Fit) -> Step:
    """A note where the fit's S is another than that of the lines: a step rests on it."""
    assert S.recorded_under is not None
    f = S.frequency_hz
    apart = np.abs(db((1.0 + S.recorded_under.response(f) * fit.model.response(f)) * S.siso))
    std = db(1.0 + S.relative_std[:, 0, 0])
    k = int(np.argmax(np.maximum(apart - 2.0 * std, 0.0)))
    fit_apart_db = 1.0  # how far a fit's S may lie from the lines' before a step from it is doubted, in dB
    if apart[k] - 2.0 * std[k] < fit_apart_db:
        return step
    note = f"the fit's |S| lies up to {apart[k]:.2g} dB from that of the measured FRF, at {f[k]:.3g} Hz"
    return replace(step, notes=(*step.notes, f"{note}: the step rests on the fit"))


def compare(prediction: Prediction, measured: FRF, *, level: float = 0.05, tolerance_db: float = 0.0) -> Comparison:
    """Whether S measured under the predicted controller (`estimate_sensitivity`, or from an FRF) confirms a prediction.

    The statistic is that of `check.agreement`; `tolerance_db` is a rms deviation of |S| that counts as none.
    "confirmed" means that these data agree, and would have noticed a change of the plant's gain of 1 dB (or of twice
    the tolerance); "cannot tell" that they would not. Lines that differ are interpolated, and it is noted.

    Misleads: variances that are too large (a sweep's) make p-values too large, too small ones report a mismatch too
    soon. Errors that both measurements share (a leaking window, the same disturbance) cancel. Refuses a measurement
    that another controller held, of another loop, or at another rate.
    """
    notes = _checked(prediction, measured)
    return _tested(prediction.loop, prediction.sensitivity, measured, level, tolerance_db, notes, plants=False)


def compare_plants(first: FRF, second: FRF, *, level: float = 0.05, tolerance_db: float = 0.0) -> Comparison:
    """Whether two FRFs (1 x 1) are of one plant, within what both are known to; as `compare` in all else.

    Refuses FRFs of several inputs or outputs, of other units, and at other rates: a hold is part of a plant.
    """
    for frf in (first, second):
        if frf.response.shape[1:] != (1, 1):
            raise WrongUseError(
                "FRFs of one input and one output are compared", f"{frf.recording}: {frf!r}", "select an element"
            )
    for one, two in ((first.outputs[0], second.outputs[0]), (first.inputs[0], second.inputs[0])):
        if unit_of(one) != unit_of(two) and "1" not in (unit_of(one), unit_of(two)):
            raise WrongUseError("both FRFs have the same units", f"{one} and {two}", "import one in the other's units")
    if first.rate_hz and second.rate_hz and first.rate_hz != second.rate_hz:
        raise WrongUseError("both FRFs have one rate", f"{first.rate_hz:g} and {second.rate_hz:g} Hz")
    return _tested(first.loop, first, second, level, tolerance_db, (), plants=True)


def compare_all(first: Sequence[FRF], second: Sequence[FRF], *, tolerance_db: float = 0.0) -> list[Comparison]:
    """`compare_plants` each of `second` with each of `first` of its loop and operating point; one alone with one alone.

    All together call plants that have not changed different 5 % of the time. Refuses FRFs of which no two belong
    together.
    """
    alone = len(first) == len(second) == 1
    pairs = [(a, b) for a in first for b in second if alone or _belong(a, b)]
    if not pairs:
        raise WrongUseError(
            "no FRFs are of one loop at one operating point",
            f"{_named(first)}; {_named(second)}", "import them with the same --loop",
        )  # fmt: skip
    level = 1.0 - 0.95 ** (1.0 / len(pairs))
    return [compare_plants(a, b, level=level, tolerance_db=tolerance_db) for a, b in pairs]


def _belong(one: FRF, two: FRF) -> bool:
    points = [{**frf.operating_point, **frf.parameters} for frf in (one, two)]
    return one.loop == two.loop and points[0] == points[1]


def _named(frfs: Sequence[FRF]) -> str:
    return ", ".join(dict.fromkeys(f"loop {frf.loop} of {frf.recording}" for frf in frfs))


def _tested(
    loop: str, first: FRF, second: FRF, level: float, tolerance_db: float, notes: tuple[str, ...], plants: bool
) -> Comparison:
    """Two measurements of one response."""
    one, two, missed, more = on_common_lines(first, second)
    made = Comparison(
        loop=loop, predicted_from=first.recording, measured_from=second.recording,
        operating_point=dict(second.operating_point), outcome=Agreement.CANNOT_TELL, p_value=float("nan"), level=level,
        lines=0, bands=(), noticed_db=float("inf"), tolerance_db=tolerance_db, notes=notes + more,
    )  # fmt: skip
    if not missed.size:
        return made
    lines = paired(one, two, missed, tolerance_db, plants)
    p_value, bands = tested(lines)
    noticed = noticed_db(lines, level)
    sharp = noticed <= max(TOL.noticed_db, 2.0 * tolerance_db)
    passed = Agreement.CONFIRMED if sharp else Agreement.CANNOT_TELL
    return replace(
        made,
        outcome=Agreement.REFUTED if p_value < level else passed,
        p_value=p_value,
        lines=lines.frequency_hz.size,
        bands=bands,
        noticed_db=noticed,
        predicted_peak_db=float(db(lines.predicted).max()),
        measured_peak_db=float(db(lines.measured).max()),
    )


def _checked(prediction: Prediction, measured: FRF) -> tuple[str, ...]:
    """Notes on what a measurement does not say; refuses one of another loop or controller."""
    controller, held = prediction.controller, measured.recorded_under
    if prediction.loop not in ("", measured.loop) or (
        measured.rate_hz > 0.0 and measured.rate_hz != controller.rate_hz
    ):
        raise WrongUseError(
            f"the measurement {measured.recording} is not of the loop that was predicted",
            f"loop {measured.loop!r} at {measured.rate_hz:g} Hz",
            f"give one of loop {prediction.loop!r} at {controller.rate_hz:g} Hz",
        )
    if held is None:
        return ("it is not known which controller closed the loop: the predicted one is assumed",)
    if not same_controller(controller, held):
        raise WrongUseError(
            f"loop {measured.loop!r} was closed by another controller at {measured.recording} than was predicted",
            "their responses differ",
            "measure under the controller of the prediction, or predict with the one that ran",
        )
    return ()


def same_controller(one: Controller, two: Controller) -> bool:
    """Whether two controllers run alike: the same rate, and responses that agree to 1e-6 up to 0.45 of it."""
    if one.rate_hz != two.rate_hz:
        return False
    f = np.geomspace(1e-5, 0.45, 60) * one.rate_hz
    first, second = one.response(f), two.response(f)
    return bool(np.all(np.abs(first - second) <= 1e-6 * np.abs(first)))


def sensitivity_of(frf: FRF) -> FRF:
    """S of a plant's FRF under the controller that held it, on all its lines; refuses one that does not name it.

    It is the same number as the direct estimate from the recording (`estimate_sensitivity`), and less sure where the
    plant's input is below the noise: prefer that where there is a recording.
    """
    if frf.recorded_under is None:
        raise WrongUseError(
            f"the sensitivity at {frf.recording} does not follow from its FRF",
            "no controller is known to have closed it",
            "give the recordings, or name the controller in run.toml",
        )
    return replace(feedback(frf, frf.recorded_under).S_o, recorded_under=frf.recorded_under, loop=frf.loop)


def compare_step(measured: StepComparison, prediction: Prediction) -> StepComparison:
    """A recorded step beside the predicted one: the share of samples outside the band, and the largest distance.

    The band is widened by two deviations of what noise leaves in the tail. It knows the spread of the fit's parameters
    and no error of its structure, so that `outside` is no test; nor is a step of another size that of a linear loop.
    """
    step = prediction.step
    if step is None:
        return replace(measured, notes=(*measured.notes, *prediction.notes))
    t, y = measured.time_s, measured.response
    predicted, low, high = (np.interp(t, step.time_s, part) for part in (step.response, step.low, step.high))
    noise = 2.0 * float(np.std(y[-max(2, y.size // 10) :]))
    missed = np.abs(y - predicted)
    k = int(np.argmax(missed))
    outside = float(np.mean((y < low - noise) | (y > high + noise)))
    return replace(measured, predicted=step, outside=outside, largest_miss=float(missed[k]), miss_at_s=float(t[k]))
