"""Plants and structures for the tuner's tests: integrators with delay, and a flexible servo at three loads."""

import numpy as np
from bench_nouns import Block, TransferFunction
from conversions import angular

import loopshape as ls
from loopshape.design.problem.problem import problem
from loopshape.loop.loops import loops_of

RATE = 10_000.0
GAIN = {"kind": "gain", "gain": {"min": 0.01, "max": 1000.0}}
LEAD = {"kind": "lead_lag", "f1_hz": {"min": 1.0, "max": 500.0}, "f2_hz": {"min": 5.0, "max": 4000.0}}
PI = {"kind": "pi", "f_hz": {"min": 0.05, "max": 50.0}}
LOW_PASS = {
    "kind": "low_pass",
    "order": 2,
    "f_hz": {"min": 20.0, "max": 4000.0},
    "damping": {"min": 0.3, "max": 1.5},
}
NOTCH = {
    "kind": "notch",
    "f1_hz": {"min": 30.0, "max": 300.0},
    "f2_hz": "f1_hz",
    "damping1": {"min": 0.02, "max": 1.5},
    "damping2": {"min": 0.1, "max": 10.0},
}
DELAY_S = 0.02
DELAYED = TransferFunction([2.0], [1.0, 0.0], DELAY_S)  # 2 exp(-0.02 s)/s


def frf(model, lines=800, name="one", low_hz=0.05, high_hz=100.0, std=0.0, seed=0):
    """A model's FRF, with relative noise of standard deviation `std` (E|d|² = std² |P|²) and its covariance."""
    f = np.geomspace(low_hz, high_hz, lines)
    G, rng = model.response(f), np.random.default_rng(seed)
    noise = (rng.standard_normal(lines) + 1j * rng.standard_normal(lines)) / np.sqrt(2.0)
    covariance = (np.abs(G) * max(std, 1e-10)) ** 2
    return ls.FRF(
        f, (G * (1.0 + std * noise))[:, None, None], covariance[:, None, None].astype(complex),
        np.ones(lines, dtype=bool), ("z_v",), ("y_rad",), "known", name, "one", RATE,
    )  # fmt: skip


def servo(load):
    """A servo axis with a resonance near 70 Hz, which a load lowers."""
    w = float(angular(70.0)) / np.sqrt(load)
    zeros = [1.0 / (1.3 * w) ** 2, 0.06 / (1.3 * w), 1.0]
    poles = np.polymul([0.05 * load, 1.0, 0.0], [1.0 / w**2, 0.06 / w, 1.0])
    return TransferFunction(100.0 * np.array(zeros), poles, 2e-4)


def servos(std=0.0, lines=400):
    """FRFs of three loads."""
    return [frf(servo(m), lines, f"load {m}", 0.5, 1500.0, std, k) for k, m in enumerate((0.8, 1.0, 1.5))]


def required(*structure, **limits):
    """Requirements of the loop "one", whose plant has one integrator; a gain where no structure is given."""
    return ls.Requirements.from_table(
        {"name": "one", "integrators": 1, "unstable_poles": 0, "structure": list(structure) or [GAIN]} | limits
    )


def problem_of(frfs, requirements, **runs):
    """The tuner's problem of FRFs, with what makes a controller run otherwise."""
    unit = ls.Controller("one", (Block("gain", {"gain": 1.0}),), RATE, **runs)
    return problem(loops_of(frfs, unit, requirements)[0], requirements, RATE)
