"""Recordings of several inputs through the same commands: DaISy's CD-player arm and flexible structure.

De Moor, DaISy, KU Leuven. The CD arm's inputs have no power above 0.4 cycles per sample; the structure's multiple
coherence is published as near 1.
"""

from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Settings

import loopshape as ls
from loopshape.identify.matrix.matrix import estimate_matrix
from loopshape.toolbox.formats.tables.import_file import import_file

MAPS = Path(__file__).parents[4] / "examples" / "daisy"


def matrix(shared: Path, name: str, settings: Settings) -> ls.FRF:
    file = shared / "data" / "daisy" / f"{name}_dat.mat"
    if not file.is_file():
        pytest.skip("the shared folder holds no DaISy recordings")
    run = import_file(file, MAPS / f"{name.lower()}.toml")
    return estimate_matrix(run, run.recordings, settings)


@pytest.mark.parametrize("method", ["welch", "local"])
def test_above_0_4_cycles_a_sample_the_cd_arm_is_refused_and_that_is_said(shared, method):
    frf = matrix(shared, "CD_player_arm", Settings(method=method))
    assert (frf.inputs, frf.outputs) == (("u1_1", "u2_1"), ("y1_1", "y2_1"))
    low, high = frf.valid_band_hz
    assert low < 0.02
    assert 0.35 < high < 0.41
    assert "no power of its own in u1_1 and u2_1 from 0.40" in " ".join(frf.notes)


def test_both_methods_see_the_same_cd_arm(shared):
    local = matrix(shared, "CD_player_arm", Settings(method="local"))
    welch = matrix(shared, "CD_player_arm", Settings(method="welch")).between(0.02, 0.15)
    at = np.searchsorted(local.frequency_hz, welch.frequency_hz - 1e-9)
    close = np.abs(local.response[at] - welch.response) ** 2 / (local.variance[at] + welch.variance)
    assert np.median(close) < 1.5  # 0.7 where errors are all there is between them
    assert np.mean(close < 9.0) > 0.9


def test_two_shakers_and_28_accelerations_are_one_matrix_with_coherence_near_one(shared):
    frf = matrix(shared, "flexible_structure", Settings(method="welch", resolution_hz=1.0))
    assert frf.response.shape[1:] == (28, 2)
    assert frf.multiple_coherence is not None
    band = frf.between(100.0, 450.0)
    assert frf.averages > 10.0  # by chance two inputs then have a fifth at most
    assert np.median(band.multiple_coherence) > 0.95
    explained = np.linalg.eigvalsh(band.covariance[::50])
    assert explained.min() > -1e-9 * explained.max()  # a covariance
