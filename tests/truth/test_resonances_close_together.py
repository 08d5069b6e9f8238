"""Resonances that stand within a few lines of each other: none that encircles -1 between two lines is stepped over.

Modes of known place, width and peak beside an integrator with lags; the truth are the roots of the closed loop's
polynomial. The bare count of the lines finds each of these loops stable, and each has two unstable poles.
"""

import numpy as np
import pytest
from drawn_loops import LINES, PLANTS, by_roots, frf_of, loop_of, with_mode

from loopshape.core.units import TWO_PI
from loopshape.loop.crowded import crowds
from loopshape.loop.stability import closed_loop_stability

PLANT = PLANTS["one integrator"]
GAP = 0.1
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
    (crowd,) = crowds(LINES, P, (1e-6 * np.abs(P)) ** 2, np.inf, rough)
    at = np.linspace(14.0, 14.6, 2000)
    for f_hz, width, _ in modes:
        k = int(np.argmin(np.abs(crowd.pole_hz[0] - complex(f_hz, width * GAP))))
        assert crowd.pole_hz[0, k].real == pytest.approx(f_hz, abs=0.01 * GAP)
        assert crowd.pole_hz[0, k].imag == pytest.approx(width * GAP, rel=0.02)
        p = plant.poles()[np.argmin(np.abs(plant.poles() - TWO_PI * complex(-width * GAP, f_hz)))]
        residue = np.polyval(plant.num, p) / np.polyval(np.polyder(plant.den), p) / TWO_PI
        reference = crowd.window.reference(np.array([[f_hz]]))[0, 0]
        assert crowd.residue[0, k] * reference == pytest.approx(residue, rel=0.03)
    assert np.max(np.abs(crowd.response(at[None])[0] - plant.response(at)) / np.abs(plant.response(at))) < 0.02
