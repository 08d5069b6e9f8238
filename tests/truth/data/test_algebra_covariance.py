"""Covariances of FRF algebra against many draws of the operands' errors."""

from dataclasses import replace

import numpy as np
import pytest
from algebra_nouns import any_frf, covariance_of, drawn

import loopshape as ls
from loopshape.data.algebra import add, feedback, inverse, lower_closure, product, subtract, upper_closure
from loopshape.data.control.controller import Block

COUNT, F = 20_000, np.array([1.0, 2.0])
Y, U = ("y0", "y1"), ("u0", "u1", "u2")


def assert_covariance(promised, responses, nominal):
    """Within 6 % of the largest eigenvalue: a sample covariance of 20000 draws scatters by a few per cent."""
    found = covariance_of(responses)
    for k in range(F.size):
        size = np.linalg.eigvalsh(promised[k]).max()
        assert np.abs(np.linalg.eigvalsh(found[k] - promised[k])).max() < 0.06 * size
    bias = np.abs(responses.mean(0) - nominal).max()
    assert bias < 0.1 * np.sqrt(np.abs(np.einsum("fii->fi", promised)).max())


@pytest.fixture
def operands():
    rng = np.random.default_rng(7)
    P = any_frf(rng, 2, 3, f=F, error=0.003, outputs=Y, inputs=U)
    K = any_frf(rng, 3, 2, f=F, error=0.003, outputs=U, inputs=Y)
    return rng, P, K, drawn(rng, P, COUNT), drawn(rng, K, COUNT)


def test_product_sum_and_inverse(operands):
    rng, P, K, p, k = operands
    assert_covariance(product(P, K).covariance, p @ k, P.response @ K.response)
    Q = any_frf(rng, 2, 3, f=F, error=0.01, outputs=Y, inputs=U)
    q = drawn(rng, Q, COUNT)
    assert_covariance(add(P, Q).covariance, p + q, P.response + Q.response)
    assert_covariance(subtract(P, Q).covariance, p - q, P.response - Q.response)
    A = any_frf(rng, 2, 2, f=F, error=0.003)
    assert_covariance(inverse(A).covariance, np.linalg.inv(drawn(rng, A, COUNT)), np.linalg.inv(A.response))


def test_the_closed_loop_counts_each_operand_once(operands):
    _, P, K, p, k = operands
    loop = feedback(P, K)
    So, Si = np.linalg.inv(np.eye(2) + p @ k), np.linalg.inv(np.eye(3) + k @ p)
    for ours, draws in (
        (loop.S_o, So), (loop.T_o, p @ k @ So), (loop.S_i, Si), (loop.T_i, k @ p @ Si),
        (loop.PS, p @ Si), (loop.KS, k @ So),
    ):  # fmt: skip
        assert_covariance(ours.covariance, draws, ours.response)


def test_put_together_from_parts_the_errors_would_be_wrong(operands):
    """P times S_o as if they were independent: the covariance is off by far more than Monte Carlo's scatter."""
    _, P, K, p, k = operands
    loop = feedback(P, K)
    apart = product(loop.S_o, P, connect="order")
    np.testing.assert_allclose(apart.response, loop.PS.response)
    right = np.einsum("fii->f", loop.PS.covariance).real
    assert np.abs(np.einsum("fii->f", apart.covariance).real / right - 1.0).max() > 0.3
    found = np.einsum("fii->f", covariance_of(p @ np.linalg.inv(np.eye(3) + k @ p))).real
    np.testing.assert_allclose(right, found, rtol=0.05)


def test_closures():
    rng = np.random.default_rng(11)
    M = any_frf(rng, 3, 4, f=F, error=0.003, outputs=("z", *Y), inputs=("w", *U))
    K = any_frf(rng, 3, 2, f=F, error=0.003, outputs=U, inputs=Y, size=0.4)
    m, k = drawn(rng, M, COUNT), drawn(rng, K, COUNT)
    draws = m[..., :1, :1] + m[..., :1, 1:] @ k @ np.linalg.inv(np.eye(2) - m[..., 1:, 1:] @ k) @ m[..., 1:, :1]
    assert_covariance(lower_closure(M, K).covariance, draws, lower_closure(M, K).response)
    D = any_frf(rng, 2, 1, f=F, error=0.003, outputs=("w", "u0"), inputs=("z",), size=0.4)
    d = drawn(rng, D, COUNT)
    inner = d @ np.linalg.inv(np.eye(1) - m[..., :1, :2] @ d)
    draws = m[..., 1:, 2:] + m[..., 1:, :2] @ inner @ m[..., :1, 2:]
    assert_covariance(upper_closure(M, D).covariance, draws, upper_closure(M, D).response)


def test_the_error_of_the_first_order_shrinks_with_the_square_of_the_noise():
    """What an inverse's variance leaves out, as a ratio: four times less for half the error."""
    biases = []
    for error in (0.08, 0.04):
        rng = np.random.default_rng(3)
        A = any_frf(rng, 1, 1, f=F[:1], error=error)
        x = drawn(np.random.default_rng(4), A, 200_000)
        biases.append(float(np.mean(np.abs(1.0 / x - 1.0 / A.response) ** 2) / inverse(A).variance[0, 0, 0] - 1.0))
    assert biases[1] < 0.4 * biases[0]


def test_a_controller_adds_no_error_and_noise_keeps_its_share():
    rng = np.random.default_rng(5)
    P = any_frf(rng, 1, 1, f=F, rate_hz=100.0)
    P = replace(P, noise_covariance=0.25 * P.covariance)
    loop = feedback(P, ls.Controller("x", (Block("gain", {"gain": 0.5}),), 100.0))
    S = 1.0 / (1.0 + 0.5 * P.siso)
    np.testing.assert_allclose(loop.S_o.siso, S)
    np.testing.assert_allclose(loop.S_o.variance[:, 0, 0], np.abs(0.5 * S**2) ** 2 * P.variance[:, 0, 0])
    np.testing.assert_allclose(loop.S_o.noise_covariance, 0.25 * loop.S_o.covariance)
    assert loop.S_o.rate_hz == 100.0
