"""PID by times and by gains, notch by depth and width: against their formulas, at a rate high enough for no warping."""

import numpy as np
import pytest

import loopshape as ls

F = np.geomspace(0.1, 200.0, 50)
S = 2j * np.pi * F
RATE = 1e6


def response(block):
    return ls.controller(block, rate_hz=RATE).response(F)


def test_pid_by_times_and_in_parallel():
    true = 3.0 * (1.0 + 1.0 / (0.4 * S) + 0.05 * S / (0.002 * S + 1.0))
    np.testing.assert_allclose(response(ls.pid(kp=3.0, ti=0.4, td=0.05, tf=0.002)), true, rtol=1e-5)
    true = 3.0 + 7.0 / S + 0.2 * S / (0.002 * S + 1.0)
    np.testing.assert_allclose(response(ls.pid(kp=3.0, ki=7.0, kd=0.2, tf=0.002)), true, rtol=1e-5)


@pytest.mark.parametrize(("depth_db", "width_hz"), [(40.0, 2.0), (6.0, 30.0), (3.1, 5.0)])
def test_a_notch_is_as_deep_and_as_wide_as_asked(depth_db, width_hz):
    notch = ls.controller(ls.notch(50.0, depth_db=depth_db, width_hz=width_hz), rate_hz=RATE)
    assert abs(notch.response([50.0])[0]) == pytest.approx(10.0 ** (-depth_db / 20.0), rel=1e-4)
    low = np.sqrt(50.0**2 + 0.25 * width_hz**2) - 0.5 * width_hz  # f2 - f1 = width, f1 f2 = 50^2
    np.testing.assert_allclose(np.abs(notch.response([low, low + width_hz])), np.sqrt(0.5), rtol=1e-4)


@pytest.mark.parametrize(
    "keys", [{"kp": 1.0}, {"kp": 1.0, "ti": 1.0, "td": 1.0, "ki": 1.0}, {"kp": 1.0, "ti": 0.0, "td": 1.0, "tf": 1.0}]
)
def test_a_pid_half_said_is_refused(keys):
    with pytest.raises(ls.LoopshapeError, match="kp, ti, td, tf or kp, ki, kd, tf"):
        ls.pid(**keys)


@pytest.mark.parametrize(
    "keys", [{"depth_db": 20.0}, {"depth_db": 3.0, "width_hz": 2.0}, {"depth_db": 20.0, "width_hz": -1.0}]
)
def test_a_notch_half_said_is_refused(keys):
    with pytest.raises(ls.LoopshapeError, match="a notch by its depth"):
        ls.notch(50.0, **keys)
    with pytest.raises(ls.LoopshapeError, match="a notch by its depth"):
        ls.notch((40.0, 60.0), depth_db=20.0, width_hz=2.0)
    with pytest.raises(ls.LoopshapeError, match="a notch by its depth"):
        ls.notch(50.0, 0.1, depth_db=20.0, width_hz=2.0)
