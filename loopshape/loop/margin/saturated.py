"""Noise at the plant's input, an actuator with ends -> how much more the loop does because of them, by simulation.

What the actuator does not pass on, q = sat(u) - u, is a disturbance of the plant's input. So u = u_linear - T q and
e = e_linear - PS q, with the impulse responses of the measured T and PS: no model of the plant, and what an integrator
of the controller winds up is in T. Records of the linear loop's spectrum with phases at random are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from loopshape.core.units import Array, ComplexArray

#: records that are simulated, and the samples of each at most
RECORDS, LONGEST = 6, 32_768
#: a share of time below this leaves the loop as it is; fewer samples outside than this are counted by Gaussian noise
RARE, COUNTED = 1e-6, 20
#: tails of impulse responses below this share of their largest value are left out, and below so many times the rms of
#: their later half
TAIL, CLEAR = 1e-5, 5.0


class Actuator(NamedTuple):
    """The room of the plant's input below and above its mean, in its unit."""

    low: float
    high: float

    def share(self, std: float) -> float:
        """Share of time that Gaussian noise of this standard deviation lies outside."""
        if min(self) <= 0.0 or std <= 0.0:
            return float(min(self) <= 0.0)
        return float(ndtr(-self.high / std) + ndtr(-self.low / std))

    def holds(self, control: Array) -> bool:
        """Whether a trace about its mean stays within."""
        return bool(control.max(initial=0.0) <= self.high and control.min(initial=0.0) >= -self.low)


class Record(NamedTuple):
    """Input and error (n,) of the linear loop, each about its mean."""

    control: Array
    error: Array

    def pieces(self) -> list[Record]:
        """The same in as many pieces as records are simulated, each of the most samples at most."""
        n = min(self.control.size // RECORDS, LONGEST)
        return [Record(self.control[k * n : (k + 1) * n], self.error[k * n : (k + 1) * n]) for k in range(RECORDS)]


class Factor(NamedTuple):
    """How many times as large something becomes, and the least and the most that it may be."""

    value: float = 1.0
    low: float = 1.0
    high: float = 1.0


SAME = Factor()


@dataclass(frozen=True)
class Factors:
    """What saturation makes of the linear loop's rms of error and input and of its peaks of input and rate.

    `share` is that of time outside the range, None where too few samples were; `away` says that the loop runs away, or
    differs so much from record to record that it may.
    """

    error: Factor = SAME
    control: Factor = SAME
    peak: Factor = SAME
    rate: Factor = SAME
    share: Factor | None = None
    away: bool = False


class Loops(NamedTuple):
    """Impulse responses (n,) from what the actuator does not pass on to the plant's input and to the error."""

    control: Array
    error: Array

    @classmethod
    def of(cls, T: ComplexArray, PS: ComplexArray) -> Loops:
        """From responses on the frequencies of a real transform; the plant answers from the next sample on."""
        n = 2 * (T.size - 1)
        made = [-np.fft.irfft(x, n)[1 : n // 2] for x in (T, PS)]
        last = max(_last(x) for x in made)
        return cls(made[0][:last], made[1][:last])


def _last(response: Array) -> int:
    """How many samples of an impulse response stand out of what the errors of its lines spread over all of it."""
    late = response[response.size // 2 :]
    least = max(TAIL * float(np.abs(response).max(initial=0.0)), CLEAR * float(np.sqrt(np.mean(late**2))))
    above = np.flatnonzero(np.abs(response) > least)
    return int(above[-1]) + 1 if above.size else 0


def simulate(control: Array, error: Array, loops: Loops, actuator: Actuator) -> tuple[Array, Array, bool]:
    """Input and error (n,) of the loop with its actuator from those of the linear one, and whether it ran away."""
    u, e, memory = control.copy(), error.copy(), loops.control.size
    away = 1e3 * max(actuator)  # an input so many times as large as its actuator's range has run away
    for k in range(u.size):
        value = u[k]
        if -actuator.low <= value <= actuator.high:
            continue
        if not -away < value < away:
            return u, e, True
        lacking = (actuator.high if value > 0.0 else -actuator.low) - value
        n = min(memory, u.size - k - 1)
        u[k + 1 : k + 1 + n] += lacking * loops.control[:n]
        e[k + 1 : k + 1 + n] += lacking * loops.error[:n]
    return u, e, False


def factors(records: Sequence[Record], loops: Loops, actuator: Actuator, scale: float, *, counted: bool) -> Factors:
    """What saturation changes in records of the linear loop's input and error (n,), all times `scale`."""
    ratios, shares = [], []
    for control, error in records:
        u, e, away = simulate(scale * control, scale * error, loops, actuator)
        outside = float(np.mean((u > actuator.high) | (u < -actuator.low)))
        if away:
            return Factors(share=Factor(outside, outside, 1.0), away=True)
        ratios.append(np.array(_sizes(e, u)) / np.maximum(_sizes(scale * error, scale * control), 1e-300))
        shares.append(outside)
    every = np.array(ratios).T
    mean = [_factor(one, 2.0 / np.sqrt(len(records))) for one in (*every[:2], np.array(shares))]
    single = [_factor(one, 2.0) for one in every[2:]]
    counted |= mean[2].value * sum(one.control.size for one in records) > COUNTED
    wild = 3.0  # records whose rms may differ by this factor are those of a loop that may run away
    away = mean[1].high > wild * mean[1].low
    return Factors(mean[0], mean[1], single[0], single[1], mean[2] if counted else None, away)


def _factor(each: Array, deviations: float) -> Factor:
    """The mean over records and an interval of so many standard deviations, not below what every record shows."""
    mean, off = float(each.mean()), deviations * float(each.std(ddof=min(1, each.size - 1)))
    return Factor(mean, max(float(each.min()), mean - off), mean + off)


def _sizes(error: Array, control: Array) -> tuple[float, float, float, float]:
    return (
        float(np.std(error)),
        float(np.std(control)),
        float(np.abs(control).max()),
        float(np.abs(np.diff(control)).max()),
    )
