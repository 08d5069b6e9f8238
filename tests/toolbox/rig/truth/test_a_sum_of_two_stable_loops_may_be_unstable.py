"""Shares of two controllers as one: exact, and refused where the loop between two good ones is unstable."""

import numpy as np
import pytest
from scipy.linalg import expm

import loopshape as ls
from loopshape.toolbox.rig.adopt.blend import blended
from loopshape.toolbox.rig.adopt.course import TrialSettings
from loopshape.toolbox.rig.adopt.forecast import forecast

RATE = 1000.0
A, B = np.array([[1.0, 1e-3], [0.0, 0.97]]), np.array([0.0, 0.4])  # the axis of the target in Python
R = ls.Requirements("axis1", sensitivity_peak_db=6.0, unstable_poles=0, integrators=1)


def controller(*blocks):
    return ls.controller(*blocks, rate_hz=RATE, loop="axis1")


def drawn(rng):
    """A controller of up to ten poles."""
    blocks = [ls.gain(10.0 ** rng.uniform(-2, 3) * rng.choice([-1.0, 1.0]))]
    blocks += [ls.pi(10.0 ** rng.uniform(-1, 1)) for _ in range(rng.integers(0, 2))]
    blocks += [ls.lead_lag(10.0 ** rng.uniform(0, 1.5), 10.0 ** rng.uniform(0.5, 2.5)) for _ in range(rng.integers(3))]
    for _ in range(rng.integers(0, 3)):
        blocks.append(ls.notch(10.0 ** rng.uniform(1, 2.6), rng.uniform(0.0, 0.2), rng.uniform(0.1, 1.0)))
    blocks += [ls.low_pass(10.0 ** rng.uniform(1.5, 2.6), order=1)] if rng.random() < 0.5 else []
    return controller(*blocks)


def radius(C):
    """The largest |z| of the closed loop, by its matrix."""
    rows = C.biquads()
    size = 2 + 2 * len(rows)
    M, value, states = np.zeros((size, size)), np.zeros(size), []
    value[0] = -1.0
    for k, (b0, b1, b2, a1, a2) in enumerate(rows):
        one, two = np.eye(size)[2 + 2 * k], np.eye(size)[3 + 2 * k]
        out = b0 * value + one
        states += [b1 * value - a1 * out + two, b2 * value - a2 * out]
        value = out
    M[:2, :2] = A
    M[:2] += np.outer(B, value)
    M[2:] = states
    return np.abs(np.linalg.eigvals(M)).max()


def measured():
    f = np.geomspace(0.2, 450.0, 400)
    z = np.exp(2j * np.pi * f / RATE)
    P = B[1] / RATE / ((z - 1.0) * (z - A[1, 1]))
    return ls.FRF.from_arrays(f, P, relative_std=0.003, rate_hz=RATE, loop="axis1")


def test_a_share_is_the_sum_of_both_responses():
    f, rng = np.geomspace(0.01, 450.0, 200), np.random.default_rng(4)
    for _ in range(100):
        old, new, share = drawn(rng), drawn(rng), rng.uniform(0.05, 0.95)
        parts = [(1.0 - share) * old.response(f), share * new.response(f)]
        off = np.abs(blended(old, new, share).response(f) - sum(parts)) / sum(map(np.abs, parts))
        assert off.max() < 1e-6


def test_integrators_of_both_are_one():
    slow, fast = (controller(ls.gain(k), ls.pi(f)) for k, f in ((1.0, 1.0), (2.0, 3.0)))
    assert blended(slow, fast, 0.5).integrators() == 1
    assert blended(controller(ls.gain(1.0)), fast, 0.5).integrators() == 1
    assert (blended(slow, fast, 0.0), blended(slow, fast, 1.0)) == (slow, fast)


def test_between_two_stable_loops_lies_an_unstable_one_and_it_is_refused():
    """A controller with three integrators is stable by its gain: a quarter of it is too little."""
    old = controller(ls.gain(0.2), ls.lead_lag(5.0, 61.0), ls.low_pass(200.0, order=1))
    new = controller(ls.gain(6.267), ls.lead_lag(3.742, 161.96), ls.pi(7.115), ls.pi(6.488), ls.pi(2.915))
    assert radius(old) < 1.0
    assert radius(new) < 1.0
    assert radius(blended(old, new, 0.25)) > 1.003
    found = forecast(measured(), old, new, R)
    assert found.verdict.passed
    assert found.outcome == "failed"
    assert (found.refused.share, found.refused.stability) == (0.25, "unstable")
    assert found.reason.startswith("at a share of 0.25: the loop is unstable")


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_between_two_loops_of_a_kind_all_is_stable_and_allowed(share):
    old = controller(ls.gain(9.0), ls.lead_lag(5.0, 61.0), ls.low_pass(200.0, order=1))
    new = controller(ls.gain(11.0), ls.lead_lag(5.0, 61.0), ls.low_pass(200.0, order=1), ls.pi(0.5))
    assert radius(blended(old, new, share)) < 1.0
    assert forecast(measured(), old, new, R, (share,)).outcome == "passed"


def two_masses(f):
    """1.73 kg, 29 % of it on a spring: an antiresonance at 48 Hz, a resonance at 57 Hz; hold and a sample of 1 ms."""
    m, share, viscous = 1.7337, 0.29313, 1.0496
    first, second = (1.0 - share) * m, share * m
    c = first * second / m * (2.0 * np.pi * 56.8865) ** 2
    d = 2.0 * 0.0038559 * np.sqrt(c * first * second / m)
    flow = np.zeros((5, 5))
    flow[0, 1] = flow[2, 3] = 1.0
    flow[1], flow[3] = np.array([-c, -d - viscous, c, d, 1.0]) / first, np.array([c, d, -c, -d, 0.0]) / second
    step, z = expm(flow / RATE), np.exp(2j * np.pi * f / RATE)
    G = np.linalg.solve(z[:, None, None] * np.eye(4) - step[:4, :4], np.tile(step[:4, 4:], (f.size, 1, 1)))
    return G[:, 0, 0] / z


def test_a_resonance_behind_an_antiresonance_that_noise_covers_is_seen():
    """Noise of one size covers the antiresonance; the resonance beside it is known to 2 %, and |S| there is 13 dB."""
    f, rng, std = np.arange(1.0, 400.0, 0.5), np.random.default_rng(0), 3.2e-6
    noise = std / np.sqrt(2.0) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    P = ls.FRF.from_arrays(f, two_masses(f) + noise, std=std, rate_hz=RATE, loop="axis1")
    blocks = (ls.lead_lag(7.0 / 3.0, 21.0), ls.low_pass(70.0, order=1), ls.notch(71.4, 0.05, 0.4), ls.pi(7.0 / 12.0))
    at = np.array([7.0])
    C = controller(ls.gain(1.0 / abs(controller(ls.gain(1.0), *blocks).response(at) * two_masses(at))[0]), *blocks)
    fine = np.linspace(50.0, 64.0, 10_000)
    true = 20.0 * np.log10(np.abs(1.0 / (1.0 + C.response(fine) * two_masses(fine))).max())
    assert true == pytest.approx(13.5, abs=0.1)
    assert np.median(P.relative_std[(f > 44.0) & (f < 52.0), 0, 0]) > 0.3
    found = forecast(P, C, C, R, (1.0,))
    assert found.outcome == "failed"
    assert found.verdict.lines[0].value == pytest.approx(true, abs=1.0)


@pytest.mark.parametrize("shares", [(), (0.5,), (0.5, 0.25, 1.0), (0.0, 1.0), (0.5, 1.5)])
def test_shares_rise_to_one(shares):
    with pytest.raises(ls.errors.WrongUseError, match="rise from above 0 to 1"):
        TrialSettings(shares)


def test_what_does_not_add_up_is_refused():
    plain, other = controller(ls.gain(1.0)), ls.controller(ls.gain(1.0), rate_hz=500.0, loop="axis1")
    late = ls.controller(ls.gain(1.0), rate_hz=RATE, loop="axis1", computation_delay_s=1e-3)
    for new in (other, late):
        with pytest.raises(ls.errors.WrongUseError, match="side by side"):
            blended(plain, new, 0.5)
    with pytest.raises(ls.errors.WrongUseError, match="between 0 and 1"):
        blended(plain, plain, 1.5)
    with pytest.raises(ls.errors.WrongUseError, match="cancel each other"):
        blended(plain, controller(ls.gain(-1.0)), 0.5)
