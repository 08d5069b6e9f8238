"""Multisines: a few sines, of equal amplitude or as asked, for as many periods as asked, with a low peak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.toolbox.rig.excitation.excitation import (
    MOST_SAMPLES,
    check_band,
    check_below_half_rate,
    check_positive,
    repeated,
    samples,
)

#: most turns of one multisine; each costs a transform per iteration
MOST_TURNS = 64
MOST_ITERATIONS = 10_000


@dataclass(frozen=True)
class Multisine:
    """Random-phase multisine of low crest factor: `periods` periods of chosen lines, seeded.

    `lines_hz` must be multiples of 1/period_s; None takes every line in the band, or the odd ones.
    Phases are the best of random draws and clipping iterations (van der Ouderaa 1988): the crest factor
    comes to about 1.5-1.8. Leading ramp `ramp_s` lies before the first whole period.

    `turn`, in cycles, is added to the phase of every line after that; 0.5 is an exact change of sign. `turns`
    is of how many equal turns (0, 1/turns, 2/turns, ...) the multisine is one: they have the same amplitude at
    every line, and `amplitude` is the largest peak of them all. More than two turns cost crest factor (about 2.1).
    Refuses a turn that is not one of them (its peak would be unknown), and more than 64 turns.

    `levels` are amplitudes of the lines in rising order, to each other: `amplitude` stays the peak of their sum. Empty
    for equal ones. Refuses another number of levels than lines, and levels that are not positive.
    """

    f_low_hz: float
    f_high_hz: float
    period_s: float
    amplitude: float
    periods: int = 4
    seed: int = 0
    odd: bool = False
    ramp_s: float = 1.0
    lines_hz: tuple[float, ...] | None = None
    crest_iterations: int = 60
    turn: float = 0.0
    turns: int = 2
    levels: tuple[float, ...] = ()
    kind: str = "multisine"

    def __post_init__(self) -> None:
        check_band(self.kind, self.f_low_hz, self.f_high_hz)
        check_positive(
            self.kind, period_s=self.period_s, amplitude=self.amplitude, periods=self.periods, turns=self.turns
        )
        steps = self.turn * self.turns
        if not (np.isfinite(steps) and abs(steps - round(steps)) < 1e-9 and self.turns <= MOST_TURNS):
            raise WrongUseError(
                f"a multisine's turn is a whole multiple of 1/turns cycles, of {MOST_TURNS} turns at most",
                f"turn = {self.turn!r} and turns = {self.turns!r}",
                "0.5 changes the sign; for another turn give turns, for example turn = 0.25 and turns = 4",
            )

        self._check_sizes()
        if self.levels:
            self._check_levels()

    def _check_sizes(self) -> None:
        """Refuse numbers that would take hours or fill the memory, before they are used."""
        count = self.f_high_hz * self.period_s if self.lines_hz is None else len(self.lines_hz)
        if count > MOST_SAMPLES or self.crest_iterations > MOST_ITERATIONS:
            raise WrongUseError(
                f"a multisine has {MOST_SAMPLES:g} lines and {MOST_ITERATIONS} crest_iterations at most",
                f"{count:.3g} lines, {self.crest_iterations:g} iterations",
                "lower its highest frequency, its period, or the iterations",
            )

    def _check_levels(self) -> None:
        count = self.lines().size
        if len(self.levels) != count or not all(np.isfinite(level) and level > 0.0 for level in self.levels):
            raise WrongUseError(
                f"a multisine of {count} lines has as many levels, all positive",
                f"{len(self.levels)} levels" + (f", the least {min(self.levels):g}" if self.levels else ""),
                "give one for each frequency in rising order, or none for equal ones",
            )

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest line."""
        lines = self.lines()
        return float(lines[0]), float(lines[-1])

    @property
    def duration_s(self) -> float:
        """Both ramps and the whole periods."""
        return 2.0 * self.ramp_s + self.periods * self.period_s

    def lines(self) -> Array:
        """Excited frequencies in Hz."""
        if self.lines_hz is None:
            k = np.arange(
                np.ceil(self.f_low_hz * self.period_s - 1e-9),
                np.floor(self.f_high_hz * self.period_s + 1e-9) + 1,
            )
            k = k[k % 2 == 1] if self.odd else k
        else:
            k = np.asarray(self.lines_hz, dtype=float) * self.period_s
        if not k.size or np.any(np.abs(k - np.round(k)) > 1e-6) or k.min() < 1:
            raise WrongUseError(
                f"a multisine's frequencies are whole multiples of {1.0 / self.period_s:g} Hz",
                f"{self.lines_hz or (self.f_low_hz, self.f_high_hz)}",
                "choose frequencies on that grid or another period",
            )
        return np.unique(np.round(k)) / self.period_s

    def signal(self, rate_hz: float) -> Array:
        """The multisine, (n,): ramp in, whole periods, ramp out; its peak is at most `amplitude` (see `turns`)."""
        lines = self.lines()
        check_below_half_rate(self.kind, float(lines[-1]), rate_hz)
        n = samples(self.period_s, rate_hz)
        bins = tuple(np.round(lines * self.period_s).astype(int).tolist())
        spectrum, peak = _low_crest(bins, tuple(self.levels), n, self.seed, self.crest_iterations, self.turns)
        one = _turned(spectrum, self.turn, n) / peak
        return self.amplitude * repeated(one, self.periods, self.ramp_s, rate_hz)


def _turned(spectrum: ComplexArray, turn: float, n: int) -> Array:
    """One period (n,) of a spectrum (n // 2 + 1,) whose lines are advanced by `turn` cycles; 0.5 is exactly -1."""
    part = turn % 1.0
    if part in (0.0, 0.5):
        return np.asarray((1.0 - 4.0 * part) * np.fft.irfft(spectrum, n))
    return np.asarray(np.fft.irfft(np.exp(1j * TWO_PI * part) * spectrum, n))


@lru_cache(maxsize=16)  # the machines of a campaign are excited alike
def _low_crest(
    lines: tuple[int, ...], levels: tuple[float, ...], n: int, seed: int, iterations: int, turns: int
) -> tuple[ComplexArray, float]:
    """Spectrum (n // 2 + 1,) of `levels` in bins, its phases iterated towards a low crest, and its signals' peak.

    The peak is the largest of all signals that its `turns` give; those half a cycle apart have the same.
    """
    rng = np.random.default_rng(seed)
    bins, sizes = np.array(lines), np.asarray(levels or 1.0)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[bins] = sizes * np.exp(1j * TWO_PI * rng.random(bins.size))
    unlike = [k / turns for k in range(turns // 2 if turns % 2 == 0 else turns)]
    signals = [_turned(spectrum, turn, n) for turn in unlike]
    best, best_peak = spectrum.copy(), _peak(signals)
    for k in range(iterations):
        level = _peak(signals) * (0.75 + 0.2 * k / max(iterations, 1))
        spectrum[bins] = sizes * np.exp(1j * np.angle(_clipped(signals, unlike, level)[bins]))
        signals = [_turned(spectrum, turn, n) for turn in unlike]
        peak = _peak(signals)
        if peak < best_peak:
            best, best_peak = spectrum.copy(), peak
    best.setflags(write=False)
    return best, best_peak


def _peak(signals: Sequence[Array]) -> float:
    return max(float(np.abs(x).max()) for x in signals)


def _clipped(signals: Sequence[Array], turns: Sequence[float], level: float) -> ComplexArray:
    """Sum of the spectra of signals clipped at a level, each turned back."""
    back = [
        np.exp(-1j * TWO_PI * turn) * np.fft.rfft(np.clip(x, -level, level))
        for x, turn in zip(signals, turns, strict=True)
    ]
    return np.asarray(np.sum(back, axis=0))
