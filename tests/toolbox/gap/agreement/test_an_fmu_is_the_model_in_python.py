"""An FMU, compiled here from C, is the same equations in Python; what does not fit is refused."""

import os
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import own_machine
import pytest
import winch_fmu
from bench_nouns import RecordingInfo

import loopshape as ls
from loopshape.io.files import part_of
from loopshape.toolbox.gap.mechanism.mockup import machine_of
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.file import read_model
from loopshape.toolbox.gap.own.following import explained
from loopshape.toolbox.gap.own.plant import OwnMachine

PAGE = (Path(__file__).parents[4] / "docs/machine.md").read_text()
WORDS = next(t for t in re.findall(r"```toml\n(.*?)```", PAGE, re.S) if "fmu =" in t)
MOVES = ({}, {"change.load": 0.2, "damping": 0.06}, {"port.bearing.coulomb": 0.03, "port.bearing.coulomb_speed": 0.01})


def machine(folder, version):
    """The machine of the docs page with the FMU built here."""
    winch_fmu.built(folder, version)
    (folder / "model.toml").write_text(WORDS)
    return machine_of(read_model(folder / "model.toml"))


def recording():
    """Two seconds of a moving lever: any will do, since both follow the same."""
    t = np.arange(1000) / 500.0
    torque, lever = 0.4 * np.sin(5 * t) + 0.1 * np.sin(31 * t), 0.3 * np.sin(5 * t - 0.4)
    return ls.Recording(
        RecordingInfo("r.parquet", "noise", "reference"), 500.0, {"torque_nm": torque, "lever_rad": lever}
    )


def test_the_example_of_the_page_is_short():
    assert WORDS.count("\n") <= 40


@pytest.mark.short
@pytest.mark.parametrize("version", [2, 3])
def test_derivatives_are_those_of_the_equations_at_any_state_and_parameters(tmp_path, version):
    mine, theirs = Composed(machine(tmp_path, version)), Composed(own_machine.MODEL)
    assert mine.is_compiled
    rng = np.random.default_rng(version)
    for _ in range(20):
        x, u, moves = rng.normal(size=2), rng.normal(size=1), {"change.load": rng.uniform(0.0, 1.0)}
        found, expected = (c.motion(0.0, x, u, c.values(moves)) for c in (mine, theirs))
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_what_a_killed_process_unpacked_is_removed_by_the_next(tmp_path, monkeypatch):
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    mine = part_of(place / "loopshape-fmu").name
    left = place / mine.replace(f"-{os.getpid()}-", f"-{ended.pid}-")
    (left / "binaries").mkdir(parents=True)
    target = Path(machine(tmp_path, 2).derived.__self__.unit.folder)
    assert target.parent == place
    assert list(place.iterdir()) == [target]


@pytest.mark.long
def test_both_follow_alike_with_effects_around_them_and_on_several_threads(tmp_path):
    plants = OwnMachine(machine(tmp_path, 2)), OwnMachine(own_machine.MODEL)
    r = recording()
    run = ls.Run(500.0, (), (r,))
    f, expected = (p.prepare(r, run, None) for p in plants)
    np.testing.assert_allclose(f.start, expected.start)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda m: explained(plants[0].composed, f, m), MOVES * 8))
    for mine, m in zip(found, MOVES * 8, strict=True):
        np.testing.assert_allclose(mine, explained(plants[1].composed, expected, m), atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "spring"', 'name = "sprung"', "a key is missing"),
        ('name = "spring",', 'name = "sprung", value = 1.0,', "parameters of model are the FMU's; received 'sprung'"),
        ('name = "drum",', 'name = "dram",', "inputs of model are the FMU's; received 'dram'; it has drum"),
        ('state = "angle"', 'state = "angel"', "the state of output encoder is not known; received 'angel'"),
        ('"winch.fmu"', '"model.toml"', "model.toml is no FMU"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_sentence(tmp_path, old, new, words):
    winch_fmu.built(tmp_path, 2)
    assert old in WORDS
    (tmp_path / "model.toml").write_text(WORDS.replace(old, new))
    with pytest.raises(ls.LoopshapeError, match=re.escape(words)):
        machine_of(read_model(tmp_path / "model.toml"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('numberOfEventIndicators="0"', 'numberOfEventIndicators="2"', "has no events"),
        ("<ModelExchange ", "<CoSimulation ", "gives derivatives (model exchange); received co-simulation alone"),
        ('<ModelExchange modelIdentifier="winch"', '<ModelExchange modelIdentifier="crane"', "runs on this system"),
    ],
)
def test_an_fmu_that_cannot_be_followed_is_refused_in_a_sentence(tmp_path, monkeypatch, old, new, words):
    text = winch_fmu.description(2)
    assert old in text
    monkeypatch.setattr(winch_fmu, "description", lambda version: text.replace(old, new))
    winch_fmu.built(tmp_path, 2)
    (tmp_path / "model.toml").write_text(WORDS)
    with pytest.raises(ls.LoopshapeError, match=re.escape(words)):
        machine_of(read_model(tmp_path / "model.toml"))
