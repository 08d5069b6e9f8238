"""Learning by commands on the simulated arm: identify, filters, trials of a third-order move, as the docs have it."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import loopshape
from simulated_machines import Arm1, plan, read_study

import loopshape as ls
from loopshape.toolbox.learning.files import read_learning

PAGE = (Path(__file__).parents[3] / "docs" / "feedforward.md").read_text()
IDENTIFY, MOVE = (part.split("```")[0] for part in PAGE.split("```toml\n")[1:3])
CONTROLLER = """
format = "loopshape-controllers/1"
rate_hz = 1000.0
[[loop]]
name = "theta2"
controller = [{ kind = "gain", gain = 0.5 }]
"""


def ran(*words: object, code: int = 0) -> dict:
    done = loopshape(*words, "--json")
    assert done.returncode == code, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The filters of the arm's angle, from the study of the page."""
    place = tmp_path_factory.mktemp("learning")
    (place / "identify.toml").write_text(IDENTIFY)
    (place / "controller.toml").write_text(CONTROLLER)
    ran("measure", place / "identify.toml", "--out", place / "run")
    words = ("--band-hz", 0.05, 5, "--integrators", 1, "--out", place / "learning.json")
    assert ran("learning", place / "run", place / "controller.toml", *words)["converges"] == "passed"
    return place


def trial(folder: Path, k: int) -> dict:
    """Measure the move as the page's study says, from the second trial on with what the last one taught."""
    helped = MOVE if k else MOVE.replace("feedforward =", "# feedforward =")
    (folder / "move.toml").write_text(helped)
    ran("measure", folder / "move.toml", "--out", folder / f"move{k}")
    return ran("next-trial", folder / f"move{k}", folder / "learning.json", "--out", folder / "next.csv")


@pytest.mark.long
def test_the_simulated_arm_learns_a_move_by_files(folder: Path) -> None:
    """Three trials: the error falls to a tenth, then to a fiftieth; what each let expect is right within a factor of
    two, for the arm is not linear."""
    told = [trial(folder, k) for k in range(3)]
    rms = [one["error_rms"] for one in told]
    assert rms[1] < 0.15 * rms[0]
    assert rms[2] < 0.03 * rms[0]
    assert all(0.5 < rms[k + 1] / told[k]["expected_rms"] < 2.0 for k in range(2))
    played = ls.read(folder / "move1").recordings[0]
    assert played.info.injection == "plant_input"
    u = np.loadtxt(folder / "next.csv", delimiter=",", skiprows=1)
    assert u.shape == (14_000, 2)
    assert played.column("n_theta2_v").std() > 0.01


@pytest.mark.long
def test_a_changed_feedforward_is_another_run(folder: Path) -> None:
    trial(folder, 0)
    (folder / "move.toml").write_text(MOVE)
    ran("measure", folder / "move.toml", "--out", folder / "again")
    text = (folder / "next.csv").read_text().splitlines()
    (folder / "next.csv").write_text("\n".join([*text[:-1], text[-1].rsplit(",", 1)[0] + ",0.5"]) + "\n")
    done = loopshape("measure", folder / "move.toml", "--out", folder / "again")
    assert done.returncode == 2
    assert "another run" in done.stderr


DRIVEN = MOVE.replace(
    "references = ", "control = { theta2 = { kind = 'staircase', times_s = [1.0], values_v = [0.1] } }\n#"
)


@pytest.mark.parametrize(
    ("head", "rows", "study", "said"),
    [
        ("t_s,feedforward_v", 14_001, MOVE, "fits in the experiment"),
        ("t_s,feedforward_rad", 14_000, MOVE, "in another unit"),
        ("t_s,u_v", 14_000, MOVE, "holds no feedforward"),
        ("t_s,feedforward_v", 14_000, DRIVEN, "goes with references alone"),
        ("t_s,feedforward_v", 14_000, MOVE.replace("next.csv", "../next.csv"), "plain"),
        ("t_s,feedforward_v", 14_000, "rate_hz = 500.0\n" + MOVE, "next.csv"),
    ],
)
def test_a_study_refuses_a_feedforward_that_does_not_fit(
    tmp_path: Path, head: str, rows: int, study: str, said: str
) -> None:
    lines = [head, *(f"{k / 1000.0!r},0.1" for k in range(rows))]
    (tmp_path / "next.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "move.toml").write_text(study)
    with pytest.raises(ls.LoopshapeError, match=said):
        plan(read_study(tmp_path / "move.toml"), Arm1())


def test_other_files_are_no_filters(tmp_path: Path) -> None:
    for text in ("[]", '{"format": "loopshape-learning/1"}'):
        (tmp_path / "f.json").write_text(text)
        with pytest.raises(ls.LoopshapeError, match=r"f\.json"):
            read_learning(tmp_path / "f.json")
