"""Magnetic bearings, P = w²/(s² - w²) exp(-s T) at several corner frequencies, measured from 5 Hz: a start is found."""

import numpy as np
import pytest
from bench_nouns import TransferFunction
from conversions import angular
from tune_plants import GAIN, LOW_PASS, PI, frf

import loopshape as ls

WIDE = {"kind": "lead_lag", "f1_hz": {"min": 1.0, "max": 1000.0}, "f2_hz": {"min": 1.0, "max": 1000.0}}
DELAY_S = 0.003


def bearing(corner_hz: float) -> TransferFunction:
    """A bearing's rigid mode, one pole on each side of the imaginary axis, with delay."""
    w = float(angular(corner_hz))
    return TransferFunction([w * w], [1.0, 0.0, -w * w], DELAY_S)


def closed_loop_poles(corner_hz: float, blocks: list[dict[str, float]]) -> np.ndarray:
    """Poles of 1 + C P by polynomials, the delay as a Padé approximation of order 6; C as it is in s."""
    w, orders = float(angular(corner_hz)), np.arange(7)
    c = np.array([1.0, 1 / 2, 5 / 44, 1 / 66, 1 / 792, 1 / 15840, 1 / 665280])  # Padé (6, 6) of exp(-x)
    num, den = w * w * (c * (-DELAY_S) ** orders)[::-1], np.polymul([1.0, 0.0, -w * w], (c * DELAY_S**orders)[::-1])
    for block in blocks:
        one = {name: float(angular(value)) for name, value in block.items() if name.endswith("_hz")}
        if block["kind"] == "gain":
            num = num * block["gain"]
        elif block["kind"] == "pi":
            num, den = np.polymul(num, [1.0, one["f_hz"]]), np.polymul(den, [1.0, 0.0])
        elif block["kind"] == "lead_lag":
            num, den = np.polymul(num, [1 / one["f1_hz"], 1.0]), np.polymul(den, [1 / one["f2_hz"], 1.0])
        else:
            f = one["f_hz"]
            den = np.polymul(den, [1 / f**2, 2 * block["damping"] / f, 1.0])
    return np.roots(np.polyadd(num, den))


def test_the_truth_knows_a_controller_for_each_case() -> None:
    """By hand: a lead of a decade and more about crossover; without it none is stable."""
    lead = [
        {"kind": "gain", "gain": 2.7},
        {"kind": "pi", "f_hz": 0.05},
        {"kind": "lead_lag", "f1_hz": 10.0, "f2_hz": 1e3},
    ]
    for corner_hz in (4.0, 8.0, 12.0):
        assert closed_loop_poles(corner_hz, lead).real.max() < 0.0
        assert closed_loop_poles(corner_hz, lead[:2]).real.max() > 0.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("corners_hz", "structure"),
    [((4.0, 8.0, 12.0), (GAIN, PI, WIDE)), ((6.0, 8.0, 10.0), (GAIN, PI, WIDE, LOW_PASS)), ((8.0,), (GAIN, WIDE))],
)
def test_a_start_is_found_on_every_seed(corners_hz: tuple[float, ...], structure: tuple[dict, ...], seed: int) -> None:
    plants = [frf(bearing(f), 120, f"{f:g}", 5.0, 200.0, 0.01, k) for k, f in enumerate(corners_hz)]
    wish = {"name": "one", "integrators": 0, "unstable_poles": 1, "sensitivity_peak_db": 8.0}
    found = ls.tune(plants, ls.Requirements.from_table(wish | {"structure": list(structure)}), seed=seed, starts=3)
    assert found.feasible
    blocks = [block.to_table() for block in found.controller.blocks]
    assert max(closed_loop_poles(f, blocks).real.max() for f in corners_hz) < 0.0
