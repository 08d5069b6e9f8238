"""Local estimates of a whole record: exact where they can be, twice as accurate as any segment where leakage dominates,
and as sure as they say."""

import known_loops as known
import numpy as np
import pytest
import two_loops as two
from bench_nouns import LoopSetup, RecordingInfo
from conversions import TWO_PI
from scipy.signal import cont2discrete, lfilter
from scipy.stats import f as f_distribution

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.local.local_fits import Window, fit_lines, predicted
from loopshape.identify.matrix.matrix import estimate_matrix
from loopshape.identify.settings import Settings

RATE, LOCAL = known.RATE, Settings(method="local")
OPEN = LoopSetup("axis", None, None, "z_v", "y_rad", None)


def resonance(damping):
    """B, A of 5 Hz behind a hold."""
    w = TWO_PI * 5.0
    B, A, _ = cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / RATE)
    return np.ravel(B), A


def response(damping, f_hz):
    B, A = resonance(damping)
    z = np.exp(-1j * TWO_PI * np.asarray(f_hz) / RATE)
    return np.polyval(B[::-1], z) / np.polyval(A[::-1], z)


def records(damping, seconds, snr_db, count, seed=0):
    """Records cut out of a longer run, so that both ends leak."""
    rng, before = np.random.default_rng(seed), 2000
    u = rng.standard_normal((count, before + round(seconds * RATE)))
    y = lfilter(*resonance(damping), u)
    y = y + y.std() * 10.0 ** (-snr_db / 20.0) * rng.standard_normal(u.shape)
    return [known.record("control", "noise", *x) for x in zip(u[:, before:], u[:, before:], y[:, before:], strict=True)]


def error_of(frf, damping):
    """Root mean squared relative error from 1 to 15 Hz, between the lines too."""
    f = np.arange(1.0, 15.0, 0.02)
    G = np.interp(f, frf.frequency_hz, frf.siso.real) + 1j * np.interp(f, frf.frequency_hz, frf.siso.imag)
    return np.sqrt(np.mean(np.abs(G / response(damping, f) - 1.0) ** 2))


def best_welch(recording, damping):
    """The least error that any length of segments gives which three averages allow."""
    lengths = [x for x in np.geomspace(1.0, 8.0, 12)]
    frfs = [estimate_frf(recording, OPEN, Settings(method="welch", resolution_hz=1.0 / x)) for x in lengths]
    return min(error_of(x, damping) for x in frfs)


@pytest.mark.parametrize("snr_db", [40.0, 60.0])
def test_where_leakage_dominates_they_are_twice_as_accurate_as_the_best_segments(snr_db):
    for recording in records(0.02, 20.0, snr_db, 2):
        local = error_of(estimate_frf(recording, OPEN, LOCAL), 0.02)
        assert 2.0 * local < best_welch(recording, 0.02)


@pytest.mark.parametrize(("damping", "snr_db"), [(0.1, 20.0), (0.5, 20.0), (0.5, 60.0)])
def test_elsewhere_they_are_no_worse(damping, snr_db):
    for recording in records(damping, 20.0, snr_db, 1):
        auto = error_of(estimate_frf(recording, OPEN), damping)
        assert auto < 1.1 * best_welch(recording, damping)


@pytest.mark.long
@pytest.mark.parametrize("place", ["control", "controller_input", "plant_input"])
@pytest.mark.parametrize("level", [0.002, 0.2])
def test_their_95_percent_circles_hold_that_share_of_errors(place, level):
    rng = np.random.default_rng(3)
    n, v = rng.standard_normal((16, 2000)), level * rng.standard_normal((16, 2000))
    found = []
    for frf in known.estimates(place, "noise", n, v, LOCAL):
        frf = frf.between(1.0, 20.0)
        error = np.abs(frf.siso - known.plant(frf.frequency_hz)) ** 2
        reach = f_distribution.ppf(0.95, 2, frf.variance_freedom)
        found.append(np.mean(error < reach * frf.variance[:, 0, 0]))
    # sixteen records of some fifteen independent lines: 1.5 % of chance
    assert 0.9 < np.mean(found) < 0.99


def test_their_error_falls_as_one_over_the_root_of_the_length():
    means = []
    for seconds in (10.0, 40.0):
        frfs = [estimate_frf(r, OPEN, LOCAL) for r in records(0.5, seconds, 20.0, 3)]
        means.append(np.sqrt(np.mean([error_of(x, 0.5) ** 2 for x in frfs])))
    # four times the length, half the error, if windows are as wide in Hz; three records tell it to a quarter
    assert 0.35 < means[1] / means[0] < 0.7


def test_a_polynomial_plant_and_transient_are_recovered_exactly():
    k, rng = np.arange(200), np.random.default_rng(0)
    R = rng.standard_normal((1, 200)) + 1j * rng.standard_normal((1, 200))
    H, T = 1.0 + 0.02j * k - 1e-4 * k**2, 3.0 - 0.01 * k + 2e-4j * k**2
    fit = fit_lines(H * R + T, R, k, 0, 199, Window(12, 2, 0))
    np.testing.assert_allclose(fit.response[:, 0, 0], H, rtol=1e-8)
    assert np.abs(fit.left_out).max() < 1e-8


@pytest.mark.parametrize("shape", [(0, 0), (2, 0), (4, 0), (2, 2)])
def test_moments_predict_what_least_squares_predict(shape):
    k, rng = np.arange(400), np.random.default_rng(0)
    R, V = (rng.standard_normal((2, 400)) + 1j * rng.standard_normal((2, 400)) for _ in range(2))
    X = np.stack([R[0] / (1.0 + 1j * (k - 200.0) / 9.0) + 0.3 * R[1], 0.5 * R[0] - R[1]]) + 0.01 * V
    windows, lines = [Window(half, *shape) for half in (16, 24, 64)], np.array([3, 20, 195, 200, 230, 396])
    response, left_out = predicted(X, R, lines, 1, 398, windows)
    for one, window in enumerate(windows):
        fit = fit_lines(X, R, lines, 1, 398, window)
        np.testing.assert_allclose(response[one], fit.response, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(left_out[one], fit.left_out, rtol=1e-4, atol=1e-7)


def test_a_rational_plant_is_recovered_exactly_at_its_resonance():
    k, rng = np.arange(200), np.random.default_rng(0)
    R = rng.standard_normal((1, 200)) + 1j * rng.standard_normal((1, 200))
    pole = 1.0 / (1j * (k - 100.3) + 0.8)
    fit = fit_lines(pole * (R + 2.0), R, k, 0, 199, Window(16, 2, 2))
    np.testing.assert_allclose(fit.response[:, 0, 0], pole, rtol=1e-6)


def lines_of(frf):
    """Width of the windows that were chosen, in lines."""
    return int(frf.method.split(" over ")[1].split(" lines")[0])


def test_sharper_resonances_are_given_narrower_windows():
    sharp, blunt = ([lines_of(estimate_frf(r, OPEN, LOCAL)) for r in records(z, 10.0, 20.0, 3)] for z in (0.02, 0.1))
    assert 1.4 * np.mean(sharp) < np.mean(blunt)


@pytest.mark.parametrize("place", ["controller_input", "plant_input"])
def test_no_resonance_falls_between_lines_where_answers_to_the_instrument_are_smooth(place):
    # the loop damps what the plant has sharp: windows follow the loop, lines must follow the plant
    rng, (B, A) = np.random.default_rng(2), resonance(0.02)
    n, v = rng.standard_normal(2000), 0.02 * rng.standard_normal(2000)
    D = np.array([4.0, -3.0])
    closed = np.pad(A, (0, 1)) + np.convolve(B, D)
    assert np.abs(np.roots(closed)).max() < 0.97
    if place == "controller_input":
        z = lfilter(np.convolve(A, D), closed, n - v)
        y = lfilter(B, A, z) + v
    else:
        z = -lfilter(np.convolve(B, D), closed, n) - lfilter(np.convolve(A, D), closed, v)
        y = lfilter(B, A, z + n) + v
    frf = estimate_frf(known.record(place, "noise", n, z, y), known.LOOP, LOCAL).between(4.0, 6.0)
    truth = response(0.02, frf.frequency_hz)
    halfway = 0.5 * (truth[1:] + truth[:-1])
    between = response(0.02, 0.5 * (frf.frequency_hz[1:] + frf.frequency_hz[:-1]))
    assert np.abs(halfway - between).max() < 1.5 * np.sqrt(frf.variance[:, 0, 0].max())


def test_too_few_lines_are_refused_with_a_way_out():
    with pytest.raises(ls.errors.BadSignalError, match="too few frequencies in one stretch") as caught:
        estimate_frf(records(0.5, 0.5, 40.0, 1)[0], OPEN, LOCAL)
    assert "Welch" in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize("place", two.PLACES)
def test_a_matrix_in_closed_loop_is_as_good_as_it_says(place):
    (run,) = two.runs(place, [two.white(1, 1, 2000), two.white(2, 1, 2000)], 0.05, 1)
    frf = estimate_matrix(run, run.recordings, LOCAL).between(1.0, 25.0)
    error = np.abs(frf.response - two.plant(frf.frequency_hz)) ** 2
    inside = error < f_distribution.ppf(0.95, 2, frf.variance_freedom) * frf.variance
    assert 0.88 < inside.mean() <= 1.0
    assert np.sqrt(error.mean()) < 0.1 * np.sqrt(np.mean(np.abs(frf.response) ** 2))


def open_recording(k, size=2000, level=0.002):
    """Noise at one of two inputs, the other at rest."""
    u, x, y = np.zeros((size, 2)), np.zeros(4), np.empty((size, 2))
    u[:, k] = two.white(5 + k, 1, size)[0]
    for i in range(size):
        y[i] = two.C @ x
        x = two.A @ x + two.B @ u[i]
    y += level * np.random.default_rng(k).standard_normal(y.shape)
    info = RecordingInfo(f"r{k}.parquet", "noise", "control", excites=f"l{k}", closed_loop=False)
    return ls.Recording(info, RATE, {f"z{j}_v": u[:, j] for j in (0, 1)} | {f"y{j}_rad": y[:, j] for j in (0, 1)})


def test_a_matrix_in_open_loop_is_found_from_one_input_after_the_other():
    loops = tuple(LoopSetup(f"l{k}", None, None, f"z{k}_v", f"y{k}_rad", None) for k in (0, 1))
    run = ls.Run(RATE, loops, [open_recording(k) for k in (0, 1)])
    frf = estimate_matrix(run, run.recordings, LOCAL).between(1.0, 25.0)
    np.testing.assert_allclose(frf.response, two.plant(frf.frequency_hz), atol=0.02)


def test_the_stated_spread_of_rationals_is_their_scatter_where_the_plant_is_weak():
    # a denominator bends to noise: with one noise power for the whole window the squared scatter is 1.4 of the stated
    # one above a sharp resonance; summed residual by residual it is not
    rng = np.random.default_rng(3)
    w, damping, rate, size = TWO_PI * 5.0, 0.02, 100.0, 3000
    b, a, _ = cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / rate, "zoh")
    f = np.arange(size // 2 + 1) * rate / size
    lines = np.flatnonzero((f > 8.0) & (f < 15.0))[::3]
    found, stated = [], []
    for _ in range(60):
        u = rng.standard_normal(size + 6000)
        y = lfilter(b[0], a, u)[6000:]
        y += 0.1 * y.std() * rng.standard_normal(size)
        X, R = np.fft.rfft(y)[None], np.fft.rfft(u[6000:])[None]
        one = fit_lines(X, R, lines, 2, f.size - 3, Window(32, 2, 2))
        found.append(one.response[:, 0, 0])
        stated.append(one.spread[:, 0, 0].real)
    ratio = np.mean(np.var(found, axis=0) / np.mean(stated, axis=0))
    assert 0.8 < ratio < 1.2  # 60 records of 70 lines, four of them independent: 7 % of chance
