"""The picture of predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.errors import WrongUseError
from loopshape.core.units import db
from loopshape.data.response.frf import FRF
from loopshape.toolbox.validation.predicted.nouns import Prediction
from loopshape.view.key import count, curve, key_of, place_key
from loopshape.view.labels import symbol
from loopshape.view.plots.curves import draw_band, fit_decibels, frequency_axis, magnitude_band_db
from loopshape.view.style import FULL_WIDTH_IN, head, styled

#: up to so many curves carry their bands
BANDS = 3


@styled()
def prediction_page(predictions: Sequence[Prediction]) -> Figure:
    """|S|, |T| and the step of one loop at all operating points; 95 % bands where there are three at most."""
    if not predictions:
        raise WrongUseError("a picture of predictions needs at least one", "none", "predict first")
    sensitivities = [one.sensitivity for one in predictions]
    key = key_of(sensitivities)
    figure = Figure(figsize=(FULL_WIDTH_IN, 5.6))
    panels = figure.subplot_mosaic([["S", "T"], ["step", "step"]])
    for k, (one, look) in enumerate(zip(predictions, key.looks, strict=True)):
        style = curve(look, k, len(predictions))
        for name, frf in (("S", one.sensitivity), ("T", one.complementary)):
            panels[name].plot(frf.frequency_hz, db(frf.siso), **style)
            if len(predictions) <= BANDS:
                draw_band(panels[name], frf.frequency_hz, *magnitude_band_db(frf), color=look["color"], alpha=0.25)
        if one.step is not None:
            step = one.step
            panels["step"].plot(step.time_s, step.response, **style)
            if len(predictions) <= BANDS:
                panels["step"].fill_between(step.time_s, step.low, step.high, color=look["color"], alpha=0.25, lw=0.0)
    for name in "ST":
        _decibels(panels[name], name, sensitivities, span=60.0)
    _step_axes(panels["step"], [one for one in predictions if one.step is not None])
    place_key(figure, key)
    controller = ", ".join(block.kind.replace("_", " ") for block in predictions[0].controller.blocks)
    title = f"Predicted: loop {symbol(predictions[0].loop)}  ·  {count(sensitivities)}"
    head(figure, title, *(text for text in (key.common, f"controller: {controller}") if text))
    return figure


def _decibels(ax: Axes, name: str, frfs: Sequence[FRF], span: float) -> None:
    frequency_axis(ax, min(f.frequency_hz[0] for f in frfs), max(f.frequency_hz[-1] for f in frfs))
    fit_decibels(ax, span=span)
    ax.axhline(0.0, color="0.3", linewidth=0.7, zorder=1.5)
    ax.set_ylabel(f"|{name}| [dB]")


def _step_axes(ax: Axes, shown: Sequence[Prediction]) -> None:
    ax.axhline(1.0, color="0.3", linewidth=0.7, zorder=1.5)
    ax.set_xlabel("time after a unit step of the setpoint [s]")
    ax.set_ylabel("output [1]")
    if not shown:
        ax.text(0.5, 0.5, "no step: no fit, or it does not come to rest", ha="center", transform=ax.transAxes)
        return
    steps = [one.step for one in shown if one.step is not None]
    settled = [s.indicators.settling_time_s for s in steps if np.isfinite(s.indicators.settling_time_s)]
    last = min(max(float(s.time_s[-1]) for s in steps), 1.6 * max(settled, default=1e9))
    ax.set_xlim(0.0, last)
