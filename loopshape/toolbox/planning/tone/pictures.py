"""A channel's spectrum with its tones, and how their amplitudes went over the recording."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from loopshape.core.units import SUFFIXES, Array
from loopshape.toolbox.planning.tone.nouns import Growth, Tones
from loopshape.toolbox.planning.tone.tones import GAP, periodogram, sides
from loopshape.view.labels import bracket, symbol
from loopshape.view.style import COLOURS, FULL_WIDTH_IN, LIMIT, QUIET, axes_or_new, head, new_figure, shades, styled

#: lines of a spectrum that are drawn one by one; above, the largest of each group of neighbours
DRAWN = 4000
#: tones whose amplitudes are drawn
SHOWN = 5


@styled()
def spectrum(found: Tones, values: Array, rate_hz: float, *, ax: Axes | None = None) -> Axes:
    """Amplitudes of all lines of a signal (n,), the noise about each, and the tones with their frequencies."""
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 2.6))
    power = periodogram(values)
    f = np.asarray(np.fft.rfftfreq(values.size, 1.0 / rate_hz), dtype=float)
    left, right, _ = sides(power, _beside(found, f))
    noise = np.maximum(left, right)
    for level, style in (
        (power, {"color": COLOURS[0], "linewidth": 0.6, "label": "line"}),
        (noise, {"color": QUIET, "linewidth": 0.9, "label": "neighbouring lines"}),
    ):
        group = max(power.size // DRAWN, 1)
        cut = power.size // group * group
        ax.plot(f[:cut:group], np.sqrt(level[:cut].reshape(-1, group).max(axis=1)), **style)  # type: ignore[arg-type]
    for tone in found.tones:
        colour = LIMIT if tone.growth is Growth.GROWS else COLOURS[1]
        ax.plot(tone.frequency_hz, tone.amplitude, "v", color=colour, markersize=5.0, gid="tone")
        ax.annotate(
            f"{tone.frequency_hz:.4g} Hz", (tone.frequency_hz, tone.amplitude), xytext=(4, 3),
            textcoords="offset points", fontsize=7.0, color=colour,
        )  # fmt: skip
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(max(f[1], 0.3 * found.lowest_hz), f[-1])
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("amplitude" + bracket(SUFFIXES.get(found.unit, found.unit)))
    ax.legend(loc="lower left")
    return ax


def _beside(found: Tones, f: Array) -> np.ndarray:
    """Lines (nf,) that no tone fills: a tone of part of the record is as many lines wide as that part is shorter."""
    usable = np.ones(f.size, dtype=bool)
    for tone in found.tones:
        usable &= np.abs(f - tone.frequency_hz) > (GAP + 1) / tone.seen_s
    return usable


@styled()
def amplitudes(found: Tones, *, ax: Axes | None = None) -> Axes:
    """Amplitude of the clearest tones over the part of the recording that shows them."""
    ax = axes_or_new(ax, (FULL_WIDTH_IN, 2.2))
    shown = found.tones[:SHOWN]
    for tone, colour in zip(shown, shades(len(shown)), strict=True):
        t = np.linspace(tone.from_s, tone.to_s, 100)
        middle = 0.5 * (tone.from_s + tone.to_s)
        a = tone.amplitude * np.exp(tone.growth_per_s * (t - middle))
        low, high = (g * (t - middle) for g in tone.growth_interval_per_s)
        least, most = (tone.amplitude * np.exp(pick(low, high)) for pick in (np.minimum, np.maximum))
        ax.plot(t, a, color=colour, label=f"{tone.frequency_hz:.4g} Hz, {tone.growth.value}")
        ax.fill_between(t, least, most, color=colour, alpha=0.25, lw=0.0)
    ax.set_xlim(0.0, found.duration_s)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("amplitude" + bracket(SUFFIXES.get(found.unit, found.unit)))
    ax.legend(loc="best")
    return ax


@styled()
def tones_page(found: Tones, values: Array, rate_hz: float) -> Figure:
    """Spectrum above, amplitudes over time below."""
    figure = new_figure(2, 1, (FULL_WIDTH_IN, 5.2))
    spectrum(found, values, rate_hz, ax=figure.axes[0])
    amplitudes(found, ax=figure.axes[1])
    unit = SUFFIXES.get(found.unit, found.unit)
    low, high = found.rms_interval
    head(
        figure,
        f"Tones  ·  {symbol(found.channel)}  ·  {found.recording}",
        f"rms {found.rms:.4g} {unit} ({low:.4g} to {high:.4g}); chance of a false tone {found.chance:g}",
    )
    return figure
