"""Picture of a gap table: where two runs differ, path and band against operating point."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm
from matplotlib.patches import Rectangle

from loopshape.core.errors import WrongUseError
from loopshape.core.units import SUFFIXES
from loopshape.toolbox.gap.nouns.gap_table import GapRow, GapTable
from loopshape.view.labels import number, quantity, symbol
from loopshape.view.style import FULL_WIDTH_IN, QUIET, axes_or_new, figure_of, styled, wrapped

#: from this size on ink on a cell is white, in percent
DARK_PERCENT = 17.0
_BESIDE_IN, _LETTER_IN = 2.2, 0.06  # what stands beside the cells, a letter of 7 pt

_Key = tuple[str, str, float, float]  # path, excited loop, band
_Column = tuple[int, int]  # block, operating point


@styled()
def gap_map(table: GapTable, *, ax: Axes | None = None) -> Axes:
    """Size of every difference in percent: paths and their bands downwards, operating points to the right.

    A difference that stands out of the noise is a coloured cell with its size in bold; one that does not is grey, with
    twice what noise gives as a bound. Without lines that both runs know a cell stays white. Colours run from 1 to 100 %
    on a logarithmic scale, light to dark, so they print in grey too. Refuses a table without rows.
    """
    if not table.rows:
        raise WrongUseError("a gap map needs a table with FRF rows", "none", "compare runs that excite a loop")
    places, headings = _lines(table)
    column_of = _columns(table)
    columns = list(dict.fromkeys(sorted(column_of.values())))
    height = max(places.values()) + 1.0
    ax = axes_or_new(ax, (_width(len(columns)), 1.3 + 0.155 * height))
    ax.set_xlim(0.0, len(columns))
    ax.set_ylim(height, 0.0)
    span_percent = (1.0, 100.0)  # sizes that the colours span, in percent
    norm, colours = LogNorm(*span_percent), _colours()
    most_numbers = 14  # with more columns than this the cells hold no numbers
    for row in table.rows:
        corner = (columns.index(column_of[row.recording]), places[(row.path, row.loop, *row.band_hz)])
        significant = table.significant(row)
        face = colours(norm(100.0 * row.size)) if significant else "0.94"
        name = "significant" if significant else "not significant"
        ax.add_patch(Rectangle(corner, 1.0, 1.0, facecolor=face, edgecolor="white", linewidth=0.7, gid=name))
        if len(columns) <= most_numbers:
            _write(ax, corner, row, significant)
    _label_lines(ax, places, headings)
    _label_columns(ax, table, column_of, columns)
    bar = figure_of(ax).colorbar(ScalarMappable(norm, colours), ax=ax, shrink=0.7, aspect=28, pad=0.02, extend="both")
    bar.set_ticks([1.0, 3.0, 10.0, 30.0, 100.0], labels=["1", "3", "10", "30", "100"])
    bar.ax.minorticks_off()
    bar.set_label("|difference| /\n|response| [%]")
    return ax


def _width(columns: int) -> float:
    return float(np.clip(_BESIDE_IN + 0.5 * columns, 3.6, FULL_WIDTH_IN))


def _colours() -> Colormap:
    """From pale yellow to dark blue, ever darker: colour-blind readers and grey printers keep the order."""
    return LinearSegmentedColormap.from_list("gap", mpl.colormaps["YlGnBu"](np.linspace(0.12, 0.97, 64)))


def _lines(table: GapTable) -> tuple[dict[_Key, float], dict[float, str]]:
    """Upper edge of each band's line, and the headings of the paths by theirs."""
    found = dict.fromkeys((r.path, r.loop, *r.band_hz) for r in table.rows)
    groups = list(dict.fromkeys((k[0], k[1]) for k in found))
    twice = {path for path, _ in groups if [p for p, _ in groups].count(path) > 1}
    places: dict[_Key, float] = {}
    headings, at = {}, 0.0
    for path, loop in groups:
        headings[at] = _path(path) + (f", {symbol(loop)} excited" if path in twice else "")
        at += 1.15
        for key in sorted((k for k in found if k[:2] == (path, loop)), key=lambda k: k[2]):
            places[key] = at
            at += 1.0
        at += 0.25
    return places, headings


def _path(path: str) -> str:
    """A path's name with symbols: `z_x -> x` as on paper."""
    ends = [
        " + ".join(" − ".join(symbol(name) for name in term.split("-")) for term in end.split("+"))
        for end in path.split(" -> ")
    ]
    return " → ".join(ends)


def _columns(table: GapTable) -> dict[str, _Column]:
    """Column of each recording: operating points side by side, a loop's further experiments there in further blocks."""
    found: dict[str, _Column] = {}
    points = list(dict.fromkeys(_point(r) for r in table.rows))
    made: Counter[tuple[str, int]] = Counter()
    for row in table.rows:
        if row.recording not in found:
            at = points.index(_point(row))
            found[row.recording] = (made[(row.loop, at)], at)
            made[(row.loop, at)] += 1
    return found


def _point(row: GapRow) -> tuple[tuple[str, float], ...]:
    return (*row.operating_point.items(), *row.parameters.items())


def _write(ax: Axes, corner: tuple[float, float], row: GapRow, significant: bool) -> None:
    """The size, or the bound that noise leaves."""
    percent = 100.0 * (row.size if significant else 2.0 * max(row.noise, 0.5 * row.size))
    ax.text(
        corner[0] + 0.5,
        corner[1] + 0.52,
        _percent(percent) if significant else f"< {_percent(percent)}",
        ha="center",
        va="center",
        fontsize=7.0 if significant else 6.0,
        fontweight="bold" if significant else "normal",
        color=QUIET if not significant else "white" if percent > DARK_PERCENT else "black",
    )


def _percent(value: float) -> str:
    """Two figures, no more: 0.3, 4.2, 17, 140."""
    return f"{value:.0f}" if value >= 9.95 else f"{value:.1f}"


def _label_lines(ax: Axes, places: Mapping[_Key, float], headings: Mapping[float, str]) -> None:
    """Bands at the left, each path's name above its bands."""
    ax.grid(visible=False)
    ax.tick_params(length=0.0)
    bands = [f"{low:.2g}–{high:.2g}" for _, _, low, high in places]
    ax.set_yticks([at + 0.5 for at in places.values()], bands, fontsize=7.0)
    ax.set_ylabel("band [Hz]")
    for at, name in headings.items():
        ax.text(0.0, at + 1.0, name, ha="left", va="bottom", fontsize=8.0, gid="path")
    for spine in ax.spines.values():
        spine.set_visible(False)


def _label_columns(ax: Axes, table: GapTable, column_of: Mapping[str, _Column], columns: Sequence[_Column]) -> None:
    """Operating points below, what was injected above each block, lines between blocks."""
    rows = [next(r for r in table.rows if column_of[r.recording] == column) for column in columns]
    keys = list(dict.fromkeys(k for row in rows for k, _ in _point(row)))
    values = [dict(_point(row)) for row in rows]
    texts = ["\n".join(number(v[k]) if k in v else "" for k in keys) for v in values]
    ax.set_xticks(np.arange(len(columns)) + 0.5, texts if keys else [r.recording for r in rows], fontsize=7.0)
    ax.set_xlabel("\n".join(quantity(k) for k in keys), fontsize=8.0)
    for block in dict.fromkeys(k for k, _ in columns):
        inside = [i for i, (k, _) in enumerate(columns) if k == block]
        injected = dict.fromkeys(_amplitude(r) for r in table.rows if column_of[r.recording][0] == block)
        room = round((_width(len(columns)) - _BESIDE_IN) * len(inside) / len(columns) / _LETTER_IN)
        lines = wrapped("injected " + "; ".join(injected), room)
        if len(lines) > 1:
            lines = ["injected", *(line for one in injected for line in wrapped(one, room))]
        ax.text(
            float(np.mean(inside)) + 0.5, -0.2, "\n".join(lines), ha="center", va="bottom", fontsize=7.0, gid="injected"
        )
        if inside[0]:
            ax.axvline(inside[0], color="0.35", linewidth=0.6)


def _amplitude(row: GapRow) -> str:
    """Where and how much was injected, rms."""
    return f"{row.amplitude:.2g} {SUFFIXES.get(row.amplitude_unit, row.amplitude_unit)} in {symbol(row.loop)}"
