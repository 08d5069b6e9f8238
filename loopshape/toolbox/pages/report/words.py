"""Numbers, names, outcomes and tables as the report writes them; sortable tables carry each cell's plain value."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isinf, isnan

from loopshape.core.outcomes import Outcome
from loopshape.data.result.verdict_words import Notation
from loopshape.toolbox.pages.markup import Content, Markup, joined, tag
from loopshape.view.labels import split_unit

DASH = "\N{EN DASH}"
#: outcome -> its word
WORDS: dict[Outcome | None, str] = {None: "no verdict"} | {one: one.word for one in Outcome}
_SIGNS = {
    Outcome.PASSED: "M4.5 10.5l3.6 3.8 7.4-8.4",
    Outcome.FAILED: "M5.5 5.5l9 9m0-9l-9 9",
    Outcome.UNDECIDED: "M7 7.6c0-4 6-4 6-.4 0 2.4-3 2.4-3 4.8m0 2.6v.6",
    None: "M5 10h10",
}


def number(value: float | None, figures: int = 4) -> str:
    """Four figures with a true minus sign, a dash for what is not there."""
    if value is None or isnan(value):
        return DASH
    if isinf(value):
        return "∞" if value > 0 else "\N{MINUS SIGN}∞"
    shown = "0" if abs(value) < 1e-9 else f"{value:.{figures}g}"
    return shown.replace("e-0", "e-").replace("e+0", "e").replace("e+", "e").replace("-", "\N{MINUS SIGN}")


#: how the report writes a verdict's table
TYPESET = Notation(number, DASH, " … ", ("≥", "≤"), ("≥ ", "≤ "), {"s": ("ms", 1e3), "1": ("", 1.0)})


def point(operating_point: Mapping[str, float], parameters: Mapping[str, float] | None = None) -> str:
    """An operating point and the rig's settings in words; empty where there are none."""
    parts = []
    for key, value in {**operating_point, **(parameters or {})}.items():
        name, unit = split_unit(key)
        parts.append(f"{name} {number(value)} {'' if unit == '1' else unit}".rstrip())
    return ", ".join(parts)


def named(name: str, where: str) -> Markup:
    """A recording's name, and below it its operating point."""
    return joined([name, tag("span", where, class_="interval95") if where else None])


def count(n: int, what: str) -> str:
    """`1 recording`, `2 recordings`."""
    return f"{n} {what}{'' if n == 1 else 's'}"


def sign(outcome: Outcome | None) -> Markup:
    """An outcome's sign: tick, cross, question mark or dash, told apart without colour."""
    shape = tag("path", d=_SIGNS[outcome])
    return tag("svg", shape, class_="sign", viewBox="0 0 20 20", aria_hidden="true", focusable="false")


def badge(outcome: Outcome | None, word: str | None = None) -> Markup:
    """An outcome as sign and word."""
    return tag(
        "span", joined([sign(outcome), tag("span", word or WORDS[outcome])]), class_=f"badge {outcome or 'none'}"
    )


@dataclass(frozen=True)
class Cell:
    """What a cell shows, the number it sorts by (None: its text), and its class."""

    shown: Content
    value: float | None = None
    kind: str | None = None


def figure(value: float | None, shown: Content = None, kind: str | None = None) -> Cell:
    """A number's cell."""
    return Cell(number(value) if shown is None else shown, float("nan") if value is None else value, kind)


def table(
    caption: Content,
    columns: Sequence[Content],
    rows: Iterable[Sequence[Cell | Content]],
    *,
    sortable: bool = False,
    cards: bool = False,
) -> Markup:
    """A table whose first column heads its rows, in a frame that scrolls by itself where the page is too narrow.

    `cards` sets each row below the other on a narrow page, each cell with its column's name.
    """
    made = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in rows]
    numeric = [all(row[k].value is not None for row in made) for k in range(len(columns))]
    heads = [
        tag("th", column, scope="col", class_="number" if is_number else None)
        for column, is_number in zip(columns, numeric, strict=True)
    ]
    body = [
        tag("tr", *(_cell(cell, columns[k], head=k == 0, number=numeric[k]) for k, cell in enumerate(row)))
        for row in made
    ]
    words = " ".join(word for word, on in (("sortable", sortable), ("cards", cards)) if on) or None
    inner = tag(
        "table",
        tag("caption", tag("span", caption)),
        tag("thead", tag("tr", *heads)),
        tag("tbody", *body),
        class_=words,
    )
    return tag("div", inner, class_="scroll")


def _cell(cell: Cell, column: Content, *, head: bool, number: bool) -> Markup:
    kind = " ".join(word for word in ("number" if number else "", cell.kind or "") if word) or None
    label = column if isinstance(column, str) and not isinstance(column, Markup) else None
    return tag(
        "th" if head else "td",
        cell.shown,
        scope="row" if head else None,
        class_=kind,
        data_label=label,
        data_value=None if cell.value is None or isnan(cell.value) else f"{cell.value:.9g}",
    )


def definitions(pairs: Iterable[tuple[Content, Content]]) -> Markup:
    """Names with what they stand for."""
    return tag("dl", joined(joined([tag("dt", name), tag("dd", what)]) for name, what in pairs))


def details(summary: Content, *inside: Content, open_: bool = False, print_: bool = True) -> Markup:
    """A part that opens on demand; printing opens all but those with `print_` False, which it leaves out."""
    return tag("details", tag("summary", summary), *inside, open=open_, class_=None if print_ else "screen")


_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


def together(notes: Sequence[tuple[str, str]], *, named: bool = True) -> list[Markup]:
    """Items of a list of notes, each with the recording that it is of ("" for none): those that differ by the recording
    and by numbers alone are one item, which names them all and holds each one's words folded away.

    `named` says that the recording stands in front of each note.
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for name, note in dict.fromkeys(notes):
        groups.setdefault(_NUMBER.sub("0", note.replace(name, "", 1) if name else note), []).append((name, note))
    return [_item(group, named) for group in groups.values()]


def _item(group: Sequence[tuple[str, str]], named: bool) -> Markup:
    words = [f"{name}: {note}" if named and name else note for name, note in group]
    if len(group) == 1:
        return tag("li", words[0])
    names = [name for name, _ in group if name]
    head = f"{len(group)} recordings alike ({', '.join(dict.fromkeys(names))}); the first: {words[0]}"
    return tag("li", tag("p", head), details("all of them", tag("ul", *(tag("li", x) for x in words)), print_=False))
