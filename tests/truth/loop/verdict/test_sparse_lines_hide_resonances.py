"""Lines too far apart, or a hole among them, hide a resonance: no row passes by what lies on both sides of it."""

import numpy as np
import pytest

import loopshape as ls

RATE_HZ = 1000.0
MODES = ((57.84, 0.003), (23.1, 0.004), (140.0, 0.005))


def plant(f: np.ndarray, f_hz: float, damping: float) -> np.ndarray:
    """A mass with friction, and a mode with its antiresonance a little below: the peak is narrow and high."""
    s = 2j * np.pi * f
    w, a = 2 * np.pi * f_hz, 2 * np.pi * 0.9 * f_hz
    ratio = (s**2 / a**2 + 2 * damping * s / a + 1.0) / (s**2 / w**2 + 2 * damping * s / w + 1.0)
    return 40.0 / (s * (1.0 + s / 400.0)) * ratio


def measured(f: np.ndarray, f_hz: float, damping: float) -> ls.FRF:
    rng = np.random.default_rng(5)
    error = 1.0 + 0.002 * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2.0)
    return ls.FRF.from_arrays(f, plant(f, f_hz, damping) * error, relative_std=0.002, rate_hz=RATE_HZ, loop="x")


def grids(f_hz: float) -> dict[str, np.ndarray]:
    """Lines a factor 1.5 apart, none near the mode, and fine ones with a hole about it."""
    sparse = f_hz * 1.5 ** (np.arange(-11, 6) + 0.5)
    fine = np.geomspace(0.5, 400.0, 300)
    return {"sparse": sparse[sparse < 400.0], "hole": fine[np.abs(np.log(fine / f_hz)) > 0.25]}


C = ls.controller(ls.gain(1.0), rate_hz=RATE_HZ, loop="x")


@pytest.mark.parametrize("lines", ["sparse", "hole"])
@pytest.mark.parametrize(("f_hz", "damping"), MODES)
def test_a_row_that_the_hidden_mode_breaks_does_not_pass(lines: str, f_hz: float, damping: float) -> None:
    dense = np.sort(np.concatenate([np.geomspace(0.1, 450.0, 20_000), f_hz * np.linspace(0.97, 1.03, 20_001)]))
    L = plant(dense, f_hz, damping) * C.response(dense)
    crossed = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
    distance = np.abs(1.0 + L)
    truth = {
        "sensitivity_peak_db": -20 * np.log10(distance.min()),
        "complementary_peak_db": 20 * np.log10((np.abs(L) / distance).max()),
        "modulus_margin": distance.min(),
        "disk_margin": (2 * distance / np.abs(1.0 - L)).min(),
        "phase_margin_deg": np.degrees(np.abs(np.angle(-L[crossed])).min()),
    }
    names = {
        x: y - 0.3 if x.endswith("_db") else min(1.1 * y, 0.999 if x == "modulus_margin" else 180.0)
        for x, y in truth.items()
    }
    required = ls.Requirements("x", integrators=1, unstable_poles=0, **names)  # each a little more than is true
    found = ls.check(measured(grids(f_hz)[lines], f_hz, damping), C, required)
    assert [line.quantity for line in found.lines if line.outcome is ls.Outcome.PASSED] == []
    bounded = [line for line in found.lines if line.measure_from_hz is not None]
    assert bounded
    assert lines == "sparse" or all(line.measure_from_hz < f_hz < line.measure_to_hz for line in bounded)


def test_what_fails_beside_the_hole_fails() -> None:
    """What is missed far below the hole: whatever a mode might do besides makes it no better."""
    f_hz, damping = MODES[2]
    required = ls.Requirements("x", integrators=1, unstable_poles=0, phase_margin_deg=88.0, disk_margin=1.9)
    found = ls.check(measured(grids(f_hz)["hole"], f_hz, damping), C, required)
    assert {line.outcome for line in found.lines} == {ls.Outcome.FAILED}
