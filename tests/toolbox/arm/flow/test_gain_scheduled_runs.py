"""A schedule from two points: written, read, checked at each, and run on the simulated arm between them."""

from pathlib import Path

import numpy as np
import pytest

import loopshape as ls

STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 0.9 }]

[[experiment]]
name = "move"
duration_s = 3.0
references = { p_ab = { kind = "profile", times_s = [0.2], values_bar = [1.35], velocity_bar_s = 0.4, acceleration_bar_s2 = 2.0, jerk_bar_s3 = 20.0 }, theta2 = { kind = "staircase", times_s = [2.0], values_deg = [4.0] } }
"""  # noqa: E501


def node(gain: float) -> ls.Controller:
    blocks = (ls.gain(gain), ls.lead_lag(2.2, 18.0), ls.notch(4.5, 0.05, 5.0), ls.low_pass(19.0, 0.55))
    return ls.controller(*blocks, rate_hz=1000.0, loop="theta2")


def schedule(low: float, high: float, lag_s: float = 0.0) -> ls.schedules.GainScheduled:
    points = [{"p_ab_bar": 0.8}, {"p_ab_bar": 1.4}]
    return ls.schedules.gain_scheduled([node(low), node(high)], points, {"p_ab_bar": "p_ab"}, lag_s=lag_s)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


def test_it_is_read_as_it_was_written(tmp_path: Path):
    C = schedule(11.0, 8.0, 0.05)
    (back,) = ls.schedules.read_gain_scheduled(ls.write(C, tmp_path / "controller.toml"))
    assert (back.loop, back.variables, back.lag_s) == (C.loop, C.variables, C.lag_s)
    np.testing.assert_array_equal(back.coefficients, C.coefficients)
    with pytest.raises(ls.errors.WrongUseError, match="holds a schedule"):
        ls.read_controllers(tmp_path / "controller.toml")


def test_with_alike_nodes_the_arm_does_what_it_does_under_the_plain_controller(study: Path, tmp_path: Path):
    """The two realisations differ in rounding alone, which converters and PWM edges hardly enlarge in three seconds."""
    plain = ls.rig.measure(study, tmp_path / "plain", controllers=[node(11.0)])
    scheduled = ls.rig.measure(study, tmp_path / "scheduled", controllers=[schedule(11.0, 11.0)])
    for name in ("theta2_rad", "z_theta2_v"):
        a, b = (run.recordings[0].column(name) for run in (plain, scheduled))
        assert np.abs(a - b).max() < 0.02 * np.ptp(a)


def test_the_arm_runs_it_and_the_logged_z_is_that_of_the_interpolated_controller(study: Path, tmp_path: Path):
    """z from the logged r and y by coefficients that are interpolated here, sample by sample, in direct form I."""
    run = ls.rig.measure(study, tmp_path / "run", controllers=[schedule(11.0, 6.0)])
    r = run.recordings[0]
    assert r.info.ended_early is None
    assert run.loops[0].controller is None
    error = r.column("r_theta2_rad") - r.column("theta2_rad")
    share = np.clip((r.column("r_p_ab_bar") - 0.8) / 0.6, 0.0, 1.0)
    assert np.ptp(share) > 0.6
    z = (11.0 + share * (6.0 - 11.0)) * error
    for b0, b1, b2, a1, a2 in node(1.0).biquads()[1:]:
        out = np.zeros(z.size + 2)
        padded = np.concatenate([[0.0, 0.0], z])
        for k in range(2, out.size):
            out[k] = b0 * padded[k] + b1 * padded[k - 1] + b2 * padded[k - 2] - a1 * out[k - 1] - a2 * out[k - 2]
        z = out[2:]
    np.testing.assert_allclose(r.column("z_theta2_v"), z, atol=2.0**-13)
    np.testing.assert_array_equal(
        ls.read(tmp_path / "run").loops[0].schedule.coefficients, schedule(11.0, 6.0).coefficients
    )


def test_each_operating_point_is_checked_under_the_controller_that_runs_there():
    f_hz = np.geomspace(0.2, 20.0, 80)
    P = [
        ls.FRF.from_arrays(
            f_hz, k / (2j * np.pi * f_hz), relative_std=0.01, rate_hz=1000.0, operating_point={"p_ab_bar": p},
            recording=f"at {p}",
        )
        for k, p in ((1.0, 0.8), (2.0, 1.1), (3.0, 1.4))
    ]  # fmt: skip
    C = ls.schedules.gain_scheduled(
        [ls.controller(ls.gain(k), rate_hz=1000.0, loop="x") for k in (6.0, 2.0)],
        [{"p_ab_bar": 0.8}, {"p_ab_bar": 1.4}],
        {"p_ab_bar": "p_ab"},
    )
    R = ls.Requirements("x", sensitivity_peak_db=6.0, integrators=1, unstable_poles=0)
    verdict = ls.check(P, C, R)
    assert verdict.passed
    crossings = [verdict.margins[f"at {p}"].bandwidth_hz for p in (0.8, 1.1, 1.4)]
    np.testing.assert_allclose(crossings, [6.0 / (2 * np.pi), 8.0 / (2 * np.pi), 6.0 / (2 * np.pi)], rtol=0.01)
    assert "moves slowly" in verdict.warnings[-1]


def test_what_cannot_be_a_schedule_is_refused():
    points = [{"p_ab_bar": 0.8}, {"p_ab_bar": 1.4}]
    other = ls.controller(ls.gain(1.0), rate_hz=1000.0, loop="theta2")
    with pytest.raises(ls.errors.WrongUseError, match="one structure"):
        ls.schedules.gain_scheduled([node(1.0), other], points, {"p_ab_bar": "p_ab"})
    with pytest.raises(ls.errors.WrongUseError, match="fill a grid"):
        ls.schedules.gain_scheduled(
            [other] * 3, [{"a": 0, "b": 0}, {"a": 1, "b": 0}, {"a": 0, "b": 1}], {"a": "a", "b": "b"}
        )
    with pytest.raises(ls.errors.WrongUseError, match="changes its sign"):
        ls.schedules.gain_scheduled([node(1.0), node(-1.0)], points, {"p_ab_bar": "p_ab"})
    with pytest.raises(ls.errors.WrongUseError, match="names its variables"):
        schedule(2.0, 1.0).at({"theta2_deg": 0.0})
