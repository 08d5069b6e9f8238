"""A command reads each file of words once, each column of a recording once, and builds each loop once."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Block
from run_files import write_frfs

import loopshape as ls
from loopshape.cli.estimate.figures import figures
from loopshape.cli.output import Output
from loopshape.cli.verify.check import check_run
from loopshape.io import config_table
from loopshape.io.run import tables
from loopshape.loop import loops
from loopshape.toolbox.rig.commands.measure import measure

STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }, { theta2_deg = 5.0, p_ab_bar = 1.0 }]
[[experiment]]
name = "a"
excites = "theta2"
excitation = { kind = "multisine", f_low_hz = 1.0, f_high_hz = 10.0, period_s = 2.0, periods = 3, amplitude_deg = 2.0 }
"""
REQUIREMENTS = """
format = "loopshape-requirements/1"
[[loop]]
name = "x"
modulus_margin = 0.4
unstable_poles = 0
"""


def counted(monkeypatch, module, name, key):
    """How often a function of a module is called, by what `key` makes of its arguments."""
    found, function = Counter(), getattr(module, name)

    def call(*arguments, **named):
        found[key(*arguments)] += 1
        return function(*arguments, **named)

    monkeypatch.setattr(module, name, call)
    return found


@pytest.fixture
def axis(tmp_path):
    """A run of one loop at two operating points, a controller and requirements."""
    f = np.geomspace(0.5, 200.0, 60)
    P = (20.0 / (2j * np.pi * f))[:, None, None]
    for name in ("one", "two"):
        frf = ls.FRF.from_arrays(f, P, relative_std=0.01, recording=name, loop="x", rate_hz=1000.0)
        write_frfs(tmp_path, [frf])
    ls.write(ls.Controller("x", (Block("gain", {"gain": 1.0}),), 1000.0), tmp_path / "c.toml")
    (tmp_path / "r.toml").write_text(REQUIREMENTS)
    return tmp_path


def test_measure_reads_its_study_its_run_and_each_column_once(tmp_path, monkeypatch):
    files = counted(monkeypatch, config_table, "read_toml", lambda path: Path(path).name)
    columns = counted(monkeypatch, tables, "_parquet_column", lambda path, name, group=None: (path.name, name, group))
    (tmp_path / "study.toml").write_text(STUDY)
    measure(tmp_path / "study.toml", tmp_path / "run", quiet=True)
    assert len(list((tmp_path / "run" / "frf").glob("*.npz"))) == 2
    assert files["study.toml"] == 1
    assert files["run.toml"] <= 1
    assert columns
    assert set(columns.values()) == {1}


@pytest.mark.long
def test_check_builds_each_loop_once_for_verdict_and_pictures(axis, monkeypatch):
    files = counted(monkeypatch, config_table, "read_toml", lambda path: Path(path).name)
    built = counted(monkeypatch, loops, "smoothed", lambda frf, band: frf.recording)
    passed, drawn = check_run(axis, axis / "c.toml", axis / "r.toml", Output(quiet=True))
    assert passed
    assert len(drawn) > 4
    assert built == {"one": 1, "two": 1}
    assert set(files.values()) == {1}


@pytest.mark.long
def test_figures_build_each_loop_once(axis, monkeypatch):
    built = counted(monkeypatch, loops, "smoothed", lambda frf, band: frf.recording)
    figures(axis, controller=axis / "c.toml", quiet=True)
    assert built == {"one": 1, "two": 1}
