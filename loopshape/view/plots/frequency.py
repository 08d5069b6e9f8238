"""Pictures of frequency responses: magnitude with its band, phase, power spectra, coherence, overviews."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, db
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Estimate, Fit
from loopshape.view.key import count, curve, key_of, place_key, place_notes
from loopshape.view.labels import (
    decibel,
    expression,
    method_in_short,
    plus_minus,
    point,
    product,
    ratio,
    split_unit,
    superscripts,
    symbol,
    units_of,
)
from loopshape.view.plots.curves import (
    draw_band,
    draw_valid,
    fit_decibels,
    fit_degrees,
    frequency_axis,
    hide_inner,
    magnitude_band_db,
    nearest_branch,
    shown,
    shown_band_hz,
    unwrapped_deg,
)
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, axes_or_new, head, new_figure, styled

_SHADE: dict[str, Any] = {"facecolor": "#F4EFE1", "edgecolor": "0.6", "zorder": 0, "linewidth": 0.5}


@styled()
def magnitude(frf: FRF, *, ax: Axes | None = None, band: bool = True, **look: Any) -> Axes:
    """|G| in dB of a 1 x 1 FRF with the 95 % band of its variance; lines outside the valid band as faint dots."""
    ax = axes_or_new(ax)
    look = {"color": COLOURS[0], **look}
    use = frf.valid
    draw_valid(ax, frf.frequency_hz, db(frf.siso), use, **look)
    if band:
        low, high = magnitude_band_db(frf)
        draw_band(ax, frf.frequency_hz[use], low[use], high[use], color=look["color"], alpha=0.25, gid="band")
    frequency_axis(ax, *shown_band_hz(frf))
    fit_decibels(ax)
    unit_in, unit_out = units_of(frf)
    ax.set_ylabel(decibel("magnitude", ratio(unit_out, unit_in)))
    return ax


@styled()
def deviations(frf: FRF, *, ax: Axes) -> Axes:
    """Standard deviation of a 1 x 1 FRF in dB beside its magnitude, and dotted noise's part; nothing without that part.

    What lies between both is what a nonlinear plant answers differently to each draw of the excitation.
    """
    if frf.noise_covariance is None:
        return ax
    noise = np.real(frf.noise_covariance[:, 0, 0])
    for variance, dash, text in ((frf.variance[:, 0, 0], "--", "std, all"), (noise, ":", "std, noise alone")):
        use = frf.valid if frf.valid.any() else slice(None)
        points = shown(frf.frequency_hz[use], db(np.sqrt(variance))[use])
        ax.plot(*points, color="0.35", linestyle=dash, linewidth=0.9, label=text)
    fit_decibels(ax)
    return ax


@styled()
def phase(frf: FRF, *, ax: Axes | None = None, **look: Any) -> Axes:
    """Phase in degrees of a 1 x 1 FRF, continuous, its first valid frequency in (-270, 90]."""
    ax = axes_or_new(ax)
    draw_valid(ax, frf.frequency_hz, unwrapped_deg(frf.siso, frf.valid), frf.valid, **({"color": COLOURS[0]} | look))
    frequency_axis(ax, *shown_band_hz(frf))
    fit_degrees(ax)
    ax.set_ylabel("phase [deg]")
    return ax


@styled()
def coherence(frf: FRF, *, ax: Axes | None = None, **look: Any) -> Axes:
    """Coherence of the loop's own input and output; an empty axes says so where the estimator has none.

    Dashed is what so few averages give where nothing is related.
    """
    ax = axes_or_new(ax)
    if frf.coherence is None:
        _absent(ax, "this estimator gives no coherence")
    else:
        draw_valid(ax, frf.frequency_hz, frf.coherence, frf.valid, **({"color": COLOURS[0]} | look))
        if frf.averages > 1.0:
            ax.axhline(
                1.0 / frf.averages, color="0.5", linestyle="--", linewidth=0.8, gid="bias", label="unrelated signals"
            )
    frequency_axis(ax, *shown_band_hz(frf))
    ax.set_ylim(0.0, 1.05)
    ax.set_ylabel("coherence [1]")
    return ax


@styled()
def spectra(frf: FRF, *, ax: Axes | None = None) -> Axes:
    """Power of input and output and the cross power's size, each in its own unit (per Hz, or per line)."""
    ax = axes_or_new(ax)
    unit_in, unit_out = units_of(frf)
    name_in, name_out = expression(frf.inputs[0]), expression(frf.outputs[0])
    powers = (
        (frf.input_power, f"{name_in} [{product(unit_in, unit_in)}]", "-"),
        (frf.output_power, f"{name_out} [{product(unit_out, unit_out)}]", "-"),
        (frf.cross_power, f"cross [{product(unit_in, unit_out)}]", "--"),
    )
    for k, (power, text, dash) in enumerate(powers):
        if power is not None:
            points = shown(frf.frequency_hz, np.abs(power))
            ax.plot(*points, color=COLOURS[k], linestyle=dash, linewidth=0.9, label=text)
    frequency_axis(ax, *shown_band_hz(frf))
    ax.set_ylabel(f"power spectra, per {frf.power_per}")
    if ax.lines:
        _power_axis(ax, frf)
    else:
        _absent(ax, "this estimator gives no spectra")
        ax.set_yticks([])
    return ax


def _power_axis(ax: Axes, frf: FRF) -> None:
    """Decades around what is seen, with room above for the legend."""
    low, high = shown_band_hz(frf)
    ax.set_yscale("log")
    points = np.concatenate([line.get_xydata() for line in ax.lines])
    values = points[(points[:, 0] >= low) & (points[:, 0] <= high), 1]
    values = values[values > 0.0]
    if values.size:
        ax.set_ylim(values.min() / 2.0, values.max() * 30.0)
    ax.legend(loc="upper center", ncols=3, columnspacing=0.7, handlelength=1.0, handletextpad=0.3, fontsize=7.0)


def _absent(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color="0.5")


@styled()
def shade_band(frf: FRF, *, ax: Axes) -> Axes:
    """Shade the valid band, from its lowest to its highest frequency; nothing where it is empty."""
    low, high = frf.valid_band_hz
    if np.isfinite(low):
        ax.axvspan(low, high, label="valid band", **_SHADE)
    return ax


@styled()
def fitted(fit: Fit, frf: FRF, *, ax: tuple[Axes, Axes], **look: Any) -> tuple[Axes, Axes]:
    """A fit over the magnitude and phase of its FRF, dashed, on the band that it was fitted in."""
    look = {"color": COLOURS[1], "linestyle": "--", "linewidth": 1.1, **look}
    lowest = float(frf.frequency_hz[frf.frequency_hz > 0.0][0])
    f_hz = np.geomspace(max(fit.band_hz[0], lowest), fit.band_hz[1], 600)
    response = fit.model.response(f_hz)
    ax[0].plot(f_hz, db(response), label="fit", **look)
    ax[1].plot(f_hz, _beside(unwrapped_deg(response), f_hz, frf), label="fit", **look)
    return ax


def _beside(phase_deg: Array, f_hz: Array, frf: FRF) -> Array:
    """The fit's phase on the turn of the measured one at the fit's lowest line."""
    k = int(np.argmin(np.abs(frf.frequency_hz - f_hz[0])))
    measured = unwrapped_deg(frf.siso, frf.valid)[k]
    return np.asarray(phase_deg + (nearest_branch(phase_deg[:1], measured) - phase_deg[0]))


@styled()
def frf_page(frf: FRF, fit: Fit | None = None) -> Figure:
    """One FRF on a page: magnitude and phase, and where it was measured power spectra and coherence at the right.

    The layout is that of figure 4.12 of van den Brink, DCT 2007.002; the valid band is shaded.
    """
    measured = any(x is not None for x in (frf.coherence, frf.input_power, frf.output_power))
    figure = new_figure(2, 1 + measured, (FULL_WIDTH_IN, 4.9), sharex=True)
    (a, *c, b), d = (figure.axes[:3], figure.axes[3:]) if measured else (figure.axes, [])
    magnitude(frf, ax=a, label="measured, 95 % band")
    if frf.noise_covariance is not None:
        deviations(frf, ax=a)
        low, high = a.get_ylim()
        a.set_ylim(low, high + 0.35 * (high - low))  # room for the legend
        a.legend(loc="upper right", fontsize=7.0)
    phase(frf, ax=b)
    for right, draw in zip((*c, *d), (spectra, coherence), strict=False):
        draw(frf, ax=right)
    if fit is not None:
        fitted(fit, frf, ax=(a, b))
        a.legend(loc="lower left")
        fit_decibels(a)
        fit_degrees(b)
        low, high = a.get_ylim()
        a.set_ylim(low - 0.2 * (high - low), high)  # room for the legend
    for ax in figure.axes:
        shade_band(frf, ax=ax)
    for ax in (one for one in d if one.get_legend_handles_labels()[0]):
        ax.legend(loc="center left", fontsize=7.0)
    hide_inner(a, *c)
    head(figure, _title(frf), frf.method, *_fit_lines(fit), *frf.notes)
    return figure


def _title(frf: FRF) -> str:
    what = f"{expression(frf.outputs[0])} / {expression(frf.inputs[0])}"
    parts = (f"FRF {what}", frf.loop and f"loop {symbol(frf.loop)}", frf.recording, point(frf.operating_point))
    return "  ·  ".join(part for part in parts if part)


def _fit_lines(fit: Fit | None) -> tuple[str, ...]:
    if fit is None:
        return ()
    readable = [p for p in fit.parameters if p.unit != "SI"]  # bare coefficients say nothing to a reader
    numbers = ", ".join(_estimate(p) for p in readable)
    outcome = "" if fit.converged else f", {fit.outcome.replace('_', ' ')}"
    misfit = f"misfit {fit.misfit_db:.2g} dB{outcome}"
    return (f"fit {fit.structure.replace('_', ' ')}: {f'{numbers} (95 %), ' if numbers else ''}{misfit}",)


def _estimate(parameter: Estimate) -> str:
    value = plus_minus(parameter.value, parameter.interval[1] - parameter.value)
    name, unit = split_unit(parameter.name)
    unit = unit or ("" if parameter.unit == "1" else superscripts(parameter.unit))
    return f"{symbol(name)} = {value} {unit}".rstrip()


@styled()
def frf_overview(frfs: Sequence[FRF], fits: Sequence[Fit] | None = None) -> Figure:
    """Magnitudes and phases of all operating points over each other, as figure 4.13 of DCT 2007.002.

    `fits`, one an FRF in the same order, are drawn dashed in grey over them.
    """
    if not frfs or (fits is not None and len(fits) != len(frfs)):
        got = f"{len(frfs)} FRFs and {'no' if fits is None else len(fits)} fits"
        raise WrongUseError("an overview needs FRFs, and one fit for each or none", got)
    key = key_of(frfs)
    figure = new_figure(2, 1, (FULL_WIDTH_IN, 6.4), sharex=True)
    top, bottom = figure.axes
    for k, (frf, look) in enumerate(zip(frfs, key.looks, strict=True)):
        line = curve(look, k, len(frfs)) | ({"alpha": 0.55} if fits is not None else {})
        magnitude(frf, ax=top, band=False, **line)
        phase(frf, ax=bottom, **line)
        if fits is not None:
            fitted(fits[k], frf, ax=(top, bottom), color="0.2", linewidth=0.5, linestyle=(0, (3, 4)))
    frequency_axis(bottom, *shown_band_hz(*frfs))
    fit_decibels(top)
    fit_degrees(bottom)
    hide_inner(top)
    if fits is not None:
        place_notes(top, [("fits", {"color": "0.2", "linewidth": 0.7, "linestyle": "--"})], "upper right")
    place_key(figure, key)
    head(figure, _overview_title(frfs), key.common, method_in_short(frfs))
    return figure


def _overview_title(frfs: Sequence[FRF]) -> str:
    what = f"{expression(frfs[0].outputs[0])} / {expression(frfs[0].inputs[0])}"
    loop = f"loop {symbol(frfs[0].loop)}" if frfs[0].loop else ""
    return "  ·  ".join(part for part in (f"FRF {what}", loop, count(frfs)) if part)
