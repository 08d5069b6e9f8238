"""Loops that the page of `shape` is tried on: a real bench, and plants of which each asks for another part of it."""

from functools import cache

import motor_bench
import numpy as np
from bench_nouns import Block

import loopshape as ls

RATE_HZ = 1000.0


@cache
def bench() -> tuple[ls.FRF, ls.Requirements, ls.Controller]:
    """The motor bench with its shipped requirements and controller."""
    P, folder = ls.frf(motor_bench.run()), motor_bench.FOLDER
    return P, ls.read_requirements(folder / "requirements.toml")[0], ls.read_controllers(folder / "controller.toml")[0]


def noisy(f_hz: np.ndarray, P: np.ndarray, share: float, name: str, seed: int) -> ls.FRF:
    rng = np.random.default_rng(seed)
    error = (rng.standard_normal(f_hz.size) + 1j * rng.standard_normal(f_hz.size)) * np.sqrt(0.5) * share
    return ls.FRF.from_arrays(f_hz, P * (1.0 + error), relative_std=share, rate_hz=RATE_HZ, recording=name, loop="x")


def plants(kind: str) -> list[ls.FRF]:
    """Operating points of a kind: lags without an integrator, a sharp resonance, an exact line, a hidden resonance,
    a reversed sign, and lines with a wide hole among them, or so far apart that they hide anything."""
    f = np.linspace(0.5, 200.0, 300) if kind in ("sharp", "hidden") else np.geomspace(0.5, 300.0, 160)
    f = np.geomspace(0.5, 300.0, 18) if kind == "sparse" else f[(f < 20.0) | (f > 27.0)] if kind == "hole" else f
    s = 2j * np.pi * f
    out = []
    for k, shift in enumerate((1.0, 1.15)):
        w = 2.0 * np.pi * 60.0 * shift
        lag = 1.0 / (1.0 + s / (2.0 * np.pi * 4.0 * shift)) * np.exp(-s * 1e-3)
        P = {
            "lag": lag,
            "minus": -0.5 * lag,
            "exact": lag,
            "sparse": lag,
            "reversed": -20.0 * lag / s,
            "hole": lag,
            "sharp": lag + 0.02 * w**2 / (s**2 + 2 * 0.004 * w * s + w**2),
            "hidden": lag + 2e-4 * w**2 / (s**2 + 2 * 0.0006 * w * s + w**2),
        }[kind]
        out.append(noisy(f, P, 0.0 if kind == "exact" else 0.01, f"point {k + 1}", seed=k))
    return out


#: lines of a plant with resonances a few lines apart: noise as a share of |P|, (Hz, half width in gaps, peak over |P|)
CROWDS = {
    "three at 2 %": (0.02, (14.158, 0.043, 2.8), (14.273, 0.033, -13.0), (13.927, 0.692, 1.7)),
    "three at 5 %": (0.05, (14.041, 0.039, -8.5), (14.388, 0.256, 1.7), (14.233, 0.06, 4.6)),
    "two in one gap": (1e-6, (14.257, 0.224, -8.0), (14.291, 0.878, 4.9)),
}


def crowded(name: str) -> ls.FRF:
    """An integrator with two lags that crosses 0 dB near 5 Hz at a gain of 1, and resonances close together."""
    f = 0.1 * np.arange(1, 601)
    noise, *modes = CROWDS[name]

    def plant(f_hz: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * f_hz
        return 30.0 / (s * (1.0 + s / (2 * np.pi * 15.0)) * (1.0 + s / (2 * np.pi * 40.0)))

    P = plant(f)
    for f_hz, width, peak in modes:
        damping, x = 0.1 * width / f_hz, 1j * f / f_hz
        P = P + peak * abs(plant(np.array([f_hz]))[0]) * 2.0 * damping * x / (x**2 + 2.0 * damping * x + 1.0)
    return noisy(f, P, noise, name, seed=1)


def moved(C: ls.Controller, rng: np.random.Generator) -> ls.Controller:
    """A controller with all parameters moved, and now and then another block, a delay, or another precision."""
    blocks = [
        Block(b.kind, {name: float(v * np.exp(0.5 * rng.standard_normal())) for name, v in b.parameters.items()})
        for b in C.blocks
    ]
    f = float(np.exp(rng.uniform(0.0, 5.0)))
    if rng.random() < 0.4:
        blocks.append(Block("pi", {"f_hz": 0.1 * f}))
    if rng.random() < 0.4:
        blocks.append(Block("notch", {"f1_hz": f, "f2_hz": f, "damping1": 0.001, "damping2": 0.02}))
    timing = {"computation_delay_s": float(rng.uniform(0.0, 2e-3))} if rng.random() < 0.4 else {}
    precision = str(rng.choice(["double", "double", "single", "q8.28"]))
    try:
        return ls.Controller(C.loop, tuple(blocks), C.rate_hz, precision=precision, **timing)
    except ls.LoopshapeError:  # coefficients that the drawn precision does not hold
        return ls.Controller(C.loop, tuple(blocks), C.rate_hz, **timing)
