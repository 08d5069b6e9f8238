"""Sweeps, multisines, pseudo-random sequences and noise put their power where they say, and no more."""

import numpy as np
import pytest
from scipy import signal

from loopshape.toolbox.rig.excitation.excitation import BandNoise, Prbs, Sweep, ramp, samples
from loopshape.toolbox.rig.excitation.multisine import Multisine

RATE_HZ = 1000.0
#: source, section 4.3: 0.1-20 Hz, rising and falling
SWEEP = Sweep(0.1, 20.0, 100.0, 2.5)


def instantaneous_hz(x):
    """Frequency (n - 1,) in Hz by the analytic signal's phase."""
    return np.diff(np.unwrap(np.angle(signal.hilbert(x)))) * RATE_HZ / (2.0 * np.pi)


def rise(sweep, t):
    lo, hi, half = sweep.f_low_hz, sweep.f_high_hz, sweep.duration_s / 2.0
    return lo + (hi - lo) * t / half if sweep.spacing == "linear" else lo * (hi / lo) ** (t / half)


@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_sweep_rises_and_falls_between_its_frequencies(spacing):
    sweep = Sweep(2.0, 20.0, 40.0, 1.0, spacing=spacing)
    x = sweep.signal(RATE_HZ)
    f = instantaneous_hz(x)
    t = (np.arange(f.size) + 0.5) / RATE_HZ
    inside = (t > 2.0) & (t < 38.0) & (np.abs(t - 20.0) > 1.0)  # the transform errs at the ends and the turn
    expected = rise(sweep, np.minimum(t, 40.0 - t))
    np.testing.assert_allclose(f[inside], expected[inside], rtol=0.02)
    # over a whole cycle the error averages out: by zero crossings the total number of cycles is right
    cycles = np.count_nonzero(np.diff(np.signbit(x))) / 2.0
    assert cycles == pytest.approx(2.0 * np.trapezoid(rise(sweep, np.linspace(0, 20, 2001)), dx=0.01), abs=1.0)


@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_sweep_has_no_jump_in_its_phase(spacing):
    x = Sweep(0.1, 20.0, 100.0, 1.0, spacing=spacing).signal(RATE_HZ)
    w = 2.0 * np.pi * 20.0 / RATE_HZ
    assert np.abs(np.diff(x)).max() <= 1.001 * w  # no faster than a sine of 20 Hz
    assert np.abs(np.diff(x, 2)).max() <= 1.01 * w**2


def test_linear_sweep_s_spectrum_is_flat_in_its_band():
    x = SWEEP.signal(RATE_HZ)
    f, power = signal.periodogram(x, RATE_HZ)
    inside = (f > 0.5) & (f < 19.5)
    # rise and fall interfere line by line, so over half a hertz
    level = 10.0 * np.log10(np.convolve(power[inside], np.ones(50) / 50, mode="valid"))
    assert np.ptp(level) < 3.0
    assert power[f > 21.0].sum() < 1e-3 * power.sum()
    assert power[inside].sum() > 0.9 * power.sum()


def test_logarithmic_sweep_spends_as_much_on_each_octave():
    x = Sweep(0.5, 32.0, 240.0, 1.0, spacing="logarithmic").signal(RATE_HZ)
    f, power = signal.periodogram(x, RATE_HZ)
    octaves = [power[(f >= 2.0**k) & (f < 2.0 ** (k + 1))].sum() for k in range(5)]
    np.testing.assert_allclose(octaves, np.mean(octaves), rtol=0.1)


def test_sweep_keeps_its_amplitude_and_its_ends_are_quiet():
    x = SWEEP.signal(RATE_HZ)
    assert x.size == 100_000
    assert np.abs(x).max() == pytest.approx(2.5, rel=1e-3)
    for end in (x[:20], x[-20:]):  # the ramp is a quarter of (pi 0.02)^2 there
        assert np.abs(end).max() < 2.5 * 1e-3
    # each half reaches the peak
    assert min(np.abs(x[10_000:50_000]).max(), np.abs(x[50_000:90_000]).max()) > 2.49


def test_ramp_is_a_half_cosine_and_mirrors():
    window = ramp(1000, 100)
    np.testing.assert_array_equal(window[100:900], 1.0)
    np.testing.assert_array_equal(window, window[::-1])
    assert np.all(np.diff(window[:100]) > 0.0)
    assert window[0] < 1e-4
    assert window[49] + window[50] == pytest.approx(1.0)
    np.testing.assert_array_equal(ramp(10, 0), 1.0)
    assert ramp(200, 100).max() < 1.0  # the shortest that is allowed


def lines_of(x, period):
    """Spectrum of one period in lines, with the amplitude of each sine."""
    return np.abs(np.fft.rfft(x[:period])) * 2.0 / period


@pytest.mark.parametrize(
    ("options", "lines"),
    [
        ({}, range(2, 41)),
        ({"odd": True}, range(3, 41, 2)),
        ({"lines_hz": (0.6, 1.0, 5.4, 9.8)}, (3, 5, 27, 49)),
        ({"lines_hz": (9.8, 0.6)}, (3, 49)),
    ],
)
def test_multisine_has_exactly_the_chosen_lines(options, lines):
    one = Multisine(0.4, 8.0, 5.0, 0.7, periods=3, seed=4, ramp_s=2.0, **options)
    np.testing.assert_allclose(one.lines() * 5.0, list(lines), atol=1e-9)
    assert one.band_hz == pytest.approx((min(lines) / 5.0, max(lines) / 5.0))
    x = one.signal(RATE_HZ)
    amplitude = lines_of(x[2000:], 5000)
    chosen = np.zeros(amplitude.size, dtype=bool)
    chosen[list(lines)] = True
    assert amplitude[~chosen].max() < 1e-13
    np.testing.assert_allclose(amplitude[chosen], amplitude[chosen].mean(), rtol=1e-10)  # all alike


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("odd", [False, True])
def test_multisine_has_its_peak_a_low_crest_factor_and_repeats_exactly(seed, odd):
    one = Multisine(0.5, 20.0, 10.0, 0.3, periods=3, seed=seed, odd=odd, ramp_s=1.0)
    x = one.signal(RATE_HZ)
    assert x.size == samples(one.duration_s, RATE_HZ) == 32_000
    whole = x[1000:31_000]
    np.testing.assert_array_equal(whole[:10_000], whole[10_000:20_000])
    np.testing.assert_array_equal(whole[:10_000], whole[20_000:])
    assert np.abs(whole).max() == pytest.approx(0.3, rel=1e-12)
    assert np.abs(x).max() == pytest.approx(0.3, rel=1e-12)
    crest = 0.3 / np.sqrt(np.mean(whole[:10_000] ** 2))
    assert crest < 1.8  # docstring: about 1.5-1.8; random phases alone give 3
    # the ramps lead in and out of the same period
    np.testing.assert_allclose(x[:1000], whole[9000:10_000] * ramp(32_000, 1000)[:1000], atol=1e-15)
    assert max(abs(x[0]), abs(x[-1])) < 1e-5


def test_crest_iterations_are_what_lowers_the_crest():
    def crest(n):
        x = Multisine(0.5, 20.0, 10.0, 1.0, seed=1, crest_iterations=n).signal(RATE_HZ)[1000:11_000]
        return 1.0 / np.sqrt(np.mean(x**2))

    assert crest(0) > 2.5
    assert crest(60) < 1.8


def test_seeds_choose_the_phases_and_nothing_else():
    one, again, other = (Multisine(0.5, 20.0, 4.0, 1.0, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.signal(RATE_HZ), again.signal(RATE_HZ))
    x, y = one.signal(RATE_HZ)[1000:5000], other.signal(RATE_HZ)[1000:5000]
    assert abs(x @ y) < 0.5 * (x @ x)
    np.testing.assert_array_equal(lines_of(x, 4000) > 1e-9, lines_of(y, 4000) > 1e-9)


def test_half_a_turn_is_exactly_the_other_sign():
    one, other = (Multisine(0.5, 20.0, 4.0, 0.3, seed=1, turn=turn).signal(RATE_HZ) for turn in (0.0, 0.5))
    np.testing.assert_array_equal(other, -one)


def test_a_turn_is_added_to_the_phase_of_every_line():
    one, other = (Multisine(0.5, 20.0, 4.0, 0.3, seed=1, turn=turn, turns=8) for turn in (0.0, 0.375))
    before, after = (np.fft.rfft(m.signal(RATE_HZ)[1000:5000])[2:81] for m in (one, other))
    np.testing.assert_allclose(after / before, np.exp(2j * np.pi * 0.375), rtol=1e-11)
    peaks = [
        np.abs(Multisine(0.5, 20.0, 4.0, 0.3, seed=1, turn=k / 8, turns=8).signal(RATE_HZ)).max() for k in range(8)
    ]
    assert max(peaks) == pytest.approx(0.3, rel=1e-12)
    assert min(peaks) > 0.2


@pytest.mark.parametrize("order", [3, 7, 10])
def test_prbs_is_a_maximum_length_sequence(order):
    one = Prbs(order, 0.005, 0.4, periods=3, seed=2)
    x = one.signal(RATE_HZ)
    n = 2**order - 1
    assert x.size == samples(one.duration_s, RATE_HZ) == 3 * 5 * n
    assert set(np.unique(x)) == {-0.4, 0.4}
    np.testing.assert_array_equal(x.reshape(3, -1), x[: 5 * n][None].repeat(3, axis=0))
    bits = x[: 5 * n : 5] / 0.4
    np.testing.assert_array_equal(np.repeat(bits, 5) * 0.4, x[: 5 * n])  # one bit a clock
    assert abs(bits.sum()) == 1.0  # one more of one level
    # the autocorrelation is n at zero lag and -1 elsewhere, so all lines but the mean have the same power
    np.testing.assert_allclose(np.abs(np.fft.fft(bits))[1:] ** 2, n + 1.0, rtol=1e-9)


def test_prbs_power_has_fallen_by_3_db_at_its_band_s_end():
    one = Prbs(11, 0.01, 1.0, periods=1)
    power = np.abs(np.fft.rfft(one.signal(RATE_HZ))) ** 2
    f = np.fft.rfftfreq(20_470, 1e-3)
    low = power[1:20].mean()
    end = power[np.abs(f - one.band_hz[1]) < 0.5].mean()
    assert 10.0 * np.log10(end / low) == pytest.approx(-3.0, abs=0.3)
    assert one.band_hz[0] == pytest.approx(1.0 / one.period_s)


def test_prbs_seed_only_shifts_it():
    one, other = (Prbs(7, 0.001, 1.0, periods=1, seed=s).signal(RATE_HZ) for s in (1, 2))
    assert not np.array_equal(one, other)
    assert any(np.array_equal(np.roll(one, k), other) for k in range(127))


def test_band_noise_has_its_standard_deviation_and_its_band():
    one = BandNoise(1.0, 30.0, 200.0, 0.2, seed=3)
    x = one.signal(RATE_HZ)
    assert x.size == 200_000
    inner = x[1000:-1000]
    # 2 x 29 Hz x 200 s independent values: std to 4 x 0.66 %; clipping at 3.5 takes 0.1 %
    assert inner.std() == pytest.approx(0.2, rel=0.027)
    assert np.abs(x).max() <= 3.5 * 0.2 * (1.0 + 1e-12)
    f, power = signal.welch(x, RATE_HZ, nperseg=10_000)
    inside = (f > 1.5) & (f < 29.5)
    assert power[(f > 0.5) & (f < 30.5)].sum() > 0.999 * power.sum()
    assert power[f > 40.0].max() < 1e-4 * power[inside].mean()
    assert power[inside].mean() == pytest.approx(0.2**2 / 29.0, rel=0.05)
    # flat: 39 segments with half overlap scatter each line by about 1/sqrt(36)
    assert np.std(power[inside]) < 0.25 * power[inside].mean()


def test_band_noise_is_gaussian_and_repeats_with_its_seed():
    one, again, other = (BandNoise(1.0, 100.0, 100.0, 1.0, seed=s).signal(RATE_HZ) for s in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert abs(one @ other) < 4.0 * one.size / np.sqrt(2 * 99 * 100.0)
    # spread over 20 000 independent values: kurtosis of a clipped normal, -0.02, within 4 sigma
    assert abs(np.mean((one[1000:-1000] / one[1000:-1000].std()) ** 4) - 3.0) < 0.15
