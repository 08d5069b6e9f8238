"""Which curve is which: colour and marker by operating point, and the key that says so.

Where the operating points vary in one or two quantities, the first gives the colour, the second the
marker, and the key lists the two apart (5 + 6 entries for 24 points). Otherwise each recording has its
own colour and marker and stands in the key by name. Words stand where a picture has room for them: away from curves
and from other words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from loopshape.core.units import TWO_PI, Array
from loopshape.view.labels import numbers, point, quantity
from loopshape.view.plots.curves import NOT_VALID
from loopshape.view.style import COLOURS, MARKERS, MARKS, QUIET, shades, styled

if TYPE_CHECKING:
    from scipy.spatial import KDTree


class Placed(Protocol):
    """Anything measured at an operating point in a recording: an FRF, a fit."""

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


def notes_with_room(ax: Axes, entries: Sequence[Entry], loc: str) -> None:
    """Such a legend at the lower or the upper end of an axes, which grows there to hold it."""
    if place_notes(ax, entries, loc):
        low, high = ax.get_ylim()
        room = 0.13 * len(entries) * (high - low)
        ax.set_ylim((low - room, high) if loc.startswith("lower") else (low, high + room))


def _handles(entries: Sequence[Entry]) -> tuple[list[Line2D], list[str]]:
    return [Line2D([], [], **(look or {"linestyle": "none"})) for _, look in entries], [text for text, _ in entries]


_EDGE_IN = (0.34, 0.1)  # half of a contour's words, which are not cut by the frame
_LINE_IN, _LETTER_IN, _HANDLE_IN = 0.155, 0.058, 0.5
_CORNERS = {"upper left": (0, 1), "upper right": (1, 1), "lower left": (0, 0), "lower right": (1, 0)}
_BETWEEN = np.linspace(0.0, 1.0, 6)[:-1]


class LabelRoom:
    """What an axes with linear scales already holds; the axes are taken to be `size_in` inches wide and high."""

    def __init__(self, ax: Axes, size_in: tuple[float, float]) -> None:
        self._ax, self._size = ax, np.array(size_in)
        self._data = np.zeros((0, 2))
        self._tree: KDTree | None = None
        for line in ax.lines:
            if line.get_gid() != NOT_VALID:
                self.add(*np.asarray(line.get_xydata()).T)

    def add(self, x: Array, y: Array) -> None:
        """A curve (n,) in the axes' own units that words should keep away from."""
        xy = np.column_stack([x, y]).astype(float)
        between = xy[:-1, None] + _BETWEEN[:, None] * np.diff(xy, axis=0)[:, None]
        xy = np.vstack([between.reshape(-1, 2), xy[-1:]])
        self._hold(xy[np.isfinite(xy).all(axis=1)])

    def add_box(self, x: float, y: float, width_in: float, height_in: float) -> None:
        """Words about a place, as wide and high as stated."""
        across, up = np.meshgrid(np.linspace(-0.5, 0.5, 9) * width_in, np.linspace(-0.5, 0.5, 3) * height_in)
        box = self._scale(np.array([[x, y]])) + np.column_stack([across.ravel(), up.ravel()])
        self._hold(self._unscale(box))

    def distance_in(self, x: Array, y: Array) -> Array:
        """Distance (n,) in inches from places to the nearest thing; minus one outside the axes or near their edge."""
        places = self._scale(np.column_stack([x, y]))
        inside = np.all((places > _EDGE_IN) & (places < self._size - _EDGE_IN), axis=1)
        if self._tree is None:
            from scipy.spatial import KDTree

            self._tree = KDTree(self._held_in())
        return np.where(inside, self._tree.query(np.where(inside[:, None], places, 0.0))[0], -1.0)

    def room_in(self, place: Array) -> float:
        """Distance in inches of one place (2,) to the nearest thing."""
        return float(self.distance_in(place[:1], place[1:])[0])

    def emptiest(self, x: Array, y: Array) -> int | None:
        """Which of some places has most room; None where all lie outside."""
        room = self.distance_in(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        return int(np.argmax(room)) if room.size and room.max() >= 0.0 else None

    def add_corner(self, loc: str, entries: Sequence[Entry]) -> None:
        """Notes in a corner."""
        width, height = _box_in(entries)
        right, upper = _CORNERS[loc]
        centre = np.array([self._size[0] - 0.5 * width if right else 0.5 * width, 0.5 * height])
        centre[1] = self._size[1] - centre[1] if upper else centre[1]
        across, up = np.meshgrid(np.linspace(-0.5, 0.5, 15) * width, np.linspace(-0.5, 0.5, 11) * height)
        box = centre + np.column_stack([across.ravel(), up.ravel()])
        self._hold(self._unscale(box))

    def around(self, x: float, y: float, radius_in: float) -> Array:
        """Places (48, 2) about a place on two circles, the larger half as wide again."""
        turn = np.linspace(0.0, TWO_PI, 24, endpoint=False)
        circle = np.column_stack([1.4 * np.cos(turn), np.sin(turn)]) * radius_in
        return self._unscale(self._scale(np.array([[x, y]])) + np.vstack([circle, 1.5 * circle]))

    def in_corner(self, loc: str, width_in: float, height_in: float) -> Array:
        """Heights in inches (n,) of what stands in a corner's columns and reaches into the corner."""
        right, upper = _CORNERS[loc]
        places = self._scale(self._data)
        places = places[((places >= 0.0) & (places <= self._size)).all(axis=1)]
        across = places[:, 0] > self._size[0] - width_in if right else places[:, 0] < width_in
        up = places[:, 1] > self._size[1] - height_in if upper else places[:, 1] < height_in
        return places[across & up, 1]

    def _hold(self, xy: Array) -> None:
        self._data, self._tree = np.vstack([self._data, xy]), None

    def _held_in(self) -> Array:
        """Places in inches, one of those that lie within a small square."""
        places = self._scale(self._data)
        places = places[((places > -1.0) & (places < self._size + 1.0)).all(axis=1)]
        if not len(places):
            return np.full((1, 2), -9.0)
        square_in = 0.02
        across, up = np.round((places + 1.0) / square_in).astype(int).T
        square = across * (up.max() + 1) + up
        first = np.full(square.max() + 1, -1)
        first[square[::-1]] = np.arange(len(square))[::-1]  # the last one written is the first; sorting takes longer
        return np.asarray(places[first[first >= 0]])

    def _scale(self, xy: Array) -> Array:
        (x_low, x_high), (y_low, y_high) = self._ax.get_xlim(), self._ax.get_ylim()
        return (xy - (x_low, y_low)) / (x_high - x_low, y_high - y_low) * self._size

    def _unscale(self, inches: Array) -> Array:
        (x_low, x_high), (y_low, y_high) = self._ax.get_xlim(), self._ax.get_ylim()
        return inches / self._size * (x_high - x_low, y_high - y_low) + (x_low, y_low)


def _box_in(entries: Sequence[Entry]) -> tuple[float, float]:
    """Width and height in inches that some notes take."""
    longest = max((len(text) for text, _ in entries), default=0)
    return _HANDLE_IN + _LETTER_IN * longest, 0.1 + _LINE_IN * len(entries)


def corner_with_room(ax: Axes, room: LabelRoom, entries: Sequence[Entry], step: float = 10.0) -> str:
    """The corner that holds least; where none is free the axes grow upwards by whole steps until an upper one is."""
    width, height = _box_in(entries)
    held = {loc: room.in_corner(loc, width, height).size for loc in _CORNERS}
    loc = min(held, key=lambda name: held[name])
    if held[loc]:
        loc = min(("upper left", "upper right"), key=lambda name: held[name])
        for _ in range(6):
            if not room.in_corner(loc, width, height).size:
                break
            low, high = ax.get_ylim()
            ax.set_ylim(low, high + step)
    return loc


def place_entries(ax: Axes, entries: Sequence[Entry], loc: str) -> Legend | None:
    """Small notes in a corner; None without entries."""
    legend = place_notes(ax, entries, loc)
    for text in legend.get_texts() if legend is not None else ():
        text.set_fontsize(7.0)
    return legend
