"""Starts that are given up because another structure lies so far below them would not have been chosen."""

import numpy as np
import pytest

import loopshape as ls
from loopshape.identify import fit as module
from loopshape.identify.structures import Rational


def two_masses(noise: float) -> ls.FRF:
    """A flexible axis with an antiresonance at 30 Hz and a resonance at 50 Hz, with noise of this relative size."""
    f = np.geomspace(3.0, 200.0, 80)
    s = 2j * np.pi * f
    zero, pole = 2.0 * np.pi * 30.0, 2.0 * np.pi * 50.0
    G = (s**2 + 0.04 * zero * s + zero**2) / (s**2 + 0.04 * pole * s + pole**2) / (1.0 + 0.5 * s) / (1.0 + 0.02 * s)
    G = G * np.exp(-1e-3 * s)
    rng = np.random.default_rng(7)
    variance = (noise * np.abs(G)) ** 2
    G = G + np.sqrt(0.5 * variance) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    return ls.FRF.from_arrays(f, G, std=np.sqrt(variance))


def test_the_chosen_fit_is_the_one_without_giving_up(monkeypatch):
    P = two_masses(1e-3)
    structures = [Rational(n, d, 0, delay=True) for n, d in ((1, 2), (2, 4))]
    found = module._simplest(P, module._fitted(P, structures))
    monkeypatch.setattr(module, "PATIENCE", 10**9)
    whole = module._simplest(P, module._fitted(P, structures))
    assert found.structure == whole.structure == "rational 2/4 and delay"
    assert [p.value for p in found.parameters] == [p.value for p in whole.parameters]


def test_a_start_that_is_far_above_is_given_up(monkeypatch):
    monkeypatch.setattr(module, "PATIENCE", 5)
    with pytest.raises(module.TooFarError):
        module.fit(two_masses(1e-3), Rational(1, 4, 0, delay=True), hopeless=1.0)
