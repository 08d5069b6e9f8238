"""The dual-stage hard disk's benchmark is simulated as its source does, and the shipped controllers score what is said.

Numbers of the reference: figure 8 of the source (PyHDDBenchmark, commit 38ed847), and the data's own referee.
"""

import csv
import os
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
STUDY = ROOT / "experiments" / "hdd"
DATA = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data")) / "hdd"
pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason="the hard disk's numbers are absent: set LOOPSHAPE_DATA to the folder of recordings"
)
sys.path.insert(0, str(STUDY))


@pytest.fixture(scope="module")
def disk():
    from hdd_benchmark import Benchmark

    return Benchmark(DATA)


@pytest.fixture(scope="module")
def disturbances(disk):
    return disk.disturbances()


@pytest.mark.parametrize(("case", "referee", "stroke_nm"), [(5, 12.804, 13.76), (9, 14.542, 14.12)])
def test_the_reference_scores_what_its_referee_says(disk, disturbances, case, referee, stroke_nm):
    y, stroke = disk.head(disk.cases[case - 1], disk.reference(), disturbances)
    assert disk.three_sigma(y) == pytest.approx(referee, abs=0.0015)
    assert 1e9 * stroke == pytest.approx(stroke_nm, abs=0.006)


def test_the_shipped_controllers_score_what_the_study_says(disk, disturbances):
    from hdd_benchmark import read_controllers

    controllers = read_controllers(STUDY / "controllers_tuned.json")
    found = disk.three_sigma(disk.head(disk.cases[8], controllers, disturbances)[0])
    rows = {
        (row["controllers"], row["case"]): row for row in csv.DictReader((STUDY / "cases.csv").read_text().splitlines())
    }
    assert found == pytest.approx(float(rows["tuned", "9"]["three_sigma"]), rel=1e-3)
    assert found < 9.0


def test_slopes_of_the_limits_rows_are_those_of_differences():
    from hdd_rows import Limits, rows_of

    f, rng = np.geomspace(0.1, 60.0, 400), np.random.default_rng(3)
    L = (4.0 / (1j * f * (1.0 + 0.1j * f)) * (1.0 + 0.2j * f / (4.0 + 0.3j * f - f**2)))[None] * np.ones((2, 1))
    step = 1e-7 * (rng.normal(size=L.shape) + 1j * rng.normal(size=L.shape))
    limits, ceiling = Limits(), np.full(L.shape, 1.0)
    rows, moved = rows_of(L, limits, ceiling), rows_of(L * np.exp(step), limits, ceiling)
    after = np.minimum(rows.i + 1, f.size - 1)
    said = np.real(rows.a * step[rows.case, rows.i] + rows.b * step[rows.case, after])
    assert rows.slack.size > 20
    np.testing.assert_allclose(moved.slack - rows.slack, said, rtol=1e-4, atol=1e-10)


@pytest.mark.parametrize(
    ("peak_db", "phase_deg", "slack"), [(-0.5, 20.0, 0.45), (-0.02, 20.0, -0.03), (-0.02, 60.0, 2.0)]
)
def test_a_turn_towards_1_keeps_away_from_it_or_has_the_phase_margin(peak_db, phase_deg, slack):
    from hdd_rows import grazes

    size = peak_db - 0.01 * np.arange(-50, 51) ** 2
    L = 10.0 ** (size / 20.0) * np.exp(1j * np.radians(phase_deg - 180.0))
    assert grazes(L[None], 48.0).slack == pytest.approx([slack], abs=1e-6)


def test_the_forecast_is_the_mean_over_seeds(disk):
    """Mean of ten other seeds, simulated once with the reference: 14.36 % in case 9."""
    from hdd_forecast import Forecast, nodes_hz, run_out_variance

    forecast, reference = Forecast(disk, nodes_hz()), disk.reference()
    K = forecast.K(reference)
    out = run_out_variance(disk, lambda other: other.K(reference))
    assert forecast.three_sigma(K, forecast.loops(K), out)[8] == pytest.approx(14.36, rel=0.01)


def test_systems_of_roots_are_those_they_were_made_of(disk):
    from hdd_forecast import response
    from hdd_tuning import Roots, resonators

    z = np.exp(1j * np.linspace(0.01, 3.1, 50))
    for system in disk.reference().values():
        roots = Roots.of(system).with_pairs(resonators([3000.0], 0.03))
        np.testing.assert_allclose(response(roots.system(), z), response(system, z), rtol=1e-9)


def test_no_set_is_better_than_the_limit_and_the_forecast_knows_what_reaches_it(disk):
    """Two routes, the lifted plant's Riccati equations and the frequency domain, agree on the least 3 sigma."""
    from hdd_benchmark import read_controllers
    from hdd_forecast import Forecast, tuning_nodes
    from hdd_limit import filters, least, lifted

    forecast = Forecast(disk, tuning_nodes(disk, 70.0))
    plant = lifted(disk, disk.cases[2])
    found = least(plant)
    rows = list(csv.DictReader((STUDY / "limit.csv").read_text().splitlines()))
    assert found.three_sigma == pytest.approx(float(rows[2]["no_controller_below"]), rel=1e-3)
    K = filters(disk, plant, found, forecast)
    assert forecast.three_sigma(K, forecast.loops(K))[2] == pytest.approx(found.three_sigma, rel=0.01)
    for controllers in (disk.reference(), read_controllers(STUDY / "controllers_tuned.json")):
        K = forecast.K(controllers)
        assert forecast.three_sigma(K, forecast.loops(K))[2] > found.three_sigma


def test_the_piezo_s_gain_does_not_move_the_limit(disk):
    from hdd_limit import least, lifted

    found = [least(lifted(disk, disk.cases[k])).three_sigma for k in (2, 5, 8)]
    assert found == pytest.approx([found[0]] * 3, rel=1e-5)
