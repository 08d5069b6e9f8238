"""Looking many times: the boundary is that of the literature, and keeps what it promises to numbers drawn."""

import numpy as np
import pytest

from loopshape.toolbox.rig.steps.enough import boundary, looks_s


@pytest.mark.parametrize(
    ("looks", "constant"), [(1, 1.960), (2, 2.178), (3, 2.289), (4, 2.361), (5, 2.413), (10, 2.555)]
)
def test_the_boundary_is_pococks(looks, constant):
    """Pocock, Biometrika 64 (1977); Jennison and Turnbull, Group Sequential Methods (2000), table 2.1, alpha = 0.05."""
    assert boundary(np.arange(1.0, looks + 1.0)) == pytest.approx(constant, abs=4e-3)


def test_a_random_walk_is_beyond_it_at_some_look_in_a_fortieth_of_all():
    times = np.array(looks_s((1.0, 0.0), 1.0, 60.0))
    steps = np.sqrt(np.diff(times, prepend=0.0))
    walks = np.cumsum(steps * np.random.default_rng(1).standard_normal((100_000, times.size)), axis=1)
    beyond = (walks / np.sqrt(times)).max(axis=1) > boundary(times)
    naive = (walks / np.sqrt(times)).max(axis=1) > 1.96
    assert beyond.mean() == pytest.approx(0.025, abs=3.0 * np.sqrt(0.025 / 100_000) + 1e-3)
    assert naive.mean() > 0.07  # a 95 % interval looked at again and again


def test_looks_come_at_whole_periods_and_at_the_end():
    times = looks_s((2.0, 0.7), 1.0, 61.2)
    periods = (np.array(times) - 0.7) / 2.0
    assert periods[0] == pytest.approx(4.0)
    np.testing.assert_allclose(periods[:-1], np.round(periods[:-1]), atol=1e-9)
    assert 60.0 < times[-1] <= 61.2
