"""The variance that an estimate states is the scatter that repeated recordings show, and how far its 95 % circle holds.

Two hundred recordings of each kind, all with the same plant. The predicted variance is compared with the scatter
about the truth, line by line; over some hundred lines the mean ratio is known to about a percent. A circle of
|d|² < -ln(0.05) var would hold 95 % of the errors if the variance were known; with m averages of noise to estimate
it from, the error over its stated deviation follows an F distribution and the circle holds
1 - (1 + 3.0/(m - 1))^-(m - 1). By periods the noise is pooled over neighbouring lines until it has some forty
degrees of freedom, which count as twenty more averages: a circle holds 0.94 however few the periods.
"""

import numpy as np
import pytest
from excitations import band_noise, multisine, up_and_down
from known_loops import CONTROLLER, RATE, common_lines, estimates, plant
from scipy.signal import freqz, lfilter
from scipy.stats import f as f_distribution

from loopshape.identify.settings import Settings
from loopshape.identify.tolerances import TOL

pytestmark = pytest.mark.long

RECORDS = 200
SWEEPS = 60  # these take a hundred times as long to estimate
SAMPLES = 16000
REACH = -np.log(0.05)


def ratio_and_coverage(frfs):
    """Predicted over true variance (nf,) between 1 and 20 Hz, and the share of errors within the 95 % circle."""
    f, response, variance = common_lines(frfs, 1.0, 20.0)
    error = np.abs(response - plant(f)) ** 2
    return variance.mean(0) / error.mean(0), float(np.mean(error < REACH * variance))


def share_held(averages):
    return 1.0 - (1.0 + REACH / (averages - 1.0)) ** (1.0 - averages)


def noise(seed, size, records=RECORDS):
    return np.random.default_rng(seed).standard_normal((records, size))


@pytest.mark.parametrize("place", ["controller_input", "plant_input"])
@pytest.mark.parametrize("overlap", [0.75, 0.5, 0.0])
def test_noise_by_segments(place, overlap):
    settings = Settings(method="welch", overlap=overlap)
    frfs = estimates(place, "noise", noise(1, SAMPLES), 0.05 * noise(2, SAMPLES), settings)
    ratio, coverage = ratio_and_coverage(frfs)
    # the transient at each segment's ends adds a few percent to the scatter between segments, less to their mean
    assert 0.97 < ratio.mean() < 1.12
    assert 0.9 < np.median(ratio) < 1.1
    averages = float(frfs[0].method.split(" averages")[0].split()[-1])
    assert coverage == pytest.approx(share_held(averages), abs=0.02)


@pytest.mark.parametrize("place", ["controller_input", "plant_input"])
@pytest.mark.parametrize("periods", [2, 3, 5, 20])
def test_multisines_by_periods(place, periods):
    n = multisine(0.25, 40.0, 4.0, RATE, periods=periods, seed=1)
    frfs = estimates(place, "multisine", n, 0.05 * noise(3, n.size), period_s=4.0, from_s=1.0)
    ratio, coverage = ratio_and_coverage(frfs)
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)
    (freedom,) = {frf.variance_freedom for frf in frfs}
    # 20 periods have 38 alone, and a mean over three lines is the least
    assert TOL.variance_freedom <= freedom < 3 * TOL.variance_freedom
    # measured: 0.937 to 0.945; without pooling two periods hold 0.75, five 0.89
    assert 0.92 < coverage < 0.97
    assert coverage == pytest.approx(share_held(1.0 + 0.5 * freedom), abs=0.015)


@pytest.mark.parametrize("periods", [2, 5, 20])
def test_a_pooled_variance_scatters_as_its_degrees_of_freedom_say(periods):
    # chi² of nu degrees of freedom: relative variance 2/nu; 200 records know it to 10 % at each of 61 lines, some
    # of which share their noise. White noise in open loop, so that nothing but chance moves it from line to line
    n = multisine(0.25, 40.0, 4.0, RATE, periods=periods, seed=1)
    frfs = estimates("control", "multisine", n, 0.05 * noise(3, n.size), period_s=4.0, from_s=1.0)
    _, _, variance = common_lines(frfs, 5.0, 20.0)  # clear of the ends of the band, where the mean folds back
    relative = np.var(variance / variance.mean(0), axis=0).mean()
    assert 2.0 / relative == pytest.approx(frfs[0].variance_freedom, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize("place", ["controller_input", "plant_input"])
def test_sweeps_are_called_neither_better_nor_worse_than_they_are(place):
    n = up_and_down(0.2, 40.0, 160.0, RATE)
    f, response, variance = common_lines(estimates(place, "sweep", n, 0.05 * noise(4, n.size, SWEEPS)), 2.0, 20.0)
    error = np.abs(response - plant(f)) ** 2
    # windows differ between records: an error counts by its own deviation, which a hundred residuals tell to a tenth
    assert np.mean(error / variance) == pytest.approx(1.0, abs=0.15)
    inside = error < REACH * variance
    assert 0.93 < inside.mean() < 0.97
    assert inside.mean(axis=0).min() > 0.75  # of 60 records 57 are expected at each line, and there are 350 lines


def test_few_averages_are_counted_as_overlapping_segments_allow():
    # 9 segments that overlap by 75 % are 5 averages; taken for 9, the variance would come out 10 % smaller, below
    # the truth. Measured: 1.09, known to 0.01
    frfs = estimates("control", "noise", noise(8, 12000), 0.2 * noise(9, 12000), Settings(resolution_hz=RATE / 4000))
    ratio, coverage = ratio_and_coverage(frfs)
    assert "5.0 averages" in frfs[0].method
    assert 1.0 < ratio.mean() < 1.15
    assert coverage == pytest.approx(share_held(5.0), abs=0.03)


@pytest.fixture(scope="module")
def loud():
    """Squared errors and variances (records, nf), 6 to 9 Hz, where ten times the noise came while the sweep passed 4 to
    11 Hz, twice; and the stated degrees of freedom."""
    n = up_and_down(0.2, 40.0, 160.0, RATE)
    t = np.arange(n.size) / RATE
    passing = 0.2 + 39.8 * np.minimum(t, 160.0 - t) / 80.0
    noisy = np.where((passing > 4.0) & (passing < 11.0), 0.2, 0.02)
    frfs = estimates("controller_input", "sweep", n, noisy * noise(10, n.size, SWEEPS))
    f, response, variance = common_lines(frfs, 6.0, 9.0)
    freedom = np.array([frf.variance_freedom for frf in frfs])
    return np.abs(response - plant(f)) ** 2, variance, freedom


def test_a_disturbance_that_comes_with_the_sweep_counts_where_it_came(loud):
    error, variance, _ = loud
    assert 0.9 < np.mean(variance.mean(0) / error.mean(0)) < 1.5  # pooled over the record it would be a tenth


def test_circles_hold_where_a_disturbance_comes_with_the_sweep(loud):
    # some 15 independent lines of 60 records: 0.7 % of chance, twice that as windows are chosen by the same noise
    error, variance, freedom = loud
    reach = f_distribution.ppf(0.95, 2, freedom)[:, None]
    assert np.mean(error < reach * variance) == pytest.approx(0.95, abs=0.03)


def test_colour_of_the_noise_is_followed_line_by_line():
    # the error is sum(V N*)/sum(U N*), so its variance is Phi_v/(|CS|² Phi_n) over the averages
    v = lfilter([1.0], [1.0, -0.95], 0.02 * noise(5, SAMPLES))
    frfs = estimates("controller_input", "noise", noise(6, SAMPLES), v, Settings(method="welch"))
    ratio, _ = ratio_and_coverage(frfs)
    f, _, variance = common_lines(frfs, 1.0, 20.0)
    C = CONTROLLER.response(f)
    colour = np.abs(freqz([1.0], [1.0, -0.95], worN=f, fs=RATE)[1] * (1.0 + C * plant(f)) / C) ** 2
    shape = variance.mean(0) / colour
    assert 0.97 < ratio.mean() < 1.15
    assert colour[0] > 2.0 * colour[-1] or colour[-1] > 2.0 * colour[0]
    # 200 variances of 18 degrees of freedom know a line to 2 %; the smearing by the window's side lobes comes on top
    np.testing.assert_allclose(shape / np.median(shape), 1.0, atol=0.25)
    assert np.std(shape) / np.median(shape) < 0.08


def test_trusted_lines_at_the_edge_of_the_excitation_are_as_good_as_they_say():
    n = np.stack([band_noise(0.5, 40.0, 160.0, RATE, seed=k) for k in range(60)])
    frfs = estimates("control", "noise", n, 0.02 * noise(7, SAMPLES)[:60], Settings(method="welch"))
    f, response, variance = common_lines(frfs, 0.3, 1.0)
    valid = np.all([x.select(np.isin(x.frequency_hz, f)).valid for x in frfs], axis=0)
    within = np.mean(np.abs(response - plant(f)) ** 2 < REACH * variance, axis=0)
    assert within[valid].min() > 0.8  # 60 runs know 0.94 to 0.03
