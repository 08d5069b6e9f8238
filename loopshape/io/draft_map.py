"""A first map for somebody's file: what it seems to hold, each guess with its reason, and what it does not tell.

Nothing is guessed in silence: the draft lists its guesses, is taken only when a person confirms or accepts it, and the
run that is made with it repeats them.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import LoopshapeError, UnreadableInputError, WrongUseError
from loopshape.core.units import UNITS, Array, to_stored
from loopshape.io.blackbox import rate_fields
from loopshape.io.column_words import Role, column_name, is_time, split_unit, unit_of_word
from loopshape.io.csv_text import CsvShape
from loopshape.io.dataflash import rate_message
from loopshape.io.draft_roles import Roles, find_roles
from loopshape.io.files import make_folder, write_text_whole
from loopshape.io.import_map import FORMAT
from loopshape.io.mdf4 import TIME_OF
from loopshape.io.sources import Place, Source, is_text, open_source
from loopshape.io.stamps import ON_GRID, read_stamps
from loopshape.io.text_layout import DATE, TextLayout, read_layout
from loopshape.io.toml_text import toml_text
from loopshape.io.ulog import rate_loop

_MOST_COLUMNS = 64
#: logs of flight controllers: where an axis's rate loop stands, its unit, and what to log where it is missing
_FLIGHT = {
    ".ulg": (rate_loop, "rad/s", "vehicle_angular_velocity and vehicle_torque_setpoint (SDLOG_PROFILE)"),
    **dict.fromkeys(
        (".bbl", ".bfl"), (rate_fields, "deg/s", "gyro, setpoint and PID terms (blackbox_disable_... = OFF)")
    ),
    ".bin": (rate_message, "deg/s", "RATE (LOG_BITMASK with attitude, fast)"),
}
_RATE_WORDS = re.compile(
    r"\b(fs|rate|rate_hz|sample[ _]?rate|sampling[ _]?rate|sampling[ _]?frequency|abtastrate|f_?s)\b[^0-9\n]{0,12}"
    r"([0-9]+(?:[.,][0-9]+)?(?:e[+-]?[0-9]+)?)\s*(k?hz)?",
    re.IGNORECASE,
)
_PERIOD_WORDS = re.compile(
    r"\b(ts|dt|sample[ _]?time|sampling[ _]?time|sampling[ _]?interval|sample[ _]?interval|increment|delta[ _]x"
    r"|hresolution|abtastzeit|cycle ?time|zykluszeit)\b([^0-9\n]{0,12})([0-9]+(?:[.,][0-9]+)?(?:e[+-]?[0-9]+)?)"
    r"(?![0-9])[\s,;]*(us|µs|ms|s)?(?!\s*[a-zµ°/%])",
    re.IGNORECASE,
)
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
class Draft:
    """A map's table as TOML takes it, and what goes with it for people: columns by part, guesses, open questions."""

    table: Mapping[str, Any]
    guesses: tuple[str, ...]
    open: tuple[str, ...]
    columns: tuple[Column, ...]
    roles: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float = 0.0


@dataclass(frozen=True)
class _Time:
    """The stamps' rule, the rate, whether the rows need a new grid, and why."""

    rule: Mapping[str, Any] | None
    rate_hz: float
    resample: bool
    guesses: tuple[str, ...]
    column: str | None = None


def draft_map(file: Path, rate_hz: float | None = None) -> Draft:
    """Look at a file that `open_source` reads, and write the map that it seems to need; a stated rate goes first.

    Refuses a file that cannot be read, one without signals of one length, and a file of text without rows of numbers.
    """
    layout = read_layout(file) if is_text(file) else None
    source = open_source(file, CsvShape() if layout is None else layout.shape)
    parts = _flight_parts(source) if file.suffix.lower() in _FLIGHT else {}
    columns, scalars = (_rate_loop(source, parts), {}) if parts else _columns(source, layout)
    columns, others = _of_one_length(columns)
    found = _time(columns, layout, scalars)
    columns, left = _brought(columns, others, found.column)
    if rate_hz is not None:
        found = replace(found, rate_hz=rate_hz, guesses=(*found.guesses, f"rate {rate_hz:g} Hz: as stated."))
    signals = [c for c in columns if c.name != found.column and not c.name.startswith(TIME_OF)]
    still = [c.name for c in signals if np.ptp(c.values) == 0.0 or bool(np.all(np.diff(c.values) == 1.0))]
    moving = tuple(c for c in signals if c.name not in still)
    known = {Role(part): name for part, name in parts.items()}
    table = np.stack([c.values for c in moving], axis=1) if moving else np.empty((0, 0))
    roles = find_roles([c.name for c in moving], table, known) if moving else Roles()
    drafted = _drafted(file, layout, found, moving, still, roles)
    return drafted if not left else _with_guess(drafted, f"left out, since they have other rows: {', '.join(left)}.")


def _with_guess(draft: Draft, guess: str) -> Draft:
    words = draft.table["draft"]
    return replace(
        draft,
        guesses=(*draft.guesses, guess),
        table={**draft.table, "draft": {**words, "guesses": [*words["guesses"], guess]}},
    )


def _of_one_length(columns: Sequence[Column]) -> tuple[tuple[Column, ...], tuple[Column, ...]]:
    """Columns of the most frequent length, and the others."""
    lengths = Counter(c.values.size for c in columns)
    rows = max(lengths, key=lambda size: (lengths[size], size))
    return tuple(c for c in columns if c.values.size == rows), tuple(c for c in columns if c.values.size != rows)


def _brought(
    columns: tuple[Column, ...], others: Sequence[Column], stamps: str | None
) -> tuple[tuple[Column, ...], tuple[str, ...]]:
    """Columns of other rates brought to these stamps by their own, and the names of those that have none."""
    times = {c.name: c for c in (*columns, *others)}
    main = times[stamps].values if stamps is not None and stamps.startswith(TIME_OF) else None
    made, left = [], []
    for c in others:
        own = next((TIME_OF + part for part in (c.name, c.name.partition(".")[0]) if TIME_OF + part in times), None)
        if c.name.startswith(TIME_OF):
            continue
        if main is None or own is None or times[own].values.size != c.values.size:
            left.append(c.name)
        else:
            made.append(replace(c, values=np.interp(main, times[own].values, c.values), own_time=own))
    return (*columns, *made), tuple(left)


def write_draft(path: Path, draft: Draft, file: Path) -> None:
    """Write a draft's map, its guesses one a line; refuses to write over a file that is there."""
    if path.exists():
        raise WrongUseError(
            f"{path} is there already", "a draft is not written over a map", "give another name (--draft FILE)"
        )
    head = f"# Draft of a map of {file.name}: read it against [draft], correct it, then delete [draft].\n"
    body = toml_text({key: value for key, value in draft.table.items() if key != "draft"})
    lists = "".join(_listed(key, draft.table["draft"].get(key, ())) for key in ("guesses", "open"))
    make_folder(path.parent)
    write_text_whole(path, f"{head}{body}\n[draft]\n{lists}")


def _listed(key: str, sentences: Sequence[str]) -> str:
    rows = "".join(f"  {json.dumps(one, ensure_ascii=False)},\n" for one in sentences)
    return f"{key} = [\n{rows}]\n" if sentences else ""


def _columns(source: Source, layout: TextLayout | None) -> tuple[tuple[Column, ...], dict[str, float]]:
    """All signals, and the numbers that stand alone."""
    found, scalars, units = [], {}, source.units()
    for k, name in enumerate(source.names[:_MOST_COLUMNS]):
        if layout is not None and layout.shape.header:
            k = layout.names.index(name)
        if layout is not None and layout.clocks[k] == DATE:
            continue
        if layout is not None and layout.clocks[k]:
            found.append(_stamped(source, layout, name, k))
            continue
        try:
            values = np.asarray(source.load(name))
        except LoopshapeError:
            continue  # a column of text
        if values.size == 1 and values.dtype.kind in "biuf":
            scalars[name] = float(values.ravel()[0])
        elif values.dtype.kind in "biuf":
            found += _signals(source, layout, name, k, np.asarray(values, dtype=float), units.get(name, ""))
    if max((c.values.size for c in found), default=0) < 2:
        raise UnreadableInputError(
            f"{source.path.name} holds no signals", f"{len(source.names)} names, none of two numbers or more",
            "name a file with a row of numbers a sample",
        )  # fmt: skip
    return tuple(_trimmed(c) for c in found), scalars


def _flight_parts(source: Source) -> dict[str, str]:
    """The signals of the roll axis's rate loop in a flight log; refuses a log without control or output."""
    find, _, cure = _FLIGHT[source.path.suffix.lower()]
    parts = find(source.names, 0)
    if not {"control", "output"} <= set(parts):
        raise UnreadableInputError(
            f"{source.path.name} holds no rate loop", f"of roll only {', '.join(parts.values()) or 'nothing'}",
            f"log {cure}",
        )  # fmt: skip
    return parts


def _rate_loop(source: Source, parts: Mapping[str, str]) -> tuple[Column, ...]:
    """A flight log's rate loop at the stamps of its gyro, each topic's own stamps beside it."""
    _, rate_unit, _ = _FLIGHT[source.path.suffix.lower()]
    main = _stamps_of(parts["output"], source.names)
    t = np.asarray(source.load(main))
    columns = [Column(main, Place(main), "s", t)]
    for part, name in parts.items():
        own, values = _stamps_of(name, source.names), np.asarray(source.load(name), dtype=float)
        unit = "1" if part == "control" else rate_unit
        if own == main:
            columns.append(Column(name, Place(name), unit, values))
        else:
            columns.append(Column(name, Place(name), unit, np.interp(t, np.asarray(source.load(own)), values), own))
    return tuple(columns)


def _stamps_of(signal: str, names: Sequence[str]) -> str:
    """The stamps of a signal's topic, or the file's only ones."""
    own = TIME_OF + signal.partition(".")[0]
    return own if own in names else next(name for name in names if name.startswith(TIME_OF))


def _trimmed(column: Column) -> Column:
    """Empty cells count as zero here: the import names and refuses them."""
    return replace(column, values=np.nan_to_num(column.values))


def _signals(source: Source, layout: TextLayout | None, name: str, k: int, values: Array, stated: str) -> list[Column]:
    """An array's signals: itself, or its columns or rows, whichever are fewer, in the unit that the format states."""
    label, named = _label(layout, name, k)
    unit = stated or named
    if values.ndim < 2 or (values.ndim == 2 and 1 in values.shape):
        place = Place(None, k + 1) if source.numbered else Place(name)
        return [Column(label, place, unit, values.ravel())]
    if values.ndim > 2 or min(values.shape) > _MOST_COLUMNS:
        return []
    down = values.shape[0] >= values.shape[1]
    each = values.T if down else values
    return [
        Column(f"{label} {i}", Place(name, i, None) if down else Place(name, None, i), unit, one)
        for i, one in enumerate(each, start=1)
    ]


def _label(layout: TextLayout | None, name: str, k: int) -> tuple[str, str]:
    if layout is None:
        return name, split_unit(name)[1]
    title = layout.names[k] or f"column {k + 1}"
    return title, layout.units[k] or split_unit(title)[1]


def _stamped(source: Source, layout: TextLayout, name: str, k: int) -> Column:
    place = Place(None, k + 1, None, layout.clocks[k]) if source.numbered else Place(name, None, None, layout.clocks[k])
    return Column(_label(layout, name, k)[0], place, "s", np.asarray(source.signal(place)))


def _time(columns: Sequence[Column], layout: TextLayout | None, scalars: Mapping[str, float]) -> _Time:
    stamps = _stamps(columns)
    if stamps is None:
        return _stated_rate(layout, scalars)
    unit, why = _time_unit(stamps)
    t_s = UNITS[unit][1] * (stamps.values - stamps.values[0])
    said = [f"time is {stamps.name!r}: its values rise{' and its name says so' if is_time(stamps.name) else ''}.", why]
    rule = _place_table(stamps.place) | {"unit": unit}
    if stamps.place.clock:
        said[1] = f"the stamps are text, read as {stamps.place.clock!r}."
        rule["clock"] = stamps.place.clock
    mean = (t_s.size - 1) / t_s[-1]
    seen = read_stamps(t_s, 1.0 / (float(np.median(np.diff(t_s))) or 1.0 / mean))
    seen = read_stamps(t_s, seen.rate_hz if np.isfinite(seen.rate_hz) else mean)
    rate = _round_rate(seen.rate_hz, t_s.size, ON_GRID + seen.unsure)
    said.append(
        f"rate {rate:.10g} Hz: all {t_s.size} stamps keep {seen.rate_hz:.8g} Hz, scatter {seen.jitter_s:.2g} s rms."
    )
    if not seen.even:
        rate = _round_rate(mean if seen.gaps == 0 else 1.0 / float(np.median(np.diff(t_s))), t_s.size, 0.01 * t_s.size)
        said[-1] = f"the stamps are not even ({seen.gaps} gaps): resampled at {rate:.6g} Hz, linear across gaps."
    return _Time(rule, rate, not seen.even, tuple(said), stamps.name)


def _stamps(columns: Sequence[Column]) -> Column | None:
    """The column of stamps: of text, else one that rises and is called so, else one of even steps other than 1."""
    for c in columns:
        if c.place.clock:
            return c
    rising = [c for c in columns if np.all(np.diff(c.values) >= 0.0) and c.values[-1] > c.values[0]]
    named = [c for c in rising if is_time(c.name) or c.name.startswith(TIME_OF)]
    if named:
        return named[0]
    return next((c for c in rising if _even(c.values)), None)


def _even(values: Array) -> bool:
    """Whether values rise in steps other than 1 that are even to a tenth, rms."""
    steps = np.diff(values)
    step = float(np.median(steps))
    return step > 0.0 and step != 1.0 and float(np.sqrt(np.mean((steps / step - 1.0) ** 2))) < 0.1


def _time_unit(stamps: Column) -> tuple[str, str]:
    """The unit of stamps, and why: stated, or by the size of a count since 1970, else s."""
    known = unit_of_word(stamps.unit) if stamps.unit else None
    if known is not None and UNITS[known][0] == "s":
        return known, f"its unit is {known}: {stamps.unit!r} stands with its name."
    for least, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s")):
        if least <= stamps.values[0] < 1e2 * least:
            return unit, f"its unit is {unit}: the values count from 1970 in it."
    step = float(np.median(np.diff(stamps.values)))
    if step >= 1.0:
        unit = "ms" if step < 200.0 else "us"
        return unit, f"its unit is not stated; steps of {step:g} are taken for {unit}: please confirm."
    return "s", "its unit is not stated and taken for s: please confirm."


def _round_rate(rate_hz: float, n: int, slack: float) -> float:
    """The roundest rate that leaves the stamps by no more than `slack` samples over n."""
    for figures in range(1, 8):
        for close in (float(f"{rate_hz:.{figures}g}"), 1.0 / float(f"{1.0 / rate_hz:.{figures}g}")):
            if abs(close / rate_hz - 1.0) * n <= slack:
                return close
    return rate_hz


def _stated_rate(layout: TextLayout | None, scalars: Mapping[str, float]) -> _Time:
    """A rate that lines above the header, or numbers that stand alone, tell; none is an open question."""
    for line in () if layout is None else layout.above:
        if found := _RATE_WORDS.search(line):
            rate = float(found[2].replace(",", ".")) * (1e3 if (found[3] or "").lower() == "khz" else 1.0)
            return _Time(None, rate, False, (f"rate {rate:g} Hz: a line above the header says {line.strip()[:60]!r}.",))
        if (found := _PERIOD_WORDS.search(line)) and (period := float(found[3].replace(",", "."))) > 0.0:
            bracket = _IN_BRACKETS.search(found[2])
            unit = unit_of_word(found[4] or (bracket[1] if bracket else "s")) or "s"
            rate = 1.0 / (period * UNITS[unit][1])
            return _Time(None, rate, False, (f"rate {rate:g} Hz: a line above the header says {line.strip()[:60]!r}.",))
    for name, value in scalars.items():
        word = name.rpartition(".")[2].lower()
        if word in ("fs", "rate", "rate_hz", "samplerate", "sample_rate", "f_s") and value > 0.0:
            return _Time(None, value, False, (f"rate {value:g} Hz: the number {name!r} of the file.",))
        if word in ("ts", "dt", "sampletime", "sample_time", "t_s", "tsample") and 0.0 < value < 10.0:
            return _Time(
                None, 1.0 / value, False, (f"rate {1.0 / value:g} Hz: one over the number {name!r} of the file.",)
            )
    return _Time(None, 0.0, False, ())


def _place_table(place: Place) -> dict[str, Any]:
    keys = {"from": place.name, "column": place.column, "row": place.row}
    return {key: value for key, value in keys.items() if value is not None}


def _drafted(
    file: Path, layout: TextLayout | None, time: _Time, signals: Sequence[Column], still: Sequence[str], roles: Roles
) -> Draft:
    guesses, questions = [*(layout.guesses if layout else ()), *time.guesses], []
    if not time.rate_hz:
        questions.append("no column rises as time does and no rate stands in the file: write rate_hz.")
    if still:
        guesses.append(f"left out, since they never move or count the rows: {', '.join(still)}.")
    stored, rules, said = _rules(signals)
    named = {role: stored[name] for role, name in roles.by_role.items()}
    if Role.OUTPUT not in named and {Role.REFERENCE, Role.ERROR} <= set(named):
        named[Role.OUTPUT] = f"{named[Role.REFERENCE]} - {named[Role.ERROR]}"
        guesses.append(f"no output was logged: it is taken for {named[Role.OUTPUT]!r}, reference less error.")
    loop = {"name": "loop"} | {key: named[role] for key, role in _LOOP_KEYS.items() if role in named}
    for key, role in (("output", Role.OUTPUT), ("control", Role.CONTROL)):
        if role not in named:
            questions.append(f"which column is the {key} of the loop could not be told: write {key} under [[loop]].")
    recording = {
        "name": re.sub(r"[^A-Za-z0-9_-]+", "-", file.name.split(".")[0]).strip("-") or "r01",
        **roles.recording,
    }
    if roles.period_rows and time.rate_hz:
        recording |= {"period_s": roles.period_rows / time.rate_hz, "periodic_from_s": roles.first_row / time.rate_hz}
    if Role.OUTPUT in named and Role.CONTROL in named:
        recording["excites"] = "loop"
        if Role.OUTPUT not in roles.by_role:  # what moved was not looked for: the output is no column
            recording |= {"injection": "reference", "closed_loop": True}
    guesses += [*said, *roles.guesses]
    table: dict[str, Any] = {"format": FORMAT, "rate_hz": time.rate_hz or None, "time": time.rule}
    table |= {"resample": True if time.resample else None, "csv": _csv_table(layout)}
    table |= {"columns": rules, "loop": [loop], "recording": recording}
    table["draft"] = {"guesses": guesses} | ({"open": [*questions, *roles.open]} if questions or roles.open else {})
    by_column = {name: role.value for role, name in roles.by_role.items()}
    return Draft(table, tuple(guesses), (*questions, *roles.open), tuple(signals), by_column, time.rate_hz)


_LOOP_KEYS = {
    "reference": Role.REFERENCE, "injected": Role.INJECTED, "control": Role.CONTROL, "output": Role.OUTPUT,
}  # fmt: skip


def _csv_table(layout: TextLayout | None) -> dict[str, Any] | None:
    """What of a layout differs from what a map takes for granted."""
    if layout is None:
        return None
    shape, usual = layout.shape, CsvShape()
    words = {"separator": {"\t": "tab", " ": "blank"}.get(shape.separator, shape.separator)}
    words |= {key: getattr(shape, key) for key in ("header", "skip_rows", "decimal", "unit_rows", "encoding")}
    differ = {key: value for key, value in words.items() if value != getattr(usual, key)}
    return differ or None


def _rules(signals: Sequence[Column]) -> tuple[dict[str, str], dict[str, Any], list[str]]:
    """Stored name of each column, the table [columns], and a sentence on each unit."""
    stored: dict[str, str] = {}
    rules: dict[str, Any] = {}
    unknown, bare, said = [], [], []
    for c in signals:
        unit = unit_of_word(c.unit) if c.unit else None
        if c.unit and unit is None:
            unknown.append(f"{c.name!r} in {c.unit!r}")
        elif not c.unit:
            bare.append(c.name)
        else:
            said.append(f"{c.name!r} is in {unit}: {c.unit!r} stands with its name.")
        unit = unit or "1"
        stored[c.name] = column_name(c.name, to_stored(unit)[0], set(rules))
        own = {} if c.own_time is None else {"time": c.own_time}
        rules[stored[c.name]] = _place_table(c.place) | {"unit": unit} | own
    if bare:
        said.append(f"no unit stands with {', '.join(bare)}: the numbers are taken as they are (unit 1).")
    if unknown:
        said.append(f"units that are not known are taken as they are (unit 1): {', '.join(unknown)}.")
    return stored, rules, said
