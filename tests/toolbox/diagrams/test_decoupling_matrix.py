"""The constant matrix that decouples a measured plant: the true one, with an error that draws of the noise confirm."""

from dataclasses import replace

import numpy as np
import pytest

import loopshape as ls

F_HZ = np.geomspace(0.5, 20.0, 40)
W12, W21 = -0.4, 0.1


def plant(relative_std: float = 0.02) -> ls.FRF:
    """P = D inverse(W) with a diagonal D that turns with frequency: W decouples it exactly."""
    D = np.stack([1.0 / (1.0 + 1j * F_HZ / 3.0), 5.0 / (1j * F_HZ)], axis=1)
    H = D[:, :, None] * np.linalg.inv(np.array([[1.0, W12], [W21, 1.0]]))
    return ls.FRF.from_arrays(F_HZ, H, relative_std=relative_std, rate_hz=1000.0)


def drawn(P: ls.FRF, rng: np.random.Generator) -> ls.FRF:
    size = np.sqrt(0.5 * np.real(np.einsum("fii->fi", P.covariance)))
    noise = size * (rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape))
    return replace(P, response=P.response + noise.reshape(-1, 2, 2).transpose(0, 2, 1))


def test_the_true_matrix_is_found_and_leaves_a_diagonal_plant():
    P = plant()
    W = ls.diagrams.decouple(P, at_hz=2.0)
    np.testing.assert_allclose(W.matrix, [[1.0, W12], [W21, 1.0]], atol=1e-12)
    behind = W.applied(P).response
    assert np.abs(behind[:, [0, 1], [1, 0]]).max() < 1e-12 * np.abs(behind).max()


@pytest.mark.parametrize("at_hz", [2.0, (1.0, 4.0)])
def test_its_deviation_is_that_of_draws(at_hz):
    """400 draws: a deviation is known to 3.5 %, and four times that is allowed."""
    P, rng = plant(), np.random.default_rng(5)
    W = ls.diagrams.decouple(P, at_hz=at_hz)
    found = np.array([ls.diagrams.decouple(drawn(P, rng), at_hz=at_hz).matrix for _ in range(400)])
    for i, j in ((0, 1), (1, 0)):
        assert found[:, i, j].std() == pytest.approx(W.std[i, j], rel=0.14)


def test_the_plant_behind_it_has_its_covariance():
    """Of P W by draws of P, W as it stands."""
    P, rng = plant(), np.random.default_rng(6)
    W = ls.diagrams.decouple(P, at_hz=2.0)
    spread = np.std([drawn(P, rng).response @ W.matrix for _ in range(400)], axis=0)
    stated = np.sqrt(np.real(np.einsum("fii->fi", W.applied(P).covariance))).reshape(-1, 2, 2).transpose(0, 2, 1)
    assert np.mean(spread / stated) == pytest.approx(1.0, abs=0.02)


def test_a_band_without_a_valid_frequency_is_refused():
    with pytest.raises(ls.errors.WrongUseError, match="no valid frequency"):
        ls.diagrams.decouple(plant(), at_hz=(30.0, 40.0))
