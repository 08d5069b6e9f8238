"""A controller whose output has ends: its law sample by sample, as the exports have it, and a loop simulated with it.

Sections with an integrator come last. Where the output is limited they are wound back: by `share` of what is cut off in
the recursion of the integrating section (back-calculation: 1 at once; Astrom and Hagglund, Advanced PID Control, 2006,
section 3.5), or they keep their states while their input drives the output farther out (conditional integration).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.gate import pass_fields
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller

if TYPE_CHECKING:
    import control


class AntiWindup(StrEnum):
    """What the integrating sections do while the output is limited."""

    BACK_CALCULATION = "back_calculation"
    CONDITIONAL = "conditional"


@dataclass(frozen=True)
class OutputLimits:
    """Ends of a controller's output in its unit, and its largest rate in that unit a second (inf: none).

    `tracking_s` is the time constant with which back-calculation winds the integrator back, 0 at once. Refuses ends
    that do not rise or do not hold 0, and rates and times that are not positive.

    >>> import loopshape as ls
    >>> ls.formats.OutputLimits(-1.0, 1.0, rate=50.0).anti_windup.value
    'back_calculation'
    """

    low: float
    high: float
    rate: float = float("inf")
    anti_windup: AntiWindup = AntiWindup.BACK_CALCULATION
    tracking_s: float = 0.0

    def __post_init__(self) -> None:
        pass_fields(self)
        object.__setattr__(self, "anti_windup", AntiWindup(self.anti_windup))
        if not (np.isfinite([self.low, self.high]).all() and self.low <= 0.0 <= self.high and self.low < self.high):
            raise WrongUseError(
                "the ends of an output are two rising numbers with 0 between them", f"{self.low!r}, {self.high!r}"
            )
        if not self.rate > 0.0 or not 0.0 <= self.tracking_s < np.inf:
            raise WrongUseError(
                "a rate of an output must be positive, its tracking time 0 or more",
                f"{self.rate!r}, {self.tracking_s!r}",
            )


class LimitedLaw(NamedTuple):
    """A controller's law with limits: sections (n, 5) in the order in which they run, of which the last integrate.

    `order` are their places in the controller. `share` is that of what is cut off which the recursion takes back.
    """

    controller: Controller
    limits: OutputLimits
    order: tuple[int, ...]
    integrating: int
    share: float

    @property
    def sections(self) -> Array:
        """Coefficients b0 b1 b2 a1 a2, rounded to the controller's precision."""
        return self.controller.biquads()[list(self.order)]

    @property
    def turned(self) -> bool:
        """Whether the integrating sections integrate downward."""
        rows = self.sections[len(self.order) - self.integrating :]
        return bool(np.prod(np.sign(rows[:, 0] + rows[:, 1] + rows[:, 2])) < 0.0)

    @property
    def step(self) -> float:
        """The most that the output changes in a sample."""
        return self.limits.rate / self.controller.rate_hz

    @property
    def dtype(self) -> type[np.floating]:
        """The type in which every operation rounds."""
        return np.float32 if self.controller.precision == "single" else np.float64


def limited(controller: Controller, limits: OutputLimits) -> LimitedLaw:
    """The law of a controller with limits. Refuses fixed point, and several integrators but for conditional ones."""
    if controller.number_format.fixed:
        raise WrongUseError(
            f"the output of loop {controller.loop!r} in fixed point is limited by the caller", controller.precision,
            "export it in single or double precision, or leave the limits out",
        )  # fmt: skip
    whole = [block.integrators() for block in controller.blocks]
    last = [k for k, count in enumerate(whole) if count > 0]
    if sum(max(count, 0) for count in whole) > 1 and limits.anti_windup is AntiWindup.BACK_CALCULATION:
        raise WrongUseError(
            f"back-calculation winds one integrator back, loop {controller.loop!r} has more", f"{sum(whole)}",
            "choose conditional",
        )  # fmt: skip
    order = (*(k for k in range(len(whole)) if k not in last), *last)
    share = min(1.0, 1.0 / (controller.rate_hz * limits.tracking_s)) if limits.tracking_s else 1.0
    return LimitedLaw(controller, limits, order, len(last), share)


class Running:
    """A limited controller that runs, every operation rounded to its precision as in the exported code."""

    def __init__(self, law: LimitedLaw) -> None:
        kind = law.dtype
        self.law, self.kind = law, kind
        self.rows = [[kind(x) for x in row] for row in law.sections]
        self.states = [[kind(0.0), kind(0.0)] for _ in self.rows]
        self.last, self.cut = kind(0.0), False
        self.low, self.high, self.most = kind(law.limits.low), kind(law.limits.high), kind(law.step)
        self.share, self.turned = kind(law.share), law.turned

    def start(self, error: float, output: float) -> None:
        """Take over at this output: filters as if this error had always been there, the integrator at the output.

        An output beyond the limits counts as their end. Without an integrator the next output is what the error makes
        of it, within the rate.
        """
        value, first = self.kind(error), len(self.rows) - self.law.integrating
        output = float(min(max(self.kind(output), self.low), self.high))
        for k, ((b0, b1, b2, a1, a2), s) in enumerate(zip(self.rows, self.states, strict=True)):
            out = self.kind(output)
            if k < first:
                out = ((b0 + b1) + b2) / ((self.kind(1.0) + a1) + a2) * value
            elif k < len(self.rows) - 1:
                out = self.kind(0.0)
            s[1] = b2 * value - a2 * out
            s[0] = out - b0 * value
            value = out
        self.last = self.kind(output)

    def step(self, error: float) -> float:
        """One sample: the error in, the limited output out."""
        value, first = self.kind(error), len(self.rows) - self.law.integrating
        for (b0, b1, b2, a1, a2), s in zip(self.rows[:first], self.states[:first], strict=True):
            out = b0 * value + s[0]
            s[0] = (b1 * value - a1 * out) + s[1]
            s[1] = b2 * value - a2 * out
            value = out
        driven, inputs = -value if self.turned else value, []
        for (b0, *_), s in zip(self.rows[first:], self.states[first:], strict=True):
            inputs.append(value)
            value = b0 * value + s[0]
        given = self._within(value)
        self.cut = bool(given != value)
        keeps = self.law.limits.anti_windup is AntiWindup.CONDITIONAL and (value - given) * driven > 0.0
        if inputs and not keeps:
            self._integrate(inputs, value, given, first)
        self.last = given
        return float(given)

    def _integrate(self, inputs: list[np.floating], value: np.floating, given: np.floating, first: int) -> None:
        back = self.law.limits.anti_windup is AntiWindup.BACK_CALCULATION
        outs = [*inputs[1:], value + self.share * (given - value) if back else value]
        for put, out, (_, b1, b2, a1, a2), s in zip(inputs, outs, self.rows[first:], self.states[first:], strict=True):
            s[0] = (b1 * put - a1 * out) + s[1]
            s[1] = b2 * put - a2 * out

    def _within(self, value: np.floating) -> np.floating:
        low, high = self.last - self.most, self.last + self.most
        low, high = max(low, self.low), min(high, self.high)
        return high if value > high else low if value < low else value


@dataclass(frozen=True, eq=False)
class Simulation:
    """A loop sample by sample, (n,) each: its output, error, the limited output of its controller.

    `limited_percent` is the share of samples at which the controller's output is cut off. The margins of a verdict hold
    for the loop whose output is not.
    """

    time_s: Array
    output: Array
    error: Array
    control: Array
    limited_percent: float

    def __repr__(self) -> str:
        """Its length, its error and how much of it is limited."""
        rms = float(np.sqrt(np.mean(self.error**2)))
        return f"Simulation: {self.time_s.size} samples, error rms {rms:.4g}, limited {self.limited_percent:.3g} %"


def simulate(
    plant: control.LTI, controller: Controller, limits: OutputLimits, *, setpoint: Array, disturbance: Array
) -> Simulation:
    """A loop at the controller's rate from rest, with a setpoint and what is added to the plant's input (n,) each.

    A plant in continuous time is sampled behind a zero-order hold. Its output must not answer within the sample. What
    the controller's computation takes, in whole samples, delays what it gives out.
    """
    law, late = Running(limited(controller, limits)), controller.computation_delay_s * controller.rate_hz
    if abs(late - round(late)) > 1e-6:
        raise WrongUseError(
            "a loop is simulated with whole samples of delay", f"{late:g} samples", "round computation_delay_s"
        )
    A, B, C = _plant(plant, controller)
    x, n = np.zeros(A.shape[0]), setpoint.size
    output, error, control, cut = np.zeros((4, n))
    for k in range(n):
        output[k] = C @ x
        error[k] = setpoint[k] - output[k]
        control[k] = law.step(float(error[k]))
        x = A @ x + B * ((control[k - round(late)] if k >= round(late) else 0.0) + disturbance[k])
        cut[k] = law.cut
    return Simulation(np.arange(n) / controller.rate_hz, output, error, control, 100.0 * float(cut.mean()))


def _plant(plant: control.LTI, controller: Controller) -> tuple[Array, Array, Array]:
    """A, B, C of a plant at the controller's rate."""
    import control

    if not isinstance(plant, control.StateSpace | control.TransferFunction):
        raise WrongUseError(
            "a loop is simulated with a system of python-control", type(plant).__name__,
            "of a fit give control.tf(fit.model.num, fit.model.den)",
        )  # fmt: skip
    space = control.ss(plant)
    if not space.isdtime(strict=True):
        space = control.sample_system(space, 1.0 / controller.rate_hz, method="zoh")
    elif space.dt is not True and abs(space.dt * controller.rate_hz - 1.0) > 1e-9:
        raise WrongUseError(
            "a plant in discrete time has another rate than the controller",
            f"{1.0 / space.dt:g} Hz and {controller.rate_hz:g} Hz", "sample it at the controller's rate",
        )  # fmt: skip
    if space.ninputs != 1 or space.noutputs != 1 or np.any(space.D):
        raise WrongUseError(
            "a loop is simulated with one plant that answers after the sample",
            f"{space.noutputs} x {space.ninputs}, direct part {space.D.tolist()}", "give the plant of one loop",
        )  # fmt: skip
    return np.asarray(space.A), np.asarray(space.B)[:, 0], np.asarray(space.C)[0]
