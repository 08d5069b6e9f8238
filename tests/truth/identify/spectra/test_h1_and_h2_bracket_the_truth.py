"""A spring whose stretch and pull are measured with noise: H1 is too small, H2 too large, by what theory says."""

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from excitations import band_noise
from h1_h2 import h1_h2

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings

RATE, K = 200.0, 3.0
LOOP = LoopSetup("spring", None, None, "stretch_m", "pull_n", None)
SETTINGS = Settings(estimator="direct", method="welch", resolution_hz=0.5)


def record(seed, input_noise=0.0, output_noise=0.0, closed=False, kind="noise", period_s=None):
    """60 s of a spring of 3 N/m under noise of rms 1 up to half the rate."""
    x = band_noise(0.01, 99.0, 60.0, RATE, seed=seed)
    rng = np.random.default_rng(seed + 10_000)
    u = x + input_noise * rng.standard_normal(x.size)
    y = K * x + output_noise * rng.standard_normal(x.size)
    info = RecordingInfo(f"r{seed}.csv", kind, "control", excites="spring", closed_loop=closed, period_s=period_s)
    return ls.Recording(info, RATE, {"stretch_m": u, "pull_n": y})


def mean_gains(**noise):
    both = h1_h2([record(k, **noise) for k in range(8)], LOOP, SETTINGS)
    band = [frf.between(5.0, 90.0).siso.mean() for frf in (both.h1, both.h2)]
    return band[0], band[1], both


def test_noise_of_the_input_lowers_h1_alone():
    h1, h2, _ = mean_gains(input_noise=0.5)
    # white noise of variance 0.25 lies on 100 Hz, the excitation of variance 1 on 99 Hz
    assert abs(h1) == pytest.approx(K / (1.0 + 0.25 * 0.99), rel=0.01)
    assert abs(h2) == pytest.approx(K, rel=0.01)


def test_noise_of_the_output_raises_h2_alone():
    h1, h2, _ = mean_gains(output_noise=1.5)
    assert abs(h1) == pytest.approx(K, rel=0.01)
    assert abs(h2) == pytest.approx(K * (1.0 + 1.5**2 / K**2 * 0.99), rel=0.01)


def test_with_both_the_truth_lies_between_and_their_ratio_is_the_coherence():
    h1, h2, both = mean_gains(input_noise=0.3, output_noise=1.0)
    assert abs(h1) < 0.97 * K
    assert abs(h2) > 1.03 * K
    np.testing.assert_allclose(both.coherence, both.h1.coherence, rtol=1e-12)


def test_h1_of_one_record_is_the_direct_estimate():
    one = record(3, output_noise=0.5)
    h1 = h1_h2([one], LOOP, SETTINGS).h1
    direct = estimate_frf(one, LOOP, SETTINGS)
    same = np.isin(h1.frequency_hz, direct.frequency_hz)
    np.testing.assert_allclose(h1.siso[same], direct.siso, rtol=1e-12)
    np.testing.assert_allclose(h1.variance[same, 0, 0], direct.variance[:, 0, 0], rtol=1e-9)


@pytest.mark.parametrize("name", ["h1", "h2"])
def test_each_scatters_about_its_own_mean_as_its_covariance_says(name):
    noise = {"input_noise": 0.4, "output_noise": 1.0}
    found = [getattr(h1_h2([record(k, **noise)], LOOP, SETTINGS), name).between(5.0, 90.0) for k in range(60)]
    responses = np.array([f.siso for f in found])
    scatter = np.mean(np.abs(responses - responses.mean(axis=0)) ** 2) * 60 / 59
    stated = np.mean([f.variance[:, 0, 0] for f in found])
    assert stated == pytest.approx(scatter, rel=0.05)


def test_more_records_shrink_the_variance_by_their_number():
    one = h1_h2([record(0, output_noise=1.0)], LOOP, SETTINGS).h1.between(5.0, 90.0)
    eight = h1_h2([record(k, output_noise=1.0) for k in range(8)], LOOP, SETTINGS).h1.between(5.0, 90.0)
    assert np.median(one.variance) / np.median(eight.variance) == pytest.approx(8.0, rel=0.25)


def test_closed_loops_sweeps_periods_and_other_rates_are_refused():
    with pytest.raises(ls.errors.WrongUseError, match="open loop"):
        h1_h2([record(0, closed=True)], LOOP)
    with pytest.raises(ls.errors.WrongUseError, match="is a sweep"):
        h1_h2([record(0, kind="sweep")], LOOP)
    with pytest.raises(ls.errors.WrongUseError, match="whole periods"):
        h1_h2([record(0, period_s=6.0)], LOOP)
    slow = ls.Recording(record(1).info, 100.0, record(1).columns)
    with pytest.raises(ls.errors.WrongUseError, match="share a rate"):
        h1_h2([record(0), slow], LOOP)
    with pytest.raises(ls.errors.WrongUseError, match="need a record"):
        h1_h2([], LOOP)
