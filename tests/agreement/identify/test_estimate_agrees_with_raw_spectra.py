"""Two routes to one response: the source's -(Phi_e1n)/(C Phi_e2n) from raw spectra, and one loop as a 1 x 1 matrix."""

import numpy as np
import pytest
from bench_nouns import Block, LoopSetup, RecordingInfo
from excitations import multisine
from scipy.signal import csd, freqz, lfilter

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.matrix.matrix import estimate_matrix
from loopshape.identify.settings import Settings

RATE, SETPOINT, SEGMENT = 100.0, 0.3, 400
A, B = np.poly([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j), 0.8]).real, np.array([0.0, 0.05, 0.02, 0.0])
GAIN = (Block("gain", {"gain": 0.4}),)
LOW_PASS = (*GAIN, Block("low_pass_1", {"f_hz": 20.0}))


def recorded(blocks, n, place="controller_input", noise=0.05, **period):
    """A noisy loop around a known plant, n at the controller's input or the plant's, setpoint not zero."""
    controller = ls.Controller("axis", blocks, RATE)
    D = F = np.ones(1)
    for b0, b1, b2, a1, a2 in controller.biquads():
        D, F = np.convolve(D, [b0, b1, b2]), np.convolve(F, [1.0, a1, a2])
    size = A.size + F.size - 1
    ones, loop = (np.pad(p, (0, size - p.size)) for p in (np.convolve(A, F), np.convolve(B, D)))
    v = noise * np.random.default_rng(9).standard_normal(n.size)
    at_controller = place == "controller_input"
    into = SETPOINT - v + (n if at_controller else 0.0)
    z = lfilter(np.convolve(D, A), ones + loop, into) - (0.0 if at_controller else lfilter(loop, ones + loop, n))
    y = lfilter(loop, ones + loop, into) + v + (0.0 if at_controller else lfilter(np.convolve(B, F), ones + loop, n))
    info = RecordingInfo("r1.parquet", "noise", place, excites="axis", **period)
    columns = {"r_rad": np.full(n.size, SETPOINT), "n_rad" if at_controller else "n_v": n, "z_v": z, "y_rad": y}
    setup = LoopSetup("axis", "r_rad", "n_rad" if at_controller else "n_v", "z_v", "y_rad", controller)
    return ls.Recording(info, RATE, columns), setup


def source_formula(recording, controller):
    """-(Phi_e1n)/(C Phi_e2n) of section 4.9, with scipy's Welch: e1 = r - y, e2 = e1 + n; csd(x, y) is E[X* Y]."""
    column = recording.column
    e1 = column("r_rad") - column("y_rad")
    e2 = e1 + column("n_rad")
    words = {"fs": RATE, "window": "hann", "nperseg": SEGMENT, "noverlap": 300, "detrend": "constant"}
    f, e1_n = csd(column("n_rad"), e1, **words)
    _, e2_n = csd(column("n_rad"), e2, **words)
    inside = slice(2, -1)
    return f[inside], -e1_n[inside] / (controller.response(f[inside]) * e2_n[inside])


def both_routes(blocks):
    recording, loop = recorded(blocks, np.random.default_rng(1).standard_normal(20000))
    frf = estimate_frf(recording, loop, Settings(resolution_hz=RATE / SEGMENT)).between(0.5, 20.0)
    f, source = source_formula(recording, loop.controller)
    on = np.isin(np.round(f, 9), np.round(frf.frequency_hz, 9))
    assert on.sum() == frf.frequency_hz.size > 70
    return frf, source[on]


def test_the_sources_formula_is_the_estimate_under_a_plain_gain():
    frf, source = both_routes(GAIN)
    np.testing.assert_allclose(frf.siso, source, rtol=1e-9)


def test_the_sources_formula_is_the_estimate_under_a_filter_up_to_the_segments_ends():
    # z of a segment is C e2 but for what the filter remembers (8 ms of 4 s), which noise makes random: 0.2 % and less
    frf, source = both_routes(LOW_PASS)
    apart = np.abs(frf.siso / source - 1.0)
    assert np.sqrt(np.mean(apart**2)) < 0.01
    assert np.all(apart < 0.2 * np.sqrt(frf.variance[:, 0, 0]) / np.abs(frf.siso) + 0.01)


def test_without_its_minus_the_sources_formula_would_be_another_plant():
    frf, source = both_routes(GAIN)
    d = np.abs(frf.siso - freqz(B, A, worN=frf.frequency_hz, fs=RATE)[1]) / np.sqrt(frf.variance[:, 0, 0])
    assert np.mean(d**2) < 1.6
    assert np.all(np.abs(frf.siso + source) > 1.9 * np.abs(source))


PERIODIC = multisine(0.25, 40.0, 4.0, RATE, periods=8, seed=1)
CASES = {
    "segments": (np.random.default_rng(1).standard_normal(20000), {}),
    "periods": (PERIODIC, {"period_s": 4.0, "periodic_from_s": 1.0}),
}


@pytest.mark.parametrize("place", ["controller_input", "plant_input"])
@pytest.mark.parametrize("case", CASES)
def test_one_loop_is_a_matrix_of_one(case, place):
    n, period = CASES[case]
    recording, loop = recorded(LOW_PASS, n, place, **period)
    run = ls.Run(RATE, (loop,), (recording,))
    (single,), matrix = ls.frfs(run), estimate_matrix(run, [recording])
    shared = np.isin(single.frequency_hz, matrix.frequency_hz)
    np.testing.assert_array_equal(matrix.frequency_hz, single.frequency_hz[shared])
    np.testing.assert_allclose(matrix.response, single.response[shared], rtol=1e-10)
    np.testing.assert_allclose(matrix.covariance, single.covariance[shared], rtol=1e-8)
    assert (matrix.inputs, matrix.outputs, matrix.line_overlap) == (single.inputs, single.outputs, single.line_overlap)
    assert shared.sum() > 100
