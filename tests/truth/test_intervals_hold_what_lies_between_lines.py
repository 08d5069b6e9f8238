"""Lines without noise to speak of: intervals of margins hold what the chords between them leave; truths by roots."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from loopshape.loop.verdict import check

STUDIES = Path(__file__).parents[2] / "experiments"
NOISE = 1e-6


def exact(loop, gain, f):
    """Gain margin in dB and phase margin in deg of gain times a loop, inf without crossing."""
    L = gain * loop.response(f)

    def at(x):
        return gain * loop.response(np.array([x]))[0]

    def roots(y, function):
        return [brentq(function, f[k], f[k + 1], xtol=1e-14, rtol=1e-14) for k in np.flatnonzero(y[:-1] * y[1:] < 0.0)]

    axis = [-at(x).real for x in roots(L.imag, lambda x: at(x).imag)]
    inner = [x for x in axis if 0.0 < x < 1.0]
    angles = [abs(180.0 - abs(np.degrees(np.angle(at(x))))) for x in roots(np.abs(L) - 1.0, lambda x: abs(at(x)) - 1.0)]
    return {
        "gain_margin_db": -20.0 * np.log10(max(inner)) if inner else np.inf,
        "phase_margin_deg": min(angles, default=np.inf),
    }


@pytest.mark.long
def test_intervals_of_lines_known_to_a_millionth_hold_the_truth(monkeypatch):
    for name in ("examiner_cases", "certificate"):
        monkeypatch.syspath_prepend(str(STUDIES / name))
    import spoiled

    rng, held = np.random.default_rng(11), {"gain_margin_db": [], "phase_margin_deg": []}
    while len(held["gain_margin_db"]) < 40:
        one = spoiled.draw(rng, "sound")
        if not one.stable:
            continue
        P = one.plant.response(one.frf.frequency_hz)
        errors = NOISE * np.abs(P) * np.sqrt(0.5) * (rng.standard_normal(P.size) + 1j * rng.standard_normal(P.size))
        G, variance = (P + errors)[:, None, None], ((NOISE * np.abs(P)) ** 2)[:, None, None] + 0j
        frf = replace(one.frf, response=G, covariance=variance, trusted=np.ones(P.size, dtype=bool))
        (read,) = check([frf], one.controller, one.asked, detuned=False).margins.values()
        gain, *blocks = one.controller.blocks
        loop = spoiled.in_series(one.plant, tuple(blocks))
        truths = exact(loop, gain.parameters["gain"], spoiled.dense_hz(loop))
        for name, truth in truths.items():
            if read.stable == "stable" and np.isfinite(truth) and truth < 60.0 and name in read.intervals:
                low, high = read.intervals[name]
                held[name].append(low <= truth <= high and high - low < 0.01 * truth + 0.2)
    for name in ("spoiled", "run", "loops"):
        sys.modules.pop(name, None)
    assert all(np.mean(kept) >= 0.9 for kept in held.values()), {name: np.mean(kept) for name, kept in held.items()}
