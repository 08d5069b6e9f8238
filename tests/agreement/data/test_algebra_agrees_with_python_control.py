"""The algebra on responses of random state-space systems against python-control's own interconnections."""

import control
import numpy as np
import pytest

import loopshape as ls
from loopshape.data.algebra import feedback, inverse, lower_closure, product, subtract, upper_closure, with_hold
from loopshape.data.control.controller import Block

F = np.geomspace(0.01, 20.0, 40)


def system(rng, ny, nu, states=5, prefix=""):
    """A stable random system; python-control's `rss` draws from the global generator."""
    A = rng.standard_normal((states, states))
    A -= (np.abs(np.linalg.eigvals(A).real).max() + 0.3) * np.eye(states)
    B, C, D = (rng.standard_normal(shape) for shape in ((states, nu), (ny, states), (ny, nu)))
    return control.ss(A, B, C, 0.1 * D)


def frf(sys_, inputs, outputs):
    G = np.moveaxis(sys_(2j * np.pi * F, squeeze=False), -1, 0)
    ny, nu = G.shape[1:]
    C = np.zeros((F.size, ny * nu, ny * nu), dtype=complex)
    return ls.FRF(F, G, C, np.ones(F.size, dtype=bool), tuple(inputs), tuple(outputs), "python-control")


def same(ours, theirs):
    np.testing.assert_allclose(
        ours.response, np.moveaxis(theirs(2j * np.pi * F, squeeze=False), -1, 0), rtol=1e-8, atol=1e-10
    )


@pytest.mark.parametrize("seed", range(5))
def test_series_difference_inverse_and_feedback(seed):
    rng = np.random.default_rng(seed)
    P, K = system(rng, 2, 3), system(rng, 3, 2)
    p, k = frf(P, ["u1", "u2", "u3"], ["y1", "y2"]), frf(K, ["y1", "y2"], ["u1", "u2", "u3"])
    same(product(p, k), control.series(K, P))
    same(subtract(product(p, k), frf(control.series(K, P), ["y1", "y2"], ["y1", "y2"])), 0.0 * control.series(K, P))
    loop, eye2, eye3 = feedback(p, k), control.ss([], [], [], np.eye(2)), control.ss([], [], [], np.eye(3))
    same(loop.PS, control.feedback(P, K))
    same(loop.KS, control.feedback(K, P))
    same(loop.S_o, control.feedback(eye2, P * K))
    same(loop.T_o, control.feedback(P * K, eye2))
    same(loop.S_i, control.feedback(eye3, K * P))
    same(loop.T_i, control.feedback(K * P, eye3))
    np.testing.assert_allclose(inverse(loop.S_o).response, np.eye(2) + p.response @ k.response, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_closures(seed):
    rng = np.random.default_rng(seed)
    M, K, D = system(rng, 4, 5), system(rng, 2, 3), system(rng, 2, 3)
    m = frf(M, ["w1", "w2", "w3", "u1", "u2"], ["z1", "y1", "y2", "y3"])
    k = frf(K, ["y1", "y2", "y3"], ["u1", "u2"])
    same(lower_closure(m, k), M.lft(K))
    same(lower_closure(m, k, connect="order"), M.lft(K))
    d = frf(D, ["z1", "y1", "y2"], ["w1", "w2"])
    same(upper_closure(m, d), control.StateSpace.lft(D, M))
    same(upper_closure(m, d, connect="order"), control.StateSpace.lft(D, M))


def test_a_held_plant_is_the_sampled_one_up_to_what_folds_down():
    """python-control's zero-order hold of a second order plant, and the alias that the docstring states."""
    P, rate = control.tf([100.0], [1.0, 2.0, 100.0]), 200.0
    sampled, f = control.c2d(P, 1.0 / rate, "zoh"), np.geomspace(0.1, 60.0, 50)
    continuous = P(2j * np.pi * f)
    C = np.full((f.size, 1, 1), 1e-6 + 0j)
    one = ls.FRF(f, continuous[:, None, None], C, np.ones(f.size, dtype=bool), ("u_v",), ("y_rad",), "analyser")
    ours = with_hold(one, rate)
    theirs = sampled(np.exp(2j * np.pi * f / rate))
    alias = np.abs(P(2j * np.pi * (rate - f)) / continuous) * f / (rate - f)
    assert np.all(np.abs(ours.siso / theirs - 1.0) < 1.3 * alias + 1e-9)
    assert np.abs(ours.siso / theirs - 1.0)[f < 10.0].max() < 1e-3
    late = with_hold(one, rate, 0.004)
    np.testing.assert_allclose(late.siso / ours.siso, np.exp(-2j * np.pi * f * 0.004), rtol=1e-12)
    np.testing.assert_allclose(ours.variance[:, 0, 0], 1e-6 * np.sinc(f / rate) ** 2, rtol=1e-12)
    assert ours.rate_hz == rate


@pytest.mark.short
def test_discrete_controllers_on_a_held_plant_are_the_discrete_loop():
    """A two-loop plant: discrete controllers and held plant against python-control's discrete feedback."""
    rate, f = 500.0, np.geomspace(0.5, 20.0, 30)
    rng = np.random.default_rng(2)
    # rolled off by two orders: what folds down from 480 Hz is small
    P = system(rng, 2, 2) * control.tf([1.0], [1.0 / 60.0, 1.0]) * control.tf([1.0], [1.0 / 60.0, 1.0])
    one = ls.Controller("a", (Block("gain", {"gain": 2.0}), Block("low_pass_1", {"f_hz": 30.0})), rate)
    two = ls.Controller("b", (Block("pi", {"f_hz": 0.3}),), rate)
    G = np.moveaxis(P(2j * np.pi * f, squeeze=False), -1, 0)
    C = np.zeros((f.size, 4, 4), dtype=complex)
    p = with_hold(ls.FRF(f, G, C, np.ones(f.size, dtype=bool), ("a_v", "b_v"), ("a_m", "b_m"), "analyser"), rate)
    loop = feedback(p, [one, two])
    z = np.exp(2j * np.pi * f / rate)
    sampled = np.moveaxis(control.c2d(control.ss(P), 1.0 / rate, "zoh")(z, squeeze=False), -1, 0)
    K = np.zeros((f.size, 2, 2), dtype=complex)
    K[:, 0, 0], K[:, 1, 1] = one.response(f), two.response(f)
    np.testing.assert_allclose(loop.S_o.response, np.linalg.inv(np.eye(2) + sampled @ K), atol=2e-3)
