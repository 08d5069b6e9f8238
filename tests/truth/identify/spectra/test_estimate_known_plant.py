"""Known plant in, known response out: every excitation, every place to inject, and the sign of the phase."""

import numpy as np
import pytest
from bench_nouns import RecordingInfo
from excitations import band_noise, multisine, up_and_down
from known_loops import LOOP, RATE, estimates, plant, record, run_loop

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings

PLACES = ("controller_input", "plant_input", "reference", "control")
PERIOD = {"period_s": 4.0, "from_s": 1.0}
EXCITATIONS = {
    "noise": (band_noise(0.5, 40.0, 202.0, RATE, seed=3), {}),
    "sweep": (up_and_down(0.2, 45.0, 202.0, RATE), {}),
    "multisine": (multisine(0.25, 40.0, 4.0, RATE, periods=50, seed=3), PERIOD),
}


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", EXCITATIONS)
def test_the_response_is_the_plants_within_its_own_standard_deviation(kind, place):
    # |d|²/var of an exact answer is 1 on average; with 200 independent lines of 19 averages its mean scatters by 0.1.
    # A sweep's variance errs on the safe side (test_estimate_variance). One of 400 lines passes 4.5 once in 1000 runs.
    n, period = EXCITATIONS[kind]
    v = 0.02 * np.random.default_rng(7).standard_normal((1, n.size))
    frf = estimates(place, kind, n, v, **period)[0].between(0.6, 39.5).valid_lines()  # clear of the excitation's edges
    d = np.abs(frf.siso - plant(frf.frequency_hz)) / np.sqrt(frf.variance[:, 0, 0])
    assert frf.frequency_hz.size > 50
    assert (0.4 if kind == "sweep" else 0.6) < np.mean(d**2) < 1.5
    assert d.max() < 4.5
    assert not frf.notes


@pytest.mark.parametrize("place", PLACES)
def test_by_periods_without_noise_the_answer_is_exact(place):
    n = multisine(0.25, 40.0, 4.0, RATE, periods=6, seed=1)
    frf = estimates(place, "multisine", n, np.zeros((1, n.size)), period_s=4.0, from_s=5.0)[0]
    np.testing.assert_allclose(frf.siso, plant(frf.frequency_hz), rtol=1e-9)
    np.testing.assert_allclose(frf.frequency_hz, np.arange(1, 161) / 4.0, rtol=1e-12)


def test_only_the_lines_of_a_sparse_multisine_are_answered():
    lines = (0.5, 1.0, 3.25, 7.75, 11.0)
    n = multisine(0.5, 11.0, 4.0, RATE, periods=6, seed=1, lines_hz=lines)
    v = 0.01 * np.random.default_rng(0).standard_normal((1, n.size))
    frf = estimates("controller_input", "multisine", n, v, **PERIOD)[0]
    np.testing.assert_allclose(frf.frequency_hz, lines, rtol=1e-12)


def test_a_delay_is_a_lag_and_a_gain_keeps_its_sign():
    x = np.random.default_rng(2).standard_normal(20000)
    y = -3.0 * np.concatenate([np.zeros(4), x[:-4]])
    info = RecordingInfo("r1.parquet", "noise", "control", excites="axis", closed_loop=False)
    frf = estimate_frf(ls.Recording(info, RATE, {"z_v": x, "y_rad": y}), LOOP).between(0.5, 10.0)
    f = frf.frequency_hz
    # Hann segments of 20 s lose 0.04 s at an end: the answer is off by the delay's share of a segment, 0.2 %
    np.testing.assert_allclose(frf.siso, -3.0 * np.exp(-2j * np.pi * f * 4 / RATE), rtol=0.02)
    slope = np.polyfit(f, np.unwrap(np.angle(-frf.siso)), 1)[0]
    assert slope == pytest.approx(-2.0 * np.pi * 4 / RATE, rel=0.01)


def test_what_enters_the_plant_is_its_input_also_where_n_enters_there():
    n = band_noise(0.5, 40.0, 100.0, RATE, seed=1)
    frf = estimates("plant_input", "noise", n, np.zeros((1, n.size)))[0].between(1.0, 20.0)
    z, _ = run_loop("plant_input", n, np.zeros(n.size))
    apart = np.abs(frf.siso / plant(frf.frequency_hz) - 1.0)
    assert np.median(apart) < 0.01
    assert np.ptp(z) > 0.1  # n alone or z alone as input would be another plant
    assert frf.inputs == ("z_v",)
    assert frf.outputs == ("y_rad",)


def settling(amplitude):
    n = multisine(0.25, 20.0, 4.0, RATE, periods=6, seed=1, ramp_s=0.0)
    v = 0.01 * np.random.default_rng(4).standard_normal(n.size)
    z, y = run_loop("controller_input", n, v)
    drift = amplitude * np.exp(-np.arange(n.size) / RATE / 0.5)
    return estimate_frf(record("controller_input", "multisine", n, z, y + drift, 4.0, 0.0), LOOP)


def test_a_first_period_that_has_not_settled_is_left_out():
    frf = settling(5.0)
    assert "5 periods of 4 s, the first left out (not settled)" in frf.method
    valid = frf.valid_lines()
    d = np.abs(valid.siso - plant(valid.frequency_hz)) / np.sqrt(valid.variance[:, 0, 0])
    assert np.mean(d**2) < 1.5  # 40 degrees of freedom: E[|d|²/var] is 1.05; with the transient in it is over 100


def test_a_settled_first_period_is_kept():
    n = multisine(0.25, 20.0, 4.0, RATE, periods=6, seed=1)
    v = 0.01 * np.random.default_rng(4).standard_normal((20, n.size))
    methods = [frf.method for frf in estimates("controller_input", "multisine", n, v, **PERIOD)]
    assert methods == ["reference estimator, 6 periods of 4 s"] * 20


@pytest.mark.parametrize("resolution_hz", [0.1, 0.5, 2.0])
def test_lines_lie_at_the_resolution_asked_for(resolution_hz):
    n = band_noise(0.5, 40.0, 100.0, RATE, seed=1)
    frf = estimates("control", "noise", n, np.zeros((1, n.size)), Settings(resolution_hz=resolution_hz))[0]
    np.testing.assert_allclose(np.diff(frf.frequency_hz), resolution_hz, rtol=1e-9)
    assert frf.frequency_hz[0] > 1.9 * resolution_hz  # the window smears the mean into the first line
