"""Feedforward from a measured plant: the inverse, the error it leaves on a setpoint, and a run on the simulated arm."""

import json
from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Experiment
from commands import invoked
from run_files import write_frfs
from scipy.signal import cont2discrete, lfilter
from scipy.stats import binom
from simulated_machines import Arm1
from study_signals import Profile

import loopshape as ls
from loopshape.toolbox.learning.verbs import setpoint_of

RATE = 500.0
F_HZ = np.geomspace(0.1, 100.0, 200)
INTEGRATOR = np.array([1.0, -1.0])
NUM = np.array([0.0, 0.0, 0.0, 4e-4])
DEN = np.convolve(INTEGRATOR, np.poly([0.96 * np.exp(0.09j), 0.96 * np.exp(-0.09j)]).real)
C = ls.controller(ls.gain(0.4), rate_hz=RATE, loop="axis")


def plant(f_hz):
    """An integrator and a resonance at 7 Hz behind two samples of delay."""
    back = np.exp(-2j * np.pi * np.asarray(f_hz) / RATE)
    return np.polyval(NUM[::-1], back) / np.polyval(DEN[::-1], back)


def measured(rng=None, relative=0.02):
    P = plant(F_HZ)
    if rng is not None:
        d = rng.standard_normal((2, F_HZ.size))
        P = P * (1.0 + relative * (d[0] + 1j * d[1]) / np.sqrt(2.0))
    return ls.FRF.from_arrays(F_HZ, P, relative_std=relative, rate_hz=RATE, loop="axis")


def followed(r, u=None):
    """The error of the loop, sample by sample, with `u` added to the plant's input."""
    closed = DEN + 0.4 * np.pad(NUM, (0, DEN.size - NUM.size))
    e = lfilter(DEN, closed, r)
    return e if u is None else e - lfilter(NUM, closed, u)


MOVE = Profile((3.0,), (0.35,), 0.6, 2.0, 12.0).sampled(14_000, 1000.0, 0.0)  # rad
R = setpoint_of(1.0, 1.0, 4.0, 40.0, rate_hz=RATE, rest_s=2.0)


def test_a_known_plant_is_inverted_between_lines_too():
    """Within 5 % over the lower half of the band; at its end F begins to let go, and says how much."""
    F = ls.learning.feedforward(measured(relative=1e-4), band_hz=(0.1, 20.0), taps=60, integrators=1)
    f = np.geomspace(0.1, 10.0, 77)
    assert np.abs(1.0 - plant(f) * F.response(f)).max() < 0.05
    assert F.inverse_error == pytest.approx(np.abs(1.0 - plant(F.frequency_hz) * F.response(F.frequency_hz)), abs=1e-4)
    assert F.taps.sum() == pytest.approx(0.0, abs=1e-9 * np.abs(F.taps).max())  # a constant setpoint needs no input


def test_the_signal_is_the_response():
    F = ls.learning.feedforward(measured(), band_hz=(0.1, 20.0), integrators=1)
    k = np.arange(4000)
    sine = np.sin(2.0 * np.pi * 5.0 * k / RATE)
    wanted = np.imag(F.response([5.0])[0] * np.exp(2j * np.pi * 5.0 * k / RATE))
    assert F.signal(sine)[500:-500] == pytest.approx(wanted[500:-500], abs=1e-6)


@pytest.mark.parametrize("helped", [False, True])
def test_the_predicted_error_is_that_of_the_loop_sample_by_sample(helped):
    P = measured(relative=1e-4)
    F = ls.learning.feedforward(P, band_hz=(0.1, 20.0), taps=60, integrators=1) if helped else None
    found = ls.learning.tracking_error(P, C, R, F, integrators=1)
    e = followed(R, F.signal(R) if F else None)
    assert found.error == pytest.approx(e, abs=0.01 * np.abs(followed(R)).max())
    assert found.rms == pytest.approx(np.sqrt(np.mean(e**2)), rel=0.05, abs=5e-5)  # rad, of 0.1 without


def test_feedforward_from_noisy_data_leaves_what_was_predicted():
    """20 measurements of 2 %: rms and largest error lie below the ends of their intervals as often as binomial chance
    of 1e-4 allows, the numbers are right within a factor of four; feedforward leaves a tenth of the error."""
    rng, below = np.random.default_rng(1), np.zeros(2)
    without = np.sqrt(np.mean(followed(R) ** 2))
    for _ in range(20):
        P = measured(rng)
        F = ls.learning.feedforward(P, band_hz=(0.1, 20.0), integrators=1)
        found, e = ls.learning.tracking_error(P, C, R, F, integrators=1), followed(R, F.signal(R))
        rms, most = np.sqrt(np.mean(e**2)), np.abs(e).max()
        assert rms < 0.1 * without
        assert 0.25 * found.largest < most < 4.0 * found.largest
        below += [low <= x <= high for (low, high), x in ((found.rms_interval, rms), (found.largest_interval, most))]
    assert (below >= binom.ppf(1e-4, 20, 0.95)).all()


def test_without_feedforward_the_interval_covers_the_error():
    """20 measurements of 5 %: rms in its interval as often as binomial chance of 1e-4 allows."""
    rng, truth = np.random.default_rng(2), np.sqrt(np.mean(followed(R) ** 2))
    found = [ls.learning.tracking_error(measured(rng, 0.05), C, R, integrators=1).rms_interval for _ in range(20)]
    assert sum(low <= truth <= high for low, high in found) >= binom.ppf(1e-4, 20, 0.95)


def test_what_cannot_be_inverted_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match="four frequencies"):
        ls.learning.feedforward(measured(), band_hz=(1.0, 1.05))
    with pytest.raises(ls.errors.WrongUseError, match="hold its preview"):
        ls.learning.feedforward(measured(), taps=10, preview=10)
    F = ls.learning.feedforward(measured(), band_hz=(0.1, 20.0))
    with pytest.raises(ls.errors.WrongUseError, match="one rate"):
        ls.learning.tracking_error(measured(), ls.controller(ls.gain(1.0), rate_hz=1000.0), R, F)


@pytest.mark.long
def test_the_command_writes_taps_and_predicts_a_move(tmp_path):
    run = ls.Run.from_arrays(u=np.ones(100), y=np.ones(100), rate_hz=RATE, loop="axis", recording="r1")
    ls.write(run, tmp_path / "run")
    P = measured(np.random.default_rng(2))
    write_frfs(tmp_path / "run", [replace(P, recording="r1")])
    ls.write(C, tmp_path / "c.toml")
    words = ["feedforward", tmp_path / "run", "--out", tmp_path / "f.json", "--band-hz", 0.1, 20, "--json"]
    words += ["--controller", tmp_path / "c.toml", "--move", 1, 1, 4, 40]
    done = invoked(words)
    told = json.loads(done.stdout)
    assert told["errors"]["with feedforward"]["rms"] < 0.1 * told["errors"]["without"]["rms"]
    assert json.loads((tmp_path / "f.json").read_text())["taps"] == told["taps"]
    assert told["figures"][0].endswith("feedforward_axis.png")


def test_trials_shrink_as_the_convergence_factor_says():
    """The change of the input from trial to trial shrinks at each frequency as |Q S (1 - P F)| says."""
    L = ls.learning(measured(relative=1e-4), C, band_hz=(0.1, 12.0), taps=20, integrators=1)
    assert L.converges is ls.Outcome.PASSED
    k = np.arange(12_000)
    for hz in (2.0, 6.0, 11.0):
        r = np.sin(2.0 * np.pi * hz * k / RATE) * np.hanning(k.size) ** 4
        u = [np.zeros(k.size)]
        for _ in range(2):
            e = followed(r, u[-1])
            u.append(L.next(u[-1], e, 0.4 * e))
        left = np.std(u[2] - u[1]) / np.std(u[1])
        assert left == pytest.approx(np.interp(hz, L.frequency_hz, L.factor), rel=0.1)


def test_convergence_is_passed_undecided_or_failed_by_its_interval():
    L = ls.learning(measured(), C, band_hz=(0.1, 12.0), integrators=1)
    level = np.full(L.factor.size, 0.5)
    for low, high, outcome in ((0.4, 0.9, "passed"), (0.4, 1.1, "undecided"), (1.1, 1.3, "failed")):
        ends = {"factor_low": low * level / 0.5, "factor_high": high * level / 0.5}
        assert replace(L, factor=level, **ends).converges == outcome


def arm_experiment(arm, controllers, name, injection, references, injected, **more):
    loops = arm.loop_setups(controllers, injection)
    point = {"theta2_deg": 0.0, "p_ab_bar": 1.2}
    kind = "profile" if more.get("excites") is None else "multisine"
    return Experiment(name, kind, loops, 1000.0, references, injected, injection, point, seed=1, **more)


@pytest.fixture(scope="module")
def arm():
    """The simulated arm at 0 deg and 1.2 bar, its controllers, and its angle's FRF from a multisine of 60 s."""
    arm, rng, period = Arm1(), np.random.default_rng(1), 20_000
    pressure = next(c for c in arm.default_controllers(1000.0) if c.loop == "p_ab")
    controllers = [ls.controller(ls.gain(0.5), rate_hz=1000.0, loop="theta2"), pressure]
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    lines = np.arange(1, 400)
    spectrum[lines] = np.exp(2j * np.pi * rng.uniform(size=lines.size)) / np.sqrt(np.maximum(lines / 20.0, 2.0))
    wave = np.fft.irfft(spectrum, period)
    rest = np.tile([0.0, 1.2], (3 * period, 1))
    injected = np.zeros_like(rest)
    injected[:, 0] = np.tile(0.06 * wave / wave.std(), 3)
    periods = {"excites": "theta2", "period_s": 20.0, "periodic_from_s": 20.0}
    asked = arm_experiment(arm, controllers, "id", "controller_input", rest, injected, **periods)
    recorded = arm.simulate([asked], threads=1)
    return arm, controllers, ls.frf(ls.Run(1000.0, asked.loops, tuple(recorded)), "theta2")


def moved(arm, controllers, u=None):
    """Error of the angle and the controller's output along a third-order move of 0.35 rad, with `u` at the input."""
    r = np.tile([0.0, 1.2], (14_000, 1))
    r[:, 0] = MOVE
    injected = np.zeros_like(r)
    injected[:, 0] = 0.0 if u is None else u
    (found,) = arm.simulate([arm_experiment(arm, controllers, "move", "plant_input", r, injected)], threads=1)
    return MOVE - found.column("theta2_rad"), found.column("z_theta2_v")


def test_the_simulated_arm_follows_a_profile_with_a_fifth_of_the_error(arm):
    arm, controllers, P = arm
    F = ls.learning.feedforward(P, band_hz=(0.05, 5.0), integrators=1)
    (without, _), (helped, _) = moved(arm, controllers), moved(arm, controllers, F.signal(MOVE))
    assert np.std(helped) < 0.2 * np.std(without)
    assert np.abs(helped).max() < 0.2 * np.abs(without).max()


def test_the_simulated_arm_learns_the_profile_in_three_trials(arm):
    arm, controllers, P = arm
    L = ls.learning(P, controllers[0], band_hz=(0.05, 5.0), integrators=1)
    assert L.converges is ls.Outcome.PASSED
    u, errors = np.zeros(MOVE.size), []
    for _ in range(4):
        e, z = moved(arm, controllers, u)
        errors.append(float(np.sqrt(np.mean(e**2))))
        u = L.next(u, e, z)
    assert errors[1] < 0.2 * errors[0]
    assert errors[3] < 0.02 * errors[0]  # friction and the valves' dead zone are learned too


def sampled(num, den, f_hz):
    back = np.exp(2j * np.pi * f_hz / RATE)
    return np.polyval(num, back) / np.polyval(den, back)


@pytest.mark.parametrize("pole_hz", [0.3, 0.6])
def test_what_lies_below_the_first_line_is_in_the_interval(pole_hz):
    """An integrator and a pole below lines from 1 Hz on: rms and largest error of the loop, sample by sample, lie in
    their intervals (rms 16 % and largest 20 % below the intervals of 0.5 %, before)."""
    w = 2.0 * np.pi * pole_hz
    num, den, _ = cont2discrete(([30.0 * w], [1.0, w, 0.0]), 1.0 / RATE, "zoh")
    num, f_hz, rng = num.ravel(), np.geomspace(1.0, 240.0, 100), np.random.default_rng(3)
    d = 0.002 * rng.standard_normal((2, 100)) / np.sqrt(2.0)
    P = ls.FRF.from_arrays(f_hz, sampled(num, den, f_hz) * (1.0 + d[0] + 1j * d[1]), relative_std=0.002, rate_hz=RATE)
    slow = ls.controller(ls.gain(0.5), ls.lead_lag(1.0, 10.0), rate_hz=RATE)
    b = np.prod(slow.biquads()[:, 0]) * np.array([1.0, slow.biquads()[-1, 1] / slow.biquads()[-1, 0]])
    a = np.array([1.0, slow.biquads()[-1, 3]])
    e = lfilter(np.polymul(a, den), np.polyadd(np.polymul(a, den), np.polymul(b, num)), R)
    found = ls.learning.tracking_error(P, slow, R, integrators=1)
    assert found.rms_interval[0] <= np.sqrt(np.mean(e**2)) <= found.rms_interval[1]
    assert found.largest_interval[0] <= np.abs(e).max() <= found.largest_interval[1]


def test_a_loop_without_integrators_keeps_its_error_at_the_end():
    """A static plant of 1 under a gain of 4 ends with a fifth of the move; it was read about no mean."""
    f_hz = np.geomspace(0.1, 200.0, 200)
    num, den, _ = cont2discrete(([60.0], [1.0, 60.0]), 1.0 / RATE, "zoh")
    P = ls.FRF.from_arrays(f_hz, sampled(num.ravel(), den, f_hz), relative_std=0.001, rate_hz=RATE)
    gain = ls.controller(ls.gain(4.0), rate_hz=RATE)
    found = ls.learning.tracking_error(P, gain, R, integrators=0)
    e = lfilter(den, den + 4.0 * num.ravel(), R)
    assert found.error[-1] == pytest.approx(0.2, abs=0.005)
    assert found.error == pytest.approx(e, abs=0.01)
    assert found.rms_interval[0] <= np.sqrt(np.mean(e**2)) <= found.rms_interval[1]


def test_an_error_that_does_not_end_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match="is unstable"):
        ls.learning.tracking_error(measured(), ls.controller(ls.gain(40.0), rate_hz=RATE), R, unstable_poles=0)
    hasty = np.interp(np.arange(475) / RATE, [0.5, 0.9], [0.0, 1.0])  # ends 50 ms after its move
    with pytest.raises(ls.errors.WrongUseError, match="died out"):
        ls.learning.tracking_error(measured(), C, hasty, integrators=1)
