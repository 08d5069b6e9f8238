"""How often `compare` contradicts a prediction that is true, and what it finds: results.csv.

A lag of second order with a delay, held by two controllers one after the other; prediction from the first record,
comparison with the second. Noise at the sensor has the spectrum of a first-order lag. The plant of the second record is
the same, or has another gain.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import control
import numpy as np
from scipy.signal import lfilter
from scipy.stats import binom

import loopshape as ls
from loopshape.core.units import TWO_PI
from loopshape.toolbox.rig.excitation.multisine import Multisine

HERE = Path(__file__).parent
RATE_HZ = 500.0
F_HZ = 6.0
NOISE = 0.01
#: excitation: periods of 4 s, or 0 for white noise of 60 s
PERIODS = (4, 16, 0)
GAINS_DB = (0.0, 0.5, 1.0)
COLUMNS = ("excitation", "gain_db", "pairs", "contradicted", "share", "low", "high")


def plant(gain_db: float) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator in z^-1 of the sampled plant, two samples late."""
    w = TWO_PI * F_HZ
    system = control.c2d(control.tf([w**2], [1.0, 0.8 * w, w**2]), 1.0 / RATE_HZ)
    numerator, denominator = system.num[0][0], system.den[0][0]
    lead = denominator.size - numerator.size
    return 10.0 ** (gain_db / 20.0) * np.r_[np.zeros(lead + 1), numerator], np.r_[denominator, 0.0]


def polynomials(C: ls.Controller) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator in z^-1 of a controller, from its sections as they run."""
    numerator, denominator = np.ones(1), np.ones(1)
    for row in C.biquads():
        numerator, denominator = np.convolve(numerator, row[:3]), np.convolve(denominator, np.r_[1.0, row[-2:]])
    return numerator, denominator


def record(C: ls.Controller, gain_db: float, periods: int, rng: np.random.Generator) -> ls.Run:
    """A closed-loop record with the excitation in front of the controller: y = P z, z = C (n - y - noise)."""
    n = excitation(periods, rng)
    (b, a), (d, c) = plant(gain_db), polynomials(C)
    noise = lfilter([1.0], [1.0, -0.9], NOISE * np.sqrt(1.0 - 0.81) * rng.standard_normal(n.size))
    forward, closed = np.convolve(b, d), np.convolve(a, c)
    size = max(forward.size, closed.size)
    whole = np.pad(closed, (0, size - closed.size)) + np.pad(forward, (0, size - forward.size))
    y = lfilter(forward, whole, n - noise)
    z = lfilter(*polynomials(C), n - y - noise)
    settled = slice(round(5.0 * RATE_HZ), round((5.0 + 4.0 * periods) * RATE_HZ)) if periods else slice(None)
    made = {"u": z[settled], "y": (y + noise)[settled], "excitation": n[settled]}
    return ls.Run.from_arrays(**made, rate_hz=RATE_HZ, controller=C, period_s=4.0 if periods else None)


def excitation(periods: int, rng: np.random.Generator) -> np.ndarray:
    """A ramp, a period to settle and whole periods of a multisine; or noise."""
    if not periods:
        return rng.standard_normal(round(60.0 * RATE_HZ))
    seed = int(rng.integers(1_000_000))
    return Multisine(0.5, 40.0, 4.0, 1.0, periods=periods + 1, seed=seed, ramp_s=1.0).signal(RATE_HZ)


def pair(gain_db: float, periods: int, seed: int) -> str:
    """Outcome of one comparison."""
    rng = np.random.default_rng([17, round(100 * gain_db), periods, seed])
    before = ls.controller(ls.gain(0.4), rate_hz=RATE_HZ, loop="loop")
    after = ls.controller(ls.gain(0.7), ls.lead_lag(4.0, 30.0), rate_hz=RATE_HZ, loop="loop")
    predicted = ls.predict(ls.frf(record(before, 0.0, periods, rng)), after)
    (found,) = ls.compare(record(after, gain_db, periods, rng), predicted)
    return str(found.comparisons[0].outcome)


def main(pairs: int = 300) -> None:
    """All cells of the table, with the 95 % interval of each share (Clopper and Pearson)."""
    with (HERE / "results.csv").open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(COLUMNS)
        for periods in PERIODS:
            for gain_db in GAINS_DB:
                count = pairs * (3 if periods else 1) // (1 if gain_db == 0.0 else 3)
                bad = sum(pair(gain_db, periods, seed) == "refuted" for seed in range(count))
                low, high = interval(bad, count)
                kind = f"{periods} periods" if periods else "noise, 60 s"
                row = [kind, gain_db, count, bad, f"{bad / count:.3f}", f"{low:.3f}", f"{high:.3f}"]
                out.writerow(row)
                file.flush()
                print(*row)


def interval(k: int, n: int) -> tuple[float, float]:
    """Shares p at which k of n or more, or k or fewer, have a chance of 2.5 %."""
    p = np.linspace(0.0, 1.0, 20_001)
    return float(p[binom.sf(k - 1, n, p) >= 0.025][0]), float(p[binom.cdf(k, n, p) >= 0.025][-1])


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
