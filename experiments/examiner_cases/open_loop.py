"""Records made in open loop: how many are said to have been made in closed loop, or to grow, by `frf` and by the draft.

python experiments/examiner_cases/open_loop.py     300 records: open_loop.csv; 1 min of one core
"""

from __future__ import annotations

import csv
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import chirp, cont2discrete, lfilter, max_len_seq

import loopshape as ls
from loopshape.core.errors import LoopshapeError
from loopshape.core.units import Array
from loopshape.toolbox.formats.drafts.draft_map import draft_map

KINDS = ("steps", "square", "multisine", "sweep", "prbs")
CLAIMS = ("records", "closed by the draft", "closed by frf", "grows", "no estimate")
SEED, COUNT = 1000, 300


@dataclass(frozen=True, eq=False)
class Record:
    """What was applied, as measured, and what was answered, (n,) at a rate."""

    kind: str
    rate_hz: float
    u: Array
    y: Array


def main() -> None:
    """Draw the records and count claims."""
    counts = {kind: Counter[str]() for kind in KINDS}
    for seed in range(SEED, SEED + COUNT):
        one = drawn(seed)
        counts[one.kind].update(claims(one))
    with (Path(__file__).parent / "open_loop.csv").open("w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["excitation", *CLAIMS])
        out.writerows([kind, *(found[claim] for claim in CLAIMS)] for kind, found in counts.items())


def claims(one: Record) -> list[str]:
    """What is claimed of a record."""
    found = ["records"]
    try:
        notes = " ".join(ls.frf(ls.Run.from_arrays(u=one.u, y=one.y, rate_hz=one.rate_hz)).notes)
        found += ["closed by frf"] * ("seems to answer" in notes) + ["grows"] * ("grow" in notes)
    except LoopshapeError:
        found.append("no estimate")
    with tempfile.TemporaryDirectory() as folder:
        path, t = Path(folder) / "record.csv", np.arange(one.u.size) / one.rate_hz
        np.savetxt(path, np.stack([t, one.u, one.y], 1), "%.8g", ",", header="time_s,drive_v,position_mm", comments="")
        found += ["closed by the draft"] * ("a loop was closed" in str(draft_map(path)))
    return found


def drawn(seed: int) -> Record:
    """A plant of first to third order or with an integrator, delayed, saturating in a quarter of the records; noise of
    1e-4 to 0.1 at the sensor, coloured in two thirds, rounded in half, and noise of the input's sensor in half."""
    rng = np.random.default_rng(seed)
    rate_hz, n = float(rng.choice([20, 50, 100, 250, 500, 1000, 2000])), int(rng.integers(800, 12_000))
    b, a, f_hz = plant(rng, rate_hz)
    u = excitation(KINDS[seed % len(KINDS)], rng, n, rate_hz, f_hz)
    y = np.roll(lfilter(b, a, u - u.mean() * bool(a.sum() < 1e-9)), delay := int(rng.integers(0, 6)))
    y[:delay] = 0.0
    if rng.random() < 0.25:
        most = 1.5 * np.abs(y).max()
        y = most * np.tanh(y / most)
    e = lfilter([1.0], [1.0, -rng.choice([0.0, 0.9, 0.99])], rng.standard_normal(n))
    y = y + 10.0 ** rng.uniform(-4.0, -1.0) * y.std() * e / e.std()
    if rng.random() < 0.5:
        step = y.std() / 10.0 ** rng.uniform(1.0, 3.0)
        y = step * np.round(y / step)
    if rng.random() < 0.5:
        u = u + 10.0 ** rng.uniform(-4.0, -1.5) * u.std() * rng.standard_normal(n)
    return Record(KINDS[seed % len(KINDS)], rate_hz, u, y)


def plant(rng: np.random.Generator, rate_hz: float) -> tuple[Array, Array, float]:
    """Numerator and denominator held between samples, and where it turns."""
    f_hz = rate_hz * 10.0 ** rng.uniform(-2.6, -1.1)
    lag, damping = [1.0 / (2.0 * np.pi * f_hz), 1.0], rng.uniform(0.02, 0.7)
    mode = [lag[0] ** 2, 2.0 * damping * lag[0], 1.0]
    high = [mode[0] / 9.0, mode[1] / 3.0, 1.0]
    den = (lag, mode, np.polymul(lag, high), [*lag, 0.0])[rng.integers(4)]
    b, a, _ = cont2discrete(([1.0], den), 1.0 / rate_hz)
    return np.ravel(b), a, f_hz


def excitation(kind: str, rng: np.random.Generator, n: int, rate_hz: float, f_hz: float) -> Array:
    """What moves the plant, (n,)."""
    if kind == "steps":
        u = np.zeros(n)
        for row in np.sort(rng.choice(np.arange(20, n - 20), rng.integers(2, 9), replace=False)):
            u[row:] = rng.uniform(-1.0, 1.0)
        return u
    if kind == "square":
        period = np.clip(rate_hz / f_hz * rng.uniform(1.0, 6.0), 20.0, n / 3.0) // 1 + rng.choice([0.0, rng.random()])
        return np.where(np.arange(n) % period < period / 2.0, 1.0, rng.choice([0.0, -1.0]))
    if kind == "multisine":
        period = n // int(rng.integers(2, 8))
        lines = np.arange(1, max(4, int(period * rng.uniform(0.05, 0.4))))
        phases = rng.uniform(0.0, 2.0 * np.pi, lines.size)
        one = np.cos(2.0 * np.pi * np.outer(np.arange(period) / period, lines) + phases).sum(axis=1)
        return np.resize(one / one.std(), n)
    if kind == "sweep":
        low, high = f_hz / rng.uniform(5.0, 20.0), min(f_hz * rng.uniform(5.0, 20.0), 0.45 * rate_hz)
        t = np.arange(n) / rate_hz
        return rng.uniform(0.3, 3.0) * chirp(t, low, t[-1], high, str(rng.choice(["linear", "logarithmic"])))
    bits = 2.0 * max_len_seq(int(rng.integers(7, 12)))[0] - 1.0
    return np.resize(np.repeat(bits, int(rng.integers(1, 9))), n)


if __name__ == "__main__":
    main()
