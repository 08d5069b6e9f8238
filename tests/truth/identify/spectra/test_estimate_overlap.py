"""What overlapping Hann segments leave of independence, against repeated noise."""

import numpy as np
import pytest

from loopshape.core.kernels.spectra import hann, independent_share, line_overlap, period_spectra, segment_spectra

LENGTH, SEGMENTS, RECORDS = 64, 9, 1500


def products(step, lengths=LENGTH):
    """Averages (records, lines) of E N* over segments of two unrelated white noises, ends of the band left out."""
    rng = np.random.default_rng(step)
    n = lengths + (SEGMENTS - 1) * step
    E, N = (
        np.array([segment_spectra(x, lengths, step, hann(lengths)) for x in rng.standard_normal((RECORDS, n))])
        for _ in range(2)
    )
    return (E * N.conj())[:, :, 3:-3]


@pytest.mark.parametrize(("step", "share"), [(64, 1.0), (32, 0.95), (16, 0.55)])
def test_independent_share_is_that_of_repeated_noise(step, share):
    each = products(step)
    one, mean = np.mean(np.abs(each) ** 2), np.mean(np.abs(each.mean(1)) ** 2)
    predicted = independent_share(SEGMENTS, LENGTH, step, hann(LENGTH))
    # 1500 records of 27 lines, 1.4 of them as one: 170 times the power's own scatter, 0.6 to 1 %
    assert one / mean / SEGMENTS == pytest.approx(predicted, rel=0.04)
    assert predicted == pytest.approx(share, abs=0.03)


def test_lines_of_a_hann_segment_share_their_error_as_stated():
    each = products(LENGTH).mean(1)
    lines = each.shape[1]
    one, mean = np.mean(np.abs(each) ** 2), np.mean(np.abs(each.mean(1)) ** 2)
    correlation = np.abs(np.fft.fft(hann(LENGTH) ** 2)) / (hann(LENGTH) @ hann(LENGTH))
    finite = 1.0 + 2.0 * sum((1.0 - k / lines) * correlation[k] ** 2 for k in (1, 2))  # a band of 27 lines has ends
    assert lines * mean / one == pytest.approx(finite, rel=0.1)
    assert finite == pytest.approx(line_overlap(hann(LENGTH)), rel=0.02)


def test_line_overlap_of_hann_is_35_18ths():
    assert line_overlap(hann(256)) == pytest.approx(35.0 / 18.0, rel=1e-12)
    assert line_overlap(np.ones(256)) == pytest.approx(1.0, rel=1e-12)


def test_a_sine_of_amplitude_a_gives_half_of_it_in_its_line():
    t = np.arange(300) / 100.0
    spectra = period_spectra(3.0 * np.cos(2.0 * np.pi * 5.0 * t), 100)
    assert spectra.shape == (3, 51)
    np.testing.assert_allclose(spectra[:, 5], 1.5, rtol=1e-12)
    np.testing.assert_allclose(np.delete(np.abs(spectra), 5, axis=1), 0.0, atol=1e-12)
