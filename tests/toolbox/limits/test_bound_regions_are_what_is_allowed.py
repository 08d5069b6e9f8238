"""The region of Q at one frequency: what the margins of all plants allow by their definition, no more than its hull."""

import numpy as np
import pytest
from bench_nouns import TransferFunction
from bound_cases import gain, limits, loop_of
from conversions import TWO_PI, from_db

from loopshape.toolbox.limits.bound_nodes import nodes
from loopshape.toolbox.limits.bound_regions import regions

GRID = 401
ASKED = {
    "S, T and CS": {"sensitivity_peak_db": 6.0, "complementary_peak_db": 3.0, "control_peak_db": 14.0},
    "disk and PS": {"disk_margin": 0.8, "process_peak_db": 3.0},
    "modulus and CS": {"modulus_margin": 0.6, "control_peak_db": 9.0},
}
HS = np.exp(1j * TWO_PI * (np.arange(8) + 0.3) / 8)


def plant(k, f_hz, delay=0.01):
    w = TWO_PI * f_hz
    return TransferFunction([k], np.polymul([1.0, 0.0], [1.0 / w**2, 0.2 / w, 1.0]), delay)


def allowed(C, Ps, asked, crossing):
    """Whether each C keeps what is asked on every plant, straight from the definitions of the margins."""
    good = np.ones(C.shape, dtype=bool)
    for P in Ps:
        L = C * P
        S = 1.0 / (1.0 + L)
        sizes = {
            "sensitivity_peak_db": np.abs(S), "complementary_peak_db": np.abs(L * S), "control_peak_db": np.abs(C * S),
            "process_peak_db": np.abs(P * S),
        }  # fmt: skip
        for name, value in asked.items():
            if name in sizes:
                good &= sizes[name] <= from_db(value)
        good &= np.abs(1.0 + L) >= asked.get("modulus_margin", 0.0)
        good &= np.abs(2.0 * (1.0 + L) / (1.0 - L)) >= asked.get("disk_margin", 0.0)
        good &= (np.abs(L) >= 1.0) | (not crossing)
    return good


@pytest.mark.parametrize("what", ASKED)
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("unstable", [0, 1])  # chooses the parameter: CS itself, or that about a controller
def test_support_is_that_of_what_is_allowed(what, several, unstable, monkeypatch):
    monkeypatch.setattr("loopshape.toolbox.limits.bound_nodes.closed_loop_stability", lambda loop: Stable)
    models = [plant(2.0, 5.0), plant(0.9, 6.0), plant(4.0, 4.5)][: 3 if several else 1]
    loops = [loop_of(m, gain(1.5), 1, unstable, name=str(n), lines=2000) for n, m in enumerate(models)]
    asked = limits(**ASKED[what])
    at = nodes(loops[0], asked)
    found = regions(at, asked, loops)
    seen = 0
    for f_hz in (0.2, 0.7, 1.5, 4.0, 5.5, 9.0):
        k = int(np.argmin(np.abs(at.f - f_hz)))
        x = np.linspace(-1.0, 1.0, GRID)
        Q = found.centre[k] + found.extent[k] * (x[:, None] + 1j * x)
        C = (at.r0[k] + at.r1[k] * Q) / (at.s0[k] + at.s1[k] * Q)
        Ps = [one.response(at.f[k : k + 1])[0] for one in models]
        for crossing in (False, True):
            inside = Q[allowed(C, Ps, ASKED[what], crossing)]
            support = [found.at(np.array([k])).support(np.array([h]), crossing=crossing)[0] for h in HS]
            if inside.size < 200:  # thinner than the grid shows
                continue
            seen += 1
            most = np.array([np.real(h * inside).max() for h in HS])
            step = 2.0 * found.extent[k] / (GRID - 1)
            assert np.all(most <= np.array(support) + 1e-4 * found.extent[k])
            assert np.all(most >= np.array(support) - 6.0 * step)  # corners may lie between the grid's points
    assert seen >= 4


class Stable:
    """What the count of encirclements would say."""

    outcome, reason = "stable", ""
