"""Multiple and partial coherence: theory of a known system of two inputs, and the bias of few averages."""

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from loopshape.core.kernels.spectra import hann, segment_spectra
from loopshape.identify.matrix.matrix import coherences


def unrelated(inputs, averages, records, seed):
    """Cross-powers (records, q + 1, q + 1) of an output and q inputs over K independent Gaussian averages."""
    rng = np.random.default_rng(seed)
    shape = (records, inputs + 1, averages)
    X = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    return X @ X.conj().transpose(0, 2, 1) / averages


@pytest.mark.parametrize(("inputs", "averages"), [(1, 2), (1, 8), (2, 3), (2, 10), (3, 4), (3, 12), (4, 40)])
def test_few_averages_show_coherence_where_there_is_none(inputs, averages):
    records = 20_000
    multiple, partial = coherences(unrelated(inputs, averages, records, 7 * inputs + averages), 1, averages)
    of_multiple, of_partial = inputs / averages, 1.0 / (averages - inputs + 1.0)  # Bendat and Piersol, 9.2
    # a beta variable's standard deviation lies below its mean here or below 0.3
    assert multiple.mean() == pytest.approx(of_multiple, abs=4.0 * 0.3 / np.sqrt(records))
    assert partial.mean() == pytest.approx(of_partial, abs=4.0 * 0.35 / np.sqrt(records))


@pytest.mark.parametrize(("inputs", "averages"), [(1, 1.0), (2, 2.0), (3, 2.5)])
def test_as_many_averages_as_inputs_tell_nothing(inputs, averages):
    whole = max(1, int(averages))
    multiple, partial = coherences(unrelated(inputs, whole, 10, 1), 1, averages)
    assert multiple is None
    assert partial is None


def test_coherences_of_a_known_system_of_two_inputs():
    # y1 = G1 u1 + G2 u2 + e, u2 partly follows u1; y2 = u2 alone, without noise
    rng = np.random.default_rng(2)
    a, b, e = rng.standard_normal((3, 1_000_000))
    u1, u2 = a, 0.6 * a + 0.8 * b
    G1, G2 = ([0.5], [1.0, -0.5]), ([0.0, 1.0], [1.0, 0.6])
    y1 = lfilter(*G1, u1) + lfilter(*G2, u2) + 0.7 * e
    length = 256
    X = np.stack([segment_spectra(x, length, length // 2, hann(length)) for x in (y1, u2, u1, u2)])
    S = np.einsum("akf,bkf->fab", X, X.conj()) / X.shape[1]
    multiple, partial = coherences(S, 2, float(X.shape[1]))
    w = 2.0 * np.pi * np.arange(length // 2 + 1) / length
    g1, g2 = (freqz(*g, worN=w)[1] for g in (G1, G2))
    Suu = np.array([[1.0, 0.6], [0.6, 1.0]])
    G = np.stack([g1, g2], axis=1)
    explained = np.real(np.einsum("fi,ij,fj->f", G, Suu, G.conj()))
    noise = 0.49
    rows = slice(3, -3)
    np.testing.assert_allclose(multiple[rows, 0], (explained / (explained + noise))[rows], atol=0.012)
    # beyond the other input, each has (1 - 0.36) of its power left
    for k, g in enumerate((g1, g2)):
        own = 0.64 * np.abs(g) ** 2
        np.testing.assert_allclose(partial[rows, 0, k], (own / (own + noise))[rows], atol=0.02)
    np.testing.assert_allclose(multiple[rows, 1], 1.0, atol=1e-9)
    np.testing.assert_allclose(partial[rows, 1, 1], 1.0, atol=1e-9)
    assert partial[rows, 1, 0].max() < 0.05  # y2 follows u1 through u2 only
    ordinary = np.abs(S[:, 1, 2]) ** 2 / (S[:, 1, 1] * S[:, 2, 2]).real
    assert ordinary[rows].mean() == pytest.approx(0.36, abs=0.01)  # which the ordinary coherence does not say
