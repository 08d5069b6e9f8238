"""Feedback is found where there is some, and in 1 % of the records where there is none, whatever the plant."""

import numpy as np
import pytest
from bench_nouns import LoopSetup
from known_loops import RATE, A, B, record, run_loop
from scipy.signal import firwin, lfilter

import loopshape as ls
from loopshape.identify.quality.feedback_check import feedback_check, repeats
from loopshape.identify.quality.quality import loop_feedback, open_loop_note

N = 2000
LOOP = LoopSetup("axis", None, None, "z_v", "y_rad", None)


def white(rng):
    return rng.standard_normal(N)


def coloured(rng):
    return lfilter([1.0], np.poly([0.95, 0.6 * np.exp(1j), 0.6 * np.exp(-1j)]).real, rng.standard_normal(N))


def prbs(rng):
    return np.repeat(np.sign(rng.standard_normal(N // 5)), 5)


def sweep(rng):
    t, k = np.arange(N) / RATE, np.log(200.0)
    return np.sin(2.0 * np.pi * 0.2 * N / RATE / k * np.expm1(k * t * RATE / N))


def multisine(rng):
    f = np.arange(1, 100) * RATE / 500
    return np.tile(
        np.cos(2.0 * np.pi * np.outer(np.arange(500) / RATE, f) + rng.uniform(0, 7, f.size)).sum(1), N // 500
    )


def open_loop(u, rng, noise=0.3):
    return lfilter(B, A, u) + lfilter([1.0], [1.0, -0.9], noise * rng.standard_normal(N))


def probabilities(make, records, first_seed=0, **words):
    found = []
    for seed in range(records):
        rng = np.random.default_rng(first_seed + seed)
        found.append(feedback_check(*make(rng), **words).probability)
    return np.array(found)


@pytest.mark.long
@pytest.mark.parametrize("excitation", [white, coloured, prbs, sweep, multisine])
def test_one_record_in_a_hundred_is_a_false_alarm(excitation):
    def make(rng):
        u = excitation(rng)
        if excitation is multisine:  # one that repeats exactly is no feedback without any test
            u = u + 1e-3 * rng.standard_normal(N)
        return u, open_loop(u, rng)

    p = probabilities(make, 1000)
    if excitation is sweep:  # its own phase is taken out first, and nothing is left: no feedback without any test
        assert np.all(p == 1.0)
        return
    assert 0.005 <= np.mean(p < 0.01) <= 0.02  # one standard deviation of the count is 0.3 %
    assert 0.35 < np.median(p) < 0.6


@pytest.mark.long
@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2, 3e-2])
@pytest.mark.parametrize("excitation", [sweep, multisine, coloured, prbs])
def test_an_input_measured_with_noise_is_a_false_alarm_as_rarely(excitation, noise):
    def found(seed):
        rng = np.random.default_rng(seed)
        u = excitation(rng)
        return feedback_check(u / u.std() + noise * rng.standard_normal(N), open_loop(u / u.std(), rng, 0.05)).detected

    assert sum(found(seed) for seed in range(100)) <= 4  # 1 % of a hundred, and what chance adds to it


@pytest.mark.parametrize("levels", [20, 200])
def test_a_few_steps_tell_nothing_and_are_no_feedback(levels):
    def make(rng):
        at = np.sort(rng.choice(np.arange(20, N - 20), 5, replace=False))
        u = np.zeros(N)
        for row in at:
            u[row:] = rng.uniform(-1.0, 1.0)
        y = lfilter(B, A, u) + 1e-3 * rng.standard_normal(N)
        step = np.ptp(y) / levels
        return u, step * np.round(y / step)

    assert np.all(probabilities(make, 100) == 1.0)


@pytest.mark.parametrize("place", ["controller_input", "plant_input"])
def test_noise_that_is_fed_back_is_found_beside_a_few_steps(place):
    def make(rng):
        n = np.repeat(rng.uniform(-3.0, 3.0, 5), N // 5)
        z, y = run_loop(place, n, lfilter([1.0], [1.0, -0.9], 0.3 * rng.standard_normal(N)))
        return z + (n if place == "plant_input" else 0.0), y

    assert np.mean(probabilities(make, 40) < 0.01) >= 0.9


@pytest.mark.long
def test_dynamics_that_the_model_lacks_are_no_feedback():
    # rings over 2000 samples, far longer than the model's memory: correlated with past inputs, not with future ones
    ringing = np.poly([0.9995 * np.exp(0.1j), 0.9995 * np.exp(-0.1j), 0.97 * np.exp(1j), 0.97 * np.exp(-1j)]).real

    def make(rng):
        u = coloured(rng)
        return u, lfilter([0.0, 0.02, 0.01], ringing, u) + 1e-3 * rng.standard_normal(N)

    assert np.mean(probabilities(make, 400) < 0.01) <= 0.025


@pytest.mark.long
def test_a_nonlinear_plant_under_noise_is_no_feedback():
    def make(rng):
        u = white(rng)
        x = open_loop(u, rng, 0.02)
        return u, x + 0.3 * np.abs(x) * x + 0.1 * np.sign(np.diff(x, prepend=0.0))

    assert np.mean(probabilities(make, 400) < 0.01) <= 0.025


@pytest.mark.long
@pytest.mark.parametrize("place", ["controller_input", "plant_input"])
@pytest.mark.parametrize("excitation", [white, prbs, sweep, multisine])
def test_sensor_noise_that_was_fed_back_is_found(place, excitation):
    def make(rng):
        n = excitation(rng)
        z, y = run_loop(place, n, lfilter([1.0], [1.0, -0.9], 0.3 * rng.standard_normal(N)))
        return z + (n if place == "plant_input" else 0.0), y

    # 10 dB below the excitation; seven of the eight give 100 %, PRBS at the plant's input 87 % of 20 s records
    assert np.mean(probabilities(make, 40) < 0.01) >= (0.8 if excitation is prbs else 0.95)


def test_power_falls_with_the_noise_and_is_found_at_the_lags_of_the_controller():
    def share(noise):
        def make(rng):
            n = white(rng)
            return run_loop("controller_input", n, lfilter([1.0], [1.0, -0.9], noise * rng.standard_normal(N)))

        return np.mean(probabilities(make, 60) < 0.01)

    assert share(0.1) > 0.95  # 20 dB below the excitation
    assert share(0.001) < 0.1  # 60 dB below: nothing to be seen, and no bias to speak of


def test_between_periods_a_nonlinear_plant_is_no_feedback_and_noise_fed_back_is():
    def still(rng):
        u = multisine(rng)
        x = lfilter(B, A, u)
        return u, x + 0.3 * np.abs(x) * x + 0.02 * rng.standard_normal(N)

    def fed_back(rng):
        n = multisine(rng)
        z, y = run_loop("plant_input", n, lfilter([1.0], [1.0, -0.9], 0.01 * rng.standard_normal(N)))
        return z + n, y

    rng = np.random.default_rng(1)
    still_one = feedback_check(*still(rng), period=500)
    assert still_one.decidable
    assert not still_one.detected
    assert "repeats exactly" in still_one.sentence
    # without the period it is found by itself
    guessed = feedback_check(*still(rng))
    assert guessed.decidable
    assert not guessed.detected
    # the controller's law is exact in the log: only from the next row on can the plant answer
    assert not feedback_check(*fed_back(rng), period=500).decidable
    assert feedback_check(*fed_back(rng), period=500, answers_after=1).detected


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize("periods", [3, 8])
@pytest.mark.parametrize("jitter", [0.0, 1e-12])
def test_an_input_that_repeats_is_no_feedback_whatever_follows_it(jitter, periods, stated):
    # a nonlinear plant behind a filter that rings: the future of the input explains it, and no noise can have caused it
    for seed in range(10):
        rng = np.random.default_rng(seed)
        u = np.tile(multisine(rng)[:500], periods) * (1.0 + jitter * rng.standard_normal(500 * periods))
        x = lfilter(B, A, u)
        y = np.roll(x + 0.3 * np.abs(x) * x, -3) + 0.02 * rng.standard_normal(u.size)
        whole = record("control", "multisine", u, u, y, 500 / RATE if stated else None, 0.0 if stated else None)
        assert open_loop_note(whole, LOOP) == ()
        assert not loop_feedback(whole, LOOP).detected


def test_an_input_of_two_values_under_feedback_may_repeat_and_is_tested():
    u = np.sign(np.sin(2.0 * np.pi * np.arange(N) / 20 + 0.1))  # a relay in its limit cycle
    assert not repeats(u)
    assert repeats(u, 20)
    assert not repeats(np.linspace(0.0, 1e-5, N) ** 2)  # slow, and no repetition


@pytest.mark.long
def test_noise_at_the_input_between_periods_keeps_the_rate():
    def make(rng):
        u = multisine(rng) + 0.05 * rng.standard_normal(N)
        return u, open_loop(u, rng)

    assert np.mean(probabilities(make, 1000, period=500) < 0.01) <= 0.02


def test_a_loop_that_was_called_open_is_told():
    rng = np.random.default_rng(3)
    n = white(rng)
    z, y = run_loop("plant_input", n, lfilter([1.0], [1.0, -0.9], 0.3 * rng.standard_normal(N)))
    lied = record("control", "noise", n, z + n, y)
    (note,) = open_loop_note(lied, LOOP)
    assert note.startswith("the input of loop axis in r1.parquet seems to answer noise of its output")
    assert "there is feedback" not in note
    assert "a plant that is not linear" in note
    assert "through a filter" in note
    assert "closed_loop = true" in note
    assert "-1/C" in note
    honest = record("control", "noise", n, n, open_loop(n, rng))
    assert open_loop_note(honest, LOOP) == ()
    assert not loop_feedback(honest, LOOP, 1e-4).detected


def test_what_cannot_be_told_is_not_told():
    rng = np.random.default_rng(4)
    u = white(rng)
    found = feedback_check(u, lfilter(B, A, u))
    assert not found.detected
    assert not found.decidable
    assert "without noise" in found.sentence
    t = np.arange(N) / RATE
    sine = feedback_check(np.sin(t), np.cos(t) + 0.1 * rng.standard_normal(N))
    assert not sine.detected


@pytest.mark.long
def test_an_input_behind_an_anti_aliasing_filter_is_no_feedback_if_one_says_so():
    def make(rng):
        u = rng.standard_normal(10 * N)  # ten steps a sample
        y = lfilter([0.0, 0.01], np.poly([0.998 * np.exp(0.05j), 0.998 * np.exp(-0.05j)]).real, u)
        u, y = (lfilter(firwin(201, 0.04, fs=1.0), [1.0], x)[::10] for x in (u, y))
        return u, y + 1e-3 * y.std() * rng.standard_normal(N)

    assert np.mean(probabilities(make, 40) < 0.01) > 0.9  # the limit that the docstring names
    assert np.mean(probabilities(make, 200, answers_after=-8) < 0.01) <= 0.03
    u, y = make(np.random.default_rng(7))
    (note,) = open_loop_note(record("control", "noise", u, u, y), LOOP)
    assert "only neighbouring samples show it, as behind an anti-aliasing filter" in note


def test_refuses_short_records_and_odd_rates():
    rng = np.random.default_rng(5)
    with pytest.raises(ls.errors.BadSignalError, match="too short to look for feedback"):
        feedback_check(rng.standard_normal(100), rng.standard_normal(100))
    with pytest.raises(ls.errors.BadSignalError, match="too few periods"):
        feedback_check(rng.standard_normal(1000), rng.standard_normal(1000), period=700)
    with pytest.raises(ls.errors.WrongUseError, match="rate of false alarms"):
        feedback_check(rng.standard_normal(1000), rng.standard_normal(1000), false_alarms=1.0)
