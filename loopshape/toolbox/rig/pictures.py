"""Pictures over time: setpoints, outputs, control signals and pressures of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.units import Array, deg
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.view.labels import bracket, expression, point, symbol, unit_of
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, axes_or_new, head, new_figure, styled


def times_s(recording: Recording) -> Array:
    """Time (n,) of each row: the recording's own `t_s`, or rows over the rate."""
    if "t_s" in recording.columns:
        return recording.column("t_s")
    return np.arange(len(next(iter(recording.columns.values())))) / recording.rate_hz


def shown(recording: Recording, terms: str) -> tuple[Array, str]:
    """A column or sum of columns as people read it, and its unit: angles in degrees, the rest as stored."""
    values, unit = recording.output(terms), unit_of(terms)
    return (deg(values), unit.replace("rad", "deg")) if unit in ("rad", "rad/s") else (values, unit)


@styled()
def response(recording: Recording, loop: LoopSetup, *, ax: Axes | None = None) -> Axes:
    """Setpoint (dashed, above) and output of one loop, in degrees or bar."""
    ax = axes_or_new(ax)
    values, unit = shown(recording, loop.output)
    ax.plot(times_s(recording), values, color=COLOURS[0], linewidth=0.9, label=expression(loop.output))
    if recording.info.closed_loop and loop.reference is not None and loop.reference in recording.columns:
        setpoint, _ = shown(recording, loop.reference)
        ax.plot(times_s(recording), setpoint, color="0.1", linewidth=0.8, linestyle="--", label="setpoint")
    return _finish(ax, recording, symbol(loop.name) + bracket(unit))


@styled()
def signals(recording: Recording, columns: Sequence[str], *, ax: Axes | None = None, label: str = "") -> Axes:
    """Columns of one unit over each other."""
    ax = axes_or_new(ax)
    unit = ""
    for k, column in enumerate(columns):
        values, unit = shown(recording, column)
        look: dict[str, Any] = {"color": COLOURS[k % len(COLOURS)], "linestyle": "-" if k < len(COLOURS) else "--"}
        ax.plot(times_s(recording), values, linewidth=0.8, label=expression(column), **look)
    return _finish(ax, recording, (label or "signal") + bracket(unit))


def _finish(ax: Axes, recording: Recording, label: str) -> Axes:
    t = times_s(recording)
    ax.set_xlim(t[0], t[-1])
    ax.margins(y=0.08)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    ax.legend(loc="center left", bbox_to_anchor=(1.005, 0.5), borderaxespad=0.2)
    return ax


@styled()
def responses(recording: Recording, loops: Sequence[LoopSetup]) -> Figure:
    """Setpoint and output of each loop, the control signals by unit, and the other pressures, over one time axis."""
    controls = _by_unit(recording, [loop.control for loop in loops if loop.control in recording.columns])
    pressures = _pressures(recording, loops)
    rows = len(loops) + len(controls) + bool(pressures)
    figure = new_figure(rows, 1, (FULL_WIDTH_IN, 0.9 + 1.35 * rows), sharex=True)
    panels = iter(figure.axes)
    for loop in loops:
        response(recording, loop, ax=next(panels))
    for columns in controls:
        signals(recording, columns, ax=next(panels), label="control")
    if pressures:
        signals(recording, pressures, ax=next(panels), label="pressure")
    for ax in figure.axes[:-1]:
        ax.set_xlabel("")
    info = recording.info
    title = f"Recording {info.name}" + (f"  ·  {point(info.operating_point)}" if info.operating_point else "")
    head(figure, title, f"{info.kind.replace('_', ' ')}, injected at the {info.injection.replace('_', ' ')}")
    return figure


def _by_unit(recording: Recording, columns: Sequence[str]) -> list[list[str]]:
    groups: dict[str, list[str]] = {}
    for column in dict.fromkeys(columns):
        groups.setdefault(shown(recording, column)[1], []).append(column)
    return list(groups.values())


def _pressures(recording: Recording, loops: Sequence[LoopSetup]) -> list[str]:
    """Columns in bar that are no loop's own signal, nor the true state behind a measured column."""
    outputs = {loop.output for loop in loops if len(sum_terms(loop.output)) == 1}
    known = outputs | {c for loop in loops for c in (loop.reference, loop.injected, loop.control) if c}
    columns = [c for c in recording.columns if c.endswith("_bar") and c not in known]
    return [c for c in columns if not (c.startswith("true_") and c.removeprefix("true_") in recording.columns)]
