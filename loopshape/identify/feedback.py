"""The direct estimator's signals, what the injected signal says of feedback around them, and where only -1/C is seen.

Under feedback z = C (r - y) the plant input u and w = u + C y, the part of it that the loop did not make, tell by their
coherence which share rho of u is noise that goes round the loop; the direct estimate Phi_yu/Phi_uu is then
P - rho (P + 1/C) (van den Hof and Schrama 1993; Pintelon and Schoukens 2012, 2.6).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import grey_closing, median_filter

from loopshape.core.stretches import Signal
from loopshape.core.units import Array, ComplexArray, db
from loopshape.data.controller import Controller
from loopshape.data.experiment import LoopSetup
from loopshape.data.recording import Recording
from loopshape.data.valid_band import KNOWN
from loopshape.identify.answers import Answers
from loopshape.identify.averages import against_instrument
from loopshape.identify.settings import Settings
from loopshape.identify.signals import LoopSignals, has_instrument, read_signals
from loopshape.identify.transforms import transform


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


#: squared distance, in variances, up to which an estimate counts as equal: F(0.95) with many degrees of freedom
EQUAL = 3.0
#: fewer lines than this between such lines, or beyond the last of them, are as doubtful
ISLAND = 25


def controller_lines(a: Answers, G: ComplexArray, variance: Array, controller: Controller) -> np.ndarray:
    """Lines (nf,) whose direct estimate G (nf,) is -1/C within its uncertainty, or nearer to it than 10 % allows.

    `a` holds the cross-powers of output and plant input. The bias rho (P + 1/C) is rho/(1 - rho) (G + 1/C); medians of
    nine lines decide. Overrated, which is on the safe side, where the logged control is not what C made of the error
    (saturation, coarse converters, another C).
    """
    C = controller.response(a.frequency_hz)
    yy, uu, yu = a.power[:, 0, 0].real, a.power[:, 1, 1].real, a.power[:, 0, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(G + 1.0 / C)
        ww, wu = uu + np.abs(C) ** 2 * yy + 2.0 * np.real(C * yu), np.abs(uu + C * yu) ** 2
        noise = np.maximum(ww * uu / wu - 1.0, 0.0) / (a.averages if a.power_per == "line" else 1.0)
        equal = np.minimum(apart**2 / (EQUAL * variance), apart / (KNOWN * np.abs(G)))
        bias = noise * apart / (KNOWN * np.abs(G))
    equal, bias = (median_filter(np.nan_to_num(x, nan=0.0, posinf=1e9), 9, mode="nearest") for x in (equal, bias))
    found = ((equal <= 1.0) | (bias > 1.0)).astype(np.uint8)
    return np.asarray(grey_closing(found, (ISLAND,), mode="nearest") > 0)


def controller_note(frequency_hz: Array, lines: np.ndarray) -> tuple[str, ...]:
    """Why lines of a direct estimate are outside the valid band; nothing where none are."""
    if not lines.any():
        return ()
    f = frequency_hz[lines]
    return (
        f"at {f.size} of {frequency_hz.size} frequencies, {f[0]:.3g} to {f[-1]:.3g} Hz, the direct estimate is -1/C of"
        " the loop's own controller within its uncertainty, or biased towards it by more than 10 %: these"
        " frequencies are outside the valid band; use the reference estimator, or excite more",
    )
