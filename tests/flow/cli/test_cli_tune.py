"""tune on the command line: warm start, other objectives, what to relax, and several loops, as files and JSON."""

import json

import numpy as np
import pytest
from bench_nouns import Block, TransferFunction
from commands import invoked
from run_files import write_frfs, write_matrices
from two_axes import matrix

import loopshape as ls

RATE = 500.0
REQUIRE = """
format = "loopshape-requirements/1"
[[loop]]
name = "axis"
phase_margin_deg = 40.0
sensitivity_peak_db = 6.0
integrators = 1
unstable_poles = 0
{more}
structure = [
  {{ kind = "gain", gain = {{ min = 0.001, max = 1.0 }} }},
  {{ kind = "lead_lag", f1_hz = {{ min = 0.5, max = 50.0 }}, f2_hz = {{ min = 5.0, max = 200.0 }} }},
]
"""
BLOCKS = (Block("gain", {"gain": 0.004}), Block("lead_lag", {"f1_hz": 2.0, "f2_hz": 40.0}))


def loopshape(*words, code=0):
    """Run a command; a refusal must be a sentence of the project's own."""
    done = invoked(words)
    if code == 2:
        assert isinstance(done.exception, ls.LoopshapeError) or done.exit_code == 2
        return str(done.exception)
    assert done.exit_code == code, done.output + repr(done.exception)
    return done.stdout


@pytest.fixture
def run(tmp_path):
    f = np.geomspace(0.5, 60.0, 150)
    for k, gain in enumerate((900.0, 1100.0)):
        P = TransferFunction([gain], [1.0, 6.0, 0.0], 0.004).response(f)
        spread = ((0.01 * np.abs(P)) ** 2)[:, None, None].astype(complex)
        mark = np.ones(f.size, dtype=bool)
        one = ls.FRF(f, P[:, None, None], spread, mark, ("z_v",), ("y_rad",), "made up", f"r{k + 1}", "axis", RATE)
        write_frfs(tmp_path / f"part{k}", [one])
    (tmp_path / "run" / "frf").mkdir(parents=True)
    for k in range(2):
        name = f"r{k + 1}.axis.npz"
        (tmp_path / f"part{k}" / "frf" / name).rename(tmp_path / "run" / "frf" / name)
    return tmp_path / "run"


def require(folder, more="", text=REQUIRE):
    path = folder.parent / "require.toml"
    path.write_text(text.format(more=more))
    return path


def start_file(folder, blocks=BLOCKS, loop="axis"):
    path = folder.parent / "start.toml"
    ls.write(ls.Controller(loop, blocks, RATE), path)
    return path


def test_a_warm_start_alone_improves_and_says_what_it_moved(run):
    out = run.parent / "made.toml"
    wide = (Block("gain", {"gain": 0.004}), Block("lead_lag", {"f1_hz": 2.0, "f2_hz": 240.0}))
    words = ("tune", run, "--require", require(run), "--start", start_file(run, wide), "--starts", 1, "--out", out)
    told = json.loads(loopshape(*words, "--json"))["loops"][0]
    assert told["outcome"] == "passed"
    assert told["moved"] == ["f2_hz of the lead_lag block is 240, outside its bounds; started from 200"]
    assert "start: f2_hz of the lead_lag block is 240" in loopshape(*words)
    assert ls.read_controllers(out)[0].blocks[0].parameters["gain"] > 0.004


def test_an_unstable_start_alone_that_leads_nowhere_says_to_try_others(run):
    """A gain of 1 makes the loop unstable: nothing near it is stable, and the search ends where it began."""
    away = (Block("gain", {"gain": 1.0}), Block("lead_lag", {"f1_hz": 50.0, "f2_hz": 5.0}))
    out = run.parent / "made.toml"
    words = ("tune", run, "--require", require(run), "--start", start_file(run, away), "--starts", 1, "--out", out)
    told = " ".join(loopshape(*words, code=1).split())
    assert "no stable controller was found from 1 start: try others beside it (--starts 16)" in told
    assert loopshape(*words[:-4], "--starts", 4, "--out", out, code=0)


def test_a_start_of_other_blocks_or_loops_is_refused(run):
    words = ("tune", run, "--require", require(run), "--out", run.parent / "made.toml", "--start")
    assert "does not fit the structure" in loopshape(*words, start_file(run, BLOCKS[:1]), code=2)
    assert "has no controller to start from" in loopshape(*words, start_file(run, loop="other"), code=2)


def test_the_objective_of_the_file_is_reported(run):
    more = 'objective = "disturbance"\ndisturbance_below_hz = 2.0'
    words = ("tune", run, "--require", require(run, more), "--out", run.parent / "made.toml", "--starts", 4)
    told = json.loads(loopshape(*words, "--json"))["loops"][0]
    assert told["rejection_db"] > 10.0
    assert f"low-frequency disturbances down by {told['rejection_db']:.3g} dB" in loopshape(*words)


def test_what_to_relax_is_told_and_nothing_written(run):
    out = run.parent / "made.toml"
    words = ("tune", run, "--require", require(run, "bandwidth_hz = 40.0"), "--out", out, "--starts", 4)
    told = json.loads(loopshape(*words, "--json", code=1))
    assert told["controller"] is None
    assert not out.exists()
    why = told["loops"][0]["shortfall"]
    assert why["certified"]
    relaxed = {one["quantity"]: one for one in why["relaxations"]}
    assert relaxed["bandwidth_hz"]["verified"]
    assert 0.0 < relaxed["bandwidth_hz"]["reachable"] < 40.0
    text = loopshape(*words, code=1)
    assert "One requirement relaxed, all others kept" in text
    assert "no small change helps" in text
    # and asking for what it said is met
    better = f"bandwidth_hz = {0.999 * relaxed['bandwidth_hz']['reachable']}"
    loopshape("tune", run, "--require", require(run, better), "--out", out, "--starts", 4)
    assert out.exists()


def test_loops_of_a_matrix_are_tuned_in_turn(tmp_path):
    write_matrices(tmp_path / "run", [matrix(0.6)])
    blocks = REQUIRE[REQUIRE.index("structure") :].format().replace("1.0 }", "1000.0 }").replace("0.001", "0.1")
    limits = "phase_margin_deg = 40.0\nsensitivity_peak_db = 6.0\ncontrol_peak_db = 60.0\nintegrators = 1\n"
    loops = "".join(f'[[loop]]\nname = "{name}"\n{limits}{blocks}\n' for name in "ab")
    path, out = tmp_path / "require.toml", tmp_path / "made.toml"
    path.write_text(f'format = "loopshape-requirements/1"\n{loops}[several]\nunstable_poles = 0\n')
    words = ("tune", tmp_path / "run", "--require", path, "--out", out, "--matrix", "--starts", 4)
    told = json.loads(loopshape(*words, "--json"))
    assert told["converged"]
    assert [one["loop"] for one in told["rounds"]][:4] == ["a", "b", "a", "b"]
    assert [one.loop for one in ls.read_controllers(out)] == ["a", "b"]
    printed = loopshape(*words, "--profile", "servo")
    assert "Loops in turn" in printed
    assert "Profile servo" in printed
    loopshape("check", tmp_path / "run", out, "--require", path, "--no-figures")
