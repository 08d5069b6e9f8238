"""Coherence lies between 0 and 1, is near 1 without noise, and falls as 1/averages for unrelated signals."""

import numpy as np
import pytest
from bench_nouns import Block, LoopSetup, RecordingInfo, Settings
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf

RATE = 100.0
LOOP = LoopSetup("axis", None, None, "z_v", "y_rad", ls.Controller("axis", (Block("gain", {"gain": 1.0}),), RATE))
BACK = LoopSetup("axis", None, None, "y_rad", "z_v", None)


def open_loop(z, y, *, loop=LOOP, period_s=None, **words):
    info = RecordingInfo(
        "r1.parquet", "noise", "control", excites="axis", closed_loop=False, period_s=period_s, periodic_from_s=0.0
    )
    return estimate_frf(ls.Recording(info, RATE, {"z_v": z, "y_rad": y}), loop, Settings(**words))


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    pole=st.floats(-0.9, 0.9),
    size=st.floats(-6.0, 6.0),
    offset=st.floats(-1e3, 1e3),
    overlap=st.floats(0.0, 0.9),
    period_s=st.sampled_from([None, 1.0, 2.5]),
)
def test_coherence_lies_between_0_and_1(seed, pole, size, offset, overlap, period_s):
    rng = np.random.default_rng(seed)
    z = rng.standard_normal(1500)
    if period_s is not None:
        z = np.tile(z[: round(period_s * RATE)], 8)[:1500]
    y = lfilter([1.0], [1.0, -pole], z) + 10.0**size * rng.standard_normal(z.size) + offset
    frf = open_loop(z, y, overlap=overlap, period_s=period_s)
    assert np.all((frf.coherence >= 0.0) & (frf.coherence <= 1.0 + 1e-12))


@pytest.mark.long
@pytest.mark.parametrize("segments", [10, 40, 160])
def test_coherence_of_unrelated_signals_is_one_over_the_averages(segments):
    # without overlap each of the segments is an average; exponential of mean 1/m: Carter, Knapp, Nuttall 1973
    rng = np.random.default_rng(segments)
    found = []
    for _ in range(60):
        z, y = rng.standard_normal((2, segments * 100))
        found.append(open_loop(z, y, resolution_hz=1.0, overlap=0.0).coherence)
    assert np.mean(found) * segments == pytest.approx(1.0, abs=0.1)  # 60 x 48 lines, 1.4 as one: 2 %


def test_coherence_of_a_plant_without_noise_is_one():
    z = np.random.default_rng(1).standard_normal(20000)
    frf = open_loop(z, lfilter([0.0, 0.2], [1.0, -0.8], z)).between(0.5, 45.0)
    assert frf.coherence.min() > 0.999
    assert frf.valid.all()


def test_coherence_tells_the_noises_share_of_the_output():
    rng = np.random.default_rng(2)
    z, v = rng.standard_normal((2, 200000))
    frf = open_loop(z, z + v, resolution_hz=1.0)
    assert frf.coherence.mean() == pytest.approx(0.5, abs=0.01)  # equal powers


@settings(max_examples=25, deadline=None)
@given(delay=st.integers(0, 6), gain=st.floats(0.1, 10.0), periods=st.integers(2, 5), seed=st.integers(0, 2**31))
def test_input_and_output_swapped_give_the_inverse_and_the_opposite_phase(delay, gain, periods, seed):
    z = np.tile(np.random.default_rng(seed).standard_normal(200), periods)
    y = gain * np.roll(z, delay)
    there, back = open_loop(z, y, period_s=2.0), open_loop(z, y, loop=BACK, period_s=2.0)
    np.testing.assert_allclose(there.siso * back.siso, 1.0, rtol=1e-9)
    expected = gain * np.exp(-2j * np.pi * there.frequency_hz * delay / RATE)
    np.testing.assert_allclose(there.siso, expected, rtol=1e-9)
    if delay:
        assert np.angle(there.siso[0]) < 0.0 < np.angle(back.siso[0])


def test_powers_are_the_signals_own():
    # white noise of variance s² has the one-sided density 2 s²/rate; a sine of amplitude a has the power a²/2
    rng = np.random.default_rng(3)
    z = 3.0 * rng.standard_normal(200000)
    frf = open_loop(z, 0.5 * z, resolution_hz=1.0)
    assert frf.power_per == "Hz"
    assert frf.input_power.mean() == pytest.approx(2.0 * 9.0 / RATE, rel=0.01)
    assert np.allclose(frf.output_power, 0.25 * frf.input_power)
    t = np.arange(1000) / RATE
    line = open_loop(2.0 * np.sin(2.0 * np.pi * 5.0 * t), 2.0 * np.sin(2.0 * np.pi * 5.0 * t - 0.3), period_s=1.0)
    assert line.power_per == "line"
    np.testing.assert_allclose(line.frequency_hz, [5.0])
    np.testing.assert_allclose(line.input_power, [2.0], rtol=1e-9)
    assert np.angle(line.cross_power[0]) == pytest.approx(-0.3)
