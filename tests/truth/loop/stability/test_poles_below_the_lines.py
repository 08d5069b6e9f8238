"""Poles below the lines: what they cannot change is decided, and what they may be taken for is not."""

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


@pytest.mark.parametrize("share", [0.1, 0.2])
def test_two_lags_below_the_lines_are_not_taken_for_two_integrators(share):
    """They look like two by slope and phase, and a model with two turns its sign; stable by the roots."""
    f, a, tf = np.geomspace(1.0, 450.0, 200), TWO_PI * share, 1.0 / (TWO_PI * 60.0)
    den = product([1.0 / a, 1.0], [0.5 / a, 1.0], [tf, 1.0])
    C = ls.controller(ls.gain(2.0 / share**2), ls.lead_lag(0.8, 8.0), rate_hz=1e4)
    gained = 2.0 / share**2 * np.array([1.0 / (TWO_PI * 0.8), 1.0])
    assert np.all(np.roots(np.polyadd(gained, product(den, [1.0 / (TWO_PI * 8.0), 1.0]))).real < 0.0)
    P = ls.FRF.from_arrays(f, 1.0 / np.polyval(den, 1j * TWO_PI * f), relative_std=1e-3, rate_hz=1e4)
    for declared in (None, 0):
        margins = ls.check(P, C, ls.Requirements(unstable_poles=0, integrators=declared)).margins["frf 1"]
        assert margins.stable == ("undecided" if declared is None else "stable"), margins.stability_reason
