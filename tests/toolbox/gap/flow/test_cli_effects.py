"""Effects by command and by study: simulate, measure, list, draw; what the run says of them, and to whom."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commands import invoked

import loopshape as ls
from loopshape.toolbox.gap.commands.effects import catalogue_rows, markdown_table
from loopshape.toolbox.rig import registry

DOCS = (Path(__file__).parents[4] / "docs" / "effects.md").read_text()
STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
seed = 3
operating_points = [{ theta2_deg = 10.0, p_ab_bar = 1.0 }]

[[experiment]]
name = "step"
duration_s = 2.0
references = { theta2 = { kind = "staircase", times_s = [0.5], values_deg = [14.0] } }
"""


def loopshape(*words: object) -> str:
    """Run a command in this process; gives what it printed."""
    done = invoked(words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture
def simulate(tmp_path: Path):
    """Simulate the study with words added to it and options; gives the run."""

    def run(*options: str, words: str = "", name: str = "run"):
        (tmp_path / "study.toml").write_text(STUDY + words)
        loopshape("simulate", tmp_path / "study.toml", "--out", tmp_path / name, "--quiet", *options)
        return ls.read(tmp_path / name)

    return run


def angle(run) -> np.ndarray:
    return run.recordings[0].column("theta2_rad")


def test_an_effect_changes_the_arm_and_stands_in_the_run_apart_from_its_settings(simulate, tmp_path):
    nominal, changed = simulate(name="nominal"), simulate("--effect", "payload=60")
    assert np.abs(angle(nominal) - angle(changed)).max() > np.radians(0.3)
    table = tomllib.loads((tmp_path / "run" / "run.toml").read_text())
    assert table["effects"] == {"payload": 60.0}
    assert "parameters" not in table
    assert "effects" not in tomllib.loads((tmp_path / "nominal" / "run.toml").read_text())


def test_the_diagnosis_is_not_told(simulate):
    run = simulate("--effect", "payload=60", words="\n[parameters]\nsupply_bar = 1.05\n")
    prepared = registry.diagnosable("arm-1dof").prepare(run.recordings[0], run, None)
    assert prepared.parameters == {"supply_bar": 1.05}


def test_a_study_s_own_effects_do_the_same(simulate):
    by_option = simulate("--effect", "payload=60", "--effect", "joint_friction:2=0.1", name="option")
    by_study = simulate(words='\n[effects]\npayload = 60.0\n"joint_friction:2" = 0.1\n', name="study")
    np.testing.assert_array_equal(angle(by_option), angle(by_study))
    assert by_option.extra["effects"] == by_study.extra["effects"] == {"payload": 60.0, "joint_friction:2": 0.1}


def test_an_option_stands_in_for_the_study_s_own(simulate):
    own = "\n[effects]\npayload = 60.0\nleak = 0.2\n"
    assert simulate("--effect", "payload=20", words=own).extra["effects"] == {"leak": 0.2, "payload": 20.0}


def test_a_name_alone_is_the_middle_of_the_usual_range(simulate):
    assert simulate("--effect", "payload").extra["effects"] == {"payload": 55.0}


def test_a_magnitude_picks_the_first_form_that_can_have_it(simulate):
    """gas_law above 1 is the polytropic exponent with all of the atmosphere."""
    np.testing.assert_array_equal(
        angle(simulate("--effect", "gas_law=1.3", name="one")), angle(simulate("--effect", "gas_law:2=1.3", name="two"))
    )


def test_measure_records_an_arm_with_an_effect(tmp_path):
    excited = """
[[experiment]]
name = "angle"
excites = "theta2"
injection = "plant_input"
excitation = { kind = "multisine", f_low_hz = 0.5, f_high_hz = 12.0, period_s = 4.0, periods = 3, amplitude_v = 0.3 }

[effects]
stiffness_error = 0.25
"""
    (tmp_path / "study.toml").write_text(STUDY.split("[[experiment]]")[0] + excited)
    loopshape("measure", tmp_path / "study.toml", "--out", tmp_path / "run", "--quiet")
    assert ls.read(tmp_path / "run").extra["effects"] == {"stiffness_error": 0.25}
    assert list((tmp_path / "run" / "frf").glob("*.npz"))


@pytest.mark.parametrize("plant", ["arm-1dof", "servo-axis"])
def test_the_page_of_the_catalogue_is_the_catalogue(plant):
    """Else: print the table with `loopshape effects PLANT --markdown` and put it into docs/effects.md."""
    table = markdown_table(catalogue_rows(registry.diagnosable(plant).effects))
    assert f"<!-- {plant} -->\n{table}\n<!-- end -->" in DOCS
    assert loopshape("effects", plant, "--markdown").strip() == table


def test_the_list_as_json_holds_every_form():
    forms = json.loads(loopshape("effects", "--json"))["forms"]
    effects = registry.diagnosable("arm-1dof").effects
    assert [(f["effect"], f["words"]) for f in forms] == [(e.effect, e.form) for e in effects]
    assert len({f["effect"] for f in forms}) == 21


def test_the_list_for_people():
    printed = loopshape("effects")
    assert "Effects of arm-1dof" in printed
    assert "point mass 0.34 m from the joint" in printed


@pytest.mark.long
def test_a_figure_of_one_effect(tmp_path):
    printed = loopshape("effects", "--figure", tmp_path / "page.png", "--effect", "gas_law=0.9")
    assert str(tmp_path / "page.png") in printed
    assert (tmp_path / "page.png").read_bytes().startswith(b"\x89PNG")
