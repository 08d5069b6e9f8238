"""Each bad request of the servo axis, and the sentence that the user gets."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, Experiment, RecordingInfo

import loopshape as ls
from loopshape.toolbox.servo.axis import ServoAxis


def run_of(force, position, parameters=None, role="estimation"):
    info = RecordingInfo("one.parquet", "profile", "reference", role=role)
    recording = ls.Recording(info, 1000.0, {"force_n": np.asarray(force), "position_m": np.asarray(position)})
    return ls.Run(1000.0, (), (recording,), "servo-axis", extra={"parameters": parameters or {}})


MOVING = (np.sin(np.arange(3000) / 50.0), 1e-3 * np.sin(np.arange(3000) / 50.0))


@pytest.mark.parametrize("point", [{}, {"position": 0.0}, {"position_m": 0.0, "theta2_deg": 0.0}])
def test_operating_point_with_other_names(point):
    with pytest.raises(ls.errors.WrongUseError, match="names position_m; received"):
        ServoAxis().check_operating_point(point)


@pytest.mark.parametrize("position_m", [1.0, -2.0, float("nan")])
def test_operating_point_outside_the_travel(position_m):
    with pytest.raises(ls.errors.WrongUseError, match="travels 1 m to both sides; received"):
        ServoAxis().check_operating_point({"position_m": position_m})


@pytest.mark.parametrize("changes", [{"weight": 1.0}, {"mass_kg": -1.0}, {"flexible_share": 1.0}])
def test_parameters_it_does_not_have(changes):
    with pytest.raises(ls.errors.WrongUseError):
        ServoAxis().check_settings(1000.0, changes)


def test_a_controller_of_another_loop():
    with pytest.raises(ls.errors.WrongUseError, match="needs one controller, of its loop position; received theta2"):
        ServoAxis().loop_setups([ls.Controller("theta2", (Block("gain", {"gain": 1.0}),), 1000.0)], "reference")


def test_a_solver_it_does_not_have():
    with pytest.raises(ls.errors.WrongUseError, match="solver is not known; received 'grid'; use edges"):
        ServoAxis().simulate([], solver="grid")


@pytest.mark.parametrize("value", [-1.0, 0.0, float("inf"), "heavy", True])
def test_a_mass_that_is_none(value):
    with pytest.raises(ls.errors.WrongUseError, match="mass_kg of the servo axis is a positive number"):
        ServoAxis().of_run(run_of(*MOVING, {"mass_kg": value}))


def test_parameters_of_a_run_that_are_not_nominal_are_left_aside():
    axis = ServoAxis().of_run(run_of(*MOVING, {"mass_kg": 3.0, "viscous_ns_m": 1.0, "coulomb_n": 9.0}))
    assert axis.parameters.rows[axis.parameters.index("coulomb_n")].value == 0.0
    assert [s.half for s in axis.spread] == [0.05, 0.2]


def test_a_run_without_estimation_recordings():
    with pytest.raises(ls.errors.WrongUseError, match="no estimation recording"):
        ServoAxis().of_run(run_of(*MOVING, role="validation"))


def test_a_recording_that_is_too_short():
    with pytest.raises(ls.errors.BadSignalError, match=r"too short to be followed; received 1 s; give at least 1\.4 s"):
        ServoAxis().of_run(run_of(np.ones(1000), np.ones(1000)))


def test_an_axis_that_stands_still():
    with pytest.raises(ls.errors.BadSignalError, match="does not move; give mass_kg and viscous_ns_m"):
        ServoAxis().of_run(run_of(np.ones(3000), np.zeros(3000)))


def test_a_force_of_the_wrong_sign():
    force, position = MOVING
    with pytest.raises(ls.errors.BadSignalError, match=r"no positive mass.*check the sign of force_n"):
        ServoAxis().of_run(run_of(force, position))  # in phase: force pushes outwards, the axis accelerates inwards


def test_a_recording_without_a_force():
    run = run_of(*MOVING)
    bare = replace(run.recordings[0], columns={"position_m": MOVING[1]})
    with pytest.raises(ls.errors.BadSignalError, match="no column force_n"):
        ServoAxis().of_run(replace(run, recordings=(bare,)))


def test_a_rotary_recording_says_which_model_takes_it():
    run = run_of(*MOVING)
    turned = replace(run.recordings[0], columns={"torque_nm": MOVING[0], "angle_rad": MOVING[1]})
    with pytest.raises(
        ls.errors.BadSignalError, match=r"columns torque_nm, angle_rad; .*model.toml with axis = \"rotary\""
    ):
        ServoAxis().of_run(replace(run, recordings=(turned,)))


def test_an_axis_that_leaves_its_travel_says_when():
    axis = ServoAxis()
    loops = axis.loop_setups(axis.default_controllers(1000.0), "control")
    force = np.full((4000, 1), 200.0)
    e = Experiment(
        "one", "open_loop", loops, 1000.0, 0 * force, force, "control", {"position_m": 0.0}, closed_loop=False
    )
    (r,) = axis.simulate([e])
    assert r.info.ended_early is not None
    assert r.info.ended_early.startswith("the axis left its travel at 1.")
    assert r.columns["position_m"].size < 2000
