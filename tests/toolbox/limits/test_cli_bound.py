"""`bound` and `schedule` end to end on a small run: tables, JSON, figure."""

import json
from pathlib import Path

import pytest
from bench_nouns import TransferFunction
from bound_cases import frf_of, gain
from run_files import write_frfs

import loopshape as ls
from loopshape.cli.output import Output
from loopshape.toolbox.limits.command import bound_run
from loopshape.toolbox.schedules.command import schedule_run

REQUIRE = """
format = "loopshape-requirements/1"

[[loop]]
name = "one"
integrators = 1
unstable_poles = 0
sensitivity_peak_db = 6.0
phase_margin_deg = 45.0
structure = [{ kind = "gain", gain = { min = 0.1, max = 100.0 } }]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bound")
    plants = [frf_of(TransferFunction([k], [1.0, 0.0], 0.02), f"gain-{k:g}", lines=200) for k in (1.0, 3.0)]
    write_frfs(folder / "run", plants)
    (folder / "req.toml").write_text(REQUIRE)
    ls.write(gain(9.0), folder / "own.toml")
    return folder


@pytest.mark.long
def test_bound_says_how_far_and_by_what(folder, capsys):
    (found,) = bound_run(folder / "run", folder / "own.toml", folder / "req.toml", Output())
    said = capsys.readouterr()
    assert "no single controller for all 2 operating points exceeds" in said.out
    assert f"ratio {found.ratio:.2f}" in said.out
    assert "kept by the bound: sensitivity_peak_db" in said.out
    assert "left out (they only lower what is possible): phase_margin_deg" in said.out


@pytest.mark.long
def test_bound_as_json(folder, capsys):
    bound_run(folder / "run", folder / "own.toml", folder / "req.toml", Output(as_json=True))
    (loop,) = json.loads(capsys.readouterr().out)["loops"]
    assert {one["recording"] for one in loop["alone"]} == {"gain-1", "gain-3"}
    assert 0.0 < loop["ratio"] < 1.0
    assert loop["bandwidth_hz"] < loop["reached"]["bandwidth_hz"] <= min(one["bound_hz"] for one in loop["alone"])


@pytest.mark.long
def test_schedule_draws_and_reports(folder, capsys):
    schedule_run(folder / "run", folder / "req.toml", folder / "own.toml", Output(as_json=True), starts=2)
    told = json.loads(capsys.readouterr().out)
    (loop,) = told["loops"]
    assert [Path(name).name for name in told["figures"]] == ["schedule_one.png"]
    assert (folder / "run" / "figures" / "schedule_one.png").read_bytes().startswith(b"\x89PNG")
    weak, strong = loop["points"]
    assert weak["cost_hz"] > 0.5 * weak["own_hz"]
    assert strong["ratio"] > 0.5
    assert loop["own_hz"] == pytest.approx(min(weak["own_hz"], strong["own_hz"]))


def test_schedule_in_words(folder, capsys):
    schedule_run(folder / "run", folder / "req.toml", folder / "own.toml", Output(), starts=2, figures=False)
    said = capsys.readouterr().out
    assert "robustness costs" in said
    assert "no figures drawn" in said
