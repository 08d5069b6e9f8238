"""The cases: plants by formula, what a check answers, and the truth from the formula itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.loops import margins as kernel
from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.loop.margin.margins import Reader
from loopshape.loop.verdict import check

RATE_HZ, DRAWS = 20_000.0, 100
W8, W5 = TWO_PI * 8.0, TWO_PI * 5.0
Plant = Callable[[Array], ComplexArray]


class Row(NamedTuple):
    """What was asked, what was answered (a median and its interval, or a share), and the truth."""

    case: str
    noise: float
    quantity: str
    found: str
    truth: str
    right: bool


def own(*blocks: tuple[str, dict[str, float]], rate_hz: float = RATE_HZ) -> Controller:
    """A controller of the loop "x"."""
    return Controller("x", tuple(Block(kind, values) for kind, values in blocks), rate_hz)


def lines_of(plant: Plant, f: Array, noise: float, seed: int, rate_hz: float = RATE_HZ) -> FRF:
    """Lines with circular relative errors whose variance is known."""
    rng, exact = np.random.default_rng(seed), plant(f)
    error = (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2.0)
    G, variance = exact * (1.0 + noise * error), (noise * np.abs(exact)) ** 2
    known = np.ones(f.size, dtype=bool)
    return FRF(f, G[:, None, None], variance[:, None, None] + 0j, known, ("u",), ("y",), "known", "one", "x", rate_hz)


def levitated(f: Array) -> ComplexArray:
    """An unstable and a stable real pole at 8 Hz, 1 ms of delay."""
    s = 1j * TWO_PI * f
    return np.asarray(W8**2 / (s**2 - W8**2) * np.exp(-0.001 * s))


def growing(f: Array) -> ComplexArray:
    """A growing mode at 5 Hz, one sample of 1 ms."""
    s = 1j * TWO_PI * f
    return np.asarray(W5**2 / (s**2 - 0.2 * W5 * s + W5**2) * np.exp(-0.001 * s))


def falling(f: Array) -> ComplexArray:
    """An integrator, a lag at 20 Hz and 1 ms."""
    s = 1j * TWO_PI * f
    return np.asarray(40.0 * np.exp(-0.001 * s) / (s * (1.0 + s / (TWO_PI * 20.0))))


def _mode(s: ComplexArray, f_hz: float, damping: float) -> ComplexArray:
    w = TWO_PI * f_hz
    return np.asarray(w * w / (s * s + 2.0 * damping * w * s + w * w))


def several_crossings(f: Array) -> ComplexArray:
    """A mode of damping 0.015 at 31 Hz that crosses 0 dB again."""
    s = 1j * TWO_PI * f
    return np.asarray((40.0 / s / (1.0 + s / (TWO_PI * 60.0)) + 0.08 * _mode(s, 31.0, 0.015)) * np.exp(-0.001 * s))


def on_a_grid(f: Array) -> ComplexArray:
    """A mode of damping 0.01 at 20.05 Hz."""
    s = 1j * TWO_PI * f
    return np.asarray((30.0 / s + 0.02 * _mode(s, 20.05, 0.01)) * np.exp(-0.001 * s))


def sharper(f: Array) -> ComplexArray:
    """A mode of damping 0.004 at 31 Hz, narrower than the lines of a logarithmic grid."""
    s = 1j * TWO_PI * f
    return np.asarray((40.0 / s / (1.0 + s / (TWO_PI * 60.0)) + 0.012 * _mode(s, 31.0, 0.004)) * np.exp(-0.001 * s))


def zero_and_pole(f: Array) -> ComplexArray:
    """An anti-resonance at 29 Hz and a resonance of damping 0.01 at 33.3 Hz behind an integrator."""
    s = 1j * TWO_PI * f
    pair = _mode(s, 33.3, 0.01) / _mode(s, 29.0, 0.02)
    return np.asarray(50.0 / s / (1.0 + s / (TWO_PI * 40.0)) * pair * np.exp(-0.001 * s))


def at_0_hz() -> Iterator[Row]:
    """A gain reduction margin whose crossing lies below the lines, at 0 Hz, from both starts of the lines."""
    lead, truth = own(("gain", {"gain": 2.2}), ("lead_lag", {"f1_hz": 8.0, "f2_hz": 150.0})), 20.0 * np.log10(2.2)
    wish = Requirements("x", integrators=0, unstable_poles=1)
    for low_hz in (0.5, 5.0):
        for noise in (1e-6, 0.01):
            name = f"unstable plant from {low_hz:g} Hz"
            found = check([lines_of(levitated, np.geomspace(low_hz, 200.0, 400), noise, 1)], lead, wish).margins["one"]
            low, high = found.intervals["gain_reduction_margin_db"]
            words = f"{found.gain_reduction_margin_db:.2f} [{low:.2f}, {high:.2f}]"
            yield Row(name, noise, "gain_reduction_margin_db", words, f"{truth:.2f}", bool(low <= truth <= high))
            yield Row(name, noise, "closed loop", found.stable, "stable", found.stable == "stable")


def undeclared() -> Iterator[Row]:
    """A growing mode that nobody declared, and that was declared."""
    slow = own(("gain", {"gain": 3.0}), ("low_pass_1", {"f_hz": 6.0}), rate_hz=1000.0)
    frf = lines_of(growing, np.geomspace(0.3, 100.0, 300), 0.01, 1, 1000.0)
    for name, wish in (
        ("growing mode, undeclared", Requirements("x")),
        ("growing mode, declared", Requirements("x", integrators=0, unstable_poles=2)),
    ):
        stable = check([frf], slow, wish).margins["one"].stable
        yield Row(name, 0.01, "closed loop", stable, "unstable", stable != "stable")


def bounds() -> Iterator[Row]:
    """Limits between what the last line bounds and the truth beyond it."""
    unit, wide = own(("gain", {"gain": 1.0})), np.geomspace(0.1, 400.0, 100_000)
    truth = exact_margins(falling, unit, wide)
    for quantity, last_hz, slack in (("gain_margin_db", 28.0, -1.0), ("sensitivity_peak_db", 12.0, 0.5)):
        wish = Requirements("x", integrators=1, unstable_poles=0, **{quantity: truth[quantity] + slack})
        (line,) = check([lines_of(falling, np.geomspace(0.2, last_hz, 300), 1e-3, 1)], unit, wish).lines
        assert line.bound is not None
        ends = sorted((line.value, line.bound))
        words = (
            f"{line.value:.2f} to {line.bound:.2f}, measure to {line.measure_to_hz or np.nan:.0f} Hz: {line.outcome}"
        )
        right = line.outcome == "undecided" and ends[0] <= truth[quantity] <= ends[1]
        yield Row("bounded by the last line", 1e-3, quantity, words, f"{truth[quantity]:.2f}", right)


def between_lines() -> Iterator[Row]:
    """How often 95 % intervals hold the truth on loops whose resonances are narrow or fall between the lines."""
    unit, wish = own(("gain", {"gain": 1.0})), Requirements("x", integrators=1, unstable_poles=0)
    for plant, f in (
        (several_crossings, np.geomspace(0.5, 120.0, 500)),
        (on_a_grid, np.arange(0.5, 100.0, 0.1)),
        (sharper, np.geomspace(0.5, 120.0, 500)),
        (zero_and_pole, np.geomspace(0.5, 150.0, 400)),
    ):
        around = [np.linspace(0.97 * f_hz, 1.03 * f_hz, 50_000) for f_hz in (20.05, 29.0, 31.0, 33.3)]
        dense = np.unique(np.concatenate([np.geomspace(f[0], f[-1], 200_000), *around]))
        truth = exact_margins(plant, unit, dense)
        for noise in (0.01, 0.03):
            found = [check([lines_of(plant, f, noise, seed)], unit, wish).margins["one"] for seed in range(DRAWS)]
            for quantity, value in truth.items():
                inside = np.mean([m.intervals[quantity][0] <= value <= m.intervals[quantity][1] for m in found])
                middle = float(np.median([getattr(m, quantity) for m in found]))
                words = f"{middle:.4g} (median), {inside:.0%} hold it"
                yield Row(plant.__name__, noise, quantity, words, f"{value:.4g}", bool(inside >= 0.9))


def exact_margins(plant: Plant, controller: Controller, dense_hz: Array) -> dict[str, float]:
    """Margins of the formula on a grid so dense that chords do not matter."""
    C = controller.response(dense_hz)
    above = np.array([dense_hz[-1], 1.1 * dense_hz[-1]])
    lines = kernel.Lines(dense_hz, C, above, controller.response(above))
    found, _ = Reader().read((plant(dense_hz) * C)[None], lines)
    columns = found[0]
    return {
        "gain_margin_db": float(columns[kernel.GAIN_DB]),
        "phase_margin_deg": float(columns[kernel.PHASE_DEG]),
        "delay_margin_s": float(np.exp(columns[kernel.LN_DELAY_S])),
        "sensitivity_peak_db": float(-20.0 / np.log(10.0) * columns[kernel.LN_MODULUS]),
        "complementary_peak_db": float(columns[kernel.COMPLEMENTARY_DB]),
        "disk_margin": float(np.exp(columns[kernel.LN_DISK])),
    }


CASES = (at_0_hz, undeclared, bounds, between_lines)
