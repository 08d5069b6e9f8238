"""The spline between the lines of a response is scipy's `CubicSpline`, bit for bit."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from loopshape.data.response.smoothed import spline


@pytest.mark.parametrize("lines", [4, 6, 50, 900])
@pytest.mark.parametrize("shape", [(), (2, 3)])
def test_spline_is_scipy_s_to_the_last_bit(lines: int, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(lines)
    f = np.cumsum(rng.random(lines) + 0.01)
    values = rng.standard_normal((lines, *shape)) + 1j * rng.standard_normal((lines, *shape))
    at = np.sort(np.concatenate([f, f[0] + (f[-1] - f[0]) * rng.random(300)]))
    gaps = np.clip(np.searchsorted(f, at, side="right") - 1, 0, lines - 2)
    assert np.array_equal(spline(f, values, at, gaps), CubicSpline(f, values)(at))
