"""Predictions and verdicts of sampled plants, whose loops are simulated here: no pole is invented, no tail missed."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import loopshape as ls

RATE = 1000.0
FIRST_ORDER = [20.0], [1.0, 20.0]
TWO_LAGS = [1.0], np.polymul([0.1, 1.0], [0.02, 1.0])
RESONANCE = [4e3], [1.0, 12.0, 4e3]
PLANTS = {"first order": FIRST_ORDER, "two lags": TWO_LAGS, "resonance": RESONANCE}


def sampled(plant, delay=2):
    """Numerator and denominator in z of a plant behind a hold and a delay of samples."""
    b, a, _ = cont2discrete(plant, 1.0 / RATE)
    return np.concatenate([np.zeros(delay), b.ravel()]), np.concatenate([a, np.zeros(delay)])


def response(b, a, f_hz):
    z = np.exp(2j * np.pi * np.asarray(f_hz) / RATE)
    return np.polyval(b, z) / np.polyval(a, z)


def measured(b, a, rng, first_hz=0.5, lines=150, std=0.02):
    f_hz = np.geomspace(first_hz, 450.0, lines)
    noise = rng.standard_normal((2, lines)) / np.sqrt(2.0)
    return ls.FRF.from_arrays(
        f_hz, response(b, a, f_hz) * (1.0 + std * (noise[0] + 1j * noise[1])), relative_std=std, rate_hz=RATE, loop="x"
    )


def closed(b, a, C):
    """Numerator and denominator of T."""
    numerator, denominator = b, a
    for row in C.biquads():
        numerator, denominator = np.polymul(numerator, row[:3]), np.polymul(denominator, [1.0, *row[3:]])
    whole = np.polyadd(numerator, denominator)
    return np.concatenate([np.zeros(whole.size - numerator.size), numerator]), whole


def controlled(b, a, crossover_hz, zero_hz):
    shape = ls.controller(ls.gain(1.0), ls.pi(zero_hz), rate_hz=RATE, loop="x")
    size = 1.0 / abs(shape.response(np.array([crossover_hz]))[0] * response(b, a, crossover_hz))
    return ls.controller(ls.gain(float(size)), ls.pi(zero_hz), rate_hz=RATE, loop="x")


@pytest.mark.parametrize("name", ["first order", "two lags", pytest.param("resonance", marks=pytest.mark.long)])
def test_a_fit_makes_no_stable_plant_unstable(name):
    """A hold bends the phase: an unstable pair above the lines follows it, and no such pole was measured."""
    b, a = sampled(PLANTS[name])
    assert np.abs(np.roots(a)).max() < 1.0
    for seed in range(2):
        P = measured(b, a, np.random.default_rng(seed), std=(0.05, 0.01)[seed])
        C = controlled(b, a, 4.0, 1.0)
        assert np.abs(np.roots(closed(b, a, C)[1])).max() < 1.0
        fit = ls.fit(P)
        assert fit.model.unstable_poles() == 0 or min(fit.model.unstable_hz()) > 450.0  # none that is counted
        assert ls.check(P, C, fits=[fit]).outcome != "failed"
        assert ls.predict(P, C, fits=[fit])[0].stability != "unstable"


def test_a_pole_beside_a_zero_that_follows_noise_is_no_unstable_pole():
    """With as many poles as four, noise of 5 % buys an unstable one amid the lines; stable ones do as well."""
    b, a = sampled(FIRST_ORDER)
    C = controlled(b, a, 4.0, 1.0)
    for seed in (1, 13, 25, 33):
        P = measured(b, a, np.random.default_rng(seed), first_hz=0.2, lines=100, std=0.05)
        orders = {"numerator": 1, "denominator": 4, "delay": True}
        assert min(ls.fit(P, "rational", **orders, stable=False).model.unstable_hz()) < 450.0
        fit = ls.fit(P, "rational", **orders)
        assert fit.model.unstable_poles() == 0
        assert ls.check(P, C, fits=[fit]).outcome != "failed"


@pytest.mark.parametrize(("seed", "numerator"), [(3, 3), (25, 2)])
def test_a_real_pole_whose_sign_the_lines_do_not_tell_is_not_counted(seed, numerator):
    """425 (-225 to 1076) and 118 (-17 to 253) Hz on the right, of a stable plant in noise of 5 %."""
    rng = np.random.default_rng(seed)
    corner_hz, f_hz = rng.uniform(1.0, 20.0), np.geomspace(0.5, 450.0, 150)
    noise = 1.0 + 0.05 / np.sqrt(2.0) * (rng.standard_normal(f_hz.size) + 1j * rng.standard_normal(f_hz.size))
    G = np.sinc(f_hz / RATE) * np.exp(-2j * np.pi * f_hz * 1.5e-3) / (1.0 + 1j * f_hz / corner_hz)
    P = ls.FRF.from_arrays(f_hz, G * noise, relative_std=0.05, rate_hz=RATE, loop="x")
    fit = ls.fit(P, "rational", numerator=numerator, denominator=4, delay=True)
    C = ls.controller(ls.gain(2.0), rate_hz=RATE, loop="x")  # crosses at 1.7 corners: at most 60 + 19 deg of lag
    assert ls.check(P, C, fits=[fit]).margins["frf 1"].stable != "unstable"


def test_an_unstable_pole_between_the_lines_still_counts():
    b, a = sampled(([150.0], [1.0, 0.0, -150.0]), delay=0)  # 1.95 Hz
    P = measured(b, a, np.random.default_rng(4), lines=200, std=0.05)
    shape = ls.controller(ls.gain(1.0), ls.lead_lag(3.0, 30.0), rate_hz=RATE, loop="x")
    size = 1.0 / abs(shape.response(np.array([9.0]))[0] * response(b, a, 9.0))
    C = ls.controller(ls.gain(float(size)), ls.lead_lag(3.0, 30.0), rate_hz=RATE, loop="x")
    assert np.abs(np.roots(closed(b, a, C)[1])).max() < 1.0
    fit = ls.fit(P)
    assert min(fit.model.unstable_hz()) == pytest.approx(np.sqrt(150.0) / 2.0 / np.pi, rel=0.02)
    assert ls.check(P, C, fits=[fit]).passed


def test_a_slow_tail_widens_the_step_or_is_no_step():
    """A zero of the controller far below the crossover leaves a tail that is longer than the lowest line's period."""
    rng, steps = np.random.default_rng(5), 0
    R = ls.Requirements(integrators=0, unstable_poles=0)
    for zero_hz in (0.02, 0.1, 0.3, 0.5, 1.0, 3.0):
        for name, plant in PLANTS.items():
            b, a = sampled(plant)
            P, C = measured(b, a, rng, lines=300, std=0.002), controlled(b, a, 8.0, zero_hz)
            step = ls.predict(P, C, R)[0].step
            if step is None:
                continue
            numerator, denominator = closed(b, a, C)
            truth = lfilter(numerator, denominator, np.ones(int(step.time_s[-1] * RATE) + 2))
            seen = np.interp(step.time_s, np.arange(truth.size) / RATE, truth)
            assert np.mean((step.low - 2e-3 <= seen) & (seen <= step.high + 2e-3)) > 0.9, (zero_hz, name)
            assert step.indicators.steady_state_error == 0.0
            steps += 1
    assert steps >= 4


def test_an_integrator_guessed_from_the_lowest_lines_leaves_open_where_the_step_ends():
    """A lag at 0.05 Hz looks like an integrator from 0.5 Hz on: 1.6 % of the step stays, and 0 was named for sure."""
    b, a = sampled(([1.0], [1.0 / (2.0 * np.pi * 0.05), 1.0]))
    P, C = measured(b, a, np.random.default_rng(1), lines=300, std=0.003), ls.controller(ls.gain(60.0), rate_hz=RATE)
    numerator, denominator = closed(b, a, C)
    error = 1.0 - numerator.sum() / denominator.sum()
    low, high = ls.predict(P, C, ls.Requirements(unstable_poles=0))[0].step.indicators.intervals["steady_state_error"]
    assert low <= 0.0
    assert error == pytest.approx(0.0164, abs=1e-4)
    assert error < high < 1.2 * error
    declared = ls.Requirements(integrators=1, unstable_poles=0)
    assert ls.predict(P, C, declared)[0].step.indicators.intervals["steady_state_error"] == (0.0, 0.0)
