"""Pictures of how loops meet: k_I against its limit, relative gains, what closing a loop changes, coherences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from loopshape.core.units import Array, db, deg
from loopshape.data.response.frf import FRF
from loopshape.toolbox.diagrams.coupling.nouns import BandVerdict, Coupling, EquivalentPlant, Interaction
from loopshape.view.labels import expression, number, point, symbol
from loopshape.view.plots.curves import (
    FLOOR_DB,
    draw_band,
    draw_valid,
    fit_decibels,
    frequency_axis,
    hide_inner,
    shown_band_hz,
)
from loopshape.view.plots.frequency import shade_band
from loopshape.view.plots.matrix import settled
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, QUIET, axes_or_new, head, new_figure, styled

VERDICT_COLOURS = dict(zip(Coupling, ("#E8E8E8", "#A6A6A6", "#3C3C3C"), strict=True))
_FEW = 3  # pairs that share a panel of half the width
_SHADED = "shaded: 95 %, of each frequency by itself"


@styled()
def coefficients(found: Interaction, *, ax: Axes | None = None) -> Axes:
    """|k_I| in dB of each pair with its 95 % band, the limit, and the verdicts as a strip below, a row a pair.

    Dots, and a band that runs out of the axes below, say that k_I may be zero.
    """
    ax = axes_or_new(ax)
    for k, one in enumerate(found.coefficients):
        colour, use = COLOURS[k % len(COLOURS)], one.valid
        known = use & settled(one.low > 0.0)
        draw_valid(ax, one.frequency_hz, db(one.coefficient), known, color=colour, label=_pair_text(one.loops))
        low, high = np.maximum(db(one.low), FLOOR_DB), np.minimum(db(one.high), 400.0)
        draw_band(ax, one.frequency_hz[use], low[use], high[use], color=colour, alpha=0.22, gid="band")
    frequency_axis(ax, *shown_band_hz(found.frf))
    ax.axhline(found.limit_db, color=LIMIT, linewidth=1.0, linestyle="--", gid="limit")
    fit_decibels(ax, span=80.0)
    foot, top = min(ax.get_ylim()[0], found.limit_db - 20.0), max(ax.get_ylim()[1], found.limit_db + 3.0)
    below, above = _strips(ax, found), _key(ax, found)
    span = (top - foot) / (1.0 - below - above)
    ax.set_ylim(foot - below * span, top + above * span)
    ax.set_ylabel("|$k_I$| [dB]")
    return ax


def _strips(ax: Axes, found: Interaction) -> float:
    """Verdicts at the foot of the axes, a row a pair with its colour at the right; gives their share of the height."""
    pairs = [one.loops for one in found.coefficients]
    height = 0.045 if len(pairs) <= _FEW else 0.03
    bottoms = {pair: 0.015 + height * (len(pairs) - 1 - k) for k, pair in enumerate(pairs)}
    for verdict in found.verdicts:
        bottom = bottoms[verdict.loops]
        ax.axvspan(
            *verdict.band_hz, bottom, bottom + 0.85 * height, facecolor=VERDICT_COLOURS[verdict.verdict],
            edgecolor="white", linewidth=0.8, zorder=3.0, gid=f"verdict {verdict.verdict}",
        )  # fmt: skip
    for k, pair in enumerate(pairs if len(pairs) > 1 else []):
        mark = Rectangle((1.004, bottoms[pair]), 0.012, 0.85 * height, transform=ax.transAxes, clip_on=False)
        mark.set(color=COLOURS[k % len(COLOURS)], linewidth=0.0, gid="pair")
        ax.add_artist(mark)
    return 0.03 + height * len(pairs)


def _key(ax: Axes, found: Interaction) -> float:
    """What colours mean, of pairs where there are several and of verdicts; gives its share of the height."""
    words = [word for word in VERDICT_COLOURS if any(v.verdict is word for v in found.verdicts)]
    handles: list[Artist] = [Patch(facecolor=VERDICT_COLOURS[word], label=word) for word in words]
    if len(found.coefficients) > 1:
        texts = [_pair_text(one.loops) for one in found.coefficients]
        handles = [*(line for line in ax.lines if line.get_label() in texts), *handles]
    columns = 3 if len(found.coefficients) <= _FEW else 6
    ax.legend(handles=handles, loc="upper left", ncols=columns, columnspacing=0.8, handlelength=1.0, fontsize=7.0)
    return 0.02 + 0.07 * float(np.ceil(len(handles) / columns))


def _pair_text(loops: tuple[str, str]) -> str:
    return f"{symbol(loops[0])}, {symbol(loops[1])}"


@styled()
def relative_gains(found: Interaction, *, ax: Axes | None = None) -> Axes:
    """|RGA| of each loop's own element with its 95 % band, and 1, where loops do not meet; others are left out.

    For two loops that is all: the rows of a RGA sum to 1.
    """
    ax = axes_or_new(ax)
    one = found.relative_gain
    use = one.valid
    normal_95 = 1.959964
    for k, name in enumerate(found.loops if len(found.loops) > 2 else found.loops[:1]):
        colour, size = COLOURS[k % len(COLOURS)], np.abs(one.gain[:, k, k])
        half_width = normal_95 * one.std[:, k, k] / np.sqrt(2.0)
        draw_valid(ax, one.frequency_hz, size, use, color=colour, label=symbol(name))
        low, high = np.maximum(size - half_width, 0.0), size + half_width
        draw_band(ax, one.frequency_hz[use], low[use], high[use], color=colour, alpha=0.22, gid="band")
    ax.axhline(1.0, color=QUIET, linewidth=0.8, linestyle="--", gid="one")
    frequency_axis(ax, *shown_band_hz(found.frf))
    _fit_gain(ax)
    if len(found.loops) > 2:
        ax.legend(loc="upper left", fontsize=7.0)
        ax.set_ylabel("|RGA| of own elements [1]")
    else:
        ax.set_ylabel("|RGA$_{11}$| = |RGA$_{22}$| [1]")
    return ax


def _fit_gain(ax: Axes) -> None:
    """Around 1 and what is plotted, never narrower than 0.5, never above 5."""
    low, high = min(float(ax.dataLim.y0), 0.75), max(float(ax.dataLim.y1), 1.25)
    ax.set_ylim(max(low - 0.1 * (high - low), 0.0), min(high + 0.15 * (high - low), 5.0))


@styled()
def closing_db(equivalents: Sequence[EquivalentPlant], *, ax: Axes | None = None) -> Axes:
    """|closed/open| in dB: what a loop's plant gains where the others close, with its 95 % band."""
    ax = axes_or_new(ax)
    for one, colour, text in _each(equivalents):
        f, use = one.open.frequency_hz, one.open.valid
        draw_valid(ax, f, db(one.ratio), use, color=colour, label=text)
        low, high = np.maximum(db(one.low), FLOOR_DB), db(one.high)
        draw_band(ax, f[use], low[use], high[use], color=colour, alpha=0.22, gid="band")
    frequency_axis(ax, *shown_band_hz(*(one.open for one in equivalents)))
    _fit_around_zero(ax, 1.0, 30.0)
    ax.legend(loc="upper left", fontsize=7.0)
    ax.set_ylabel("closed / open [dB]")
    return ax


@styled()
def closing_deg(equivalents: Sequence[EquivalentPlant], *, ax: Axes | None = None) -> Axes:
    """Phase of closed/open in degrees, within half a turn, with its 95 % band."""
    ax = axes_or_new(ax)
    for one, colour, text in _each(equivalents):
        f, use = one.open.frequency_hz, one.open.valid
        angle = deg(np.angle(one.ratio))
        draw_valid(ax, f, angle, use, color=colour, label=text)
        low, high = angle - one.reach_deg, angle + one.reach_deg
        draw_band(ax, f[use], low[use], high[use], color=colour, alpha=0.22, gid="band")
    frequency_axis(ax, *shown_band_hz(*(one.open for one in equivalents)))
    _fit_around_zero(ax, 10.0, 180.0)
    ax.set_ylabel("closed / open [deg]")
    return ax


def _each(equivalents: Sequence[EquivalentPlant]) -> Iterator[tuple[EquivalentPlant, str, str]]:
    for k, one in enumerate(equivalents):
        others = ", ".join(symbol(name) for name in one.others)
        yield one, COLOURS[k % len(COLOURS)], f"{symbol(one.loop)}, with {others} closed"


def _fit_around_zero(ax: Axes, least: float, most: float) -> None:
    """Symmetric, with room for the key above."""
    half_width = max(abs(float(ax.dataLim.y0)), abs(float(ax.dataLim.y1)))
    half_width = min(max(half_width if np.isfinite(half_width) else 0.0, least), most)
    ax.axhline(0.0, color=QUIET, linewidth=0.8, linestyle="--", gid="zero")
    ax.set_ylim(-1.2 * half_width, 1.6 * half_width)


@styled()
def multiple_coherences(frf: FRF, *, ax: Axes | None = None) -> Axes:
    """Multiple coherence of each output with all inputs; dashed what it is by chance, inputs/averages."""
    values = None if frf.multiple_coherence is None else list(frf.multiple_coherence.T)
    names = [expression(name) for name in frf.outputs]
    chance = len(frf.inputs) / frf.averages
    return _coherence(frf, values, names, chance, "multiple coherence [1]", axes_or_new(ax))


@styled()
def partial_coherences(frf: FRF, *, ax: Axes | None = None) -> Axes:
    """Partial coherence of each output with each input beyond the others; dashed what it is by chance."""
    outputs, inputs = len(frf.outputs), len(frf.inputs)
    pairs = [(i, j) for i in range(outputs) for j in range(inputs)]
    coherence = frf.partial_coherence
    values = None if coherence is None else [coherence[:, i, j] for i, j in pairs]
    names = [f"{expression(frf.outputs[i])}, {expression(frf.inputs[j])}" for i, j in pairs]
    chance = 1.0 / (frf.averages - inputs + 1.0) if frf.averages > inputs else np.nan
    return _coherence(frf, values, names, chance, "partial coherence [1]", axes_or_new(ax))


def _coherence(frf: FRF, values: list[Array] | None, names: Sequence[str], chance: float, label: str, ax: Axes) -> Axes:
    frequency_axis(ax, *shown_band_hz(frf))
    columns = 3 if len(names) < 9 else 4
    ax.set_ylim(0.0, 1.1 + 0.09 * np.ceil((len(names) + 1) / columns))
    ax.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0])
    ax.set_ylabel(label)
    if values is None:
        ax.text(0.5, 0.5, "this FRF has none", transform=ax.transAxes, ha="center", va="center", color="0.5")
        return ax
    for k, (value, name) in enumerate(zip(values, names, strict=True)):
        dash = "-" if k < len(COLOURS) else ":"
        draw_valid(ax, frf.frequency_hz, value, frf.valid, color=COLOURS[k % len(COLOURS)], label=name, ls=dash)
    if np.isfinite(chance) and chance < 1.0:
        ax.axhline(chance, color=QUIET, linewidth=1.0, linestyle="--", gid="bias", label=f"by chance, {chance:.2g}")
    ax.legend(loc="upper left", ncols=columns, columnspacing=0.7, handlelength=0.9, handletextpad=0.4, fontsize=6.5)
    return ax


@styled()
def interaction_page(found: Interaction) -> Figure:
    """k_I and relative gains; what closing the other loops changes, where their controllers are known; coherences.

    Partial coherences are left out where they are more than nine.
    """
    frf, shown = found.frf, found.equivalents
    panels: list[Callable[[Axes], Axes]] = [lambda ax: relative_gains(found, ax=ax)]
    if shown:
        panels += [lambda ax: closing_db(shown, ax=ax), lambda ax: closing_deg(shown, ax=ax)]
    if frf.multiple_coherence is not None:
        panels.append(lambda ax: multiple_coherences(frf, ax=ax))
    many = 9  # partial coherences beyond which no curve can be told
    if frf.partial_coherence is not None and len(frf.inputs) * len(frf.outputs) <= many:
        panels.append(lambda ax: partial_coherences(frf, ax=ax))
    wide = len(found.coefficients) > _FEW
    figure, axes = _places(len(panels), wide)
    coefficients(found, ax=axes[0])
    for panel, ax in zip(panels, axes[1:], strict=True):
        panel(ax)
    for ax in axes:
        shade_band(frf, ax=ax)
    hide_inner(*axes[int(wide) : -2])
    head(figure, _title(found), point(frf.operating_point), frf.method, *_words(found.verdicts))
    return figure


def _places(panels: int, wide: bool) -> tuple[Figure, list[Axes]]:
    """A figure, and axes for k_I (`wide`: as wide as the page) and for panels two a row."""
    rows = int(np.ceil((panels + 1 + wide) / 2))
    size = (FULL_WIDTH_IN, 1.1 + 2.2 * rows + 0.9 * wide)
    heights = [1.0 + 0.4 * wide, *[1.0] * (rows - 1)]
    figure = new_figure(rows, 2, size, squeeze=False, sharex=True, gridspec_kw={"height_ratios": heights})
    axes = list(figure.axes)
    if wide:
        grid = axes[0].get_gridspec()
        assert grid is not None
        axes.pop(1).remove()
        axes[0].set_subplotspec(grid[0, :])
    for ax in axes[panels + 1 :]:
        ax.remove()
    for ax in [axes[0], *axes[max(panels - 1, 0) : panels + 1]]:
        ax.tick_params(labelbottom=True)
    return figure, axes[: panels + 1]


def _title(found: Interaction) -> str:
    loops = ", ".join(symbol(name) for name in found.loops)
    parts = (f"Interaction of {loops}", f"limit {number(found.limit_db)} dB", found.frf.recording)
    return "  ·  ".join(part for part in parts if part)


def _words(verdicts: Sequence[BandVerdict]) -> list[str]:
    """Which pairs are what, over how many bands; all pairs together where they are many."""
    pairs = list(dict.fromkeys(v.loops for v in verdicts))
    if len(pairs) > _FEW:
        return [_SHADED, f"{len(pairs)} pairs of loops: {_counted(verdicts)}"]
    lines = [f"{symbol(a)} and {symbol(b)}: {_counted([v for v in verdicts if v.loops == (a, b)])}" for a, b in pairs]
    return [_SHADED, "; ".join(lines)] if lines else []


def _counted(verdicts: Sequence[BandVerdict]) -> str:
    counts = [(word, sum(v.verdict is word for v in verdicts)) for word in VERDICT_COLOURS]
    return f"of {len(verdicts)} bands " + ", ".join(f"{count} {word}" for word, count in counts if count)
