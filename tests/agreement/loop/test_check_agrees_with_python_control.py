"""Margins from lines agree with python-control's, which has the transfer function."""

import control
import numpy as np
import pytest
from bench_nouns import Block, Loop, TransferFunction
from conversions import TWO_PI, db, hz

import loopshape as ls
from loopshape.loop.margin.margins import margins

F = np.geomspace(0.005, 2000.0, 12000)
UNITY = ls.Controller("axis", (Block("gain", {"gain": 1.0}),), 1e5)


def products(*polynomials):
    out = np.ones(1)
    for polynomial in polynomials:
        out = np.polymul(out, polynomial)
    return out


def pair(f_hz, damping):
    w = TWO_PI * f_hz
    return [1.0 / w**2, 2.0 * damping / w, 1.0]


W = TWO_PI * 6.3
#: numerator, denominator, integrators, unstable poles
LOOPS = {
    "arm's third order, gain 10": ([7800.0], [1.0, 0.1 * W, W * W, 0.0], 1, 0),
    "arm's third order, gain 3": ([2340.0], [1.0, 0.1 * W, W * W, 0.0], 1, 0),
    "three lags": ([8.0], products([1.0, 1.0], [0.3, 1.0], [0.05, 1.0]), 0, 0),
    "integrator and two lags": ([5.0], products([1.0, 0.0], [0.1, 1.0], [0.02, 1.0]), 1, 0),
    "double integrator with a lead": (np.multiply(20.0, [0.3, 1.0]), products([1.0, 0.0, 0.0], [0.01, 1.0]), 2, 0),
    "three integrators, two leads": (
        100.0 * products([0.4, 1.0], [0.4, 1.0]), products([1.0, 0.0, 0.0, 0.0], [0.005, 1.0]), 3, 0),
    "unstable pole": ([5.0], products([0.2, -1.0], [0.01, 1.0]), 0, 1),
    "non-minimum phase": ([-0.4, 4.0], products([1.0, 0.0], [0.1, 1.0]), 1, 0),
    "resonance and its zero": (
        np.multiply(12.0, pair(5.0, 0.05)), products([1.0, 0.0], pair(7.0, 0.02), [0.003, 1.0]), 1, 0),
    "sharp resonance": ([3.0], products([1.0, 0.0], pair(11.0, 0.03)), 1, 0),
    "four lags": ([20.0], products([0.5, 1.0], [0.2, 1.0], [0.05, 1.0], [0.01, 1.0]), 0, 0),
    "low gain": ([0.5], products([1.0, 0.0], [0.4, 1.0], [0.05, 1.0]), 1, 0),
    "unstable in closed loop": ([200.0], products([1.0, 0.0], [0.1, 1.0], [0.05, 1.0]), 1, 0),
}  # fmt: skip


def ours(name):
    num, den, integrators, unstable = LOOPS[name]
    P = TransferFunction(num, den).response(F)[:, None, None]
    known = np.ones(F.size, dtype=bool)
    frf = ls.FRF(F, P, 1e-20 * np.abs(P) ** 2 + 0j, known, ("z_v",), ("y_rad",), "exact", rate_hz=1e5)
    return margins(Loop(frf, UNITY, integrators, unstable))


@pytest.mark.parametrize("name", LOOPS)
def test_margins_and_crossovers(name):
    num, den = LOOPS[name][:2]
    found = ours(name)
    gains, phases, distances, w_180, w_unity, _ = control.stability_margins(control.tf(num, den), returnall=True)
    # chords between lines 0.1 % apart cut a resonance's corner by (turn/line)²/8, 2e-4 of |L| at damping 0.03
    up = [g for g, w in zip(db(gains), w_180, strict=True) if g >= 0.0 and w > 0.0]
    down = [-g for g, w in zip(db(gains), w_180, strict=True) if g < 0.0 and (w == 0.0 or w > TWO_PI * F[0])]
    last = -float(db(np.polyval(num, 1j * TWO_PI * F[-1]) / np.polyval(den, 1j * TWO_PI * F[-1])))
    assert found.gain_margin_db == pytest.approx(min([*up, last]), abs=2e-3)
    if "gain_reduction_margin_db" in found.bounds:  # no crossing is seen: as large as |L| at the first line at least
        first = float(db(abs(np.polyval(num, 1j * TWO_PI * F[0]) / np.polyval(den, 1j * TWO_PI * F[0]))))
        assert found.gain_reduction_margin_db == pytest.approx(first, abs=2e-3)
        assert min([*down, np.inf]) > first
    else:
        assert found.gain_reduction_margin_db == pytest.approx(min([*down, np.inf]), abs=2e-3)
    wrapped = (phases + 180.0) % 360.0 - 180.0  # rotation either way
    assert found.phase_margin_deg == pytest.approx(np.abs(wrapped).min(), abs=1e-2)
    np.testing.assert_allclose(np.sort(found.crossings_hz), np.sort([hz(w) for w in w_unity]), rtol=1e-5)
    assert found.modulus_margin == pytest.approx(min(distances), abs=3e-4)


@pytest.mark.parametrize("name", LOOPS)
def test_stability(name):
    num, den = LOOPS[name][:2]
    poles = control.feedback(control.tf(num, den), 1).poles()
    assert ours(name).stable == ("stable" if np.all(poles.real < 0.0) else "unstable")


def test_the_dozen_holds_both_kinds():
    assert {ours(name).stable for name in LOOPS} == {"stable", "unstable"}
