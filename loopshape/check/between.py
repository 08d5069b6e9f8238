"""How 1 + L turns between its lines: along curves, and past resonances that the lines step over."""

from __future__ import annotations

import numpy as np

from loopshape.check.crossings import chords_to_minus_one
from loopshape.check.sampling import SHARPEST, HiddenPole
from loopshape.controller import Controller
from loopshape.units import TWO_PI, Array, ComplexArray, hz

#: places along a path past a pole, in half widths of it: even on its circle, and on to where it is straight
_CIRCLE, _BEYOND = np.tan(np.linspace(-1.5, 1.5, 49)), np.geomspace(25.0, 4000.0, 8)
_ALONG = np.concatenate([-_BEYOND[::-1], _CIRCLE, _BEYOND])
#: places between two lines where a curve is followed, as shares of the logarithm of frequency
_SHARES = np.linspace(0.0, 1.0, 9)
#: L may leave its curve between lines by this much of what the lines leave theirs (a quarter for a parabola)
BULGE = 0.5
#: the path past a pole is followed over this many lines more on either side, where its tails bend
ASIDE = 2
#: resonances of the controller as wide as this many lines need no path of their own
_WIDE = 16


def turns_past(
    pole: HiddenPole, controller: Controller, f: Array, P: ComplexArray, L: ComplexArray
) -> tuple[int, int, int, int, bool]:
    """Lines `first`, `last` about a hidden pole, least and most whole turns that chords of 1 + L leave out of 1 + C P.

    Of all the poles that lines f (nf,) of P (nf,) allow; L (nf,) is C P, or what smoothing made of it. What is smooth
    of P runs straight between lines, and where it bends so much that the likeliest path might pass -1 on the other side
    the last answer is False.
    """
    first, last = _lines_about(f, pole.low_hz, pole.high_hz)
    first, last = max(first - ASIDE, 0), min(last + ASIDE, f.size - 1)
    own, P_own = f[first : last + 1], P[first : last + 1]
    z, r = (pole.centre_hz + 1j * pole.half_width_hz)[:, None], pole.residue[:, None]
    at = _path(own, z)
    smooth = P_own - r / (1j * (own - z))
    path = 1.0 + controller.response(at) * (r / (1j * (at - z)) + _straight(at, own, smooth))
    C = controller.response(own)
    turns = _left_out(path, 1.0 + L[first : last + 1])
    gap = np.clip(np.searchsorted(own, at[0, :-1], side="right") - 1, 0, own.size - 2)
    sure = bool(np.all(chords_to_minus_one(path[0] - 1.0)[0] > bulges(own, C * smooth[0])[gap]))
    return first, last, int(turns.min()), int(turns.max()), sure


def turns_of_controller(controller: Controller, f: Array, P: ComplexArray) -> list[tuple[int, int, int]]:
    """Lines `first`, `last` and whole turns of 1 + C P that chords leave out at resonances of the controller itself."""
    found = []
    for z in _poles(controller):
        first, last = _lines_about(f, z.real - 4.0 * z.imag, z.real + 4.0 * z.imag)
        if not f[0] < z.real < f[-1] or last - first > _WIDE:
            continue
        own, P_own = f[first : last + 1], P[first : last + 1]
        at = _path(own, np.array([[z]]))
        path = 1.0 + controller.response(at) * _straight(at, own, P_own[None, :])
        found.append((first, last, int(_left_out(path, 1.0 + controller.response(own) * P_own)[0])))
    return found


def _lines_about(f: Array, low_hz: float, high_hz: float) -> tuple[int, int]:
    first = int(np.clip(np.searchsorted(f, low_hz, side="right") - 1, 0, f.size - 2))
    return first, int(np.clip(np.searchsorted(f, high_hz, side="left"), first + 1, f.size - 1))


def _path(own: Array, z: ComplexArray) -> Array:
    """Frequencies (nz, n) in Hz along lines `own`, dense about each pole z (nz, 1)."""
    even = np.concatenate([own, np.linspace(own[0], own[-1], 4 * own.size)])
    every = np.concatenate([z.real + np.abs(z.imag) * _ALONG, np.broadcast_to(even, (z.shape[0], even.size))], axis=1)
    return np.sort(np.clip(every, own[0], own[-1]), axis=1)


def _straight(at: Array, own: Array, values: ComplexArray) -> ComplexArray:
    """Values (nz, lines) at lines `own`, straight between them, at (nz, n)."""
    k = np.clip(np.searchsorted(own, at, side="right") - 1, 0, own.size - 2)
    slope = np.diff(values) / np.diff(own)
    row = np.arange(len(values))[:, None]
    return np.asarray(values[row, k] + (at - own[k]) * slope[row, k])


def _left_out(path: ComplexArray, lines: ComplexArray) -> np.ndarray:
    """Whole turns (nz,) of paths (nz, n) over those of the chords between lines."""
    return np.rint((turn(path) - turn(lines)) / TWO_PI).astype(int)


def turn(path: ComplexArray) -> Array:
    """Angle in rad that a path (..., n) turns about zero, at most half a turn a step."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sum(np.nan_to_num(np.angle(path[..., 1:] / path[..., :-1])), axis=-1))


def _poles(controller: Controller) -> list[complex]:
    """Complex poles of the controller as it runs, as centre + j half width in Hz."""
    found = []
    for *_, a1, a2 in controller.biquads():
        for z in np.roots([1.0, a1, a2]):
            if z.imag > 0.0:
                s = controller.rate_hz * np.log(z)
                centre = hz(s.imag)
                found.append(complex(centre, max(hz(abs(s.real)), SHARPEST * centre)))
    return found


def curved(L: ComplexArray) -> ComplexArray:
    """L (nf,) between its lines as a power of f, which integrators and delays are: (nf - 1, places), ends included."""
    with np.errstate(divide="ignore", invalid="ignore"):
        path = L[:-1, None] * (L[1:] / L[:-1])[:, None] ** _SHARES
    straight = L[:-1, None] + _SHARES * (L[1:] - L[:-1])[:, None]
    path = np.where(np.isfinite(path), path, straight)
    path[:, 0], path[:, -1] = L[:-1], L[1:]
    return np.asarray(path)


def curves_of(controller: Controller, f: Array, P: ComplexArray) -> ComplexArray:
    """C P between lines f (nf,): P (nf,) along such curves, the controller as it is: (nf - 1, places)."""
    at = f[:-1, None] * (f[1:] / f[:-1])[:, None] ** _SHARES
    C = controller.response(at.ravel()).reshape(at.shape)
    C[:, 0], C[:, -1] = (own := controller.response(f))[:-1], own[1:]
    return np.asarray(C * curved(P))


def turns_of_curves(curves: ComplexArray) -> np.ndarray:
    """Whole turns (nf - 1,) of 1 + L along curves (nf - 1, places) that the chords between their ends leave out."""
    return np.rint((turn(1.0 + curves) - turn(1.0 + curves[:, [0, -1]])) / TWO_PI).astype(int)


def bulges(f: Array, L: ComplexArray) -> Array:
    """How far L may leave such curves between lines, (nf - 1,), by how far lines leave those of their neighbours."""
    if f.size < 3:
        return np.zeros(f.size - 1)
    ln_f = np.log(f)
    share = (ln_f[1:-1] - ln_f[:-2]) / (ln_f[2:] - ln_f[:-2])
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(L[1:-1] - L[:-2] * (L[2:] / L[:-2]) ** share)
    off = np.nan_to_num(np.concatenate([off[:1], off, off[-1:]]), posinf=0.0)
    return np.asarray(BULGE * np.maximum(off[1:], off[:-1]))
