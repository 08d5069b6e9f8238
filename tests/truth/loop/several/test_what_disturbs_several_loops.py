"""The rms of each loop's error and input under new controllers, of two loops that meet in a plant.

The truth is a state space by scipy alone: recordings are its samples, rms solve its Lyapunov equation.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov
from several_cases import frf_of, noisy

import loopshape as ls

RATE_HZ, F = 500.0, np.geomspace(0.1, 240.0, 250)
MASSES = np.array([[0, 1, 0, 0], [-900, -12, 300, 0], [0, 0, 0, 1], [200, 0, -500, -10.0]])
FORCES = np.array([[0, 0], [1000, 200], [0, 0], [-150, 600.0]])
HELD = expm(np.block([[MASSES, FORCES], [np.zeros((2, 6))]]) / RATE_HZ)
A, B, READ = HELD[:4, :4], HELD[:4, 4:], np.eye(4)[[0, 2]]
BEFORE, AFTER = ((0.1, 0.5), (0.2, 0.5)), ((0.5, 1.5), (0.4, 2.0))  # gain and corner in Hz of a PI by Tustin, a loop


def loops_of(pairs):
    """State space (X, W, e, z): states x, the last e and z, low-pass forces; noise of 3 forces and 2 sensors."""
    half = np.pi * np.array([corner for _, corner in pairs]) / RATE_HZ
    gains = np.array([gain for gain, _ in pairs])
    now, last, zero, one = np.diag(gains * (1.0 + half)), np.diag(gains * (half - 1.0)), np.zeros((2, 2)), np.eye(2)
    e = np.hstack([-READ, np.zeros((2, 6))]), np.hstack([np.zeros((2, 3)), -0.02 * one])
    z = now @ e[0] + np.hstack([np.zeros((2, 4)), last, one, zero]), now @ e[1]
    force = np.hstack([np.zeros((2, 8)), 0.94 * one]), 0.06 * np.array([[1, 0, 1, 0, 0], [0, 1, -1, 0, 0]])
    x = np.hstack([A, np.zeros((4, 6))]) + B @ (z[0] + force[0]), B @ (z[1] + force[1])
    return np.vstack([x[0], e[0], z[0], force[0]]), np.vstack([x[1], e[1], z[1], force[1]]), e, z


def true_rms(pairs):
    """Rms of both errors, then of both inputs."""
    X, W, e, z = loops_of(pairs)
    assert np.abs(np.linalg.eigvals(X)).max() < 1.0
    spread = solve_discrete_lyapunov(X, W @ W.T)
    return np.sqrt(np.concatenate([np.diag(M @ spread @ M.T + D @ D.T) for M, D in (e, z)]))


def recorded(seed, samples=20_000):
    """Errors and inputs (2, n) under the old controllers."""
    X, W, e, z = loops_of(BEFORE)
    noise = np.random.default_rng(seed).standard_normal((samples + 2000, 5))
    pushed, state, states = noise @ W.T, np.zeros(10), np.zeros((samples + 2000, 10))
    for k, push in enumerate(pushed):
        states[k] = state
        state = X @ state + push
    return [(states @ M.T + noise @ D.T)[2000:].T for M, D in (e, z)]


def controllers(pairs):
    made = zip("ab", pairs, strict=True)
    return [ls.controller(ls.gain(gain), ls.pi(corner), rate_hz=RATE_HZ, loop=x) for x, (gain, corner) in made]


def plant(relative):
    z = np.exp(2j * np.pi * F / RATE_HZ)
    exact = np.array([READ @ np.linalg.solve(x * np.eye(4) - A, B) for x in z])
    return replace(frf_of(F, exact, relative, loop="a+b"), rate_hz=RATE_HZ)


def disturbances(seed, **changes):
    errors, inputs = recorded(seed)
    return [
        ls.Disturbance.from_arrays(
            errors[k],
            RATE_HZ,
            **{"recorded_under": C, "control": inputs[k], "loop": C.loop, "recording": "still"} | changes,
        )
        for k, C in enumerate(controllers(BEFORE))
    ]


def readings(seed, relative=0.02):
    rng = np.random.default_rng(seed + 1000)
    P, C = noisy(plant(relative), rng), controllers(AFTER)
    whole = ls.Requirements(integrators=0, unstable_poles=0)
    verdict = ls.check(P, C, together=whole, disturbance=disturbances(seed))
    found = [next(iter(one.margins.values())) for one in verdict.each]
    return [m[name] for name in ("error_rms", "control_rms") for m in found]


def test_rms_is_that_of_the_state_space_and_not_that_of_each_loop_alone():
    truth, old = true_rms(AFTER), true_rms(BEFORE)
    found = readings(0, 1e-6)
    assert [one.value for one in found] == pytest.approx(truth, rel=0.06)
    assert np.all(np.abs(truth / old - 1.0) > 0.08)  # they are not what was recorded
    for one, true in zip(found, truth, strict=True):
        assert one.interval[0] < true < one.interval[1]


@pytest.mark.long
def test_intervals_cover_95_percent():
    truth, count = true_rms(AFTER), 80
    found = [readings(seed) for seed in range(count)]
    for k, true in enumerate(truth):
        hits = sum(one[k].interval[0] <= true <= one[k].interval[1] for one in found)
        assert hits >= 0.88 * count  # binomial: 95 % less three standard deviations
    assert np.mean([np.ptp(one[0].interval) for one in found]) < 0.4 * truth[0]


def test_loops_that_do_not_meet_have_what_each_has_alone():
    P, C, made = plant(0.01), controllers(AFTER), disturbances(3)
    apart = replace(P, response=P.response * np.eye(2))
    together = ls.check(apart, C, together=ls.Requirements(integrators=0, unstable_poles=0), disturbance=made)
    for k, own in enumerate(C):
        alone = ls.FRF.from_arrays(F, P.response[:, k, k], relative_std=0.01, rate_hz=RATE_HZ)
        single = ls.check(alone, own, ls.Requirements(own.loop, integrators=0, unstable_poles=0), disturbance=made[k])
        (one,), (other,) = (list(x.margins.values()) for x in (together.each[k], single))
        for name in ("error_rms", "control_rms", "control_peak", "control_rate"):
            assert one[name].value == pytest.approx(other[name].value, rel=2e-3)  # beyond samples' ends they part
            assert one[name].interval == pytest.approx(other[name].interval, rel=2e-2)


def test_tuning_keeps_to_the_error_of_each_loop():
    limits = [
        ls.Requirements(x, error_rms=r, modulus_margin=0.4, unstable_poles=0, integrators=0)
        for x, r in (("a", 0.28), ("b", 0.34))
    ]
    start = controllers(BEFORE)
    shape = [ls.gain((0.01, 5.0)), ls.pi((0.5, 5.0))]
    whole = ls.Requirements(integrators=0, unstable_poles=0)
    tuned = ls.tune(plant(0.01), limits, shape, start=start, together=whole, disturbance=disturbances(5), starts=3)
    assert tuned.feasible
    for one, limit in zip(tuned.verdict.each, limits, strict=True):
        assert next(iter(one.margins.values()))["error_rms"].interval[1] < limit.error_rms
    with pytest.raises(ls.errors.WrongUseError, match="no start for b"):
        ls.tune(plant(0.01), limits, shape, start=start[:1], disturbance=disturbances(5), starts=3)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda made: made[:1], "nothing tells that of b"),
        (lambda made: [made[0], replace(made[1], recording="later")], "at the same time"),
        (lambda made: [ls.Disturbance.from_spectrum([1.0, 9.0], [1.0, 1.0], loop=x) for x in "ab"], "at the same time"),
    ],
)
def test_what_was_not_recorded_at_once_is_refused(changed, words):
    with pytest.raises(ls.errors.WrongUseError, match=words):
        ls.check(plant(0.01), controllers(AFTER), disturbance=changed(disturbances(7)))


TONE_HZ = 3.0


def coupled(P, pairs, struck):
    """Errors (2,) of both loops to a tone at the output of one, as they are."""
    c = np.array([C.response([TONE_HZ])[0] for C in controllers(pairs)])
    return np.linalg.inv(np.eye(2) + P * c)[:, struck]


def at_the_tone():
    return READ @ np.linalg.solve(np.exp(2j * np.pi * TONE_HZ / RATE_HZ) * np.eye(4) - A, B)


def of_a_tone(P, struck):
    """Readings of both errors of a tone at one output, under the new controllers."""
    t, old = np.arange(20_000) / RATE_HZ, coupled(at_the_tone(), BEFORE, struck)
    still = [
        ls.Disturbance.from_arrays(
            np.real(old[k] * np.exp(2j * np.pi * TONE_HZ * t)), RATE_HZ, recorded_under=C, loop=C.loop, recording="tone"
        )
        for k, C in enumerate(controllers(BEFORE))
    ]
    whole = ls.Requirements(integrators=0, unstable_poles=0)
    verdict = ls.check(P, controllers(AFTER), together=whole, disturbance=still)
    return [next(iter(one.margins.values()))["error_rms"] for one in verdict.each]


@pytest.mark.parametrize("struck", [0, 1])
def test_a_tone_at_one_output_reaches_the_other_loop_by_the_plant(struck):
    """What loop b makes of a tone at the output of a is the coupling from a to b, and not that from b to a."""
    found = [one.value for one in of_a_tone(plant(1e-6), struck)]
    assert found == pytest.approx(np.abs(coupled(at_the_tone(), AFTER, struck)) / np.sqrt(2.0), rel=0.02)


def carried_over(P, struck):
    """Errors (2,) to that tone as a plant P carries them over from the recorded ones."""
    old, new = (np.eye(2) + P * [C.response([TONE_HZ])[0] for C in controllers(x)] for x in (BEFORE, AFTER))
    return np.linalg.solve(new, old @ coupled(at_the_tone(), BEFORE, struck))


@pytest.mark.parametrize("struck", [0, 1])
def test_an_interval_is_wide_by_the_element_that_is_not_known(struck):
    """A tenth's error of one element alone widens it as the derivative to this element does."""
    exact, G = plant(1e-6), at_the_tone()
    before = [np.diff(one.interval)[0] for one in of_a_tone(exact, struck)]
    rise, slope = np.zeros((2, 2, 2)), np.zeros((2, 2, 2))
    for a, b in np.ndindex(2, 2):
        covariance, k = exact.covariance.copy(), 2 * b + a
        covariance[:, k, k] = (0.1 * np.abs(exact.response[:, a, b])) ** 2
        wide = [np.diff(one.interval)[0] for one in of_a_tone(replace(exact, covariance=covariance), struck)]
        rise[a, b] = np.sqrt(np.maximum(np.square(wide) - np.square(before), 0.0))
        step = np.zeros((2, 2))
        step[a, b] = 1e-6
        ends = [carried_over(G * (1.0 + x * step), struck) for x in (1.0, -1.0)]
        slope[a, b] = np.abs(ends[0] - ends[1])
    assert rise / rise.max() == pytest.approx(slope / slope.max(), rel=0.1, abs=0.03)
