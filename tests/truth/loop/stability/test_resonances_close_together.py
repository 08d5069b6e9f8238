"""Resonances that stand within a few lines of each other: none that encircles -1 between two lines is stepped over.

Modes of known place, width and peak beside an integrator with lags; the truth are the roots of the closed loop's
polynomial. The bare count of the lines finds each of these loops stable, and each has two unstable poles.
"""

import numpy as np
import pytest
from bench_nouns import Block, Loop
from conversions import TWO_PI
from drawn_loops import LINES, PLANTS, by_roots, errors, frf_of, limit_gain, loop_of, with_mode
from tune_plants import DELAYED
from tune_plants import frf as delayed

import loopshape as ls
from loopshape.loop.stability.mode_clusters import cluster_bands, cluster_of
from loopshape.loop.stability.stability import closed_loop_stability

PLANT = PLANTS["one integrator"]
GAP = 0.1
LEAD_HZ = {"f1_hz": 23.0, "f2_hz": 4000.0}
#: noise of the lines as a share of |P|, and (Hz, half width in gaps, peak over |P|) of each mode
CASES = {
    "three at 2 %": (0.02, (14.158, 0.043, 2.8), (14.273, 0.033, -13.0), (13.927, 0.692, 1.7)),
    "three at 5 %": (0.05, (14.041, 0.039, -8.5), (14.388, 0.256, 1.7), (14.233, 0.06, 4.6)),
    "a sharp one beside a wide one": (1e-6, (14.157, 0.043, -5.9), (14.37, 0.894, -1.4)),
    "two in one gap": (1e-6, (14.257, 0.224, -8.0), (14.291, 0.878, 4.9)),
    "a sharp one in the flank of a wide one at 5 %": (0.05, (13.991, 0.053, -6.2), (14.176, 1.493, 1.7)),
    "three without noise": (1e-6, (14.226, 0.046, 13.1), (14.129, 1.233, 5.7), (14.452, 0.031, -18.5)),
}


def with_modes(*modes):
    plant = PLANT
    for f_hz, width, peak in modes:
        plant = with_mode(plant, f_hz, width * GAP / f_hz, peak * abs(PLANT.response([f_hz])[0]))
    return plant


@pytest.mark.parametrize("name", CASES)
def test_what_several_resonances_encircle_between_lines_is_counted_or_left_open(name):
    noise, *modes = CASES[name]
    plant = with_modes(*modes)
    P = plant.response(LINES)
    found = closed_loop_stability(loop_of(plant, frf_of(LINES, P, noise * np.abs(P), np.random.default_rng(1))))
    assert by_roots(plant) == 2
    assert found.outcome == "undecided" or found.unstable_poles == 2
    if found.outcome == "undecided":
        low, high = found.band_hz
        assert low < 14.5
        assert high > 13.9
        assert high - low < 30.0 * GAP


def test_poles_and_residues_of_two_that_stand_close_are_found():
    modes = (14.157, 0.043, -5.9), (14.37, 0.894, -1.4)
    plant = with_modes(*modes)
    P, rough = plant.response(LINES), np.zeros(LINES.size - 1, dtype=bool)
    rough[138:146] = True
    (stretch,) = cluster_bands(LINES, rough)
    crowd = cluster_of(LINES, P, (1e-6 * np.abs(P)) ** 2, np.inf, stretch)
    at = np.linspace(14.0, 14.6, 2000)
    for f_hz, width, _ in modes:
        k = int(np.argmin(np.abs(crowd.pole_hz[0] - complex(f_hz, width * GAP))))
        assert crowd.pole_hz[0, k].real == pytest.approx(f_hz, abs=0.01 * GAP)
        assert crowd.pole_hz[0, k].imag == pytest.approx(width * GAP, rel=0.02)
        p = plant.poles()[np.argmin(np.abs(plant.poles() - TWO_PI * complex(-width * GAP, f_hz)))]
        residue = np.polyval(plant.num, p) / np.polyval(np.polyder(plant.den), p) / TWO_PI
        reference = crowd.window.reference(np.array([[f_hz]]))[0, 0]
        assert crowd.residue[0, k] * reference == pytest.approx(residue, rel=0.03)
    made, P = crowd.response(at[None], np.array([0]))[0], plant.response(at)
    assert np.max(np.abs(made - P) / np.abs(P)) < 0.02


def shares_of_the_other_sign():
    """How many of the ways have a damping of the wrong sign, in six draws of noise that hides it."""
    plant = with_modes((14.157, 0.1, -2.0), (14.37, 0.9, -1.4))
    P, rough = plant.response(LINES), np.zeros(LINES.size - 1, dtype=bool)
    rough[138:146] = True
    std = 0.02 * np.abs(P)
    for seed in range(6):
        noisy = P + std * errors(np.random.default_rng(seed), LINES.size)
        pole_hz = cluster_of(LINES, noisy, std**2, np.inf, *cluster_bands(LINES, rough), unstable=True).pole_hz
        sharp = pole_hz[:, np.argmin(np.abs(pole_hz[0].imag))]
        yield np.mean(np.sign(sharp.imag) != np.sign(sharp[0].imag))


def test_where_the_plant_may_be_unstable_lines_seldom_tell_the_sign_of_a_sharp_one():
    assert sum(share > 0.02 for share in shares_of_the_other_sign()) >= 4


def scattered(low_hz, high_hz, gain=1.0):
    """A loop whose lines know their noise, but for a band where they scatter five times as far."""
    P = PLANT.response(LINES)
    std = 0.03 * np.abs(P)
    more = np.where(np.abs(LINES - 0.5 * (low_hz + high_hz)) < 0.5 * (high_hz - low_hz), 5.0, 1.0)
    return loop_of(PLANT, frf_of(LINES, P + std * more * errors(np.random.default_rng(5), LINES.size), std), gain)


def test_lines_that_scatter_where_the_loop_is_small_decide_nothing_less():
    loop = scattered(15.0, 17.0)
    assert np.max(np.abs(loop.L[LINES > 15.0])) < 0.3
    assert by_roots(PLANT) == 0
    assert closed_loop_stability(loop).outcome == "stable"


def test_the_same_scatter_beside_minus_one_leaves_the_count_open():
    limit = limit_gain(PLANT)
    at = LINES[np.argmin(np.abs(1.0 + limit * PLANT.response(LINES)))]
    assert closed_loop_stability(scattered(at - 1.0, at + 1.0, limit / 1.1)).outcome == "undecided"


@pytest.mark.long
def test_resonances_drawn_close_together_are_never_counted_wrong():
    decided = 0
    for seed in range(24):
        rng = np.random.default_rng([14, seed])
        middle, noise = rng.uniform(8.0, 30.0), (1e-6, 0.02)[seed % 2]
        places = [middle + GAP * rng.uniform(-3.0, 3.0) for _ in range(rng.integers(2, 4))]
        plant = with_modes(*[(at, 0.03 * 100.0 ** rng.random(), rng.uniform(-10.0, 10.0)) for at in places])
        P = plant.response(LINES)
        found = closed_loop_stability(loop_of(plant, frf_of(LINES, P, noise * np.abs(P), rng), 0.5))
        assert found.outcome == "undecided" or found.unstable_poles == by_roots(plant, 0.5), seed
        decided += found.outcome != "undecided"
    assert decided >= 12


def test_a_long_delay_between_few_lines_is_no_resonance():
    # 2 exp(-0.02 s)/s turns by 30 to 90 deg from line to line above 46 Hz, where |L| stays near 0.3
    controller = ls.Controller("one", (Block("gain", {"gain": 21.0}), Block("lead_lag", LEAD_HZ)), 10_000.0)
    loop = Loop(delayed(DELAYED, 60), controller, integrators=1, unstable_poles=0)
    f = np.geomspace(0.01, 4000.0, 400_000)
    L = DELAYED.response(f) * controller.response(f)
    assert np.abs(L[f > 40.0]).max() < 0.4  # no crossing of 1 there, and the phase margin at the only one tells:
    crossing = int(np.flatnonzero(np.diff(np.abs(L) < 1.0))[0])
    assert 0.0 < np.angle(-L[crossing]) < np.pi
    assert closed_loop_stability(loop).outcome == "stable"
