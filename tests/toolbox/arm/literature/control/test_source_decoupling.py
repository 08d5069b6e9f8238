"""Claims of experiments/decoupling about the source's decoupling (section 5.1, chapter 6); ARM.md, sections 1 and 7."""

import sys
from pathlib import Path

import numpy as np
import pytest
from conversions import db
from simulated_machines import read_study

from loopshape.toolbox.arm.dynamics.equilibrium import pressures
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.arm.source import EQUILIBRIA, value

FOLDER = Path(__file__).parents[5] / "experiments" / "decoupling"
LIMIT_DB = value("figure_h_7.interaction")
NUMBERS = constants(ARM1_PARAMETERS.vector())
BANDWIDTH_HZ = np.linspace(value("table_5_1.bandwidth_low"), value("table_5_1.bandwidth_high"), 9)


@pytest.fixture(scope="module")
def study_modules():
    """The study's own functions."""
    sys.path.insert(0, str(FOLDER))
    try:
        import decoupling_measure
        import decoupling_static

        yield decoupling_measure, decoupling_static
    finally:
        sys.path.remove(str(FOLDER))


def interaction_db(P):
    return db(P[:, 0, 1] * P[:, 1, 0] / (P[:, 0, 0] * P[:, 1, 1]))


def rates_at(lin, u):
    """dp_A/dt, dp_B/dt in bar/s for duties u of each muscle: filling above zero, exhaust below."""
    return np.where(u > 0.0, lin.fill, lin.exhaust) * u


@pytest.mark.parametrize("p_ab", sorted({p for _, p in EQUILIBRIA}))
def test_upright_the_outputs_are_decoupled_by_symmetry(p_ab):
    """Section 5.1 of the source; only rounding of the lever arms is left."""
    assert interaction_db(linearise(NUMBERS, 0.0, p_ab).response(BANDWIDTH_HZ)).max() < LIMIT_DB - 80.0


@pytest.mark.parametrize("point", [(15.0, 0.8), (30.0, 0.8), (15.0, 1.2), (30.0, 1.0)])
def test_both_signs_of_the_angle_couple_alike(point):
    theta, p_ab = point
    P, Q = (linearise(NUMBERS, sign * theta, p_ab).response(BANDWIDTH_HZ) for sign in (1.0, -1.0))
    assert interaction_db(P) == pytest.approx(interaction_db(Q), abs=0.3)
    assert P[:, 0, 1] / P[:, 0, 0] == pytest.approx(-Q[:, 0, 1] / Q[:, 0, 0], rel=0.02)


def test_linearising_calls_every_equilibrium_decoupled_within_the_bandwidth():
    """What the measurement contradicts: averaged valves do not know the commands' mean."""
    supply = constants(ARM1_PARAMETERS.vector({"supply_bar": 1.25}))
    for theta, p_ab in EQUILIBRIA:
        full = max(pressures(NUMBERS, theta, p_ab)) > 1.0
        lin = linearise(supply if full else NUMBERS, theta, p_ab)
        assert interaction_db(lin.response(BANDWIDTH_HZ)).max() < LIMIT_DB


def test_a_muscle_near_the_supply_fills_far_slower_than_it_empties():
    """The cause: at (30 deg, 1.2 bar) a swing of z_theta2 takes more out of A than it brings in, so p_AB sinks."""
    lin = linearise(NUMBERS, 30.0, 1.2)
    assert lin.exhaust[0] / lin.fill[0] > 10.0
    swing = sum(rates_at(lin, z * np.array([1.0, -1.0])) for z in (1.0, -1.0))
    assert swing[0] < -1.5
    higher = linearise(constants(ARM1_PARAMETERS.vector({"supply_bar": 1.25})), 30.0, 1.2)
    assert higher.exhaust[0] / higher.fill[0] < 4.0


def test_the_best_static_matrix_of_a_pair_of_angles_is_the_sources_own(study_modules):
    """Both couplings are odd in theta2: a constant matrix for both signs can only be the identity."""
    _, static = study_modules
    f = np.linspace(0.4, 10.0, 40)
    pair = [linearise(NUMBERS, theta, 0.8).response(f) for theta in (-30.0, 30.0)]
    alone = static.best(pair[1:])
    assert np.abs(static.best(pair)).max() < 0.01
    assert abs(alone[0]) > 0.5
    assert static.best(pair, [-30.0, 30.0])[0] == pytest.approx(alone[0] / 30.0, rel=0.01)


def test_a_static_matrix_takes_the_coupling_off_what_it_was_fitted_to(study_modules):
    _, static = study_modules
    P = linearise(NUMBERS, 30.0, 0.8).response(BANDWIDTH_HZ)
    assert interaction_db(P @ static.matrix(static.best([P]))).max() < interaction_db(P).max() - 20.0


def test_measured_the_worst_point_is_coupled(study_modules):
    """One point of the study with fewer realisations: above the limit of H.7 with its whole interval."""
    measure, _ = study_modules
    from dataclasses import replace

    study = read_study(FOLDER / "study.toml")
    one = next(s for s in measure.at_one_point(study) if s.operating_points[0] == {"theta2_deg": 30.0, "p_ab_bar": 1.2})
    few = replace(one, experiments=tuple(e for e in one.experiments if e.name.endswith(("-r1", "-r2", "-r3"))))
    found = measure.found_at(few, {"lowest_hz": 0.4, "mode_within": 0.1, "high_hz": [7.0, 10.0]})
    verdicts = dict(zip(found.bands_hz, found.met.verdicts, strict=True))
    assert verdicts["bandwidth"].low_db > LIMIT_DB
    assert max(abs(g) for g in found.gains.ravel()) > 3.0 * abs(found.gains[0, 0])
