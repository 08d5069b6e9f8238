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
from loopshape.core.units import Array, to_stored
from loopshape.io.csv_text import CsvShape
from loopshape.io.files import make_folder, read_toml, short, write_text_whole
from loopshape.io.provenance import file_sha256
from loopshape.io.toml_text import toml_text
from loopshape.toolbox.formats.drafts.column_words import (
    Role,
    column_name,
    parts_of,
    role_weights,
    split_unit,
    unit_of_word,
)
from loopshape.toolbox.formats.drafts.draft_roles import Roles, find_roles
from loopshape.toolbox.formats.drafts.draft_time import Column, Time, find_time, place_table
from loopshape.toolbox.formats.logs.blackbox import rate_fields
from loopshape.toolbox.formats.logs.dataflash import rate_message
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF
from loopshape.toolbox.formats.logs.ulog import rate_loop
from loopshape.toolbox.formats.tables.import_map import FORMAT
from loopshape.toolbox.formats.tables.sources import Place, Source, is_text, open_source
from loopshape.toolbox.formats.tables.text_layout import DATE, TextLayout, read_layout

#: columns that a draft holds, of an array that counts as signals, and among which parts are looked for
_MOST_COLUMNS, _MOST_SEEN = 64, 24
#: logs of flight controllers: where an axis's rate loop stands, its unit, and what to log where it is missing
_FLIGHT = {
    ".ulg": (rate_loop, "rad/s", "vehicle_angular_velocity and vehicle_torque_setpoint (SDLOG_PROFILE)"),
    **dict.fromkeys(
        (".bbl", ".bfl"), (rate_fields, "deg/s", "gyro, setpoint and PID terms (blackbox_disable_... = OFF)")
    ),
    ".bin": (rate_message, "deg/s", "RATE (LOG_BITMASK with attitude, fast)"),
}


@dataclass(frozen=True)
class Draft:
    """A map's table as TOML takes it, and what goes with it for people: columns by part, guesses, open questions."""

    table: Mapping[str, Any]
    guesses: tuple[str, ...]
    open: tuple[str, ...]
    columns: tuple[Column, ...]
    roles: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float = 0.0


def draft_map(file: Path, rate_hz: float | None = None) -> Draft:
    """Look at a file that `open_source` reads, and write the map that it seems to need; a stated rate goes first.

    Refuses a file that cannot be read, one without signals of one length that move, a spectrum, and a file of text
    without rows of numbers.
    """
    layout = read_layout(file) if is_text(file) else None
    source = open_source(file, CsvShape() if layout is None else layout.shape)
    remarks = [*source.remarks]
    source = _longest(source, remarks)
    parts = _flight_parts(source) if file.suffix.lower() in _FLIGHT else {}
    left: dict[str, list[str]] = {}
    columns, scalars = (_rate_loop(source, parts), {}) if parts else _columns(source, layout, left)
    columns, others = _of_one_recording(columns)
    found = find_time(file.name, columns, layout, scalars, rate_hz or source.rate_hz)
    columns = _brought(columns, others, found.column, left)
    signals = [c for c in columns if c.name != found.column and not c.name.startswith(TIME_OF)]
    moving = [c for c in signals if np.ptp(c.values) != 0.0 and not np.all(np.diff(c.values) == 1.0)]
    left["they never move or count the rows"] = [c.name for c in signals if c not in moving]
    if not moving:
        raise UnreadableInputError(
            f"{file.name} holds no signal that moves",
            short(f"stamps {found.column!r}" if not signals else ", ".join(c.name for c in signals)),
            "name a file with a column of numbers for each signal",
        )
    moving = _telling(moving, left)
    roles = _roles(moving, {Role(part): name for part, name in (parts or _pair(source, moving, remarks)).items()})
    roles.open += source.questions
    drafted = _drafted(file, layout, found, [c for c in moving if c.name not in roles.copies], roles)
    return _with_guesses(
        drafted, [*remarks, *(f"left out, since {why}: {_counted(names)}." for why, names in left.items() if names)]
    )


def _longest(source: Source, remarks: list[str]) -> Source:
    """The longest recording of a file that holds several; `remarks` takes that it does."""
    if not source.pieces:
        return source
    rows = {k: last - first for k, (first, last) in source.pieces.items()}
    longest = max(rows, key=rows.__getitem__)
    remarks.append(
        f"the file holds {len(rows)} episodes ({min(rows)} to {max(rows)}), each a recording: episodes = [...] under"
        f" [recording] takes some of them. This draft is made from episode {longest}, the longest."
    )
    return source.piece(longest)


def _pair(source: Source, moving: Sequence[Column], remarks: list[str]) -> dict[str, str]:
    """Control and output of the first loop that the format tells and that moves; `remarks` takes the others."""
    names = {c.name for c in moving}
    pairs = [pair for pair in source.pairs if names >= {*pair}]
    if len(pairs) > 1:
        others = ", ".join(f"{control} and {output}" for control, output in pairs[1:])
        remarks.append(f"pairs of control and output alike, each for a [[loop]] of its own: {short(others, 300)}.")
    return dict(zip(("control", "output"), pairs[0], strict=True)) if pairs else {}


def _counted(names: Sequence[str]) -> str:
    return short(", ".join(names), 300) + (f" ({len(names)} in all)" if len(names) > 5 else "")


def _with_guesses(draft: Draft, guesses: Sequence[str]) -> Draft:
    words, every = draft.table["draft"], [*draft.guesses, *guesses]
    return replace(draft, guesses=tuple(every), table={**draft.table, "draft": {**words, "guesses": every}})


def _loudness(name: str) -> float:
    """How loudly a name speaks for a part in a loop."""
    return max(role_weights(name).values(), default=0.0)


def _telling(moving: list[Column], left: dict[str, list[str]]) -> list[Column]:
    """At most so many columns as a draft holds, those with telling names first, in the file's order."""
    best = sorted(moving, key=lambda c: -_loudness(c.name))[:_MOST_COLUMNS]
    left[f"a draft holds {_MOST_COLUMNS} of the {len(moving)} signals that move, telling names first"] = [
        c.name for c in moving if c not in best
    ]
    return [c for c in moving if c in best]


def _roles(moving: Sequence[Column], known: Mapping[Role, str]) -> Roles:
    """Parts of the columns; of many those whose names tell most are looked at, and that is said."""
    seen = sorted(moving, key=lambda c: (c.name not in known.values(), -_loudness(c.name)))[:_MOST_SEEN]
    seen = [c for c in moving if c in seen]
    table = np.stack([c.values for c in seen], axis=1)
    roles = find_roles([c.name for c in seen], table, known, [c.name for c in seen if c.own_time])
    if len(seen) < len(moving):
        roles.guesses.append(f"parts were looked for among {len(seen)} of {len(moving)} signals, telling names first.")
    return roles


def _of_one_recording(columns: Sequence[Column]) -> tuple[tuple[Column, ...], tuple[Column, ...]]:
    """Columns of the length that is the recording's, and the others.

    That is one which several columns have, control and output by name among them where there are any, and which holds
    most numbers: the commonest length may be that of constants.
    """
    lengths = Counter(c.values.size for c in columns)
    named = {
        rows: len({max(role_weights(c.name), key=role_weights(c.name).__getitem__, default=None)
                   for c in columns if c.values.size == rows} - {None})
        for rows in lengths
    }  # fmt: skip
    rows = max(lengths, key=lambda size: (lengths[size] > 1, named[size] > 1, lengths[size] * size))
    return tuple(c for c in columns if c.values.size == rows), tuple(c for c in columns if c.values.size != rows)


def _brought(
    columns: tuple[Column, ...], others: Sequence[Column], stamps: str | None, left: dict[str, list[str]]
) -> tuple[Column, ...]:
    """Columns, those of other stamps brought to these by their own; what has other rows and no stamps is left out."""
    times = {c.name: c for c in (*columns, *others)}
    main = times[stamps].values if stamps is not None and stamps.startswith(TIME_OF) else None
    made, odd = [], []
    same_time = 0.01  # of a step, up to which stamps of two topics are one
    for c in (*columns, *others):
        own = next((TIME_OF + part for part in (c.name, c.name.partition(".")[0]) if TIME_OF + part in times), None)
        alike = c.values.size == columns[0].values.size
        if c.name.startswith(TIME_OF):
            made += [c] if alike else []
        elif main is None or own is None or times[own].values.size != c.values.size:
            made += [c] if alike else []
            odd += [] if alike else [f"{c.name} ({c.values.size} of {columns[0].values.size})"]
        elif alike and np.abs(times[own].values - main).max() < same_time * float(np.median(np.diff(main))):
            made.append(c)
        else:
            made.append(replace(c, values=np.interp(main, times[own].values, c.values), own_time=own))
    left["they have other rows"] = odd
    return tuple(made)


def refuse_to_write_over(path: Path) -> None:
    """Refuse a draft's file that is there already."""
    if path.exists():
        raise WrongUseError(
            "a draft is not written over a map",
            f"{path}, which is there already",
            f"import with it (--map {path} --out RUN), remove it, or give the draft another name (--draft FILE)",
        )


def write_draft(path: Path, draft: Draft, file: Path) -> None:
    """Write a draft's map, its guesses one a line; refuses to write over a file that is there."""
    refuse_to_write_over(path)
    head = f"# Draft of a map of {file.name}: read it against [draft], correct it, then delete [draft].\n"
    body = toml_text({key: value for key, value in draft.table.items() if key != "draft"})
    lists = "".join(_listed(key, draft.table["draft"].get(key, ())) for key in ("guesses", "open"))
    of = toml_text({"file": file.name, "sha256": file_sha256(file)})
    make_folder(path.parent)
    write_text_whole(path, f"{head}{body}\n[draft]\n{of}{lists}")


def refuse_draft_of_another(map_file: Path, file: Path) -> None:
    """Refuse a map that stands under a draft's usual name and does not say that it is the draft of this file."""
    draft = read_toml(map_file).get("draft")
    if not isinstance(draft, dict) or draft.get("sha256") != file_sha256(file):
        of = f"a draft of {short(draft.get('file'))}" if isinstance(draft, dict) else "a map without [draft]"
        raise WrongUseError(
            f"{map_file} is not the draft of this file", f"{of}, and {file}",
            f"remove it, name another (--draft), or delete [draft] in it and take it with --map {map_file}",
        )  # fmt: skip


def _listed(key: str, sentences: Sequence[str]) -> str:
    rows = "".join(f"  {json.dumps(one, ensure_ascii=False)},\n" for one in sentences)
    return f"{key} = [\n{rows}]\n" if sentences else ""


def _columns(
    source: Source, layout: TextLayout | None, left: dict[str, list[str]]
) -> tuple[tuple[Column, ...], dict[str, float]]:
    """All signals, and the numbers that stand alone; `left` takes the names of what is none, by the reason."""
    found, scalars, units = [], {}, source.units()
    text, wide = (left.setdefault(why, []) for why in ("they are no numbers", "they are tables of more columns"))
    for k, name in enumerate(source.names):
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
            values = np.empty(0, dtype=object)  # a column of text
        if values.size == 1 and values.dtype.kind in "biuf":
            scalars[name] = float(values.ravel()[0])
        elif values.dtype.kind in "biuf":
            made = _signals(source, layout, name, k, np.asarray(values, dtype=float), units.get(name, ""))
            wide += [] if made or not values.size else [name]
            found += made
        else:
            text.append(name)
    empty = {c.name for c in found if layout is not None and 2 * np.count_nonzero(np.isnan(c.values)) > c.values.size}
    left["they are no signals, or in a form that is not read"] = list(source.closed)
    left["most of their cells are empty"] = sorted(empty)
    found = [c for c in found if c.name not in empty]
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
    """Empty cells count as zero here, and numbers that have no square: the import names and refuses them."""
    values = np.nan_to_num(column.values, posinf=0.0, neginf=0.0)
    largest = 1e120  # numbers beyond it, of damaged files, have no squares
    return replace(column, values=np.where(np.abs(values) < largest, values, 0.0))


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
        return name, split_unit(".".join(parts_of(name)))[1]
    title = layout.names[k] or f"column {k + 1}"
    return title, layout.units[k] or split_unit(".".join(parts_of(title)) or title)[1]


def _stamped(source: Source, layout: TextLayout, name: str, k: int) -> Column:
    place = Place(None, k + 1, None, layout.clocks[k]) if source.numbered else Place(name, None, None, layout.clocks[k])
    return Column(_label(layout, name, k)[0], place, "s", np.asarray(source.signal(place)))


def _drafted(file: Path, layout: TextLayout | None, time: Time, signals: Sequence[Column], roles: Roles) -> Draft:
    guesses, questions = [*(layout.guesses if layout else ()), *time.guesses], [*time.open]
    if not time.rate_hz and not time.open:
        questions.append("no column rises as time does and no rate stands in the file: write rate_hz.")
    stored, rules, notes = _rules(signals)
    named = {role: stored[name] for role, name in roles.by_role.items()}
    if Role.OUTPUT not in named and {Role.REFERENCE, Role.ERROR} <= set(named):
        named[Role.OUTPUT] = f"{named[Role.REFERENCE]} - {named[Role.ERROR]}"
        guesses.append(f"no output was logged: it is taken for {named[Role.OUTPUT]!r}, reference less error.")
    loop = {"name": "loop"} | {key: named[role] for key, role in _LOOP_KEYS.items() if role in named}
    recording = {
        "name": re.sub(r"[^A-Za-z0-9_-]+", "-", file.name.split(".")[0]).strip("-") or "r01",
        "excites": "loop",
        **roles.recording,
    }
    missing = [role.value for role in (Role.OUTPUT, Role.CONTROL) if role not in named]
    questions += [
        f"which column is the {key} of the loop could not be told: write {key} under [[loop]], and injection and"
        " closed_loop under [recording]."
        for key in missing
    ]
    if roles.period_rows and time.rate_hz:
        recording |= {"period_s": roles.period_rows / time.rate_hz, "periodic_from_s": roles.first_row / time.rate_hz}
    if not missing and Role.OUTPUT not in roles.by_role:  # what moved was not looked for: the output is no column
        recording |= {"injection": "reference", "closed_loop": True}
    guesses += [*notes, *roles.guesses]
    table: dict[str, Any] = {"format": FORMAT, "rate_hz": time.rate_hz or None, "time": time.rule}
    table |= {"resample": True if time.resample else None, "csv": _csv_table(layout)}
    table |= {"columns": rules, "loop": [loop], "recording": recording}
    asked = (*questions, *roles.open)
    table["draft"] = {"guesses": guesses} | ({"open": [*asked]} if asked else {})
    by_column = {name: role.value for role, name in roles.by_role.items()}
    return Draft(table, tuple(guesses), asked, tuple(signals), by_column, time.rate_hz)


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
    unknown, bare, notes = [], [], []
    short_of = _without_common_path([c.name for c in signals])
    for c in signals:
        unit = unit_of_word(c.unit) if c.unit else None
        if c.unit and unit is None:
            unknown.append(f"{c.name!r} in {c.unit!r}")
        elif not c.unit:
            bare.append(c.name)
        else:
            notes.append(f"{c.name!r} is in {unit}: {c.unit!r} stands with its name.")
        unit = unit or "1"
        stored[c.name] = column_name(short_of[c.name], to_stored(unit)[0], set(rules))
        own = {} if c.own_time is None else {"time": c.own_time}
        rules[stored[c.name]] = place_table(c.place) | {"unit": unit} | own
    if bare:
        notes.append(f"no unit stands with {', '.join(bare)}: the numbers are taken as they are (unit 1).")
    if unknown:
        notes.append(f"units that are not known are taken as they are (unit 1): {', '.join(unknown)}.")
    return stored, rules, notes


def _without_common_path(names: Sequence[str]) -> dict[str, str]:
    """Names without the path that all have in common (`exp1.`), so that files of one rig make the same columns."""
    paths = {name: parts_of(name) or [name] for name in names}
    shared = 0
    while len(names) > 1 and all(len(path) > shared + 1 for path in paths.values()):
        if len({path[shared] for path in paths.values()}) > 1:
            break
        shared += 1
    return {name: ".".join(path[shared:]) for name, path in paths.items()}
