"""Runs that a diagnosis cannot use, or not wholly: what it says instead, and what to record."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from simulated_machines import FORMS, Arm1, ExperimentTemplate, header, measure
from study_signals import Multisine

import loopshape as ls
from loopshape.cli.main import run as command

POINT = {"theta2_deg": 0.0, "p_ab_bar": 1.0}


def loopshape(*words: object) -> int:
    """The command in this process, with a catalogue of two effects; gives its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["loopshape", *map(str, words)])
        patch.setattr(Arm1, "effects", tuple(f for f in FORMS if f.effect in ("payload", "base_tilt")))
        with pytest.raises(SystemExit) as ended:
            command()
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def good() -> ls.Run:
    """Two recordings at one point, both for estimation."""
    templates = tuple(
        ExperimentTemplate(
            f"r0{k}", "multisine", "controller_input", "theta2", Multisine(0.5, 6.0, 4.0, 0.4, 1, k, crest_iterations=5)
        )
        for k in (1, 2)
    )
    study = ls.rig.Study("simulated", "arm-1dof", templates, (POINT,), seed=4)
    effect = replace(study, changes={"payload_kg": 0.06})
    return replace(header(study, Arm1()), recordings=tuple(measure(effect, Arm1(), threads=1)))


def changed(recording: ls.Recording, name: str, **columns: np.ndarray | None) -> ls.Recording:
    """The recording under another name, columns replaced, or left out where None."""
    kept = {k: v for k, v in (dict(recording.columns) | columns).items() if v is not None}
    return ls.Recording(replace(recording.info, file=f"{name}.parquet"), recording.rate_hz, kept)


def short(recording: ls.Recording, name: str, seconds: float) -> ls.Recording:
    n = round(seconds * recording.rate_hz)
    cut = {k: v[:n] for k, v in recording.columns.items()}
    return ls.Recording(replace(recording.info, file=f"{name}.parquet"), recording.rate_hz, cut)


def blind(recording: ls.Recording, name: str) -> ls.Recording:
    return changed(recording, name, p_b_bar=None)


def stuck(recording: ls.Recording, name: str) -> ls.Recording:
    """The angle's sensor is at its end for a third of the time."""
    angle = np.array(recording.column("theta2_rad"))
    return changed(recording, name, theta2_rad=np.minimum(angle, np.quantile(angle, 0.66)))


def refused(run: ls.Run, folder, capsys) -> str:
    """What the command says of a run that it cannot use: one sentence, exit code 2, no file."""
    ls.write(run, folder / "run")
    return refused_folder(folder, capsys)


def refused_folder(folder, capsys) -> str:
    assert loopshape("gap", folder / "run", "--save-answer", folder / "gap.json", "--report", folder / "gap.png") == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert not (folder / "gap.json").exists()
    assert not (folder / "gap.png").exists()
    assert said[-1].startswith("loopshape: ")
    assert "Traceback" not in said[-1]
    return said[-1]


def test_a_run_without_pressures(good, tmp_path, capsys) -> None:
    loops = tuple(loop for loop in good.loops if loop.name == "theta2")
    bare = [changed(r, r.info.name, p_a_bar=None, p_b_bar=None) for r in good.recordings]
    said = refused(replace(good, loops=loops, recordings=tuple(bare)), tmp_path, capsys)
    assert "no recording of this run can be followed on arm-1dof" in said
    assert "r01.parquet has no p_a_bar, p_b_bar" in said
    assert "record the columns theta2_rad, p_a_bar, p_b_bar, u_a_v, u_b_v" in said


def test_a_run_of_validation_recordings_alone(good, tmp_path, capsys) -> None:
    held = [replace(r, info=replace(r.info, role="validation")) for r in good.recordings]
    said = refused(replace(good, recordings=tuple(held)), tmp_path, capsys)
    assert "the run has none of role estimation" in said


def test_recordings_that_are_all_too_short(good, tmp_path, capsys) -> None:
    cut = tuple(short(r, r.info.name, 1.5) for r in good.recordings)
    said = refused(replace(good, recordings=cut), tmp_path, capsys)
    assert "r01.parquet lasts 1.5 s: too short" in said
    assert "record at least 3 s" in said


def test_recordings_that_are_all_saturated(good, tmp_path, capsys) -> None:
    said = refused(replace(good, recordings=tuple(stuck(r, r.info.name) for r in good.recordings)), tmp_path, capsys)
    assert "theta2_rad rests at its end in" in said
    assert "saturated" in said


def test_an_unknown_plant(good, tmp_path, capsys) -> None:
    said = refused(replace(good, plant="crane"), tmp_path, capsys)
    assert "a plant is not known; received 'crane'; use one of arm-1dof, arm-2dof, arm-2dof-pairs, servo-axis" in said


def test_another_plant(good, tmp_path, capsys) -> None:
    said = refused(replace(good, plant="servo-axis"), tmp_path, capsys)
    assert "servo-axis" in said
    assert "force_n" in said


def test_no_plant(good, tmp_path, capsys) -> None:
    said = refused(replace(good, plant=None), tmp_path, capsys)
    assert "names no plant, so there is no model to compare with" in said
    assert "loopshape gap RUN_REAL RUN_SIM" in said


def test_a_damaged_table(good, tmp_path, capsys) -> None:
    ls.write(good, tmp_path / "run")
    file = tmp_path / "run" / "r02.parquet"
    file.write_bytes(file.read_bytes()[:2000])
    assert "r02.parquet cannot be read" in refused_folder(tmp_path, capsys)


def test_a_damaged_description(good, tmp_path, capsys) -> None:
    ls.write(good, tmp_path / "run")
    toml = tmp_path / "run" / "run.toml"
    toml.write_text(toml.read_text().replace("rate_hz", "rate_hz ="))
    assert "run.toml cannot be read as TOML" in refused_folder(tmp_path, capsys)


def test_a_hole_in_a_column(good, tmp_path, capsys) -> None:
    angle = np.array(good.recordings[0].column("theta2_rad"))
    angle[700:710] = np.nan
    said = refused(replace(good, recordings=(changed(good.recordings[0], "r01", theta2_rad=angle),)), tmp_path, capsys)
    assert "column theta2_rad of recording r01.parquet holds 10 values that are not numbers" in said


def test_no_run_at_all(tmp_path, capsys) -> None:
    assert "run.toml" in refused_folder(tmp_path, capsys)


def test_what_is_left_is_diagnosed_and_what_it_cannot_tell_is_said(good, tmp_path, capsys) -> None:
    one, two = good.recordings
    bad = (short(one, "r04", 1.5), stuck(one, "r05"))
    ls.write(replace(good, recordings=(one, two, *bad)), tmp_path / "run")
    assert (
        loopshape("gap", tmp_path / "run", "--save-answer", tmp_path / "gap.json", "--report", tmp_path / "gap.png")
        == 0
    )
    found, warned = json.loads((tmp_path / "gap.json").read_text()), capsys.readouterr().err
    for words in (
        "no validation recording: how far the gap shrinks is not known; hold a sweep and a staircase out",
        "one operating point: effects that differ only by theta2_deg or p_ab_bar stay together",
        "r04.parquet lasts 1.5 s: too short, left out; record at least 3 s",
        "r05.parquet: theta2_rad rests at its end in",
    ):
        assert any(words in note for note in found["notes"])
        assert words in warned
    assert found["gap"] is None
    assert {row["recording"] for row in found["submodels"]} == {"r01", "r02"}
    assert found["ranking"][0]["effect"] == found["verdict"] == "payload"
    assert (tmp_path / "gap.png").read_bytes().startswith(b"\x89PNG")


def test_a_recording_without_a_pressure_among_good_ones_is_left_out(good, tmp_path) -> None:
    ls.write(replace(good, recordings=(*good.recordings, blind(good.recordings[0], "r03"))), tmp_path / "run")
    assert loopshape("gap", tmp_path / "run", "--save-answer", tmp_path / "gap.json", "--quick", "--quiet") == 0
    notes = json.loads((tmp_path / "gap.json").read_text())["notes"]
    assert "r03.parquet has no p_b_bar: it is left out; record them" in notes


def test_one_recording_alone_is_diagnosed_with_a_note(good, tmp_path) -> None:
    ls.write(replace(good, recordings=good.recordings[:1]), tmp_path / "run")
    assert loopshape("gap", tmp_path / "run", "--save-answer", tmp_path / "gap.json", "--quick", "--quiet") == 0
    found = json.loads((tmp_path / "gap.json").read_text())
    assert any(
        "one estimation recording: intervals by leaving recordings out do not exist" in n for n in found["notes"]
    )
    assert sum(row["probability"] for row in found["ranking"]) == pytest.approx(1.0)


def notes_of(run: ls.Run, folder) -> list[str]:
    """What the command notes of a run that it can use in part; exit code 0."""
    ls.write(run, folder / "run")
    assert loopshape("gap", folder / "run", "--save-answer", folder / "gap.json", "--quiet") == 0
    return json.loads((folder / "gap.json").read_text())["notes"]


def test_a_dead_sensor_leaves_its_recording_out(good, tmp_path) -> None:
    dead = changed(good.recordings[0], "r03", p_b_bar=np.full(len(good.recordings[0].columns["t_s"]), 0.5))
    notes = notes_of(replace(good, recordings=(*good.recordings, dead)), tmp_path)
    assert any("r03.parquet: p_b_bar never moves" in note for note in notes)


def test_numbers_that_are_none_leave_their_recording_out(good, tmp_path) -> None:
    torn = np.array(good.recordings[0].column("p_a_bar"))
    torn[1000] = np.nan
    usable = replace(good, recordings=(*good.recordings, changed(good.recordings[0], "r03", p_a_bar=torn)))
    from loopshape.toolbox.gap.recordings.suitable import (
        suitable,  # a run folder with such a table is refused when it is read
    )

    notes, kept = suitable(Arm1(), usable)
    assert [r.info.name for r in kept] == ["r01", "r02"]
    assert any("r03.parquet" in note for note in notes)


def test_without_an_operating_point_there_is_an_answer_and_no_table(good, tmp_path) -> None:
    nowhere = tuple(replace(r, info=replace(r.info, operating_point={})) for r in good.recordings)
    notes = notes_of(replace(good, recordings=nowhere), tmp_path)
    assert any("no closed-loop table" in note and "operating point" in note for note in notes)


def test_the_pwm_of_the_plant_holds_where_the_run_names_none(good, tmp_path) -> None:
    assert not any("PWM" in note for note in notes_of(replace(good, pwm={}), tmp_path))
    assert json.loads((tmp_path / "gap.json").read_text())["verdict"] == "payload"


def test_settings_that_a_run_states_are_no_gap(good) -> None:
    """A heavier body that the run states is the nominal one: the spread goes about it, not about the table's."""
    from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis

    stated = replace(good, extra=dict(good.extra) | {"parameters": {"m2_kg": 1.0}})
    plant, _, _ = Arm1().readied(stated, ["r01"])
    phi = np.zeros(len(plant.spread))
    assert Hypothesis(plant).moves(phi)["m2_kg"] == 1.0
    phi[[s.name for s in plant.spread].index("mass")] = 1.0
    assert Hypothesis(plant).moves(phi)["m2_kg"] == pytest.approx(1.01)
