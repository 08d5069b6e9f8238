"""Two coupled loops, one excited at a time: P = S_P S_I^-1 is the plant, and its covariance is the scatter."""

from dataclasses import replace

import numpy as np
import pytest
from excitations import multisine
from two_loops import PLACES, RATE, equivalent_plant, plant, runs, white

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.matrix.matrix import estimate_matrix
from loopshape.identify.settings import Settings


@pytest.mark.parametrize("place", PLACES)
def test_without_noise_the_matrix_is_the_plant(place):
    n = [multisine(0.5, 30.0, 4.0, RATE, periods=4, seed=k) for k in (1, 2)]
    run = runs(place, n, 0.0, 1, "multisine", period_s=4.0, periodic_from_s=5.0)[0]
    frf = estimate_matrix(run, run.recordings)
    np.testing.assert_allclose(frf.response, plant(frf.frequency_hz), rtol=1e-8, atol=1e-12)
    assert (frf.inputs, frf.outputs) == (("z0_v", "z1_v"), ("y0_rad", "y1_rad"))


@pytest.mark.parametrize("place", PLACES)
def test_one_loop_alone_sees_the_other_closed(place):
    n = [multisine(0.5, 30.0, 4.0, RATE, periods=4, seed=k) for k in (1, 2)]
    run = runs(place, n, 0.0, 1, "multisine", period_s=4.0, periodic_from_s=5.0)[0]
    for k in (0, 1):
        frf = estimate_frf(run.recordings[k], run.loops[k])
        np.testing.assert_allclose(frf.siso, equivalent_plant(frf.frequency_hz, k), rtol=1e-8)
        assert np.abs(frf.siso / plant(frf.frequency_hz)[:, k, k] - 1.0).max() > 0.03  # and that is another plant


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_the_order_of_the_recordings_does_not_matter(place):
    run = runs(place, [white(1, 1, 4000), white(2, 1, 4000)], 0.05, 1)[0]
    there, back = (estimate_matrix(run, list(run.recordings)[::s]) for s in (1, -1))
    np.testing.assert_array_equal(there.response, back.response)


def shared(covariance, i, j):
    """Largest correlation of two elements' errors over the lines."""
    return np.max(np.abs(covariance[:, i, j]) / np.sqrt(np.real(covariance[:, i, i] * covariance[:, j, j])))


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_the_covariance_is_that_of_repeated_runs(place):
    # whitened by the predicted covariance, the error of vec(P), columns stacked, has covariance 1 on average
    found = [
        estimate_matrix(run, run.recordings, Settings(resolution_hz=0.5))
        for run in runs(place, [white(1, 200, 6000), white(2, 200, 6000)], 0.05, 200)
    ]
    f = found[0].frequency_hz
    band = (f >= 1.5) & (f <= 25.0)
    error = np.array([(x.response[band] - plant(f[band])).transpose(0, 2, 1).reshape(band.sum(), 4) for x in found])
    predicted = np.mean([x.covariance[band] for x in found], axis=0)
    scatter = np.einsum("rfi,rfj->fij", error, error.conj()) / len(found)
    root = np.linalg.inv(np.linalg.cholesky(predicted))
    white_scatter = (root @ scatter @ root.conj().transpose(0, 2, 1)).mean(0)
    # 200 runs of 48 lines, 1.9 as one: an element is known to 1.5 %; transients raise the prediction by some percent
    assert np.real(np.diag(white_scatter)) == pytest.approx(np.ones(4), abs=0.12)
    np.testing.assert_allclose(white_scatter - np.diag(np.diag(white_scatter)), 0.0, atol=0.08)
    assert shared(predicted, 0, 2) > 0.3  # P_11 and P_12 share y_1's noise: a diagonal would not do


@pytest.mark.long
@pytest.mark.parametrize("place", PLACES)
def test_variance_has_the_place_of_its_element(place):
    run = runs(place, [white(1, 1, 6000), white(2, 1, 6000)], 0.05, 1)[0]
    frf = estimate_matrix(run, run.recordings)
    for column in (0, 1):
        for row in (0, 1):
            k = 2 * column + row
            np.testing.assert_array_equal(frf.variance[:, row, column], frf.covariance[:, k, k].real)


def test_multisines_of_different_periods_are_refused():
    n = [multisine(0.5, 30.0, period, RATE, periods=4, seed=1) for period in (4.0, 5.0)]
    size = min(x.size for x in n)
    run = runs("plant_input", [n[0][:size], n[1][:size]], 0.0, 1, "multisine", period_s=4.0, periodic_from_s=1.0)[0]
    second = replace(run.recordings[1], info=replace(run.recordings[1].info, period_s=5.0))
    with pytest.raises(ls.errors.WrongUseError, match="different periods"):
        estimate_matrix(run, [run.recordings[0], second])
