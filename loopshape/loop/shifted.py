"""A loop whose plant's resonances have moved: its lines, what margins and count read from them, and how sure they are.

The whole axis: P'(f) = P(f/(1 + d)) is known on the plant's own frequencies times 1 + d, and the controller anywhere.
One resonance: its pole pair, from a local fit, is taken out of P and put back moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.kernels.loops import margins as kernel
from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.data.response.smoothed import Dense, Scatter
from loopshape.identify.smooth.resonances import Phase, Resonance, resonances
from loopshape.loop.loop import Loop
from loopshape.loop.margin.between import interpolated
from loopshape.loop.margin.margins import Reader
from loopshape.loop.stability.low_end import BELOW_RATIOS, in_sight, is_large, low_models, poles_at_0
from loopshape.loop.stability.stability import count_unstable, swing_near
from loopshape.loop.tolerances import TOL

#: a resonance narrower than so many gaps between lines is followed between them, at these places in half widths
NARROW, PLACES = 1.0, np.tan(np.linspace(-1.4, 1.4, 21))
#: resonances whose peak of |L|, with the controller at the best of these shifts, stays below this matter to nobody
MATTERS, NEAR = 0.1, np.array([-0.05, -0.02, 0.0, 0.02, 0.05])


@dataclass(frozen=True, eq=False)
class ShiftedColumns:
    """Margins (columns,) of the kernel, where they lie, unstable poles by the bare count (None: it does not close).

    `clear` is the least distance of L from -1 over the deviation of L there.
    """

    values: Array
    at_hz: Array
    poles: int | None
    clear: float


@dataclass(frozen=True, eq=False)
class Plant:
    """Lines f (nf,) in Hz and P (nf,) that margins are read from, with the deviation (nf,) of P.

    `interpolated` are resonances narrower than the lines. `below_hz` and `P_below` (nb,) lead below the first line,
    `above_hz` above the last. `ahead_of` of the lines lie before the first one that was measured.
    `errors` (draws, n) are of n lines, of which f are the `at` (nf,)-th and a `share` (nf,) of the way to the next.
    """

    f: Array
    P: ComplexArray
    std: Array
    errors: ComplexArray | None
    below_hz: Array
    P_below: ComplexArray
    above_hz: Array
    interpolated: tuple[Resonance, ...] = ()
    at: np.ndarray | None = None
    share: Array | None = None
    ahead_of: int = 0

    @property
    def draws(self) -> ComplexArray | None:
        """Draws (draws, nf) of the error of P."""
        if self.errors is None or self.at is None or self.share is None:
            return self.errors
        return _between(self.errors, self.at, self.share)

    def stretched(self, shift: float) -> Plant:
        """The plant with its whole frequency axis stretched by 1 + shift, lines and all."""
        above = self.above_hz * (1.0 + shift)
        if above.size:
            above = np.append(above, self.above_hz[self.above_hz > above[-1]])
        return replace(self, f=self.f * (1.0 + shift), below_hz=self.below_hz * (1.0 + shift), above_hz=above)

    def dense(self) -> Plant:
        """The plant on more lines, about its narrow resonances."""
        return self._dense(self.interpolated, 0.0, None)

    def with_moved(self, one: Resonance, shift: float) -> Plant:
        """The plant with one of its resonances shifted alone, on lines dense about the narrow ones."""
        taken = self.interpolated if one in self.interpolated else (*self.interpolated, one)
        change = one.response(self.below_hz, shift) - one.response(self.below_hz)
        return replace(self._dense(taken, shift, one), P_below=self.P_below + change)

    def _dense(self, taken: Sequence[Resonance], shift: float, one: Resonance | None) -> Plant:
        """P with resonances taken out, straight between lines, and put back, `one` shifted; dense about narrow ones."""
        if not taken:
            return self
        shifts = [shift if x is one else 0.0 for x in taken]
        places = [
            (1.0 + s) * (x.frequency_hz + abs(x.pole_hz.imag) * PLACES)
            for x, s in zip(taken, shifts, strict=True)
            if x in self.interpolated
        ]
        f = np.unique(np.concatenate([self.f, *places]))
        f = f[(f >= self.f[0]) & (f <= self.f[-1])]
        k = np.clip(np.searchsorted(self.f, f, side="right") - 1, 0, self.f.size - 2)
        share = (f - self.f[k]) / (self.f[k + 1] - self.f[k])
        rest = self.P - sum(x.response(self.f) for x in taken)
        P = _between(rest, k, share) + sum(x.response(f, s) for x, s in zip(taken, shifts, strict=True))
        return replace(self, f=f, P=P, std=_between(self.std, k, share), at=k, share=share)


def _between(values: np.ndarray, k: np.ndarray, share: Array) -> np.ndarray:
    return np.asarray(values[..., k] * (1.0 - share) + values[..., k + 1] * share)


def stretched(loop: Loop, percent: float, name: str) -> Loop:
    """The loop with its plant's whole frequency axis stretched, as a plant of its own, of recording `name`.

    Lines that come to lie at half the rate or above are left out.
    """
    shift, half_hz = 0.01 * percent, 0.499 * loop.controller.rate_hz

    def moved(frf: FRF) -> FRF:
        kept = frf.select(frf.frequency_hz * (1.0 + shift) < half_hz)
        return replace(kept, frequency_hz=kept.frequency_hz * (1.0 + shift), recording=name)

    lines = loop.frequency_hz * (1.0 + shift) < half_hz
    scatter, beyond = loop.scatter, loop.beyond
    if scatter is not None:
        scatter = Scatter(
            scatter.reference[lines], scatter.deviations[:, lines], _moved(scatter.dense, shift, half_hz),
            scatter.pole_hz * (1.0 + shift), scatter.residue * (1.0 + shift),
        )  # fmt: skip
    if beyond is not None:
        beyond = moved(beyond) if beyond.frequency_hz[0] * (1.0 + shift) < half_hz else None
    return replace(
        loop,
        plant=moved(loop.plant),
        model=None if loop.model is None else loop.model.stretched(shift),
        beyond=beyond,
        raw=None if loop.raw is None else moved(loop.raw),
        scatter=scatter,
    )


def _moved(dense: Dense | None, shift: float, half_hz: float) -> Dense | None:
    if dense is None:
        return None
    f = dense.frequency_hz * (1.0 + shift)
    kept = f < half_hz
    return Dense(f[kept], dense.response[kept], dense.reference[kept], dense.deviations[:, kept])


def plant_of(loop: Loop, seen: Sequence[Resonance]) -> Plant:
    """The plant of a loop on the places that its margins are read from.

    Of those `seen` narrow ones are followed, where the loop's smoothing did not do so.
    """
    f, P, std, draws = loop.frequency_hz, loop.plant.siso, np.sqrt(loop.plant.variance[:, 0, 0]), None
    narrow: list[Resonance] = []
    if loop.scatter is None:
        after = np.clip(np.searchsorted(f, [x.frequency_hz for x in seen]), 1, f.size - 1)
        narrow = [x for x, k in zip(seen, after, strict=True) if abs(x.pole_hz.imag) < NARROW * (f[k] - f[k - 1])]
    else:
        dense, _ = interpolated(loop)
        f, P, draws = dense.frequency_hz, dense.response, dense.deviations[: TOL.shifted_draws]
        std = np.interp(f, loop.frequency_hz, std)
    ahead_of = 0  # as margins of the unmoved loop have it: what a bound there hides is no bias
    for model in low_models(loop)[:1] if not is_large(loop) and in_sight(loop) else ():
        below = float(f[0]) * BELOW_RATIOS[poles_at_0(loop) > 0 :]  # down to 0 Hz where L is finite there
        ahead = model.response(below)
        std = np.concatenate([std[0] * np.abs(ahead / P[0]), std])
        draws = None if draws is None else np.concatenate([ahead / P[0] * draws[:, :1], draws], axis=1)
        f, P, ahead_of = np.concatenate([below, f]), np.concatenate([ahead, P]), below.size
    return Plant(f, P, std, draws, loop.below_hz, loop.P_below, loop.above_hz, tuple(narrow), ahead_of=ahead_of)


def seen_resonances(loop: Loop) -> tuple[Resonance, ...]:
    """Resonances of a loop's plant, as measured, whose damping is known and whose peak matters to L."""
    raw = loop.measured
    half = 0.5 * loop.controller.rate_hz / (1.0 + NEAR[-1])
    found = [x for x in resonances(raw) if x.frequency_hz < half and x.phase is not Phase.UNKNOWN]
    if not found:
        return ()
    C = np.abs(loop.controller.response(np.outer([x.frequency_hz for x in found], 1.0 + NEAR).ravel()))
    largest = C.reshape(len(found), NEAR.size).max(axis=1)
    return tuple(x for x, c in zip(found, largest, strict=True) if c * x.peak > MATTERS)


def read(loop: Loop, plant: Plant, reader: Reader) -> ShiftedColumns:
    """What a loop's margins and count are with its plant as it stands moved."""
    lines, C_below = _lines(loop, plant)
    f, C = lines.f, lines.C
    L = C * plant.P[: f.size]
    found, at = reader.read(L[None], lines, least=loop.largest_above)
    with np.errstate(divide="ignore"):
        clear = float(np.min(np.abs(1.0 + L) / (np.abs(C) * plant.std[: f.size])))
    integrators = (loop.integrators or 0) + loop.controller.integrators()
    near = 0.0 if plant.P_below.size else swing_near(loop)
    counted = L[plant.ahead_of :] if abs(L[plant.ahead_of]) >= 1.0 else L  # it says how L starts by its first value
    poles = count_unstable(counted, integrators, loop.unstable_poles or 0, C_below * plant.P_below, near)
    return ShiftedColumns(found[0], at[0], poles, clear)


def scatter_of(loop: Loop, plant: Plant, reader: Reader, reading: ShiftedColumns) -> tuple[Array, Array]:
    """Bias and half 95 % interval (columns,) of a reading, by draws of the plant's error; infinite where one jumps."""
    draws = plant.draws
    if draws is None:
        return np.zeros(kernel.COLUMNS), np.zeros(kernel.COLUMNS)
    lines, _ = _lines(loop, plant)
    n = lines.f.size
    drawn, _ = reader.read(lines.C * (plant.P[:n] + draws[:, :n]), lines, least=loop.largest_above)
    known = np.isfinite(drawn).all(axis=0) & np.isfinite(reading.values)
    off = np.where(known, drawn, 0.0) - np.where(known, reading.values, 0.0)
    return off.mean(axis=0), np.where(known, TOL.half_width_shifted_std * off.std(axis=0), np.inf)


def _lines(loop: Loop, plant: Plant) -> tuple[kernel.Lines, ComplexArray]:
    """Lines below half the rate and above them with C there, and C below the first line."""
    rate_hz = loop.controller.rate_hz
    f = plant.f[plant.f < 0.499 * rate_hz]
    above = plant.above_hz[(plant.above_hz > f[-1]) & (plant.above_hz <= 0.45 * rate_hz)]
    C = loop.controller.response(np.concatenate([f, above, plant.below_hz]))
    lines = kernel.Lines(f, C[: f.size], above, C[f.size : f.size + above.size])
    return lines, C[f.size + above.size :]
