"""What robustness costs, and how a controller would have to be scheduled over the operating points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from loopshape.toolbox.schedules.schedule import PointCost, Schedule
from loopshape.view.key import varying
from loopshape.view.labels import bracket, numbers, quantity, split_unit, symbol
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, MARKERS, QUIET, axes_or_new, head, shades, styled

_KINDS = {"lead_lag": "lead-lag", "low_pass_1": "low-pass", "low_pass_2": "low-pass"}


@styled()
def costs(found: Schedule, *, ax: Axes | None = None) -> Axes:
    """Bandwidth at every operating point: with its own controller, with the robust one, and what none exceeds.

    Hollow circles are own controllers that do not surely meet all requirements; dashed lines mark the lowest
    bandwidths.
    """
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 2.8))
    points = ordered(found.points)
    x = np.arange(len(points), dtype=float)
    own, robust, bound = (np.array([getattr(p, name) for p in points]) for name in ("own_hz", "robust_hz", "bound_hz"))
    ax.vlines(x, robust, own, color=QUIET, linewidth=0.9)
    feasible = np.array([p.feasible for p in points])
    ax.plot(x, own, "o", color=COLOURS[0], markerfacecolor="white", gid="own")
    ax.plot(x[feasible], own[feasible], "o", color=COLOURS[0], label="own controller")
    ax.plot(x, robust, "s", color=COLOURS[1], label="robust controller", gid="robust")
    if np.isfinite(bound).any():
        look = {"color": LIMIT, "markersize": 9.0, "markeredgewidth": 1.2, "linestyle": "none"}
        ax.plot(x, bound, marker="_", label="no controller exceeds", gid="bound", **look)  # type: ignore[arg-type]
    for lowest, colour in ((found.own_hz, COLOURS[0]), (found.robust_hz, COLOURS[1])):
        ax.axhline(lowest, color=colour, linewidth=0.8, linestyle="--", zorder=1.0)
    _plain_log(ax, np.concatenate([own, robust, bound]))
    _places(ax, points)
    ax.set_ylabel("bandwidth [Hz]")
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, columnspacing=1.2)
    return ax


def ordered(points: Sequence[PointCost]) -> list[PointCost]:
    """Points by their last varying quantity, then by the others."""
    keys = varying(points)
    return sorted(points, key=lambda p: [p.operating_point[key] for key in reversed(keys)]) if keys else list(points)


def _places(ax: Axes, points: Sequence[PointCost]) -> None:
    """The first quantity at every point, the second below each group; recordings' names where neither varies."""
    keys = varying(points)
    x = np.arange(len(points))
    ax.set_xlim(-0.6, len(points) - 0.4)
    if not keys or len(keys) > 2:
        ax.set_xticks(x, [p.recording for p in points], rotation=90.0)
        return
    ax.set_xticks(x, [f"{p.operating_point[keys[0]]:g}".replace("-", "\N{MINUS SIGN}") for p in points], fontsize=7.0)
    ax.grid(False, axis="x")
    ax.set_xlabel(quantity(keys[0]), labelpad=2.0 if len(keys) == 1 else 12.0)
    if len(keys) == 2:
        _groups(ax, [p.operating_point[keys[1]] for p in points], keys[1])


def _groups(ax: Axes, seconds: Sequence[float], key: str) -> None:
    name, unit = split_unit(key)
    texts = numbers(sorted(set(seconds)))
    for k, second in enumerate(sorted(set(seconds))):
        members = np.flatnonzero(np.array(seconds) == second)
        if k:
            ax.axvline(members[0] - 0.5, color="#B0B0B0", linewidth=0.6, zorder=0.5)
        text = f"{symbol(name)} = {texts[k]}" if k == 0 else texts[k]
        unit_text = f" {unit}" if k == 0 else ""
        ax.annotate(
            text + unit_text, (float(members.mean()), 0.0), xycoords=("data", "axes fraction"), xytext=(0, -16),
            textcoords="offset points", ha="center", va="top", fontsize=7.0, color=QUIET, annotation_clip=False,
        )  # fmt: skip


@styled()
def parameter(found: Schedule, name: str, *, ax: Axes | None = None) -> Axes:
    """A parameter of the own controllers over the first quantity that varies, a line for each value of the second.

    `name` is one of `Schedule.parameters()`; the dashed line is the robust controller's.
    """
    ax = axes_or_new(ax, (3.4, 2.2))
    values = dict(zip([p.recording for p in found.points], found.parameters()[name], strict=True))
    place, kind, what = name.split(" ")
    keys = varying(found.points)
    if not keys or len(keys) > 2:
        ax.plot(range(len(values)), list(values.values()), "o", color=COLOURS[0])
        ax.set_xticks(range(len(values)), list(values), rotation=90.0)
    else:
        for k, (label, members) in enumerate(_lines(found.points, keys).items()):
            look = {"color": shades(len(_lines(found.points, keys)))[k], "marker": MARKERS[k % len(MARKERS)]}
            x = [p.operating_point[keys[0]] for p in members]
            ax.plot(x, [values[p.recording] for p in members], label=label, linewidth=0.8, **look)  # type: ignore[arg-type]
        ax.set_xlabel(quantity(keys[0]))
    robust = found.robust.blocks[int(place) - 1].parameters[what]
    ax.axhline(robust, color=QUIET, linewidth=0.9, linestyle="--", gid="robust", label="robust")
    seen = np.array([*values.values(), robust])
    logarithmic = 4.0  # a parameter that spans less than this factor is drawn on a linear axis
    if seen.min() > 0.0 and seen.max() > logarithmic * seen.min():
        _plain_log(ax, seen)
    short, unit = split_unit(what)
    ax.set_ylabel((f"{_KINDS.get(kind, kind)} {symbol(short)}" if kind != what else kind) + bracket(unit))
    return ax


def _lines(points: Sequence[PointCost], keys: Sequence[str]) -> dict[str, list[PointCost]]:
    """Points by the value of the second key, each sorted by the first."""
    rising = sorted(points, key=lambda p: p.operating_point[keys[0]])
    if len(keys) == 1:
        return {"own": rising}
    seconds = sorted({p.operating_point[keys[1]] for p in points})
    return {
        text: [p for p in rising if p.operating_point[keys[1]] == second]
        for text, second in zip(numbers(seconds), seconds, strict=True)
    }


@styled()
def schedule_page(found: Schedule) -> Figure:
    """Costs above; below them the two parameters that follow the operating point best, which a schedule could hold."""
    names = scheduled(found)[:2]
    rows = (len(names) + 1) // 2
    figure = Figure(figsize=(FULL_WIDTH_IN, 4.0 + 2.2 * rows))
    grid = figure.add_gridspec(rows + 1, 2, height_ratios=[1.7] + [1.0] * rows)
    costs(found, ax=figure.add_subplot(grid[0, :]))
    for k, name in enumerate(names):
        ax = parameter(found, name, ax=figure.add_subplot(grid[1 + k // 2, k % 2]))
        if k + 2 < len(names):
            ax.set_xlabel("")
            ax.tick_params(labelbottom=False)
    if names:
        keys = varying(found.points)
        handles, labels = figure.axes[1].get_legend_handles_labels()
        title = quantity(keys[1]) if len(keys) == 2 else None
        figure.legend(handles, labels, title=title, loc="outside lower center", ncols=8, title_fontsize=8.0)
    head(
        figure,
        f"One controller or one for each operating point  ·  loop {symbol(found.loop)}",
        f"lowest bandwidth {found.own_hz:.3g} Hz scheduled, {found.robust_hz:.3g} Hz robust (dashed)",
    )
    return figure


def scheduled(found: Schedule) -> list[str]:
    """Parameters that vary, first the one of which a quadratic of the operating point explains most."""
    points = np.array([[p.operating_point[key] for key in varying(found.points)] for p in found.points])
    X = np.column_stack([np.ones(len(found.points)), points, points**2])
    values = found.parameters()

    def unexplained(name: str) -> float:
        y = np.log(np.abs(np.array(values[name])) + 1e-300)
        spread = float(np.sum((y - y.mean()) ** 2))
        return float(np.sum((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2)) / spread if spread > 0.0 else 1.0

    return sorted(distinct(found), key=unexplained)


def distinct(found: Schedule) -> list[str]:
    """Parameters that vary, each once: one tied to another has the same values."""
    seen: set[tuple[float, ...]] = set()
    names = []
    for name, values in found.parameters().items():
        if tuple(values) not in seen:
            names.append(name)
        seen.add(tuple(values))
    return names


def _plain_log(ax: Axes, values: np.ndarray) -> None:
    """A logarithmic axis over positive values, with plain numbers."""
    seen = values[np.isfinite(values) & (values > 0.0)]
    if not seen.size:
        return
    ax.set_yscale("log")
    ax.set_ylim(0.8 * float(seen.min()), 1.25 * float(seen.max()))
    wide = float(seen.max() / seen.min()) > 100.0
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
