"""EMPS (A. Janot, M. Gautier, M. Brunot 2019, nonlinear benchmark): a recorded axis against one without friction."""

import csv
import os
from dataclasses import replace
from pathlib import Path

import pytest
from simulated_machines import ServoAxis, import_file

from loopshape.toolbox.gap.diagnose import attribute
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis

ROOT = Path(__file__).parents[4]
EMPS = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data")) / "emps"
pytestmark = pytest.mark.skipif(
    not EMPS.is_dir(), reason="the EMPS recordings are absent: set LOOPSHAPE_DATA to the folder of recordings"
)


@pytest.fixture(scope="module")
def run():
    maps = ROOT / "examples" / "emps"
    first = import_file(EMPS / "DATA_EMPS.mat", maps / "map.toml")
    second = import_file(EMPS / "DATA_EMPS_PULSES.mat", maps / "map_pulses.toml")
    return replace(first, recordings=(*first.recordings, *second.recordings))


@pytest.fixture(scope="module")
def evidence(run):
    axis, cut, names = ServoAxis().readied(run, ["emps"])
    return Evidence.of(axis, cut, names, periodic_s=float("inf"), threads=1)


@pytest.fixture(scope="module")
def none(evidence):
    return attribute.healthy(evidence)


def fit(evidence, base, *forms):
    (start,) = attribute.screened(evidence, [Hypothesis(evidence.plant, forms)], base)
    return attribute.again(evidence, start, rounds=6)


def form(axis, effect, words):
    return next(f for f in axis.effects if f.effect == effect and f.form == words)


def errors(run, fitted):
    """Relative force errors in per cent of both recordings; the second was never fitted."""
    axis = fitted.hypothesis.plant
    moves = fitted.hypothesis.moves(fitted.phi)
    return [100.0 * axis.relative_error(axis.prepare(r, run, None), moves) for r in run.recordings]


def test_without_coulomb_friction_about_a_sixth_of_the_force_is_missing(run, none):
    assert errors(run, none) == pytest.approx([17.5, 17.8], abs=1.0)  # 17.8 % in the literature's way


def test_coulomb_friction_and_offset_have_the_published_values(run, evidence, none):
    axis = evidence.plant
    coulomb, offset = form(axis, "coulomb_friction", "tanh Coulomb"), form(axis, "force_offset", "constant")
    both = fit(evidence, fit(evidence, none, coulomb), coulomb, offset)
    moves = both.hypothesis.moves(both.phi)
    assert moves["mass_kg"] == pytest.approx(95.1089, rel=0.01)
    assert moves["viscous_ns_m"] == pytest.approx(203.5034, rel=0.02)
    assert moves["coulomb_n"] == pytest.approx(20.3935, rel=0.02)
    assert moves["force_offset_n"] == pytest.approx(3.1648, rel=0.03)  # on the other side of the equation there
    estimation, held_out = errors(run, both)
    assert estimation == pytest.approx(4.08, abs=0.6)
    assert held_out < 5.98  # with the force at the time at which it acts, less is left than was published


def test_friction_of_each_direction_has_the_published_values(run, evidence, none):
    asymmetric = fit(evidence, none, form(evidence.plant, "asymmetric_friction", "more viscous downwards"))
    moves = asymmetric.hypothesis.moves(asymmetric.phi)
    up, down = (moves["viscous_ns_m"] * (1.0 + side * moves["viscous_asymmetry"]) for side in (1.0, -1.0))
    assert (up, down) == (pytest.approx(166.71, rel=0.02), pytest.approx(240.42, rel=0.02))
    levels = [moves["coulomb_n"] * (1.0 + side * moves["coulomb_asymmetry"]) for side in (1.0, -1.0)]
    assert levels == pytest.approx([20.14, 20.63], rel=0.02)
    assert errors(run, asymmetric)[0] == pytest.approx(3.11, abs=0.7)


def test_the_study_s_table_is_the_literature_s():
    with (ROOT / "experiments" / "emps" / "errors.csv").open() as file:
        table = {row["model"]: float(row["sampled_held_out_percent"]) for row in csv.DictReader(file)}
    assert table["viscous only"] == pytest.approx(17.8, abs=0.3)
    assert table["Coulomb + offset"] == pytest.approx(5.98, abs=0.4)
    assert table["asymmetric"] == pytest.approx(5.4, abs=0.4)
    assert table["quadratic drag"] == pytest.approx(11.3, abs=0.4)
    assert table["Stribeck + offset"] == pytest.approx(table["Coulomb + offset"], abs=0.3)
