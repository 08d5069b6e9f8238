"""Random loops whose lines are cut below, cut above, or have a hole: no limit is decided wrongly where stability is.

Truths are read off 400,000 frequencies of the formulas. Required is what holds by 15 or 50 %, or fails by as much.
"""

import numpy as np
import pytest
from conversions import TWO_PI, db

import loopshape as ls

RATE = 2000.0
HALF = 10.0**-0.15
PEAKS = ("sensitivity_peak_db", "complementary_peak_db", "control_peak_db", "process_peak_db")


def drawn(rng):
    """A plant with a delay, its poles at 0, and a controller with a crossover."""
    kind, w, delay_s = rng.integers(5), TWO_PI * 10.0 ** rng.uniform(-0.3, 0.7), 10.0 ** rng.uniform(-3.0, -2.2)
    modes = [
        (TWO_PI * 10.0 ** rng.uniform(1.2, 1.9), 10.0 ** rng.uniform(-2.3, -0.7), 10.0 ** rng.uniform(-2.0, -0.3))
        for _ in range(rng.integers(3))
    ]
    crossover_hz = 10.0 ** rng.uniform(0.3, 1.1)

    def rigid(s):
        return (
            1.0 / (1.0 + s / w), 1.0 / (s * (1.0 + 5.0 * s / w)), 1.0 / (s * (s + w)),
            1.0 / ((1.0 + s / w) * (1.0 + s / (3.0 * w))), w / (s * (s + w)) * (1.0 + s / (20.0 * w)),
        )[kind]  # fmt: skip

    size = 0.3 * abs(rigid(1j * TWO_PI * crossover_hz))

    def plant(f):
        s = 1j * TWO_PI * f
        added = sum(r * size / (s * s / a**2 + 2.0 * z * s / a + 1.0) for a, z, r in modes)
        return (rigid(s) + added) * np.exp(-s * delay_s)

    blocks = [ls.gain(1.0)]
    blocks += [ls.lead_lag(crossover_hz / 3.0, 3.0 * crossover_hz)] if rng.random() < 0.6 else []
    blocks += [ls.pi(crossover_hz / 10.0 ** rng.uniform(0.7, 1.3))] if rng.random() < 0.5 else []
    blocks += [ls.low_pass(10.0 * crossover_hz, 0.7)] if rng.random() < 0.4 else []
    at = np.array([crossover_hz])
    blocks[0] = ls.gain(1.0 / abs(plant(at)[0] * ls.controller(*blocks, rate_hz=RATE).response(at)[0]))
    return plant, ls.controller(*blocks, rate_hz=RATE), (0, 1, 1, 0, 1)[kind], crossover_hz


def truths(f, P, C):
    L, known = P * C, f < 0.45 * RATE
    S, size = 1.0 / (1.0 + L), np.abs(L)
    T = L * S
    found = dict(zip(PEAKS, (db(np.abs(x)).max() for x in (S, T, (C * S)[known], P * S)), strict=True))
    falls, rises = (size[:-1] >= 1.0) & (size[1:] < 1.0), (np.abs(S[:-1]) < HALF) & (np.abs(S[1:]) >= HALF)
    late = (np.abs(T[:-1]) >= HALF) & (np.abs(T[1:]) < HALF)
    found |= {"modulus_margin": np.abs(1.0 + L).min(), "disk_margin": np.abs(2.0 * (1.0 + L) / (1.0 - L)).min()}
    found |= {"bandwidth_hz": f[:-1][falls][:1], "sensitivity_bandwidth_hz": f[:-1][rises][:1]}
    found |= {"complementary_bandwidth_hz": f[:-1][late][-1:]}
    crossed = np.flatnonzero(np.diff(size >= 1.0))
    turned = np.angle(-L[crossed])
    found |= {"phase_margin_deg": np.abs(np.degrees(turned)), "delay_margin_s": turned % TWO_PI / (TWO_PI * f[crossed])}
    real = db(1.0 / size[np.flatnonzero((np.diff(L.imag >= 0.0)) & (L.real[:-1] < 0.0))])
    found |= {"gain_margin_db": real[real > 0.0], "gain_reduction_margin_db": -real[real < 0.0]}
    near = [np.flatnonzero((k * size[:-1] >= 1.0) & (k * size[1:] < 1.0))[:1] for k in (0.95, 1.05)]
    if not all(x.size for x in near) or f[near[1]] > 1.3 * f[near[0]]:  # |L| hardly crosses 1 there
        del found["bandwidth_hz"]
    return {name: float(np.min(value)) for name, value in found.items() if np.size(value)}


def asked(rng, truth):
    """Requirements within what a file may ask, and whether each holds."""
    required, holds = {}, {}
    for name, value in truth.items():
        sign, share = rng.choice([-1.0, 1.0]), 1.0 + rng.choice([0.15, 0.5])
        limit = value + sign * db(share) if name.endswith("_db") else value * share**sign
        top = {"disk_margin": 2.0, "modulus_margin": 1.0, "phase_margin_deg": 180.0}.get(name, np.inf)
        if limit < top and (limit > 0.0 or (name in PEAKS and name != "sensitivity_peak_db")):
            required[name], holds[name] = float(limit), (value <= limit) == (name in PEAKS)
    return required, holds


def measured(rng, plant, crossover_hz):
    """An FRF with 0.1 to 5 % of noise, whole or with a part of its lines left out."""
    low, high, kind = crossover_hz / 30.0, min(20.0 * crossover_hz, 0.4 * RATE), rng.integers(4)
    low = crossover_hz * 10.0 ** rng.uniform(-1.0, 0.5) if kind == 1 else low
    high = crossover_hz * 10.0 ** rng.uniform(0.0, 0.8) if kind == 2 else high
    f = np.geomspace(low, high, 200)
    if kind == 3:
        begins = crossover_hz * 10.0 ** rng.uniform(-0.7, 0.5)
        f = f[(f < begins) | (f > begins * 10.0 ** rng.uniform(0.1, 0.4))]
    noise = float(rng.choice([0.001, 0.01, 0.05]))
    error = noise * np.sqrt(0.5) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    return ls.FRF.from_arrays(f, plant(f) * (1.0 + error), relative_std=noise, rate_hz=RATE, open_loop=True)


@pytest.mark.long
def test_no_limit_is_decided_wrongly_where_stability_is_decided():
    """|L| and |P| stay below their last values above the lines, as every bound takes them to."""
    grid, wrong, decided = np.geomspace(1e-4, 0.49 * RATE, 400_000), [], 0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        plant, C, integrators, crossover_hz = drawn(rng)
        P, own = plant(grid), C.response(grid)
        turned_deg = np.degrees(np.diff(np.unwrap(np.angle(1.0 + P * own))[[0, -1]]))[0]
        truth, FRF = truths(grid, P, own), measured(rng, plant, crossover_hz)
        above = grid > FRF.frequency_hz[-1]
        quiet = all(np.abs(x[above]).max() <= 1.001 * np.abs(x[above][0]) for x in (P * own, P))
        if (
            abs(turned_deg - 90.0 * (integrators + C.integrators())) > 30.0
            or truth["modulus_margin"] < 0.15
            or not quiet
        ):
            continue
        required, holds = asked(rng, truth)
        verdict = ls.check(FRF, C, ls.Requirements(**required, integrators=integrators, unstable_poles=0))
        (m,) = verdict.margins.values()
        assert m.stable != "unstable"
        lines = [x for x in verdict.lines if x.outcome != "undecided" and m.stable == "stable" and x.quantity in holds]
        decided += len(lines)
        wrong += [(seed, x) for x in lines if x.passed != holds[x.quantity]]
    assert decided > 1000
    assert wrong == []
