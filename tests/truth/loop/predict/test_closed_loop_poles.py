"""Poles of a closed loop by ways that share nothing with Newton's method: Lambert's W, polynomials, python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.special import lambertw

import loopshape as ls

F = np.geomspace(0.01, 40.0, 300)


def fitted(response, *, numerator, denominator, rate_hz=1000.0, delay=False):
    P = ls.FRF.from_arrays(F, response, relative_std=1e-6, rate_hz=rate_hz, loop="x")
    return P, ls.fit(P, "rational", numerator=numerator, denominator=denominator, delay=delay)


def loop_of(P, gain, rate_hz):
    return ls.Loop(P, ls.controller(ls.gain(gain), rate_hz=rate_hz, loop="x"))


@pytest.mark.parametrize("gain", [0.5, 2.0, 30.0])
def test_a_gain_around_an_integrator_with_delay_has_the_poles_of_lamberts_w(gain):
    delay, rate = 0.05, 100.0
    P = ls.FRF.from_arrays(
        F, np.exp(-2j * np.pi * F * delay) / (2j * np.pi * F), relative_std=1e-6, rate_hz=rate, loop="x"
    )
    fit = ls.fit(P, "integrator_delay")
    d, k = fit.model.delay_s, gain * fit.model.num[-1]
    truth = np.array([lambertw(-k * d, n) / d for n in range(-20, 20)])
    truth = truth[np.abs(truth) < 0.999 * np.pi * rate]
    found = loop_of(P, gain, rate).poles(fit)
    assert found.size == truth.size > 5
    assert np.abs(found[:, None] - truth[None, :]).min(axis=1).max() < 1e-6 * np.pi * rate
    assert (found.real.max() > 0.0) == (gain * delay > np.pi / 2.0)  # the limit of a pure delay and an integrator


def test_without_delay_they_are_the_roots_of_a_polynomial():
    w = 2j * np.pi * F
    P, fit = fitted((w + 3.0) / (w**2 + 0.4 * w + 100.0), numerator=1, denominator=2)
    truth = np.roots(np.polyadd(fit.model.den, 7.0 * fit.model.num))
    found = ls.Loop(P, ls.controller(ls.gain(7.0), rate_hz=1000.0, loop="x")).poles(fit)
    assert np.sort_complex(found) == pytest.approx(np.sort_complex(truth), rel=1e-6)


def test_each_makes_the_return_difference_zero_by_python_control():
    w, rate = 2j * np.pi * F, 200.0
    P, fit = fitted(50.0 / (w**2 + 2.0 * w + 40.0), numerator=0, denominator=2, rate_hz=rate)
    C = ls.controller(ls.gain(3.0), ls.pi(0.5), ls.lead_lag(2.0, 20.0), rate_hz=rate, loop="x")
    found = ls.Loop(P, C).poles(fit)
    discrete = ls.to_control(C)
    plant = control.tf(fit.model.num, fit.model.den)
    assert found.size >= 4
    for s in found:
        assert abs(1.0 + discrete(np.exp(s / rate)) * plant(s)) < 1e-6


def test_they_are_stable_where_the_check_says_so_and_only_there():
    w, rate = 2j * np.pi * F, 200.0
    P, fit = fitted(50.0 / (w**2 + 2.0 * w + 40.0) / (1.0 + w / 30.0), numerator=0, denominator=3, rate_hz=rate)
    P = replace(P, open_loop=True)
    for gain in (0.5, 2.0, 20.0, 60.0):
        loop = loop_of(P, gain, rate)
        assert (loop.poles(fit).real.max() < 0.0) == (loop.margins().stable == "stable")


def test_margins_of_a_loop_are_those_of_check_and_its_steps_end_where_the_integrator_puts_them():
    w, rate = 2j * np.pi * F, 200.0
    P, fit = fitted(50.0 / (w**2 + 12.0 * w + 40.0), numerator=0, denominator=2, rate_hz=rate)
    P = replace(P, open_loop=True)
    C = ls.controller(ls.gain(2.0), ls.pi(0.5), rate_hz=rate, loop="x")
    loop, (checked,) = ls.Loop(P, C), ls.check(P, C).margins.values()
    assert loop.margins().to_dict() == checked.to_dict()
    assert loop.step().response[-1] == pytest.approx(1.0, abs=0.02)
    assert loop.step(fit).response[-1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("method", ["zoh", "matched", "tustin"])
def test_a_controller_that_another_rule_made_discrete_runs_as_it_is(method):
    lead = control.tf([1.0, 2.0], [1.0, 40.0])
    made = control.sample_system(lead, 1.0 / 200.0, method=method)
    C = ls.controller(*ls.fixed(made), rate_hz=200.0)
    assert C.response(F) == pytest.approx(made(np.exp(2j * np.pi * F / 200.0)), rel=1e-9)


@pytest.mark.parametrize("rate", [1e3, 1e4])
def test_the_slow_poles_of_a_delay_of_a_thousand_samples_are_found_too(rate):
    # exp(pi rate delay) is no number: those up to 40/delay are looked for, and there Lambert's W has them all
    delay, gain = 0.2, 3.0
    P = ls.FRF.from_arrays(F, 1.0 / (2j * np.pi * F), relative_std=1e-6, rate_hz=rate, loop="x")
    one = ls.fit(P, "integrator")
    fit = replace(one, model=replace(one.model, num=np.array([1.0]), den=np.array([1.0, 0.0]), delay_s=delay))
    truth = np.array([lambertw(-gain * delay, n) / delay for n in range(-20, 20)])
    truth = truth[np.abs(truth) < 0.999 * 40.0 / delay]
    found = loop_of(P, gain, rate).poles(fit)
    assert found.size == truth.size > 5
    assert np.abs(found[:, None] - truth[None, :]).min(axis=1).max() < 1e-6
