"""How often the 95 % intervals of margins hold the truth, and how far their medians lie from it: Monte Carlo."""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.data.response.model import TransferFunction
from loopshape.data.result.margins import Margins
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.loop.loop import Loop
from loopshape.loop.margin.margins import margins
from loopshape.loop.verdict import check

HERE = Path(__file__).parent
RATE = 1000.0
RUNS = 400
NOISE = (0.02, 0.05, 0.10)
#: ways to spoil the lines, and how many readings a row needs at least
SPOILED, MANY = ("hole", "poor band", "low end cut"), 40
COLUMNS = ("loop", "noise", "errors", "quantity", "unit", "truth", "raw_bias", "bias", "half_width", "coverage", "runs")
#: quantity -> unit, and whether its error is counted as a share of it
QUANTITIES = {
    "gain_margin_db": ("dB", False), "gain_reduction_margin_db": ("dB", False), "phase_margin_deg": ("deg", False),
    "modulus_margin": ("%", True), "delay_margin_s": ("%", True), "disk_margin": ("%", True),
    "sensitivity_peak_db": ("dB", False), "complementary_peak_db": ("dB", False), "control_peak_db": ("dB", False),
    "process_peak_db": ("dB", False), "bandwidth_hz": ("%", True), "sensitivity_bandwidth_hz": ("%", True),
    "complementary_bandwidth_hz": ("%", True),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A plant on its lines, a controller, and what the loop has at s = 0 and in the right half plane."""

    f: Array
    plant: TransferFunction
    blocks: tuple[Block, ...]
    integrators: int
    unstable: int = 0


def pair(f_hz: float, damping: float) -> Array:
    """s²/w² + 2 d s/w + 1."""
    w = TWO_PI * f_hz
    return np.array([1.0 / w**2, 2.0 * damping / w, 1.0])


def real(f_hz: float) -> Array:
    """s/w + 1."""
    return np.array([1.0 / (TWO_PI * f_hz), 1.0])


def product(*polynomials: Array) -> Array:
    """Product of polynomials in s."""
    out = np.ones(1)
    for polynomial in polynomials:
        out = np.polymul(out, polynomial)
    return out


S = np.array([1.0, 0.0])
LEAD = (Block("gain", {"gain": 1.6}), Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 30.0}))
ARM = (
    Block("gain", {"gain": 12.0}),
    Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 15.0}),
    Block("notch", {"f1_hz": 6.1, "f2_hz": 6.1, "damping1": 0.05, "damping2": 5.0}),
    Block("low_pass_2", {"f_hz": 15.0, "damping": 0.7}),
)


def gain(value: float) -> tuple[Block, ...]:
    """A plain gain."""
    return (Block("gain", {"gain": value}),)


CASES = {
    "resonance that comes up to 0 dB": Case(
        np.geomspace(0.1, 60.0, 500), TransferFunction([13.2], product(S, pair(6.3, 0.1)), 0.005), gain(1.0), 1
    ),
    "arm, third order, notch": Case(
        np.geomspace(0.1, 60.0, 500), TransferFunction([0.498], product(S, pair(6.3, 0.05))), ARM, 1
    ),
    "peak of 8.4 dB": Case(
        np.geomspace(0.1, 60.0, 400), TransferFunction([51.8], product(S, real(8.0), real(20.0)), 0.0027), gain(1.0), 1
    ),
    "double integrator, lead": Case(
        np.geomspace(0.3, 80.0, 250), TransferFunction([30.0], [1.0, 0.0, 0.0], 0.002), LEAD, 2
    ),
    "lag with delay, even lines": Case(
        np.arange(1, 301) * 0.25, TransferFunction([5.5], product(real(2.0), pair(30.0, 0.3)), 0.01), gain(1.0), 0
    ),
    "unstable plant": Case(
        np.geomspace(0.1, 40.0, 400), TransferFunction([4.0], product(np.array([1 / TWO_PI, -1.0]), real(15.0))),
        gain(1.0), 0, 1,
    ),
    "three integrators": Case(
        np.geomspace(0.05, 100.0, 600),
        TransferFunction(100.0 * product(real(0.4), real(0.4)), product(S, S, S, real(30.0))), gain(1.0), 3,
    ),
    "several crossings": Case(
        np.geomspace(0.05, 100.0, 600),
        TransferFunction(12.0 * pair(5.0, 0.05), product(S, pair(7.0, 0.02), real(60.0))), gain(1.0), 1,
    ),
}  # fmt: skip


def frf(case: Case, response: ComplexArray, variance: Array, overlap: float = 1.0, freedom: float = np.inf) -> FRF:
    """Lines with a stated variance."""
    return FRF(
        case.f, response[:, None, None], variance[:, None, None] + 0j, np.ones(case.f.size, dtype=bool), ("z_v",),
        ("y_rad",), "made up", rate_hz=RATE, line_overlap=overlap, variance_freedom=freedom,
    )  # fmt: skip


def read(case: Case, measured: FRF) -> tuple[Margins, Margins]:
    """Margins of the lines as they are, and bias-corrected with intervals."""
    controller = Controller("axis", case.blocks, RATE)
    plain = Loop(measured, controller, case.integrators, case.unstable)
    plant, scatter = smoothed(measured)
    return margins(plain), margins(
        Loop(plant, controller, case.integrators, case.unstable, raw=measured, scatter=scatter)
    )


def white(rng: np.random.Generator, lines: int) -> ComplexArray:
    """Independent circular errors of variance 1."""
    return np.sqrt(0.5) * (rng.standard_normal(lines) + 1j * rng.standard_normal(lines))


def as_hann(rng: np.random.Generator, lines: int) -> ComplexArray:
    """Errors of noise seen through Hann segments: neighbours correlate by 4/9, next ones by 1/36."""
    average = 40
    noise = rng.standard_normal((average, lines + 2)) + 1j * rng.standard_normal((average, lines + 2))
    drive = rng.standard_normal((average, lines + 2)) + 1j * rng.standard_normal((average, lines + 2))
    n, u = (x[:, 1:-1] * 0.5 - 0.25 * (x[:, :-2] + x[:, 2:]) for x in (noise, drive))
    d = np.sum(n * u.conj(), axis=0) / average
    return np.asarray(d / np.sqrt(np.mean(np.abs(n) ** 2) * np.mean(np.abs(u) ** 2) / average))


ERRORS: dict[str, tuple[Callable[[np.random.Generator, int], ComplexArray], float, float]] = {
    "independent": (white, 1.0, np.inf),
    "Hann": (as_hann, 1.9444, np.inf),
    "three periods": (white, 1.0, 4.0),
}


def measure(case: Case, noise: float, errors: str, rng: np.random.Generator) -> FRF:
    """One measurement: relative errors of a standard deviation sqrt(E|d|²)/|P|, the variance known or estimated."""
    draw, overlap, freedom = ERRORS[errors]
    P = case.plant.response(case.f)
    variance = (noise * np.abs(P)) ** 2
    response = P + np.sqrt(variance) * draw(rng, P.size)
    if np.isfinite(freedom):
        variance = variance * rng.chisquare(freedom, P.size) / freedom
    return frf(case, response, variance, overlap, freedom)


def spoiled(case: Case, noise: float, how: str, rng: np.random.Generator) -> FRF:
    """A measurement without a band of 0.1 to 0.7 octaves near 0 dB, with 50 % errors in it, or without what lies below.

    The band's centre is drawn from the lines where |L| is 0.1 to 10.
    """
    P = case.plant.response(case.f)
    L = np.abs(P * Controller("axis", case.blocks, RATE).response(case.f))
    centre, octaves = rng.choice(case.f[(L > 0.1) & (L < 10.0)]), rng.uniform(0.1, 0.7)
    inside = np.abs(np.log2(case.f / centre)) < 0.5 * octaves
    relative = np.where(inside & (how == "poor band"), 0.5, noise)
    low = case.f < rng.uniform(0.05, 0.6) * case.f[int(np.argmin(np.abs(np.log(L))))]
    measured = frf(case, P * (1.0 + relative * white(rng, P.size)), (relative * np.abs(P)) ** 2)
    measured = replace(measured, valid=valid_lines(case.f, relative, measured.valid))
    return measured.select(~{"hole": inside, "low end cut": low}.get(how, np.zeros(P.size, dtype=bool)))


def coverage(name: str, noise: float, errors: str, runs: int) -> list[list]:
    """Rows of the table for one loop at one level."""
    case, rng = CASES[name], np.random.default_rng([7, *name.encode(), round(1000 * noise), *errors.encode()])
    truth = read(case, frf(case, case.plant.response(case.f), np.zeros(case.f.size)))[0]
    kept = [q for q in QUANTITIES if np.isfinite(getattr(truth, q)) and getattr(truth, q) != 0.0]
    if errors in SPOILED:
        return _spoiled_rows(case, name, noise, errors, {q: getattr(truth, q) for q in kept}, runs, rng)
    found = [read(case, measure(case, noise, errors, rng)) for _ in range(runs)]
    rows = []
    for q in kept:
        unit, relative = QUANTITIES[q]
        true = getattr(truth, q)
        raw, value = (np.array([getattr(pair[k], q) for pair in found]) for k in (0, 1))
        ends = np.array([pair[1].intervals[q] for pair in found])
        inside = np.mean((ends[:, 0] <= true) & (true <= ends[:, 1]))
        share = 100.0 / true if relative else 1.0
        bias = [share * (np.median(x) - true) for x in (raw, value)]
        half = share * np.median(0.5 * (ends[:, 1] - ends[:, 0]))
        row = [name, noise, errors, q, unit, *(f"{x:.4g}" for x in (true, *bias, half)), f"{inside:.3f}", runs]
        rows.append(row)
    return rows


def _spoiled_rows(
    case: Case, name: str, noise: float, how: str, truth: dict[str, float], runs: int, rng: np.random.Generator
) -> list[list]:
    """Rows of loops that stay decided; of those, readings that are bounds are left out."""
    told = Requirements("axis", integrators=case.integrators, unstable_poles=case.unstable)
    controller, found = Controller("axis", case.blocks, RATE), []
    for _ in range(runs):
        (one,) = check([spoiled(case, noise, how, rng)], controller, told).margins.values()
        found += [one] if one.stable == "stable" else []
    rows = []
    for q, true in truth.items():
        unit, relative = QUANTITIES[q]
        read = [(getattr(m, q), *m.intervals[q]) for m in found if q in m.intervals and q not in m.bounds]
        if len(read) < MANY:
            continue
        value, low, high = np.array(read).T
        share = 100.0 / true if relative else 1.0
        numbers = true, np.nan, share * (np.median(value) - true), share * np.median(0.5 * (high - low))
        inside = np.mean((low <= true) & (true <= high))
        rows.append([name, noise, how, q, unit, *(f"{x:.4g}" for x in numbers), f"{inside:.3f}", len(read)])
    return rows


def main(runs: int = RUNS) -> None:
    """All loops at all levels, errors independent; two loops with other errors."""
    rows = [row for name in CASES for noise in NOISE for row in coverage(name, noise, "independent", runs)]
    for name in ("peak of 8.4 dB", "arm, third order, notch", "lag with delay, even lines"):
        for errors in ("Hann", "three periods"):
            rows += coverage(name, 0.05, errors, runs)
        for how in SPOILED:
            rows += coverage(name, 0.02, how, runs)
    with (HERE / "results.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    share = np.array([float(row[9]) for row in rows])
    within = np.mean((share >= 0.93) & (share <= 0.97))
    print(f"{share.size} rows: mean {share.mean():.3f}, {within:.0%} within 93-97 %")
    for row in rows:
        if not 0.92 <= float(row[9]) <= 0.98:
            print(*row)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else RUNS)
