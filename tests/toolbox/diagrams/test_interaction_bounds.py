"""Intervals of k_I, relative gains and equivalent plants hold the truth as often as they say, by Monte Carlo."""

import numpy as np
import pytest
from bench_nouns import Block
from interaction_nouns import F, coupled_by, errors, matrix_frf

import loopshape as ls
from loopshape.toolbox.diagrams.coupling.bounds import magnitude_bounds, product_bounds
from loopshape.toolbox.diagrams.coupling.interaction import closing_the_others, interaction_coefficient, relative_gain

DRAWS = 4000
NAMES = ("theta1", "theta2")
SIGNS = np.array([1.0, 1.0, -1.0, -1.0])


def full_covariance(seed, size):
    """One covariance (4, 4) of unit diagonal times sizes (4,) squared, with strong correlations."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))
    root *= (np.asarray(size) / np.sqrt((np.abs(root) ** 2).sum(1)))[:, None]
    return root @ root.conj().T


def repeated(P, covariance, seed=0):
    """FRF of DRAWS lines, each a measurement of one plant (2, 2) with one covariance (4, 4)."""
    return matrix_frf(P, covariance, np.arange(1.0, DRAWS + 1.0), seed=seed)


def truth_of(P):
    return P[0, 1] * P[1, 0] / (P[0, 0] * P[1, 1])


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("error", [0.005, 0.04])
def test_with_small_errors_the_interval_holds_k_in_95_of_100(seed, error):
    P = coupled_by(-15.0)[0]
    one = interaction_coefficient(repeated(P, full_covariance(seed, error * np.abs(P.T.ravel()))), 0, 1, NAMES)
    inside = (one.low <= abs(truth_of(P))) & (abs(truth_of(P)) <= one.high)
    assert 0.93 <= inside.mean() <= 0.97
    relative = one.coefficient / truth_of(P) - 1.0
    assert np.sqrt(np.mean(np.abs(relative) ** 2)) == pytest.approx(np.median(one.relative_std), rel=0.06)


@pytest.mark.long
@pytest.mark.parametrize("freedom", [np.inf, 40.0, 10.0])
@pytest.mark.parametrize("ratios", [(0.0, 0.0), (0.0, 10.0), (1.0, 1.0), (2.0, 10.0), (3.0, 10.0), (3.0, 100.0)])
@pytest.mark.parametrize("direct", [6.0, 100.0])
def test_where_an_element_is_noise_the_interval_is_never_too_narrow(ratios, direct, freedom):
    rng = np.random.default_rng(round(10 * sum(ratios) + direct))
    factors = np.array([*ratios, direct, direct]) * np.exp(1j * rng.uniform(0.0, 6.0, 4))
    C = full_covariance(round(direct), np.ones(4))
    measured = factors + errors(rng, np.broadcast_to(C, (DRAWS, 4, 4)))
    seen = np.broadcast_to(C, (DRAWS, 4, 4))
    if np.isfinite(freedom):
        apart = errors(rng, np.broadcast_to(C, (DRAWS * round(freedom / 2), 4, 4))).reshape(DRAWS, -1, 4)
        seen = np.einsum("dni,dnj->dij", apart, apart.conj()) / apart.shape[1]
    low, high = product_bounds(measured, seen, SIGNS, freedom)
    truth = abs(factors[0] * factors[1] / (factors[2] * factors[3]))
    assert np.mean((low <= truth) & (truth <= high)) >= 0.935
    assert np.mean(truth > high) <= 0.035
    if min(ratios) == 0.0:
        assert np.mean(low > 0.0) <= 0.035  # opens to -inf dB


@pytest.mark.parametrize("size", [0.0, 0.5, 1.5, 3.0, 10.0, 60.0])
def test_the_interval_of_one_magnitude(size):
    rng = np.random.default_rng(1)
    measured = np.abs(size + errors(rng, np.ones((20 * DRAWS, 1, 1))))[:, 0]
    low, high = magnitude_bounds(measured, np.ones(measured.size))
    assert np.mean(low > size) == pytest.approx(0.025, abs=0.003)  # exact, by Rice's distribution
    assert np.mean(high < size) <= 0.028
    if size >= 10.0:
        assert np.mean(high < size) >= 0.019


def test_four_percent_in_each_element_are_eight_in_k():
    # and 5.7 % of |k_I|, so that its 95 % interval reaches 11 % to each side
    P = coupled_by(-15.0)[0]
    one = interaction_coefficient(repeated(P, np.diag((0.04 * np.abs(P.T.ravel())) ** 2).astype(complex)), 0, 1, NAMES)
    assert np.median(one.relative_std) == pytest.approx(0.08, rel=0.01)
    size = np.abs(one.coefficient) / abs(truth_of(P))
    assert np.std(np.log(size)) == pytest.approx(0.0566, rel=0.05)
    assert np.median(one.high / np.abs(one.coefficient)) == pytest.approx(1.117, abs=0.01)
    exact = interaction_coefficient(matrix_frf(coupled_by(-15.0), error=0.04), 0, 1, NAMES)
    np.testing.assert_allclose(exact.relative_std, 0.08)


def test_errors_that_the_elements_share_count_with_their_sign():
    # one gain error of a sensor is in both elements of a row, and falls out of k_I
    P = coupled_by(-15.0)[0]
    vec = P.T.ravel()
    row = np.array([vec[0], 0.0, vec[2], 0.0])
    shared = interaction_coefficient(repeated(P, 0.05**2 * np.outer(row, row.conj())), 0, 1, NAMES)
    np.testing.assert_allclose(shared.relative_std, 0.0, atol=1e-6)
    np.testing.assert_allclose(shared.coefficient, truth_of(P))
    # with opposite signs it counts twice
    against = np.array([vec[0], 0.0, -vec[2], 0.0])
    assert np.median(
        interaction_coefficient(repeated(P, 0.05**2 * np.outer(against, against.conj())), 0, 1, NAMES).relative_std
    ) == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("n", [2, 3])
def test_the_deviation_of_relative_gains_is_their_scatter(n):
    rng = np.random.default_rng(7)
    P = np.eye(n) + 0.4 * (rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))
    root = 0.003 * (rng.standard_normal((n * n, n * n)) + 1j * rng.standard_normal((n * n, n * n)))
    names = "+".join(f"l{k}" for k in range(n))
    frf = matrix_frf(P, root @ root.conj().T, np.arange(1.0, DRAWS + 1.0), seed=3, loop=names)
    found = relative_gain(frf)
    exact = P * np.linalg.inv(P).T
    scatter = np.sqrt(np.mean(np.abs(found.gain - exact) ** 2, axis=0))
    np.testing.assert_allclose(np.median(found.std, axis=0), scatter, rtol=0.06)


def test_the_deviation_of_what_closing_the_others_changes_is_its_scatter():
    P = coupled_by(-6.0)[0]
    f = np.linspace(2.0, 2.0 + 1e-6, DRAWS)
    C = full_covariance(5, 0.02 * np.abs(P.T.ravel()))
    K = {name: ls.Controller(name, (Block("gain", {"gain": 15.0}),), 1000.0) for name in NAMES}
    found = closing_the_others(matrix_frf(P, C, f, seed=9), NAMES, "theta1", K)
    closed = P[0, 0] - P[0, 1] * 15.0 * P[1, 0] / (1.0 + 15.0 * P[1, 1])
    ratio = closed / P[0, 0]
    assert np.median(found.relative_std) == pytest.approx(
        np.sqrt(np.mean(np.abs(found.ratio / ratio - 1.0) ** 2)), rel=0.06
    )
    inside = (found.low <= abs(ratio)) & (abs(ratio) <= found.high)
    assert 0.93 <= inside.mean() <= 0.97
    turned = np.abs(np.degrees(np.angle(found.ratio / ratio)))
    assert 0.93 <= np.mean(turned <= found.reach_deg) <= 0.97


def test_a_part_of_a_matrix_has_its_own_covariance():
    frf = matrix_frf(coupled_by(-15.0), error=0.04)
    turned = ls.interaction(frf, NAMES[::-1]).frf
    one, two = (interaction_coefficient(x, 0, 1, NAMES) for x in (frf, turned))
    np.testing.assert_allclose(one.coefficient, two.coefficient)
    np.testing.assert_allclose(one.high, two.high)
    assert one.frequency_hz.size == F.size
