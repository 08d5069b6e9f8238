"""What became of trials: reached or not, how soon, how far off, and how the arm moves at the setpoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from nine_actions import Rules, Trace
from scipy.stats import binomtest

from loopshape.core.units import Array

RATE_HZ = 1000.0


def first_held(inside: Array, ticks: int) -> int | None:
    """First tick from which `inside` (n,) holds for `ticks` without a break; None where it never does."""
    ticks = max(ticks, 1)
    runs = np.convolve(inside.astype(float), np.ones(ticks), "valid") > ticks - 0.5
    found = np.flatnonzero(runs)
    return int(found[0]) if found.size else None


def reached_s(trace: Trace, limit_s: float, tolerance_deg: float, held_s: float) -> float:
    """When the angle comes within the tolerance to stay there for `held_s`, all before the limit; nan: not reached."""
    n = round(limit_s * RATE_HZ)
    inside = np.abs(trace.theta2_deg - trace.setpoint_deg)[:n] <= tolerance_deg
    at = first_held(inside, round(held_s * RATE_HZ)) if inside.size else None
    return float("nan") if at is None else at / RATE_HZ


@dataclass(frozen=True)
class AtSetpoint:
    """The last seconds of a trial: span in deg, strongest frequency in Hz, mean error in deg, valve edges per s."""

    span_deg: float
    frequency_hz: float
    mean_deg: float
    edges_hz: float
    inside: bool  # within the tolerance all the time


def at_setpoint(trace: Trace, rules: Rules) -> AtSetpoint:
    """How the arm moves at the end of a trial; no frequency (nan) where it moves by no more than `moves_deg`."""
    n = round(rules.look_s * RATE_HZ)
    error = (trace.theta2_deg - trace.setpoint_deg)[-n:]
    span = float(np.ptp(error))
    return AtSetpoint(
        span,
        strongest_hz(error) if span > rules.moves_deg else float("nan"),
        float(error.mean()),
        float(trace.edges[-n:].sum()) / rules.look_s,
        bool(np.abs(error).max() <= rules.tolerance_deg),
    )


def strongest_hz(signal: Array) -> float:
    """Frequency of the largest line of a Hann-windowed spectrum."""
    window = np.hanning(signal.size)
    spectrum = np.abs(np.fft.rfft(window * (signal - signal.mean()), 4 * signal.size))
    return float(np.fft.rfftfreq(4 * signal.size, 1.0 / RATE_HZ)[spectrum.argmax()])


def interval_percent(hits: int, trials: int) -> tuple[float, float, float]:
    """Rate and its 95 % interval (Wilson) in %."""
    low, high = binomtest(hits, trials).proportion_ci(method="wilson")
    return 100.0 * hits / trials, 100.0 * low, 100.0 * high


@dataclass(frozen=True)
class Summary:
    """Outcome of a set of trials; medians over those that stayed in range, of the frequency over those that move."""

    trials: int
    reached: int
    left_range: int
    settling_s: float
    static_deg: float
    stayed: int  # within the tolerance all through the last seconds
    moving: int  # still moving then, by more than `Rules.moves_deg`
    span_deg: float
    span_90_deg: float
    frequency_hz: float
    edges_hz: float


def summary(traces: Sequence[Trace], rules: Rules) -> Summary:
    """All of it."""
    times = [reached_s(t, rules.limit_s, rules.tolerance_deg, rules.held_s) for t in traces]
    there = [s for s in times if np.isfinite(s)]
    ends = [at_setpoint(t, rules) for t in traces if not t.left_range]
    moving = [e for e in ends if e.span_deg > rules.moves_deg]
    spans = [e.span_deg for e in ends]
    return Summary(
        trials=len(traces),
        reached=len(there),
        left_range=len(traces) - len(ends),
        settling_s=middle(there),
        static_deg=middle([abs(e.mean_deg) for e in ends]),
        stayed=sum(e.inside for e in ends),
        moving=len(moving),
        span_deg=middle(spans),
        span_90_deg=float(np.quantile(spans, 0.9)) if spans else float("nan"),
        frequency_hz=middle([e.frequency_hz for e in moving]),
        edges_hz=middle([e.edges_hz for e in ends]),
    )


def middle(values: Sequence[float]) -> float:
    """Median, nan of nothing."""
    return float(np.median(values)) if values else float("nan")


def tracking_deg(trace: Trace, skip_s: float) -> tuple[float, float]:
    """Rms and largest error in deg after the first seconds; nan where the arm left its range."""
    error = (trace.theta2_deg - trace.setpoint_deg)[round(skip_s * RATE_HZ) :]
    if trace.left_range or not error.size:
        return float("nan"), float("nan")
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
