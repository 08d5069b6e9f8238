"""A count on a large L decides although poles may lie below its lines, where they cannot change the outcome."""

import numpy as np
import pytest
from bench_nouns import Block, Loop, TransferFunction
from conversions import TWO_PI

import loopshape as ls
from loopshape.loop.stability.low_end import is_large, is_told
from loopshape.loop.stability.stability import closed_loop_stability

FIRST_HZ = 0.1
GRID = np.arange(1, 601) * FIRST_HZ


def real(f_hz, sign=1.0):
    return np.array([1.0 / (TWO_PI * f_hz), sign])


def product(*polynomials):
    out = np.ones(1)
    for p in polynomials:
        out = np.polymul(out, p)
    return out


def measured(plant, gain):
    P = plant.response(GRID)
    frf = ls.FRF(
        GRID, P[:, None, None], (1e-6 * np.abs(P[:, None, None])) ** 2 + 0j, np.ones(GRID.size, dtype=bool), ("u",),
        ("y",), "drawn", rate_hz=1e5,
    )  # fmt: skip
    controller = ls.Controller("axis", (Block("gain", {"gain": gain}),), 1e5)
    return Loop(frf, controller, plant.integrators(), plant.unstable_poles())


def growing(plant, gain):
    return int(np.sum(np.roots(np.polyadd(plant.den, gain * plant.num)).real > 0.0))


@pytest.mark.parametrize("gain", [0.5, 4.0])
def test_three_integrators_and_an_unstable_pole_within_the_lines_are_decided(gain):
    """Three zeros near the first line bend the phase so that no small model follows, and the pole is at 0.85 Hz."""
    num = product(real(0.60), real(0.46), real(0.43))
    den = np.concatenate([product(real(0.845, -1.0), real(9.4), real(11.4)), np.zeros(3)])
    plant = TransferFunction(num / abs(np.polyval(num, 10j * TWO_PI) / np.polyval(den, 10j * TWO_PI)), den)
    found = closed_loop_stability(measured(plant, gain))
    assert found.outcome == ("unstable" if growing(plant, gain) else "stable"), found.reason


def test_unstable_poles_below_the_lines_are_never_taken_for_some_within_them():
    """Poles and zeros at a fifth of the first line and less: undecided or right, by the roots, where no model tells."""
    rng, asked = np.random.default_rng(5), 0
    for _ in range(150):
        low = [real(float(rng.uniform(0.003, 0.02)), -1.0) for _ in range(int(rng.integers(1, 3)))]
        zeros = [real(float(rng.uniform(0.003, 0.02))) for _ in low]
        num = product(*zeros, *(real(float(rng.uniform(0.35, 0.6))) for _ in range(3)))
        den = np.concatenate([product(*low, *(real(float(rng.uniform(8.0, 40.0))) for _ in range(2))), np.zeros(3)])
        plant = TransferFunction(num / abs(np.polyval(num, 10j * TWO_PI) / np.polyval(den, 10j * TWO_PI)), den)
        gain = float(np.exp(rng.uniform(-2.0, 2.0)))
        loop = measured(plant, gain)
        if is_told(loop) or not is_large(loop):
            continue
        asked += 1
        found = closed_loop_stability(loop)
        assert found.outcome in ("undecided", "unstable" if growing(plant, gain) else "stable"), (plant, gain, found)
    assert asked >= 20
