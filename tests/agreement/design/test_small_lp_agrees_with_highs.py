"""The tuner's small linear programmes agree with HiGHS, plain and compiled alike."""

import numpy as np
import pytest
from scipy.optimize import linprog

from loopshape.core.kernels.loops.small_lp import NOT_SOLVED, OPTIMAL, boxed_lp


def programme(seed, feasible=True):
    """Random rows about a point inside the box."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 14)), int(rng.integers(1, 200))
    A, cost = rng.standard_normal((m, n)), rng.standard_normal(n)
    A[rng.random((m, n)) < 0.3] = 0.0
    low, high = -rng.random(n), rng.random(n)
    inside = low + rng.random(n) * (high - low)
    b = A @ inside + (rng.exponential(0.3, m) if feasible else -5.0)
    if seed % 3 == 0:
        b[: m // 2] = A[: m // 2] @ inside  # many rows through one point: degenerate corners
    return cost, A, b, low, high


@pytest.mark.parametrize("seed", range(60))
def test_the_optimum_is_that_of_highs(seed):
    cost, A, b, low, high = programme(seed)
    y, multipliers, outcome = boxed_lp(cost, A, b, low, high)
    peer = linprog(cost, A_ub=A, b_ub=b, bounds=np.stack([low, high], axis=1), method="highs")
    assert outcome == OPTIMAL
    assert cost @ y == pytest.approx(peer.fun, abs=1e-8)
    assert np.all(A @ y <= b + 1e-8)
    assert np.all((y >= low - 1e-8) & (y <= high + 1e-8))
    # duality: the Lagrangian's least value over the box is the optimum
    assert np.all(multipliers >= 0.0)
    slope = cost + multipliers @ A
    dual = np.minimum(slope * low, slope * high).sum() - multipliers @ b
    assert dual == pytest.approx(peer.fun, abs=1e-8)


def test_rows_that_exclude_each_other_are_not_solved():
    for seed in range(10):
        cost, A, b, low, high = programme(seed, feasible=False)
        A, b = np.vstack([A, -A[:1]]), np.append(b, -b[0] - 1.0)
        assert boxed_lp(cost, A, b, low, high)[2] == NOT_SOLVED


def test_no_row_leaves_the_best_corner_of_the_box():
    y, _, outcome = boxed_lp(np.array([1.0, -2.0]), np.zeros((0, 2)), np.zeros(0), -np.ones(2), np.ones(2))
    assert outcome == OPTIMAL
    np.testing.assert_array_equal(y, [-1.0, 1.0])


def test_plain_and_compiled_agree():
    plain = getattr(boxed_lp, "py_func", boxed_lp)
    for seed in range(20):
        one, two = boxed_lp(*programme(seed)), plain(*programme(seed))
        assert one[2] == two[2]
        np.testing.assert_allclose(one[0], two[0], atol=1e-9)
