"""Transforms that are made of parts are those of the whole record, to rounding."""

import numpy as np
import pytest
from scipy.signal import hilbert

from loopshape.identify.spectra import transforms
from loopshape.identify.spectra.transforms import low_lines, quadrature


@pytest.mark.parametrize("part", [1 << 20, 700])
@pytest.mark.parametrize("n", [4096, 12_150, 3645])
def test_lines_and_quadrature(n, part, monkeypatch):
    monkeypatch.setattr(transforms, "PART", part)
    monkeypatch.setattr(transforms, "SHARE", n)
    x = np.random.default_rng(n).standard_normal(n) + 3.0
    whole = np.fft.rfft(x)
    for last in (0, n // 7, n // 2):
        assert np.allclose(low_lines(x, last), whole[: last + 1], rtol=0.0, atol=1e-14 * np.abs(whole).max())
    assert np.allclose(quadrature(x), hilbert(x - 3.0).imag, rtol=0.0, atol=1e-13)
