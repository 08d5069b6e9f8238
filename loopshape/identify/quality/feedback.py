"""The direct estimator's signals, what the injected signal says of feedback around them, and where only -1/C is seen.

Under feedback z = C (r - y) the plant input u and w = u + C y, the part of it that the loop did not make, tell by their
coherence which share rho of u is noise that goes round the loop; the direct estimate Phi_yu/Phi_uu is then
P - rho (P + 1/C) (van den Hof and Schrama 1993; Pintelon and Schoukens 2012, 2.6).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import grey_closing, median_filter, uniform_filter1d

from loopshape.core.errors import BadSignalError
from loopshape.core.stretches import Signal
from loopshape.core.units import Array, ComplexArray, db
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf_arrays import KNOWN
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers, plant_of
from loopshape.identify.respond import respond
from loopshape.identify.settings import Settings
from loopshape.identify.signals import LoopSignals, has_instrument, read_signals
from loopshape.identify.spectra.averages import against_instrument
from loopshape.identify.spectra.transforms import transform
from loopshape.identify.tolerances import TOL


def direct_signals(
    recording: Recording, loop: LoopSetup, settings: Settings
) -> tuple[LoopSignals[Signal], tuple[str, ...]]:
    """Signals with the plant's input as its own instrument, and a warning where there is feedback."""
    if has_instrument(recording, loop):
        s = read_signals(recording, loop)
        return replace(s, instrument=s.u), _feedback_note(recording, loop, s, settings) if s.feedback else ()
    opened = Recording(replace(recording.info, closed_loop=False), recording.rate_hz, recording.columns)
    return read_signals(opened, loop), (BIASED,)


#: what can be said of every direct estimate under feedback
BIASED = "direct estimator in closed loop: biased towards -1/C where noise outweighs the excitation"


def _feedback_note(
    recording: Recording, loop: LoopSetup, s: LoopSignals[Signal], settings: Settings
) -> tuple[str, ...]:
    """The warning, with how far the plant's input answers the injected signal otherwise than without feedback."""
    at_plant = recording.info.injection == "plant_input"
    if loop.controller is None and not at_plant:
        return (BIASED,)
    t = transform(recording, [np.asarray(s.u)], np.asarray(s.instrument), settings)
    rows = np.flatnonzero(t.excited & (t.frequency_hz < 0.45 * recording.rate_hz))
    f = t.frequency_hz[rows]
    alone = np.ones(f.size) if at_plant or loop.controller is None else loop.controller.response(f)
    change = db(against_instrument(t)[rows, 0] / alone)
    worst = int(np.argmax(np.abs(change)))
    return (f"{BIASED}; feedback changes what reaches the plant by {change[worst]:+.1f} dB at {f[worst]:.3g} Hz",)


def biased_lines(
    recording: Recording, loop: LoopSetup, settings: Settings, a: Answers, G: ComplexArray, variance: Array
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Lines (nf,) on which a direct estimate G (nf,) under feedback is or may be biased by more than 10 %, and why.

    Told by the external signal where one was recorded, else by the loop's own controller; by neither, none is known.
    """
    f = a.frequency_hz
    if not recording.info.closed_loop:
        return np.zeros(f.size, dtype=bool), ()
    if has_instrument(recording, loop):
        found, why = unconfirmed_lines(recording, loop, settings, f, G, variance), _UNCONFIRMED
        if loop.controller is not None:
            found |= _near_inverse(G, variance, loop.controller.response(f)) <= 1.0
    elif loop.controller is not None:
        found, why = controller_lines(a, G, variance, loop.controller), _INVERSE
    else:
        return np.zeros(f.size, dtype=bool), ()
    return found, controller_note(f, found & (variance <= (KNOWN * np.abs(G)) ** 2), why)


def controller_lines(a: Answers, G: ComplexArray, variance: Array, controller: Controller) -> np.ndarray:
    """Lines (nf,) whose direct estimate G (nf,) is -1/C within its uncertainty, or nearer to it than 10 % allows.

    `a` holds the cross-powers of output and plant input. The bias rho (P + 1/C) is rho/(1 - rho) (G + 1/C); medians of
    nine lines decide. Overrated, which is on the safe side, where the logged control is not what C made of the error
    (saturation, coarse converters, another C).
    """
    C = controller.response(a.frequency_hz)
    yy, uu, yu = a.power[:, 0, 0].real, a.power[:, 1, 1].real, a.power[:, 0, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        apart, equal = np.abs(G + 1.0 / C), _near_inverse(G, variance, C)
        ww, wu = uu + np.abs(C) ** 2 * yy + 2.0 * np.real(C * yu), np.abs(uu + C * yu) ** 2
        noise = np.maximum(ww * uu / wu - 1.0, 0.0) / (a.averages if a.power_per == "line" else 1.0)
        bias = noise * apart / (KNOWN * np.abs(G))
    bias = median_filter(np.nan_to_num(bias, nan=0.0, posinf=1e9), 9, mode="nearest")
    found = ((equal <= 1.0) | (bias > 1.0)).astype(np.uint8)
    return np.asarray(grey_closing(found, (TOL.island_lines,), mode="nearest") > 0)


def _near_inverse(G: ComplexArray, variance: Array, C: ComplexArray) -> Array:
    """How far G (nf,) of this variance is from -1/C, by the median of nine: up to 1 it is -1/C within its uncertainty
    or 10 %."""
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(G + 1.0 / C)
        near = np.minimum(apart**2 / (TOL.equal_variances * variance), apart / (KNOWN * np.abs(G)))
    return np.asarray(median_filter(np.nan_to_num(near, nan=0.0, posinf=1e9), 9, mode="nearest"))


def unconfirmed_lines(
    recording: Recording, loop: LoopSetup, settings: Settings, frequency_hz: Array, G: ComplexArray, variance: Array
) -> np.ndarray:
    """Lines (nf,) whose direct estimate G (nf,) of this variance what answers the external signal does not confirm.

    On such a line the reference estimate, which feedback does not bias, is off by more than 10 % in the mean of nine
    lines or by itself beyond noise: rho (P + 1/C) is measured, whatever C is. Or loop noise exceeds the external signal
    there, or the signal feeds no such line: then rho is near 1. Where rho/|T| is below 10 % both estimates are equally
    precise, so hardly a line is lost. A second external signal counts as noise.
    """
    s = read_signals(recording, loop)
    try:
        a = respond(recording, [s.y, s.u], [s.instrument], 1, settings)
    except BadSignalError:  # nothing of the external signal can be told apart
        return np.ones(frequency_hz.size, dtype=bool)
    plant = plant_of([a], 1)
    f, other, spread = a.frequency_hz, plant.response[:, 0, 0], plant.covariance[:, 0, 0].real
    rows = a.excited & np.isfinite(other) & np.isfinite(spread)
    if not rows.any() or min(f.size, frequency_hz.size) < 2:
        return np.ones(frequency_hz.size, dtype=bool)
    usable = np.zeros(f.size, dtype=bool)
    unsure = median_filter(np.sqrt(spread[rows]) / np.abs(other[rows]), TOL.alongside_lines, mode="nearest")
    usable[rows] = plant.sound(rows) & (unsure <= TOL.alongside_std)
    near = _nearest(f, frequency_hz)
    beside = np.abs(f[near] - frequency_hz) <= np.maximum(np.gradient(f)[near], np.gradient(frequency_hz))
    other = np.interp(frequency_hz, f[rows], other[rows])
    relative = np.sqrt(variance + np.interp(frequency_hz, f[rows], spread[rows])) / np.abs(other)
    known = usable[near] & beside
    apart = np.where(known, G / other - 1.0, 0.0)
    weight = np.maximum(uniform_filter1d(known.astype(float), TOL.alongside_lines, mode="nearest"), 1e-9)
    mean = np.abs([uniform_filter1d(x, TOL.alongside_lines, mode="nearest") for x in (apart.real, apart.imag)])
    off = np.hypot(*mean) / weight > KNOWN
    return np.asarray(~known | off | (np.abs(apart) > KNOWN + TOL.alone_std * relative))


def _nearest(grid: Array, wanted: Array) -> np.ndarray:
    """Places (n,) in a rising grid that are nearest to what is wanted (n,)."""
    above = np.clip(np.searchsorted(grid, wanted), 1, grid.size - 1)
    return np.asarray(above - (wanted - grid[above - 1] < grid[above] - wanted))


_INVERSE = "is -1/C of the loop's own controller within its uncertainty, or biased towards it by more than 10 %"
_UNCONFIRMED = "is biased towards -1/C of the loop's own controller by more than 10 %, or too little excited to tell"


def controller_note(frequency_hz: Array, lines: np.ndarray, why: str) -> tuple[str, ...]:
    """Which lines of a direct estimate are outside the valid band for this alone, and why; nothing where none are."""
    if not lines.any():
        return ()
    f = frequency_hz[lines]
    return (
        f"at {f.size} of {frequency_hz.size} frequencies, {f[0]:.3g} to {f[-1]:.3g} Hz, the direct estimate {why}:"
        " these frequencies are outside the valid band; use the reference estimator, or excite more",
    )
