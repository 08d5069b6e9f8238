"""Indicators of recorded steps, and the error of a setpoint that moves, are those of the known response."""

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from predicted_loops import RATE_HZ
from scipy.signal import lfilter

import loopshape as ls
from loopshape.toolbox.validation.remeasured import recorded_steps, tracking


def staircase(noise: float, seed: int = 0) -> tuple[ls.Recording, LoopSetup]:
    """Steps of +0.1 at 2 s and -0.2 at 6 s of a loop 1/(0.1 s + 1), T(0) = 0.98."""
    t = np.arange(10_000) / RATE_HZ
    r = np.where(t < 2.0, 1.0, np.where(t < 6.0, 1.1, 0.9))
    move = lambda start: np.where(t >= start, 1.0 - np.exp(-(t - start) / 0.1), 0.0)  # noqa: E731
    y = 1.0 + 0.098 * move(2.0) - 0.196 * move(6.0) + noise * np.random.default_rng(seed).standard_normal(t.size)
    info = RecordingInfo("steps.parquet", "staircase", "reference")
    loop = LoopSetup("a", "r_a_rad", None, "z_a_v", "a_rad", None)
    return ls.Recording(info, RATE_HZ, {"r_a_rad": r, "a_rad": y, "z_a_v": r}), loop


@pytest.mark.parametrize("noise", [0.0, 0.0003])
def test_indicators_of_recorded_steps_are_those_of_the_response(noise: float) -> None:
    found = recorded_steps(*staircase(noise))
    assert [round(step.size, 6) for step in found] == [0.1, -0.2]
    assert [step.at_s for step in found] == [2.0, 6.0]
    for step in found:
        assert step.measured.rise_time_s == pytest.approx(0.1 * np.log(9.0), rel=0.05)
        assert step.measured.settling_time_5_s == pytest.approx(0.1 * np.log(20.0), rel=0.1)
        assert step.measured.steady_state_error == pytest.approx(0.02, abs=0.002)
        assert step.measured.overshoot < 0.02
        assert step.measured.outcome == "settled"


def test_noise_that_hides_a_band_is_said() -> None:
    found = recorded_steps(*staircase(0.004))
    assert any("noise hides" in note for note in found[0].notes)
    assert found[0].measured.outcome == "settled"


def test_a_moving_setpoint_is_no_step_and_its_error_is_predicted() -> None:
    t = np.arange(8000) / RATE_HZ
    r = np.clip(t - 1.0, 0.0, 2.0)
    y = lfilter([1.0 - np.exp(-0.01)], [1.0, -np.exp(-0.01)], r)
    info = RecordingInfo("profile.parquet", "profile", "reference")
    recording = ls.Recording(info, RATE_HZ, {"r_a_rad": r, "a_rad": y, "z_a_v": r})
    loop = LoopSetup("a", "r_a_rad", None, "z_a_v", "a_rad", None)
    assert recorded_steps(recording, loop) == ()
    answer = 1.0 - np.exp(-(t + 1.0 / RATE_HZ) / 0.1)
    found = tracking(recording, loop, t, answer)
    assert found.largest_error == pytest.approx(0.1, rel=0.01)  # a ramp of 1/s behind a lag of 0.1 s
    assert found.predicted_largest_error == pytest.approx(found.largest_error, rel=0.01)
    assert found.predicted_rms_error == pytest.approx(found.rms_error, rel=0.01)
