"""The laws of FRF algebra, for any responses and sizes: products, inverses, S + T = I, closures, push-through."""

from dataclasses import replace

import numpy as np
from algebra_nouns import any_frf
from hypothesis import assume, given
from hypothesis import strategies as st

from loopshape.data.algebra import (
    add,
    channels,
    feedback,
    inverse,
    lower_closure,
    product,
    regrid,
    subtract,
    upper_closure,
    with_hold,
)  # fmt: skip

seeds, sizes = st.integers(0, 2**31), st.integers(1, 3)


def close(one, other, rtol=1e-9):
    size = max(np.abs(one).max(), np.abs(other).max(), 1e-30)
    np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol * size)


def well(*matrices):
    """Skip draws that are all but singular."""
    assume(all(np.linalg.cond(m).max() < 1e4 for m in matrices))


@given(seeds, sizes, sizes, sizes, sizes)
def test_products_associate_with_their_covariances(seed, a, b, c, d):
    rng = np.random.default_rng(seed)
    A, B, C = (any_frf(rng, i, j, recording=r) for i, j, r in ((a, b, "a"), (b, c, "b"), (c, d, "c")))
    left = product(product(A, B, connect="order"), C, connect="order")
    right = product(A, product(B, C, connect="order"), connect="order")
    close(left.response, right.response)
    close(left.covariance, right.covariance)
    assert (left.inputs, left.outputs) == (C.inputs, A.outputs)
    assert left.recording == "a+b+c"


@given(seeds, sizes)
def test_the_inverse_of_a_product_is_the_product_of_the_inverses_turned_round(seed, n):
    rng = np.random.default_rng(seed)
    A, B = any_frf(rng, n, n), any_frf(rng, n, n)
    well(A.response, B.response)
    one = inverse(product(A, B, connect="order"))
    other = product(inverse(B), inverse(A), connect="order")
    close(one.response, other.response)
    close(one.covariance, other.covariance, 1e-7)
    close(inverse(inverse(A)).covariance, A.covariance, 1e-7)
    assert (inverse(A).inputs, inverse(A).outputs) == (A.outputs, A.inputs)


@given(seeds, sizes, sizes)
def test_sensitivities_add_up_and_push_through(seed, ny, nu):
    rng = np.random.default_rng(seed)
    P, K = (
        any_frf(rng, ny, nu),
        any_frf(rng, nu, ny, inputs=[f"y{k}" for k in range(ny)], outputs=[f"u{k}" for k in range(nu)]),
    )
    well(np.eye(ny) + P.response @ K.response, np.eye(nu) + K.response @ P.response)
    loop = feedback(P, K)
    close(add(loop.S_o, loop.T_o).response, np.broadcast_to(np.eye(ny), (7, ny, ny)))
    close(add(loop.S_i, loop.T_i).response, np.broadcast_to(np.eye(nu), (7, nu, nu)))
    close(loop.S_o.covariance, loop.T_o.covariance)  # T = I - S: one error
    close(loop.S_i.covariance, loop.T_i.covariance)
    close(loop.S_o.response @ P.response, P.response @ loop.S_i.response)  # push-through
    close(loop.PS.response, loop.S_o.response @ P.response)
    close(loop.KS.response, loop.S_i.response @ K.response)
    assert (loop.PS.inputs, loop.PS.outputs, loop.KS.inputs, loop.KS.outputs) == (
        P.inputs,
        P.outputs,
        P.outputs,
        P.inputs,
    )


@given(seeds, sizes, sizes, sizes, sizes)
def test_closures_are_what_their_definitions_say(seed, nz, nw, ny, nu):
    rng = np.random.default_rng(seed)
    M, K = any_frf(rng, nz + ny, nw + nu), any_frf(rng, nu, ny, size=0.3)
    m, k = M.response, K.response
    m11, m12, m21, m22 = m[:, :nz, :nw], m[:, :nz, nw:], m[:, nz:, :nw], m[:, nz:, nw:]
    well(np.eye(ny) - m22 @ k)
    lower = lower_closure(M, K, connect="order")
    close(lower.response, m11 + m12 @ k @ np.linalg.inv(np.eye(ny) - m22 @ k) @ m21)
    assert (lower.inputs, lower.outputs) == (M.inputs[:nw], M.outputs[:nz])
    turned = channels(M, [*M.outputs[nz:], *M.outputs[:nz]], [*M.inputs[nw:], *M.inputs[:nw]])
    upper = upper_closure(turned, K, connect="order")
    close(upper.response, lower.response)
    close(upper.covariance, lower.covariance)


@given(seeds, sizes, sizes)
def test_feedback_is_a_lower_closure_and_a_zero_closure_opens_the_loop(seed, ny, nu):
    rng = np.random.default_rng(seed)
    y, u = [f"y{k}" for k in range(ny)], [f"u{k}" for k in range(nu)]
    P, K = any_frf(rng, ny, nu), any_frf(rng, nu, ny, inputs=y, outputs=u)
    well(np.eye(ny) + P.response @ K.response)
    # y = P (w + u), u = -K y: M = [[P, P], [P, P]] from (w, u) to (z, y), its four errors all that of P
    whole = np.tile(P.response, (1, 2, 2))
    copies = np.kron(np.ones((2, 1)), np.eye(ny)), np.kron(np.ones((2, 1)), np.eye(nu))
    J = np.kron(copies[1], copies[0])
    M = any_frf(
        rng, 2 * ny, 2 * nu, outputs=[*[f"z{k}" for k in range(ny)], *y], inputs=[*[f"w{k}" for k in range(nu)], *u]
    )
    M = replace(M, response=whole, covariance=J @ P.covariance @ J.T)
    minus = replace(K, response=-K.response)
    PS, closed = feedback(P, K).PS, lower_closure(M, minus)
    close(closed.response, PS.response)
    close(closed.covariance, PS.covariance, 1e-7)
    nothing = replace(K, response=0.0 * K.response, covariance=0.0 * K.covariance)
    close(lower_closure(M, nothing).response, P.response)
    close(lower_closure(M, nothing).covariance, P.covariance)


@given(seeds, sizes, sizes)
def test_channels_and_names(seed, ny, nu):
    rng = np.random.default_rng(seed)
    A, B = any_frf(rng, ny, nu), any_frf(rng, ny, nu)
    turned = channels(B, B.outputs[::-1], B.inputs[::-1])
    close(add(A, turned).response, A.response + B.response)  # by name, whatever the order
    close(add(A, turned).covariance, A.covariance + B.covariance)
    close(subtract(A, B).response, A.response - B.response)
    close(channels(turned, B.outputs, B.inputs).covariance, B.covariance)
    one = channels(A, [A.outputs[-1]], [A.inputs[0]])
    close(one.variance[:, 0, 0], A.variance[:, -1, 0])


@given(seeds, sizes)
def test_regridding_is_exact_on_old_lines_and_on_straight_ones(seed, n):
    rng = np.random.default_rng(seed)
    A = any_frf(rng, n, n)
    same = regrid(A, A.frequency_hz)
    close(same.response, A.response, 1e-14)
    close(same.covariance, A.covariance, 1e-14)
    new = np.sort(rng.uniform(1.0, 7.0, 9))
    w = new - np.floor(new)
    left = np.floor(new).astype(int) - 1
    implied = ((1 - w) ** 2)[:, None, None] * A.covariance[left] + (w**2)[:, None, None] * A.covariance[left + 1]
    more = regrid(A, new).covariance - implied
    assert np.linalg.eigvalsh(more).min() > -1e-12
    step = (slice(None), None, None)
    one_error = (1 - w)[step] * np.sqrt(A.variance[left]) + w[step] * np.sqrt(A.variance[left + 1])
    assert np.all(regrid(A, new).variance >= (1 - 1e-9) * one_error**2)  # even where all lines err together


def test_no_operation_changes_its_operands():
    rng = np.random.default_rng(5)
    P, K = any_frf(rng, 2, 2), any_frf(rng, 2, 2, inputs=["y0", "y1"], outputs=["u0", "u1"])
    before = [(x.frequency_hz.copy(), x.response.copy(), x.covariance.copy()) for x in (P, K)]
    feedback(P, K), product(P, K), inverse(P), add(P, P, independent=True), with_hold(P, 100.0), regrid(P, [1.5, 2.5])
    lower_closure(P, channels(K, ["u0"], ["y0"])), upper_closure(P, channels(K, ["u0"], ["y0"]))
    for x, (f, G, C) in zip((P, K), before, strict=True):
        np.testing.assert_array_equal(x.frequency_hz, f)
        np.testing.assert_array_equal(x.response, G)
        np.testing.assert_array_equal(x.covariance, C)
        assert not x.response.flags.writeable
