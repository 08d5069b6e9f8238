"""Pictures of fitted parameters over the operating points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from loopshape.core.errors import WrongUseError
from loopshape.data.response.model import Fit
from loopshape.view.key import varying
from loopshape.view.labels import bracket, numbers, point, quantity, split_unit, superscripts, symbol
from loopshape.view.style import COLOURS, MARKERS, QUIET, axes_or_new, shades, styled


@styled()
def parameter_map(fits: Sequence[Fit], name: str, *, ax: Axes | None = None) -> Axes:
    """A fitted parameter with its 95 % interval over the first quantity of the operating points that varies.

    Each value of a second one is a line of its own, set a little aside so that the intervals stay apart.
    Fits that did not converge are hollow. Without such operating points the recordings stand on the x axis.
    """
    if not fits:
        raise WrongUseError("a parameter map needs fits", "none", "fit some FRFs first")
    ax = axes_or_new(ax, (5.6, 3.2))
    keys = varying(fits)
    if not keys or len(keys) > 2:
        _by_recording(ax, fits, name)
    else:
        _by_point(ax, fits, name, keys)
    parameter, unit = split_unit(name)
    ax.set_ylabel(symbol(parameter) + bracket(unit or superscripts(fits[0][name].unit)))
    return ax


def _by_point(ax: Axes, fits: Sequence[Fit], name: str, keys: Sequence[str]) -> None:
    lines = _lines(fits, keys)
    seconds = numbers([second for second, _ in lines]) if len(keys) == 2 else ["fits"] * len(lines)
    labels = [f"{text} ({settings})" if settings else text for text, (_, settings) in zip(seconds, lines, strict=True)]
    places = np.unique([fit.operating_point[keys[0]] for fit in fits])
    gap = 0.015 * float(np.min(np.diff(places)))
    for k, members in enumerate(lines.values()):
        aside = gap * (k - 0.5 * (len(lines) - 1))
        x = np.array([fit.operating_point[keys[0]] for fit in members]) + aside
        _errorbars(ax, x, members, name, labels[k], shades(len(lines))[k], MARKERS[k % len(MARKERS)])
    if any(not fit.converged for fit in fits):
        ax.plot([], [], "o", color=QUIET, markerfacecolor="white", label="not converged")
    ax.set_xticks(places, numbers(list(places)))
    ax.set_xlabel(quantity(keys[0]))
    if len(keys) == 2:
        handles, texts = ax.get_legend_handles_labels()
        last = sorted(range(len(texts)), key=lambda k: texts[k] not in labels)
        handles, texts = [handles[k] for k in last], [texts[k] for k in last]
        ax.legend(
            handles, texts, title=quantity(keys[1]), title_fontsize=8.0, loc="center left", bbox_to_anchor=(1.01, 0.5)
        )


def _lines(fits: Sequence[Fit], keys: Sequence[str]) -> Mapping[tuple[float, str], list[Fit]]:
    """Fits by the value of the second key and the rig's own settings, each sorted by the first key."""
    groups: dict[tuple[float, str], list[Fit]] = {}
    for fit in sorted(fits, key=lambda f: tuple(f.operating_point[k] for k in keys)):
        place = fit.operating_point[keys[1]] if len(keys) == 2 else 0.0
        groups.setdefault((place, point(fit.rig_parameters)), []).append(fit)
    return dict(sorted(groups.items()))


def _by_recording(ax: Axes, fits: Sequence[Fit], name: str) -> None:
    x = np.arange(len(fits), dtype=float)
    _errorbars(ax, x, fits, name, "fits", COLOURS[0], "o", linestyle="none")
    ax.set_xticks(x, [fit.recording or str(k + 1) for k, fit in enumerate(fits)], rotation=90.0)
    ax.set_xlabel("recording")


def _errorbars(
    ax: Axes, x: np.ndarray, fits: Sequence[Fit], name: str, label: str, colour: str, marker: str, **look: Any
) -> None:
    values = np.array([fit[name].value for fit in fits])
    half_width = np.array([fit[name].interval[1] for fit in fits]) - values
    half_width = np.where(np.isfinite(half_width), half_width, 0.0)
    style: dict[str, Any] = {
        "color": colour,
        "linewidth": 0.8,
        "elinewidth": 0.9,
        "capsize": 1.5,
        "markersize": 4.0,
    } | look
    ax.errorbar(x, values, yerr=half_width, label=label, marker=marker, **style)
    failed = np.array([not fit.converged for fit in fits])
    if failed.any():
        hollow: dict[str, Any] = {
            "markerfacecolor": "white",
            "markeredgecolor": colour,
            "linestyle": "none",
            "zorder": 3,
        }
        ax.plot(x[failed], values[failed], marker=marker, markersize=4.5, gid="not converged", **hollow)
