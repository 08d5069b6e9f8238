"""Lines almost without noise: do intervals of margins hold what lies between them? Truths by root finding.

python experiments/examiner_cases/between.py     150 loops each at 1e-6 and 1 % of noise: between.csv; 4 min of one core
"""

from __future__ import annotations

import csv
import sys
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import brentq, minimize_scalar

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "certificate")]

from spoiled import MOST, dense_hz, draw, in_series  # noqa: E402

from loopshape.core.units import Array  # noqa: E402
from loopshape.data.response.model import TransferFunction  # noqa: E402
from loopshape.loop.verdict import check  # noqa: E402

NOISE, COUNT, SEED = (1e-6, 1e-2), 150, 11
Held = dict[str, list[bool]]


def held(noise: float, count: int, seed: int) -> Held:
    """Whether the interval of each quantity of stable, decided loops holds the truth; bounds are left out."""
    rng, out, drawn = np.random.default_rng(seed), defaultdict(list), 0
    while drawn < count:
        one = draw(rng, "sound")
        if not one.stable:
            continue
        drawn += 1
        P = one.plant.response(one.frf.frequency_hz)
        errors = noise * np.abs(P) * np.sqrt(0.5) * (rng.standard_normal(P.size) + 1j * rng.standard_normal(P.size))
        G, covariance = (P + errors)[:, None, None], ((noise * np.abs(P)) ** 2)[:, None, None] + 0j
        frf = replace(one.frf, response=G, covariance=covariance, valid=np.ones(P.size, dtype=bool))
        (read,) = check([frf], one.controller, one.asked).margins.values()
        gain, *blocks = one.controller.blocks
        loop = in_series(one.plant, tuple(blocks))
        for name, truth in exact(loop, gain.parameters["gain"], dense_hz(loop)).items():
            asked = read.stable == "stable" and truth < MOST.get(name, np.inf) and name not in read.bounds
            if asked and name in read.intervals:
                low, high = read.intervals[name]
                out[name].append(bool(low <= truth <= high))
    return dict(out)


def exact(loop: TransferFunction, gain: float, f: Array) -> dict[str, float]:
    """Margins by their definitions, from roots and minima between the points of a dense grid (nf,) in Hz."""

    def at(hz: float) -> complex:
        return complex(gain * loop.response(np.array([hz]))[0])

    def roots(of: Callable[[float], float], y: Array) -> list[float]:
        rows = np.flatnonzero(y[:-1] * y[1:] < 0.0)
        return [brentq(of, f[k], f[k + 1], xtol=1e-14, rtol=1e-14) for k in rows]

    def least(of: Callable[[float], float], y: Array) -> float:
        k, last = int(np.argmin(y)), f.size - 1
        ends = f[max(k - 1, 0)], f[min(k + 1, last)]
        return min(float(y[k]), float(minimize_scalar(of, bounds=ends, method="bounded").fun))

    L = gain * loop.response(f)
    sizes = [-at(hz).real for hz in roots(lambda hz: at(hz).imag, L.imag)]
    if abs(L[0].imag) < 1e-3 * abs(L[0].real):  # without integrators: the axis is met at 0 Hz
        sizes.append(-L[0].real)
    inner, outer = [x for x in sizes if 0.0 < x < 1.0], [x for x in sizes if x >= 1.0]
    angles = [
        abs(180.0 - abs(np.degrees(np.angle(at(hz))))) for hz in roots(lambda hz: abs(at(hz)) - 1.0, np.abs(L) - 1.0)
    ]
    peak = -least(lambda hz: -abs(at(hz) / (1.0 + at(hz))), -np.abs(L / (1.0 + L)))
    return {
        "modulus_margin": least(lambda hz: abs(1.0 + at(hz)), np.abs(1.0 + L)),
        "complementary_peak_db": 20.0 * np.log10(peak),
        "gain_margin_db": -20.0 * np.log10(max(inner)) if inner else np.inf,
        "gain_reduction_margin_db": 20.0 * np.log10(min(outer)) if outer else np.inf,
        "phase_margin_deg": min(angles, default=np.inf),
    }


def main() -> None:
    """Count at each noise."""
    with (HERE / "between.csv").open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(("noise", "quantity", "loops", "held"))
        for noise in NOISE:
            found = held(noise, COUNT, SEED)
            out.writerows((noise, name, len(kept), f"{np.mean(kept):.3f}") for name, kept in found.items())
            every = [x for kept in found.values() for x in kept]
            out.writerow((noise, "all", len(every), f"{np.mean(every):.3f}"))


if __name__ == "__main__":
    main()
