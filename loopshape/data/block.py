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
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, ComplexArray

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


@dataclass(frozen=True)
class BlockKind:
    """What a kind of block is: its parameters, its transfer function, and that function's slopes."""

    parameters: tuple[str, ...]
    section: Callable[[Mapping[str, float]], Section]
    slopes: Callable[[Mapping[str, float]], dict[str, Section]]
    order: int | None = None


BLOCK_KINDS: dict[str, BlockKind] = {
    "gain": BlockKind(("gain",), _gain, _gain_slopes),
    "lead_lag": BlockKind(("f1_hz", "f2_hz"), _lead_lag, _lead_lag_slopes),
    "notch": BlockKind(("f1_hz", "f2_hz", "damping1", "damping2"), _notch, _notch_slopes),
    "low_pass_1": BlockKind(("f_hz",), _low_pass_1, _low_pass_1_slopes, order=1),
    "low_pass_2": BlockKind(("f_hz", "damping"), _low_pass_2, _low_pass_2_slopes, order=2),
    "pi": BlockKind(("f_hz",), _pi, _pi_slopes),
}


def block_kind(table: Mapping[str, Any]) -> str:
    """Internal kind of a block written as in a run's TOML (`low_pass` carries its order)."""
    kind = table.get("kind")
    name = f"low_pass_{table.get('order', '?')}" if kind == "low_pass" else kind
    if name not in BLOCK_KINDS or (kind != "low_pass" and "order" in table):
        raise WrongUseError(
            "a controller block is not known",
            f"{dict(table)!r}",
            "use kind gain, lead_lag, notch, pi, or low_pass with order 1 or 2",
        )
    return str(name)


@dataclass(frozen=True)
class Block:
    """One block of a controller: an internal kind (`low_pass_2`, not `low_pass`) and its parameters."""

    kind: str
    parameters: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.kind not in BLOCK_KINDS:
            raise WrongUseError(
                "a controller block is not known", f"{self.kind!r}", f"use one of {', '.join(BLOCK_KINDS)}"
            )
        wanted = BLOCK_KINDS[self.kind].parameters
        if set(self.parameters) != set(wanted):
            raise WrongUseError(
                f"a {self.kind} block has the parameters {', '.join(wanted)}",
                ", ".join(sorted(self.parameters)) or "none",
                "name each once and no other",
            )
        values = {name: _finite(self.kind, name, self.parameters[name]) for name in wanted}
        object.__setattr__(self, "parameters", MappingProxyType(values))

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
        order = BLOCK_KINDS[self.kind].order
        head: dict[str, Any] = {"kind": "low_pass", "order": order} if order is not None else {"kind": self.kind}
        return head | dict(self.parameters)

    def section(self) -> Section:
        """Numerator and denominator, coefficients of s^0, s^1, s^2."""
        return BLOCK_KINDS[self.kind].section(self.parameters)

    def order(self) -> int:
        """Degree of the denominator, or of the numerator where that is higher: the poles of the block as it runs."""
        return max(k for polynomial in self.section() for k, c in enumerate(polynomial) if c != 0.0 or k == 0)

    def log_slopes(self, s: ComplexArray) -> dict[str, ComplexArray]:
        """d log(block)/d parameter at each s, exact; keys are the block's parameters."""
        num, den = (_polyval(p, s) for p in self.section())
        slopes = BLOCK_KINDS[self.kind].slopes(self.parameters)
        return {name: _polyval(dn, s) / num - _polyval(dd, s) / den for name, (dn, dd) in slopes.items()}


def series_response(blocks: Sequence[Block], s: ComplexArray) -> ComplexArray:
    """Response (ns,) of blocks in series at complex frequencies s (ns,)."""
    out = np.ones_like(s)
    for block in blocks:
        num, den = block.section()
        out = out * _polyval(num, s) / _polyval(den, s)
    return out


def refuse_too_large(kind: str, name: str, value: float) -> None:
    """Refuse a parameter beyond what can be computed with: 1e9 Hz for a frequency, 1e100 for any other."""
    largest, unit = (_LARGEST_HZ, " Hz") if name.endswith("_hz") else (_LARGEST, "")
    if abs(value) > largest:
        received = repr(value) if isinstance(value, float) else "a longer whole number"
        raise WrongUseError(
            f"{name} of a {kind} block must not exceed {largest:g}{unit} in magnitude", received, "check its unit"
        )


def _finite(kind: str, name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < np.inf:
        raise WrongUseError(f"{name} of a {kind} block must be a finite number", f"{value!r}", "write a plain number")
    refuse_too_large(kind, name, value)
    if name != "gain" and not (value > 0.0 or (name == "damping1" and value == 0.0)):
        raise WrongUseError(f"{name} of a {kind} block must be positive", f"{value!r}", "give a positive number")
    return float(value)


def _polyval(p: Polynomial, s: ComplexArray) -> ComplexArray:
    return p[0] + s * (p[1] + s * p[2])


@dataclass(frozen=True)
class Free:
    """A parameter that tuning may move between `low` and `high`, starting at `start` where given."""

    low: float
    high: float
    start: float | None = None


@dataclass(frozen=True, eq=False)
class BlockTemplate:
    """A block whose parameters are fixed numbers or `Free`; `tie` names parameters kept equal to another."""

    kind: str
    parameters: Mapping[str, float | Free]
    tie: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> BlockTemplate:
        """Template from TOML: a number fixes, `{ min, max, start }` frees, `"f1_hz"` ties to another."""
        kind = block_kind(table)
        names = BLOCK_KINDS[kind].parameters
        given = {k: v for k, v in table.items() if k not in ("kind", "order")}
        if set(given) != set(names):
            raise WrongUseError(
                f"a {kind} block has the parameters {', '.join(names)}", ", ".join(sorted(given)) or "none"
            )
        tie = {k: v for k, v in given.items() if isinstance(v, str)}
        for name, target in tie.items():
            if target not in names or target == name or target in tie:
                raise WrongUseError(f"{name} of a {kind} block is tied to nothing", f"{target!r}")
        return cls(kind, {k: _free_or_fixed(kind, k, v) for k, v in given.items() if k not in tie}, tie)

    def block(self, values: Mapping[str, float]) -> Block:
        """Block with the free parameters at `values`."""
        known = {k: (values[k] if isinstance(v, Free) else v) for k, v in self.parameters.items()}
        return Block(self.kind, known | {k: known[target] for k, target in self.tie.items()})


def _free_or_fixed(kind: str, name: str, value: Any) -> float | Free:
    if not isinstance(value, Mapping):
        return float(value)
    if not {"min", "max"} <= set(value) <= {"min", "max", "start"}:
        raise WrongUseError(
            f"{name} of a {kind} block is a number or a table with min, max and perhaps start",
            f"{dict(value)!r}",
        )
    low, high, start = float(value["min"]), float(value["max"]), value.get("start")
    if not 0.0 < low < high < np.inf or (start is not None and not low <= start <= high):
        raise WrongUseError(f"{name} of a {kind} block needs 0 < min < max, and start between them", f"{dict(value)!r}")
    refuse_too_large(kind, name, high)
    return Free(low, high, None if start is None else float(start))
