"""S as it was measured; a prediction and a measurement under its controller, or two FRFs of a plant -> Comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import db
from loopshape.data.algebra import feedback
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.data.signal.channel import unit_of
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import ordinary_coherence
from loopshape.identify.frequency_response import source
from loopshape.identify.respond import respond
from loopshape.identify.settings import Settings
from loopshape.identify.signals import loop_signals, wiring_notes
from loopshape.loop.tolerances import TOL
from loopshape.toolbox.validation.agreement import noticed_db, on_common_lines, paired, tested
from loopshape.toolbox.validation.nouns import Agreement, Comparison, StepComparison
from loopshape.toolbox.validation.predicted.nouns import Prediction


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


def estimate_sensitivity(recording: Recording, loop: LoopSetup, settings: Settings | None = None) -> FRF:
    """S (1 x 1) of the loop that a recording excites: 1 - y/n with n in front of the controller or as the reference,
    u/n with n at the plant's input, where u is what enters the plant.

    It is what 1/(1 + C P) makes of the P of the same recording, if z is the controller's answer to the error, and it
    stays well known where that P is not: where C lets little through, z is small and noise hides P but not S. Its
    error is that of one linear average (-S times the disturbance over n), without a quotient's bias. The channels are
    the loop's output; the valid band is where S is known to 10 %, as for a plant. Other loops stay closed.

    Raises BadSignalError for a recording in open loop, and as `estimate_frf` does.
    """
    info = recording.info
    if not info.closed_loop or info.injection == "control" or not info.alone:
        raise BadSignalError(
            f"recording {info.file} has no sensitivity of loop {loop.name}",
            "its loop was open" if info.excites == loop.name else f"it excites {', '.join(info.excited) or 'no loop'}",
            "give a recording that excites this loop alone, closed",
        )
    s = loop_signals(recording, loop)
    every = respond(recording, [s.y, s.u], [s.instrument], 1, settings or Settings())
    at_input = info.injection == "plant_input"
    k = 1 if at_input else 0
    sound = every.excited & np.isfinite(every.response[:, :, 0]).all(axis=1)
    sound &= np.isfinite(every.covariance).all(axis=(1, 2))
    if not sound.any():
        raise BadSignalError(f"no frequency of recording {info.file} is excited", every.method, "excite more")
    a, f = every.select(sound), every.frequency_hz[sound]
    S = a.response[:, k, 0] if at_input else 1.0 - a.response[:, 0, 0]
    variance = a.covariance[:, k, k].real
    z, std = a.response[:, 1, 0] - (1.0 if at_input else 0.0), np.sqrt(a.covariance[:, 1, 1].real)
    column = s.output_channel.column
    return FRF(
        frequency_hz=f,
        response=S[:, None, None],
        covariance=np.asarray(variance[:, None, None], dtype=complex),
        valid=valid_lines(f, np.sqrt(variance) / np.abs(S), a.excited),
        inputs=(column,),
        outputs=(column,),
        method=f"sensitivity from the injected signal, {a.method}",
        loop=loop.name,
        coherence=np.clip(ordinary_coherence(a.power, 0, 2), 0.0, 1.0),
        recorded_under=loop.controller,
        notes=tuple(dict.fromkeys((*a.notes, *wiring_notes(recording, loop, f, z, a.response[:, 0, 0], std)))),
        **source([recording], a),
    )
