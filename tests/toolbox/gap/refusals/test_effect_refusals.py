"""Each bad request for an effect, and the sentence that the user gets."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
from simulated_machines import ExperimentTemplate, ServoAxis, plan

import loopshape as ls
from loopshape.toolbox.gap.commands.effects import effects
from loopshape.toolbox.rig.effects import asked, catalogue, chosen, moves

POINT = {"theta2_deg": 0.0, "p_ab_bar": 1.0}


def study(**fields):
    hold = ExperimentTemplate("hold", "none", "reference", duration_s=0.5, parameters=fields.pop("own", {}))
    return ls.rig.Study("simulated", "arm-1dof", (hold,), (POINT,), **fields)


@pytest.mark.parametrize("word", ["friction", "", "Payload", "quadratic_drag"])
def test_an_unknown_effect_lists_the_known(arm, word):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"arm-1dof has no such effect; received .*; .*known are loop_delay, .*lash"
    ):
        asked(arm, [word])
    with pytest.raises(ls.errors.WrongUseError, match="arm-1dof has no such effect"):
        moves(arm, asked(arm, [f"{word}=1"]))


@pytest.mark.parametrize(
    ("key", "magnitude", "sentence"),
    [
        ("payload", 900.0, "the magnitude of payload lies between 0 and 500 g; received 900"),
        ("payload", -1.0, "the magnitude of payload lies between 0 and 500 g; received -1"),
        ("payload", float("nan"), "received nan"),
        (
            "gas_law",
            2.0,
            "the magnitude of gas_law lies between 0 and 1 (gas absolute share) or 1 and 1.6 (polytropic exponent)",
        ),
        ("gas_law:1", 1.2, "the magnitude of gas_law:1 lies between 0 and 1 (gas absolute share); received 1.2"),
        ("base_tilt", 40.0, "between -25 and 25 deg; received 40"),
    ],
)
def test_a_magnitude_out_of_bounds(arm, key, magnitude, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=re.escape(sentence)):
        chosen(arm, key, magnitude)


@pytest.mark.parametrize("word", ["payload=heavy", "payload=", "payload=20 g"])
def test_a_magnitude_that_is_no_number(arm, word):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"an effect is NAME=MAGNITUDE; received .*; give the magnitude as a number"
    ):
        asked(arm, [word])


@pytest.mark.parametrize("number", ["0", "9", "two", "01", ""])
def test_a_form_that_is_not_there(arm, number):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"gas_law has no such form; received .*; its forms are 1 share of the atm"
    ):
        chosen(arm, f"gas_law:{number}", 0.5)


def test_an_effect_twice(arm):
    with pytest.raises(ls.errors.WrongUseError, match="given twice"):
        asked(arm, ["payload=20", "payload=30"])
    with pytest.raises(ls.errors.WrongUseError, match="given twice; received joint_friction"):
        moves(arm, {"joint_friction": 0.1, "joint_friction:2": 0.1})


def test_two_effects_that_want_one_parameter(arm):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"loop_delay:2 and hose_lag:3 want different values of one parameter.*NAME:F"
    ):
        moves(arm, {"loop_delay:2": 3.0, "hose_lag:3": 2.0})


def test_an_effect_and_the_study_on_one_parameter(arm):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"the effect payload moves a parameter that the study changes too; .*payload_kg"
    ):
        plan(study(effects={"payload": 20.0}, changes={"payload_kg": 0.1}), arm)
    with pytest.raises(ls.errors.WrongUseError, match="moves a parameter that the study changes too"):
        plan(study(effects={"payload": 20.0}, own={"payload_kg": 0.1}), arm)


def test_a_solver_that_does_not_know_effects(arm):
    with pytest.raises(
        ls.errors.WrongUseError, match=r"the solver 'grid' does not know every effect.*use solver = .edges"
    ):
        plan(study(effects={"payload": 20.0}, solver="grid"), arm)


def test_a_point_where_the_changed_arm_cannot_stand(arm):
    there = ({"theta2_deg": -30.0, "p_ab_bar": 0.8},)
    plan(replace(study(), operating_points=there), arm)
    with pytest.raises(ls.errors.WrongUseError, match="the 1-DoF arm cannot stand there"):
        plan(replace(study(effects={"hose_stiffness": 15.0}), operating_points=there), arm)


def test_a_plant_without_effects():
    with pytest.raises(ls.errors.WrongUseError, match="the plant bench has no catalogue of effects"):
        catalogue(SimpleNamespace(name="bench"))


def test_an_effect_of_another_plant():
    with pytest.raises(
        ls.errors.WrongUseError, match="servo-axis has no such effect; received 'payload'; known are coulomb_friction"
    ):
        asked(ServoAxis(), ["payload"])


def test_a_page_of_another_plant_or_kind(tmp_path):
    with pytest.raises(
        ls.errors.WrongUseError, match="no page of effects is drawn of this plant; received 'servo-axis'"
    ):
        effects("servo-axis", tmp_path / "page.png")
    with pytest.raises(ls.errors.WrongUseError, match=r"a page of effects is a \.png file"):
        effects("arm-1dof", tmp_path / "page.jpeg")


def test_effects_in_a_study_are_numbers(tmp_path):
    text = (
        'format = "loopshape-study/1"\nrig = "simulated"\nplant = "arm-1dof"\noperating_points = [{ theta2_deg = 0.0, '
    )
    text += 'p_ab_bar = 1.0 }]\n[effects]\npayload = "heavy"\n[[experiment]]\nname = "hold"\nduration_s = 0.5\n'
    (tmp_path / "study.toml").write_text(text)
    with pytest.raises(
        ls.errors.WrongUseError, match=r"study.toml, effects: payload must be a finite number; received 'heavy'"
    ):
        ls.rig.measure(tmp_path / "study.toml", tmp_path / "run")


def test_a_run_is_not_gone_on_with_another_effect(tmp_path):
    text = (
        'format = "loopshape-study/1"\nrig = "simulated"\nplant = "arm-1dof"\noperating_points = [{ theta2_deg = 0.0, '
    )
    text += 'p_ab_bar = 1.0 }]\n[[experiment]]\nname = "hold"\nduration_s = 0.5\n'
    (tmp_path / "study.toml").write_text(text)
    ls.rig.measure(tmp_path / "study.toml", tmp_path / "run", effects=["payload=20"])
    with pytest.raises(ls.errors.WrongUseError, match="already holds another run; received different effects"):
        ls.rig.measure(tmp_path / "study.toml", tmp_path / "run", effects=["payload=30"])
