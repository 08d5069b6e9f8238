"""Blocks of a controller, and what they are in s.

Transfer functions, w = 2 pi f (source: appendix H.1 of van den Brink, DCT 2007.002):

| kind | parameters | transfer function |
|---|---|---|
| gain | gain | gain |
| lead_lag | f1_hz, f2_hz | (s/w1 + 1)/(s/w2 + 1) |
| notch | f1_hz, f2_hz, damping1, damping2 | (s²/w1² + 2 b1 s/w1 + 1)/(s²/w2² + 2 b2 s/w2 + 1), tilted where f1 != f2 |
| low_pass, order 1 | f_hz | 1/(s/w + 1) |
| low_pass, order 2 | f_hz, damping | 1/(s²/w² + 2 b s/w + 1) |
| pi | f_hz | (s + w)/s |
| pid | gain, fi_hz, fd_hz, ff_hz | gain (1 + wi/s + (s/wd)/(s/wf + 1)) |
| section | n0, n1, n2, d0, d1, d2 | (n0 + n1 s + n2 s²)/(d0 + d1 s + d2 s²), s in rad/s |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError, an, meant, refuse_unknown
from loopshape.core.units import TWO_PI, Array, ComplexArray

Polynomial = tuple[float, float, float]  # coefficients of s^0, s^1, s^2
Section = tuple[Polynomial, Polynomial]

#: largest frequency and largest magnitude of any other parameter: their powers stay finite numbers
_LARGEST_HZ, _LARGEST = 1e9, 1e100

_ONE: Polynomial = (1.0, 0.0, 0.0)
_ZERO: Polynomial = (0.0, 0.0, 0.0)


def _quadratic(f_hz: float, damping: float) -> Polynomial:
    w = TWO_PI * f_hz
    return (1.0, 2.0 * damping / w, 1.0 / w**2)


def _quadratic_by_f(f_hz: float, damping: float) -> Polynomial:
    w = TWO_PI * f_hz
    return (0.0, -2.0 * damping / (w * f_hz), -2.0 / (w**2 * f_hz))


def _quadratic_by_damping(f_hz: float) -> Polynomial:
    return (0.0, 2.0 / (TWO_PI * f_hz), 0.0)


def _gain(p: Mapping[str, float]) -> Section:
    return (p["gain"], 0.0, 0.0), _ONE


def _gain_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    return {"gain": (_ONE, _ZERO)}


def _lead_lag(p: Mapping[str, float]) -> Section:
    return (1.0, 1.0 / (TWO_PI * p["f1_hz"]), 0.0), (1.0, 1.0 / (TWO_PI * p["f2_hz"]), 0.0)


def _lead_lag_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    return {
        "f1_hz": ((0.0, -1.0 / (TWO_PI * p["f1_hz"] ** 2), 0.0), _ZERO),
        "f2_hz": (_ZERO, (0.0, -1.0 / (TWO_PI * p["f2_hz"] ** 2), 0.0)),
    }


def _notch(p: Mapping[str, float]) -> Section:
    return _quadratic(p["f1_hz"], p["damping1"]), _quadratic(p["f2_hz"], p["damping2"])


def _notch_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    return {
        "f1_hz": (_quadratic_by_f(p["f1_hz"], p["damping1"]), _ZERO),
        "f2_hz": (_ZERO, _quadratic_by_f(p["f2_hz"], p["damping2"])),
        "damping1": (_quadratic_by_damping(p["f1_hz"]), _ZERO),
        "damping2": (_ZERO, _quadratic_by_damping(p["f2_hz"])),
    }


def _low_pass_1(p: Mapping[str, float]) -> Section:
    return _ONE, (1.0, 1.0 / (TWO_PI * p["f_hz"]), 0.0)


def _low_pass_1_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    return {"f_hz": (_ZERO, (0.0, -1.0 / (TWO_PI * p["f_hz"] ** 2), 0.0))}


def _low_pass_2(p: Mapping[str, float]) -> Section:
    return _ONE, _quadratic(p["f_hz"], p["damping"])


def _low_pass_2_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    return {
        "f_hz": (_ZERO, _quadratic_by_f(p["f_hz"], p["damping"])),
        "damping": (_ZERO, _quadratic_by_damping(p["f_hz"])),
    }


def _pi(p: Mapping[str, float]) -> Section:
    return (TWO_PI * p["f_hz"], 1.0, 0.0), (0.0, 1.0, 0.0)


def _pi_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    return {"f_hz": ((TWO_PI, 0.0, 0.0), _ZERO)}


def _pid(p: Mapping[str, float]) -> Section:
    (n0, n1, n2), den = _pid_of_gain_one(p)
    return (p["gain"] * n0, p["gain"] * n1, p["gain"] * n2), den


def _pid_of_gain_one(p: Mapping[str, float]) -> Section:
    wi, tame, derivative = TWO_PI * p["fi_hz"], 1.0 / (TWO_PI * p["ff_hz"]), 1.0 / (TWO_PI * p["fd_hz"])
    return (wi, 1.0 + wi * tame, tame + derivative), (0.0, 1.0, tame)


def _pid_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    gain, wi = p["gain"], TWO_PI * p["fi_hz"]
    tame, by_ff = 1.0 / (TWO_PI * p["ff_hz"]), -1.0 / (TWO_PI * p["ff_hz"] ** 2)
    return {
        "gain": (_pid_of_gain_one(p)[0], _ZERO),
        "fi_hz": ((gain * TWO_PI, gain * TWO_PI * tame, 0.0), _ZERO),
        "fd_hz": ((0.0, 0.0, -gain / (TWO_PI * p["fd_hz"] ** 2)), _ZERO),
        "ff_hz": ((0.0, gain * wi * by_ff, gain * by_ff), (0.0, 0.0, by_ff)),
    }


_COEFFICIENTS = ("n0", "n1", "n2", "d0", "d1", "d2")


def _section(p: Mapping[str, float]) -> Section:
    return (p["n0"], p["n1"], p["n2"]), (p["d0"], p["d1"], p["d2"])


def _section_slopes(p: Mapping[str, float]) -> dict[str, Section]:
    units: tuple[Polynomial, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    top = {f"n{k}": (one, _ZERO) for k, one in enumerate(units)}
    return top | {f"d{k}": (_ZERO, one) for k, one in enumerate(units)}


def _refuse_section(p: Mapping[str, float]) -> None:
    """Refuse what cannot run: no numerator, more zeros than poles, a common zero and pole at s = 0, unstable poles."""
    num, den = _section(p)
    if not any(num) or not any(den):
        raise WrongUseError("a section needs a numerator and a denominator", f"{num} over {den}")
    if _degree(num) > _degree(den):
        raise WrongUseError(
            "a section with more zeros than poles cannot run (it is improper)", f"{num} over {den}",
            "add a pole far above the band",
        )  # fmt: skip
    if num[0] == den[0] == 0.0:
        raise WrongUseError("a section has a zero and a pole at s = 0", f"{num} over {den}", "cancel the factor s")
    poles = np.roots(den[::-1])
    rest = poles[poles != 0.0]
    if rest.size and float(rest.real.max()) >= 0.0:
        shown = ", ".join(f"{pole:.4g}" for pole in rest)
        raise WrongUseError(
            "a section of a controller must be stable", f"poles at {shown} rad/s", "integrators at s = 0 may stay"
        )


def _degree(p: Polynomial) -> int:
    return max((k for k, c in enumerate(p) if c != 0.0), default=0)


@dataclass(frozen=True)
class BlockKind:
    """What a kind of block is: its parameters, its transfer function, and that function's slopes.

    `signed` are the parameters that need not be positive; `refuse` refuses what each parameter alone does not show.
    """

    parameters: tuple[str, ...]
    section: Callable[[Mapping[str, float]], Section]
    slopes: Callable[[Mapping[str, float]], dict[str, Section]]
    order: int | None = None
    signed: tuple[str, ...] = ()
    refuse: Callable[[Mapping[str, float]], None] | None = None


BLOCK_KINDS: dict[str, BlockKind] = {
    "gain": BlockKind(("gain",), _gain, _gain_slopes, signed=("gain",)),
    "lead_lag": BlockKind(("f1_hz", "f2_hz"), _lead_lag, _lead_lag_slopes),
    "notch": BlockKind(("f1_hz", "f2_hz", "damping1", "damping2"), _notch, _notch_slopes),
    "low_pass_1": BlockKind(("f_hz",), _low_pass_1, _low_pass_1_slopes, order=1),
    "low_pass_2": BlockKind(("f_hz", "damping"), _low_pass_2, _low_pass_2_slopes, order=2),
    "pi": BlockKind(("f_hz",), _pi, _pi_slopes),
    "pid": BlockKind(("gain", "fi_hz", "fd_hz", "ff_hz"), _pid, _pid_slopes, signed=("gain",)),
    "section": BlockKind(_COEFFICIENTS, _section, _section_slopes, signed=_COEFFICIENTS, refuse=_refuse_section),
}


def block_kind(table: Mapping[str, Any]) -> str:
    """Internal kind of a block written as in a run's TOML (`low_pass` carries its order)."""
    kind = table.get("kind")
    name = f"low_pass_{table.get('order', '?')}" if kind == "low_pass" else kind
    if not isinstance(name, str) or name not in BLOCK_KINDS or (kind != "low_pass" and "order" in table):
        raise WrongUseError(
            "a controller block is not known",
            f"{dict(table)!r}",
            f"{meant(kind, ('low_pass', *BLOCK_KINDS))}use kind, a text: gain, lead_lag, notch, pi, pid, section, or"
            " low_pass with order 1 or 2",
        )
    return str(name)


@dataclass(frozen=True)
class Block:
    """One block of a controller: an internal kind (`low_pass_2`, not `low_pass`) and its parameters."""

    kind: str
    parameters: Mapping[str, float]

    def __post_init__(self) -> None:
        refuse_unknown("a controller block is not known", self.kind, BLOCK_KINDS, "use one of")
        wanted = BLOCK_KINDS[self.kind].parameters
        if set(self.parameters) != set(wanted):
            raise WrongUseError(
                f"{an(self.kind)} block has the parameters {', '.join(wanted)}",
                ", ".join(sorted(self.parameters)) or "none",
                "name each once and no other",
            )
        values = {name: _finite(self.kind, name, self.parameters[name]) for name in wanted}
        object.__setattr__(self, "parameters", MappingProxyType(values))
        if (refuse := BLOCK_KINDS[self.kind].refuse) is not None:
            refuse(values)

    def __reduce__(self) -> tuple[type, tuple[str, dict[str, float]]]:
        """As another process is sent it."""
        return type(self), (self.kind, dict(self.parameters))

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Block:
        """Block from a TOML table such as `{ kind = "low_pass", order = 1, f_hz = 10.0 }`."""
        kind = block_kind(table)
        return cls(kind, {k: v for k, v in table.items() if k not in ("kind", "order")})

    def to_table(self) -> dict[str, Any]:
        """The TOML table of this block, as `from_table` reads it."""
        return _head(self.kind) | dict(self.parameters)

    def section(self) -> Section:
        """Numerator and denominator, coefficients of s^0, s^1, s^2."""
        return BLOCK_KINDS[self.kind].section(self.parameters)

    def order(self) -> int:
        """Degree of the denominator, or of the numerator where that is higher: the poles of the block as it runs."""
        return max(_degree(polynomial) for polynomial in self.section())

    def integrators(self) -> int:
        """Number of poles at s = 0, below zero of zeros there."""
        num, den = (next((k for k, c in enumerate(p) if c != 0.0), 0) for p in self.section())
        return den - num

    def bounded_section(self) -> Section:
        """The section without the integral term of its partial fractions; 1 where it is nothing else."""
        num, den = self.section()
        if den[0] != 0.0:
            return num, den
        rest = (0.0, num[1] - num[0] * den[2] / den[1] if den[1] != 0.0 else 0.0, num[2])
        return (_lowered(rest, den), _lowered(den, den)) if any(rest) else (_ONE, _ONE)

    def log_slopes(self, s: ComplexArray, *, bounded: bool = False) -> dict[str, ComplexArray]:
        """d log(block)/d parameter at each s, exact, by parameter; of the `bounded_section` where that is asked."""
        section, slopes = self.section(), BLOCK_KINDS[self.kind].slopes(self.parameters)
        if bounded and section[1][0] == 0.0:
            slopes = {name: _bounded_slope(section, slope) for name, slope in slopes.items()}
            section = self.bounded_section()
        num, den = (_polyval(p, s) for p in section)
        return {name: _polyval(dn, s) / num - _polyval(dd, s) / den for name, (dn, dd) in slopes.items()}


def _head(kind: str) -> dict[str, Any]:
    """The keys by which a table is known as a block of this kind."""
    order = BLOCK_KINDS[kind].order
    return {"kind": kind} if order is None else {"kind": "low_pass", "order": order}


def _lowered(p: Polynomial, den: Polynomial) -> Polynomial:
    """A polynomial without the factors s that it has in common with a denominator of integrators."""
    return (p[1], p[2], 0.0) if den[1] != 0.0 else (p[2], 0.0, 0.0)


def _bounded_slope(section: Section, slope: Section) -> Section:
    """Slope of the section without its integral term."""
    ((n0, _, _), den), ((dn0, dn1, dn2), dd) = section, slope
    _, d1, d2 = den
    if d1 == 0.0:
        return _lowered((0.0, 0.0, dn2), den), _lowered(dd, den)
    ratio, moved = d2 / d1, dd[2] / d1 - d2 * dd[1] / d1**2
    return _lowered((0.0, dn1 - dn0 * ratio - n0 * moved, dn2), den), _lowered(dd, den)


def series_response(blocks: Sequence[Block], s: ComplexArray, *, bounded: bool = False) -> ComplexArray:
    """Response (...) of blocks in series at complex frequencies s (...); without integral terms where `bounded`."""
    from loopshape.core.kernels.loops.flat_loops import series

    return series(coefficients(blocks, bounded=bounded), s.ravel()).reshape(s.shape)


def coefficients(blocks: Sequence[Block], *, bounded: bool = False) -> Array:
    """Coefficients of blocks (blocks, 6): s^0, s^1, s^2 of the numerator, and of the denominator."""
    sections = (block.bounded_section() if bounded else block.section() for block in blocks)
    return np.array([(*num, *den) for num, den in sections], dtype=float).reshape(-1, 6)


def refuse_too_large(kind: str, name: str, value: float) -> None:
    """Refuse a parameter beyond what can be computed with: 1e9 Hz for a frequency, 1e100 for any other."""
    largest, unit = (_LARGEST_HZ, " Hz") if name.endswith("_hz") else (_LARGEST, "")
    if abs(value) > largest:
        received = repr(value) if isinstance(value, float) else "a longer whole number"
        raise WrongUseError(
            f"{name} of {an(kind)} block must not exceed {largest:g}{unit} in magnitude", received, "check its unit"
        )


def _finite(kind: str, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < np.inf:
        raise WrongUseError(f"{name} of {an(kind)} block must be a finite number", f"{value!r}", "write a plain number")
    refuse_too_large(kind, name, value)
    if name not in BLOCK_KINDS[kind].signed and not (value > 0.0 or (name == "damping1" and value == 0.0)):
        raise WrongUseError(f"{name} of {an(kind)} block must be positive", f"{value!r}", "give a positive number")
    return float(value)


def _polyval(p: Polynomial, s: ComplexArray) -> ComplexArray:
    return p[0] + s * (p[1] + s * p[2])


@dataclass(frozen=True)
class Free:
    """A parameter that tuning may move between `low` and `high`, starting at `start` where given."""

    low: float
    high: float
    start: float | None = None

    def to_table(self) -> dict[str, float]:
        """{ min, max, start } of a template's table, nothing where it is open."""
        if self == OPEN:
            return {}
        ends = {"min": self.low, "max": self.high}
        return ends if self.start is None else ends | {"start": self.start}


#: a parameter that tuning may move as far as the plants' frequencies and gains make sense
OPEN = Free(0.0, np.inf)


@dataclass(frozen=True, eq=False)
class BlockTemplate:
    """A block whose parameters are fixed numbers or `Free`; `tie` names parameters kept equal to another."""

    kind: str
    parameters: Mapping[str, float | Free]
    tie: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> BlockTemplate:
        """Template from TOML: a number fixes, `{ min, max, start }` frees, `{}` leaves open, `"f1_hz"` ties."""
        kind = block_kind(table)
        names = BLOCK_KINDS[kind].parameters
        given = {k: v for k, v in table.items() if k not in ("kind", "order")}
        if set(given) != set(names):
            raise WrongUseError(
                f"{an(kind)} block has the parameters {', '.join(names)}", ", ".join(sorted(given)) or "none",
                f"give each: {names[0]} = 1.0 fixes it, {{ min, max }} bounds it, {{}} leaves the bounds to the plant",
            )  # fmt: skip
        tie = {k: v for k, v in given.items() if isinstance(v, str)}
        for name, target in tie.items():
            if target not in names or target == name or target in tie:
                raise WrongUseError(f"{name} of {an(kind)} block is tied to nothing", f"{target!r}")
        return cls(kind, {k: _free_or_fixed(kind, k, v) for k, v in given.items() if k not in tie}, tie)

    def to_table(self) -> dict[str, Any]:
        """The TOML table of this template, as `from_table` reads it."""
        own = {k: v.to_table() if isinstance(v, Free) else v for k, v in self.parameters.items()}
        return _head(self.kind) | own | dict(self.tie)

    def block(self, values: Mapping[str, float]) -> Block:
        """Block with the free parameters at `values`."""
        known = {k: (values[k] if isinstance(v, Free) else v) for k, v in self.parameters.items()}
        return Block(self.kind, known | {k: known[target] for k, target in self.tie.items()})

    def integrators(self) -> int:
        """Number of the block's poles at s = 0, below zero of zeros there, whatever its free parameters are."""
        return self.block({k: v.low for k, v in self.parameters.items() if isinstance(v, Free)}).integrators()


def _free_or_fixed(kind: str, name: str, value: Any) -> float | Free:
    if not isinstance(value, Mapping):
        return _finite(kind, name, value)
    if not value:
        return OPEN
    if not {"min", "max"} <= set(value) <= {"min", "max", "start"}:
        raise WrongUseError(
            f"{name} of {an(kind)} block is a number or a table with min, max, perhaps start", f"{dict(value)!r}"
        )
    ends = {key: _finite(kind, name, one) for key, one in value.items()}
    low, high, start = ends["min"], ends["max"], ends.get("start")
    if not 0.0 < low < high < np.inf or (start is not None and not low <= start <= high):
        raise WrongUseError(f"{name} of {an(kind)} block needs 0 < min < max, start between them", f"{dict(value)!r}")
    return Free(low, high, start)
