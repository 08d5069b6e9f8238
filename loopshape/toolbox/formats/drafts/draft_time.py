"""The time of a file that has no map: its stamps, their unit and rate, or a rate that is written in it.

What the stamps do not tell (steps of 1: s, ms or rows?) is asked; a column of frequencies is no time, but a spectrum.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import UNITS, Array
from loopshape.io.stamps import ON_GRID, read_stamps
from loopshape.toolbox.formats.drafts.column_words import is_time, role_weights, unit_of_word, words_of
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF
from loopshape.toolbox.formats.tables.sources import Place
from loopshape.toolbox.formats.tables.text_layout import TextLayout

_RATE_WORDS = re.compile(
    r"(?<!baud )(?<!bit )(?<!flow )(?<!feed )(?<!slew )(?<!frame )(?<!data )"
    r"\b(fs|rate|rate_hz|sample[ _]?rate|sampling[ _]?rate|sampling[ _]?frequency|abtastrate|f_?s)\b[^0-9\n]{0,12}"
    r"([0-9]+(?:[.,][0-9]+)?(?:e[+-]?[0-9]+)?)\s*(?:([km]?)(?:hz|sa?/s|sps|samples?/s)\b|(?![a-z0-9%°/.]))",
    re.IGNORECASE,
)
_PERIOD_WORDS = re.compile(
    r"\b(ts|dt|sample[ _]?time|sampling[ _]?time|sampling[ _]?interval|sample[ _]?interval|increment|delta[ _]x"
    r"|hresolution|abtastzeit|cycle ?time|zykluszeit)\b([^0-9\n]{0,12})([0-9]+(?:[.,][0-9]+)?(?:e[+-]?[0-9]+)?)"
    r"(?![0-9])[\s,;]*(us|µs|ms|s)?(?!\s*[a-zµ°/%])",
    re.IGNORECASE,
)
#: a round rate this near (relative) is the nominal one: files of one rig, each by its own clock, make one run
_NOMINAL = 5e-4
_FREQUENCY = {"freq", "frequency", "frequencies", "frequenz", "omega", "hz", "f"}
_PER_TIME = {"hz", "khz", "mhz", "rad/s", "rad/sec"}
_SECONDS = ("s", "ms", "us", "ns")
#: longer units of stamps, in s
_LONG = {
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86400.0),
}
_ABSCISSA = {("x",), ("x", "value"), ("x", "axis")}  # what scopes call the time
_IN_BRACKETS = re.compile(r"[\[(](us|µs|ms|s)[\])]")


@dataclass(frozen=True)
class Column:
    """A signal of the file: its name there, where it stands, the unit that it bears ("" for none), and its values.

    `own_time` names stamps of its own, from which the values were brought to the recording's.
    """

    name: str
    place: Place
    unit: str
    values: Array
    own_time: str | None = None


@dataclass(frozen=True)
class Time:
    """The stamps' rule, the rate, whether the rows need a new grid, and why; `open` is what they do not tell."""

    rule: Mapping[str, Any] | None
    rate_hz: float
    resample: bool
    guesses: tuple[str, ...]
    column: str | None = None
    open: tuple[str, ...] = ()


def find_time(
    file: str,
    columns: Sequence[Column],
    layout: TextLayout | None,
    scalars: Mapping[str, float],
    stated_hz: float | None,
) -> Time:
    """The time of columns of one length; a rate that the user states goes first. Refuses a spectrum."""
    stamps = _stamps(columns)
    _refuse_spectrum(file, columns, stamps)
    found = _stated_rate(layout, scalars) if stamps is None else _by_stamps(stamps)
    if stated_hz is None:
        return found
    return replace(found, rate_hz=stated_hz, open=(), guesses=(*found.guesses, f"rate {stated_hz:g} Hz: as stated."))


def _refuse_spectrum(file: str, columns: Sequence[Column], stamps: Column | None) -> None:
    """Refuse columns over frequency: one that rises and is called so, or a first one that rises by a factor."""
    if stamps is not None and (_is_stamps(stamps) or stamps.place.clock):
        return
    for k, c in enumerate(columns):
        if not np.all(np.diff(c.values) > 0.0):
            continue
        called = c.unit.strip("[]() ").lower() in _PER_TIME or set(words_of(c.name)) & _FREQUENCY
        if called or (k == 0 and not is_time(c.name) and _by_a_factor(c.values)):
            how = "rises and is called a frequency" if called else "rises by a constant factor"
            raise WrongUseError(
                f"{file} holds a spectrum, not a recording", f"{c.name!r} {how}, and no column is called time",
                f"a response is read by: loopshape import-frf {file} --out FOLDER; for a recording give the stamps a"
                " name of time, or say all in a map (--map)",
            )  # fmt: skip


def _said_unit(stamps: Column) -> str:
    """The word of a unit that stands with stamps, or ends their name."""
    word = stamps.unit.strip("[]() ").lower()
    return word or next((last for last in words_of(stamps.name)[-1:] if last in _LONG and len(last) > 2), "")


def _is_stamps(c: Column) -> bool:
    """Whether a column's name or unit says time."""
    return is_time(c.name) or c.name.startswith(TIME_OF) or unit_of_word(c.unit or "?") in _SECONDS


def _by_a_factor(values: Array) -> bool:
    if values.size < 8 or values[0] <= 0.0:
        return False
    steps = np.diff(np.log(values))
    return bool(np.ptp(steps) < 1e-2 * steps.mean() and values[-1] > 2.0 * values[0] and np.ptp(np.diff(values)) > 0.0)


def _by_stamps(stamps: Column) -> Time:
    """Unit and rate of stamps, and why."""
    long = _LONG.get(_said_unit(stamps), 1.0)
    unit, why = ("s", f"its values are in {_said_unit(stamps)}, of {long:g} s.") if long > 1.0 else _time_unit(stamps)
    if not unit:
        return Time(None, 0.0, False, (), stamps.name, (why,))
    t_s = long * UNITS[unit][1] * (stamps.values - stamps.values[0])
    notes = [f"time is {stamps.name!r}: its values rise{' and its name says so' if is_time(stamps.name) else ''}.", why]
    rule = place_table(stamps.place) | {"unit": unit} | ({"gain": long} if long > 1.0 else {})
    if stamps.place.clock:
        notes[1] = f"the stamps are text, read as {stamps.place.clock!r}."
        rule["clock"] = stamps.place.clock
    mean = (t_s.size - 1) / t_s[-1]
    seen = read_stamps(t_s, 1.0 / (float(np.median(np.diff(t_s))) or 1.0 / mean))
    seen = read_stamps(t_s, seen.rate_hz if np.isfinite(seen.rate_hz) else mean)
    rate = _round_rate(seen.rate_hz, t_s.size, ON_GRID + seen.unsure)
    notes.append(
        f"rate {rate:.10g} Hz: all {t_s.size} stamps keep {seen.rate_hz:.8g} Hz, scatter {seen.jitter_s:.2g} s rms."
    )
    nominal = _nominal(rate)
    if seen.even and nominal != rate:
        notes[-1] = (
            f"rate {nominal:.6g} Hz, to which the rows are brought: the stamps keep {seen.rate_hz:.8g} Hz, that rate"
            " by another clock."
        )
        return Time(rule, nominal, True, tuple(notes), stamps.name)
    if not seen.even:
        rate = _round_rate(mean if seen.gaps == 0 else 1.0 / float(np.median(np.diff(t_s))), t_s.size, 0.01 * t_s.size)
        notes[-1] = f"the stamps are not even ({seen.gaps} gaps): resampled at {rate:.6g} Hz, linear across gaps."
    return Time(rule, rate, not seen.even, tuple(notes), stamps.name)


def _stamps(columns: Sequence[Column]) -> Column | None:
    """The column of stamps: of text, else the format's own, else one that rises and is called so, else a first one of
    even steps but 1.
    """
    for c in columns:
        if c.place.clock:
            return c
    rising = [c for c in columns if np.all(np.diff(c.values) >= 0.0) and c.values[-1] > c.values[0]]
    named = sorted((c for c in rising if _is_stamps(c)), key=lambda c: not c.name.startswith(TIME_OF))
    return next(iter([*named, *(c for c in rising if _may_be_stamps(c, columns))]), None)


def _may_be_stamps(c: Column, columns: Sequence[Column]) -> bool:
    """Whether a column that is not called time is even and the first: of all, or of an array, whose name it bears."""
    first_of_array = c.place.name is not None and 1 in (c.place.row, c.place.column)
    other = (role_weights(c.name) and words_of(c.name) not in _ABSCISSA) or (
        c.unit and unit_of_word(c.unit) is not None
    )
    return _even(c.values) and (first_of_array or (c is columns[0] and not other))


def _even(values: Array) -> bool:
    """Whether values rise in steps other than 1 that are even to a tenth, rms."""
    steps = np.diff(values)
    step = float(np.median(steps))
    return step > 0.0 and step != 1.0 and float(np.sqrt(np.mean((steps / step - 1.0) ** 2))) < 0.1


def _time_unit(stamps: Column) -> tuple[str, str]:
    """The unit of stamps, and why: stated, or by the size of a count since 1970, else s; "" and a question."""
    known = unit_of_word(stamps.unit) if stamps.unit else None
    if known is not None and UNITS[known][0] == "s":
        return known, f"its unit is {known}: {stamps.unit!r} stands with its name."
    for least, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s")):
        if least <= stamps.values[0] < 1e2 * least:
            return unit, f"its unit is {unit}: the values count from 1970 in it."
    if stamps.unit and known is None and not stamps.place.clock:
        rule = f"time = {{ from = {stamps.name!r}, unit = ... }}"
        return "", f"the unit {stamps.unit!r} of {stamps.name!r} is not known: write {rule} and rate_hz."
    step = float(np.median(np.diff(stamps.values)))
    if stamps.place.clock or step < 1.0:
        return "s", "its unit is not stated and taken for s: please confirm."
    if step < 200.0 or step % 60.0 == 0.0:
        may_be = "s, ms, us or a count of rows" if step == 1.0 else "s, ms or us"
        rule = f"time = {{ from = {stamps.name!r}, unit = ... }}"
        question = f"{stamps.name!r} rises by {step:g} a row without a unit: {may_be}?"
        return "", f"{question} Write {rule} and rate_hz, or rate_hz alone."
    return "us", f"its unit is not stated; steps of {step:g} are taken for us: please confirm."


def _nominal(rate_hz: float) -> float:
    """A rate or a period of two figures so near that another clock explains the rest; else the rate itself."""
    for figures in (1, 2):
        for close in (float(f"{rate_hz:.{figures}g}"), 1.0 / float(f"{1.0 / rate_hz:.{figures}g}")):
            if abs(close / rate_hz - 1.0) <= _NOMINAL:
                return close
    return rate_hz


def _round_rate(rate_hz: float, n: int, slack: float) -> float:
    """The roundest rate that leaves the stamps by no more than `slack` samples over n."""
    for figures in range(1, 8):
        for close in (float(f"{rate_hz:.{figures}g}"), 1.0 / float(f"{1.0 / rate_hz:.{figures}g}")):
            if abs(close / rate_hz - 1.0) * n <= slack:
                return close
    return rate_hz


def _stated_rate(layout: TextLayout | None, scalars: Mapping[str, float]) -> Time:
    """A rate that lines above the header, or numbers that stand alone, tell; none is an open question."""
    for line in () if layout is None else layout.above:
        if found := _RATE_WORDS.search(line):
            rate = float(found[2].replace(",", ".")) * {"k": 1e3, "m": 1e6}.get((found[3] or "").lower(), 1.0)
            return Time(None, rate, False, (f"rate {rate:g} Hz: a line above the header says {line.strip()[:60]!r}.",))
        if (found := _PERIOD_WORDS.search(line)) and (period := float(found[3].replace(",", "."))) > 0.0:
            bracket = _IN_BRACKETS.search(found[2])
            if period >= 1.0 and not found[4] and not bracket:
                continue  # a cycle time of 250: of what?
            unit = unit_of_word(found[4] or (bracket[1] if bracket else "s")) or "s"
            rate = 1.0 / (period * UNITS[unit][1])
            return Time(None, rate, False, (f"rate {rate:g} Hz: a line above the header says {line.strip()[:60]!r}.",))
    for name, value in scalars.items():
        word = name.rpartition(".")[2].lower()
        if word in ("fs", "rate", "rate_hz", "samplerate", "sample_rate", "f_s") and value > 0.0:
            return Time(None, value, False, (f"rate {value:g} Hz: the number {name!r} of the file.",))
        if word in ("ts", "dt", "sampletime", "sample_time", "t_s", "tsample") and 0.0 < value < 10.0:
            return Time(
                None, 1.0 / value, False, (f"rate {1.0 / value:g} Hz: one over the number {name!r} of the file.",)
            )
    return Time(None, 0.0, False, ())


def place_table(place: Place) -> dict[str, Any]:
    """A place as a rule of a map writes it."""
    keys = {"from": place.name, "column": place.column, "row": place.row}
    return {key: value for key, value in keys.items() if value is not None}
