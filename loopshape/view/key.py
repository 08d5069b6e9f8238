"""Which curve is which: colour and marker by operating point, and the key that says so.

Where the operating points vary in one or two quantities, the first gives the colour, the second the
marker, and the key lists the two apart (5 + 6 entries for 24 points). Otherwise each recording has its
own colour and marker and stands in the key by name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from loopshape.view.labels import numbers, point, quantity
from loopshape.view.style import COLOURS, MARKERS, MARKS, QUIET, shades, styled


class Placed(Protocol):
    """Anything measured at an operating point in a recording: a FRF, a fit."""

    @property
    def recording(self) -> str:
        """Name of the recording."""

    @property
    def operating_point(self) -> Mapping[str, float]:
        """Where the plant rested."""


def count(items: Sequence[Placed]) -> str:
    """How many there are: operating points where they differ, else recordings; one by its name."""
    if len(items) == 1:
        return items[0].recording
    points = {tuple(sorted(item.operating_point.items())) for item in items}
    return f"{len(items)} {'operating points' if len(points) == len(items) else 'recordings'}"


Entry = tuple[str, dict[str, Any]]  # text, line properties; text alone is a heading


@dataclass(frozen=True)
class Key:
    """Line properties of each item, in order, and the rows of the key; `common` is what all items share."""

    looks: tuple[dict[str, Any], ...]
    rows: tuple[tuple[Entry, ...], ...]
    common: str


def varying(items: Sequence[Placed]) -> list[str]:
    """Operating-point keys whose value differs between items; [] where an item lacks a key."""
    points = [item.operating_point for item in items]
    if not points or any(set(p) != set(points[0]) for p in points):
        return []
    return [k for k in points[0] if len({p[k] for p in points}) > 1]


def key_of(items: Sequence[Placed]) -> Key:
    """Looks and key of some items."""
    names = varying(items)
    values = [tuple(item.operating_point[n] for n in names) for item in items]
    if not names or len(names) > 2 or len(set(values)) < len(values):
        return _by_name(items)
    columns = [sorted({v[k] for v in values}) for k in range(len(names))]
    colours = dict(zip(columns[0], shades(len(columns[0])), strict=True))
    looks = [{"color": colours[v[0]]} for v in values]
    rows = [_row(names[0], columns[0], [{"color": c, "linewidth": 2.5} for c in colours.values()])]
    if len(names) == 2:
        markers = {v: MARKERS[k % len(MARKERS)] for k, v in enumerate(columns[1])}
        looks = [look | {"marker": markers[v[1]]} for look, v in zip(looks, values, strict=True)]
        rows.append(_row(names[1], columns[1], [{"color": QUIET, "marker": m} for m in markers.values()]))
    shared = {k: v for k, v in items[0].operating_point.items() if k not in names}
    return Key(tuple(looks), tuple(rows), point(shared))


def _row(name: str, values: Sequence[float], looks: Sequence[dict[str, Any]]) -> tuple[Entry, ...]:
    return ((quantity(name), {}), *zip(numbers(values), looks, strict=True))


def _by_name(items: Sequence[Placed]) -> Key:
    few = len(items) <= len(COLOURS)
    colours = list(COLOURS[: len(items)]) if few else shades(len(items))
    looks = tuple(
        {"color": c} if few else {"color": c, "marker": MARKERS[k % len(MARKERS)]} for k, c in enumerate(colours)
    )
    texts = [item.recording or f"{k + 1}" for k, item in enumerate(items)]
    same = len(items) > 0 and all(item.operating_point == items[0].operating_point for item in items)
    return Key(looks, (tuple(zip(texts, looks, strict=True)),), point(items[0].operating_point) if same else "")


def curve(look: Mapping[str, Any], k: int, n: int) -> dict[str, Any]:
    """Properties of the k-th of n curves: thin, with a few markers at places that differ from curve to curve."""
    if "marker" not in look:
        return {"linewidth": 0.9, **look}
    return {
        "linewidth": 0.8,
        "markersize": 4.0,
        "markeredgewidth": 0.4,
        "markeredgecolor": "white",
        "markevery": (k / n * 0.3, 0.3),
        **look,
    }


@styled()
def place_key(figure: Figure, key: Key) -> Legend | None:
    """The key below the figure, a quantity in as few rows as fit its width; None for a single curve."""
    if len(key.looks) < 2:
        return None
    rows = [line for row in key.rows for line in _broken(row, 72.0 * figure.get_figwidth())]
    width = max(len(row) for row in rows)
    cells = [row[i] if i < len(row) else ("", {}) for i in range(width) for row in rows]  # filled by column
    return figure.legend(
        *_handles(cells),
        loc="outside lower center",
        ncols=width,
        columnspacing=1.2,
        handletextpad=0.5,
        borderaxespad=0.3,
    )


def _broken(row: Sequence[Entry], width_pt: float) -> list[list[Entry]]:
    """A row as lines of about equal length that fit a width; the first alone has the heading."""
    heading = [entry for entry in row[:1] if not entry[1]]
    entries = row[len(heading) :]
    each, first = (max((_width_pt(text) for text, _ in part), default=0.0) for part in (entries, heading))
    columns = max(1, int((width_pt - first) / each))
    n = -(-len(entries) // -(-len(entries) // columns))
    lines = [list(entries[k : k + n]) for k in range(0, len(entries), n)]
    return [[*(heading if not k else [("", {})] * len(heading)), *line] for k, line in enumerate(lines)]


def _width_pt(text: str) -> float:
    """About what an entry takes: its line, the gaps and its letters, at 8 pt."""
    return 28.0 + 5.2 * len(MARKS.sub("", text))


@styled()
def place_notes(ax: Axes, entries: Sequence[Entry], loc: str) -> Legend | None:
    """A small legend inside an axes for what is not a curve; None without entries."""
    handles, texts = _handles(entries)
    return ax.legend(handles, texts, loc=loc, handletextpad=0.5) if entries else None  # type: ignore[call-overload]


def _handles(entries: Sequence[Entry]) -> tuple[list[Line2D], list[str]]:
    return [Line2D([], [], **(look or {"linestyle": "none"})) for _, look in entries], [text for text, _ in entries]
