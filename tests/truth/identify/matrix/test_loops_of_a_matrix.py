"""The square part of a matrix FRF that its loops make, and the plant that a loop meets with the others closed."""

import numpy as np
import pytest
from bench_nouns import Block
from interaction_nouns import F, coupled_by, matrix_frf

import loopshape as ls
from loopshape.data.algebra import controller_frf, lower_closure
from loopshape.identify.matrix.equivalent_plant import equivalent_plant, square_part

NAMES = ("theta1", "theta2")


def random_matrix(n, seed=1):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((F.size, n, n)) + 1j * rng.standard_normal((F.size, n, n))


def controllers(names=NAMES):
    blocks = (Block("gain", {"gain": 5.0}), Block("lead_lag", {"f1_hz": 0.5, "f2_hz": 9.0}))
    return {name: ls.Controller(name, blocks, 1000.0) for name in names}


def test_loops_are_chosen_by_name_and_rows_follow():
    P = random_matrix(3)
    frf = matrix_frf(P, error=0.01, loop="theta1+theta2+p_a")
    part, names = square_part(frf, ("p_a", "theta1"))
    assert names == ("p_a", "theta1")
    assert part.inputs == ("z_p_a_v", "z_theta1_v")
    assert part.outputs == ("p_a_rad", "theta1_rad")
    np.testing.assert_array_equal(part.response, P[:, [2, 0]][:, :, [2, 0]])
    np.testing.assert_allclose(part.variance, frf.variance[:, [2, 0]][:, :, [2, 0]])


def test_rows_of_a_tall_matrix_are_found_by_name_or_named():
    P = np.concatenate([random_matrix(2, 5)[:, :1], random_matrix(2)], axis=1)
    tall = matrix_frf(P, outputs=("x_m", "theta1_rad", "theta2_rad"))
    np.testing.assert_array_equal(square_part(tall)[0].response, P[:, 1:])
    named = square_part(tall, outputs=("x_m", "theta2_rad"))[0]
    np.testing.assert_array_equal(named.response, P[:, [0, 2]])


@pytest.mark.parametrize("names", [NAMES, ("theta1", "theta2", "p_a")])
def test_an_equivalent_plant_is_the_closure_with_its_covariance(names):
    n = len(names)
    rng = np.random.default_rng(4)
    root = 0.01 * (rng.standard_normal((F.size, n * n, n * n)) + 1j * rng.standard_normal((F.size, n * n, n * n)))
    frf = matrix_frf(random_matrix(n), root @ root.conj().transpose(0, 2, 1), loop="+".join(names))
    for i, name in enumerate(names):
        found = equivalent_plant(frf, names, name, controllers(names))
        rest = [k for k in range(n) if k != i]
        K = controller_frf([controllers(names)[names[k]] for k in rest], F,
                           [frf.outputs[k] for k in rest], [frf.inputs[k] for k in rest])  # fmt: skip
        minus = type(K)(**{**K.__dict__, "response": -K.response})
        direct = lower_closure(frf, minus)
        assert found.loop == name
        np.testing.assert_allclose(found.response, direct.response)
        np.testing.assert_allclose(found.covariance, direct.covariance)


def test_the_variance_of_an_equivalent_plant_is_its_scatter():
    P, draws = coupled_by(-6.0)[0], 4000
    rng = np.random.default_rng(5)
    root = 0.01 * np.abs(P.T.ravel())[:, None] * (rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4)))
    f = np.linspace(2.0, 2.0 + 1e-6, draws)
    own = {name: ls.Controller(name, (Block("gain", {"gain": 15.0}),), 1000.0) for name in NAMES}
    found = equivalent_plant(matrix_frf(P, root @ root.conj().T, f, seed=9), NAMES, "theta1", own)
    closed = P[0, 0] - P[0, 1] * 15.0 * P[1, 0] / (1.0 + 15.0 * P[1, 1])
    assert np.median(found.variance) == pytest.approx(np.mean(np.abs(found.siso - closed) ** 2), rel=0.1)


def test_a_loop_that_is_not_there_or_has_no_controller_is_refused():
    frf = matrix_frf(coupled_by(-30.0), error=0.01)
    tall = matrix_frf(np.ones((F.size, 3, 2)), outputs=("a_m", "b_m", "c_m"))
    for ask, words in (
        (lambda: square_part(frf, ("theta1", "nose")), "a loop is not in the FRF; received nose; it has theta1, the"),
        (lambda: square_part(frf, ("theta1", "theta1")), "between two loops at least, each once"),
        (lambda: square_part(tall), "3 outputs (a_m, b_m, c_m) for the loops theta1, theta2; name the outputs"),
        (lambda: square_part(tall, outputs=("a_m",)), "1 outputs for 2 loops"),
        (lambda: equivalent_plant(frf, NAMES, "nose", {}), "a loop is not in the FRF"),
        (lambda: equivalent_plant(frf, NAMES, "theta1", {}), "received none of theta2"),
    ):
        with pytest.raises(ls.errors.WrongUseError) as caught:
            ask()
        assert words in str(caught.value)
