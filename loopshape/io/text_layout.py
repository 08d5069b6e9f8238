"""How somebody's file of text is laid out, read off its first lines: separator, decimal sign, header, units, rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from loopshape.core.errors import UnreadableInputError
from loopshape.io.csv_text import CsvShape, first_text
from loopshape.io.files import short

_LOOKED_AT = 1 << 18  # bytes
_SEPARATORS = (";", "\t", ",", "|", " ")
_NAMED = {"\t": "tab", " ": "blanks", ",": "comma", ";": "semicolon", "|": "bar"}
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
#: what a cell is called that holds a day alone
DATE = "date"
_CLOCKS = (
    (DATE, re.compile(r"\d\d?\.\d\d?\.\d{4}|\d{4}-\d\d-\d\d|\d\d?/\d\d?/\d{4}")),
    ("iso", re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?")),
    ("%d.%m.%Y %H:%M:%S.%f", re.compile(r"\d\d?\.\d\d?\.\d{4} \d\d?:\d\d:\d\d\.\d+")),
    ("%d.%m.%Y %H:%M:%S,%f", re.compile(r"\d\d?\.\d\d?\.\d{4} \d\d?:\d\d:\d\d,\d+")),
    ("%d.%m.%Y %H:%M:%S", re.compile(r"\d\d?\.\d\d?\.\d{4} \d\d?:\d\d:\d\d")),
    ("%Y/%m/%d %H:%M:%S.%f", re.compile(r"\d{4}/\d\d/\d\d \d\d?:\d\d:\d\d\.\d+")),
    ("clock", re.compile(r"\d\d?:\d\d:\d\d([.,]\d+)?")),
)


@dataclass(frozen=True)
class TextLayout:
    """How a file is laid out, the names and units of its columns ("" where none stands), and why.

    `clocks` says of each column how its stamps are written where they are text, else "". `above` are the lines over the
    header, which often hold rates.
    """

    shape: CsvShape
    names: tuple[str, ...]
    units: tuple[str, ...]
    clocks: tuple[str, ...]
    above: tuple[str, ...]
    guesses: tuple[str, ...]


@dataclass(frozen=True)
class _Rows:
    """A stretch of lines that hold numbers under one separator and decimal sign."""

    separator: str
    decimal: str
    start: int
    count: int
    cells: tuple[str, ...]

    @property
    def worth(self) -> tuple[int, int]:
        return self.count * len(self.cells), len(self.cells)


def read_layout(path: Path) -> TextLayout:
    """The layout that the first lines of a file show; refuses one without rows of numbers (`UnreadableInputError`)."""
    text, encoding = first_text(path, _LOOKED_AT)
    lines = text.splitlines()
    made = [_rows(lines, s, d) for s, d in product(_SEPARATORS, (".", ",")) if s != d]
    best = max((rows for rows in made if rows is not None), key=lambda rows: rows.worth, default=None)
    if best is None:
        raise UnreadableInputError(*_nothing(path, lines))
    return _layout(lines, best, encoding)


def _nothing(path: Path, lines: Sequence[str]) -> tuple[str, str, str]:
    full = [line for line in lines if line.strip()]
    if not full:
        return f"{path.name} is empty", "no line with anything in it", "record again, or name another file"
    if len(full) == 1:
        return (
            f"{path.name} holds a header and no rows", short(full[0], 80), "record again, or name another file"
        )  # fmt: skip
    return f"{path.name} holds no rows of numbers", short(full[-1], 80), "name a file with a row of numbers a sample"


def cells_of(line: str, separator: str) -> tuple[str, ...]:
    """The cells of a line, without blanks and quotes around them; a separator at the end makes no cell."""
    parts = line.split() if separator == " " else line.rstrip("\r\n").split(separator)
    return tuple(part.strip().strip('"').strip() for part in parts)


def clock_of(cell: str) -> str:
    """How a stamp written as text is written, "" for what is none."""
    return next((name for name, pattern in _CLOCKS if pattern.fullmatch(cell)), "")


def _is_value(cell: str, decimal: str) -> bool:
    number = cell.replace(",", ".") if decimal == "," else cell
    return bool(_NUMBER.fullmatch(number)) and not (decimal == "," and "." in cell)


def _full(cells: Sequence[str], decimal: str) -> bool:
    """Whether cells are those of a row: values, stamps, and few empty ones."""
    filled = [cell for cell in cells if cell]
    values = sum(_is_value(cell, decimal) for cell in filled)
    return bool(values) and values + sum(bool(clock_of(cell)) for cell in filled) == len(filled) > len(cells) // 2


def _rows(lines: Sequence[str], separator: str, decimal: str) -> _Rows | None:
    """The last stretch of lines with values and one number of cells; it reaches the end but for empty lines."""
    end = len(lines)
    while end and not lines[end - 1].strip():
        end -= 1
    start, cells = end, None
    while start:
        found = cells_of(lines[start - 1], separator)
        if not _full(found, decimal) or (cells is not None and len(found) != len(cells)):
            break
        cells, start = cells or found, start - 1
    return None if cells is None else _Rows(separator, decimal, start, end - start, cells)


def _layout(lines: Sequence[str], rows: _Rows, encoding: str) -> TextLayout:
    width, over = len(rows.cells), [k for k in range(rows.start) if lines[k].strip()]
    heads = [k for k in over[-3:] if len(cells_of(lines[k].lstrip("#%; "), rows.separator)) == width]
    if heads and heads[-1] != over[-1]:  # something else stands between
        heads = []
    texts = {k: cells_of(lines[k].lstrip("#%; "), rows.separator) for k in heads}
    units_at = heads[-1] if len(heads) > 1 and _look_like_units(texts[heads[-1]]) else None
    named = (heads[-2] if units_at is not None else heads[-1]) if heads else None
    names = ("",) * width if named is None else texts[named]
    units = ("",) * width if units_at is None else texts[units_at]
    by_name = named is not None and _usable(lines[named], names, rows.separator)
    shape = CsvShape(
        rows.separator,
        by_name,
        named if by_name and named is not None else rows.start,
        rows.decimal,
        rows.start - named - 1 if by_name and named is not None else 0,
        encoding,
    )
    guesses = tuple(_sentences(rows, shape, named, units_at, encoding))
    clocks = tuple("" if _is_value(cell, rows.decimal) else clock_of(cell) for cell in rows.cells)
    return TextLayout(shape, names, units, clocks, tuple(lines[: rows.start]), guesses)


def _usable(line: str, names: Sequence[str], separator: str) -> bool:
    """Whether columns can be picked by the header's names as the reader of tables takes them."""
    given = [name for name in names if name]
    plain = line[:1] not in "#%;" and (separator == " " or tuple(cells_of(line, separator)) == tuple(names))
    return plain and len(set(given)) == len(given) > 0


def _look_like_units(cells: Sequence[str]) -> bool:
    """Whether a row holds units: short, some in brackets or known, and no two long words."""
    from loopshape.io.column_words import unit_of_word

    filled = [cell for cell in cells if cell]
    known = sum(cell[0] in "[(" or unit_of_word(cell) is not None for cell in filled)
    return bool(filled) and 2 * known >= len(filled) and max(map(len, filled)) <= 12


def _sentences(rows: _Rows, shape: CsvShape, named: int | None, units_at: int | None, encoding: str) -> list[str]:
    every = f"{rows.count} lines looked at have {len(rows.cells)} cells of numbers with it"
    said = [f"separator {_NAMED[rows.separator]}, decimal sign {rows.decimal!r}: {every}."]
    if named is None:
        said.append(f"no header: the first row of numbers is line {rows.start + 1}, and no line of names stands above.")
    else:
        by = (
            "columns are picked by name"
            if shape.header
            else "columns are picked by number (names repeat or are a remark)"
        )
        said.append(f"line {named + 1} is the header: {by}.")
    if units_at is not None:
        said.append(f"line {units_at + 1} is a row of units.")
    if encoding != "utf-8-sig":
        said.append(f"encoding {encoding}: the text is no UTF-8.")
    return said
