"""Lines that no input feeds are refused with their band; those that are fed are kept."""

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import firwin, lfilter

import loopshape as ls
from loopshape.core.kernels.spectra import hann, segment_spectra
from loopshape.identify.spectra.input_power import _leaked, own_power, powered, unfed_bands


def cross_powers(signals, length):
    X = np.stack([segment_spectra(np.ascontiguousarray(x), length, length // 4, hann(length)) for x in signals])
    return np.einsum("akf,bkf->fab", X, X.conj()) / X.shape[1], np.arange(length // 2 + 1) / length


@pytest.mark.parametrize("length", [128, 204, 256, 400, 512])
def test_the_cd_players_band_above_four_tenths_is_refused_and_the_rest_kept(shared, length):
    file = shared / "data" / "daisy" / "CD_player_arm_dat.mat"
    if not file.is_file():
        pytest.skip("the CD player's recording is not in the shared data")
    S, f = cross_powers(loadmat(file)["CD_player_arm_dat"][:, :2].T, length)
    fed = powered(S)
    line = 1.0 / length
    assert not fed[f > 0.4 + 1.5 * line].any()
    assert fed[(f > 2.5 * line) & (f < 0.4 - line)].all()  # the mean is taken off: the lowest lines are empty
    band = unfed_bands(f, S, ("force 1", "force 2"))[-1]
    assert band.low_hz == pytest.approx(0.4, abs=2.5 * line)
    assert band.high_hz == 0.5
    assert band.level_db < -70.0  # its first line still lies in the window's main lobe
    assert band.inputs == (0, 1)
    assert band.sentence.startswith(f"no power of its own in force 1 and force 2 from {band.low_hz:.4g} to 0.5 Hz (")


def test_a_band_that_one_input_leaves_out_is_its_own():
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 60_000))
    stop = firwin(801, [0.2, 0.3], pass_zero=True, fs=1.0, window=("kaiser", 12.0))
    S, f = cross_powers((a, lfilter(stop, [1.0], b)), 512)
    (band,) = [x for x in unfed_bands(f, S, ("z1_v", "z2_v")) if x.high_hz > 0.01]
    assert (band.low_hz, band.high_hz) == pytest.approx((0.2, 0.3), abs=0.012)
    assert band.inputs == (1,)
    assert powered(S[:, :1, :1])[5:-5].all()


def test_an_input_that_copies_another_is_refused_where_it_does():
    rng = np.random.default_rng(1)
    a, b = rng.standard_normal((2, 60_000))
    low = firwin(801, 0.25, fs=1.0, window=("kaiser", 12.0))
    both = a + lfilter(low, [1.0], b)  # own power below a quarter only
    S, f = cross_powers((a, both), 256)
    fed = powered(S)
    assert fed[(f > 0.02) & (f < 0.24)].all()
    assert not fed[f > 0.27].any()
    assert np.linalg.cond(S[f > 0.27]).min() > 1e4
    _, share = own_power(S)
    np.testing.assert_allclose(share[(f > 0.02) & (f < 0.23)].mean(axis=0), [0.5, 0.5], atol=0.02)


def test_levels_alone_may_be_handed_in():
    f = np.linspace(0.0, 10.0, 101)
    level = np.where(f < 8.0, 1.0, 1e-9)[:, None]
    (band,) = unfed_bands(f, level)
    assert (band.low_hz, band.high_hz) == pytest.approx((8.0, 10.0))
    assert band.level_db == pytest.approx(-90.0)
    assert unfed_bands(f, np.ones((101, 2))) == []


def test_powers_of_another_shape_are_refused():
    with pytest.raises(ls.errors.WrongUseError, match=r"\(frequencies, inputs, inputs\)"):
        powered(np.ones((10, 2)))


def test_what_leaks_from_a_band_is_what_a_cliff_shows():
    # white noise up to 0.2, nothing beyond: all that is seen there leaked; by theory to half a dB where it is clear
    rng = np.random.default_rng(2)
    X = np.fft.rfft(rng.standard_normal(2**18))
    X[int(0.2 * 2**18) :] = 0.0
    S, f = cross_powers((np.fft.irfft(X),), 512)
    level = S[:, 0, 0].real
    rows = (f > 0.22) & (f < 0.3)
    np.testing.assert_allclose(10.0 * np.log10(_leaked(level)[rows] / level[rows]), 0.0, atol=0.7)
    fed = powered(S)
    assert fed[(f > 0.01) & (f < 0.2 - 1.0 / 512)].all()
    assert not fed[f > 0.2 + 1.0 / 512].any()
