"""Is a recording fit for an FRF? Feedback where none is declared, unfed bands, records that grow, by loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from loopshape.core.kernels.spectra import cross_spectra
from loopshape.core.stretches import LongSignal, Signal, extent, stretches
from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.signal.excitation_kind import rows_of_a_period
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.quality.feedback_check import (
    FeedbackCheck,
    enough_periods,
    feedback_check,
    nothing_new,
    repeats,
)
from loopshape.identify.signals import input_signal
from loopshape.identify.spectra.input_power import unfed_bands
from loopshape.identify.spectra.transforms import measured_period
from loopshape.identify.tolerances import TOL

#: rows of a record that are looked at for feedback; more tell no more and take longer
MOST_ROWS = 200_000
#: rows that are looked at for feedback, at the least
LEAST_ROWS = 200


def stayed_bounded(recordings: Sequence[Recording], loops: Sequence[LoopSetup], outputs: Sequence[str]) -> bool:
    """Whether all recordings were made without feedback and no output grows along any: no pole is unstable then.

    What rested before the first input moved is left out: an output grows there because it was at rest.
    """
    if any(r.info.closed_loop for r in recordings):
        return False
    # the output of a record in open loop may grow by this much from the first third of what moved to the last,
    # rms; an unstable pole whose frequency the record resolves makes it grow by exp(4) and more
    grown = 10.0
    for recording in recordings:
        start = min(_begins(input_signal(recording, loop)) for loop in loops)
        for expression in outputs:
            first, last = (extent(part).std for part in _first_and_last_third(recording.signal(expression), start))
            if not last <= grown * first:
                return False
    return True


def _begins(u: Signal) -> int:
    """The row at which an input (n,) begins to move, in the first half."""
    whole, first, start = extent(u), float(u[:1][0]), 0
    started = 0.1  # share of its range by which an input leaves its first value when it begins to move
    for (part,) in stretches(u):
        moved = np.flatnonzero(np.abs(part - first) > started * (whole.most - whole.least))
        if moved.size:
            return min(start + int(moved[0]), u.size // 2)
        start += part.size
    return 0


def _first_and_last_third(y: Signal, start: int) -> tuple[Signal, Signal]:
    """Parts of what follows the row `start` of a signal (n,), read when they are used."""
    third = (y.size - start) // 3
    if isinstance(y, LongSignal):
        rest = y.size - third
        return (
            LongSignal(third, lambda a, b: y.read(start + a, start + b)),
            LongSignal(third, lambda a, b: y.read(rest + a, rest + b)),
        )
    return y[start : start + third], y[-third:]


def loop_feedback(recording: Recording, loop: LoopSetup, false_alarms: float = 0.01) -> FeedbackCheck:
    """Whether what enters the plant of a loop answers noise of the loop's output; see `feedback_check`.

    Of a periodic recording, what differs between periods is tested, from the first settled one on. A plant may answer
    within the sample; only where the output follows the input without any noise, as under a controller that is
    computed from the logged output, it may not: in a run folder row k holds the answer to what row k measured.

    For recordings stated to be in open loop; in closed loop the answer is known beforehand, and a `found` that is False
    means only that no noise worth mentioning goes round.
    """
    info, rate = recording.info, recording.rate_hz
    first = round((info.periodic_from_s or 0.0) * rate) if info.period_s else 0
    rows = slice(first, first + MOST_ROWS)
    u, y = input_signal(recording, loop)[rows], recording.signal(loop.output)[rows]
    stated = round(info.period_s * rate) if info.period_s else None
    return signal_feedback(u, y, stated, false_alarms, f"the input of loop {loop.name} in {info.file}")


def signal_feedback(
    u: Array, y: Array, stated: int | None, false_alarms: float, name: str, *, later: bool = False
) -> FeedbackCheck:
    """Whether an input u (n,) answers noise of the output y (n,); its period is measured, `stated` or not (samples).

    With `later` the plant is known to answer from the next row on.
    """
    if stated:
        period = measured_period(u, stated)
    else:
        period, first = rows_of_a_period(u)
        if u.size - first < LEAST_ROWS:  # a few rows at the end that happen to repeat
            period = first = 0
        u, y = u[first:], y[first:]
    if stated and u.size < 4 * period and not repeats(u, period):  # too few to tell them from noise
        period = 0
    elif period and not enough_periods(u.size, period) and not repeats(u, period):  # what differs is a sensor's noise
        return nothing_new(false_alarms, u.size, name, periodic=False, predictable=True)
    if not later:
        found = feedback_check(u, y, period=period or None, false_alarms=false_alarms, name=name)
        if found.decidable:
            return found
    return feedback_check(u, y, answers_after=1, period=period or None, false_alarms=false_alarms, name=name)


def open_loop_note(recording: Recording, loop: LoopSetup) -> tuple[str, ...]:
    """A warning where a recording stated to be in open loop shows feedback; nothing for others, or a short record.

    An input that repeats exactly is none. Where only neighbouring samples show it, as behind a filter, that is added.
    """
    u = recording.signal(loop.control)[:MOST_ROWS]
    if recording.info.closed_loop or u.size < LEAST_ROWS:
        return ()
    found = loop_feedback(recording, loop, false_alarms=1e-4)
    if not found.detected:
        return ()
    if found.explained > TOL.before_its_cause:
        return (
            f"{found.sentence}; so much comes before its cause that {loop.control} and {loop.output} may be swapped",
        )
    if recording.info.period_s is None:
        y = recording.signal(loop.output)[:MOST_ROWS]
        if not feedback_check(u, y, answers_after=-8, false_alarms=1e-4).detected:
            return (f"{found.sentence}; only neighbouring samples show it, as behind an anti-aliasing filter",)
    return (found.sentence,)


#: over a band's upper half: slope of ln|G| over ln f, lead of the phase in rad; at its end, |G| over the band's largest
#: and smallest, from which on together an estimate looks inverse
RISES, LEADS, AT_ITS_LARGEST, ABOVE = 0.3, 0.1, 0.85, 3.0


def inverse_note(recording: Recording, loop: LoopSetup, frequency_hz: Array, G: ComplexArray) -> tuple[str, ...]:
    """A warning where G (nf,), on lines of the valid band, is what swapped columns of control and output would give.

    A plant's magnitude does not rise to the end of a band while its phase leads more and more: that is a negative
    delay, an output before its cause. Nothing is reported where a known controller tells the columns apart
    (`wiring_notes`), of bands below an octave, or of a plant whose inverse falls (an acceleration). Wrong for a true
    differentiator without delay (voltage of an inductor).
    """
    if recording.info.closed_loop and loop.controller is not None:
        return ()
    if _exact_multiple(input_signal(recording, loop), recording.signal(loop.output)):
        return (
            f"{loop.output} is an exact multiple of {loop.control} in {recording.info.file}: one column mapped twice?"
            " No measured plant answers without noise and delay",
        )
    if frequency_hz.size < 12 or frequency_hz[-1] < 2.0 * frequency_hz[0]:
        return ()
    upper = frequency_hz >= np.sqrt(frequency_hz[0] * frequency_hz[-1])
    f, size, phase = frequency_hz[upper], np.abs(G), np.unwrap(np.angle(G))[upper]
    rises = _slope(np.log(f), np.log(size[upper]), 1.0 / f)
    leads, end = _slope(f, phase, np.ones(f.size)) * float(np.ptp(f)), float(size[-3:].mean())
    if rises < RISES or leads < LEADS or end < max(AT_ITS_LARGEST * size.max(), ABOVE * size.min()):
        return ()
    return (
        f"the response of loop {loop.name} in {recording.info.file} looks like the inverse of a plant: its magnitude"
        f" rises up to the end of the valid band ({20.0 * rises:.0f} dB a decade at {f[-1]:.3g} Hz) and its phase leads"
        f" more and more ({deg(leads):+.0f} deg from {f[0]:.3g} Hz), as if the output preceded its cause: are"
        f" {loop.control} and {loop.output} swapped?",
    )


def _slope(x: Array, y: Array, weight: Array) -> float:
    """Weighted least-squares slope of y over x (n,)."""
    x, y = x - np.average(x, weights=weight), y - np.average(y, weights=weight)
    return float((weight * x * y).sum() / (weight * x * x).sum())


def _exact_multiple(u: Signal, y: Signal) -> bool:
    """Whether y (n,) is a u + b up to rounding; of long signals in each stretch, by one a and b in all of them."""
    gains = []
    # part of an output that is no multiple of its input, squared, up to which it counts as an exact one
    exact = 1e-18
    for a, b in stretches(u, y):
        a, b = a - a.mean(), b - b.mean()
        gains.append((a @ b) / (a @ a) if a.any() else 0.0)
        left = b - gains[-1] * a
        if left @ left > exact * (b @ b):
            return False
    return bool(np.allclose(gains, gains[0], rtol=1e-6))


def unfed_notes(recording: Recording, loops: Sequence[LoopSetup]) -> tuple[str, ...]:
    """Sentences on wide bands where inputs of noise in open loop have no power; nothing for other recordings.

    What a study injects has the band that was asked for, and its unfed rest is no news; here it is the record's.
    """
    info = recording.info
    if info.closed_loop or info.kind != "noise":
        return ()
    inputs = [recording.signal(loop.control) for loop in loops]
    length = min(512, inputs[0].size // 8)
    if length < 32:
        return ()
    sums, *_ = cross_spectra(inputs, length, length // 4)
    upper = np.moveaxis(sums, -1, 0)
    lower = np.tril(np.ones(upper.shape[1:], dtype=bool), -1)
    power = np.where(lower, upper.conj().transpose(0, 2, 1), upper)
    f = np.arange(length // 2 + 1, dtype=np.float64) * (recording.rate_hz / length)
    names = tuple(loop.control for loop in loops)
    wide = max(3, f.size // 20)
    return tuple(band.sentence for band in unfed_bands(f[2:-1], power[2:-1], names, wide, leaks=False))
