"""Measured plant, controller, feedforward and a setpoint -> the error while it moves, with intervals.

e = S (1 - P F) r, where F adds to the plant's input. The setpoint moves from rest to rest and is taken back the same
way, so that it repeats and has a spectrum; the rest at both ends lets the error die out. The plant is the FRF smoothed
over its lines, as `check` reads it, and the FRF's error is carried by draws of what noise does to that.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.outcomes import ClosedLoop
from loopshape.core.units import Array, ComplexArray
from loopshape.data.arrays import real_array
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.smoothed import FEWEST, Dense, Scatter
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.loop.loops import loops_of
from loopshape.loop.stability.continued import continued, integrators_of
from loopshape.loop.stability.low_end import low_frequency_models
from loopshape.loop.stability.stability import closed_loop_stability
from loopshape.toolbox.learning.taps import Feedforward

Interval = tuple[float, float]
#: draws of what lies between the lines of an FRF without error
FEWEST_DRAWS = 100


@dataclass(frozen=True, eq=False)
class TrackingError:
    """Error (n,) of a loop along a setpoint, in its unit, with 95 % intervals from the FRF's error.

    `low` and `high` (n,) hold each sample by itself; `rms` and `largest` (absolute value) are medians over what the
    plant may be. A feedforward that is made from the same FRF follows some of its noise, and the draws count that noise
    twice: then both numbers are on the safe side and only the upper ends of their intervals are told (the lower are 0).
    Noise and disturbances of the machine are not in it.
    """

    time_s: Array
    error: Array
    low: Array
    high: Array
    rms: float
    rms_interval: Interval
    largest: float
    largest_interval: Interval

    def __repr__(self) -> str:
        """One line: rms and largest error with their intervals."""
        (a, b), (c, d) = self.rms_interval, self.largest_interval
        return (
            f"TrackingError: rms {self.rms:.4g} ({a:.4g} to {b:.4g}), largest {self.largest:.4g} ({c:.4g} to {d:.4g})"
        )


def tracking_error_of(
    P: FRF,
    C: Controller,
    setpoint: ArrayLike,
    feedforward: Feedforward | None = None,
    *,
    integrators: int | None = None,
    unstable_poles: int | None = None,
) -> TrackingError:
    """The error of a loop along a setpoint (n,) at the controller's rate, from rest to rest.

    Raises WrongUseError for a feedforward at another rate, for a loop that is unstable, and where the error has not
    died out at the setpoint's end.
    """
    if feedforward is not None and feedforward.rate_hz != C.rate_hz:
        raise WrongUseError(
            "feedforward and controller run at one rate", f"{feedforward.rate_hz:g} and {C.rate_hz:g} Hz",
            "make the feedforward from an FRF at the controller's rate",
        )  # fmt: skip
    r = real_array(setpoint, "the setpoint", ndim=1)
    if r.size < 16:
        raise WrongUseError("a setpoint has 16 samples at least", f"{r.size}")
    _refuse_unstable(P, C, integrators, unstable_poles)
    lines, scatter = smoothed(P)
    order = integrators_of(lines) if integrators is None else integrators
    at_rest = order + C.integrators() > 0
    _refuse_alive(lines, C, r, order, at_rest)
    f = _lines_of(r, C)
    F = np.zeros(f.size) if feedforward is None else feedforward.response(f)
    gain = C.response(f)

    def error(plant: ComplexArray) -> Array:
        return _swung((1.0 - plant * F) / (1.0 + gain * plant), r, at_rest)

    orders = (order,) if integrators is not None else tuple(k for k in (order, order - 1, order + 1) if k >= 0)
    plants = list(_plants(P.valid_lines(), lines, scatter, f, orders))
    own = error(plants[0][0])
    each = [np.array([error(plant * (1.0 + one)) for one in off]) for plant, off in plants]
    ends = np.array([np.quantile(one, (0.025, 0.975), axis=0) for one in each])
    rms, most = [np.sqrt(np.mean(one**2, axis=1)) for one in each], [np.abs(one).max(axis=1) for one in each]
    both = feedforward is None
    return TrackingError(
        np.arange(r.size) / C.rate_hz, own, ends[:, 0].min(axis=0), ends[:, 1].max(axis=0),
        float(np.median(rms[0])), _ends(rms, both), float(np.median(most[0])), _ends(most, both),
    )  # fmt: skip


def _refuse_unstable(P: FRF, C: Controller, integrators: int | None, unstable_poles: int | None) -> None:
    """Refuse what is unstable by the count; of a plant whose unstable poles nobody tells as if it had none."""
    for poles in dict.fromkeys((unstable_poles, unstable_poles or 0)):
        (loop,), _ = loops_of([P], C, Requirements(loop=C.loop, integrators=integrators, unstable_poles=poles))
        stability = closed_loop_stability(loop)
        if stability.outcome is ClosedLoop.UNSTABLE:
            raise WrongUseError(
                f"loop {C.loop!r} is unstable, its error does not end", stability.reason,
                "look at `ls.check`, and declare the plant's unstable_poles where it has some",
            )  # fmt: skip
        if stability.outcome is ClosedLoop.STABLE:
            return


def _lines_of(r: Array, C: Controller) -> Array:
    """Frequencies (nf,) in Hz of a setpoint (n,) that is taken back the same way."""
    return np.asarray(np.fft.rfftfreq(2 * r.size, 1.0 / C.rate_hz)[1:-1], dtype=float)


def _swung(through: ComplexArray, r: Array, at_rest: bool) -> Array:
    """What a loop whose response is `through` (nf,) makes of a setpoint (n,), which it rested at.

    At rest nothing is left of the setpoint; else its mean leaves what the lowest frequency does.
    """
    whole = np.zeros(through.size + 2, dtype=complex)
    whole[1:-1] = through * np.fft.rfft(np.concatenate([r, r[-1] + r[0] - r]))[1:-1]
    made = np.asarray(np.fft.irfft(whole, 2 * r.size)[: r.size], dtype=float)
    return made if at_rest else made + 0.5 * float(through[0].real) * (r[0] + r[-1])


def _refuse_alive(lines: FRF, C: Controller, r: Array, order: int, at_rest: bool) -> None:
    """Refuse a setpoint whose rest at the end is too short: with twice the time the error is another."""
    made = []
    for one in (r, np.append(r, np.full(r.size, r[-1]))):
        f = _lines_of(one, C)
        P = continued(lines, f, order, smooth=True).response
        made.append(_swung(1.0 / (1.0 + C.response(f) * P), one, at_rest))
    alive, size = (float(np.abs(x).max()) for x in (made[0] - made[1][: r.size], made[0]))
    if alive > 0.02 * size:  # the share of it that a step from lines may have at its end, too
        raise WrongUseError(
            "the error must have died out at the setpoint's end",
            f"with a rest as long as all of it again it differs by {alive:.3g} of {size:.3g}",
            "give the setpoint a longer rest, or look at `ls.check` whether the loop is stable",
        )


def _plants(
    measured: FRF, lines: FRF, scatter: Scatter, f: Array, orders: Sequence[int]
) -> Iterator[tuple[ComplexArray, ComplexArray]]:
    """What the plant may be at f (nf,), each with draws (draws, nf) of its relative error; the likeliest first.

    They differ where there is no line: below the first by the small models that follow the lowest ones, with each
    number of integrators in `orders`; above the last P falls as 1/f² or stays. Between lines half of how far a spline
    lies off a straight line is an error of its own.
    """
    there = continued(lines, f, orders[0], smooth=True)
    P = there.response
    draws = scatter.deviations if len(scatter.deviations) > 1 else np.zeros((FEWEST_DRAWS, lines.siso.size), complex)
    off = there.spread(draws / scatter.reference)
    yield P, off
    off = off[::4]  # the others take a quarter of the draws: what counts is how they differ
    first, last = lines.frequency_hz[0], lines.frequency_hz[-1]
    inside, below = (f >= first) & (f <= last), f < first
    if lines.frequency_hz.size >= FEWEST:
        dense = scatter.dense or Dense(lines.frequency_hz, lines.siso, scatter.reference, draws)
        P, off, among = P.copy(), off.copy(), dense.at(f[inside])
        P[inside], off[:, inside] = among.response, among.deviations[::4] / among.reference
        yield P, off
    flat = P.copy()
    flat[f > last] = lines.siso[-1]
    yield flat, off
    for model in (one for k in orders for one in low_frequency_models(measured, k)):
        lower = P.copy()
        lower[below] = lines.siso[0] * model.response(f[below]) / model.response(np.array([first]))
        yield lower, off


def _ends(values: Sequence[Array], both: bool) -> Interval:
    low, high = np.transpose([np.quantile(one, (0.025, 0.975)) for one in values])
    return float(low.min()) if both else 0.0, float(high.max())
