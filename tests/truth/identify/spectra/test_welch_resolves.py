"""Welch's automatic segments resolve three lightly damped modes, or say which lines they do not."""

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from conversions import TWO_PI
from scipy.signal import cont2discrete, freqz, lfilter

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.welch import by_welch

RATE, RECORDS = 250.0, 25
LOOP = LoopSetup("axis", None, None, "u_v", "y_m", None)
MODES = (11.0, 24.0, 41.0)
REACH = -np.log(0.05)
WELCH = Settings("direct", method="welch")


def held(damping):
    """Three modes in a row of equal strength, exactly held."""
    num, den = np.zeros(1), np.ones(1)
    for f in MODES:
        w = TWO_PI * f
        part = np.array([1.0, 2.0 * damping * w, w**2])
        num, den = (
            np.polyadd(np.polymul(num, part), np.array([w**2]) if den.size == 1 else w**2 * den),
            np.polymul(den, part),
        )
    b, a, _ = cont2discrete((num, den), 1.0 / RATE)
    return b.ravel(), a


def record(damping, length_s, seed):
    b, a = held(damping)
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(round(length_s * RATE) + 4000)  # settled where the record begins
    y = lfilter(b, a, u)
    y += 0.05 * y.std() * rng.standard_normal(y.size)
    info = RecordingInfo("r1.parquet", "noise", "control", excites="axis", closed_loop=False)
    return ls.Recording(info, RATE, {"u_v": u[4000:], "y_m": y[4000:]})


def answers(damping, length_s, seed, settings=WELCH):
    r = record(damping, length_s, seed)
    found = by_welch(r, [r.columns["y_m"]], [r.columns["u_v"]], settings)
    return found, freqz(*held(damping), worN=TWO_PI * found.frequency_hz / RATE)[1]


def near(f_hz, width=0.5):
    return np.abs(f_hz[:, None] - np.array(MODES)).min(axis=1) < width


@pytest.mark.parametrize("length_s", [40.0, 120.0])
def test_lines_that_count_as_resolved_hold_their_circles(length_s):
    held_lines, every = [], []
    for seed in range(RECORDS):
        a, truth = answers(0.01, length_s, seed)
        error = np.abs(a.response[:, 0, 0] - truth) ** 2 / a.covariance[:, 0, 0].real
        rows = near(a.frequency_hz)
        every += (error[rows] < REACH).tolist()
        held_lines += (error[rows & ~a.unresolved] < REACH).tolist()
    assert len(held_lines) > 2 * RECORDS
    # nine averages: 1 - (1 + 3.0/8)^-8 = 0.92; the tenth of a record that was taken before gives 0.5 at 40 s
    assert np.mean(held_lines) > 0.9
    assert np.mean(every) > 0.88


def test_segments_become_longer_and_what_stays_unresolved_is_outside_the_valid_band():
    frf = estimate_frf(record(0.01, 20.0, 1), LOOP, WELCH)
    assert frf.frequency_hz[1] - frf.frequency_hz[0] == pytest.approx(0.25)  # 0.5 Hz for a tenth of 20 s
    (note,) = [n for n in frf.notes if "a resonance is narrower than the lines, 0.25 Hz apart, can show" in n]
    assert "outside the valid band" in note
    truth = freqz(*held(0.01), worN=TWO_PI * frf.frequency_hz / RATE)[1]
    wrong = near(frf.frequency_hz, 0.2) & (np.abs(frf.siso / truth - 1.0) > 0.1)
    assert wrong.any()
    assert not (frf.valid & wrong).any()
    assert frf.valid[(frf.frequency_hz > 2.0) & (frf.frequency_hz < 8.0)].all()


def test_a_resolution_that_was_asked_for_is_kept_and_its_bias_is_told():
    frf = estimate_frf(record(0.01, 20.0, 1), LOOP, Settings("direct", method="welch", resolution_hz=0.5))
    assert np.allclose(np.diff(frf.frequency_hz), 0.5)
    assert any("0.5 Hz apart" in n and "taken as they are" in n for n in frf.notes)


def test_well_damped_modes_change_nothing():
    for seed in range(40):
        a, _ = answers(0.3, 20.0, seed)
        assert a.frequency_hz[1] == pytest.approx(0.5)
        assert not a.unresolved.any()
        assert a.notes == ()
