"""Predict, measure under the new controller, compare: the commands end to end on two operating points."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from plant_behind import plant_behind
from prediction_nouns import read_predictions
from typer.testing import CliRunner, Result

import loopshape as ls
from loopshape.cli.estimate.fit import fit_run
from loopshape.cli.output import Output
from loopshape.toolbox.rig.commands.measure import measure
from loopshape.toolbox.validation.command import compare
from loopshape.toolbox.validation.predicted.command import predict

app = typer.Typer()
for command in (measure, predict, compare):
    app.command()(command)
POINTS = "operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }, { theta2_deg = 0.0, p_ab_bar = 1.2 }]"
SWEEP = 'kind = "sweep", f_low_hz = 0.1, f_high_hz = 15.0, duration_s = 80.0, spacing = "logarithmic"'
PROFILE = 'kind = "profile", velocity_deg_s = 10.0, acceleration_deg_s2 = 40.0, jerk_deg_s3 = 400.0'
HEAD = f'format = "loopshape-study/1"\nrig = "simulated"\nplant = "arm-1dof"\n{POINTS}\n'
OLD = (
    HEAD
    + f"""
[[loop]]
name = "theta2"
controller = [{{ kind = "gain", gain = 0.5 }}]
[[experiment]]
name = "angle"
excites = "theta2"
injection = "controller_input"
excitation = {{ {SWEEP}, amplitude_rad = 0.1 }}
lead_s = 8.0
"""
)
NEW = (
    HEAD
    + f"""
[[experiment]]
name = "again"
excites = "theta2"
injection = "controller_input"
excitation = {{ {SWEEP}, amplitude_rad = 0.03 }}
lead_s = 8.0
[[experiment]]
name = "steps"
references = {{ theta2 = {{ kind = "staircase", times_s = [4.0, 8.0], values_deg = [3.0, 0.0] }} }}
duration_s = 12.0
[[experiment]]
name = "profile"
references = {{ theta2 = {{ {PROFILE}, times_s = [2.0], values_deg = [5.0] }} }}
duration_s = 6.0
"""
)
BLOCKS = """[
  { kind = "gain", gain = 11.0 }, { kind = "lead_lag", f1_hz = 2.2, f2_hz = 18.0 },
  { kind = "notch", f1_hz = 4.5, f2_hz = 4.5, damping1 = 0.05, damping2 = 5.0 },
  { kind = "low_pass", order = 2, f_hz = 19.0, damping = 0.55 } ]"""


def controller(path: Path, gain: float = 11.0) -> Path:
    blocks = BLOCKS.replace("gain = 11.0", f"gain = {gain}")
    path.write_text(
        f'format = "loopshape-controllers/1"\nrate_hz = 1000.0\n[[loop]]\nname = "theta2"\ncontroller = {blocks}\n'
    )
    return path


def run(*words: object) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("predict")
    (place / "old.toml").write_text(OLD)
    (place / "new.toml").write_text(NEW)
    own = controller(place / "controller.toml")
    assert run("measure", place / "old.toml", "--out", place / "old", "-q").exit_code == 0
    fit_run(place / "old", Output(quiet=True), structure="third_order")
    made = run("predict", place / "old", own, "--out", place / "prediction.npz", "--json")
    assert made.exit_code == 0, made.output
    measured = run("measure", place / "new.toml", "--controllers", own, "--out", place / "new", "-q")
    assert measured.exit_code == 0, measured.output
    return place


def test_a_prediction_is_written_whole_and_reads_back(folder: Path) -> None:
    first = read_predictions(folder / "prediction.npz")
    assert [one.recording for one in first] == ["angle-01", "angle-02"]
    assert all(one.stability == "stable" and one.step is not None for one in first)
    again = run("predict", folder / "old", folder / "controller.toml", "--out", folder / "again.npz", "--no-figures")
    assert again.exit_code == 0
    for one, two in zip(first, read_predictions(folder / "again.npz"), strict=True):
        assert np.array_equal(one.sensitivity.response, two.sensitivity.response)
        assert one.step is not None
        assert two.step is not None
        assert np.array_equal(one.step.low, two.step.low)
        assert one.step.indicators == two.step.indicators
        assert one.controller.blocks == two.controller.blocks
    assert (folder / "prediction_theta2.png").read_bytes().startswith(b"\x89PNG")


def test_the_run_was_made_under_the_controllers_of_the_file(folder: Path) -> None:
    loop = ls.read(folder / "new").loop("theta2")
    assert loop.controller is not None
    assert loop.controller.blocks[0].parameters["gain"] == 11.0
    assert len(loop.controller.blocks) == 4


def test_within_a_tolerance_the_predictions_hold_and_exit_code_is_0(folder: Path) -> None:
    done = run("compare", folder / "new", folder / "prediction.npz", "--tolerance-db", 1.5, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["outcome"] == "confirmed"
    assert len(found["predictions"]) == 2
    for one in found["predictions"]:
        assert [c["measured_from"][:5] for c in one["comparisons"]] == ["again"]
        assert [round(step["at_s"]) for step in one["steps"]] == [4, 8]
        assert all(step["measured"]["outcome"] == "settled" for step in one["steps"])
        assert all(abs(step["measured"]["overshoot"] - step["predicted"]["overshoot"]) < 0.15 for step in one["steps"])
        (profile,) = one["profiles"].values()
        assert profile["largest_error"] == pytest.approx(profile["predicted_largest_error"], rel=0.25)
    assert (folder / "new" / "figures" / "compare_theta2.png").exists()
    assert (folder / "new" / "figures" / "steps_theta2.png").exists()


def test_a_prediction_of_another_gain_did_not_hold_and_exit_code_is_1(folder: Path, tmp_path: Path) -> None:
    """The rig's gain fell by a third after the prediction was made: here, the prediction is of a larger plant."""
    from dataclasses import replace

    from prediction_nouns import write_predictions
    from run_files import read_frfs

    from loopshape.toolbox.validation.predicted.predict import predict as predict_loop

    made = read_predictions(folder / "prediction.npz")[0].controller
    larger = [replace(f, response=1.5 * f.response, covariance=2.25 * f.covariance) for f in read_frfs(folder / "old")]
    write_predictions(tmp_path / "p.npz", predict_loop(larger, made))
    done = run("compare", folder / "new", tmp_path / "p.npz", "--tolerance-db", 1.5, "--no-figures")
    assert done.exit_code == 1
    assert "refuted" in done.stdout


def test_a_run_under_another_controller_is_refused(folder: Path, tmp_path: Path) -> None:
    other = controller(tmp_path / "other.toml", gain=10.0)
    assert run("predict", folder / "old", other, "--out", tmp_path / "p.npz", "--no-figures").exit_code == 0
    done = run("compare", folder / "new", tmp_path / "p.npz")
    assert done.exit_code != 0
    assert "another controller" in str(done.exception)


def test_the_loop_that_ran_passes_a_check_of_its_recordings(folder: Path) -> None:
    """The plant behind the measured sensitivity, held against requirements: what ran, and not what was identified."""
    again = ls.read(folder / "new")
    found = ls.compare(again, read_predictions(folder / "prediction.npz"), tolerance_db=1.5)
    plants = [plant_behind(frf, again.loop("theta2").control) for one in found for frf in one.measured]
    required = ls.Requirements(
        "theta2", sensitivity_peak_db=9.0, phase_margin_deg=25.0, integrators=1, unstable_poles=0
    )
    verdict = ls.check(plants, found[0].prediction.controller, required)
    assert verdict.outcome == "passed", verdict
    tighter = ls.Requirements("theta2", sensitivity_peak_db=1.0, integrators=1, unstable_poles=0)
    assert ls.check(plants, found[0].prediction.controller, tighter).outcome == "failed"
