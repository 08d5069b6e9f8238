"""MAP.toml: what a user says of somebody else's file, so that nothing has to be guessed.

    format = "loopshape-map/1"
    rate_hz = 100.0                            # the rate of the recording that is made
    plant = "servo-axis"                       # as in run.toml; outputs, pwm and parameters may stand here too
    time = { from = "t", unit = "ms" }         # optional: the stamps, checked against rate_hz; of text, clock = "iso"
    resample = true                            # optional: stamps are irregular, interpolate linearly

    [csv]                                      # optional, for text files
    separator = "tab"                          # a character, "tab", or "blank" for any run of blanks
    header = false                             # default true
    skip_rows = 2                              # lines above the header or the first row
    decimal = ","                              # default "."
    unit_rows = 1                              # lines between the header and the first row
    encoding = "cp1252"                        # default "utf-8-sig"

    [columns]                                  # stored name = where it comes from
    theta_m_rad = { from = "theta_mx", unit = "deg", sign = -1 }
    force_n = { from = "data", column = 3, unit = "V", gain = 50.0, offset = -0.1 }
    gyro_rad_s = { from = "gyro.x", unit = "rad/s", time = "time of gyro" }   # stamps in s of its own, another rate
    z_v = { sum = "r_rad - theta_m_rad", controller = "axis" }                # made of columns above: `made_columns`

    [[loop]]                                   # as in run.toml
    [recording]                                # as in run.toml without file, and with
    name = "r01"                               # default: the file's name
    from_row = 2001                            # first and last row that are taken
    to_row = 52000
    episodes = [0, 2]                          # of a file that holds several (LeRobot); default: all, each a recording

    [draft]                                    # only in a draft, which is taken with --accept
    file = "log.csv"                           # of which file, and its sha256
    guesses = ["..."]                          # what was guessed, each with its reason
    open = ["..."]                             # what could not be told

Columns, rows of an array (`row = 2`, for signals that lie in rows) and rows of a recording count from 1; a
header is no row. A headerless table takes `column` alone. stored = factor (sign gain value + offset): gain and
offset bring the file's number to `unit` (a sensor in volts read as newtons), factor brings `unit` to the stored
one, and the stored name must end in that unit. `t_s` is made from the rate; `period_s` and
`periodic_from_s` count from the first row that is taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.core.units import SUFFIXES, to_stored
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import RecordingInfo
from loopshape.io.config_table import ConfigTable, read_words, said_in
from loopshape.io.csv_text import CsvShape
from loopshape.io.files import plain_name, short
from loopshape.io.run.run_tables import read_info, read_loops, read_outputs
from loopshape.io.run.tables import TIME
from loopshape.toolbox.formats.tables.made_columns import MadeRule, check_made, made_of_loops, read_made
from loopshape.toolbox.formats.tables.sources import Place

FORMAT = "loopshape-map/1"
_KEYS = (
    "format", "rate_hz", "plant", "outputs", "pwm", "parameters", "time", "resample", "csv", "columns", "loop",
    "recording", "draft",
)  # fmt: skip
#: encodings of text that a map may name
ENCODINGS = ("utf-8-sig", "cp1252", "latin-1", "utf-16")
_RECORDINGS = (".csv", ".txt", ".tsv", ".dat", ".mat", ".npz", ".parquet", ".gz")
_SEPARATORS = {"tab": "\t", "blank": " ", " ": " "}


@dataclass(frozen=True)
class ColumnRule:
    """How one stored column comes out of a file: scale is factor sign gain, shift is factor offset.

    `own_time` are stamps in s of its own, where its rate is another than the recording's.
    """

    stored: str
    place: Place
    scale: float
    shift: float
    own_time: Place | None = None


@dataclass(frozen=True, eq=False)
class ImportMap:
    """A map that has been read: rows are counted from 0 here, `to_row` excluded."""

    rate_hz: float
    time: ColumnRule | None
    resample: bool
    csv: CsvShape
    columns: tuple[ColumnRule, ...]
    made: tuple[MadeRule, ...]
    loops: tuple[LoopSetup, ...]
    info: RecordingInfo
    from_row: int
    to_row: int | None
    episodes: tuple[int, ...]
    plant: str | None
    pwm: Mapping[str, float]
    parameters: Mapping[str, Any]
    outputs: tuple[str, ...] = ()
    guesses: tuple[str, ...] = ()


def read_map(map_file: Path, default_name: str, *, accept_draft: bool = False) -> ImportMap:
    """Read a MAP.toml; refuses missing and unknown keys, wrong units, loops and outputs without their columns.

    A draft is refused unless it is accepted, and one that leaves questions open in any case.
    """
    if map_file.suffix.lower() in _RECORDINGS:
        raise WrongUseError(
            "a map is a TOML file", str(map_file), "name the recording first and the map behind --map; without --map a"
            " draft of one is written",
        )  # fmt: skip
    words = read_words(map_file, FORMAT)
    words.only(*_KEYS)
    guesses = _draft(words, accept_draft)
    words.need("rate_hz", "columns", "loop", "recording")
    rate_hz = words.positive("rate_hz")
    words, of_loops = made_of_loops(words)
    _refuse_no_control(words)
    loops = read_loops(words, rate_hz)
    columns, made = _read_columns(words.inner("columns"))
    made = (*made, *of_loops)
    stored = {rule.stored for rule in columns}
    check_made(made, stored, loops, words.where)
    outputs = read_outputs(words)
    _refuse_unfed(loops, outputs, stored | {rule.stored for rule in made}, words.where)
    _refuse_twice(loops, {rule.stored: rule.place for rule in columns}, words.where)
    recording = words.inner("recording")
    from_row, to_row = _rows(recording)
    return ImportMap(
        rate_hz=rate_hz,
        time=_read_rule(TIME, words.inner("time")) if "time" in words.table else None,
        resample=_resample(words),
        csv=_read_csv(words.inner("csv")),
        columns=columns,
        made=made,
        loops=loops,
        info=_read_info(recording, default_name, loops),
        from_row=from_row,
        to_row=to_row,
        episodes=_episodes(recording),
        plant=words.maybe_text("plant"),
        pwm=words.numbers("pwm"),
        parameters=words.numbers("parameters"),
        outputs=outputs,
        guesses=guesses,
    )


def _draft(words: ConfigTable, accepted: bool) -> tuple[str, ...]:
    """The guesses of a draft; empty for a map that somebody wrote or confirmed."""
    if "draft" not in words.table:
        return ()
    draft = words.inner("draft")
    draft.only("file", "sha256", "guesses", "open")
    if questions := draft.list_of_texts("open"):
        raise WrongUseError(
            f"{words.where} is a draft that leaves questions open", " ".join(questions).rstrip("."),
            "answer them in the map and delete its table [draft]",
        )  # fmt: skip
    guesses = draft.list_of_texts("guesses")
    if not accepted:
        raise WrongUseError(
            f"{words.where} is a draft that has not been confirmed", f"{len(guesses)} guesses under [draft]",
            "read it, correct it and delete [draft], or take it as it is with --accept",
        )  # fmt: skip
    return guesses


def _resample(words: ConfigTable) -> bool:
    resample = words.value("resample", bool, False)
    if resample and "time" not in words.table:
        raise WrongUseError(
            f"{words.where}: resample needs the stamps",
            "no time",
            'write time = { from = "...", unit = "s" }',
        )
    return resample


def _read_csv(words: ConfigTable) -> CsvShape:
    words.only("separator", "header", "skip_rows", "decimal", "unit_rows", "encoding")
    separator = words.text("separator", ",")
    separator = _SEPARATORS.get(separator, separator)
    if len(separator) != 1 or separator in "\r\n\"'.0123456789":
        raise WrongUseError(
            f"{words.where}: separator is one character",
            repr(separator),
            'write ",", ";", "tab", or "blank" for any run of blanks',
        )
    decimal = words.one_of("decimal", (".", ","), ".")
    if decimal == separator:
        raise WrongUseError(f"{words.where}: separator and decimal are the same", repr(decimal), "say which is which")
    header, encoding = words.value("header", bool, True), words.one_of("encoding", ENCODINGS, ENCODINGS[0])
    return CsvShape(separator, header, words.whole("skip_rows", 0), decimal, words.whole("unit_rows", 0), encoding)


def _read_columns(words: ConfigTable) -> tuple[tuple[ColumnRule, ...], tuple[MadeRule, ...]]:
    """Columns that come from the file, and those that are made of others."""
    if TIME in words.table:
        raise WrongUseError(f"{words.where}: t_s is made from rate_hz", "a rule for it", "write time = { ... } instead")
    tables = {stored: words.inner(stored) for stored in words.table}
    rules = tuple(_read_rule(stored, table) for stored, table in tables.items() if "sum" not in table.table)
    if not rules:
        raise WrongUseError(f"{words.where}: no column is imported", "an empty table", "name at least one")
    return rules, tuple(read_made(stored, table) for stored, table in tables.items() if "sum" in table.table)


def _refuse_no_control(words: ConfigTable) -> None:
    """A loop whose control was not logged: with its controller the control can be computed."""
    for loop in words.tables("loop"):
        if "control" in loop.table:
            continue
        raise WrongUseError(
            f"{loop.where}: a loop without its control", "no control",
            'log it; or, with controller = [...] under [[loop]], let it be computed: under [columns] z_v = { sum ='
            ' "r_rad - y_rad", controller = "' + str(loop.table.get("name", "loop")) + '" }, and control = "z_v"',
        )  # fmt: skip


def _read_rule(stored: str, words: ConfigTable) -> ColumnRule:
    words.only("from", "column", "row", "unit", "sign", "gain", "offset", "clock" if stored == TIME else "time")
    unit = words.text("unit")
    with said_in(words.where):
        suffix, factor = to_stored(unit)
        wanted = Channel.from_column("time_s" if stored == TIME else stored).unit
    if suffix != wanted:
        raise WrongUseError(
            f"{words.where}: the stored name ends in _{wanted}, which is {SUFFIXES[wanted]}",
            f"unit = {unit!r}",
            f"end the name in _{suffix}, or correct the unit",
        )
    sign = words.number("sign", 1.0)
    if sign not in (1.0, -1.0):
        raise WrongUseError(f"{words.where}: sign is 1 or -1", f"{sign:g}", "use gain for other factors")
    scale = factor * sign * words.number("gain", 1.0)
    own = Place(words.text("time")) if stored != TIME and "time" in words.table else None
    return ColumnRule(stored, _read_place(words), scale, factor * words.number("offset", 0.0), own)


def _read_place(words: ConfigTable) -> Place:
    if not {"from", "column"} & set(words.table):
        raise WrongUseError(f"{words.where}: it comes from nowhere", "no from", 'write from = "name in the file"')
    return Place(
        words.maybe_text("from"), _count(words, "column"), _count(words, "row"), words.maybe_text("clock")
    )  # fmt: skip


def _count(words: ConfigTable, key: str) -> int | None:
    """A number that counts from 1, or None where it is missing."""
    number = words.whole(key, 1)
    if number < 1:
        raise WrongUseError(f"{words.where}: {key} counts from 1", f"{number}")
    return number if key in words.table else None


def _rows(words: ConfigTable) -> tuple[int, int | None]:
    first, last = _count(words, "from_row") or 1, _count(words, "to_row")
    if last is not None and last <= first:
        raise WrongUseError(f"{words.where}: to_row lies above from_row", f"from {first} to {last}", "let it rise")
    return first - 1, last


def _episodes(words: ConfigTable) -> tuple[int, ...]:
    """Numbers of the episodes that are taken; empty for all."""
    numbers = words.value("episodes", tuple[float, ...], ())
    if len(set(numbers)) != len(numbers) or not all(x >= 0 and x.is_integer() for x in numbers):
        raise WrongUseError(f"{words.where}: episodes are whole numbers from 0 on, each once", short(str(numbers)))
    return tuple(int(x) for x in numbers)


def _read_info(words: ConfigTable, default_name: str, loops: tuple[LoopSetup, ...]) -> RecordingInfo:
    with said_in(words.where):
        name = plain_name(words.text("name", default_name), "the name of a recording")
    if "." in name:
        raise WrongUseError(f"{words.where}: the name of a recording has no dot", repr(name), "write another name")
    table = {key: value for key, value in words.table.items() if key not in ("name", "from_row", "to_row", "episodes")}
    return read_info(table, words.where, loops, file=f"{name}.parquet")


def _refuse_unfed(loops: tuple[LoopSetup, ...], outputs: tuple[str, ...], stored: set[str], where: str) -> None:
    named: dict[str, set[str | None]] = {
        f"loop {loop.name!r} names": {loop.reference, loop.injected, loop.control, *sum_terms(loop.output)} - {None}
        for loop in loops
    }
    named["outputs name"] = {term for output in outputs for term in sum_terms(output)}
    for who, columns in named.items():
        if missing := sorted(str(name) for name in columns - stored):
            raise WrongUseError(
                f"{where}: {who} columns that [columns] does not make",
                ", ".join(missing),
                f"it makes {', '.join(sorted(stored))}",
            )


def _refuse_twice(loops: tuple[LoopSetup, ...], places: Mapping[str, Place], where: str) -> None:
    """Refuse a loop whose output comes from the place in the file that one of its other signals comes from."""
    for loop in loops:
        others = [str(name) for name in (loop.control, loop.injected, loop.reference) if name is not None]
        for output, other in product(sum_terms(loop.output), others):
            if output in places and places[output] == places.get(other):
                raise WrongUseError(
                    f"{where}: {output} and {other} of loop {loop.name!r} come from one place in the file",
                    ", ".join(str(x) for x in (places[other].name, places[other].column) if x is not None),
                    "map each to a column of its own",
                )
