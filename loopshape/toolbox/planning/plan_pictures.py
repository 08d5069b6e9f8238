"""Picture of a planned experiment: how sure the response is before and after, and what is injected for it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from loopshape.toolbox.planning.plan_nouns import Plan
from loopshape.view.labels import symbol
from loopshape.view.plots.curves import frequency_axis, hide_inner
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, QUIET, axes_or_new, head, new_figure, styled


@styled()
def accuracy(plan: Plan, *, ax: Axes | None = None) -> Axes:
    """Relative std of |G| in percent: of the first record, predicted for the plan, required; the crossover."""
    ax = axes_or_new(ax)
    ax.plot(
        plan.before_hz, 100.0 * plan.before_std, color=QUIET, linewidth=0.9, label=f"first record: {plan.recording}"
    )
    planned = {"color": COLOURS[0], "marker": "o", "markersize": 3.0, "linewidth": 0.6}
    ax.plot(plan.lines_hz, 100.0 * plan.std, label="predicted for the plan", **planned)  # type: ignore[arg-type]
    if plan.floor.any():
        floor = np.where(plan.floor > 0.0, 100.0 * plan.floor, np.nan)
        ax.plot(
            plan.lines_hz, floor, color=COLOURS[1], linewidth=0.9, linestyle=":",
            label="of which distortion", gid="floor",
        )  # fmt: skip
    if plan.required.std is not None:
        ax.axhline(
            100.0 * plan.required.std, color=LIMIT, linewidth=1.0, linestyle="--", label="required", gid="required"
        )
    crossover_line(plan, ax)
    _percent_axis(ax)
    frequency_axis(ax, *_band(plan))
    ax.set_ylabel("relative std of |G| [%]")
    ax.legend(loc="upper center", ncols=4, columnspacing=0.8, handlelength=1.4, fontsize=7.0)
    return ax


@styled()
def injected(plan: Plan, *, ax: Axes | None = None) -> Axes:
    """Amplitude of each line that is injected."""
    ax = axes_or_new(ax)
    least = 0.5 * float(plan.line_amplitude.min())
    ax.vlines(plan.lines_hz, least, plan.line_amplitude, color=COLOURS[0], linewidth=0.9)
    ax.plot(plan.lines_hz, plan.line_amplitude, color=COLOURS[0], marker="o", markersize=3.0, linestyle="none")
    crossover_line(plan, ax)
    ax.set_yscale("log")
    ax.set_ylim(least, 2.0 * float(plan.line_amplitude.max()))
    _plain_numbers(ax, float(plan.line_amplitude.max()) / least)
    frequency_axis(ax, 0.8 * float(plan.lines_hz[0]), 1.25 * float(plan.lines_hz[-1]))
    ax.set_ylabel(f"amplitude of a frequency [{plan.unit}]")
    return ax


@styled()
def crossover_line(plan: Plan, ax: Axes) -> None:
    """A thin mark at the frequency of the required accuracy."""
    ax.axvline(plan.crossover_hz, color=QUIET, linewidth=0.8, linestyle="-.", gid="crossover", zorder=1.0)


@styled()
def plan_page(plan: Plan) -> Figure:
    """Accuracy above, what is injected below, the plan in words over both."""
    figure = new_figure(2, 1, (FULL_WIDTH_IN, 5.2), sharex=True, height_ratios=(1.6, 1.0))
    top, bottom = figure.axes
    injected(plan, ax=bottom)
    accuracy(plan, ax=top)
    frequency_axis(bottom, *_band(plan))
    top.annotate(
        f"{plan.crossover_hz:.3g} Hz", (plan.crossover_hz, 0.02), xycoords=("data", "axes fraction"),
        xytext=(3, 0), textcoords="offset points", fontsize=7.0, color=QUIET,
    )  # fmt: skip
    hide_inner(top)
    head(figure, f"Planned experiment  ·  loop {symbol(plan.loop)}", plan.sentence)
    return figure


def _band(plan: Plan) -> tuple[float, float]:
    """What is planned, and the first record around it by a factor of 1.6."""
    low, high = float(plan.lines_hz[0]), float(plan.lines_hz[-1])
    f = plan.before_hz
    return min(0.9 * low, max(float(f[0]), low / 1.6)), max(1.1 * high, min(float(f[-1]), 1.6 * high))


def _percent_axis(ax: Axes) -> None:
    """Logarithmic, plain numbers, room above for the key."""
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in ax.lines if line.get_gid() is None])
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.1, 10.0)
    asked = [float(np.asarray(line.get_ydata(), dtype=float)[0]) for line in ax.lines if line.get_gid() == "required"]
    low, high = min([low, *asked]), max([high, *asked])
    ax.set_yscale("log")
    ax.set_ylim(low / 1.6, 2.5 * high)
    _plain_numbers(ax, high / low)


def _plain_numbers(ax: Axes, span: float) -> None:
    """Ticks of a logarithmic axis that spans a factor, as plain numbers."""
    short = span < 300.0
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if short else (1.0,)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
