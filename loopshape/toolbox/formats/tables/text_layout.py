"""How somebody's file of text is laid out, read off its first lines: separator, decimal sign, header, units, rows."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from loopshape.core.errors import UnreadableInputError
from loopshape.io.csv_text import CsvShape, bytes_of
from loopshape.io.files import reading, short
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF

_SEPARATORS = (";", "\t", ",", "|", " ")
_NAMED = {"\t": "tab", " ": "blanks", ",": "comma", ";": "semicolon", "|": "bar"}
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
#: first words of lines that name the channels or their units
_UNIT_LINE = re.compile(r"(?<!time )(unit|einheit)", re.IGNORECASE)
_NAME_LINE = re.compile(r"^(name|symbol ?name|signal|channel|variable|trace ?names?)s?$", re.IGNORECASE)
_PERIOD_UNIT = re.compile(r"(?:sample|cycle|time)[^\[]*\[(us|µs|ms|s)\]", re.IGNORECASE)
#: what a cell is called that holds a day alone
DATE = "date"
_CLOCKS = (
    (DATE, re.compile(r"\d\d?\.\d\d?\.\d{4}|\d{4}-\d\d-\d\d|\d\d?/\d\d?/\d{4}")),
    ("iso", re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?(Z|[+-]\d\d:?\d\d)?")),
    ("%d.%m.%Y %H:%M:%S.%f", re.compile(r"\d\d?\.\d\d?\.\d{4} \d\d?:\d\d:\d\d\.\d+")),
    ("%d.%m.%Y %H:%M:%S,%f", re.compile(r"\d\d?\.\d\d?\.\d{4} \d\d?:\d\d:\d\d,\d+")),
    ("%d.%m.%Y %H:%M:%S", re.compile(r"\d\d?\.\d\d?\.\d{4} \d\d?:\d\d:\d\d")),
    ("%Y/%m/%d %H:%M:%S.%f", re.compile(r"\d{4}/\d\d/\d\d \d\d?:\d\d:\d\d\.\d+")),
    ("clock", re.compile(r"\d\d?:\d\d:\d\d([.,]\d+)?|-?\d+([.,]\d+)? (sec|min|hr)")),
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
    looked_at = 1 << 18  # bytes
    text, encoding = first_text(path, looked_at)
    lines = text.splitlines()
    best = None
    for words in (False, True):
        made = [_rows(lines, s, d, words) for s, d in product(_SEPARATORS, (".", ",")) if s != d]
        best = best or max((rows for rows in made if rows is not None), key=lambda rows: rows.worth, default=None)
    if best is None:
        raise UnreadableInputError(*_nothing(path, lines))
    _refuse_rows_above(path, lines, best)
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


def _full(cells: Sequence[str], decimal: str, texts: Collection[int]) -> bool:
    """Whether cells are those of a row: values, stamps, few empty ones, and texts in columns of text alone."""
    filled = [cell for k, cell in enumerate(cells) if cell and k not in texts]
    values = sum(_is_value(cell, decimal) for cell in filled)
    whole = values + sum(bool(clock_of(cell)) for cell in filled) == len(filled)
    return bool(values) and whole and 2 * len(filled) >= len(cells) - len(texts)


def _texts(cells: Sequence[str], decimal: str) -> frozenset[int]:
    """Columns of text in a row that has twice as many values at least."""
    values = sum(_is_value(cell, decimal) for cell in cells)
    found = frozenset(k for k, cell in enumerate(cells) if cell and not _is_value(cell, decimal) and not clock_of(cell))
    return found if 2 * len(found) <= values else frozenset()


def _rows(lines: Sequence[str], separator: str, decimal: str, words: bool) -> _Rows | None:
    """The last stretch of lines with values and one number of cells; it reaches the end but for empty lines.

    With `words` columns may hold text, as the last line does. A last line that was cut does not count.
    """
    end = len(lines)
    while end and not lines[end - 1].strip():
        end -= 1
    found = _stretch(lines, end, separator, decimal, words)
    if end > 3 and (found is None or found.count == 1):
        before = _stretch(lines, end - 1, separator, decimal, words)
        found = before if before is not None and before.count > 1 else found
    return found


def _stretch(lines: Sequence[str], end: int, separator: str, decimal: str, words: bool) -> _Rows | None:
    """The lines above an end that are rows of one number of cells."""
    texts = _texts(cells_of(lines[end - 1], separator), decimal) if words and end else frozenset()
    start, cells = end, None
    while start:
        found = cells_of(lines[start - 1], separator)
        if not _full(found, decimal, texts) or (cells is not None and len(found) != len(cells)):
            break
        cells, start = cells or found, start - 1
    return None if cells is None else _Rows(separator, decimal, start, end - start, cells)


def _refuse_rows_above(path: Path, lines: Sequence[str], rows: _Rows) -> None:
    """Refuse a file whose rows stop and go on: what stands above the last stretch would be lost."""
    run = 0
    table = 4  # rows in a line that are a table, and no numbers of a head
    for k in range(rows.start - 1, -1, -1):
        cells = cells_of(lines[k], rows.separator)
        run = run + 1 if len(cells) == len(rows.cells) and _full(cells, rows.decimal, ()) else 0
        if run == table:
            broken = next(j for j in range(rows.start - 1, -1, -1) if j == k + run or lines[j].strip())
            raise UnreadableInputError(
                f"{path.name} holds several tables, one below the other",
                f"rows above line {rows.start + 1} too, behind {short(lines[broken], 60)!r}",
                "write each into a file of its own, or take out the lines between its rows",
            )


def _layout(lines: Sequence[str], rows: _Rows, encoding: str) -> TextLayout:
    width = len(rows.cells)
    heads = _heads(lines, rows)
    units_at = next((k for k in reversed(heads) if len(heads) > 1 and _look_like_units(heads[k])), None)
    above = [k for k in heads if units_at is None or k < units_at]
    named = next((k for k in reversed(above) if not _all_alike(heads[k])), None)
    names = ("",) * width if named is None else heads[named]
    units = _beside(lines[: rows.start], _UNIT_LINE, width) if units_at is None else heads[units_at]
    by_name = named is not None and _usable(lines[named], names, rows.separator)
    if pairs := _pairs(heads):
        names, units, by_name = pairs
    elif named is None:
        names = _beside(lines[: rows.start], _NAME_LINE, width)
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
    notes = [f"{name}: {cell}" for name, cell in zip(names, units, strict=True) if _is_value(cell, rows.decimal)]
    units = tuple("" if _is_value(cell, rows.decimal) and cell != "1" else cell for cell in units)
    return TextLayout(shape, names, units, clocks, (*lines[: rows.start], *notes), guesses)


def _heads(lines: Sequence[str], rows: _Rows) -> dict[int, tuple[str, ...]]:
    """The lines with one cell a column that stand straight above the rows, by their place."""
    found: dict[int, tuple[str, ...]] = {}
    for k in reversed([k for k in range(rows.start) if lines[k].strip()]):
        cells = cells_of(lines[k].lstrip("#%; "), rows.separator)
        more = len(cells) == len(rows.cells) + 1 and cells[-1].lower() in ("", "comment")  # LabVIEW's last column
        cells = cells[:-1] if more else cells
        if len(cells) != len(rows.cells) or len(found) == 12 or not any(cells):
            break
        found[k] = cells
    return dict(sorted(found.items()))


def _all_alike(cells: Sequence[str]) -> bool:
    """Whether a line says the same of several columns, as a row of types does."""
    return len(cells) > 1 and len(set(cells)) == 1


def _beside(lines: Sequence[str], word: re.Pattern[str], width: int) -> tuple[str, ...]:
    """What a line of the head says of each column behind its first word, the time's column left out or not."""
    for line in lines:
        for separator in _SEPARATORS[:-1]:
            first, *rest = cells_of(line, separator)
            if word.search(first) and width - 1 <= len(rest) <= width and all(rest):
                return ("",) * (width - len(rest)) + tuple(rest)
    return ("",) * width


def _pairs(heads: Mapping[int, Sequence[str]]) -> tuple[tuple[str, ...], tuple[str, ...], bool] | None:
    """Names and units where each channel has its time beside it, with a word in the time's column; None otherwise."""
    notes = {cells[0].lower(): cells[1::2] for cells in heads.values() if len(cells) > 3 and _all_alike(cells[0::2])}
    names = next((rest for word, rest in notes.items() if _NAME_LINE.search(word)), None)
    if names is None:
        return None
    units = next((rest for word, rest in notes.items() if _UNIT_LINE.search(word)), ("",) * len(names))
    stamp = next((found[1] for word in notes if (found := _PERIOD_UNIT.search(word))), "")
    columns = [(TIME_OF + name, stamp, name, unit) for name, unit in zip(names, units, strict=True)]
    return tuple(x for c in columns for x in c[0::2]), tuple(x for c in columns for x in c[1::2]), False


def _usable(line: str, names: Sequence[str], separator: str) -> bool:
    """Whether columns can be picked by the header's names as the reader of tables takes them."""
    given = [name for name in names if name]
    plain = line[:1] not in "#%;" and (separator == " " or tuple(cells_of(line, separator)) == tuple(names))
    return plain and len(set(given)) == len(given) > 0


def _look_like_units(cells: Sequence[str]) -> bool:
    """Whether a row holds units: short, some in brackets or known, and no two long words."""
    from loopshape.toolbox.formats.drafts.column_words import unit_of_word

    filled = [cell for cell in cells if cell and not _NUMBER.fullmatch(cell)]
    known = sum(cell[0] in "[(" or unit_of_word(cell) is not None for cell in filled)
    return bool(filled) and 2 * known >= len(filled) and max(map(len, filled)) <= 12


def _sentences(rows: _Rows, shape: CsvShape, named: int | None, units_at: int | None, encoding: str) -> list[str]:
    every = f"{rows.count} lines looked at have {len(rows.cells)} cells of numbers with it"
    notes = [f"separator {_NAMED[rows.separator]}, decimal sign {rows.decimal!r}: {every}."]
    if named is None:
        notes.append(f"no header: the first row of numbers is line {rows.start + 1}, and no line of names is above.")
    else:
        by = (
            "columns are picked by name"
            if shape.header
            else "columns are picked by number (names repeat or are a remark)"
        )
        notes.append(f"line {named + 1} is the header: {by}.")
    if units_at is not None:
        notes.append(f"line {units_at + 1} is a row of units.")
    if encoding != "utf-8-sig":
        notes.append(f"encoding {encoding}: the text is not UTF-8.")
    return notes


def first_text(path: Path, most_bytes: int) -> tuple[str, str]:
    """The beginning of a file of text in whole lines, and its encoding: a mark's, else UTF-8, else Windows-1252."""
    with reading(path, "text"), bytes_of(path) as file:
        data = file.read(most_bytes)
    text, encoding = _decoded(path, data, len(data) == most_bytes)
    return (text[: text.rfind("\n") + 1] or text if len(data) == most_bytes else text), encoding


def whole_text(path: Path, most_bytes: int) -> str:
    """A whole file of text; refuses a longer one, of which a part would be missing in silence."""
    with reading(path, "text"):
        if (size := path.stat().st_size) >= most_bytes:
            raise ValueError(f"it has {size} bytes, and {most_bytes - 1} are read at most")
    return first_text(path, most_bytes)[0]


def _decoded(path: Path, data: bytes, cut: bool) -> tuple[str, str]:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data[: len(data) // 2 * 2].decode("utf-16", errors="replace"), "utf-16"
    if b"\0" in data:
        raise UnreadableInputError(f"{path} is no file of text", "it holds zero bytes", "name its kind by its ending")
    whole = data[: data.rfind(b"\n") + 1] or data if cut else data
    try:
        return whole.decode("utf-8-sig"), "utf-8-sig"
    except UnicodeDecodeError:
        return whole.decode("cp1252", errors="replace"), "cp1252"
