"""Open-loop validation of van den Brink, DCT 2007.002, figures 4.16 to 4.18: what the model does, and why."""

from pathlib import Path

import numpy as np
import pytest
from simulated_machines import read_study

from loopshape.toolbox.arm.dynamics.model import muscle
from loopshape.toolbox.arm.parameters import TWO_L
from loopshape.toolbox.arm.source import value

STUDY = Path(__file__).parents[5] / "experiments" / "open_loop_validation" / "study.toml"
STEPS = round(1e3 * value("open_loop.duration"))


@pytest.fixture(scope="module")
def driven(arm, arm_experiment, quiet):
    """True angle in deg and pressures in bar, and why it ended, of a 7 s run driven by pulses of z (start, end, V)."""

    def run(start, z_theta=(), z_p=(), solver="edges", **changes):
        z = np.zeros((STEPS, 2))
        for column, pulses in enumerate((z_theta, z_p)):
            for first_s, last_s, volts in pulses:
                z[round(1e3 * first_s) : round(1e3 * last_s), column] = volts
        e = arm_experiment(start, STEPS, injection="control", injected=z)
        (r,) = arm.simulate([e], changes=quiet | changes, solver=solver, states=True)
        columns = [r.column(f"true_{k}") for k in ("theta2_rad", "p_a_bar", "p_b_bar")]
        return np.degrees(columns[0]), columns[1], columns[2], r.info.ended_early

    return run


BACK = ((1.0, 3.0, 0.11),)
EMPTY = ((1.0, 4.0, -0.22),)
SWING = ((0.5, 1.0, 0.23), (1.5, 2.0, -0.27), (2.5, 3.0, 0.32))


def pulled_back(driven, **changes):
    turning = tuple((a, b, -v) for a, b, v in BACK)
    return driven((30.0, 0.8), turning, BACK, **changes)


def test_every_record_of_the_study_is_as_long_as_the_sources():
    study = read_study(STUDY)
    assert {e.name for e in study.experiments} >= {"figure-4-16", "figure-4-17", "figure-4-18"}
    for e in study.experiments:
        assert e.duration_s == value("open_loop.duration"), e.name


def test_a_shut_muscle_that_is_stretched_rises_hardly_as_printed_and_clearly_with_the_absolute_law(driven):
    rises = {}
    for share in (0.0, 1.0):
        theta, p_a, p_b, ended = pulled_back(driven, gas_absolute_share=share)
        assert ended is None
        assert theta[-1] < 10.0 < theta[0]
        rises[share] = p_a[-1] - p_a[0]
        assert p_b[-1] - p_b[0] > 0.3
    assert 0.0 < rises[0.0] < 0.05
    assert rises[1.0] > 2.0 * rises[0.0]


@pytest.mark.parametrize(("share", "exponent"), [(0.0, 1.0), (1.0, 1.0), (1.0, 1.4)])
def test_its_rise_follows_the_polytropic_law_of_the_volume(driven, arm_constants, share, exponent):
    theta, p_a, _, _ = pulled_back(driven, gas_absolute_share=share, polytropic_exponent=exponent)
    c = arm_constants()

    def volume(angle_deg):
        angle = np.radians(angle_deg)  # muscle A: ARM.md section 5, lengths in m
        x, y = 0.33 - 0.034 * np.sin(angle), -0.0497 + 0.034 * np.cos(angle)
        return muscle(c, 5e4, float(np.hypot(x, y)) - 0.14, 0.0, 1.0, c[TWO_L], 0.0)[1]

    atmosphere = 1.01325 * share
    expected = (p_a[0] + atmosphere) * (volume(theta[0]) / volume(theta[-1])) ** exponent - atmosphere
    assert p_a[-1] == pytest.approx(expected, abs=1e-7)


def test_the_run_stops_and_says_so_where_a_muscle_leaves_the_range(driven):
    *_, ended = driven((0.0, 1.0), (), EMPTY)
    assert "pressure left the model's range" in ended


def test_the_arm_falls_over_below_the_low_pressure_with_and_without_gravity(driven):
    for gravity in (9.81, 0.0):
        theta, p_a, _, ended = driven(
            (0.0, 1.0), (), EMPTY, gravity_m_s2=gravity, range_low_bar=0.01, range_angle_deg=60.0
        )
        assert "angle left" in ended
        assert np.abs(theta[p_a > value("open_loop.low_pressure")]).max() < 0.1


def test_the_sources_solver_errs_by_the_edges_that_it_misses(driven):
    exact, coarse = (driven((0.0, 1.0), SWING, solver=solver)[0] for solver in ("edges", "grid"))
    assert 0.1 < np.abs(exact - coarse).max() < 1.0
