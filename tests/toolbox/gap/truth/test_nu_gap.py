"""The nu-gap from lines: closed forms, an independent winding number, what it promises, and its interval."""

import numpy as np
import pytest
from bench_nouns import Block
from conversions import TWO_PI, angular, rad

import loopshape as ls
from loopshape.toolbox.gap.two_runs.nu_gap import kappa, nu_gap, order_of, shaped

F_HZ = np.geomspace(1e-4, 1e3, 3000)


def frf(num, den, f_hz=F_HZ, std=0.0, rng=None, delay_s=0.0):
    s = 1j * angular(f_hz)
    P = np.polyval(num, s) / np.polyval(den, s) * np.exp(-s * delay_s)
    variance = (std * np.abs(P)) ** 2
    if std:
        P = P + np.sqrt(0.5 * variance) * (rng.standard_normal(P.size) + 1j * rng.standard_normal(P.size))
    return ls.FRF(
        frequency_hz=f_hz,
        response=P[:, None, None],
        covariance=variance[:, None, None].astype(complex),
        valid=np.ones(P.size, dtype=bool),
        inputs=("u_v",),
        outputs=("y_rad",),
        method="computed",
    )


def mirrored(p):
    """p(-s)."""
    p = np.asarray(p, dtype=float)
    return p * (-1.0) ** np.arange(p.size - 1, -1, -1)


def independent(one, two):
    """Whether the condition holds, and max kappa, by normalised coprime factors.

    With P = n/d = N/M, N = n/h, M = d/h and h h~ = n n~ + d d~, the condition is wno(N2~ N1 + M2~ M1) = 0 on the plain
    imaginary axis (Vinnicombe 1993): as many zeros of n2~ n1 + d2~ d1 as poles of 1/h2~ in the right half plane, and
    these are deg P2.
    """
    (n1, d1), (n2, d2) = one, two
    zeros = np.roots(np.polyadd(np.polymul(mirrored(n2), n1), np.polymul(mirrored(d2), d1)))
    s = 1j * np.concatenate([[0.0], np.geomspace(1e-6, 1e6, 100_001)])
    N1, M1, N2, M2 = (np.polyval(p, s) for p in (n1, d1, n2, d2))
    size = np.abs(N1 * M2 - N2 * M1)
    size = size / np.sqrt((np.abs(N1) ** 2 + np.abs(M1) ** 2) * (np.abs(N2) ** 2 + np.abs(M2) ** 2))
    return int(np.sum(zeros.real > 0.0)) == len(d2) - 1, float(size.max())


def test_two_integrators_differ_by_the_difference_of_their_gains_over_the_sum():
    # kappa = |k1 - k2| w / sqrt((w² + k1²)(w² + k2²)), largest at w² = k1 k2
    found = nu_gap(frf([4.0], [1.0, 0.0]), frf([6.0], [1.0, 0.0]))
    assert found.winding == "holds"
    assert found.value == pytest.approx(0.2, rel=1e-4)
    assert TWO_PI * found.at_hz == pytest.approx(np.sqrt(24.0), rel=0.01)


@pytest.mark.parametrize("a", [0.01, 0.5, 3.0])
def test_an_integrator_and_a_lag(a):
    # kappa = a / sqrt((1 + w²)(1 + a² + w²)), largest towards zero frequency
    one, two = frf([1.0], [1.0, 0.0]), frf([1.0], [1.0, a])
    found = nu_gap(one, two, integrators=(1, 0))
    assert found.winding == "holds"
    assert found.value == pytest.approx(a / np.sqrt(1.0 + a * a), rel=1e-4)
    assert nu_gap(two, one, integrators=(0, 1)).value == pytest.approx(found.value)


def test_a_leak_below_the_lines_may_pass_for_an_integrator():
    f_hz = np.geomspace(0.05, 50.0, 400)
    leaky = frf([5.0], [1.0, 0.02], f_hz)
    assert order_of(leaky) == 1
    found = nu_gap(frf([5.0], [1.0, 0.0], f_hz), leaky)
    assert found.winding == "holds"
    assert found.value < 0.005


def test_a_stable_and_an_unstable_pole():
    # P1 = 1/(s + a), P2 = 1/(s - a): below a = 1 one controller may hold both, above none at no cost
    for a, word in ((0.5, "holds"), (2.0, "fails")):
        found = nu_gap(frf([1.0], [1.0, a]), frf([1.0], [1.0, -a]), integrators=(0, 0), unstable_poles=(0, 1))
        assert found.winding == word
        assert (found.value == 1.0) == (word == "fails")
        assert independent(([1.0], [1.0, a]), ([1.0], [1.0, -a]))[0] == (word == "holds")


def test_an_encirclement_makes_it_one_however_close_the_lines_lie():
    # 100/(s + 1) and the same through ((c - s)/(c + s))², c = 0.01: kappa never exceeds 0.04, yet unit feedback
    # holds the first and not the second
    allpass = np.polymul([-1.0, 0.01], [-1.0, 0.01]), np.polymul([1.0, 0.01], [1.0, 0.01])
    one = ([100.0], [1.0, 1.0])
    two = (100.0 * allpass[0], np.polymul([1.0, 1.0], allpass[1]))
    found = nu_gap(frf(*one), frf(*two), integrators=(0, 0))
    assert found.largest_kappa < 0.04
    assert (found.winding, found.value, found.interval) == ("fails", 1.0, (1.0, 1.0))
    assert np.roots(np.polyadd(one[0], one[1])).real.max() < 0.0
    assert np.roots(np.polyadd(two[0], two[1])).real.max() > 0.0


def random_plant(rng):
    """Numerator, denominator, integrators and unstable poles of a strictly proper plant."""
    integrators, unstable, den = int(rng.integers(0, 3)), 0, np.ones(1)
    for _ in range(rng.integers(1, 4)):
        corner = 10.0 ** rng.uniform(-1.0, 1.0)
        if rng.random() < 0.6:
            sign = -1.0 if rng.random() < 0.15 else 1.0
            unstable += sign < 0.0
            den = np.polymul(den, [1.0, sign * corner])
        else:
            den = np.polymul(den, [1.0, 2.0 * rng.uniform(0.05, 1.0) * corner, corner**2])
    den = np.polymul(den, [1.0] + [0.0] * integrators)
    num = np.array([10.0 ** rng.uniform(-1.0, 1.5) * (1.0 if rng.random() < 0.85 else -1.0)])
    for _ in range(rng.integers(0, den.size - 1)):
        num = np.polymul(num, [1.0, (1.0 if rng.random() < 0.7 else -1.0) * 10.0 ** rng.uniform(-1.0, 1.0)])
    return num, den, integrators, int(unstable)


def random_pair(rng):
    one = random_plant(rng)
    two = random_plant(rng) if rng.random() < 0.5 else (one[0] * rng.uniform(0.5, 2.0), *one[1:])
    return one, two


def test_the_winding_number_is_that_of_the_coprime_factors():
    rng, fails, near = np.random.default_rng(1), 0, 0
    for _ in range(300):
        (n1, d1, k1, u1), (n2, d2, k2, u2) = random_pair(rng)
        holds, size = independent((n1, d1), (n2, d2))
        one, two = frf(n1, d1), frf(n2, d2)
        found = nu_gap(one, two, integrators=(k1, k2), unstable_poles=(u1, u2))
        back = nu_gap(two, one, integrators=(k2, k1), unstable_poles=(u2, u1))
        assert found.winding == back.winding == ("holds" if holds else "fails"), (n1, d1, n2, d2)
        assert back.value == pytest.approx(found.value)
        near += holds and abs(found.value - size) < 0.01 * size + 1e-3
        fails += not holds
    assert 50 < fails < 250
    assert near > 0.97 * (300 - fails)  # a few have their largest kappa below the first line


def test_a_controller_keeps_what_the_gap_promises():
    # arcsin b(P2, 1) >= arcsin b(P1, 1) - arcsin nu-gap (Vinnicombe 1993); b is 0 for an unstable loop
    rng, promised = np.random.default_rng(2), 0
    for _ in range(300):
        one, two = random_pair(rng)
        b1, b2 = unit_margin(*one[:2]), unit_margin(*two[:2])
        found = nu_gap(frf(*one[:2]), frf(*two[:2]), integrators=(one[2], two[2]), unstable_poles=(one[3], two[3]))
        gap = min(found.interval[1] + 0.01, 1.0)  # 1 where it is undecided
        least = np.sin(max(np.arcsin(b1) - np.arcsin(gap), 0.0))
        promised += least > 0.0
        assert b2 >= least - 0.01
    assert promised > 15


def unit_margin(num, den):
    """Normalised coprime stability margin of a plant under unit feedback, by its definition."""
    if np.roots(np.polyadd(num, den)).real.max() >= 0.0:
        return 0.0
    s = 1j * np.geomspace(1e-6, 1e6, 20_001)
    n, d = np.polyval(num, s), np.polyval(den, s)
    return float((np.abs(n + d) / np.sqrt(2.0 * (np.abs(n) ** 2 + np.abs(d) ** 2))).min())


def test_kappa_lies_between_its_identity():
    rng = np.random.default_rng(3)
    a, b = rng.standard_normal((2, 50)) + 1j * rng.standard_normal((2, 50))
    complement = np.abs(1.0 + b.conj() * a) ** 2 / ((1.0 + np.abs(a) ** 2) * (1.0 + np.abs(b) ** 2))
    assert kappa(a, b) ** 2 + complement == pytest.approx(np.ones(50))


def arm_like(f_hz, damping=0.1, gain=2000.0):
    w = TWO_PI * f_hz
    return [gain], np.polymul([1.0, 0.0], [1.0, 2.0 * damping * w, w * w])


@pytest.mark.parametrize("std", [0.01, 0.05])
@pytest.mark.parametrize("pair", [(5.0, 5.0), (5.0, 5.3)])
def test_the_interval_covers_and_the_value_is_not_pulled_up(std, pair):
    f_hz, rng = np.linspace(0.1, 10.0, 400), np.random.default_rng(4)
    plants = [arm_like(f) for f in pair]
    truth = nu_gap(*(frf(*p, f_hz) for p in plants)).value
    found = [nu_gap(*(frf(*p, f_hz, std, rng) for p in plants)) for _ in range(200)]
    low, high = np.array([x.interval for x in found]).T
    value, face = np.array([(x.value, x.largest_kappa) for x in found]).T
    assert np.mean((low <= truth) & (truth <= high)) >= 0.93
    assert np.median(face) - truth > 3.0 * abs(np.median(value) - truth)
    assert np.median(high - low) < 8.0 * std * max(truth, 0.3)  # it says something
    assert np.mean(low > 0.0) < 0.05 if pair[0] == pair[1] else np.mean(low > 0.05) > 0.95


def test_a_controller_shapes_response_and_covariance_alike():
    rng, f_hz = np.random.default_rng(5), np.linspace(0.1, 10.0, 50)
    plant, controller = (
        frf(*arm_like(5.0), f_hz, 0.02, rng),
        ls.Controller("a", (Block("gain", {"gain": 3.0}),), 1000.0),
    )
    L = shaped(plant, controller)
    np.testing.assert_allclose(L.siso, 3.0 * plant.siso)
    np.testing.assert_allclose(L.variance, 9.0 * plant.variance)


def undecided(one, two, **words):
    found = nu_gap(one, two, **words)
    assert (found.winding, found.value, found.interval[1]) == ("undecided", None, 1.0)
    assert found.interval[0] <= found.largest_kappa
    return found.reason


def test_what_the_lines_cannot_tell_is_undecided_and_says_why():
    f_hz = np.geomspace(0.1, 10.0, 300)
    high = frf([1000.0], [1.0, 0.0], f_hz)
    assert "measure higher" in undecided(high, high)
    between = frf([1.0], np.polymul([1.0, 0.0], [1.0, 0.7]), f_hz)
    assert "declare it" in undecided(between, between)
    late = frf([8.0], [1.0, 1.0], np.linspace(0.01, 3.0, 12), delay_s=1.6)
    early = frf([8.0], [1.0, 1.0], np.linspace(0.01, 3.0, 12))
    assert "measure finer" in undecided(early, late, integrators=(0, 0))
    lag = frf([1.0], [1.0, 0.0], f_hz)
    assert "do not fit 1 and 0" in undecided(lag, lag, integrators=(1, 0))


def test_a_product_near_minus_one_within_the_noise_is_undecided():
    f_hz, rng = np.geomspace(0.01, 10.0, 300), np.random.default_rng(6)
    one = frf([1.0], [1.0, 0.5], f_hz, 0.05, rng)
    turned = frf([-1.0], [1.0, 0.5], f_hz, 0.05, rng)
    assert "measure longer" in undecided(one, turned, integrators=(0, 0))


def test_a_common_delay_does_not_matter():
    f_hz = np.geomspace(0.05, 20.0, 600)
    plants = [arm_like(5.0), arm_like(5.4)]
    bare = nu_gap(*(frf(*p, f_hz) for p in plants))
    late = nu_gap(*(frf(*p, f_hz, delay_s=0.02) for p in plants))
    assert late.value == pytest.approx(bare.value)
    assert rad(360.0) * 0.02 * 5.0 > 0.6  # the delay is no small one
