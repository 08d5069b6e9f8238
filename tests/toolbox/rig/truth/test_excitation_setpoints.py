"""Setpoints: staircases step where they say, profiles keep their limits and end on target."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loopshape.toolbox.rig.excitation.setpoints import Profile, Staircase

RATE_HZ = 1000.0


def test_staircase_steps_at_its_times():
    x = Staircase((0.0, 0.1, 0.25), (1.0, -2.0, 3.0)).sampled(400, RATE_HZ, before=9.0)
    np.testing.assert_array_equal(x, np.repeat([1.0, -2.0, 3.0], [100, 150, 150]))


def test_staircase_waits_at_the_value_before():
    x = Staircase((0.2,), (1.0,)).sampled(400, RATE_HZ, before=-0.5)
    np.testing.assert_array_equal(x, np.repeat([-0.5, 1.0], 200))


def test_staircase_s_time_between_samples_takes_the_next_sample():
    x = Staircase((0.0101,), (1.0,)).sampled(20, RATE_HZ, before=0.0)
    assert np.flatnonzero(x)[0] == 11


def test_staircase_at_a_sample_s_time_starts_there():
    for k in range(0, 3000, 7):  # times that binary numbers miss
        x = Staircase((k / RATE_HZ,), (1.0,)).sampled(3000, RATE_HZ, before=0.0)
        assert np.flatnonzero(x)[0] == k


def derivatives(profile, duration_s, before, rate_hz=1000.0):
    """Values, velocity, acceleration and jerk by differences; the jerk's at the corners is a mean."""
    x = profile.sampled(round(duration_s * rate_hz), rate_hz, before)
    return x, *(np.diff(x, k) * rate_hz**k for k in (1, 2, 3))


def rounding(size, jerk, whole_s, k, rate_hz=1000.0):
    """Rounding of a k-th difference: positions are sums of cubes up to jerk T^3/6, and differences double it."""
    return np.finfo(float).eps * (2.0 * size + 4.0 * jerk * whole_s**3 / 6.0) * (2.0 * rate_hz) ** k


CASES = {
    "jerk alone": (0.01, (60.0, 300.0, 3000.0)),
    "jerk and acceleration": (20.0, (200.0, 300.0, 6000.0)),
    "all limits": (40.0, (60.0, 300.0, 3000.0)),
    "velocity without constant acceleration": (30.0, (10.0, 300.0, 3000.0)),
}


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_profile_keeps_its_limits_and_ends_on_target(case, down):
    distance, limits = CASES[case]
    target = -distance if down else distance
    x, *slopes = derivatives(Profile((0.1,), (1.0 + target,), *limits), 5.0, 1.0)
    whole_s = np.flatnonzero(np.diff(x)).max() / RATE_HZ - 0.1
    for k, (slope, limit) in enumerate(zip(slopes, limits, strict=True), start=1):
        assert np.abs(slope).max() <= limit + rounding(np.abs(x).max(), limits[2], whole_s, k)
    np.testing.assert_array_equal(x[:101], 1.0)
    left = rounding(np.abs(x).max(), limits[2], whole_s, 0)
    np.testing.assert_allclose(x[4000:], 1.0 + target, rtol=0.0, atol=left)
    assert np.all(np.sign(target) * np.diff(x) >= -2.0 * left)  # no overshoot
    assert left < 1e-10


def test_profile_uses_its_limits():
    """The move takes the least time of a third-order profile: all limits are reached."""
    x, velocity, acceleration, jerk = derivatives(Profile((0.1,), (40.0,), 60.0, 300.0, 3000.0), 3.0, 0.0)
    assert velocity.max() == pytest.approx(60.0, rel=1e-9)
    assert acceleration.max() == pytest.approx(300.0, rel=1e-3)
    assert -acceleration.min() == pytest.approx(300.0, rel=1e-3)
    assert np.abs(jerk).max() == pytest.approx(3000.0, rel=0.05)
    # v/a + a/j to the cruise and the same from it: D/v + v/a + a/j in all
    end = np.flatnonzero(np.abs(x - 40.0) > 1e-9)[-1] / RATE_HZ
    assert end == pytest.approx(0.1 + 40.0 / 60.0 + 60.0 / 300.0 + 300.0 / 3000.0, abs=0.003)


@given(
    distance=st.floats(1e-4, 100.0),
    velocity=st.floats(0.5, 100.0),
    acceleration=st.floats(1.0, 1000.0),
    jerk=st.floats(5.0, 1e4),
)
def test_any_profile_keeps_its_limits_and_ends_on_target(distance, velocity, acceleration, jerk):
    n = 4000
    # long enough: cruise at the velocity, plus the ramps
    whole_s = distance / velocity + velocity / acceleration + acceleration / jerk + 3.0 * np.cbrt(4.0 * distance / jerk)
    rate_hz = n / (1.2 * whole_s + 0.1)
    x, v, a, _ = derivatives(Profile((0.0,), (distance,), velocity, acceleration, jerk), n / rate_hz, 0.0, rate_hz)
    assert x[-1] == pytest.approx(distance, abs=rounding(distance, jerk, whole_s, 0))
    assert v.max() <= velocity + rounding(distance, jerk, whole_s, 1, rate_hz)
    assert np.abs(a).max() <= acceleration + rounding(distance, jerk, whole_s, 2, rate_hz)
    assert x.max() <= distance + rounding(distance, jerk, whole_s, 0)


def test_profile_moves_from_point_to_point():
    x = Profile((0.5, 2.0, 4.0), (10.0, -5.0, -5.0), 60.0, 300.0, 3000.0).sampled(6000, RATE_HZ, 2.0)
    for second, value in ((0.5, 2.0), (1.9, 10.0), (3.9, -5.0), (5.9, -5.0)):
        assert x[round(second * RATE_HZ)] == pytest.approx(value, abs=1e-12)


def test_profile_stays_on_target_long_after_the_move():
    """Its cubes, left to grow with time, cancelled to 3e-4 deg after 1000 s."""
    x = Profile((1.0,), (30.0,), 60.0, 300.0, 3000.0).sampled(1_000_000, RATE_HZ, 0.0)
    np.testing.assert_allclose(x[5000:], 30.0, rtol=0.0, atol=1e-12)


def test_profile_between_equal_points_stands_still():
    x = Profile((0.1,), (3.0,), 1.0, 1.0, 1.0).sampled(500, RATE_HZ, 3.0)
    np.testing.assert_array_equal(x, 3.0)
