"""Sweeps in closed loop against a known plant: the whole band they cross is valid, the error is that of the best known
estimators or less, and 95 % intervals hold 93 to 97 %."""

import numpy as np
import pytest
from scipy.signal import lfilter
from swept_loop import HIGH, LOOP, LOW, loop, measured, median_error, peer_errors, plant, share_inside, sweep

from loopshape.core.errors import BadSignalError
from loopshape.core.units import TWO_PI
from loopshape.data.recording import Recording, RecordingInfo
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings
from loopshape.identify.sweeps import swept_band

RATE = 1000.0
PLACES = ("controller_input", "plant_input")


def swept(seconds, spacing="logarithmic", both_ways=False):
    return sweep(seconds, RATE, spacing, both_ways)


def recorded(place, n, seed, drift=0.0):
    return measured(place, n, RATE, seed, drift)


def octaves(f_hz):
    return np.log2(f_hz[-1] / f_hz[0])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("seconds", [20.0, 60.0, 180.0])
def test_the_band_that_a_sweep_crosses_once_is_valid_and_as_accurate_as_by_the_best_known_estimator(place, seconds):
    record = recorded(place, swept(seconds), seed=1)
    frf = estimate_frf(record, LOOP)
    valid = frf.frequency_hz[frf.trusted]
    assert valid[0] > 0.98 * LOW
    assert valid[-1] < 1.02 * HIGH
    assert frf.trusted.mean() > 0.95
    assert np.ptp(valid) > 0.95 * (HIGH - LOW)
    assert octaves(valid) > 0.95 * np.log2(HIGH / LOW)
    # the estimator's lines are closer at low frequency: errors are compared at the peers' own
    P = np.interp(f := np.arange(0.6, 79.5, 0.1), valid, frf.siso[frf.trusted])
    assert median_error(f, P, RATE) < 1.5 * min(peer_errors(record, place).values())


CASES = {
    "one way": {},
    "both ways": {"both_ways": True},
    "linear": {"spacing": "linear"},
    "linear, both ways": {"spacing": "linear", "both_ways": True},
}


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_their_95_percent_circles_hold_that_share_of_errors(case):
    # 24 records of some 30 independent lines: 1 % of chance
    n = swept(20.0, **CASES[case])
    shares = [share_inside(estimate_frf(recorded(p, n, seed), LOOP), RATE) for p in PLACES for seed in range(12)]
    assert 0.925 < np.mean(shares) < 0.985


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("both_ways", [False, True])
def test_a_drift_as_large_as_the_answer_costs_at_most_the_end_of_the_band_and_no_intervals(place, both_ways):
    n = swept(10.0, both_ways=both_ways)
    frfs = [estimate_frf(recorded(place, n, seed, drift=1.0), LOOP) for seed in range(8)]
    assert min(np.ptp(x.frequency_hz[x.trusted]) for x in frfs) > 0.9 * (HIGH - LOW)
    assert 0.9 < np.mean([share_inside(x, RATE) for x in frfs]) < 0.985


def test_a_loop_that_was_not_at_rest_at_the_start_is_no_response():
    n = swept(30.0)
    record = recorded("controller_input", n, seed=0)
    y = record.column("y_rad") + 0.5 * np.exp(-np.arange(n.size) / RATE / 0.8)
    moved = Recording(record.info, RATE, dict(record.columns) | {"y_rad": y})
    frf = estimate_frf(moved, LOOP)
    error = np.abs(frf.siso / plant(frf.frequency_hz, RATE) - 1.0)
    assert np.median(error) < 0.005
    assert share_inside(frf, RATE) > 0.9


def test_lines_lie_at_the_resolution_asked_for():
    frf = estimate_frf(recorded("plant_input", swept(20.0), seed=0), LOOP, Settings(resolution_hz=0.5))
    np.testing.assert_allclose(np.diff(frf.frequency_hz), 0.5, rtol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_the_band_is_read_from_the_injected_signal(case):
    low, high = swept_band(swept(20.0, **CASES[case]), RATE)
    # a linear sweep of 20 s crosses 0.5 to 2 Hz in its first cycle
    assert 0.98 * LOW < low < (2.0 if "linear" in case else 1.1 * LOW)
    assert high == pytest.approx(HIGH, rel=0.02)


def test_a_sweep_over_fewer_lines_than_a_window_is_refused():
    with pytest.raises(BadSignalError, match="four cycles at least"):
        estimate_frf(recorded("plant_input", swept(20.0)[:600], seed=0), LOOP)
    n = np.sin(TWO_PI * np.cumsum(np.linspace(20.0, 26.0, 200)) / RATE)
    with pytest.raises(BadSignalError, match="crosses too few lines"):
        estimate_frf(recorded("plant_input", n, seed=0), LOOP)


def test_what_a_window_rounds_off_of_a_resonance_is_not_taken_for_noise_that_comes_with_the_sweep():
    # white noise of constant power: mean of squared errors over variances is nu/(nu - 2), a little above 1
    n = swept(60.0, spacing="linear")
    found = []
    for seed in range(8):
        frf = estimate_frf(recorded("controller_input", n, seed), LOOP).between(16.0, 25.0)
        found.append(np.mean(np.abs(frf.siso - plant(frf.frequency_hz, RATE)) ** 2 / frf.variance[:, 0, 0]))
    assert 0.7 < np.mean(found) < 1.3


def test_a_slow_linear_sweep_is_valid_from_where_it_starts():
    frf = estimate_frf(recorded("controller_input", swept(180.0, spacing="linear"), seed=0), LOOP)
    assert octaves(frf.frequency_hz[frf.trusted]) > 0.95 * np.log2(HIGH / LOW)


@pytest.mark.parametrize("both_ways", [False, True])
def test_harmonics_of_a_nonlinear_machine_are_neither_plant_nor_noise(both_ways):
    # u + 0.2 u^2 - 0.3 u^3 in front of a known plant: a sine of amplitude 1 sees the plant times 1 - 3/4 0.3
    B, A, _, _ = loop(RATE)
    n, gain = swept(60.0, both_ways=both_ways), 0.775
    errors, spreads, inside = [], [], []
    for y in (lfilter(B, A, gain * n), lfilter(B, A, n + 0.2 * n**2 - 0.3 * n**3)):
        for seed in range(3):
            frf = estimate_frf(recorded_open(n, y, seed), LOOP)
            assert ("without the sweep's harmonics 2, 3" in frf.method) == (len(errors) >= 3)
            apart = frf.frequency_hz > 3.0  # from where harmonics pass at another time than the sweep
            truth = gain * plant(frf.frequency_hz[apart], RATE)
            errors.append(np.median(np.abs(frf.siso[apart] / truth - 1.0)))
            spreads.append(np.median(np.sqrt(frf.variance[apart, 0, 0]) / np.abs(truth)))
            inside.append(share_inside(frf.select(apart), RATE, gain))
    assert np.mean(errors[3:]) < 2.0 * np.mean(errors[:3])  # 6 to 10 times with harmonics taken for noise or plant
    assert np.mean(spreads[3:]) < 3.0 * np.mean(spreads[:3])
    assert np.mean(inside[3:]) > 0.85


def recorded_open(n, y, seed):
    v = 0.01 * y.std() * np.random.default_rng(seed).standard_normal(n.size)
    columns = {"z_v": n, "y_rad": y + v, "r_rad": np.zeros(n.size), "n_rad": n}
    return Recording(RecordingInfo("r1.parquet", "sweep", "controller_input", excites="axis"), RATE, columns)
