"""Pictures of what a measurement makes of predictions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.errors import WrongUseError
from loopshape.core.units import db
from loopshape.data.response.frf import FRF
from loopshape.toolbox.validation.nouns import Agreement, Comparison, StepComparison
from loopshape.toolbox.validation.predicted.nouns import Prediction
from loopshape.toolbox.validation.remeasured import Remeasured
from loopshape.verbs.pictures import save
from loopshape.view.labels import point, symbol
from loopshape.view.plots.curves import draw_band, frequency_axis, magnitude_band_db
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, head, new_figure, styled

_PREDICTED, _MEASURED = COLOURS[0], COLOURS[1]
_COLUMNS, _MOST = 3, 9


@styled()
def comparison_grid(
    predictions: Sequence[Prediction], measured: Sequence[FRF], comparisons: Sequence[Comparison]
) -> Figure:
    """|S| predicted and measured of one loop, a panel for each operating point, with the outcome and where it fails."""
    if not comparisons or not len(predictions) == len(measured) == len(comparisons):
        raise WrongUseError(
            "a comparison's picture needs a prediction and a measurement for each", f"{len(comparisons)}"
        )
    shown = _most_telling([_departure(c) for c in comparisons])
    figure, panels = _grid(len(shown))
    band = [
        min(p.sensitivity.frequency_hz[0] for p in predictions),
        max(p.sensitivity.frequency_hz[-1] for p in predictions),
    ]
    for ax, k in zip(panels, shown, strict=False):
        one, two, found = predictions[k], measured[k], comparisons[k]
        seen = two.select((two.frequency_hz >= band[0]) & (two.frequency_hz <= band[1]))
        for frf, colour in ((one.sensitivity, _PREDICTED), (seen, _MEASURED)):
            draw_band(ax, frf.frequency_hz, *magnitude_band_db(frf), color=colour, alpha=0.25)
            ax.plot(frf.frequency_hz, db(frf.siso), color=colour, linewidth=0.8)
        worst = found.worst
        if found.outcome is Agreement.REFUTED and worst is not None:
            ax.axvspan(worst.low_hz, worst.high_hz, color=LIMIT, alpha=0.10, linewidth=0.0)
        frequency_axis(ax, band[0], band[1], label=False)
        _panel_title(ax, point(found.operating_point) or found.measured_from, _verdict(found), found.outcome)
    low = min(float(ax.dataLim.y0) for ax in panels[: len(shown)])
    for ax in panels[: len(shown)]:
        ax.set_ylim(max(5.0 * np.floor(low / 5.0), -45.0), 12.0)
    _outer_labels(panels[: len(shown)], "frequency [Hz]", "|S| [dB]")
    _legend(figure, [("predicted, 95 %", _PREDICTED), ("measured, 95 %", _MEASURED)])
    confirmed = sum(c.outcome is Agreement.CONFIRMED for c in comparisons)
    head(
        figure, f"Sensitivity of loop {symbol(comparisons[0].loop)}: {confirmed} of {len(comparisons)} confirmed",
        f"level {comparisons[0].level:.2g} each, deviations of {comparisons[0].tolerance_db:g} dB rms count as none;"
        " shaded: the band that differs most", *_left_out(len(shown), len(comparisons)),
    )  # fmt: skip
    return figure


def _departure(found: Comparison) -> float:
    """How far a comparison is from its prediction, in dB; of those that are not refuted nothing."""
    return abs(found.worst.sensitivity_db) if found.outcome is Agreement.REFUTED and found.worst is not None else 0.0


def _most_telling(departures: Sequence[float]) -> list[int]:
    """Places of the panels that are shown: as many as can be read, those that depart most, in their own order."""
    return sorted(sorted(range(len(departures)), key=lambda k: -departures[k])[:_MOST])


def _left_out(shown: int, every: int) -> list[str]:
    return [f"{shown} of {every} operating points, those that differ most"] if shown < every else []


def _verdict(found: Comparison) -> str:
    worst = found.worst
    if found.outcome is not Agreement.REFUTED or worst is None:
        return found.outcome
    return f"{worst.sensitivity_db:+.1f} dB at {worst.low_hz:.2g}-{worst.high_hz:.2g} Hz".replace(
        "-", "\N{MINUS SIGN}", int(worst.sensitivity_db < 0.0)
    )


@styled()
def steps_grid(steps: Sequence[StepComparison]) -> Figure:
    """Measured steps over the predicted ones, all as unit steps, a panel for each operating point."""
    if not steps:
        raise WrongUseError("a picture of steps needs at least one", "none", "record a setpoint that steps")
    every = list(dict.fromkeys(_place(step) for step in steps))
    misses_of = [max((s.largest_miss for s in steps if _place(s) == place), default=0.0) for place in every]
    places = [every[k] for k in _most_telling([miss if np.isfinite(miss) else 0.0 for miss in misses_of])]
    figure, panels = _grid(len(places))
    last = _shown_s(steps)
    for ax, place in zip(panels, places, strict=False):
        mine = [step for step in steps if _place(step) == place]
        for step in mine:
            ax.plot(step.time_s, step.response, color=_MEASURED, linewidth=0.6, alpha=0.8)
        predicted = mine[0].predicted
        if predicted is not None:
            ax.fill_between(predicted.time_s, predicted.low, predicted.high, color=_PREDICTED, alpha=0.25, lw=0.0)
            ax.plot(predicted.time_s, predicted.response, color=_PREDICTED, linewidth=0.9)
        ax.axhline(1.0, color="0.3", linewidth=0.6, zorder=1.5)
        misses = [step.largest_miss for step in mine if np.isfinite(step.largest_miss)]
        off = f"off by {100.0 * max(misses):.0f} % at most" if misses else "not predicted"
        _panel_title(ax, place, off, Agreement.CONFIRMED if misses else Agreement.CANNOT_TELL)
        ax.set_xlim(0.0, last)
        ax.set_ylim(-0.25, 1.75)
    _outer_labels(panels[: len(places)], "time after the step [s]", "output [1]")
    _legend(figure, [("predicted, 95 % of the fit's parameters", _PREDICTED), ("measured, each step", _MEASURED)])
    title = f"Steps of loop {symbol(steps[0].loop)}, as of a unit step of the setpoint"
    head(figure, title, *_left_out(len(places), len(every)))
    return figure


def _shown_s(steps: Sequence[StepComparison]) -> float:
    """Time to show: twice what most steps need to settle, as predicted or measured to 5 %."""
    reads = [s.predicted.indicators.settling_time_s if s.predicted else s.measured.settling_time_5_s for s in steps]
    longest = max(float(step.time_s[-1]) for step in steps)
    settled = [t for t in reads if np.isfinite(t) and t > 0.0]
    return min(longest, 2.0 * max(settled)) if settled else longest


def _place(step: StepComparison) -> str:
    return point(step.operating_point) or step.recording


def _grid(count: int) -> tuple[Figure, list[Axes]]:
    columns = min(_COLUMNS, count)
    rows = -(-count // columns)
    figure = new_figure(rows, columns, (FULL_WIDTH_IN, 1.3 + 1.6 * rows), sharex=True, sharey=True, squeeze=False)
    panels = list(figure.axes)
    for ax in panels[count:]:
        ax.set_visible(False)
    return figure, panels


def _panel_title(ax: Axes, first: str, second: str, outcome: Agreement) -> None:
    ax.set_title(first, fontsize=8.0, loc="left", pad=2.5)
    colour = LIMIT if outcome is Agreement.REFUTED else "0.25"
    box: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85}
    ax.text(0.97, 0.06, second, fontsize=7.5, ha="right", va="bottom", color=colour, transform=ax.transAxes, bbox=box)


def _outer_labels(panels: Sequence[Axes], x: str, y: str) -> None:
    """Labels at the left column and at the last panel of each column."""
    columns = min(_COLUMNS, len(panels))
    for k, ax in enumerate(panels):
        last = k + columns >= len(panels)
        ax.set_xlabel(x if last else "")
        ax.set_ylabel(y if k % columns == 0 else "")
        ax.tick_params(labelbottom=last)


def _legend(figure: Figure, entries: Sequence[tuple[str, str]]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, linewidth=2.0) for _, colour in entries]
    figure.legend(handles, [text for text, _ in entries], loc="outside lower center", ncols=len(entries))


def draw_remeasured(folder: Path, found: Sequence[Remeasured]) -> list[str]:
    """Predicted over measured of each loop: sensitivities, and steps where there are any."""
    drawn = []
    for loop in dict.fromkeys(one.prediction.loop for one in found):
        mine = [one for one in found if one.prediction.loop == loop]
        seen = [(one.prediction, frf, c) for one in mine for frf, c in zip(one.measured, one.comparisons, strict=True)]
        if seen:
            figure = comparison_grid([p for p, _, _ in seen], [m for _, m, _ in seen], [c for _, _, c in seen])
            drawn.append(str(save(figure, folder / f"compare_{loop}.png")))
        if steps := [s for one in mine for s in one.steps]:
            drawn.append(str(save(steps_grid(steps), folder / f"steps_{loop}.png")))
    return drawn
