"""`loopshape interaction` on a folder with matrix FRFs: table, JSON, figures, exit codes, refusals."""

import json

import numpy as np
import pytest
from bench_nouns import Block
from commands import invoked
from interaction_nouns import F, coupled_by, matrix_frf
from run_files import write_controllers, write_frfs, write_matrices

import loopshape as ls

K_DB = np.where((F > 2.95) & (F < 3.25), -8.0, -40.0)


def loopshape(*words, code=0):
    """Run a command; a refusal must be a sentence of the project's own."""
    done = invoked(["interaction", *map(str, words)])
    if code == 2:
        assert isinstance(done.exception, ls.LoopshapeError)
        return str(done.exception)
    assert done.exit_code == code, done.output + repr(done.exception)
    return done.stdout


@pytest.fixture
def run(tmp_path):
    one = matrix_frf(coupled_by(K_DB), error=0.03, seed=1, multiple_coherence=np.full((F.size, 2), 0.9), averages=20.0)
    single = matrix_frf(coupled_by(K_DB)[:, :1, :1], error=0.03, loop="theta1")
    write_frfs(tmp_path / "run", [single])
    write_matrices(tmp_path / "run", [one])
    return tmp_path / "run"


def test_a_table_a_band_and_sentences(run):
    said = loopshape(run)
    assert "verdict" in said
    assert said.count("theta1, theta2") == 7
    assert "theta1 and theta2, 2 to 4 Hz: coupled, |k_I| is above -20 dB at 3 of 21 lines" in said
    names = sorted(p.name for p in (run / "figures").glob("*.png"))
    assert names == ["interaction_r1+r2.theta1+theta2.png", "matrix_r1+r2.theta1+theta2.png"]


def test_json_bands_limits_and_controllers(run, tmp_path):
    blocks = (Block("gain", {"gain": 2.0}),)
    write_controllers(tmp_path / "c.toml", [ls.Controller(name, blocks, 1000.0) for name in ("theta1", "theta2")])
    words = ("--bands", "0.5-2,2-4", "--limit-db", "-30", "--controller", tmp_path / "c.toml", "--no-figures")
    said = json.loads(loopshape(run, "--json", *words))
    assert not said["decoupled"]
    assert said["figures"] == []
    assert not (run / "figures").exists()
    one = said["interactions"][0]
    assert [(b["from_hz"], b["to_hz"], b["verdict"]) for b in one["bands"]] == [
        (0.5, 2.0, "decoupled"),
        (2.0, 4.0, "coupled"),
    ]
    assert one["bands"][1]["low_db"] < one["bands"][1]["estimate_db"] < one["bands"][1]["high_db"]
    assert one["loops"] == ["theta1", "theta2"]
    assert one["limit_db"] == -30.0
    assert [c["loop"] for c in one["closing_the_others"]] == ["theta1", "theta2"]
    assert one["closing_the_others"][0]["largest_change_db"] > 0.1


def test_coupling_fails_only_where_that_is_required(run):
    assert loopshape(run, "--quiet", "--no-figures") == ""
    loopshape(run, "--quiet", "--no-figures", "--require-decoupled", code=1)
    loopshape(run, "--quiet", "--no-figures", "--require-decoupled", "--bands", "0.5-2")
    loopshape(run, "--quiet", "--no-figures", "--require-decoupled", "--limit-db", "-5")


def test_loops_are_chosen_in_their_order(run):
    said = json.loads(loopshape(run, "--loops", "theta2,theta1", "--json"))
    assert said["interactions"][0]["loops"] == ["theta2", "theta1"]
    assert [name.rsplit("/", 1)[1] for name in said["figures"]] == [
        "matrix_r1+r2.theta2+theta1.png",
        "interaction_r1+r2.theta2+theta1.png",
    ]


def test_an_imported_matrix_lies_among_the_frfs(tmp_path):
    write_frfs(tmp_path / "run", [matrix_frf(coupled_by(-40.0), error=0.03, seed=1)])
    assert json.loads(loopshape(tmp_path / "run", "--json", "--require-decoupled"))["decoupled"]


def test_refusals_name_the_way_out(run, tmp_path):
    assert "it has theta1, theta2" in loopshape(run, "--loops", "theta1,nose", code=2)
    assert "write bands as 0.5-1,1-4" in loopshape(run, "--bands", "low", code=2)
    write_frfs(tmp_path / "single", [matrix_frf(coupled_by(K_DB)[:, :1, :1], loop="theta1")])
    assert "loopshape frf RUN --matrix" in loopshape(tmp_path / "single", code=2)
    assert "does not exist" in loopshape(tmp_path / "nothing", code=2)
