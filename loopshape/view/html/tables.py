"""Tables with captions; those that may be sorted carry each cell's plain value."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isnan

from loopshape.view.html.markup import Content, Markup, joined, tag
from loopshape.view.html.words import number


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
