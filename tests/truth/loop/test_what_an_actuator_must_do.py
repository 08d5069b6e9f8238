"""Rms, peak, rate and saturation of the plant's input under a new controller, against loops simulated here."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import loopshape as ls
from loopshape.loop.margin.saturated import Actuator, Loops, simulate

RATE, N = 500.0, 16_000
NUM, DEN, _ = cont2discrete(([40.0], [1.0, 6.0, 0.0]), 1.0 / RATE)  # a motor: torque to angle
NUM = NUM.ravel()
OLD, NEW = 0.3, 2.0  # gains
F_HZ = np.geomspace(0.05, 240.0, 300)
QUANTITIES = ("error_rms", "control_rms", "control_peak", "control_rate", "saturation_percent")


def plant(f_hz):
    z = np.exp(2j * np.pi * np.asarray(f_hz) / RATE)
    return np.polyval(NUM, z) / np.polyval(DEN, z)


def looped(gain, output, torque, room=np.inf):
    """Error and input of the motor under a gain, sample by sample; torque and output are disturbed."""
    y, applied, error, control = (
        np.zeros(output.size),
        np.zeros(output.size),
        np.zeros(output.size),
        np.zeros(output.size),
    )
    for k in range(output.size):
        for i in (1, 2):
            if k >= i:
                y[k] += NUM[i] * applied[k - i] - DEN[i] * y[k - i]
        error[k] = -(y[k] + output[k])
        control[k] = gain * error[k]
        applied[k] = min(max(control[k], -room), room) + torque[k]
    return error, control


def noise(rng, n=N):
    return 0.002 * rng.standard_normal(n), lfilter([0.1], [1.0, -0.9], rng.standard_normal(n))


def controlled(gain):
    return ls.controller(ls.gain(gain), rate_hz=RATE, loop="axis")


def measured(relative=1e-3):
    return ls.FRF.from_arrays(F_HZ, plant(F_HZ), relative_std=relative, rate_hz=RATE, loop="axis")


def still(rng, n=N):
    error, control = looped(OLD, *noise(rng, n))
    return ls.Disturbance.from_arrays(error, RATE, recorded_under=controlled(OLD), control=control)


def read(disturbance, **limits):
    R = ls.Requirements("axis", unstable_poles=0, integrators=1, **limits)
    (margins,) = ls.check(measured(), controlled(NEW), R, disturbance=disturbance).margins.values()
    return margins


def test_an_actuator_that_saturates_is_what_the_sample_by_sample_loop_does():
    rng = np.random.default_rng(1)
    output, torque = noise(rng)
    e0, u0 = looped(NEW, output, torque)
    room = 1.5 * float(np.std(u0))
    e1, u1 = looped(NEW, output, torque, room)
    f = np.fft.rfftfreq(2 * N, 1.0 / RATE)
    P = plant(np.maximum(f, 1e-9))
    T, PS = NEW * P / (1.0 + NEW * P), P / (1.0 + NEW * P)
    u, e, away = simulate(u0, e0, Loops.of(T, PS), Actuator(room, room))
    assert not away
    assert np.mean(np.abs(u1) > room) > 0.05
    np.testing.assert_allclose(u, u1, atol=1e-4 * np.std(u1))
    np.testing.assert_allclose(e, e1, atol=1e-4 * np.std(e1))


@pytest.mark.long
def test_readings_are_those_of_the_loop_that_runs():
    rng, inside = (
        np.random.default_rng(2),
        dict.fromkeys(("error_rms", "control_rms", "control_peak", "control_rate", "saturation_percent"), 0),
    )
    _, free = looped(NEW, *noise(rng, 8 * N))
    room = 2.2 * float(np.std(free))
    error, control = looped(NEW, *noise(rng, 16 * N), room)
    for _ in range(12):
        margins = read(still(rng), saturation_percent=5.0, control_range=(-room, room))
        _, one = looped(NEW, *noise(rng), room)
        peaks = np.abs(one).max(), RATE * np.abs(np.diff(one)).max()
        truth = np.std(error), np.std(control), *peaks, 100.0 * np.mean(np.abs(control) > room)
        for name, value in zip(QUANTITIES, truth, strict=True):
            low, high = margins[name].interval
            inside[name] += low <= value <= high
    assert min(inside.values()) >= 9  # of 12 at 95 %: fewer once in two thousand


def test_a_profile_asks_of_the_actuator_what_the_simulated_loop_does():
    t = np.arange(2000) / RATE
    profile = 0.5 * np.sin(np.pi * t / t[-1]) ** 2
    error, control = looped(NEW, -profile, np.zeros(t.size))
    margins = read(ls.Disturbance.from_profile(profile, RATE), control_peak=3.0)
    assert margins.control_peak == pytest.approx(np.abs(control).max(), rel=2e-3)
    assert margins.control_rate == pytest.approx(RATE * np.abs(np.diff(control)).max(), rel=2e-2)
    assert margins.control_rms == pytest.approx(np.sqrt(np.mean(control**2)), rel=2e-3)
    assert margins.error_rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=2e-3)


def test_a_profile_saturates_for_its_share_of_the_move():
    t = np.arange(2000) / RATE
    profile = 0.5 * np.sin(np.pi * t / t[-1]) ** 2
    _, free = looped(NEW, -profile, np.zeros(t.size))
    room = 0.9 * float(np.abs(free).max())
    _, control = looped(NEW, -profile, np.zeros(t.size), room)
    margins = read(ls.Disturbance.from_profile(profile, RATE), saturation_percent=5.0, control_range=(-room, room))
    assert margins.saturation_percent == pytest.approx(100.0 * np.mean(np.abs(control) > room), rel=0.03)
    assert margins.control_peak == pytest.approx(np.abs(control).max(), rel=0.02)


def test_what_a_tone_might_reach_counts_at_the_end_of_its_interval():
    t = np.arange(N) / RATE
    tone = ls.Disturbance.from_arrays(0.1 * np.sin(2 * np.pi * 5.0 * t), RATE, recorded_under=controlled(NEW))
    near = 0.1 * NEW * 1.001  # a hair above the peak: within the error of its rms
    low, high = read(tone, saturation_percent=5.0, control_range=(-near, near))["saturation_percent"].interval
    assert low == 0.0
    assert high > 0.0


def test_a_derivative_without_its_filter_screams_and_fails():
    rng = np.random.default_rng(3)
    limits = {"control_rms": 1.0, "control_rate": 300.0}
    R = ls.Requirements("axis", unstable_poles=0, integrators=1, **limits)
    calm = ls.controller(ls.gain(NEW), ls.lead_lag(20.0, 60.0), rate_hz=RATE, loop="axis")
    loud = ls.controller(ls.gain(NEW), ls.lead_lag(2.0, 240.0), rate_hz=RATE, loop="axis")
    recorded = still(rng)
    assert ls.check(measured(), calm, R, disturbance=recorded).outcome == "passed"
    verdict = ls.check(measured(), loud, R, disturbance=recorded)
    assert [line.outcome for line in verdict.lines if line.quantity == "control_rate"] == ["failed"]


def test_tones_are_told_from_noise_and_keep_their_own_peak():
    t = np.arange(N) / RATE
    tone = ls.Disturbance.from_arrays(0.1 * np.sin(2 * np.pi * 5.0 * t), RATE, recorded_under=controlled(OLD))
    P = plant(5.0)
    peak = 0.1 * NEW * abs((1.0 + OLD * P) / (1.0 + NEW * P))
    R = ls.Requirements("axis", unstable_poles=0, integrators=1, control_peak=1.0)
    verdict = ls.check(measured(), controlled(NEW), R, disturbance=tone)
    (margins,) = verdict.margins.values()
    assert margins.control_peak == pytest.approx(peak, rel=0.02)
    assert any("unlike Gaussian noise" in text for text in verdict.warnings)


def test_a_shock_saturates_for_as_long_as_it_lasts():
    error = np.zeros(N)
    error[N // 2 : N // 2 + 40] = 1.0
    margins = read(
        ls.Disturbance.from_arrays(error, RATE, recorded_under=controlled(NEW)), saturation_percent=5.0,
        control_range=(-1.0, 1.0),
    )  # fmt: skip
    assert margins.saturation_percent == pytest.approx(100.0 * 40 / (0.8 * N), rel=0.1)  # of the middle that is used
    assert margins.control_peak == pytest.approx(NEW, rel=0.05)


def test_a_drift_slower_than_the_record_is_as_large_as_one_value_of_it():
    f = np.linspace(0.001, 0.002, 50)
    slow = ls.Disturbance.from_spectrum(f, np.full(50, 1e3), recorded_under=controlled(NEW), duration_s=10.0)
    margins = read(slow)
    assert margins.control_peak == pytest.approx(0.6745 * margins.control_rms, rel=0.02)  # the median of one |value|


def test_a_spectrum_has_no_peak_without_a_length_and_its_peak_is_that_of_gaussian_noise():
    spectrum = ls.Disturbance.from_spectrum([0.0, 250.0], [1e-4, 1e-4])
    assert np.isnan(read(spectrum).control_peak)
    R = ls.Requirements("axis", unstable_poles=0, integrators=1, control_peak=1.0)
    verdict = ls.check(measured(), controlled(NEW), R, disturbance=spectrum)
    assert verdict.outcome == "undecided"
    assert "duration_s" in " ".join(verdict.warnings)
    with pytest.raises(ls.errors.WrongUseError, match="belongs to a record of some length"):
        ls.tune(measured(), replace(R, phase_margin_deg=40.0), [ls.gain((0.1, 5.0))], disturbance=spectrum)


def test_a_loop_that_runs_away_when_it_saturates_is_not_predicted():
    unstable = ls.FRF.from_arrays(F_HZ, 2.0 / (2j * np.pi * F_HZ / 6.0 - 1.0) * np.exp(-2j * np.pi * F_HZ / RATE),
                                  relative_std=1e-3, rate_hz=RATE, loop="axis")  # fmt: skip
    slow = ls.Disturbance.from_spectrum([0.0, 2.0, 2.1, 250.0], [0.05, 0.05, 1e-8, 1e-8], duration_s=20.0)
    R = ls.Requirements("axis", unstable_poles=1, integrators=0, error_rms=1.0, control_range=(-0.2, 0.2))
    C = ls.controller(ls.gain(2.0), rate_hz=RATE, loop="axis")
    verdict = ls.check(unstable, C, R, disturbance=slow)
    assert verdict.outcome == "undecided"
    assert any("runs away" in text for text in verdict.warnings)


def bandwidth(tuning):
    return next(iter(tuning.verdict.margins.values())).bandwidth_hz


def test_a_tuning_keeps_the_actuator_within_its_limits():
    disturbance = still(np.random.default_rng(5))
    limits = {"control_rms": 0.6, "control_peak": 3.0, "control_rate": 400.0, "saturation_percent": 0.5}
    free = ls.Requirements("axis", modulus_margin=0.5, unstable_poles=0, integrators=1)
    R = replace(free, control_range=(-1.5, 1.5), **limits)
    made = ls.tune(measured(), R, [ls.gain((0.05, 50.0)), ls.lead_lag()], starts=2, disturbance=disturbance)
    assert made.verdict.passed
    assert {one.quantity for one in made.binding} & set(limits)
    wider = ls.tune(measured(), free, [ls.gain((0.05, 50.0)), ls.lead_lag()], starts=2)
    assert bandwidth(wider) > 1.2 * bandwidth(made)


def test_ranges_and_lengths_that_make_no_sense_are_refused():
    for ends in ((1.0, -1.0), (0.0, np.inf)):
        with pytest.raises(ls.errors.WrongUseError, match="lowest and the highest input"):
            ls.Requirements("axis", control_range=ends)
    with pytest.raises(ls.errors.WrongUseError, match="needs the actuator's range"):
        ls.Requirements("axis", saturation_percent=1.0)
    with pytest.raises(ls.errors.WrongUseError, match="comes back to where it begins"):
        ls.Disturbance.from_profile([0.0, 1.0], RATE)
    with pytest.raises(ls.errors.WrongUseError, match="needs 512 samples"):
        ls.Disturbance.from_arrays(np.zeros(100), RATE)


def test_another_rate_is_refused():
    error = np.random.default_rng(1).standard_normal(1000)
    with pytest.raises(ls.errors.WrongUseError, match="another rate"):
        ls.Disturbance.from_arrays(error, 2.0 * RATE, recorded_under=controlled(OLD))
    for other in (
        ls.Disturbance.from_arrays(error, 2.0 * RATE),
        ls.Disturbance.from_profile(error - error, 2.0 * RATE),
    ):
        with pytest.raises(ls.errors.WrongUseError, match="another rate"):
            read(other)
