"""A controller: blocks in series (`loopshape.data.control.block`), discretised at its rate, in the target's numbers.

Tustin maps s to k (z-1)/(z+1); on the unit circle that is j k tan(pi f T). k = 2/T, or, prewarped at f_p,
k = w_p / tan(w_p T/2), which makes the discrete response at f_p that of the blocks (Franklin, Powell and Workman,
Digital Control of Dynamic Systems, on prewarping). So the discrete response at f is the continuous one at a warped f',
and one formula serves both. Where coefficients are rounded, the response is that of the rounded sections.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import TOO_LARGE, pass_fields, received
from loopshape.core.units import TWO_PI, Array, ComplexArray, angular, db, deg
from loopshape.data.arrays import rate
from loopshape.data.control.block import BLOCK_KINDS, Block, Polynomial, Section, block_kind, series_response

_FIXED = re.compile(r"q([1-9][0-9]?)\.([1-9][0-9]?)")
_MOST_BITS = 45  # signals then keep 16 bits beside a sign in products of 60


@dataclass(frozen=True)
class Precision:
    """A number format. `name` is "double", "single", or "qM.N": M integer bits with the sign, N fractional bits.

    A fixed-point coefficient is an integer times 2^-N between -2^(M-1) and 2^(M-1) - 2^-N; M + N is 45 at most.
    """

    name: str
    integer_bits: int = 0
    fraction_bits: int = 0

    @classmethod
    def of(cls, name: str) -> Precision:
        """The format of a name; refuses a name that is none."""
        if name in ("double", "single"):
            return cls(name)
        found = _FIXED.fullmatch(name) if isinstance(name, str) else None
        if not found or int(found[1]) + int(found[2]) > _MOST_BITS:
            raise WrongUseError(
                "a precision of coefficients is not known",
                repr(name),
                f'use "double", "single", or fixed point "qM.N" of at most {_MOST_BITS} bits, such as "q5.27"',
            )
        return cls(name, int(found[1]), int(found[2]))

    @property
    def fixed(self) -> bool:
        """Whether it is fixed point."""
        return self.integer_bits > 0

    @property
    def bits(self) -> int:
        """Bits of a fixed-point coefficient, with its sign."""
        return self.integer_bits + self.fraction_bits

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest coefficient."""
        if self.fixed:
            return -(2.0 ** (self.integer_bits - 1)), 2.0 ** (self.integer_bits - 1) - 2.0**-self.fraction_bits
        largest = float(np.finfo(np.float32 if self.name == "single" else np.float64).max)
        return -largest, largest

    @property
    def signal_limit(self) -> int:
        """Fixed point: largest magnitude of an integer signal for which no sum of products leaves int64."""
        product_bits = 60  # five products of 60 bits add up within int64
        return int(min(2**31, 2 ** (product_bits - self.bits + 1)) - 1)

    def rounded(self, values: ArrayLike) -> Array:
        """The nearest values of the format, ties to even, in double (which holds them exactly); not clipped."""
        values = np.asarray(values, dtype=float)
        if self.fixed:
            return np.asarray(np.rint(values * 2.0**self.fraction_bits) * 2.0**-self.fraction_bits)
        with np.errstate(over="ignore", under="ignore"):
            return values.astype(np.float32).astype(float) if self.name == "single" else values

    def fits(self, rounded: ArrayLike) -> np.ndarray:
        """Which rounded values lie within the range."""
        low, high = self.range
        return np.asarray((low <= np.asarray(rounded)) & (np.asarray(rounded) <= high))

    def integers(self, rounded: Array) -> list[list[int]]:
        """Fixed point: rounded values (n, m) as integers, value = integer 2^-N."""
        return [[int(v * 2.0**self.fraction_bits) for v in row] for row in rounded]

    def wide_enough(self, values: ArrayLike) -> Precision | None:
        """Fixed point: as many bits with an integer part that holds `values`; None where there is none."""
        for m in range(self.integer_bits, self.bits):
            wider = Precision(f"q{m}.{self.bits - m}", m, self.bits - m)
            if wider.fits(wider.rounded(values)).all():
                return wider
        return None


__all__ = ["BLOCK_KINDS", "Block", "Controller", "block_kind", "hold_and_delay", "series_response"]


def hold_and_delay(frequency_hz: ArrayLike, rate_hz: float, delay_s: float = 0.0, *, hold: bool = True) -> ComplexArray:
    """Response (nf,) of a zero-order hold at `rate_hz`, sinc(f/rate) exp(-j pi f/rate), and of a delay.

    Without `hold` the delay alone. What the sampler folds down from above half the rate is neglected.
    """
    f = np.asarray(frequency_hz, dtype=float)
    if not hold:
        return np.asarray(np.exp(-1j * angular(f) * delay_s))
    return np.asarray(np.sinc(f / rate_hz) * np.exp(-1j * angular(f) * (0.5 / rate_hz + delay_s)))


@dataclass(frozen=True, eq=False)
class Controller:
    """Blocks in series for one loop, as they will run: at `rate_hz` after Tustin's rule, in the target's numbers.

    `precision` is that of the coefficients (`Precision`); the sections of `biquads` are rounded to it,
    and `response` is theirs. `prewarp_hz` is the frequency at which Tustin's rule is exact.

    `computation_delay_s` is from sampling to when the output takes effect, and `added_hold` adds the zero-order hold:
    each only as far as the measured plant does not contain it. An FRF from the logged z to the sampled y contains the
    hold, and the delay of the controller under which it was recorded; there `added_hold` would count the hold twice,
    and only what the new controller takes longer is a delay. Both belong to a plant measured as continuous (drive
    voltage to sensor). With `added_hold` |C| and |CS| are those of the held signal: up to 3.9 dB below z at half the
    rate.

    Refuses coefficients outside the range of `precision`, and sections that rounding makes unstable, empty, or robs
    of their integrator. Arithmetic is taken as exact: noise by rounding of signals is not in the response.
    """

    loop: str
    blocks: tuple[Block, ...]
    rate_hz: float
    discretisation: str = "tustin"
    prewarp_hz: float | None = None
    computation_delay_s: float = 0.0
    added_hold: bool = False
    precision: str = "double"
    READ_AS: ClassVar = {"loop": "name", "blocks": "controller"}
    ELSEWHERE: ClassVar = ("rate_hz",)
    WRITTEN: ClassVar = ("discretisation",)

    def __post_init__(self) -> None:
        pass_fields(self, "loop", "blocks")
        object.__setattr__(self, "blocks", tuple(self.blocks))
        refuse_unknown("a discretisation is not known", self.discretisation, ("tustin",))
        rate(self.rate_hz, "a controller's rate")
        if not self.blocks:
            raise WrongUseError(
                f"the controller of loop {self.loop!r} has no block", "an empty list", "give at least a gain"
            )
        _check_timing(self)
        if self.precision != "double":
            self.check_sections()

    def __repr__(self) -> str:
        """One line: its loop, its blocks and its rate."""
        kinds = ", ".join(block.kind for block in self.blocks)
        return f"Controller{f' {self.loop}' if self.loop else ''}: {kinds} at {self.rate_hz:g} Hz"

    def __mul__(self, other: Controller) -> Controller:
        """Both in series, as one controller; times an FRF, the FRF of the open loop. Refuses two that run otherwise.

        >>> import loopshape as ls
        >>> ls.controller(ls.gain(2.0), rate_hz=1000.0) * ls.controller(ls.pi(0.5), rate_hz=1000.0)
        Controller: gain, pi at 1000 Hz
        """
        if not isinstance(other, Controller):
            return NotImplemented
        alike: tuple[str, ...] = ("rate_hz", "discretisation", "prewarp_hz", "added_hold", "precision")
        alike += ("loop",) if self.loop and other.loop else ()
        if differ := [name for name in alike if getattr(self, name) != getattr(other, name)]:
            raise WrongUseError(
                "controllers in series run alike",
                ", ".join(f"{name} = {getattr(self, name)!r} and {getattr(other, name)!r}" for name in differ),
                "give both the same settings",
            )
        return replace(
            self, loop=self.loop or other.loop, blocks=self.blocks + other.blocks,
            computation_delay_s=self.computation_delay_s + other.computation_delay_s,
        )  # fmt: skip

    @property
    def number_format(self) -> Precision:
        """The format of its coefficients."""
        return Precision.of(self.precision)

    @property
    def tustin_constant(self) -> float:
        """k of s = k (z-1)/(z+1) in rad/s."""
        if self.prewarp_hz is None:
            return 2.0 * self.rate_hz
        w = TWO_PI * self.prewarp_hz
        return float(w / np.tan(0.5 * w / self.rate_hz))

    def s_at(self, frequency_hz: ArrayLike) -> ComplexArray:
        """j 2 pi f' with Tustin's warped f'; refuses frequencies at or above half the rate."""
        f = np.asarray(frequency_hz, dtype=float)
        if f.size and f.max() >= 0.5 * self.rate_hz:
            raise WrongUseError(
                f"a controller at {self.rate_hz:g} Hz has no response at or above {0.5 * self.rate_hz:g} Hz",
                f"{f.max():g} Hz",
                "ask below half the rate",
            )
        return np.asarray(1.0j * self.tustin_constant * np.tan(0.5 * TWO_PI * f / self.rate_hz))

    def response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Response (nf,) at `frequency_hz` (nf,) of the controller as it runs, with its delay and added hold."""
        s = self.s_at(frequency_hz)
        if self.precision == "double":
            own = series_response(self.blocks, s)
        else:
            from loopshape.core.kernels import biquads

            own = biquads.response(self.biquads(), angular(frequency_hz) / self.rate_hz)
        return own * self.outside(frequency_hz) if self.computation_delay_s or self.added_hold else own

    def outside(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Response (nf,) of what follows the sections: the computation's delay and the added hold."""
        return hold_and_delay(frequency_hz, self.rate_hz, self.computation_delay_s, hold=self.added_hold)

    def phase_budget(self, frequency_hz: float) -> tuple[tuple[str, float, float], ...]:
        """What each block adds at a frequency: its kind, degrees and dB; last the hold and delay, where it has them.

        Rounded coefficients are left out: `moved_by_rounding` says what they change.
        """
        s = self.s_at([frequency_hz])
        parts = [(block.kind, series_response((block,), s)) for block in self.blocks]
        if self.computation_delay_s or self.added_hold:
            parts.append(("hold and delay", self.outside([frequency_hz])))
        return tuple((kind, float(deg(np.angle(one[0]))), float(db(np.abs(one[0])))) for kind, one in parts)

    def biquads(self) -> Array:
        """Discrete sections (n, 5) as b0, b1, b2, a1, a2 with a0 = 1, by Tustin's rule, rounded to `precision`.

        Where one of a section's two poles is an integrator, a2 is what keeps it at z = 1 to the last digit.
        """
        k = self.tustin_constant
        rows = self.number_format.rounded([_biquad(block.section(), k) for block in self.blocks])
        beside = [block.integrators() == 1 and block.section()[1][2] != 0.0 for block in self.blocks]
        rows[beside, 4] = -1.0 - rows[beside, 3]
        return rows

    def check_sections(self) -> None:
        """Refuse coefficients that the number format does not hold, and sections that rounding ruins.

        Done when the controller is made, but for double: there only a corner far below 1e-7 of the rate is ruined,
        `response` does not show it, and an export asks.
        """
        form, rounded = self.number_format, self.biquads()
        for k, (block, row) in enumerate(zip(self.blocks, rounded, strict=True), start=1):
            where = f"block {k} ({block.kind}) of loop {self.loop!r}"
            for name, value, fits in zip(("b0", "b1", "b2", "a1", "a2"), row, form.fits(row), strict=True):
                if not fits:
                    raise _does_not_fit(f"coefficient {name} of {where}", float(value), rounded, form)
            _check_section(where, block, row, form)

    def integrators(self) -> int:
        """Number of poles at s = 0, less that of zeros there."""
        return sum(block.integrators() for block in self.blocks)

    def order(self) -> int:
        """Number of its poles."""
        return sum(block.order() for block in self.blocks)

    def moved_by_rounding(self) -> float:
        """Largest |C/C' - 1| from 1e-5 to 0.45 of the rate, C' being the controller in double precision."""
        f = np.geomspace(1e-5, 0.45, 400) * self.rate_hz
        return float(np.max(np.abs(self.response(f) / replace(self, precision="double").response(f) - 1.0)))

    @property
    def digest(self) -> str:
        """A short mark of the controller as it runs: sections, precision, rate, delay and hold, not its loop's name."""
        numbers = [
            v.hex() for v in (*self.biquads().ravel().tolist(), float(self.rate_hz), float(self.computation_delay_s))
        ]
        return sha256(" ".join([*numbers, str(self.added_hold), self.precision]).encode()).hexdigest()[:16]


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -TOO_LARGE < value < TOO_LARGE


def _check_timing(c: Controller) -> None:
    if c.prewarp_hz is not None and not (_number(c.prewarp_hz) and 0.0 < c.prewarp_hz < 0.5 * c.rate_hz):
        raise WrongUseError(
            f"prewarp_hz of loop {c.loop!r} must lie above 0 and below half the rate, {0.5 * c.rate_hz:g} Hz",
            received(c.prewarp_hz),
            "name the frequency where the response is to be exact, or leave it out",
        )
    if not (_number(c.computation_delay_s) and c.computation_delay_s >= 0.0):
        raise WrongUseError(
            f"computation_delay_s of loop {c.loop!r} must not be negative", f"{c.computation_delay_s!r}", "give it in s"
        )
    if not isinstance(c.added_hold, bool):
        raise WrongUseError(f"added_hold of loop {c.loop!r} must be true or false", f"{c.added_hold!r}")


def _does_not_fit(what: str, value: float, rounded: Array, form: Precision) -> WrongUseError:
    low, high = form.range
    wider = form.wide_enough(rounded) if form.fixed else None
    return WrongUseError(
        f"{what} does not fit {form.name}",
        f"{value:.6g}, and its range is {low:g} to {high:.10g}",
        f'use "{wider.name}" or more bits' if wider else "use more integer bits, or spread the gain over blocks",
    )


def _check_section(where: str, block: Block, row: Array, form: Precision) -> None:
    """Refuse a rounded section with a pole on or outside the unit circle, without a numerator or its integrator."""
    b0, b1, b2, a1, a2 = row.tolist()
    finer = "use a finer precision, or raise the frequency of the block"
    if b0 == b1 == b2 == 0.0 and any(block.section()[0]):
        raise WrongUseError(f"{where} lets nothing pass", f"a numerator that {form.name} rounds to 0", finer)
    if block.integrators() > 0:
        if b0 + b1 + b2 == 0.0:
            raise WrongUseError(
                f"{where} has lost its integrator", f"a zero that {form.name} rounds onto its pole at z = 1", finer
            )
        if block.integrators() == 1 and not abs(a2) < 1.0:
            raise WrongUseError(f"{where} has a second pole on or outside the unit circle", f"z = {a2:.9g}", finer)
    elif not (abs(a2) < 1.0 and abs(a1) < 1.0 + a2):  # the stability triangle of 1 + a1/z + a2/z²
        radius = float(np.max(np.abs(np.roots([1.0, a1, a2]))))
        raise WrongUseError(
            f"{where} has a pole on or outside the unit circle",
            f"|z| = {radius:.9g} when rounded to {form.name}",
            finer,
        )


def tustin(section: Section, k: float) -> tuple[Polynomial, Polynomial]:
    """A section's discrete numerator and denominator by s = k (z-1)/(z+1): coefficients of 1, 1/z, 1/z².

    Linear in the section's polynomials, as long as their degree stays.
    """
    num, den = section
    if num[2] != 0.0 or den[2] != 0.0:
        return _tustin_polynomial(num, k), _tustin_polynomial(den, k)
    if num[1] != 0.0 or den[1] != 0.0:  # first order: the common factor (z + 1) would stay as a hidden mode at -1
        return (num[0] + k * num[1], num[0] - k * num[1], 0.0), (den[0] + k * den[1], den[0] - k * den[1], 0.0)
    return (num[0], 0.0, 0.0), (den[0], 0.0, 0.0)


def _biquad(section: Section, k: float) -> tuple[float, float, float, float, float]:
    b, a = tustin(section, k)
    return b[0] / a[0], b[1] / a[0], b[2] / a[0], a[1] / a[0], a[2] / a[0]


def _tustin_polynomial(p: Polynomial, k: float) -> Polynomial:
    """p(s)(z + 1)² with s = k (z-1)/(z+1): coefficients of z^2, z^1, z^0."""
    return (
        p[0] + k * p[1] + k * k * p[2],
        2.0 * p[0] - 2.0 * k * k * p[2],
        p[0] - k * p[1] + k * k * p[2],
    )


#: ln of -3 dB
HALF_POWER = -0.5 * float(np.log(2.0))


def controller_grid_hz(rate_hz: float) -> Array:
    """The lines (360,) that C is looked at on: logarithmic, from a millionth of the rate to just below half of it."""
    return np.geomspace(1e-6 * rate_hz, 0.4999 * rate_hz, 360)


def controller_bandwidth_hz(controller: Controller) -> float:
    """Highest frequency in Hz at which |C| is within 3 dB of its largest; half the rate where C does not roll off.

    An integrator's |C| is infinite at zero frequency and says nothing of how high C reaches, so blocks count without
    the integral term of their partial fractions (`pi` as the 1 that it comes to above its corner). Between lines
    ln |C| is linear in ln f. A resonance of C between two lines (4 % apart) is not seen whole.
    """
    f = controller_grid_hz(controller.rate_hz)
    size = np.log(np.abs(series_response(controller.blocks, controller.s_at(f), bounded=True)))
    room = size - (size.max() + HALF_POWER)
    k = int(np.flatnonzero(room >= 0.0)[-1])
    if k == f.size - 1:
        return 0.5 * controller.rate_hz
    return float(f[k] * (f[k + 1] / f[k]) ** (room[k] / (room[k] - room[k + 1])))
