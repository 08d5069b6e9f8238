"""`measure --escalate` and `--until`: steps judged before the next, on a simulated axis and on a target."""

import json
from contextlib import nullcontext
from itertools import pairwise

import numpy as np
import pytest
from axis_study import experiment, study_text, target, write_study
from commands import ROOT
from emulated_cases import needs_a_compiler
from python_target_line import Pty, Running

import loopshape as ls

AXIS = """
format = "loopshape-study/1"
rig = "simulated"
plant = "servo-axis"
seed = 1
operating_points = [{{ position_m = 0.0 }}]
[parameters]
position_noise_m = 2e-6
{more}
[limits]
position = {{ low_mm = -4.0, high_mm = 4.0 }}
force = {{ low_n = -{force}, high_n = {force} }}
[[experiment]]
name = "axis"
excites = "position"
lead_s = 0.2
[experiment.excitation]
kind = "multisine"
f_low_hz = 2.0
f_high_hz = 100.0
period_s = 1.0
periods = {periods}
ramp_s = 0.2
amplitude_mm = {amplitude}
"""


def axis(folder, periods=20, amplitude=20.0, force=1e6, more=""):
    path = folder / "study.toml"
    path.write_text(AXIS.format(periods=periods, amplitude=amplitude, force=force, more=more))
    return path


def events(run, word):
    lines = [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    return [line for line in lines if line["event"] == word]


def largest(run, name, column="position_m"):
    return float(np.abs(ls.read(run).recording(name).columns[column]).max())


def test_the_amplitude_rises_until_a_limit_is_near(tmp_path):
    ls.rig.measure(axis(tmp_path), tmp_path / "run", escalate=1.0)
    steps = events(tmp_path / "run", "step")
    assert [step["stop"] for step in steps[:-1]] == [None] * (len(steps) - 1)
    assert steps[-1]["stop"] == "limit_near"
    percents = [step["percent"] for step in steps]
    assert percents[:2] == [0.0, 1.0]
    assert all(before < after <= 2.0 * before * (1.0 + 1e-9) for before, after in pairwise(percents[1:]))
    assert 0.55 * 4e-3 < largest(tmp_path / "run", "axis") < 0.875 * 4e-3  # near to the limit, within the guard


def test_what_the_next_step_does_lies_in_what_was_predicted(tmp_path):
    ls.rig.measure(axis(tmp_path), tmp_path / "run", escalate=1.0)
    steps = events(tmp_path / "run", "step")[1:]
    for before, after in pairwise(steps):
        for told, came in zip(before["rooms"], after["rooms"], strict=True):
            near, far = sorted(told["predicted"])
            assert near <= came["reached"] <= far


def test_it_stops_rising_where_the_accuracy_is_reached(tmp_path):
    ls.rig.measure(axis(tmp_path), tmp_path / "run", escalate=0.01, until=0.01)
    last = events(tmp_path / "run", "step")[-1]
    assert last["stop"] == "accurate"
    assert last["full_std"] <= 0.01
    assert last["percent"] < 100.0


def test_an_actuator_that_saturates_makes_a_step_invalid_and_the_recording_is_made_below(tmp_path):
    study = axis(tmp_path, more="force_limit_n = 4000.0")
    with pytest.warns(UserWarning, match="its data are invalid; an actuator saturates"):
        ls.rig.measure(study, tmp_path / "run", escalate=1.0)
    *before, last = events(tmp_path / "run", "step")
    assert last["stop"] == "clipped"
    assert not last["valid"]
    assert largest(tmp_path / "run", "axis", "force_n") < 4000.0 * 2.0
    made = largest(tmp_path / "run", "axis", "n_position_m") / 20e-3
    assert made == pytest.approx(before[-1]["percent"] / 100.0, rel=0.01)


def test_noise_at_rest_that_takes_a_command_is_refused_before_anything_is_excited(tmp_path):
    study = axis(tmp_path, force=2500.0)
    study.write_text(study.read_text().replace("position_noise_m = 2e-6", "position_noise_m = 1e-4"))
    with (
        pytest.warns(UserWarning, match="noise at rest alone"),
        pytest.raises(ls.errors.RigError, match="noise at rest alone"),
    ):
        ls.rig.measure(study, tmp_path / "run", escalate=1.0)
    assert [r.info.name for r in ls.read(tmp_path / "run").recordings] == ["axis-a0"]


def test_a_recording_ends_when_the_verdict_is_decided(tmp_path):
    R = ls.Requirements("position", sensitivity_peak_db=9.0, unstable_poles=0, integrators=1)
    study = axis(tmp_path, periods=40, amplitude=0.2)
    run = ls.rig.measure(study, tmp_path / "run", until=[R])
    (enough,) = events(tmp_path / "run", "enough")
    assert (enough["state"], enough["outcome"]) == ("decided", "passed")
    assert run.recording("axis").columns["t_s"].size < 41_000
    assert ls.check(ls.frf(run), run.loop("position").controller, R).passed


def test_a_target_climbs_and_ends_by_itself(tmp_path):
    text = study_text(
        experiment("one", period_s=0.5, periods=20, amplitude=0.19), angle="low_rad = -0.1, high_rad = 0.3",
        target=["watchdog_ms = 1000"],
    )  # fmt: skip
    study, out = write_study(tmp_path, text), tmp_path / "run"
    with Running(target, line=Pty()) as running:
        run = ls.rig.measure(study, out, port=running.port, arm=True, escalate=2.0, until=0.0001)
    assert events(out, "step")[-1]["stop"] in ("limit_near", "full_amplitude")
    angle = np.asarray(run.recording("one").columns["angle1_rad"])
    assert np.abs(angle - 0.1).max() < 0.2 * 0.875
    assert run.recording("one").info.ended_early is None


def test_a_controller_that_would_scream_at_rest_is_refused_before_it_is_armed(tmp_path):
    text = study_text(experiment("one"), drive="low_v = -3.0, high_v = 3.0")
    study = write_study(tmp_path, text)

    def noisy():
        made = target()
        made.machine.noise_rad = 0.05
        return made

    with Running(noisy, line=Pty()) as running:
        with pytest.raises(ls.errors.WrongUseError, match="drive1_v: noise of the sensors at rest alone"):
            ls.rig.measure(study, tmp_path / "run", port=running.port, arm=True)
        assert ls.rig.connect(running.port).state() == "idle"
    assert not (tmp_path / "run").exists()


def test_the_base_motion_goes_on_and_leaves_the_frequencies_alone(tmp_path):
    study = axis(tmp_path, amplitude=0.2)
    plain = ls.frf(ls.rig.measure(study, tmp_path / "plain", escalate=50.0))
    study.write_text(study.read_text() + "\n[escalate]\nstart_percent = 50.0\nbase_percent = 300.0\n")
    run = ls.rig.measure(study, tmp_path / "based", escalate=True)
    moved = run.recording("axis").columns["reference_m"]
    assert np.ptp(moved) == pytest.approx(2 * 3 * 0.2e-3, rel=1e-3)
    based = ls.frf(run)
    common = np.isin(plain.frequency_hz, based.frequency_hz) & plain.valid
    other = based.siso[np.isin(based.frequency_hz, plain.frequency_hz[common])]
    np.testing.assert_allclose(np.abs(other / plain.siso[common]), 1.0, atol=0.1)


def test_a_mean_outside_its_travel_window_ends_all(tmp_path):
    study = axis(tmp_path)
    study.write_text(study.read_text() + "\n[escalate.travel]\nposition = { low_mm = 1.0, high_mm = 2.0 }\n")
    with pytest.raises(ls.errors.RigError, match="left its travel window"):
        ls.rig.measure(study, tmp_path / "run", escalate=True)
    assert events(tmp_path / "run", "step")[-1]["stop"] == "drifted"


def test_a_sweep_and_a_loop_without_requirements_are_refused(tmp_path):
    study = axis(tmp_path)
    with pytest.raises(ls.errors.WrongUseError, match="no requirements of loop 'position'"):
        ls.rig.measure(study, tmp_path / "run", until=[ls.Requirements("other", phase_margin_deg=30.0)])
    text = study.read_text().replace("period_s = 1.0\nperiods = 20", "duration_s = 20.0").replace("multisine", "sweep")
    study.write_text(text)
    with pytest.raises(ls.errors.WrongUseError, match="a sweep comes to each frequency once"):
        ls.rig.measure(study, tmp_path / "run", until=0.02)
    assert not (tmp_path / "run").exists()


def test_the_emulated_arm_climbs_and_ends_by_itself(tmp_path):
    needs_a_compiler()
    text = (ROOT / "examples" / "rig" / "study.toml").read_text()
    text = text.replace("period_s = 10.0, periods = 6, ramp_s = 4.0", "period_s = 2.5, periods = 24, ramp_s = 1.0")
    text = text.replace("f_low_hz = 0.2, f_high_hz = 20.0", "f_low_hz = 0.4, f_high_hz = 4.0")
    text = text.replace(", { theta2_deg = 15.0, p_ab_bar = 1.0 }", "")
    study, out = write_study(tmp_path, text), tmp_path / "run"
    with ls.rig.emulator() as port:
        run = ls.rig.measure(study, out, port=port, arm=True, escalate=20.0, until=0.02)
    assert events(out, "step")[-1]["stop"] in ("accurate", "full_amplitude", "limit_near")
    (enough,) = events(out, "enough")
    assert enough["state"] == "accurate"
    rows = np.asarray(run.recording("angle").columns["t_s"]).size
    assert enough["elapsed_s"] * 1000.0 < rows < 60_000


def test_a_simulated_recording_ends_at_a_limit(tmp_path):
    one = ls.rig.measure(axis(tmp_path), tmp_path / "run").recording("axis")
    assert "position_m passed its limit" in one.info.ended_early
    x = np.abs(np.asarray(one.columns["position_m"]))
    assert x[-1] > 4e-3
    assert x[:-1].max() <= 4e-3


def test_a_climb_that_was_interrupted_begins_again_and_a_finished_one_is_left_alone(tmp_path):
    class Stop:
        def say(self, line):
            if "axis-a2" in line:
                raise KeyboardInterrupt

        def warn(self, lines): ...

        def progress(self, label, total):
            return nullcontext(lambda word: None)

    study, out = axis(tmp_path), tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        ls.rig.measure(study, out, escalate=1.0, watch=Stop())
    ls.rig.measure(study, out, escalate=1.0)
    assert [step["percent"] for step in events(out, "step")[:5]] == [0.0, 1.0, 2.0, 0.0, 1.0]
    written = (out / "axis.parquet").stat().st_mtime_ns
    ls.rig.measure(study, out, escalate=1.0)
    assert (out / "axis.parquet").stat().st_mtime_ns == written
