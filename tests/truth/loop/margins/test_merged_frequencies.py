"""An FRF of very many frequencies is checked on fewer of them, and what is said of it stays true."""

import numpy as np
import pytest
from bench_nouns import Block

import loopshape as ls
from loopshape.identify.smooth.smoothing import merged
from loopshape.loop.verdict import check

RATE_HZ, LAST_HZ = 10_000.0, 4_000.0
BLOCKS = (Block("gain", {"gain": 5.0}), Block("lead_lag", {"f1_hz": 30.0, "f2_hz": 300.0}))
CONTROLLER = ls.Controller(loop="axis", rate_hz=RATE_HZ, blocks=BLOCKS)


def pair(f, at_hz, damping):
    return at_hz**2 / (at_hz**2 - f**2 + 2j * damping * at_hz * f)


def plant(f):
    """An integrator, a lag, a wide resonance and one as narrow as a few frequencies."""
    modes = 1.0 + 0.02 * pair(f, 180.0, 0.01) + 2e-4 * pair(f, 700.0, 3e-4)
    return 10.0 / (1j * f) / (1.0 + 1j * f / 2000.0) * modes


def circular(rng, n):
    return (rng.standard_normal(n) + 1j * rng.standard_normal(n)) / np.sqrt(2.0)


def frequencies(n):
    return np.arange(1, n + 1) * (LAST_HZ / n)


def measured(n, relative, seed=0, **words):
    f = frequencies(n)
    P = plant(f) * (1.0 + relative * circular(np.random.default_rng(seed), n))
    return ls.FRF.from_arrays(f, P, relative_std=relative, rate_hz=RATE_HZ, loop="axis", recording="r", **words)


def misses(frf):
    """Errors of an FRF's values in their own deviations, no less than what merging may round off."""
    std = np.sqrt(frf.variance[:, 0, 0] + (1e-4 * np.abs(frf.siso)) ** 2)
    return np.abs(frf.siso - plant(frf.frequency_hz)) / std


@pytest.mark.parametrize("relative", [0.0, 0.001, 0.01, 0.1])
def test_groups_err_as_they_say(relative):
    """For circular errors |error/deviation|² is of mean 1 and below ln(n/1e-6) nearly surely."""
    few = merged(measured(100_000, relative))
    off = misses(few) ** 2
    assert few.frequency_hz.size < 5_000
    assert off.mean() < 1.0 + 4.0 / np.sqrt(off.size)
    assert off.max() < np.log(off.size / 1e-6)
    if relative >= 0.01:
        assert off.mean() > 1.0 - 4.0 / np.sqrt(off.size)


def test_correlated_neighbours_are_counted():
    """Errors that two neighbours share half and half (an overlap of 2) fall as 1/sqrt(m/2), and not as 1/sqrt(m)."""
    n, f = 100_000, frequencies(100_000)
    white = circular(np.random.default_rng(1), n + 1)
    P = plant(f) * (1.0 + 0.01 * (white[1:] + white[:-1]) / np.sqrt(2.0))
    frf = ls.FRF.from_arrays(f, P, relative_std=0.01, rate_hz=RATE_HZ, line_overlap=2.0)
    off = misses(merged(frf)) ** 2
    assert off.mean() == pytest.approx(1.0, abs=6.0 / np.sqrt(off.size))


def test_a_smaller_frf_stays_as_it_is():
    frf = measured(20_000, 0.01)
    assert merged(frf) is frf


def test_a_narrow_resonance_and_a_frequency_that_stands_out_keep_their_place():
    """Half of the peak of the narrow one is 0.42 Hz wide, ten frequencies; one more value is off by 7 deviations."""
    n = 100_000
    f, P = frequencies(n), np.array(measured(n, 0.01).siso)
    P[60_000] *= 1.07
    few = merged(ls.FRF.from_arrays(f, P, relative_std=0.01, rate_hz=RATE_HZ))
    near = f[np.abs(f - 700.0) < 0.42]
    assert np.isin(near, few.frequency_hz).all()
    assert f[60_000] in few.frequency_hz


def test_a_frequency_that_errs_more_is_not_mixed_with_its_neighbours():
    """50 Hz from the mains: its deviation is 20 times that of the rest."""
    n = 100_000
    f, std = frequencies(n), np.full(n, 0.01)
    hum = int(np.argmin(np.abs(f - 50.0)))
    std[hum] = 0.2
    P = plant(f) * (1.0 + std * circular(np.random.default_rng(2), n))
    few = merged(ls.FRF.from_arrays(f, P, std=std * np.abs(P), rate_hz=RATE_HZ))
    assert f[hum] in few.frequency_hz
    k = int(np.searchsorted(few.frequency_hz, f[hum]))
    assert few.variance[k - 8, 0, 0] < 0.5 * (0.01 * abs(plant(f[hum]))) ** 2


def test_a_noise_that_was_stated_too_small_merges_all_the_same():
    f = frequencies(100_000)
    P = plant(f) * (1.0 + 0.01 * circular(np.random.default_rng(3), f.size))
    few = merged(ls.FRF.from_arrays(f, P, relative_std=0.002, rate_hz=RATE_HZ))
    assert few.frequency_hz.size < 10_000


def exact():
    """Peak of |S| in dB, phase margin in deg and first 0 dB crossing in Hz of the plant itself, on a fine grid."""
    f = np.unique(np.concatenate([np.geomspace(0.1, LAST_HZ, 400_001), np.linspace(150.0, 220.0, 400_001)]))
    L = CONTROLLER.response(f) * plant(f)
    k = np.flatnonzero((np.abs(L[1:]) < 1.0) != (np.abs(L[:-1]) < 1.0))
    ahead = np.degrees(np.angle(L[k])) % 360.0 - 180.0
    return 20.0 * np.log10(np.max(1.0 / np.abs(1.0 + L))), float(np.min(np.abs(ahead))), float(f[k[0]])


def margins(frf):
    return check([frf], CONTROLLER, ls.Requirements("axis", unstable_poles=0)).margins["r"]


def test_margins_of_an_exact_frf_are_those_of_the_plant():
    """|P| may be off by 1e-4: 0.001 dB, and 0.006 deg; a chord of the path adds as much again."""
    peak_db, phase_deg, first_hz = exact()
    found = margins(measured(100_000, 0.0))
    assert found.stable == "stable"
    assert found.sensitivity_peak_db == pytest.approx(peak_db, abs=2e-3)
    assert found.phase_margin_deg == pytest.approx(phase_deg, abs=0.05)
    assert found.crossings_hz[0] == pytest.approx(first_hz, rel=2e-4)


@pytest.mark.long
def test_intervals_hold_the_truth():
    """Of 16 intervals of 95 % fewer than 12 hold the truth once in 3000 cases."""
    peak_db, phase_deg, _ = exact()
    held = []
    for seed in range(16):
        ends = margins(measured(40_000, 0.03, seed)).intervals
        truth = {"sensitivity_peak_db": peak_db, "phase_margin_deg": phase_deg}
        held.append([ends[name][0] <= value <= ends[name][1] for name, value in truth.items()])
    assert np.sum(held, axis=0).min() >= 12


def test_a_resonance_between_frequencies_is_not_merged_away():
    """One of 1e-6 damping, a tenth of the spacing wide, whose circle holds -1: it must not pass for stable."""
    n = 40_000
    f, rng = frequencies(n), np.random.default_rng(4)
    at_hz = float(f[9_000] + 0.5 * (f[1] - f[0]))
    P = (plant(f) - 3e-4 * pair(f, at_hz, 1e-5)) * (1.0 + 0.001 * circular(rng, n))
    frf = ls.FRF.from_arrays(f, P, relative_std=0.001, rate_hz=RATE_HZ, loop="axis", recording="r")
    assert margins(frf).stable != "stable"
    assert margins(measured(n, 0.001)).stable == "stable"
