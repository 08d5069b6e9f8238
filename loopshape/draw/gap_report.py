"""The picture of a gap diagnosis: where the gap lies, which effect makes it, how far it shrinks, and how that looks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.draw.gap_chain import chain, percent
from loopshape.draw.labels import bracket, symbol
from loopshape.draw.style import COLOURS, FULL_WIDTH_IN, QUIET, axes_or_new, styled
from loopshape.gap_report import GapReport, Ranked, Submodel, Trace
from loopshape.units import Array

NOMINAL, HEALED, RIVAL, MEASURED = COLOURS[1], COLOURS[0], COLOURS[2], "0.1"
LEAST, MOST = 3, 5  # hypotheses that are shown
PLAIN = 0.001  # a hypothesis below is shown only to fill the least
_LINE = 96  # characters of the title's lines
_WINDOW_S = (3.0, 10.0)


@styled()
def gap_figure(report: GapReport) -> Figure:
    """One figure of a diagnosis under its sentence: (a) where, (b) which, (c) how far, (d) a stretch of a recording.

    Colours and marks stay the same throughout: vermilion for the nominal model, blue for the model with the effect,
    green for its rival. Without recordings to look at (d) is left out.
    """
    title = balanced(report.sentence).replace("$", r"\$")
    shown = bool(report.traces)
    heights = [1.42, 2.7, *([2.3] if shown else [])]
    figure = Figure(figsize=(FULL_WIDTH_IN, sum(heights) + 0.18 + 0.17 * (1 + title.count("\n"))))
    figure.suptitle(title, x=0.012, ha="left", fontsize=10.0, linespacing=1.25)
    parts = np.atleast_1d(figure.subfigures(len(heights), 1, height_ratios=heights))
    _headed(chain(report.where, ax=parts[0].subplots()), "a", "Where", "probability that the gap lies in each block")
    left, right = parts[1].subplots(1, 2, gridspec_kw={"width_ratios": [1.0, 1.0]})
    _headed(hypotheses(report, ax=left), "b", "Which", "leading hypotheses, size and 95 % interval")
    what = "held-out recordings, driven as the machine was" if report.gap else "fitted recordings, none held out"
    _headed(distances(report, ax=right), "c", "How far", what)
    parts[1].legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=2 if _long(report) else 4)
    if shown:
        above, below = parts[2].subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1.7, 1.0]})
        trace = plainest(report)
        stretch(report, trace, ax=above)
        _headed(above, "d", "How it looks", f"recording {trace.recording}")
        errors(report, trace, ax=below)
        above.tick_params(labelbottom=False)
        parts[2].align_ylabels()
    return figure


def balanced(sentence: str) -> str:
    """The sentence in lines of about equal length."""
    lines = -(-len(sentence) // _LINE)
    return min((fill(sentence, w) for w in range(len(sentence) // lines, _LINE + 1)), key=lambda t: (t.count("\n"), _longest(t)))


def _longest(text: str) -> int:
    return max(len(line) for line in text.split("\n"))


def _long(report: GapReport) -> bool:
    return sum(len(label) for label in _labels(report).values()) > 64


def _headed(ax: Axes, letter: str, word: str, rest: str) -> None:
    """Letter and word in bold, the rest behind them in grey."""
    ax.set_title(rf"$\bf{{{letter}\ \ \ {word.replace(' ', chr(92) + ' ')}}}$   {rest}", loc="left", fontsize=8.5, pad=5.0)


def leading(ranking: Sequence[Ranked]) -> list[Ranked]:
    """The most probable hypotheses: those that count, some at least and not too many."""
    counted = sum(r.probability >= PLAIN for r in ranking)
    return list(ranking[: min(max(counted, LEAST), MOST)])


@styled()
def hypotheses(report: GapReport, *, ax: Axes | None = None) -> Axes:
    """Bars of the leading hypotheses' probabilities, names and sizes above each; the ambiguity set is dark."""
    ax = axes_or_new(ax)
    rows = leading(report.ranking)
    for k, r in enumerate(rows):
        inside = r.effect in report.ambiguity
        colour = HEALED if inside else "#A9BBC7"
        ax.barh(k + 0.74, r.probability, 0.2, color=colour, gid=f"probability {r.effect}", zorder=2.0)
        ax.barh(k + 0.74, 1.0, 0.2, color="0.94", zorder=1.0)
        ax.text(0.0, k + 0.2, named(r.effect), va="center", fontsize=8.0, fontweight="bold" if k == 0 else "normal")
        ax.text(1.0, k + 0.2, percent(r.probability), va="center", ha="right", fontsize=8.0)
        ax.text(0.0, k + 0.48, sizes(r), va="center", fontsize=7.0, color=QUIET)
    ax.set_xlim(0.0, 1.0)
    ax.set_ylim(max(len(rows), 4), 0.0)
    ax.set_yticks([])
    ax.set_xticks(np.linspace(0.0, 1.0, 6), [f"{100 * x:.0f} %" for x in np.linspace(0.0, 1.0, 6)])
    ax.set_xlabel("probability")
    ax.grid(visible=False)
    for side in ("left", "right", "top"):
        ax.spines[side].set_visible(False)
    return ax


def named(effect: str) -> str:
    """An effect, a pair, `none` or `unknown` in words."""
    words = {"none": "none: no gap", "unknown": "unknown: no known effect"}
    return words.get(effect, effect.replace("+", " + ").replace("_", " "))


def sizes(r: Ranked) -> str:
    """Magnitudes with intervals and units, "" where there are none."""
    parts = list(r.parts.values())
    if r.magnitude is not None:
        parts = [(r.magnitude, r.interval or (r.magnitude, r.magnitude), r.unit or "")]
    return ";  ".join(_size(*part) for part in parts)


def _size(value: float, interval: tuple[float, float], unit: str) -> str:
    text = f"{value:.3g}{'' if unit in ('', '1') else ' ' + unit} ({interval[0]:.3g} to {interval[1]:.3g})"
    return text.replace("-", "\N{MINUS SIGN}")


def compared(report: GapReport) -> list[Submodel]:
    """Rows of the recordings that tell how far: those held out, or all where none is."""
    held = [s for s in report.submodels if s.role == "validation"]
    return held or list(report.submodels)


def rms(values: Iterable[float | None]) -> float | None:
    """Root of the mean square; None where a value is missing."""
    known = list(values)
    if not known or any(v is None for v in known):
        return None
    return float(np.sqrt(np.mean(np.square(np.array(known, dtype=float)))))


@styled()
def distances(report: GapReport, *, ax: Axes | None = None) -> Axes:
    """For each path the rms over its floor: nominal, with the effect (arrow), with the rival; the floor is 1.

    Large marks are the rms over recordings, small ones each recording.
    """
    ax = axes_or_new(ax)
    rows = compared(report)
    groups = {"all paths": rows} | {path: [s for s in rows if s.path == path] for path in dict.fromkeys(s.path for s in rows)}
    ax.axvline(1.0, color="0.25", linewidth=1.0, linestyle=(0, (4, 2)), gid="floor", label="floor: noise and ordinary spread")
    for k, mine in enumerate(groups.values()):
        _dumbbell(ax, float(k), mine, small=k > 0, named=report if k == 0 else None)
    _distance_axes(ax, list(groups), rows)
    return ax


def _dumbbell(ax: Axes, y: float, rows: Sequence[Submodel], *, small: bool, named: GapReport | None) -> None:
    before, after, rival = (rms(getattr(s, key) for s in rows) for key in ("before", "after", "rival"))
    marks = (("before", before, "o", NOMINAL, y), ("after", after, "o", HEALED, y), ("rival", rival, "D", RIVAL, y + 0.28))
    if before is not None and after is not None:
        arrow = {"arrowstyle": "-|>", "color": "0.35", "linewidth": 1.0, "mutation_scale": 8.0, "shrinkA": 3.0, "shrinkB": 4.0}
        ax.annotate("", (after, y), (before, y), arrowprops=arrow, zorder=2.0)
    labels = _labels(named) if named else {}
    for key, value, marker, colour, at in marks:
        if value is None:
            continue
        hollow = {"markerfacecolor": "white"} if key != "after" else {}
        size = 6.0 if key != "rival" else 4.5
        ax.plot([value], [at], marker, color=colour, markersize=size, markeredgewidth=1.3, gid=key, zorder=3.0,
                label=labels.get(key, "_"), **hollow)  # fmt: skip
        if small and key != "rival" and len(rows) > 1:
            ax.plot([getattr(s, key) for s in rows], np.full(len(rows), at), "|", color=colour, markersize=5.0,
                    gid=f"{key} each", zorder=2.5)  # fmt: skip


def _labels(report: GapReport) -> dict[str, str]:
    """What the marks and lines are called."""
    named_ = [r.effect for r in report.ranking if r.magnitude is not None or r.parts]
    effect = report.verdict if report.verdict not in ("none", "unknown") else next(iter(named_), "")
    healed = f"with {named(effect)}" if report.verdict != "unknown" else f"with the nearest, {named(effect)}"
    rival = report.gap.rival if report.gap and report.gap.rival else next((n for n in named_ if n != effect), "the rival")
    return {"before": "nominal model", "after": healed, "rival": f"with {named(rival)}"}


def _distance_axes(ax: Axes, names: Sequence[str], rows: Sequence[Submodel]) -> None:
    seen = [v for s in rows for v in (s.before, s.after, s.rival) if v is not None and v > 0.0]
    ax.set_xscale("log")
    ax.set_xlim(0.75 * min(0.5, *seen, 0.8), 1.4 * max(3.0, *seen, 1.0))
    low, high = ax.get_xlim()
    ticks = [t for t in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1e3, 1e4) if low < t < high]
    ax.set_xticks(ticks if len(ticks) < 8 else [t for t in ticks if np.log10(t) % 1.0 == 0.0])
    ax.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    ax.minorticks_off()
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_yticks(range(len(names)), [" → ".join(symbol(end) for end in name.split(" -> ")) for name in names])
    ax.get_yticklabels()[0].set_fontweight("bold")
    ax.tick_params(axis="y", length=0.0)
    ax.axhline(0.5, color="0.6", linewidth=0.6)
    ax.grid(visible=False, axis="y")
    ax.set_xlabel("measured − simulated, rms over floor")


def window(report: GapReport, trace: Trace) -> tuple[slice, float]:
    """The stretch of a trace where the nominal model is plainest off beyond the other, and its rms off there.

    It lasts two periods of the band's lower end, a few seconds at least.
    """
    step = float(trace.t_s[1] - trace.t_s[0])
    seconds = float(np.clip(2.0 / max(report.where.band_hz[0], 1e-3), *_WINDOW_S))
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
        look = {"color": HEALED, "linewidth": 1.1, "linestyle": (0, (4, 1.5))}
        label = "with the nearest effect" if report.verdict == "unknown" else "with the effect"
        ax.plot(t, trace.with_effect[part], gid="with effect", label=label, **look)
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
    """Name and unit of `theta2 [deg]`."""
    name, _, unit = trace.channel.partition(" [")
    return name, unit.rstrip("]")
