"""Which lines an experiment excites: a period long enough for the resonances, lines no denser than that, and levels."""

from __future__ import annotations

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.toolbox.planning.plan_record import FirstRecord

KINDS = ("odd", "log", "all")
#: from line to line a response may change by this much (natural logarithm): four lines within the half-power width
CHANGE = 0.5
#: periods in s are these times a power of ten
_ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


def crossovers_hz(f: Array, L: ComplexArray) -> Array:
    """Where |L| (nf,) falls through 1, in Hz; between lines ln |L| is linear in ln f."""
    size = np.log(np.abs(L))
    k = np.flatnonzero((size[:-1] >= 0.0) & (size[1:] < 0.0))
    share = size[k] / (size[k] - size[k + 1])
    return np.asarray(f[k] * (f[k + 1] / f[k]) ** share)


def crossover_of(first: FirstRecord, controller: Controller | None, at_hz: float | None) -> float:
    """The frequency of the required accuracy: `at_hz`, or the highest crossover of C G, which the record must have."""
    f, loop = first.frequency_hz, first.loop.name
    band = f"{f[0]:.3g} to {f[-1]:.3g} Hz are known to 10 % or so"
    if at_hz is not None:
        if not f[0] <= at_hz <= f[-1]:
            raise WrongUseError(
                "the first recording does not know the response where it is wanted",
                f"{at_hz:g} Hz; {band}",
                "ask within that band, or record a first one that excites there",
            )
        return float(at_hz)
    if controller is None:
        raise WrongUseError(
            f"the controller of loop {loop} is not known, so neither is its crossover",
            "no controller in run.toml",
            "say where: --at HZ, or give a controller file",
        )
    below = f < 0.5 * controller.rate_hz
    found = crossovers_hz(f[below], controller.response(f[below]) * first.plant[below])
    if not found.size:
        raise WrongUseError(
            f"loop {loop} has no crossover where the first recording is sure",
            band,
            "say where the accuracy is wanted: --at HZ, or excite about the crossover first",
        )
    return float(found[-1])


def needed_spacing_hz(f: Array, response: ComplexArray, std: Array) -> Array:
    """Distance (nf,) in Hz over which a response (nf,) changes by `CHANGE`, noise of relative `std` (nf,) allowed for.

    About a resonance that is a quarter of its half-power width; at most f itself. A resonance sharper than the lines
    is rounded off in the first record, and its width comes out too large.
    """
    log = np.log(np.abs(response)) + 1j * np.unwrap(np.angle(response))
    need = np.array(f, dtype=float)
    open_ = np.ones(f.size, dtype=bool)
    for step in range(1, f.size):
        apart = f[step:] - f[:-step]
        if not (open_[:-step] | open_[step:]).any() or np.all(apart > f[:-step]):
            break
        change = np.abs(log[step:] - log[:-step])
        allowed = CHANGE + 3.0 * np.sqrt(2.0) * np.hypot(std[step:], std[:-step])
        for rows in (slice(None, -step), slice(step, None)):
            hit = open_[rows] & (change > allowed)
            need[rows] = np.where(hit, np.minimum(need[rows], apart * CHANGE / np.maximum(change, CHANGE)), need[rows])
            open_[rows] &= ~hit
    return need


def round_period_s(least_s: float, rate_hz: float) -> float:
    """A round period of at least `least_s`, whole samples long."""
    power = 10.0 ** np.floor(np.log10(least_s))
    wanted = next(p * power for p in _ROUND if p * power >= least_s * (1.0 - 1e-9))
    return float(np.ceil(wanted * rate_hz - 1e-6) / rate_hz)


def chosen_lines(
    period_s: float, band_hz: tuple[float, float], spacing_hz: tuple[Array, Array], per_octave: float, kind: str
) -> Array:
    """Lines (n,) in Hz on a period's grid: each within reach of the last, by octaves or closer where G asks for it.

    `spacing_hz` are frequencies and the distance needed there. `odd` takes odd multiples of 1/period and leaves out one
    in four, so that odd and even distortion can be told from the response; `all` takes every one.
    """
    low, high = np.ceil(band_hz[0] * period_s - 1e-9), np.floor(band_hz[1] * period_s + 1e-9)
    k = np.arange(max(low, 1.0), high + 1.0)
    if kind == "odd":
        k = k[(k % 2 == 1) & (k % 8 != 7)]
    f = k / period_s
    if kind == "all" or f.size < 2:
        return f
    wanted = np.minimum(f * (2.0 ** (1.0 / per_octave) - 1.0), np.interp(f, *spacing_hz))
    kept = [0]
    while kept[-1] < f.size - 1:
        farthest = int(np.searchsorted(f, f[kept[-1]] + wanted[kept[-1]] * (1.0 + 1e-9), side="right")) - 1
        kept.append(max(farthest, kept[-1] + 1))
    return f[kept]


def with_line_near(lines_hz: Array, at_hz: float, period_s: float, kind: str) -> Array:
    """The lines and the one of the grid that lies nearest to a frequency, in place of its nearest neighbour."""
    k = np.arange(max(1.0, np.floor(at_hz * period_s) - 3.0), np.ceil(at_hz * period_s) + 4.0)
    if kind == "odd":
        k = k[(k % 2 == 1) & (k % 8 != 7)]
    nearest = k[np.argmin(np.abs(k / period_s - at_hz))] / period_s
    return np.unique(np.round(np.append(lines_hz, nearest) * period_s)) / period_s


def levels_of(need: Array, crossover: int, ratio: float) -> Array:
    """Amplitudes (n,) to each other, 1 at the crossover's line, that know all lines equally well where they may.

    `need` (n,) is the power that a line needs for some accuracy. The largest is at most `ratio` times the least.
    """
    farthest = np.sqrt(ratio)
    return np.asarray(np.clip(np.sqrt(need / need[crossover]), 1.0 / farthest, farthest))
