"""A block diagram drawn: signals run to the right, what leads back lies below."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

from loopshape.toolbox.diagrams.diagram import Diagram
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, QUIET, axes_or_new, styled

#: distance of columns and of rows, half width and half height of a block, radius of a sum; in units of the diagram
COLUMN, ROW, WIDE, HIGH, ROUND = 2.0, 1.25, 0.55, 0.34, 0.15
_TEXT = 8.0
_PLANT, _TUNED = "#E4EEF7", "#FBE6D9"
Edge = tuple[str, str, str, float]


@dataclass(frozen=True)
class Layout:
    """Blocks, sums and outside signals by name: places (x, y), and which of them lead back (from right to left)."""

    places: Mapping[str, tuple[float, float]]
    back: frozenset[str]
    edges: tuple[Edge, ...]  # from, to, signal, sign


def layout_of(D: Diagram) -> Layout:
    """Columns by the longest way from outside, rows by whom a node follows; circles are cut where they come back."""
    edges = _edges(D)
    after: dict[str, list[str]] = {}
    for source, target, _, _ in edges:
        after.setdefault(source, []).append(target)
    after = {name: sorted(targets, key=lambda t: t not in D.sums) for name, targets in after.items()}
    returning = _returning(after, [*sorted(D.external), *(one.name for one in D.parts)])
    back = _leading_back(D, edges, returning)
    forward = [e for e in edges if (e[0], e[1]) not in returning and not {e[0], e[1]} & back]
    nodes = list(dict.fromkeys([*D.external, *(n for e in edges for n in e[:2])]))
    column = _columns([n for n in nodes if n not in back], forward, {one.name for one in D.parts})
    row = _rows(column, forward)
    places = {n: (COLUMN * column[n], -ROW * row[n]) for n in column}
    for name in D.external:  # close to what it enters
        targets = [places[e[1]] for e in forward if e[0] == name]
        if targets and len(targets) == 1:
            x, y = targets[0]
            places[name] = (x - 0.75 * COLUMN, y) if not _entered(forward, places, name, targets[0]) else (x, y + ROW)
    lowest = min(y for _, y in places.values())
    for k, name in enumerate(sorted(back)):
        ends = [e[0] if e[1] == name else e[1] for e in edges if name in e[:2]]
        xs = [places[n][0] for n in ends if n in places] or [0.0]
        places[name] = (float(np.mean(xs)), lowest - ROW * (k + 1))
    return Layout(places, frozenset(back), edges)


def _edges(D: Diagram) -> tuple[Edge, ...]:
    """Lines from the maker of each signal to its readers: blocks, and sums by the name of what they give out."""
    maker = {name: one.name for one in D.parts for name in one.outputs}
    found = [(maker.get(s, s), one.name, s, 1.0) for one in D.parts for s in one.inputs]
    found += [(maker.get(s, s), name, s, sign) for name in D.sums for sign, s in D.terms(name)]
    return tuple(found)


def _returning(after: Mapping[str, Sequence[str]], order: Sequence[str]) -> set[tuple[str, str]]:
    """Edges that lead back to a node on the way from outside, depth first."""
    seen: dict[str, bool] = {}
    found = set()

    def walk(name: str) -> None:
        seen[name] = True
        for target in after.get(name, ()):
            if seen.get(target):
                found.add((name, target))
            elif target not in seen:
                walk(target)
        seen[name] = False

    for name in order:
        if name not in seen:
            walk(name)
    return found


def _leading_back(D: Diagram, edges: Sequence[Edge], returning: set[tuple[str, str]]) -> set[str]:
    """Blocks all of whose outputs lead back: filters in a feedback path."""
    back: set[str] = set()
    plants = {one.name for one in D.parts if one.plants}
    while True:
        more = {
            node
            for node in {e[0] for e in edges} - set(D.external) - back - plants
            if all((node, e[1]) in returning or e[1] in back for e in edges if e[0] == node)
        } - {name for name in D.sums if any((name, e[1]) in returning for e in edges) and name not in back}
        more = {n for n in more if n not in D.sums or any(e[1] in back for e in edges if e[0] == n)}
        if not more:
            return back
        back |= more


def _columns(nodes: Sequence[str], forward: Sequence[Edge], blocks: set[str]) -> dict[str, int]:
    column = dict.fromkeys(nodes, 0)
    for _ in nodes:
        for source, target, _, _ in forward:
            column[target] = max(column[target], column[source] + 1)
    for name in sorted(set(nodes) & blocks, key=lambda n: -column[n]):  # and as near as can be to what it drives
        column[name] = min([column[e[1]] - 1 for e in forward if e[0] == name], default=column[name])
    return column


def _rows(column: Mapping[str, int], forward: Sequence[Edge]) -> dict[str, int]:
    """The row of the first node that leads there, where it is free, else the next one."""
    row: dict[str, int] = {}
    taken: set[tuple[int, int]] = set()
    for name in sorted(column, key=lambda n: column[n]):
        before = [row[e[0]] for e in forward if e[1] == name and e[0] in row]
        r = min(before, default=0)
        while (column[name], r) in taken:
            r += 1
        row[name] = r
        taken.add((column[name], r))
    return row


def _entered(
    forward: Sequence[Edge], places: Mapping[str, tuple[float, float]], name: str,
    target: tuple[float, float],
) -> bool:  # fmt: skip
    """Whether another line comes into that place from the left."""
    return any(places[e[1]] == target and e[0] != name and places[e[0]][1] == target[1] for e in forward)


@styled()
def diagram(D: Diagram, *, ax: Axes | None = None) -> Axes:
    """A block diagram: plants blue, the tuned block orange; a new figure of its size without `ax`."""
    made = layout_of(D)
    xs = np.array([x for x, _ in made.places.values()])
    lines = _Lines(made, D)
    low, high = lines.lowest - 0.3, lines.highest + 0.3
    if ax is None:
        wide = float(np.ptp(xs)) + 3.2
        unit_in = min(0.52, FULL_WIDTH_IN / wide)
        ax = Figure(figsize=(unit_in * wide, unit_in * (high - low))).add_subplot()
    ax = axes_or_new(ax)
    ax.set_axis_off()
    ax.set_aspect("equal")
    ax.set_xlim(xs.min() - 1.2, lines.furthest + 1.3)
    ax.set_ylim(low, high)
    ends = {name for name in (*D.sums, *(p.name for p in D.parts))} & set(made.places)
    for edge in made.edges:
        lines.draw(ax, edge)
    for name in made.places:
        _node(ax, D, name, made.places[name])
    for name in sorted(ends - {e[0] for e in made.edges}):  # what is left with no reader
        _out(ax, D, name, made.places[name])
    return ax


def _node(ax: Axes, D: Diagram, name: str, at: tuple[float, float]) -> None:
    if name in D.external:
        ax.text(at[0], at[1], name, ha="center", va="center", style="italic", fontsize=_TEXT)
        return
    if name in D.sums:
        ax.add_patch(Circle(at, ROUND, facecolor="white", edgecolor="0.2", linewidth=0.9, zorder=3))
        return
    part = D.part(name)
    face = _TUNED if name == D.tuned else _PLANT if part.plants else "white"
    corner = (at[0] - WIDE, at[1] - HIGH)
    box = FancyBboxPatch(corner, 2 * WIDE, 2 * HIGH, boxstyle="round,pad=0,rounding_size=0.06", facecolor=face)
    box.set(edgecolor=COLOURS[1] if name == D.tuned else "0.2", linewidth=0.9, zorder=3)
    ax.add_patch(box)
    ax.text(*at, name, ha="center", va="center", fontsize=_TEXT if len(name) < 6 else 6.5, zorder=4)


def _out(ax: Axes, D: Diagram, name: str, at: tuple[float, float]) -> None:
    radius = ROUND if name in D.sums else WIDE
    label = name if name in D.sums else ", ".join(D.part(name).outputs)
    ax.annotate("", (at[0] + radius + 0.7, at[1]), (at[0] + radius, at[1]), arrowprops=_ARROW)
    ax.text(at[0] + radius + 0.35, at[1] + 0.1, label, ha="center", style="italic", fontsize=_TEXT - 1.0)


_ARROW = {
    "arrowstyle": "-|>,head_length=0.35,head_width=0.16",
    "color": "0.2",
    "linewidth": 0.9,
    "shrinkA": 0,
    "shrinkB": 0,
}


class _Lines:
    """The lines of a layout: straight ahead, to another row, above what stands in the way, or back below it all."""

    def __init__(self, made: Layout, D: Diagram) -> None:
        self.made, self.D = made, D
        self.labelled: set[str] = set()
        lowest = min(y for _, y in made.places.values()) - 0.35
        back = [e for e in made.edges if self._returns(e)]
        shortest_first = sorted(back, key=lambda e: made.places[e[0]][0] - made.places[e[1]][0])
        signals = list(dict.fromkeys(e[2] for e in shortest_first))
        self.lanes = {name: lowest - 0.3 * (k + 1) for k, name in enumerate(signals)}
        self.lowest = min([lowest, *self.lanes.values()])
        self.highest = max(y for _, y in made.places.values())
        over = [e for e in made.edges if self._blocked(e)]
        self.over = {e[2]: self.highest + 0.62 + 0.25 * k for k, e in enumerate(over)}
        self.highest = max([self.highest + 0.4, *self.over.values()])
        self.furthest = max([x for x, _ in made.places.values()] + [x for e in back for x, _ in self._way(e)])

    def _returns(self, edge: Edge) -> bool:
        """Whether a line runs back from right to left, and not into or out of a block that lies on the way back."""
        (xa, _), (xb, _) = (self.made.places[name] for name in edge[:2])
        return xb <= xa and not set(edge[:2]) & self.made.back

    def _blocked(self, edge: Edge) -> bool:
        """Whether something stands between two places of one row."""
        (xa, ya), (xb, yb) = (self.made.places[name] for name in edge[:2])
        return ya == yb and xb > xa and any(y == ya and xa < x < xb for x, y in self.made.places.values())

    def _port(self, name: str, signal: str, way: int) -> tuple[float, float]:
        """Where a signal leaves (1) or enters (-1) a node at its side; several signals one above the other."""
        x, y = self.made.places[name]
        if name in self.D.external or name in self.D.sums:
            return x + way * (ROUND if name in self.D.sums else 0.16), y
        part = self.D.part(name)
        ports = sorted(part.outputs if way > 0 else part.inputs, key=lambda n: self.lanes.get(n, 0.0))
        turned = -1 if name in self.made.back else 1
        return x + turned * way * WIDE, y - 0.32 * (ports.index(signal) - 0.5 * (len(ports) - 1))

    def draw(self, ax: Axes, edge: Edge) -> None:
        """One line with its arrow, the dot where it branches, its sign at a sum and, once, its signal's name."""
        source, _, signal, sign = edge
        points = self._way(edge)
        ax.plot(*zip(*points[:-1], strict=True), color="0.2", linewidth=0.9, solid_capstyle="butt", zorder=1)
        ax.annotate("", points[-1], points[-2], arrowprops=_ARROW, zorder=2)
        if len(points) > 2 and len([e for e in self.made.edges if e[2] == signal]) > 1:
            ax.plot(*points[1], "o", color="0.2", markersize=2.2)
        if sign < 0:
            (px, py), (_, qy) = points[-1], points[-2]
            aside = (-0.13, 0.13) if qy == py else (0.16, 0.13 * np.sign(qy - py))
            ax.text(px + aside[0], py + aside[1], "\N{MINUS SIGN}", ha="center", va="center", fontsize=_TEXT)
        if signal not in self.labelled and source not in self.D.external:
            self.labelled.add(signal)
            left = source in self.made.back
            x, y = points[0][0] + (-0.08 if left else 0.08), points[0][1] + 0.08
            ax.text(x, y, signal, ha="right" if left else "left", style="italic", fontsize=_TEXT - 1.5, color=QUIET)

    def _way(self, edge: Edge) -> list[tuple[float, float]]:
        source, target, signal, _ = edge
        (xa, ya), (xb, yb) = self._port(source, signal, 1), self._port(target, signal, -1)
        round_, x = target in self.D.sums, self.made.places[target][0]
        names = [signal] if source in (*self.D.sums, *self.D.external) else self.D.part(source).outputs
        aside = max(0.45, 0.15 * max(map(len, names))) if self._returns(edge) else 0.45
        aside += 0.4 * (ya - self.made.places[source][1])  # an upper port turns farther out
        if self._returns(edge):
            lane = self.lanes[signal]
            return [(xa, ya), (xa + aside, ya), (xa + aside, lane), *self._up_to(target, (xb, yb), lane)]
        if source in self.made.back:
            return [(xa, ya), (xb, yb)] if target in self.made.back else [(xa, ya), (x, ya), (x, yb - ROUND)]
        if target in self.made.back:
            return [(xa, ya), (xa + aside, ya), (xa + aside, yb), (xb, yb)]
        if self._blocked(edge):
            lane = self.over[signal]
            return [(xa, ya), (xa + aside, ya), (xa + aside, lane), *self._up_to(target, (xb, yb), lane)]
        if ya == yb:
            return [(xa, ya), (xb, yb)]
        if round_ and self.made.places[source][1] != yb:
            start = [(xa, ya)] if x != self.made.places[source][0] else []
            return [*start, (x, ya), (x, yb + (ROUND if ya > yb else -ROUND))]
        return [(xa, ya), (xa + aside, ya), (xa + aside, yb), (xb, yb)]

    def _up_to(self, target: str, end: tuple[float, float], lane: float) -> list[tuple[float, float]]:
        """From a lane below or above into a sum, or into the left side of a block."""
        x, y = self.made.places[target]
        if target in self.D.sums:
            return [(x, lane), (x, y + (ROUND if lane > y else -ROUND))]
        return [(end[0] - 0.3, lane), (end[0] - 0.3, end[1]), end]
