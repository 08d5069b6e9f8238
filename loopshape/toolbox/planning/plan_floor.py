"""What distortion leaves on a planned line, however long it is measured: read off the first record's silent lines.

A line that is not excited tells what falls beside the response on those that are (Pintelon and Schoukens 2012, ch. 4).
Referred to the plant's input it is taken to keep its power per Hz, over the power of the whole input, when lines,
levels and amplitude change. That is a rule of thumb: a cubic grows faster with the amplitude, friction falls. A gain
that changes with the amplitude no silent line tells.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from loopshape.core.units import Array
from loopshape.identify.tolerances import TOL
from loopshape.toolbox.planning.plan_record import FirstRecord, between
from loopshape.toolbox.rig.distortion import Lines


def planned_floor(first: FirstRecord, lines_hz: Array, line_input: Array, period_s: float, *, odd_lines: bool) -> Array:
    """Relative std (n,) of |G| on planned lines (n,) that distortion leaves; zero where the first record shows none.

    `line_input` (n,) is the amplitude of the plant's input at each line, the rest of it being silent.
    """
    first_s, power = first.recording.info.period_s, 0.5 * float(np.sum(line_input**2))
    if first_s is None or not first.input_caused > 0.0:
        return np.zeros(lines_hz.size)
    scale = np.sqrt(first_s / period_s * power) / first.input_caused
    return _at_input(first, lines_hz, odd_lines) * scale / line_input / np.sqrt(2.0)


def own_floor(first: FirstRecord, *, odd_lines: bool) -> Array:
    """The same (nf,) of the first record itself, in its valid band."""
    found = first.distortion
    if found is None or found.excited is None:
        return np.zeros(first.frequency_hz.size)
    size = np.interp(np.log(first.frequency_hz), np.log(found.excited.frequency_hz), np.log(found.excited.amplitude))
    line_input = np.exp(size) / np.abs(first.plant)
    return _at_input(first, first.frequency_hz, odd_lines) / line_input / np.sqrt(2.0)


def _at_input(first: FirstRecord, f: Array, odd_lines: bool) -> Array:
    """Amplitude (n,) of a line of the first record's distortion, as if it came in at the plant's input.

    By octaves; one without silent lines takes its nearest neighbour's. On odd lines only odd distortion falls.
    """
    found = first.distortion
    middles, levels = [], []
    for band in found.bands if found is not None else ():
        kinds = [found.odd] if odd_lines else [found.odd, found.even]  # type: ignore[union-attr]
        here = [x for kind in kinds if kind and (x := _level(first, kind.between(*band.band_hz))) is not None]
        if here:
            middles.append(np.log(np.prod(band.band_hz)) / 2.0)
            levels.append(float(np.sqrt(np.sum(np.square(here)))))
    if not middles:
        return np.zeros(f.size)
    return np.array(levels)[np.abs(np.log(f)[:, None] - np.array(middles)).argmin(axis=1)]


def _level(first: FirstRecord, silent: Lines) -> float | None:
    """Rms amplitude of silent lines over |G|; 0 where it is no more than noise, None without lines.

    The noise is that of neighbouring lines and all periods, so that a single line can exceed it.
    """
    found, period_s = first.distortion, first.recording.info.period_s
    if found is None or period_s is None or not silent.amplitude.size:
        return None
    f, near = silent.frequency_hz, (np.log(silent.frequency_hz), np.log(first.frequency_hz))
    size = np.abs(between(f, first.frequency_hz, first.plant)) ** 2
    noise = 2.0 * np.exp(np.interp(*near, np.log(first.noise))) / (period_s * found.periods)
    clear = float(np.mean(silent.amplitude**2 / size) / np.mean(noise / size)) if np.all(noise > 0.0) else np.inf
    freedom = 2.0 * float(np.interp(*near, first.averages).mean())
    if fdtrc(2 * f.size, freedom, clear) >= TOL.distortion_by_chance:
        return 0.0
    return float(np.sqrt(max(float(np.mean((silent.amplitude**2 - noise) / size)), 0.0)))
