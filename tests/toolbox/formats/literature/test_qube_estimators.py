"""An unstable plant: the direct estimate is drawn to -1/C and stays there, the other one comes to the plant."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from conversions import db

from loopshape.identify.quality.quality import loop_feedback
from loopshape.toolbox.formats.tables.import_file import import_file

ROOT = Path(__file__).resolve().parents[4]
STUDY = ROOT / "experiments" / "qube"
LENGTHS_S = (60, 240, 960)


@pytest.fixture(scope="module")
def simulated():
    return runpy.run_path(str(STUDY / "simulated.py"))


@pytest.fixture(scope="module")
def found(shared):
    if not (shared / "data" / "qube").is_dir():
        pytest.skip("the QUBE recordings are not in the shared data")
    before = sys.path.copy()
    try:
        study = runpy.run_path(str(STUDY / "run.py"))
    finally:
        sys.path[:] = before
    study["measured"].__globals__["DATA"] = shared / "data" / "qube"
    return study["measured"]()


def errors(simulated, estimator, noise_rad):
    return np.array([simulated["relative_error"](estimator, s, noise_rad, 3) for s in LENGTHS_S])


def exponent(found):
    return np.polyfit(np.log(LENGTHS_S), np.log(found), 1)[0]


def test_with_noise_the_direct_error_of_an_unstable_plant_stays_and_the_other_falls(simulated):
    direct, reference = (errors(simulated, e, 0.1) for e in ("direct", "reference"))
    assert direct.min() > 0.6
    assert exponent(direct) == pytest.approx(0.0, abs=0.06)
    assert exponent(reference) == pytest.approx(-0.5, abs=0.12)
    assert reference[-1] < 0.09


def test_with_little_noise_both_are_right(simulated):
    for estimator in ("direct", "reference"):
        assert errors(simulated, estimator, 0.003).max() < 0.03  # what Welch's window leaves


def test_with_noise_alone_the_direct_estimate_is_minus_the_inverse_controller(simulated):
    frf = simulated["estimated"]("direct", 960, 10.0, 1)
    limit = simulated["minus_inverse_controller"](frf.frequency_hz)
    assert np.median(np.abs(frf.siso / limit - 1.0)) < 0.05


def test_the_qubes_direct_estimate_lies_between_the_plant_and_minus_the_inverse_controller(found):
    low = found.frequency_hz <= 1.5
    for kind in ("direct", "quiet"):
        lower = db(found.reference[low]) - db(getattr(found, kind)[low])
        assert np.all(lower > 1.0)
    assert np.all(np.abs(db(found.quiet) - db(found.minus_inverse_controller))[found.frequency_hz <= 3.0] < 4.0)
    assert np.all(np.abs(found.direct / found.reference - 1.0)[low] > 1.4 * found.relative_std[low])  # no more in 24 s
    assert db(found.reference[0]) - db(found.direct[0]) == pytest.approx(9.0, abs=0.3)


def test_where_the_excitation_outweighs_the_rest_both_agree(found):
    rows = (found.frequency_hz >= 4.0) & (found.frequency_hz <= 9.0)
    assert found.coherence[rows].min() > 0.93
    assert np.abs(found.direct / found.reference - 1.0)[rows].max() < 0.06


def test_the_qubes_feedback_is_found(shared):
    for file in sorted((shared / "data" / "qube").glob("*.csv")):
        run = import_file(file, ROOT / "examples" / "qube" / "map.toml")
        for loop in run.loops:
            feedback = loop_feedback(run.recordings[0], loop)
            assert feedback.detected
            assert feedback.probability < 1e-100
