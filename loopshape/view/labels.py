"""How names, units, operating points and methods of estimates are written on paper."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from loopshape.core.errors import WrongUseError
from loopshape.core.units import SUFFIXES, TWO_PI
from loopshape.data.response.frf import FRF
from loopshape.data.signal.channel import Channel, sum_terms

if TYPE_CHECKING:
    from loopshape.data.response.model import Estimate, Fit

_GREEK = ("theta", "kappa", "zeta", "omega", "phi", "psi", "alpha", "beta", "gamma", "delta", "tau")
#: times the highest line from which on a real root is not told from one at infinity
FAR = 10.0
_USER_SUFFIXES = {"_deg": "deg", "_hz": "Hz", "_kg": "kg"}


def split_unit(column: str) -> tuple[str, str]:
    """Name and unit as written: `theta1_deg` is ("theta1", "deg"); no unit is ""."""
    for suffix, unit in _USER_SUFFIXES.items():
        if column.endswith(suffix):
            return column[: -len(suffix)], unit
    try:
        channel = Channel.from_column(column)
    except WrongUseError:
        return column, ""
    return channel.name, SUFFIXES[channel.unit]


def symbol(name: str) -> str:
    """`theta1` as a Greek letter with its index, `p_ab` as p with index AB; other words stay."""
    if match := re.fullmatch(rf"(?:(\w)_)?({'|'.join(_GREEK)})_?(\d*)", name):
        lead, letter, index = match.groups()
        inner = rf"\{letter}" + (f"_{{{index}}}" if index else "")
        return f"${lead}_{{{inner}}}$" if lead else f"${inner}$"
    if match := re.fullmatch(r"(\w)_([a-z]{1,2})|([a-z])(\d)", name):
        base, index = (match[1], match[2].upper()) if match[1] else (match[3], match[4])
        return f"${base}_{{{index}}}$"
    if match := re.fullmatch(r"(\w)_(\w)_([a-z]{1,2})", name):
        return f"${match[1]}_{{{match[2]},{match[3].upper()}}}$"
    return name.replace("_", " ")


def bracket(unit: str) -> str:
    """A unit in brackets, "" for none."""
    return f" [{unit}]" if unit and unit != "1" else ""


def quantity(column: str) -> str:
    """Symbol and unit of a column or operating-point key, as an axis shows them."""
    name, unit = split_unit(column)
    return symbol(name) + bracket(unit)


def expression(terms: str) -> str:
    """Symbols of a column or a sum of columns, without the unit."""
    return " + ".join(symbol(split_unit(term)[0]) for term in sum_terms(terms))


def unit_of(terms: str) -> str:
    """Unit of a column or a sum of columns, "1" where the name carries none."""
    try:
        return split_unit(sum_terms(terms)[0])[1] or "1"
    except WrongUseError:
        return "1"


def ratio(numerator: str, denominator: str) -> str:
    """Unit of a quotient: "rad/V", "1/V", "rad", "" for a plain number."""
    if numerator == denominator:
        return ""
    return numerator if denominator == "1" else f"{numerator}/{_wrapped(denominator)}"


def _wrapped(unit: str) -> str:
    return f"({unit})" if "/" in unit or " " in unit else unit


def product(first: str, second: str) -> str:
    """Unit of a product: "V rad", "V²"."""
    if first == second:
        return "1" if first == "1" else f"{_wrapped(first)}²"
    return " ".join(_wrapped(unit) for unit in (first, second) if unit != "1")


def units_of(frf: FRF) -> tuple[str, str]:
    """Units of a 1 x 1 FRF's input and output."""
    return unit_of(frf.inputs[0]), unit_of(frf.outputs[0])


def decibel(what: str, unit: str) -> str:
    """Axis label of a magnitude in dB; the reference is one of `unit`."""
    return f"{what} [dB re {unit}]" if unit else f"{what} [dB]"


def point(operating_point: Mapping[str, float]) -> str:
    """An operating point in words, to four figures: "θ2 = -30 deg, p_AB = 0.8 bar"; "" where there is none."""
    parts = []
    for key, value in operating_point.items():
        name, unit = split_unit(key)
        parts.append(f"{symbol(name)} = {number(float(f'{value:.4g}'))} {'' if unit == '1' else unit}".rstrip())
    return ", ".join(parts)


def superscripts(unit: str) -> str:
    """`rad/(V s3)` with raised exponents."""
    return re.sub(r"(?<=[A-Za-z])\^?([23])", lambda m: {"2": "²", "3": "³"}[m[1]], unit)


def number(value: float) -> str:
    """A number with a true minus sign."""
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def numbers(values: Sequence[float]) -> list[str]:
    """Numbers with as many decimals as the longest of them needs (at most 3): 0.8, 1.0, 1.2."""
    decimals = max((len(f"{v:.3f}".rstrip("0").split(".")[1]) for v in values), default=0)
    return [f"{v + 0.0:.{decimals}f}".replace("-", "\N{MINUS SIGN}") for v in values]


#: what each number of a method says, in the order of the sentence
_PHRASES = {
    "sweep_s": ("local fits of sweeps of {} s", ".4g"),
    "rationals_percent": ("{} % rationals", ".0f"),
    "record_s": ("local fits of records of {} s", ".4g"),
    "resolution_hz": ("frequencies {} Hz apart", ".3g"),
    "segment_s": ("Welch, segments of {} s", ".4g"),
    "averages": ("{} averages", ".1f"),
    "periods": ("{} periods", ".0f"),
    "period_s": ("of {} s", ".4g"),
    "realisations": ("{} realisations", ".0f"),
}


def method_in_short(frfs: Sequence[FRF]) -> str:
    """How FRFs were measured: the sentence that all share, else one with the ranges of its numbers for each kind.

    Kinds are told apart by which numbers a method has; methods without numbers, as those of other programs, are
    counted. Estimator and sweep's harmonics stand in each `FRF.method` alone.
    """
    if len({frf.method for frf in frfs}) < 2:
        return frfs[0].method if frfs else ""
    kinds: dict[tuple[str, ...], list[FRF]] = {}
    for frf in frfs:
        kinds.setdefault(tuple(name for name in _PHRASES if name in frf.method_numbers), []).append(frf)
    return "; ".join(_kind(names, mine) for names, mine in kinds.items())


def methods_by_loop(frfs: Sequence[FRF]) -> list[str]:
    """The same, a line for each loop; one for all where all share it."""
    if len({frf.method for frf in frfs}) < 2:
        return [frfs[0].method] if frfs else []
    loops = dict.fromkeys(frf.loop for frf in frfs)
    return [f"{loop}: ".lstrip(": ") + method_in_short([frf for frf in frfs if frf.loop == loop]) for loop in loops]


def _kind(names: Sequence[str], frfs: Sequence[FRF]) -> str:
    count, methods = f"{len(frfs)} estimate{'s' * (len(frfs) > 1)}", {frf.method for frf in frfs}
    if len(methods) == 1:
        return f"{count}: {methods.pop()}"
    if not names:
        return f"{count} by {len(methods)} methods"
    phrases = [_phrase(name, [frf.method_numbers[name] for frf in frfs]) for name in names]
    return f"{count}: {', '.join(phrases)}".replace(" periods, of", " periods of")


def _phrase(name: str, values: Sequence[float]) -> str:
    text, form = _PHRASES[name]
    ends = dict.fromkeys((format(min(values), form), format(max(values), form)))
    return text.format("-".join(ends))


def parameter_text(fit: Fit, p: Estimate) -> str:
    """A parameter with its 95 % interval; a delay that turns no line's phase is none."""
    no_delay_rad = 1e-6  # phase in rad at the highest line that a delay must turn to be one
    if p.name == "delay_s" and abs(p.value) * TWO_PI * fit.band_hz[1] < no_delay_rad:
        return "none"
    return plus_minus(p.value, 1.96 * p.std)


def plus_minus(value: float, half_width: float) -> str:
    """A value and the half width of its interval to the same decimal: two figures of the half width (GUM, 7.2.6)."""
    if not 0.0 < half_width < math.inf:
        return f"{value:.5g} ± {half_width:.2g}"
    power = 0 if 1e-7 <= half_width < 1e6 else math.floor(math.log10(max(abs(value), half_width)))
    places = max(0, 1 + power - math.floor(math.log10(half_width)))
    text = f"{value / 10.0**power:.{places}f} ± {half_width / 10.0**power:.{places}f}"
    return f"({text})e{power:+d}" if power else text


def root_rows(fit: Fit) -> list[list[str | None]]:
    """Recording, loop, name and cells of each zero and pole of a rational fit."""
    from loopshape.identify.fit import modes

    found = modes(fit)
    pairs = zip(found[::2], found[1::2], strict=True)
    return [
        [fit.recording, fit.loop, f.name.removesuffix("_f_hz"), *root_cells(f, d, fit.band_hz[1])] for f, d in pairs
    ]


def root_cells(frequency: Estimate, damping: Estimate, highest_hz: float) -> list[str | None]:
    """Frequency, damping and time constant of a root as cells; of a real one the time constant alone.

    A real root that the lines up to `highest_hz` do not tell from one at infinity has a bound in place of a value.
    """
    if abs(damping.value) < 1.0 - 1e-9:
        cells = [plus_minus(e.value, 1.96 * e.std) for e in (frequency, damping)]
        return [cells[0] + ", above the measured frequencies" * (frequency.value > highest_hz), cells[1], None]
    side = "" if damping.value > 0.0 else ", right half plane"
    constant = 1.0 / (TWO_PI * frequency.value)
    if frequency.value > FAR * highest_hz:
        return [None, None, f"below {1.0 / (TWO_PI * highest_hz):.2g}, above the measured frequencies{side}"]
    if not 1.96 * frequency.std < frequency.value:
        return [None, None, f"about {constant:.2g}, not known{side}"]
    return [None, None, plus_minus(constant, 1.96 * constant * frequency.std / frequency.value) + side]
