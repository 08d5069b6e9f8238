"""What k_I, relative gains and equivalent plants are by definition."""

import numpy as np
import pytest
from bench_nouns import Block
from conversions import db
from interaction_nouns import F, coupled_by, matrix_frf

import loopshape as ls
from loopshape.toolbox.diagrams.coupling.interaction import interaction_coefficient, relative_gain

NAMES = ("theta1", "theta2")


def controllers(gain=5.0, names=NAMES):
    blocks = (Block("gain", {"gain": gain}), Block("lead_lag", {"f1_hz": 0.5, "f2_hz": 9.0}))
    return {name: ls.Controller(name, blocks, 1000.0) for name in names}


def random_matrix(n, seed=1):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((F.size, n, n)) + 1j * rng.standard_normal((F.size, n, n))


def k_of(P):
    return interaction_coefficient(matrix_frf(P), 0, 1, NAMES)


@pytest.mark.parametrize(
    ("P", "k"),
    [
        ([[1.0, 1.0], [-1.0, 1.0]], -1.0),
        ([[2.0, 1.0], [1.0, 2.0]], 0.25),
        ([[1.0, 5.0], [0.0, 1.0]], 0.0),
        ([[1j, 2.0], [0.5, 1.0]], -1j),
    ],
)
def test_k_of_a_known_matrix(P, k):
    np.testing.assert_allclose(k_of(P).coefficient, k)
    np.testing.assert_allclose(k_of(P).low, abs(k))  # no error, no interval
    np.testing.assert_allclose(k_of(P).high, abs(k))


def test_k_has_the_same_value_for_other_units_and_for_the_inverse():
    P = random_matrix(2)
    k = k_of(P).coefficient
    scaled = np.diag([3.0, 1e-3]) @ P @ np.diag([0.2j, 50.0])
    np.testing.assert_allclose(k_of(scaled).coefficient, k)
    np.testing.assert_allclose(k_of(np.linalg.inv(P)).coefficient, k)


def test_relative_gains_sum_to_one_and_are_one_for_a_triangular_plant():
    for n in (2, 3):
        loop = "+".join(f"l{k}" for k in range(n))
        gain = relative_gain(matrix_frf(random_matrix(n), loop=loop)).gain
        np.testing.assert_allclose(gain.sum(axis=1), 1.0)
        np.testing.assert_allclose(gain.sum(axis=2), 1.0)
        triangular = relative_gain(matrix_frf(np.tril(random_matrix(n)), loop=loop))
        np.testing.assert_allclose(triangular.gain, np.broadcast_to(np.eye(n), (F.size, n, n)), atol=1e-9)
        np.testing.assert_allclose(triangular.number, 0.0, atol=1e-8)


def test_of_two_loops_relative_gain_and_coefficient_say_the_same():
    P = random_matrix(2)
    found = relative_gain(matrix_frf(P))
    np.testing.assert_allclose(found.gain[:, 0, 0], 1.0 / (1.0 - k_of(P).coefficient))
    np.testing.assert_allclose(found.number, 4.0 * np.abs(found.gain[:, 0, 0] - 1.0))


def test_with_two_loops_closing_one_changes_the_other_by_1_minus_k_T():
    P, C = coupled_by(-6.0), controllers()
    found = ls.interaction(matrix_frf(P, error=0.02), controllers=C)
    L = P[:, 1, 1] * C["theta2"].response(F)
    np.testing.assert_allclose(found.equivalents[0].ratio, 1.0 - k_of(P).coefficient * L / (1.0 + L))


def test_an_equivalent_plant_goes_to_the_open_one_as_the_others_open():
    frf = matrix_frf(coupled_by(-6.0), error=0.02)
    changes = []
    for gain in (1e-1, 1e-2, 1e-3):
        one = ls.interaction(frf, controllers=controllers(gain)).equivalents[0]
        changes.append(np.abs(one.ratio - 1.0).max())
        assert (one.low <= np.abs(one.ratio)).all()
        assert (np.abs(one.ratio) <= one.high).all()
    assert changes[1] / changes[0] == pytest.approx(0.1, rel=0.2)  # as the controller's gain
    assert changes[2] / changes[1] == pytest.approx(0.1, rel=0.02)
    np.testing.assert_allclose(one.closed.covariance, one.open.covariance, rtol=2e-3)


def test_a_notebook_shows_one_line_of_it():
    shown = repr(ls.interaction(matrix_frf(coupled_by(-40.0), error=0.01)))
    assert shown == "Interaction of theta1, theta2: 7 of 7 bands decoupled"


def test_loops_are_chosen_by_name():
    frf = matrix_frf(random_matrix(3), error=0.01, loop="theta1+theta2+p_a")
    found = ls.interaction(frf, ("p_a", "theta1"), limit_db=-15.0)
    assert found.coefficients[0].loops == ("p_a", "theta1")
    assert {v.limit_db for v in found.verdicts} == {-15.0}
    assert found.equivalents == ()
    assert len(ls.interaction(frf).coefficients) == 3


def test_the_coefficients_bounds_hold_its_estimate_and_open_to_zero_in_noise():
    found = interaction_coefficient(matrix_frf(coupled_by(-30.0), error=0.1, seed=2), 0, 1, NAMES)
    assert (found.low < np.abs(found.coefficient)).all()
    assert (np.abs(found.coefficient) < found.high).all()
    P = coupled_by(-30.0)
    C = np.zeros((F.size, 4, 4), dtype=complex)
    C[:, 2, 2] = (2.0 * np.abs(P[:, 0, 1])) ** 2
    noisy = interaction_coefficient(matrix_frf(P, C), 0, 1, NAMES)
    assert (noisy.low == 0.0).all()
    assert np.isfinite(noisy.high).all()
    assert (db(noisy.high) > -30.0).all()
    C[:, 0, 0] = np.abs(P[:, 0, 0]) ** 2
    assert np.isinf(interaction_coefficient(matrix_frf(P, C), 0, 1, NAMES).high).all()
