"""A first short recording -> the multisine that reaches a wanted standard deviation at the crossover.

With P periods of T s and a line of power p (mean square) in the instrument, the relative std of |G| is
sqrt(Phi_e/(2 P T p |H_y|²)): Phi_e the power per Hz of Y - G U, H_y the output's response to the instrument (Pintelon
and Schoukens 2012, ch. 2 and 5; Ljung 1999, ch. 13). It falls with the amplitude and with the square root of the time.
Distortion does not fall with time: where the first record shows it, it counts as a noise floor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import SUFFIXES, Array
from loopshape.data.control.controller import Controller
from loopshape.data.signal.channel import Channel
from loopshape.toolbox.planning import plan_words
from loopshape.toolbox.planning.plan_floor import own_floor, planned_floor
from loopshape.toolbox.planning.plan_lines import (
    chosen_lines,
    crossover_of,
    levels_of,
    needed_spacing_hz,
    round_period_s,
    with_line_near,
)
from loopshape.toolbox.planning.plan_nouns import Plan, Required
from loopshape.toolbox.planning.plan_record import FirstRecord, between
from loopshape.toolbox.rig.excitation.multisine import Multisine

#: periods that a plan has at least: fewer hardly tell noise from response
LEAST_PERIODS = 4
#: noise is taken to reach this many times its rms
NOISE_PEAK = 4.0
#: periods of each realisation where there are several
FEW_PERIODS = 2
#: a default band reaches this factor to both sides of the crossover
DECADE = 10.0


@dataclass(frozen=True, eq=False)
class _Shape:
    """A multisine of amplitude 1 and one period: lines' powers (n,), peaks of u and y, and what lines need (n,).

    `need` (n,) is std² times measured seconds times the line's power.
    """

    excitation: Multisine
    lines_hz: Array
    crossover: int
    power: Array
    peak_input: float
    peak_output: float
    need: Array
    floor: Array


def plan(first: FirstRecord, required: Required, controller: Controller | None = None) -> Plan:
    """The shortest experiment within the limits that reaches the accuracy, or the best one where none does.

    `controller` says where the crossover is; without it the loop's own. At four periods the amplitude is what the wish
    needs, yet that of the first record at least, for which distortion is known. Where that stands above it the
    plan has several realisations, over which it averages. Refuses an accuracy beside what the record knows, limits that
    the noise alone breaks, and a longest time in which no four periods of the lowest line fit. An experiment that is
    told, not wanted for its accuracy, may lie in a band that the first record does not know: predicted as at its edge.
    """
    if required.std is None:
        band = _told_band(first, required)
        crossover_hz = required.at_hz or float(np.sqrt(band[0] * band[1]))
    else:
        crossover_hz = crossover_of(first, controller or first.loop.controller, required.at_hz)
        band = _band(first, required, crossover_hz)
    shape, notes = _shape(first, required, crossover_hz, band)
    x, e = shape.crossover, shape.excitation
    most, binds = _most(first, required, shape)
    made = _size(required, shape, most, binds, min(most, first.amplitude))
    measured_s = made.realisations * made.periods * e.period_s
    floor = shape.floor / np.sqrt(made.realisations)
    column, f = _column(first), first.frequency_hz
    before = np.hypot(first.std, own_floor(first, odd_lines=required.kind == "odd"))
    std = np.sqrt(shape.need / (shape.power * made.amplitude**2 * measured_s) + floor**2)
    return Plan(
        loop=first.loop.name,
        recording=first.recording.info.name,
        injection=first.recording.info.injection,
        column=column,
        unit=SUFFIXES[Channel.from_column(column).unit],
        required=required,
        excitation=replace(e, amplitude=made.amplitude, periods=made.periods),
        realisations=made.realisations,
        lines_hz=shape.lines_hz,
        line_amplitude=made.amplitude * np.sqrt(2.0 * shape.power),
        std=std,
        floor=floor,
        crossover_hz=crossover_hz,
        at_crossover=float(std[x]),
        before=float(np.exp(np.interp(np.log(crossover_hz), np.log(f), np.log(before)))),
        before_hz=f,
        before_std=before,
        sure=float(0.5 / np.sqrt(np.interp(crossover_hz, f, first.averages))),
        measured_s=measured_s,
        peak_input=abs(first.input_rest) + made.amplitude * shape.peak_input + NOISE_PEAK * first.input_noise,
        peak_output=made.amplitude * shape.peak_output + NOISE_PEAK * first.output_noise,
        binds=made.binds,
        reached=made.reached,
        short_by=1.0 if made.reached or required.std is None else float(std[x] / required.std),
        needed_s=made.needed_s,
        needed_amplitude=made.needed_amplitude,
        notes=(*notes, *plan_words.cannot_know(first, required, shape.floor[x], made.amplitude)),
    )


@dataclass(frozen=True)
class _Size:
    """How large and how long; the active constraint, and what would be needed where the accuracy is not reached."""

    realisations: int
    periods: int
    amplitude: float
    binds: str
    reached: bool
    needed_s: float
    needed_amplitude: float


def _size(required: Required, shape: _Shape, most: float, binds: str, least: float) -> _Size:
    """Realisations, periods and amplitude (between `least` and `most`) that reach the accuracy, or come nearest."""
    x, period_s, ramps_s = shape.crossover, shape.excitation.period_s, 2.0 * shape.excitation.ramp_s
    if required.std is None:
        periods = max(FEW_PERIODS, round(float(required.seconds or 0.0) / period_s))
        return _Size(1, periods, most, "seconds", True, periods * period_s + ramps_s, most)
    floor = float(shape.floor[x]) ** 2
    distortion_share = 0.5  # of the wish's variance, that distortion may take in one realisation, or in their mean
    count = max(1, int(np.ceil(floor / (distortion_share * required.std**2) - 1e-9)))
    each_s = float(shape.need[x] / shape.power[x]) / most**2  # std² times seconds of noise alone, at most
    seconds = each_s / (required.std**2 - floor / count)
    fewest = FEW_PERIODS if count > 1 else LEAST_PERIODS
    periods = max(fewest, int(np.ceil(seconds / count / period_s - 1e-9)))
    needed_s = count * (periods * period_s + ramps_s)
    if needed_s <= required.longest_s * (1.0 + 1e-9):
        amplitude = most * float(np.sqrt(seconds / (count * periods * period_s)))
        if periods > fewest:
            return _Size(count, periods, amplitude, binds, True, needed_s, amplitude)
        why = "shortest" if count == 1 else "distortion"
        return _Size(count, periods, max(amplitude, least), why, True, needed_s, amplitude)
    longest = int((required.longest_s - ramps_s) / period_s + 1e-9)
    if count == 1:
        enough = most * float(np.sqrt(seconds / (longest * period_s)))
        return _Size(1, longest, most, binds, False, needed_s, enough)
    count = int(required.longest_s / (FEW_PERIODS * period_s + ramps_s) + 1e-9)
    if count < 2:
        return _Size(1, longest, most, "distortion", False, needed_s, np.inf)
    periods = int((required.longest_s / count - ramps_s) / period_s + 1e-9)
    return _Size(count, periods, most, "distortion", False, needed_s, np.inf)


def _column(first: FirstRecord) -> str:
    """Column of what is injected."""
    loop, injection = first.loop, first.recording.info.injection
    return str({"control": loop.control, "reference": loop.reference}.get(injection, loop.injected))


def _band(first: FirstRecord, required: Required, crossover_hz: float) -> tuple[float, float]:
    """Lowest and highest frequency to excite; refuses one beside what the first record knows."""
    low, high = first.frequency_hz[[0, -1]].tolist()
    asked = (
        required.f_low_hz or max(low, crossover_hz / DECADE),
        required.f_high_hz or min(high, crossover_hz * DECADE),
    )
    if asked[0] < 0.999 * low or asked[1] > 1.001 * high or not asked[0] < asked[1]:
        raise WrongUseError(
            "the first recording does not know the band that is to be excited",
            f"{asked[0]:g} to {asked[1]:g} Hz; {low:.3g} to {high:.3g} Hz are known",
            "ask for less, or record a first one that excites more",
        )
    return asked


def _told_band(first: FirstRecord, required: Required) -> tuple[float, float]:
    """The band of an experiment that is told; refuses one that no multisine of the rate has."""
    f, rate_hz = first.frequency_hz, first.recording.rate_hz
    band = required.f_low_hz or float(f[0]), required.f_high_hz or float(f[-1])
    if not band[0] < band[1] < 0.5 * rate_hz:
        raise WrongUseError(
            "a band to excite begins below its end, which lies below half the rate",
            f"{band[0]:g} to {band[1]:g} Hz at {rate_hz:g} Hz",
            "give --from-hz and --to-hz, in Python f_low_hz and f_high_hz",
        )
    return band


def _shape(
    first: FirstRecord, required: Required, crossover_hz: float, band: tuple[float, float]
) -> tuple[_Shape, tuple[str, ...]]:
    """Period, lines, levels and signal of amplitude 1."""
    f, rate = first.frequency_hz, first.recording.rate_hz
    inside = (f >= band[0]) & (f <= band[1])
    spacing = needed_spacing_hz(f, first.plant, first.std)
    narrow = max(0.05 * band[0], float(spacing[inside].min(initial=band[0])))
    settle_s = 0.4 / min(narrow, float(needed_spacing_hz(f, first.to_output, first.std)[inside].min(initial=narrow)))
    step = 1.0 if required.kind != "odd" else 2.0
    period_s, ramp_s, notes = _period(required, rate, max(step / narrow, 1.0 / band[0]), settle_s, band[0])
    lines = chosen_lines(period_s, band, (f, spacing), required.per_octave, required.kind)
    lines = with_line_near(lines, crossover_hz, period_s, required.kind)
    x = int(np.argmin(np.abs(lines - crossover_hz)))
    H_u, H_y = (between(lines, f, H) for H in (first.to_input, first.to_output))
    noise = np.exp(np.interp(np.log(lines), np.log(f), np.log(first.noise)))
    need = noise / (2.0 * np.abs(H_y) ** 2)
    levels = tuple(levels_of(need, x, required.level_ratio).tolist())
    ends = float(lines[0]) * (1.0 - 1e-6), float(lines[-1]) * (1.0 + 1e-6)
    made = Multisine(
        *ends, period_s, 1.0, 1, required.seed, ramp_s=0.0, lines_hz=tuple(lines.tolist()), levels=levels
    )  # fmt: skip
    N = np.fft.rfft(made.signal(rate))
    bins, n = np.round(lines * period_s).astype(int), round(period_s * rate)
    line_input = 2.0 * np.abs(N[bins] * H_u) / n
    shape = _Shape(
        excitation=replace(made, ramp_s=ramp_s),
        lines_hz=lines,
        crossover=x,
        power=2.0 * np.abs(N[bins] / n) ** 2,
        peak_input=_peak(N, bins, H_u, n),
        peak_output=_peak(N, bins, H_y, n),
        need=need,
        floor=planned_floor(first, lines, line_input, period_s, odd_lines=required.kind == "odd"),
    )
    return shape, notes


def _period(
    required: Required, rate_hz: float, least_s: float, settle_s: float, f_low_hz: float
) -> tuple[float, float, tuple[str, ...]]:
    """Period and ramp in s; a shorter period than the resonances ask for, with a note, where the time is short."""
    period_s = round_period_s(least_s, rate_hz)

    def ramp_of(period: float) -> float:
        return max(2.0, np.ceil(min(settle_s, period) * rate_hz)) / rate_hz

    if required.resolution_hz is not None:
        period_s = float(np.ceil(rate_hz / required.resolution_hz - 1e-6) / rate_hz)
        return period_s, float(ramp_of(period_s)), ()
    if LEAST_PERIODS * period_s + 2.0 * ramp_of(period_s) <= required.longest_s:
        return period_s, float(ramp_of(period_s)), ()
    ramp_s = float(ramp_of(min(period_s, 0.1 * required.longest_s)))
    period_s = float(np.floor((required.longest_s - 2.0 * ramp_s) / LEAST_PERIODS * rate_hz) / rate_hz)
    if period_s < 1.0 / f_low_hz:
        raise WrongUseError(
            f"the longest time holds no {LEAST_PERIODS} periods of the lowest frequency",
            f"{required.longest_s:g} s and {f_low_hz:.3g} Hz",
            f"allow {LEAST_PERIODS / f_low_hz + 2.0 * ramp_s:.3g} s, or begin at a higher frequency",
        )
    note = f"the longest time leaves a period of {period_s:.3g} s where resonances ask for {least_s:.3g} s"
    return period_s, ramp_s, (f"{note}: they are rounded off",)


def _peak(N: Any, bins: np.ndarray, H: Any, n: int) -> float:
    """Peak of what a period (transform N) becomes through H on its lines, the rest taken as silent."""
    out = np.zeros_like(N)
    out[bins] = N[bins] * H
    return float(np.abs(np.fft.irfft(out, n)).max())


def _most(first: FirstRecord, required: Required, shape: _Shape) -> tuple[float, str]:
    """Largest amplitude within all limits, and which limit it is; refuses one that rest and noise already break."""
    rest = abs(first.input_rest) + NOISE_PEAK * first.input_noise
    limits = {"amplitude": required.max_amplitude or first.amplitude}
    rooms = (
        ("input", required.max_input, rest, shape.peak_input),
        ("output", required.max_output, NOISE_PEAK * first.output_noise, shape.peak_output),
    )
    for word, limit, taken, each in rooms:
        if limit is None:
            continue
        if limit <= taken:
            raise WrongUseError(
                f"the limit of the plant's {word} leaves no room for an excitation",
                f"{limit:g}; rest and noise alone come to {taken:.3g} in the first recording",
                "allow more, or hold the machine elsewhere",
            )
        limits[word] = (limit - taken) / each
    binds = min(limits, key=lambda word: limits[word])
    return float(limits[binds]), binds
