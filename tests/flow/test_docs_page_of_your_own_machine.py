"""The page `docs/machine.md` followed to the letter: its two files, its command, a machine with dry friction."""

import json
import re
from pathlib import Path

import numpy as np
import own_machine
import pytest
from small_gap_run import loopshape

import loopshape as ls
from loopshape.core.errors import LoopshapeError
from loopshape.io.machine import read_model
from loopshape.io.run_folder import write_run
from loopshape.model.own.mechanism import machine

PAGE = (Path(__file__).parents[2] / "docs/machine.md").read_text()
XML = re.search(r"```xml\n(.*?)```", PAGE, re.S).group(1)
RUN_WORDS, WORDS, XML_WORDS = re.findall(r"```toml\n(.*?)```", PAGE, re.S)[:3]
CODE = re.search(r"```python\n(.*?)```", PAGE, re.S).group(1)
FILES = re.findall(r'file = "(\w+)\.csv"', RUN_WORDS)
COMMAND = re.search(r"```console\nloopshape (.*?)\n```", PAGE, re.S).group(1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "winch.py").write_text(CODE)
    (tmp_path / "model.toml").write_text(WORDS)
    return tmp_path


def test_the_example_is_short():
    assert CODE.count("\n") + WORDS.count("\n") <= 40


@pytest.mark.long
def test_the_example_runs_and_names_the_friction(folder):
    write_run(folder / "runs/winch", own_machine.run_of(coulomb=0.03))
    assert loopshape(*COMMAND.split(), "--save-answer", "gap.json") == 0
    found = json.loads((folder / "gap.json").read_text())
    assert found["verdict"] == "coulomb_friction@bearing"
    assert found["where"]["place"] == "bearing"
    assert sum(r["probability"] for r in found["ranking"]) == pytest.approx(1.0)
    assert found["gap"]["shrink"] > 0.9
    assert (folder / "gap.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_as_the_page_shows_it_is_a_run(folder):
    run = folder / "runs/winch"
    run.mkdir(parents=True)
    with pytest.raises(LoopshapeError, match="received winch without one; write one"):
        ls.read(run)
    (run / "run.toml").write_text(RUN_WORDS)
    rng = np.random.default_rng(1)
    tables = {name: np.column_stack([np.arange(900) / 500.0, rng.normal(size=(900, 2))]) for name in FILES}
    for name, table in tables.items():
        np.savetxt(run / f"{name}.csv", table, delimiter=",", header="time_s,torque_nm,lever_rad", comments="")
    found = ls.read(run)
    assert found.rate_hz == 500.0
    assert [r.info.role for r in found.recordings] == ["estimation", "estimation", "validation"]
    assert np.array_equal(found.recordings[1].column("lever_rad"), tables["slow"][:, 2])


@pytest.fixture
def winch(folder):
    (folder / "winch.xml").write_text(XML)
    (folder / "model.toml").write_text(XML_WORDS)
    return folder


def test_the_mujoco_example_is_short():
    assert XML.count("\n") + XML_WORDS.count("\n") <= 40


@pytest.mark.long
def test_the_mujoco_example_runs_and_names_the_friction(winch):
    pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    write_run(winch / "runs/winch", own_machine.run_of(coulomb=0.03))
    assert loopshape(*COMMAND.split(), "--save-answer", "gap.json") == 0
    found = json.loads((winch / "gap.json").read_text())
    assert found["verdict"] == "coulomb_friction@bearing"
    assert found["ranking"][0]["magnitude"] == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("winch.xml", 'contype="0"', 'margin="1" contype="1"', "is a tree of hinges and slides; received"),
        ("winch.xml", "</body>", "</body><body><freejoint/><geom size='1'/></body>", "are hinges and slides"),
        ("winch.xml", "<motor", "<position", "actuator drum of model is a motor at a joint"),
        ("winch.xml", 'joint="bearing"/></sensor>', 'joint="gone"/></sensor>', "winch.xml does not compile in MuJoCo"),
        ("winch.xml", "jointpos", "jointactuatorfrc", "sensor encoder reads the position or the speed of a joint"),
        ("model.toml", "encoder =", "coder =", "sensor coder stands in model"),
        ("model.toml", "mass =", "weight =", "unknown key; received 'weight'"),
        ("model.toml", '"winch.xml"', '"../winch.xml"', "the MuJoCo model"),
        ("model.toml", "lever = 0.03", "hoist = 0.03", "tolerances name what the model has; received mass of 'hoist'"),
        ("model.toml", "drum =", "crab =", "actuators of model.toml stand in the model; received 'crab'"),
    ],
)
def test_a_mujoco_model_that_does_not_fit_is_refused_in_a_sentence(winch, file, old, new, words):
    pytest.importorskip("mujoco", reason="the extra `mujoco` is not installed")
    text = (winch / file).read_text()
    assert old in text
    if "contype" in old:
        text = text.replace("<body name", '<geom type="plane" size="9 9 1" pos="0 0 0.1"/><body name')
    (winch / file).write_text(text.replace(old, new))
    with pytest.raises(LoopshapeError, match=re.escape(words)):
        machine(read_model(winch / "model.toml"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('file = "winch.py"', 'file = "../winch.py"', "the Python file of a model"),
        ('file = "winch.py"', 'file = "none.py"', "none.py"),
        ('function = "motion"', 'function = "moves"', "winch.py has no function moves"),
        ('state = "angle"', 'state = "angel"', "the state of output encoder is not known; received 'angel'"),
        ('input = "drum"', 'input = "drumm"', "the input of port bearing is not known; received 'drumm'"),
        ('name = "load", value = 0.0', 'name = "load", vale = 0.0', "unknown key"),
        (", range = [0.0, 1.0]", "", "parameter load is 0, so nothing tells how far it may be off"),
        ("range = [0.0, 1.0]", "range = [1.0, 0.0]", "a range is two rising numbers"),
        ('column = "torque_nm"', 'column = "torque_nm", factor = 0', "a factor is not 0"),
        ("window_s = 0.8", "window_s = 0", "window_s"),
        ('format = "loopshape-model/1"\n', "", "loopshape-model/1"),
        ("tolerance = 0.10", "tolerance = 10.0", "the tolerance of damping is a share from 0 to 1"),
        ('["angle", "speed"]', "[]", "model.toml"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(folder, old, new, words):
    assert old in WORDS
    (folder / "model.toml").write_text(WORDS.replace(old, new))
    with pytest.raises(LoopshapeError, match=re.escape(words)):
        read_model(folder / "model.toml")


def test_python_that_does_not_run_is_refused_in_a_sentence(folder):
    (folder / "winch.py").write_text("import no_such_thing_at_all\n")
    with pytest.raises(LoopshapeError, match=r"winch.py does not run; received ModuleNotFoundError"):
        read_model(folder / "model.toml")


def test_a_run_never_loads_a_python_file_that_it_names_itself(folder):
    (folder / "winch.py").write_text("raise SystemExit('loaded')\n")
    write_run(folder / "run", ls.Run.from_arrays(u=np.ones(4000), y=np.ones(4000), rate_hz=500.0))
    text = (folder / "run/run.toml").read_text()
    (folder / "run/run.toml").write_text('plant = "winch"\n' + text + '\n[model]\nfile = "../model.toml"\n')
    assert loopshape("gap", folder / "run") == 2
