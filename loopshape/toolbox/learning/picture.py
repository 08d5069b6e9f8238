"""A feedforward: how well it inverts the plant, its taps, and the error that it leaves on a setpoint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.data.response.frf import FRF
from loopshape.toolbox.learning.noun import Learning
from loopshape.toolbox.learning.taps import Feedforward
from loopshape.toolbox.learning.tracking import TrackingError
from loopshape.view.labels import bracket, ratio, symbol, units_of
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, axes_or_new, head, new_figure, styled


@styled()
def inverse_error(made: Feedforward, *, ax: Axes | None = None) -> Axes:
    """|1 - P F| over its band, with the end of its 95 % interval."""
    ax = axes_or_new(ax)
    ax.plot(made.frequency_hz, made.inverse_error, color=COLOURS[0], label="|1 - P F|")
    ax.fill_between(made.frequency_hz, made.inverse_error, made.inverse_high, color=COLOURS[0], alpha=0.25, lw=0.0)
    frequency_axis(ax, *made.band_hz)
    ax.set_yscale("log")
    ax.set_ylabel("|1 - P F| [1]")
    return ax


@styled()
def learning_factor(made: Learning, *, ax: Axes | None = None) -> Axes:
    """What is left from trial to trial over frequency, with its 95 % interval, and 1, below which trials converge."""
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 2.8))
    f = made.frequency_hz
    ax.plot(f, made.factor, color=COLOURS[0], label="|Q S (1 - P F)|")
    ax.fill_between(f, made.factor_low, made.factor_high, color=COLOURS[0], alpha=0.25, lw=0.0)
    ax.axhline(1.0, color=LIMIT, linewidth=1.0)
    frequency_axis(ax, f[0], f[-1])
    ax.set_ylim(0.0, max(1.1, 1.1 * float(made.factor_high.max())))
    ax.set_ylabel("left after a trial")
    ax.set_title(f"Learning: convergence {made.converges}")
    ax.legend(loc="best")
    return ax


@styled()
def taps(made: Feedforward, *, ax: Axes | None = None, unit: str = "") -> Axes:
    """The taps over the time by which they look back; ahead is negative."""
    ax = axes_or_new(ax)
    ax.plot((np.arange(made.taps.size) - made.preview) / made.rate_hz, made.taps, color=COLOURS[1])
    ax.axvline(0.0, color="0.3", linewidth=0.7)
    ax.set_xlabel("time back [s]")
    ax.set_ylabel(f"taps of F{bracket(unit)}")
    return ax


@styled()
def errors(found: Mapping[str, TrackingError], *, ax: Axes | None = None, unit: str = "") -> Axes:
    """Errors along one setpoint with 95 % bands, by name."""
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 2.4))
    for (name, one), colour in zip(found.items(), COLOURS, strict=False):
        ax.plot(one.time_s, one.error, color=colour, label=name)
        ax.fill_between(one.time_s, one.low, one.high, color=colour, alpha=0.25, lw=0.0)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"error{bracket(unit)}")
    ax.legend(loc="best")
    return ax


@styled()
def feedforward_page(made: Feedforward, found: Mapping[str, TrackingError], plant: FRF) -> Figure:
    """Inverse error and taps, and below them the errors along a setpoint where there are any; units are the plant's."""
    unit_in, unit_out = units_of(plant)
    if found:
        figure = Figure(figsize=(FULL_WIDTH_IN, 5.2))
        panels = figure.subplot_mosaic([["inverse", "taps"], ["errors", "errors"]])
        errors(found, ax=panels["errors"], unit=unit_out)
        left, right = panels["inverse"], panels["taps"]
    else:
        figure = new_figure(1, 2, (FULL_WIDTH_IN, 2.8))
        left, right = figure.axes
    inverse_error(made, ax=left)
    taps(made, ax=right, unit=ratio(unit_in, unit_out))
    head(
        figure,
        f"Feedforward  ·  loop {symbol(made.loop)}",
        f"{made.taps.size} taps, {made.preview} samples ahead, {made.band_hz[0]:.3g} to {made.band_hz[1]:.3g} Hz",
    )
    return figure
