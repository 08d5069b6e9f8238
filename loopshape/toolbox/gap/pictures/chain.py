"""The loop as a chain of blocks, as dark as their share of the blame: where a gap lies.

Places of a user's own machine are no chain (nobody states how they are connected): boxes in a row, most probable first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

from loopshape.toolbox.gap.nouns.gap_report import Where, percent
from loopshape.view.labels import point, symbol
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, QUIET, axes_or_new, styled

#: blocks in the order in which the signal runs; words that are not here stand before the sensor
ORDER = (
    "controller", "drive", "valve", "line", "gas", "muscle", "transmission", "joint", "guide", "spring", "body",
    "sensor",
)  # fmt: skip
#: blocks beside the chain, and the block that they feed
FEEDS = {"supply": "valve"}
OUTSIDE = ("none", "unknown")
BLAME, WELL = COLOURS[1], COLOURS[0]
_WIDTH, _HEIGHT, _UPPER, _RETURN = 0.84, 0.8, 1.3, -0.42
_MOST_POINTS = 2


def shares(blocks: Mapping[str, float]) -> dict[str, float]:
    """Probability of each block alone: what it has itself, and all pairs that it takes part in."""
    out: dict[str, float] = {}
    for name, p in blocks.items():
        for part in set(name.split("+")):
            out[part] = out.get(part, 0.0) + p
    return out


def in_order(names: Sequence[str]) -> list[str]:
    """The blocks of the chain itself as the signal runs; what feeds one of them is left out where that one is there."""
    inner = [n for n in names if n not in OUTSIDE and FEEDS.get(n) not in names]
    known = {name: k for k, name in enumerate(ORDER)}
    return sorted(inner, key=lambda n: (known.get(n, known["sensor"] - 0.5), n))


@styled()
def chain(where: Where, *, ax: Axes | None = None) -> Axes:
    """The loop's blocks with the probability that the gap lies there; blamed ones framed, none and unknown apart."""
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 1.5))
    probability = shares(where.blocks)
    looped = all(n in (*ORDER, *FEEDS, *OUTSIDE) for n in probability)
    inner = [n for n in probability if n not in OUTSIDE]
    row = in_order(inner) if looped else sorted(inner, key=lambda n: -probability[n])
    blamed = set(where.block.split("+"))
    places = {name: (float(k), 0.0) for k, name in enumerate(row)}
    places |= {n: (places[FEEDS[n]][0], _UPPER) for n in probability if looped and n in FEEDS and FEEDS[n] in places}
    outside = [n for n in OUTSIDE if n in probability]
    places |= {n: (len(row) - len(outside) + float(k), _UPPER) for k, n in enumerate(outside)}
    for name, corner in places.items():
        _box(ax, name, corner, probability[name], name in blamed, len(row))
    if looped:
        _arrows(ax, len(row), [places[n] for n in places if n in FEEDS and n not in row])
    if where.block != "none":
        ax.text(0.5 * (len(row) - 1 + _WIDTH), _RETURN - 0.1, _signs(where), ha="center", va="top", fontsize=8.0)
    first = min(x for x, _ in places.values())  # a single block has none and unknown above and before it
    ax.set_xlim(first - 0.03, len(row) - 1 + _WIDTH + 0.03)
    ax.set_ylim(_RETURN - 0.5, _UPPER + _HEIGHT + 0.04)
    ax.axis("off")
    return ax


def _box(ax: Axes, name: str, corner: tuple[float, float], p: float, blamed: bool, n: int) -> None:
    """One block: name above, probability below."""
    x, y = corner
    tint = 0.0 if p < 0.01 else 0.15 + 0.55 * p
    colour = WELL if name == "none" else BLAME
    face = tuple(1.0 - tint * (1.0 - np.array(to_rgb(colour))))
    apart = name in OUTSIDE
    ax.add_patch(
        Rectangle(
            corner, _WIDTH, _HEIGHT, facecolor=face, edgecolor=colour if blamed else "0.45",
            linewidth=2.0 if blamed else 0.8, linestyle=(0, (3, 2)) if apart and not blamed else "-",
            gid=f"block {name}", zorder=2.0,
        )
    )  # fmt: skip
    look = {"ha": "center", "va": "center", "fontsize": 8.0 * min(1.0, 9.0 / n), "zorder": 3.0}
    weight = "bold" if blamed else "normal"
    ax.text(x + 0.5 * _WIDTH, y + 0.66 * _HEIGHT, name.replace("_", " "), fontweight=weight, **look)  # type: ignore[arg-type]
    ink = "black" if p >= 0.01 else QUIET
    ax.text(x + 0.5 * _WIDTH, y + 0.27 * _HEIGHT, percent(p), fontweight=weight, color=ink, **look)  # type: ignore[arg-type]


def _arrows(ax: Axes, n: int, feeding: Sequence[tuple[float, float]]) -> None:
    """The signal's way along the row and back, and down from what feeds a block."""
    look = {
        "arrowstyle": "-|>",
        "color": "0.3",
        "linewidth": 0.8,
        "mutation_scale": 7.0,
        "shrinkA": 0.0,
        "shrinkB": 0.0,
    }
    middle, end = 0.5 * _HEIGHT, n - 1 + 0.5 * _WIDTH
    for k in range(n - 1):
        ax.annotate("", (k + 1.0, middle), (k + _WIDTH, middle), arrowprops=look)
    for x, y in feeding:
        ax.annotate("", (x + 0.5 * _WIDTH, _HEIGHT), (x + 0.5 * _WIDTH, y), arrowprops=look)
    ax.plot([end, end, 0.5 * _WIDTH], [0.0, _RETURN, _RETURN], color="0.3", linewidth=0.8, gid="feedback")
    ax.annotate("", (0.5 * _WIDTH, 0.0), (0.5 * _WIDTH, _RETURN - 0.01), arrowprops=look)


def _signs(where: Where) -> str:
    """In which signal, band and operating points the nominal model is off most."""
    low, high = where.band_hz
    points = [point(dict(sorted(p.items(), reverse=True))) for p in where.operating_points]
    more = f" and {len(points) - _MOST_POINTS} more" if len(points) > _MOST_POINTS else ""
    at = "; ".join(p for p in points[:_MOST_POINTS] if p) + more
    return f"most visible in {symbol(where.channel)}, {low:.2g} to {high:.2g} Hz" + (f", at {at}" if at else "")
