"""Measured plant, controller and period -> a memory of one period that learns what repeats, as a block diagram."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.control.block import BlockTemplate
from loopshape.data.control.controller import Controller
from loopshape.data.control.shorthand import controller, gain, low_pass
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.design.tune import Tuning
from loopshape.toolbox.diagrams.diagram import Diagram, Part

#: a period may miss whole samples by so much, and so many periods at most are tried to come closer
MISSED, PERIODS = 0.05, 12
#: sections of a low-pass without phase at most
SECTIONS = 60


def repetitive(
    P: FRF | Sequence[FRF],
    C: Controller | Tuning,
    period_s: float,
    q_filter: float | BlockTemplate | Sequence[BlockTemplate],
    *,
    learning: BlockTemplate | Sequence[BlockTemplate] | None = None,
    preview: int | None = None,
    requirements: Requirements | None = None,
) -> Diagram:
    """A memory of one period around a loop that is closed: what repeats with `period_s` is learned while it runs.

    w = G z^p m with m = Q z^-N (e + m) is added to the error: at the period's harmonics the error shrinks to about
    |1 - Q| of what `C` alone leaves, between them it grows by 1/|1 - Q z^-N (1 - T G z^p)| at most (Tomizuka, Tsao and
    Chew, ASME J. Dynamic Systems, Measurement and Control 111, 1989). Stable for every period where
    |Q (1 - T G z^p)| < 1. The tuned block is `memory`, and it is checked as any: the sensitivity peak is what grows
    between the harmonics. Where the loop of `C` integrates, what the memory meets is 0 at 0 Hz: integrators = -1.
    `requirements` are those of the loop within, which has to be stable.

    `q_filter` is the low-pass Q: blocks, 1 at low frequency, or the corner in Hz (-3 dB) of one without phase, all of
    whose zeros lie at half the rate. `learning` is G (1 where it is left out), `preview` p in samples: by default where
    the largest |Q (1 - T G z^p)| of all operating points is smallest. Q's delay is taken off the memory.

    Raises WrongUseError for a period that is no whole number of samples, a corner too low for the rate, and a Q that
    takes longer than the period. Misleads where the period drifts: an error of one per cent at the tenth harmonic
    is already 36 deg.

    >>> import control, numpy as np, loopshape as ls
    >>> plant = control.c2d(control.ss(control.tf([24.0], [1.0, 5.0, 0.0])), 1e-3)
    >>> P = ls.FRF.from_control(plant, np.geomspace(0.05, 450.0, 150), relative_std=0.01, open_loop=True)
    >>> C = ls.controller(ls.gain(30.0), ls.lead_lag(5.0, 60.0), rate_hz=1e3)
    >>> D = ls.learning.repetitive(P, C, 0.2, 50.0)
    >>> D
    Diagram repetitive: memory, C, P, preview; memory is tuned, from outside: r
    """
    own = C.controller if isinstance(C, Tuning) else C
    plants = (P,) if isinstance(P, FRF) else tuple(P)
    rate = own.rate_hz
    Q = controller(*_low_pass(q_filter, rate), rate_hz=rate)
    blocks = (learning,) if isinstance(learning, BlockTemplate) else tuple(learning or ())
    G = controller(*(blocks or (gain(1.0),)), rate_hz=rate)
    samples, slow = _samples(period_s, rate), _delay(Q)
    most = int(np.floor(samples - slow)) - 1
    if most < 0:
        raise WrongUseError(
            "Q takes longer than the period",
            f"{slow:.4g} of {samples} samples",
            "raise its corner, or learn two periods",
        )
    ahead = _preview(plants, own, Q, G, most) if preview is None else preview
    if not 0 <= ahead <= most:
        raise WrongUseError("the preview lies within the period", f"{ahead} samples", f"give 0 to {most}")
    rest = samples - slow - ahead
    if abs(rest - round(rest)) > MISSED:
        raise WrongUseError(
            "the period less Q's delay is no whole number of samples", f"{samples} - {slow:.4g} samples",
            "move Q's corner, or give it as a number: that low-pass has no phase",
        )  # fmt: skip
    within = Part(own.loop or "C", "e1", "u", own, requirements=requirements)
    memory = replace(Q, loop="memory", computation_delay_s=round(rest) / rate)
    return _diagram(plants, within, memory, G if blocks else None, ahead)


def _diagram(plants: tuple[FRF, ...], within: Part, memory: Controller, G: Controller | None, ahead: int) -> Diagram:
    """The parts and sums; what would do nothing is left out."""
    R = within.requirements
    known = (R.integrators, R.unstable_poles) if R is not None else ()
    kept, added = ("m" if ahead else "a"), ("a" if G is None else "w")
    parts = [Part("memory", "v", "a", memory), within, Part("P", "u", "y", plants, *known)]
    parts += [] if G is None else [Part("G", "a", "w", G)]
    if ahead:
        late = controller(gain(1.0), rate_hz=memory.rate_hz)
        parts.append(Part("preview", "a", "m", replace(late, computation_delay_s=ahead / memory.rate_hz)))
    return Diagram(tuple(parts), {"e": "r - y", "v": f"e + {kept}", "e1": f"e + {added}"}, "memory", "repetitive")


def _low_pass(q_filter: float | BlockTemplate | Sequence[BlockTemplate], rate_hz: float) -> tuple[BlockTemplate, ...]:
    """Blocks of Q; a corner becomes ((1 + z^-1)/2)^2m, a low-pass without phase but for m samples of delay."""
    if isinstance(q_filter, BlockTemplate):
        return (q_filter,)
    if not isinstance(q_filter, int | float):
        return tuple(q_filter)
    if not 0.0 < q_filter < 0.5 * rate_hz:
        raise WrongUseError("Q's corner lies below half the rate", f"{q_filter:g} Hz", f"rate {rate_hz:g} Hz")
    turn = max(np.pi * q_filter / rate_hz, 1e-6)  # below, its cosine is 1
    many = int(np.ceil(np.log(0.5) / (4.0 * np.log(np.cos(turn)))))
    if many > SECTIONS:
        lowest = rate_hz / np.pi * np.arccos(0.5 ** (0.25 / SECTIONS))
        raise WrongUseError(
            "a corner so far below the rate takes too many sections", f"{many} for {q_filter:g} Hz",
            f"give {lowest:.3g} Hz or more, or blocks: ls.low_pass({q_filter:g}, order=1)",
        )  # fmt: skip
    return (low_pass(rate_hz / np.pi, 1.0),) * many


def _delay(Q: Controller) -> float:
    """Delay at low frequency in samples; refuses a Q that is not 1 there."""
    f = 1e-6 * Q.rate_hz
    low = Q.response([f])[0]
    if abs(low - 1.0) > 1e-3:
        raise WrongUseError("Q of a memory is 1 at low frequency", f"{abs(low):.4g}", "use a low-pass")
    return float(-np.angle(low) / (TWO_PI * 1e-6))


def _samples(period_s: float, rate_hz: float) -> int:
    """The period in samples; refuses one that is no whole number of them, and tells how many periods are."""
    samples = period_s * rate_hz
    if not (np.isfinite(samples) and samples >= 2.0):
        raise WrongUseError("a period is at least two samples", f"{period_s!r} s at {rate_hz:g} Hz")
    if abs(samples - round(samples)) <= MISSED:
        return round(samples)
    several = [k for k in range(2, PERIODS) if abs(k * samples - round(k * samples)) <= MISSED]
    way = f"learn {several[0]} periods: {several[0] * period_s:.6g} s" if several else "choose another rate"
    raise WrongUseError("the period is no whole number of samples", f"{samples:.6g}", way)


def _preview(plants: Sequence[FRF], C: Controller, Q: Controller, G: Controller, most: int) -> int:
    """Samples of preview with the smallest largest |Q (1 - T G z^p)| over all lines and operating points."""
    worst: Array = np.zeros(most + 1)
    for one in plants:
        f = one.frequency_hz
        L = one.siso * C.response(f)
        turned: ComplexArray = np.exp(1j * np.outer(np.arange(most + 1), TWO_PI * f / C.rate_hz))
        left = np.abs(Q.response(f)) * np.abs(1.0 - turned * (L / (1.0 + L) * G.response(f)))
        worst = np.maximum(worst, left.max(axis=1))
    return int(np.argmin(worst))
