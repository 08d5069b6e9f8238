"""Rooms under the limits on what a disturbance makes of a loop: rms of its error, and what its actuator must do.

The mean square of the error is the sum over frequencies of the disturbance's power in open loop times |S|², that of the
plant's input has |CS|² in place of |S|². Between the lines of the problem |S|² is straight in ln f. Below the first
line it falls as the integrators of the loop make it, above the last one it is 1. Peaks are those of Gaussian noise.
What `check` reads otherwise (an actuator that saturates, the bias of noise) is made up for as with every limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.remembered import remembered
from loopshape.core.units import Array, ComplexArray
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.signal.disturbance import Disturbance
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.problem.problem import Opened, Problem
from loopshape.design.problem.rows import LEAST, DenseRows, Tighten, required
from loopshape.loop.loop import Loop
from loopshape.loop.margin.disturbed import change, crossings_a_sample, largest, lines_of
from loopshape.loop.margin.saturated import Actuator
from loopshape.loop.stability.continued import continued

#: which power of a signal's rate each limit is about: 0 the signal itself, 1 its rate
_RATES = {"error_rms": 0, "control_rms": 0, "control_peak": 0, "control_rate": 1, "saturation_percent": 0}


def opened(loop: Loop, disturbance: Disturbance | None, requirements: Requirements) -> Opened | None:
    """What disturbs a loop, as it would be with the loop open; None if unknown.

    Refuses limits on peaks where the disturbance is a spectrum of no length.
    """
    if disturbance is None:
        return None
    asked, rate_hz = requirements.of(loop.plant.operating_point), loop.controller.rate_hz
    peaks = [name for name in ("control_peak", "control_rate") if getattr(asked, name) is not None]
    if peaks and np.isnan(disturbance.duration_s):
        raise WrongUseError(
            f"{', '.join(peaks)} of loop {requirements.loop!r} belongs to a record of some length", "a spectrum alone",
            "give duration_s with it, or a recording",
        )  # fmt: skip
    f, power, _ = lines_of(disturbance, rate_hz)
    if disturbance.recorded_under is not None:
        P = continued(loop.measured, f, loop.integrators or 0).response
        power = power * np.abs(1.0 + disturbance.recorded_under.response(f) * P) ** 2
    low, high = asked.control_range or (-np.inf, np.inf)
    mean = disturbance.control_mean
    return Opened(f, power, disturbance.duration_s * rate_hz, mean - low, high - mean)


@dataclass(frozen=True, eq=False)
class _Spread:
    """A disturbance's power, and that of its rate and of the rate of that, on the lines and on columns above them.

    `on_lines` (3, nf); `above` (3, points, columns of the problem).
    """

    on_lines: Array
    above: Array


def disturbed_rows(e: Evaluation, tighten: Tighten) -> Iterator[DenseRows]:
    """The room under each limit of what a disturbance makes, at each operating point whose disturbance is known."""
    p = e.p
    asked = [name for name in _RATES if name in p.limits]
    known = np.flatnonzero([one is not None for one in p.opened])
    if not asked or not known.size:
        return
    powers = _Powers(e, _spread(p))
    for name in asked:
        yield _rows(name, powers, known, required(p, name, tighten))


@dataclass(frozen=True, eq=False)
class _Powers:
    """Mean squares of error and input at each point, how ln of them moves with ln C, and where most of them lies."""

    e: Evaluation
    spread: _Spread

    def of(self, control: bool, rates: int) -> tuple[Array, ComplexArray, np.ndarray]:
        """Mean square (points,), pulls (points, columns) of ln of it, and the flat lines with most of it (points,)."""
        e, p = self.e, self.e.p
        C2 = np.exp(2.0 * e.ln_C[: p.beyond.start]) if control else np.ones(p.beyond.start)
        each = self.spread.on_lines[rates] * np.exp(2.0 * e.ln_S) * C2[p.line]
        above = self.spread.above[rates] * C2
        total = np.maximum(np.bincount(p.owner, weights=each, minlength=p.points) + above.sum(axis=1), 1e-300)
        pull = 2.0 * above.astype(complex) if control else np.zeros(above.shape, dtype=complex)
        moves = 1.0 / (1.0 + e.L) if control else -e.L / (1.0 + e.L)  # d ln |CS|, d ln |S| by d ln C
        np.add.at(pull, (p.owner, p.line), 2.0 * each * moves)
        most = np.array([a + each[a:b].argmax() for a, b in zip(p.first[:-1], p.first[1:], strict=True)])
        return total, pull / total[:, None], most


def _rows(name: str, powers: _Powers, known: np.ndarray, limit: Array) -> DenseRows:
    e, p = powers.e, powers.e.p
    control, rates = name != "error_rms", _RATES[name]
    mean, pull, most = powers.of(control, rates)
    room, pull = np.log(limit) - 0.5 * np.log(mean), -0.5 * pull
    if name in ("control_peak", "control_rate"):
        faster, faster_pull, _ = powers.of(control, rates + 1)
        for k in known:
            ln_peak, by_ratio = _ln_largest(mean[k], faster[k], _opened(p, k).samples, p.unit.rate_hz)
            room[k] -= ln_peak
            pull[k] -= by_ratio * (faster_pull[k] + 2.0 * pull[k])
    if name == "saturation_percent":
        for k in known:
            room[k] += np.log(_largest_std(_opened(p, k), limit[k]) / limit[k])
    columns = np.arange(p.beyond.start)
    return DenseRows(
        name, room[known], most[known], known, lambda: np.real(pull[known] @ p.slopes(e.values, columns).T)
    )


def _opened(p: Problem, point: int) -> Opened:
    one = p.opened[point]
    assert one is not None
    return one


def _ln_largest(mean: float, faster: float, samples: float, rate_hz: float) -> tuple[float, float]:
    """ln of the median of the largest value over the rms, and its slope by ln of the rate's power over the signal's."""
    crossings = crossings_a_sample(mean, faster, rate_hz)
    peak = largest(samples * crossings, samples, 0.5)
    step = 1e-5
    ahead, behind = (
        largest(samples * crossings_a_sample(mean, faster * np.exp(x), rate_hz), samples, 0.5) for x in (step, -step)
    )
    return float(np.log(peak)), float(np.log(ahead / behind)) / (2.0 * step)


def _largest_std(one: Opened, percent: float) -> float:
    """The rms of an input that leaves the actuator's range for this share of time."""
    from scipy.optimize import brentq

    actuator = Actuator(one.low, one.high)
    if min(actuator) <= 0.0:  # its mean alone saturates
        return LEAST
    ends = 1e-6 * min(actuator), 10.0 * max(actuator)
    return float(brentq(lambda std: 100.0 * actuator.share(std) - percent, *ends))


@remembered
def _spread(p: Problem) -> _Spread:
    on_lines, above = np.zeros((3, p.f.size)), np.zeros((3, p.points, p.beyond.start))
    for k, one in enumerate(p.opened):
        if one is None:
            continue
        a, b = p.first[k] + p.below[k], p.first[k + 1]
        f, lines = one.f, p.f[a:b]
        faster = np.abs(change(f, p.unit.rate_hz)) ** 2
        columns = np.append(p.line[b - 1], np.arange(p.above.start, p.above.stop)[p.f_above > lines[-1]])
        column_hz = np.append(lines[-1], p.f_above[p.f_above > lines[-1]])
        for rates in range(3):
            power = one.power * faster**rates
            on_lines[rates, a:b] = _on(lines, f, power, int(p.integrators[k]))
            high = f > lines[-1]
            np.add.at(above[rates, k], columns, _on(column_hz, np.minimum(f[high], column_hz[-1]), power[high], 0))
    return _Spread(on_lines, above)


def _on(lines: Array, f: Array, power: Array, integrators: int) -> Array:
    """What each line (n,) has of a spectrum up to the last of them, straight in ln f."""
    out = np.zeros(lines.size)
    low = f < lines[0]
    out[0] += float(power[low] @ (f[low] / lines[0]) ** (2 * max(integrators, 0)))
    inside = ~low & (f <= lines[-1])
    f, power = f[inside], power[inside]
    k = np.clip(np.searchsorted(lines, f, side="right") - 1, 0, max(lines.size - 2, 0))
    after = np.minimum(k + 1, lines.size - 1)
    share = np.log(f / lines[k]) / np.log(np.maximum(lines[after] / lines[k], 1.0 + 1e-12))
    np.add.at(out, k, (1.0 - share) * power)
    np.add.at(out, after, share * power)
    return out
