"""Random loops whose closed-loop poles are known: plants of each kind, lines, noise, and gains about their limits."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import control
import numpy as np

from loopshape.core.units import TWO_PI, Array, hz
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.data.response.model import TransferFunction
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.loop.loop import Loop
from loopshape.loop.loops import loops_of

KINDS = (
    "no integrator", "one integrator", "two integrators", "three integrators", "delay", "unstable pole",
    "unstable pair", "sharp resonance",
)  # fmt: skip
#: ways to spoil the lines of a loop of any of these kinds
SPOILED = ("hole", "poor band", "low end cut", "high end cut")
#: one step inside and outside a limit of the gain, and far from it
STEPS = (0.5, 0.9, 0.97, 1.03, 1.1, 2.0)
RATE_HZ = 1e5
GAINS = np.geomspace(1e-3, 1e3, 121)
LINEAR, LOGARITHMIC = 0.1 * np.arange(1, 601), np.geomspace(0.05, 200.0, 500)


@dataclass(frozen=True, eq=False)
class Case:
    """One loop: plant, lines in Hz, gain of the controller, how far that lies from a limit, and its unstable poles."""

    kind: str
    plant: TransferFunction
    lines_hz: Array
    grid: str
    gain: float
    step: float
    unstable: int

    @property
    def mode(self) -> tuple[float, float]:
        """Frequency in Hz of the plant's sharpest pole and the size of its residue, Hz times |P|; (0, inf) without."""
        poles = self.plant.poles()
        poles = poles[poles.imag > 0.0]
        if not poles.size:
            return 0.0, float("inf")
        p = poles[np.argmin(np.abs(poles.real / poles.imag))]
        residue = np.polyval(self.plant.num, p) / np.polyval(np.polyder(self.plant.den), p)
        return hz(p.imag), hz(abs(residue))


def product(*polynomials: Array) -> Array:
    """Polynomials multiplied."""
    out = np.ones(1)
    for p in polynomials:
        out = np.polymul(out, p)
    return out


def pair(f_hz: float, damping: float) -> Array:
    """Quadratic of a resonance, one at s = 0."""
    w = TWO_PI * f_hz
    return np.array([1.0 / w**2, 2.0 * damping / w, 1.0])


def real(f_hz: float, sign: float = 1.0) -> Array:
    """First order, +-1 at s = 0."""
    return np.array([1.0 / (TWO_PI * f_hz), sign])


def case(rng: np.random.Generator, kind: str) -> Case:
    """A random loop of one kind, at a step from one of the limits of its gain where it has one."""
    grid = ("linear", "logarithmic")[int(rng.integers(2))]
    lines = LINEAR if grid == "linear" else LOGARITHMIC
    plant = random_plant(rng, kind, lines)
    counts = np.array([unstable_poles(plant, g) for g in GAINS])
    changes = np.flatnonzero(np.diff(counts))
    step = float(rng.choice(STEPS))
    gain = limit(plant, counts, int(rng.choice(changes))) * step if changes.size else float(rng.choice(GAINS))
    return Case(kind, plant, lines, grid, gain, step if changes.size else 0.0, unstable_poles(plant, gain))


def random_plant(rng: np.random.Generator, kind: str, lines: Array) -> TransferFunction:
    """Integrators with leads and lags, resonances that the lines resolve, and what makes the kind."""
    integrators = {"one integrator": 1, "two integrators": 2, "three integrators": 3}.get(kind, int(rng.integers(0, 3)))
    integrators = 0 if kind == "no integrator" else integrators
    num = product(*(real(between(rng, 0.3, 3.0)) for _ in range(max(integrators - 1, 0))))
    den = product(*(real(between(rng, 0.5, 5.0)) for _ in range(2 if integrators == 0 else 0)))
    den = product(den, *(real(between(rng, 8.0, 40.0)) for _ in range(2)))
    if rng.random() < 0.6:
        f_hz = between(rng, 4.0, 30.0)
        den = product(den, pair(f_hz, between(rng, 0.03, 0.3)))
        if rng.random() < 0.5:
            num = product(num, pair(f_hz * between(rng, 0.7, 1.4), between(rng, 0.03, 0.3)))
    if kind == "unstable pole":
        num, den = product(num, real(between(rng, 0.5, 3.0))), product(den, real(between(rng, 0.5, 3.0), -1.0))
    if kind == "unstable pair":
        num = product(num, real(between(rng, 0.5, 3.0)), real(between(rng, 0.5, 3.0)))
        den = product(den, pair(between(rng, 0.5, 3.0), -between(rng, 0.1, 0.5)))
    den = np.concatenate([den, np.zeros(integrators)])
    scale = 1.0 / abs(TransferFunction(num, den).response([5.0])[0])
    delay = between(rng, 0.003, 0.1) if kind == "delay" else 0.0
    plant = TransferFunction(scale * num, den, delay)
    return with_mode(rng, plant, lines) if kind == "sharp resonance" else plant


def with_mode(rng: np.random.Generator, plant: TransferFunction, lines: Array) -> TransferFunction:
    """The plant and a mode beside it, 0.03 to 1 gaps wide (half width), whose peak is 0.3 to 10 times |P| there."""
    f_hz = between(rng, 4.0, 40.0)
    k = int(np.searchsorted(lines, f_hz))
    damping = max(between(rng, 0.03, 1.0) * float(lines[k] - lines[k - 1]) / f_hz, 1.5e-4)
    peak = between(rng, 0.3, 10.0) * abs(plant.response([f_hz])[0]) * rng.choice([-1.0, 1.0])
    mode = pair(f_hz, damping)
    num = np.polyadd(np.polymul(plant.num, mode), 2.0 * damping * peak * plant.den)
    return TransferFunction(num, np.polymul(plant.den, mode))


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A draw, its logarithm even."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def unstable_poles(plant: TransferFunction, gain: float) -> int:
    """Closed-loop poles in the right half plane: roots, and with a delay the count of a dense analytic contour."""
    if plant.delay_s:
        return by_contour(plant, gain)
    return int(np.sum(np.roots(np.polyadd(plant.den, gain * plant.num)).real > 0.0))


def by_contour(plant: TransferFunction, gain: float) -> int:
    """Z = P - D/pi, D the turn of 1 + L(s) on s from a small real number, along its quarter circle, up the axis."""
    low, high = TWO_PI * 1e-4, TWO_PI * 1e3
    w = np.geomspace(low, high, 3000)
    arc = low * np.exp(0.5j * np.pi * np.linspace(0.0, 1.0, 100))
    for _ in range(40):
        s = np.concatenate([arc, 1j * w[1:]])
        g = 1.0 + gain * np.polyval(plant.num, s) / np.polyval(plant.den, s) * np.exp(-s * plant.delay_s)
        step = np.angle(g[1:] / g[:-1])
        coarse = np.flatnonzero(np.abs(step[arc.size - 1 :]) > 0.7)
        if not coarse.size:
            break
        w = np.sort(np.concatenate([w, 0.5 * (w[coarse] + w[coarse + 1])]))
    return round(plant.unstable_poles() - (float(step.sum()) - float(np.angle(g[-1]))) / np.pi)


def limit(plant: TransferFunction, counts: np.ndarray, k: int) -> float:
    """The gain between GAINS k and k + 1 at which the count changes, by bisection to 1e-6."""
    low, high = GAINS[k], GAINS[k + 1]
    while high / low > 1.0 + 1e-6:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if unstable_poles(plant, middle) == counts[k] else (low, middle)
    return float(low)


def measured(case: Case, rng: np.random.Generator, noise: float, floor: float = 0.0) -> FRF:
    """Lines with circular errors: `noise` of |P|, and one that grows with f to `floor` of L at the last."""
    P = case.plant.response(case.lines_hz)
    rising = floor / case.gain * case.lines_hz / case.lines_hz[-1]
    variance = (noise * np.abs(P)) ** 2 + rising**2
    error = np.sqrt(0.5 * variance) * (rng.standard_normal(P.size) + 1j * rng.standard_normal(P.size))
    return FRF(
        case.lines_hz, (P + error)[:, None, None], variance[:, None, None] + 0j, np.ones(P.size, dtype=bool), ("z_v",),
        ("y_rad",), "drawn", rate_hz=RATE_HZ,
    )  # fmt: skip


def spoiled(case: Case, rng: np.random.Generator, noise: float, how: str) -> FRF:
    """Lines without a band of 0.1 to 1.5 octaves near a crossover or a mode, with 20 to 80 % errors in it, or cut."""
    f, L = case.lines_hz, case.gain * np.abs(case.plant.response(case.lines_hz))
    near = [*f[(L > 0.03) & (L < 30.0)], *np.abs(np.roots(case.plant.den).imag) / TWO_PI]
    centre, octaves = float(rng.choice([x for x in near if x > 0.0] or [5.0])), between(rng, 0.1, 1.5)
    inside = np.abs(np.log2(f / centre)) < 0.5 * octaves
    relative = np.where(inside & (how == "poor band"), rng.uniform(0.2, 0.8), noise)
    falls = np.maximum.accumulate(L[::-1])[::-1] <= L  # the loop comes no closer above: what is taken for granted there
    ends = f[falls & (L < 0.7)]
    low = between(rng, 0.1, 6.0) if how == "low end cut" else 0.0
    high = float(rng.choice(ends)) if how == "high end cut" and ends.size else np.inf
    keep = (f > low) & (f <= high) & ~(inside & (how == "hole"))
    whole = measured(case, rng, 1.0)
    error = (whole.siso - case.plant.response(f)) * relative
    P, std = case.plant.response(f) + error, relative * np.abs(case.plant.response(f))
    known = valid_lines(f[keep], relative[keep], np.ones(int(keep.sum()), dtype=bool))
    made = {"response": P[keep, None, None], "covariance": (std[keep] ** 2)[:, None, None] + 0j, "valid": known}
    return replace(whole, frequency_hz=f[keep], loop="axis", **made)


def checked(case: Case, frf: FRF) -> Loop:
    """The loop on the lines that `check` would use, its plant's integrators and unstable poles declared."""
    told = Requirements("axis", integrators=case.plant.integrators(), unstable_poles=case.plant.unstable_poles())
    return loops_of([frf], Controller("axis", (Block("gain", {"gain": case.gain}),), RATE_HZ), told)[0][0]


def loop(case: Case, frf: FRF, *, model: bool = False) -> Loop:
    """The measured plant under the case's gain, with what is declared of it."""
    controller = Controller("axis", (Block("gain", {"gain": case.gain}),), RATE_HZ)
    plant, (smooth, scatter) = case.plant, smoothed(frf)
    witness = plant if model else None
    return Loop(smooth, controller, plant.integrators(), plant.unstable_poles(), witness, raw=frf, scatter=scatter)


def peer(case: Case, frf: FRF) -> int:
    """Unstable poles by python-control's count of the same lines, told of the plant's unstable poles."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = control.frd(case.gain * frf.siso, TWO_PI * frf.frequency_hz)
        return int(control.nyquist_response(data).count) + case.plant.unstable_poles()
