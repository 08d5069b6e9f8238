"""The picture of a gap diagnosis: where the gap lies, which effect makes it, how far it shrinks, and how that looks."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from loopshape.core.units import Array
from loopshape.toolbox.gap.nouns.gap_report import Curve, GapReport, Ranked, Trace
from loopshape.toolbox.gap.pictures.chain import chain, percent
from loopshape.toolbox.gap.pictures.distances import HEALED, NOMINAL, compared, distances, named
from loopshape.view.labels import bracket, symbol
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, QUIET, axes_or_new, styled

MEASURED = "0.1"
LEAST, MOST = 4, 5  # hypotheses that are shown
_LINE = 96  # characters of the title's lines
#: letters of sizes that fit below a hypothesis's name at a size that can be read in print
LONGEST = 58
CURVES, ROOM = 2, 0.6  # of a missing force, side by side at most; above and below them, of their height


@styled()
def gap_figure(report: GapReport) -> Figure:
    """One figure of a diagnosis under its sentence: where, which, how far, a stretch of a recording, the missing force.

    Colours and marks stay the same in the first four: vermilion for the nominal model, blue for the model with the
    effect, green for its rival. Without recordings to look at the stretch is left out, and the force where no places
    are known.
    """
    title = balanced(report.sentence).replace("$", r"\$")
    shown = bool(report.traces)
    legend_rows = 1 if report.verdict in ("none", "unknown") else 2
    curves = _largest(next(iter(report.missing_by_place.values()), []))
    heights = [1.42, 2.75 + 0.17 * legend_rows, *([2.3] if shown else []), *([2.0] if curves else [])]
    figure = Figure(figsize=(FULL_WIDTH_IN, sum(heights) + 0.18 + 0.17 * (1 + title.count("\n"))))
    figure.suptitle(title, x=0.012, ha="left", fontsize=10.0, linespacing=1.25)
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    _headed(chain(report.where, ax=parts[0].subplots()), "a", "Where", "probability that the gap lies in each block")
    left, right = parts[1].subplots(1, 2, gridspec_kw={"width_ratios": [0.92, 1.08]})
    _headed(hypotheses(report, ax=left), "b", "Which", "leading hypotheses, size and 95 % interval")
    _headed(distances(report, ax=right), "c", "How far", _distance(report), x=-0.1)
    handles, texts = right.get_legend_handles_labels()
    long = 40  # characters of a name that leaves room for two columns of the key
    columns = -(-len(texts) // legend_rows) if max(map(len, texts)) < long else 2
    parts[1].legend(handles, texts, loc="outside lower center", ncols=columns)
    if shown:
        above, below = parts[2].subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1.7, 1.0]})
        trace = plainest(report)
        stretch(report, trace, ax=above)
        _headed(above, "d", "How it looks", "")
        errors(report, trace, ax=below)
        below.set_xlabel(f"time [s] of recording {trace.recording}")
        above.tick_params(labelbottom=False)
        parts[2].align_ylabels()
    if curves:
        axes = parts[-1].subplots(1, len(curves), squeeze=False)[0]
        for ax, curve in zip(axes, curves, strict=True):
            missing(report, curve, ax=ax)
        _headed(axes[0], "e", "What is missing", f"a nameless force or signal at {curves[0].place}, 95 % interval")
        handles, texts = max((ax.get_legend_handles_labels() for ax in axes), key=lambda both: len(both[1]))
        parts[-1].legend(handles, texts, loc="outside lower center", ncols=2)
    return figure


def balanced(sentence: str) -> str:
    """The sentence in lines of about equal length."""
    tried = [fill(sentence, width, break_on_hyphens=False) for width in range(_LINE // 2, _LINE + 1)]
    return min(tried, key=lambda text: (text.count("\n"), max(len(line) for line in text.split("\n"))))


def _distance(report: GapReport) -> str:
    """The held-out gap relative to the noise floor."""
    if report.gap is None:
        return "fitted recordings, none held out"
    after = f" to {report.gap.after:.3g}" if any(s.after is not None for s in compared(report)) else ""
    return f"held out: {report.gap.before:.3g}{after} × noise floor"


def _headed(ax: Axes, letter: str, word: str, rest: str, x: float = 0.0) -> None:
    """Letter and word in bold, the rest behind them in grey."""
    ax.set_title(
        rf"$\bf{{{letter}\ \ \ {word.replace(' ', chr(92) + ' ')}}}$   {rest}", loc="left", x=x, fontsize=8.5, pad=5.0
    )


def leading(ranking: Sequence[Ranked]) -> list[Ranked]:
    """The most probable hypotheses: those that count, some at least and not too many."""
    counted = sum(r.probability >= 0.001 for r in ranking)  # a hypothesis below is shown only to fill the least
    return list(ranking[: min(max(counted, LEAST), MOST)])


@styled()
def hypotheses(report: GapReport, *, ax: Axes | None = None) -> Axes:
    """Bars of the leading hypotheses' probabilities, names and sizes above each; the ambiguity set is dark."""
    ax = axes_or_new(ax)
    rows = leading(report.ranking)
    for k, r in enumerate(rows):
        inside = any(r.effect in group for group in report.ambiguity)
        colour = HEALED if inside else "#A9BBC7"
        ax.barh(k + 0.74, r.probability, 0.2, color=colour, gid=f"probability {r.effect}", zorder=2.0)
        ax.barh(k + 0.74, 1.0, 0.2, color="0.94", zorder=1.0)
        name, size, weight = named(r.effect), sizes(r), "bold" if k == 0 else "normal"
        ax.text(0.0, k + 0.17, name, va="center", fontsize=max(6.1, min(8.0, 300.0 / len(name))), fontweight=weight)
        ax.text(1.02, k + 0.74, percent(r.probability), va="center", fontsize=8.0, fontweight=weight)
        ax.text(0.0, k + 0.46, size, va="center", fontsize=min(7.0, 6.6 * LONGEST / max(len(size), 1)), color=QUIET)
    ax.set_xlim(0.0, 1.0)
    ax.set_ylim(max(len(rows), 4), 0.0)
    ax.set_yticks([])
    ax.set_xticks(np.linspace(0.0, 1.0, 6), [f"{100 * x:.0f} %" for x in np.linspace(0.0, 1.0, 6)])
    ax.set_xlabel("probability")
    ax.grid(visible=False)
    for side in ("left", "right", "top"):
        ax.spines[side].set_visible(False)
    return ax


def sizes(r: Ranked) -> str:
    """Magnitudes with intervals and units, "" where there are none; where that is too long, the last without them."""
    parts = list(r.sizes.values())
    whole = [_size(*part) for part in parts]
    for k in range(len(parts) - 1, 0, -1):
        if len(";  ".join(whole)) > LONGEST:
            whole[k] = _size(parts[k][0], None)
    return ";  ".join(whole)


def _size(text: str, interval: tuple[float, float] | None) -> str:
    if interval is not None and interval[1] > interval[0]:  # one recording alone gives none
        text += f" ({interval[0]:.3g} to {interval[1]:.3g})"
    return text.replace("-", "\N{MINUS SIGN}")


def window(report: GapReport, trace: Trace) -> tuple[slice, float]:
    """The stretch of a trace where the nominal model is plainest off beyond the other, and its rms off there.

    It lasts two periods of the band's lower end, a few seconds at least.
    """
    step = float(trace.t_s[1] - trace.t_s[0])
    window_s = (3.0, 10.0)
    seconds = float(np.clip(2.0 / max(report.where.band_hz[0], 1e-3), *window_s))
    n = min(round(seconds / step), trace.t_s.size)
    square, other = (trace.measured - trace.nominal) ** 2, (trace.measured - trace.with_effect) ** 2
    if np.allclose(square, other):
        other = np.zeros_like(square)
    total = np.concatenate([[0.0], np.cumsum(square - other)])
    gains = total[n:] - total[:-n]
    start = int(np.argmax(gains))
    return slice(start, start + n), float(np.sqrt(max(gains[start], 0.0) / n))


def plainest(report: GapReport) -> Trace:
    """The recording whose best window shows most."""
    return max(report.traces, key=lambda trace: window(report, trace)[1])


def _healed(report: GapReport) -> bool:
    return report.verdict != "none"


@styled()
def stretch(report: GapReport, trace: Trace, *, ax: Axes | None = None) -> Axes:
    """Measured, nominal, and unless nothing is wrong the model with the effect, over some seconds."""
    ax = axes_or_new(ax)
    part, _ = window(report, trace)
    t = trace.t_s[part]
    ax.plot(t, trace.measured[part], color=MEASURED, linewidth=1.8, gid="measured", label="measured")
    ax.plot(t, trace.nominal[part], color=NOMINAL, linewidth=1.1, gid="nominal", label="nominal model")
    if _healed(report):
        label = "with the nearest effect" if report.verdict == "unknown" else "with the effect"
        dashes = (0, (4, 1.5))
        ax.plot(t, trace.with_effect[part], color=HEALED, linestyle=dashes, gid="with effect", label=label)
    name, unit = _channel(trace)
    ax.set_ylabel(symbol(name) + bracket(unit))
    ax.set_xlim(t[0], t[-1])
    ax.margins(y=0.08)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1, fontsize=7.5)
    return ax


@styled()
def errors(report: GapReport, trace: Trace, *, ax: Axes | None = None) -> Axes:
    """Measured less simulated over the same seconds."""
    ax = axes_or_new(ax)
    part, _ = window(report, trace)
    ax.axhline(0.0, color="0.25", linewidth=0.6)
    ax.plot(trace.t_s[part], _off(trace, trace.nominal)[part], color=NOMINAL, linewidth=1.0, gid="nominal off")
    if _healed(report):
        ax.plot(trace.t_s[part], _off(trace, trace.with_effect)[part], color=HEALED, linewidth=1.0, gid="effect off")
    ax.set_ylabel(f"error{bracket(_channel(trace)[1])}")
    ax.margins(y=0.1)
    ax.set_xlabel("time [s]")
    return ax


def _off(trace: Trace, simulated: Array) -> Array:
    return np.asarray(trace.measured - simulated)


def _channel(trace: Trace) -> tuple[str, str]:
    """Name and unit of `theta [deg]`."""
    name, _, unit = trace.channel.partition(" [")
    return name, unit.rstrip("]")


@styled()
def missing(report: GapReport, curve: Curve, *, ax: Axes | None = None) -> Axes:
    """One curve: what would close the gap over speed, position or size, its 95 % interval, and the named effect."""
    ax = axes_or_new(ax)
    ax.axhline(0.0, color="0.7", linewidth=0.6)
    ax.fill_between(curve.x, curve.low, curve.high, color=COLOURS[0], alpha=0.2, linewidth=0.0, gid="interval")
    ax.plot(curve.x, curve.value, color=COLOURS[0], linewidth=1.4, gid="nameless", label="what would close the gap")
    if curve.named is not None:
        label = report.leading_name.replace("_", " ")
        ax.plot(
            curve.x, curve.named, color=COLOURS[1], linewidth=1.2, linestyle=(0, (4, 1.5)), gid="named", label=label
        )
    ax.set_xlabel(f"{curve.over}{bracket(curve.over_unit)}")
    ax.set_ylabel(f"added{bracket(curve.unit)}")
    ax.set_xlim(curve.x[0], curve.x[-1])
    ends = [curve.value, *([] if curve.named is None else [curve.named])]
    low, high = min(float(y.min()) for y in ends), max(float(y.max()) for y in ends)
    room = ROOM * max(high - low, 1e-12)  # an interval that is wider tells no more
    ax.set_ylim(low - room, high + room)
    # whole numbers at each tick: a power of ten above the axis would stand in the title
    ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:.3g}".replace("-", "\N{MINUS SIGN}")))
    return ax


def _largest(curves: Sequence[Curve]) -> list[Curve]:
    """The curves that matter most: those that swing furthest."""
    return sorted(curves, key=lambda c: -float(c.value.max() - c.value.min()))[:CURVES]
