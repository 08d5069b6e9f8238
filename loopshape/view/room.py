"""Where a picture has room for words: away from curves and from other words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.legend import Legend
from scipy.spatial import KDTree

from loopshape.core.units import TWO_PI, Array
from loopshape.view.key import Entry, place_notes
from loopshape.view.plots.curves import UNTRUSTED

NOTE_SIZE = 7.0
EDGE_IN = (0.34, 0.1)  # half of a contour's words, which are not cut by the frame
_SQUARE_IN, _STRIDE = 0.02, 100_000
_LINE_IN, _LETTER_IN, _HANDLE_IN = 0.155, 0.058, 0.5
_CORNERS = {"upper left": (0, 1), "upper right": (1, 1), "lower left": (0, 0), "lower right": (1, 0)}
_BETWEEN = np.linspace(0.0, 1.0, 6)[:-1]


class Crowd:
    """What an axes with linear scales already holds; the axes are taken to be `size_in` inches wide and high."""

    def __init__(self, ax: Axes, size_in: tuple[float, float]) -> None:
        self._ax, self._size = ax, np.array(size_in)
        self._data = np.zeros((0, 2))
        self._tree: KDTree | None = None
        for line in ax.lines:
            if line.get_gid() != UNTRUSTED:
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
        inside = np.all((places > EDGE_IN) & (places < self._size - EDGE_IN), axis=1)
        if self._tree is None:
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
        width, height = box_in(entries)
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
        across, up = np.round((places + 1.0) / _SQUARE_IN).astype(int).T
        _, first = np.unique(across * _STRIDE + up, return_index=True)
        return np.asarray(places[first])

    def _scale(self, xy: Array) -> Array:
        (x_low, x_high), (y_low, y_high) = self._ax.get_xlim(), self._ax.get_ylim()
        return (xy - (x_low, y_low)) / (x_high - x_low, y_high - y_low) * self._size

    def _unscale(self, inches: Array) -> Array:
        (x_low, x_high), (y_low, y_high) = self._ax.get_xlim(), self._ax.get_ylim()
        return inches / self._size * (x_high - x_low, y_high - y_low) + (x_low, y_low)


def box_in(entries: Sequence[Entry]) -> tuple[float, float]:
    """Width and height in inches that some notes take."""
    longest = max((len(text) for text, _ in entries), default=0)
    return _HANDLE_IN + _LETTER_IN * longest, 0.1 + _LINE_IN * len(entries)


def corner_with_room(ax: Axes, crowd: Crowd, entries: Sequence[Entry], step: float = 10.0) -> str:
    """The corner that holds least; where none is free the axes grow upwards by whole steps until an upper one is."""
    width, height = box_in(entries)
    held = {loc: crowd.in_corner(loc, width, height).size for loc in _CORNERS}
    loc = min(held, key=lambda name: held[name])
    if held[loc]:
        loc = min(("upper left", "upper right"), key=lambda name: held[name])
        for _ in range(6):
            if not crowd.in_corner(loc, width, height).size:
                break
            low, high = ax.get_ylim()
            ax.set_ylim(low, high + step)
    return loc


def place_entries(ax: Axes, entries: Sequence[Entry], loc: str) -> Legend | None:
    """Small notes in a corner; None without entries."""
    legend = place_notes(ax, entries, loc)
    for text in legend.get_texts() if legend is not None else ():
        text.set_fontsize(NOTE_SIZE)
    return legend
