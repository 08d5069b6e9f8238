"""FRFs and predictions as version 1 of their formats wrote them, with `trusted` and `held_by`: kept, and open."""

from pathlib import Path

import numpy as np
import pytest
from prediction_nouns import read_predictions
from run_files import read_frfs

import loopshape as ls
from loopshape.toolbox.formats.frf.frf_csv import read_frf_csv
from loopshape.toolbox.formats.frf.frf_foreign import frf_of
from loopshape.toolbox.formats.frf.frf_hdf5 import read_frf_hdf5
from loopshape.toolbox.formats.frf.frf_mat import read_frf_mat

DATA = Path(__file__).parent / "data"
READERS = {"csv": read_frf_csv, "h5": read_frf_hdf5, "mat": read_frf_mat}


def belongs(frf: ls.FRF) -> None:
    """What was written: 1/(j f) at 1, 2 and 4 Hz, the last outside the valid band, recorded under a gain of 2."""
    assert np.allclose(frf.siso, 1.0 / (1j * np.array([1.0, 2.0, 4.0])))
    assert frf.valid.tolist() == [True, True, False]
    assert frf.recorded_under is not None
    assert frf.recorded_under.response(np.array([1.0]))[0] == pytest.approx(2.0)


@pytest.mark.parametrize("ending", READERS)
def test_a_frf_of_version_1_opens(ending: str) -> None:
    belongs(frf_of(READERS[ending](DATA / f"frf_1.{ending}")))


def test_frfs_beside_a_run_open() -> None:
    (frf,) = read_frfs(DATA / "run_1")
    belongs(frf)


def test_predictions_of_version_1_open() -> None:
    (one,) = read_predictions(DATA / "predictions_1.npz")
    assert one.controller.response(np.array([1.0]))[0] == pytest.approx(2.0)
    assert one.sensitivity.valid.tolist() == [True, True]
