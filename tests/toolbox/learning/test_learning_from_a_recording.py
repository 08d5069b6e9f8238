"""The next trial's feedforward from recordings: a plant that is known sample by sample, played trial after trial."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from scipy.signal import lfilter

import loopshape as ls
from loopshape.toolbox.learning.verbs import setpoint_of

RATE = 500.0
NUM = np.array([0.0, 0.0, 0.0, 4e-4])
DEN = np.convolve([1.0, -1.0], np.poly([0.96 * np.exp(0.09j), 0.96 * np.exp(-0.09j)]).real)
GAIN = 0.4
C = ls.controller(ls.gain(GAIN), rate_hz=RATE, loop="axis")
F_HZ = np.geomspace(0.1, 100.0, 200)
R = setpoint_of(1.0, 1.0, 4.0, 40.0, rate_hz=RATE, rest_s=3.0)
SETUP = LoopSetup("axis", "r_axis_rad", "n_axis_v", "z_axis_v", "y_rad", C)


def learning(taps=20):
    """Filters from the plant as it is."""
    back = np.exp(-2j * np.pi * F_HZ / RATE)
    P = ls.FRF.from_arrays(
        F_HZ, np.polyval(NUM[::-1], back) / np.polyval(DEN[::-1], back), relative_std=1e-4, rate_hz=RATE, loop="axis"
    )
    return ls.learning(P, C, band_hz=(0.1, 12.0), taps=taps, integrators=1)


def played(u, noise=0.0, seed=0, name="move", setpoint=R):
    """A recording of the loop along the move with `u` at the plant's input, by the difference equation."""
    closed = DEN + GAIN * np.pad(NUM, (0, DEN.size - NUM.size))
    n = noise * np.random.default_rng(seed).standard_normal(setpoint.size)
    y = lfilter(GAIN * NUM, closed, setpoint - n) + lfilter(NUM, closed, u) + n
    columns = {"r_axis_rad": setpoint, "n_axis_v": u, "z_axis_v": GAIN * (setpoint - y), "y_rad": y}
    info = RecordingInfo(f"{name}.parquet", "profile", "plant_input")
    return ls.Recording(info, RATE, columns)


def run_of(*recordings):
    return ls.Run(RATE, (SETUP,), recordings)


def rms(x):
    return float(np.sqrt(np.mean(np.asarray(x) ** 2)))


def error_of(recording):
    return R - recording.column("y_rad")


def test_the_next_trial_s_error_is_the_one_expected():
    """Six taps, which do not converge: each rms within 3 % of what the trial before let expect, also where it grows
    again; it fell by 700 before."""
    L, u, found, expected = learning(6), np.zeros(R.size), [], []
    assert L.converges is ls.Outcome.FAILED
    for _ in range(6):
        recorded = played(u)
        trial = ls.learning.next_trial(L, run_of(recorded))
        found.append(rms(error_of(recorded)))
        expected.append(trial.expected_rms)
        assert trial.error_rms == pytest.approx(found[-1], rel=1e-9)
        u = trial.feedforward
    assert found[1:5] == pytest.approx(expected[:4], rel=0.03)
    assert found[3] < found[0] / 600.0
    assert min(found[5], expected[4]) > found[4]


def test_the_update_is_that_of_the_filters():
    """u_next = Q (u + F e + z), of a trial that had a feedforward already."""
    L = learning()
    u = ls.learning.next_trial(L, run_of(played(np.zeros(R.size)))).feedforward
    second = played(u)
    wanted = L.next(u, error_of(second), GAIN * error_of(second))
    assert ls.learning.next_trial(L, run_of(second)).feedforward == pytest.approx(wanted, abs=1e-12)


def test_repetitions_tell_what_cannot_be_learned():
    """Sixteen noisy repetitions: the scatter's rms is that of S n within 5 %, the noise that is learned is a quarter
    of one recording's within a half, and what repeats is the error without noise within 5 %."""
    L, zero = learning(), np.zeros(R.size)
    noisy = [played(zero, 0.1, seed, f"r{seed}") for seed in range(16)]
    clean = ls.learning.next_trial(L, run_of(played(zero)))
    all16, one = ls.learning.next_trial(L, run_of(*noisy)), ls.learning.next_trial(L, run_of(noisy[0]))
    assert all16.repetitions == 16
    assert one.scatter_rms is None
    truth = rms([error_of(r) - error_of(played(zero)) for r in noisy])
    assert all16.scatter_rms == pytest.approx(truth, rel=0.05)
    assert all16.repeated_rms == pytest.approx(clean.error_rms, rel=0.05)
    assert all16.expected_rms == pytest.approx(np.hypot(clean.expected_rms, truth), rel=0.05)
    mean = np.mean([error_of(r) for r in noisy], axis=0)
    assert all16.feedforward == pytest.approx(L.next(zero, mean, GAIN * mean), abs=1e-9)
    learned = rms(all16.feedforward - clean.feedforward) / rms(one.feedforward - clean.feedforward)
    assert 0.125 < learned < 0.375


def test_a_move_that_repeats_within_one_recording_is_folded():
    there_and_back = np.concatenate([R, R[-1] - R])
    three = np.tile(there_and_back, 3)
    L = learning()
    whole = ls.learning.next_trial(
        L, run_of(played(np.zeros(three.size), setpoint=three)), period_s=there_and_back.size / RATE
    )
    once = ls.learning.next_trial(L, run_of(played(np.zeros(there_and_back.size), setpoint=there_and_back)))
    assert whole.repetitions == 3
    assert whole.feedforward == pytest.approx(np.tile(once.feedforward, 3), abs=1e-6 * np.abs(once.feedforward).max())


def test_recordings_that_are_no_trial_are_refused():
    L, zero = learning(), np.zeros(R.size)
    first = played(zero)
    for other, said in (
        (played(zero + 1.0, name="b"), "differ in their feedforward"),
        (played(zero, setpoint=2.0 * R, name="b"), "differ in their setpoint"),
        (played(zero[:-5], setpoint=R[:-5], name="b"), "one length"),
    ):
        with pytest.raises(ls.errors.WrongUseError, match=said):
            ls.learning.next_trial(L, run_of(first, other))
        assert ls.learning.next_trial(L, run_of(first, other), recordings=["move"]).repetitions == 1
    excited = ls.Recording(replace(first.info, injection="controller_input", excites="axis"), RATE, first.columns)
    with pytest.raises(ls.errors.WrongUseError, match="with the loop closed"):
        ls.learning.next_trial(L, run_of(excited))
    with pytest.raises(ls.errors.WrongUseError, match="with the loop closed"):
        ls.learning.next_trial(L, replace(run_of(first), loops=(replace(SETUP, reference=None),)))
    with pytest.raises(ls.errors.WrongUseError, match="rate of its filters"):
        ls.learning.next_trial(L, run_of(ls.Recording(first.info, 250.0, first.columns)))
    with pytest.raises(ls.errors.WrongUseError, match="whole number of samples"):
        ls.learning.next_trial(L, run_of(first), period_s=0.0033)
    with pytest.raises(ls.errors.WrongUseError, match="without one"):
        ls.learning.next_trial(L, run_of())
