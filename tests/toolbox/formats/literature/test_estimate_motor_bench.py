"""The two-inertia motor bench of the University of Tokyo, from its recording: FdiTools_Python (MIT), MultisineTypeA.

20 periods of 1 s at 2.5 kHz, Schroeder multisine of 11-250 Hz. Published with it: anti-resonance about 53-54 Hz at
-78 to -82 dB on the motor's side, resonance about 77 Hz at -37 dB, the standard deviation of the FRF 40-60 dB
below, and a model of order 4 with two zeros.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Rational
from conversions import db

from loopshape.identify.fit import fit, modes
from loopshape.identify.frequency_response import estimate_frf
from loopshape.toolbox.formats.tables.import_file import import_file

ROOT = Path(__file__).resolve().parents[4]
BENCH = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data")) / "tokyo_bench" / "MultisineTypeA.mat"
pytestmark = pytest.mark.skipif(
    not BENCH.is_file(), reason="the motor bench's recording is absent: set LOOPSHAPE_DATA to the folder of recordings"
)


@pytest.fixture(scope="module")
def frf():
    run = import_file(BENCH, ROOT / "examples" / "motor_bench" / "map.toml")
    return estimate_frf(run.recordings[0], run.loops[0])


@pytest.fixture(scope="module")
def model(frf):
    return fit(frf, Rational(2, 4))


def test_it_is_estimated_by_its_periods_on_the_multisines_lines(frf):
    assert "19 periods of 1 s, the first left out (not settled)" in frf.method
    np.testing.assert_allclose(frf.frequency_hz, np.arange(11.0, 251.0))


def test_anti_resonance(frf):
    near = frf.between(45.0, 62.0)
    k = int(np.argmin(np.abs(near.siso)))
    assert 53.0 <= near.frequency_hz[k] <= 54.0
    assert -83.0 < db(near.siso[k]) < -77.0


def test_resonance(frf):
    near = frf.between(65.0, 90.0)
    k = int(np.argmax(np.abs(near.siso)))
    assert 76.0 <= near.frequency_hz[k] <= 78.0
    assert db(near.siso[k]) == pytest.approx(-37.0, abs=1.0)


def test_the_standard_deviation_lies_40_to_60_db_below(frf):
    below = db(frf.siso) - 10.0 * np.log10(frf.variance[:, 0, 0])
    assert 40.0 < np.median(below) < 60.0


def test_a_model_of_order_4_with_2_zeros_has_the_published_modes(model):
    found = {x.name: x for x in modes(model)}
    zero = [x for n, x in found.items() if n.startswith("zero") and n.endswith("f_hz")]
    pole = [x for n, x in found.items() if n.startswith("pole") and n.endswith("f_hz")]
    assert model.outcome == "converged"
    assert min(abs(x.value - 54.0) for x in zero) < 1.0
    assert min(abs(x.value - 76.5) for x in pole) < 0.5


def test_the_phase_turns_by_180_degrees_at_the_zero_and_back_at_the_pole(frf):
    # a collocated drive: its phase climbs by 180 deg at the zero and falls by 180 deg at the pole
    def phase(f_low, f_high):
        return np.angle(np.mean(frf.between(f_low, f_high).siso))

    before, between, after = phase(46.0, 49.0), phase(60.0, 70.0), phase(84.0, 90.0)
    assert np.cos(between - before) < -0.8
    assert np.cos(after - between) < -0.8
