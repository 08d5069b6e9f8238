"""Outputs in m, um or bar and inputs in V or kN are one machine: no outcome, margin or interval of several loops moves.

A diagonal change of units is a similarity of the loop: eigenvalues, det(I + L) and structured singular values stay.
"""

import numpy as np
import pytest
from conversions import TWO_PI

import loopshape as ls

RATE_HZ = 1000.0


def drawn(rng, n):
    """Frequencies, a plant (nf, n, n) of coupled lags, resonances and delays, and the controllers' gains."""
    f = np.geomspace(0.2, 120.0, 60)
    s = 1j * TWO_PI * f[:, None, None]
    corner, mode = TWO_PI * 10.0 ** rng.uniform(0.2, 1.0, (2, n, n)) * np.array([1.0, 6.0])[:, None, None]
    size = rng.standard_normal((n, n)) * 0.3 * (1.0 - np.eye(n)) + np.eye(n)
    P = size / (1.0 + s / corner) / (1.0 + 0.4 * s / mode + (s / mode) ** 2) * np.exp(-0.003 * s)
    return f, P, 10.0 ** rng.uniform(0.0, 0.6, n)


def verdict(f, P, std, gains, outputs, inputs):
    """The verdict in units of the channels that are `outputs` and `inputs` times smaller."""
    units = outputs[:, None] * inputs
    n = len(gains)
    y, u = ("y0_rad", "y1_m", "y2_bar"), ("u0_V", "u1_V", "u2_V")
    plant = ls.FRF.from_arrays(f, P * units, std=std * units, rate_hz=RATE_HZ, outputs=y[:n], inputs=u[:n])
    C = [
        ls.controller(ls.gain(float(g / own)), ls.pi(1.0), rate_hz=RATE_HZ, loop=name)
        for name, g, own in zip(u, gains, outputs * inputs, strict=False)
    ]
    R = [ls.Requirements(c.loop, phase_margin_deg=40.0, modulus_margin=0.5, bandwidth_hz=2.0) for c in C]
    together = ls.Requirements(
        disk_margin=0.5, modulus_margin=0.4, input_output_disk_margin=0.25, unstable_poles=0, integrators=0
    )
    return ls.check(plant, C, R, together=together)


def readings(found):
    """Every number of a verdict, and every outcome."""
    lines = [line for part in found.parts for line in part.lines]
    ends = [end for x in lines for end in (x.value, *(x.interval or (np.nan, np.nan)))]
    return np.array(ends), [found.outcome, *found.stabilities, *(x.outcome for x in lines)]


@pytest.mark.parametrize(
    ("n", "noise", "seed"), [(2, 0.0, 1), (2, 0.02, 2), (2, 0.1, 3), (3, 0.0, 4), (3, 0.05, 5), (3, 0.05, 6)]
)
def test_units_of_outputs_and_inputs_change_no_verdict(n, noise, seed):
    rng = np.random.default_rng(seed)
    f, P, gains = drawn(rng, n)
    std = noise * np.abs(P)
    P = P + std * np.sqrt(0.5) * (rng.standard_normal(P.shape) + 1j * rng.standard_normal(P.shape))
    values, outcomes = readings(verdict(f, P, std, gains, np.ones(n), np.ones(n)))
    for outputs, inputs in 10.0 ** rng.uniform(-6.0, 6.0, (3, 2, n)):
        moved, decided = readings(verdict(f, P, std, gains, outputs, inputs))
        assert decided == outcomes
        np.testing.assert_allclose(moved, values, rtol=1e-3, atol=1e-6)
