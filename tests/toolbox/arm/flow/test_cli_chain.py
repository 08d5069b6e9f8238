"""The commands end to end on small cases: tables, JSON, exit codes, files, resume."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from commands import loopshape
from typer.testing import CliRunner

import loopshape as ls
from loopshape.cli.main import app

ROOT = Path(__file__).parents[4]
EXAMPLES = ROOT / "examples"
SMALL_STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
seed = 3
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }, { theta2_deg = 15.0, p_ab_bar = 0.8 }]

[[loop]]
name = "theta2"
controller = [{ kind = "gain", gain = 0.5 }]

[[experiment]]
name = "angle"
excites = "theta2"
injection = "controller_input"
excitation = { kind = "sweep", f_low_hz = 0.5, f_high_hz = 15.0, duration_s = 60.0, amplitude_rad = 0.1 }
lead_s = 8.0
tail_s = 8.0
"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arm")
    (folder / "study.toml").write_text(SMALL_STUDY)
    done = loopshape("measure", folder / "study.toml", "--out", folder / "run")
    assert done.returncode == 0, done.stderr
    return folder


def test_measure_writes_a_run_its_frfs_and_a_figure_of_each(arm: Path) -> None:
    names = sorted(path.name for path in (arm / "run").iterdir())
    assert names == ["angle-01.parquet", "angle-02.parquet", "figures", "frf", "journal.jsonl", "run.toml"]
    assert {p.name for p in (arm / "run" / "figures").iterdir()} == {
        "frf_theta2.png", "frf_theta2_angle-01.png", "frf_theta2_angle-02.png",
    }  # fmt: skip


def test_measure_again_keeps_what_is_there(arm: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in (arm / "run").glob("*.parquet")}
    assert loopshape("measure", arm / "study.toml", "--out", arm / "run", "--json").returncode == 0
    assert {p: p.stat().st_mtime_ns for p in (arm / "run").glob("*.parquet")} == before


@pytest.mark.long
def test_an_interrupted_run_goes_on_and_gives_the_same_recordings(arm: Path, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(SMALL_STUDY)
    assert loopshape("measure", tmp_path / "study.toml", "--out", tmp_path / "run").returncode == 0
    head = (tmp_path / "run" / "run.toml").read_text()
    cut = head.rindex("[[recording]]")
    (tmp_path / "run" / "run.toml").write_text(head[:cut])  # as if it had stopped after the first recording
    journal = (tmp_path / "run" / "journal.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "run" / "journal.jsonl").write_text(journal[0])
    (tmp_path / "run" / "angle-02.parquet").write_bytes(b"half a file")
    done = loopshape("measure", tmp_path / "study.toml", "--out", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    for name in ("angle-01.parquet", "angle-02.parquet", "run.toml"):
        assert (tmp_path / "run" / name).read_bytes() == (arm / "run" / name).read_bytes()


def test_another_study_is_not_mixed_into_a_run(arm: Path, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(SMALL_STUDY.replace("seed = 3", "seed = 4"))
    done = loopshape("measure", tmp_path / "study.toml", "--out", arm / "run")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("loopshape: ")


def test_the_chain_ends_in_a_pass_and_exit_code_0(arm: Path) -> None:
    run, controller = arm / "run", arm / "controller.toml"
    require = EXAMPLES / "arm" / "requirements.toml"
    only_angle = arm / "require.toml"
    text = require.read_text()
    only_angle.write_text(text[: text.index('[[loop]]\nname = "p_ab"')])
    assert loopshape("fit", run, "--structure", "third_order").returncode == 0
    tuned = loopshape("tune", run, "--require", only_angle, "--out", controller, "--json")
    assert tuned.returncode == 0, tuned.stderr
    found = json.loads(tuned.stdout)
    assert found["loops"][0]["feasible"]
    assert found["loops"][0]["bandwidth_hz"] > 0.5
    assert {b["quantity"] for b in found["loops"][0]["binding"]} >= {"bandwidth_hz"}
    checked = loopshape("check", run, controller, "--require", only_angle, "--junit", arm / "report.xml")
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout.startswith("verdict: pass: ")
    assert 'failures="0"' in (arm / "report.xml").read_text()
    for name in ("nichols", "loop", "sensitivities"):
        assert (run / "figures" / f"{name}_theta2.png").read_bytes().startswith(b"\x89PNG")


def test_a_missed_requirement_is_exit_code_1_and_named(arm: Path) -> None:
    controller, require = arm / "hot.toml", arm / "hot_require.toml"
    controller.write_text(
        'format = "loopshape-controllers/1"\nrate_hz = 1000.0\n[[loop]]\nname = "theta2"\n'
        'controller = [{ kind = "gain", gain = 1.0 }]\n'
    )
    require.write_text(
        'format = "loopshape-requirements/1"\n[[loop]]\nname = "theta2"\nintegrators = 1\n'
        "phase_margin_deg = 45.0\ngain_margin_db = 30.0\n"
    )
    done = loopshape("check", arm / "run", controller, "--require", require, "--junit", arm / "hot.xml", "--no-figures")
    assert done.returncode == 1
    line = next(x for x in done.stdout.splitlines() if x.startswith("gain_margin_db"))
    assert "FAIL" in line
    assert re.search(r"verdict: FAIL: gain_margin_db[^;]*angle-0[12]", done.stdout)
    assert 'failures="0"' not in (arm / "hot.xml").read_text()


def test_requirements_out_of_reach_write_no_controller_and_exit_1(arm: Path) -> None:
    require = arm / "wild.toml"
    require.write_text(
        'format = "loopshape-requirements/1"\n[[loop]]\nname = "theta2"\nintegrators = 1\n'
        "phase_margin_deg = 45.0\nbandwidth_hz = 9.0\n"
        'structure = [{ kind = "gain", gain = { min = 0.1, max = 10.0 } }]\n'
    )
    done = loopshape("tune", arm / "run", "--require", require, "--out", arm / "none.toml")
    assert done.returncode == 1
    assert "no controller was found that meets all requirements" in done.stderr
    assert not (arm / "none.toml").exists()


def test_quiet_says_nothing_and_json_is_one_object(arm: Path) -> None:
    assert loopshape("frf", arm / "run", "--no-figures", "--quiet").stdout == ""
    found = json.loads(loopshape("frf", arm / "run", "--no-figures", "--json").stdout)
    assert [one["recording"] for one in found["frfs"]] == ["angle-01", "angle-02"]
    assert found["frfs"][0]["valid_to_hz"] > 6.0


def test_csv_of_an_frf_can_be_read_back(arm: Path) -> None:
    assert loopshape("frf", arm / "run", "--no-figures", "--csv", "-q").returncode == 0
    table = np.genfromtxt(arm / "run" / "frf" / "angle-01.theta2.csv", delimiter=",", names=True)
    assert {"frequency_hz", "re", "im", "std", "coherence", "valid"} <= set(table.dtype.names)
    assert np.all(np.diff(table["frequency_hz"]) > 0)


def test_figures_draws_estimates_and_loops(arm: Path, tmp_path: Path) -> None:
    done = loopshape("figures", arm / "run", "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    assert all(Path(path).exists() for path in json.loads(done.stdout)["figures"])


def test_simulate_gives_responses_and_true_states(tmp_path: Path) -> None:
    done = loopshape("simulate", EXAMPLES / "arm" / "steps.toml", "--out", tmp_path / "steps", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert {row["recording"] for row in found["errors"]} == {"steps", "profile", "open-loop"}
    assert all(Path(path).exists() for path in found["figures"])
    import pandas as pd

    table = pd.read_parquet(tmp_path / "steps" / "steps.parquet")
    assert {"true_theta2_rad", "true_p_c_bar"} <= set(table.columns)
    assert np.degrees(table.theta2_rad[3800:4000].mean()) == pytest.approx(10.0, abs=0.5)


def test_an_unstable_simulation_stops_keeps_its_recording_and_exits_2(tmp_path: Path) -> None:
    text = SMALL_STUDY.replace("gain = 0.5", "gain = 8.0").replace("duration_s = 60.0", "duration_s = 10.0")
    (tmp_path / "study.toml").write_text(text)
    done = loopshape("simulate", tmp_path / "study.toml", "--out", tmp_path / "run")
    assert done.returncode == 2
    assert re.search(r"angle-02: .* left the model's range at \d+\.\d+ s", done.stderr)
    assert "Traceback" not in done.stderr
    assert (tmp_path / "run" / "angle-02.parquet").exists()
    assert "ended_early" in (tmp_path / "run" / "run.toml").read_text()


def test_measure_of_an_unstable_arm_says_so_in_a_sentence(tmp_path: Path) -> None:
    text = SMALL_STUDY.replace("gain = 0.5", "gain = 8.0").replace("duration_s = 60.0", "duration_s = 10.0")
    (tmp_path / "study.toml").write_text(text)
    done = loopshape("measure", tmp_path / "study.toml", "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "left the model's range" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("frf", "no-such-run"), "no-such-run"),
        (("measure", "no-such-study.toml", "--out", "x"), "no-such-study.toml"),
        (("check", "x", "y", "--require", "z"), "does not exist"),
        (("import", "README.md", "--map", "examples/axis/map.toml", "--out", "x"), "README.md"),
    ],
)
def test_wrong_use_is_one_sentence_and_exit_code_2(words: tuple[str, ...], said: str) -> None:
    done = loopshape(*words)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("loopshape: ")
    assert said in done.stderr
    assert not (ROOT / "x").exists()


@pytest.mark.short
def test_help_is_quick_and_imports_nothing_heavy() -> None:
    code = (
        "import sys; import loopshape.cli.main as m;"
        "heavy = {'numpy', 'scipy', 'pandas', 'matplotlib', 'numba', 'control', 'pyarrow', 'rich'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.short
def test_every_command_has_help() -> None:
    listed = loopshape("--help").stdout
    commands = typer.main.get_command(app).commands
    assert len(commands) > 25
    for command in commands:
        assert f"  {command} " in listed
        helped = CliRunner().invoke(app, [command, "--help"])
        assert helped.exit_code == 0, helped.exception
        assert f"{command} [OPTIONS]" in helped.stdout
    assert loopshape("frf", "--help").returncode == 0


@pytest.mark.long
def test_plain_environment_is_enough(tmp_path: Path) -> None:
    """No home, no display: as a CI job has it."""
    clean = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "MPLCONFIGDIR": str(tmp_path)}
    words = [sys.executable, "-m", "loopshape.cli.main", "equilibria", "--out", str(tmp_path / "eq"), "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env=clean, cwd=ROOT)
    rows = json.loads(done.stdout)["equilibria"]
    assert len(rows) == 24
    assert sum(not row["within_supply"] for row in rows) == 4


def test_a_stale_frf_is_not_checked(arm: Path, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(arm / "run", tmp_path / "run")
    head = tmp_path / "run" / "run.toml"
    head.write_text(head.read_text().replace("p_ab_bar = 0.8", "p_ab_bar = 0.9"))
    done = loopshape("fit", tmp_path / "run")
    assert done.returncode == 2
    assert "changed or gone: angle-02" in done.stderr
    assert loopshape("frf", tmp_path / "run", "--no-figures", "-q").returncode == 0
    assert loopshape("fit", tmp_path / "run", "--structure", "third_order", "-q").returncode == 0


def test_a_study_that_cannot_be_done_leaves_nothing_behind(tmp_path: Path) -> None:
    for old, new, said in (
        ("seed = 3", 'seed = 3\nsolver = "euler"', "solver"),
        ("seed = 3", "seed = 3\npwm = { frequency_hz = 30.0 }", "PWM period"),
        ("duration_s = 60.0", "duration_s = 60.0005", "whole number of samples"),
        ('excites = "theta2"', 'excites = "theta9"', "theta9"),
        ("amplitude_rad = 0.1", "amplitude_bar = 0.1", "another unit"),
        ("f_high_hz = 15.0", "f_high_hz = 600.0", "half the rate"),
    ):
        (tmp_path / "study.toml").write_text(SMALL_STUDY.replace(old, new, 1))
        done = loopshape("measure", tmp_path / "study.toml", "--out", tmp_path / "run")
        assert done.returncode == 2, (old, done.stdout)
        assert said in done.stderr
        assert not (tmp_path / "run").exists()


def test_imports_are_repeated_without_harm_and_replaced_on_request(tmp_path: Path) -> None:
    axis, out = EXAMPLES / "axis", tmp_path / "run"
    words = ("import", axis / "closed_loop.csv", "--map", axis / "map.toml", "--out", out, "-q")
    assert loopshape(*words).returncode == 0
    before = (out / "run.toml").read_bytes()
    assert loopshape(*words).returncode == 0
    assert (out / "run.toml").read_bytes() == before
    other = tmp_path / "map.toml"
    other.write_text((axis / "map.toml").read_text().replace('unit = "V" }', 'unit = "V", gain = 2.0 }'))
    changed = ("import", axis / "closed_loop.csv", "--map", other, "--out", out, "-q")
    refused = loopshape(*changed)
    assert refused.returncode == 2
    assert "--replace" in refused.stderr
    assert loopshape(*changed, "--replace").returncode == 0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('injection = "controller_input"', 'injection = "plant_input"'),
        ('from = "position_mm", unit = "mm"', 'from = "position_mm", unit = "mm", sign = -1'),
        ('from = "position_mm", unit = "mm"', 'from = "position_mm", unit = "um"'),
    ],
)
def test_a_wrong_map_is_said_where_the_controller_is_known(old: str, new: str, tmp_path: Path) -> None:
    axis, wrong = EXAMPLES / "axis", tmp_path / "map.toml"
    wrong.write_text((axis / "map.toml").read_text().replace(old, new))
    assert loopshape("import", axis / "closed_loop.csv", "--map", wrong, "--out", tmp_path / "run").returncode == 0
    done = loopshape("frf", tmp_path / "run", "--no-figures")
    assert "is not its controller's answer to the error" in done.stderr


def test_the_right_map_gives_no_warning(tmp_path: Path) -> None:
    axis = EXAMPLES / "axis"
    done = loopshape("import", axis / "closed_loop.csv", "--map", axis / "map.toml", "--out", tmp_path / "run")
    assert done.returncode == 0
    assert loopshape("frf", tmp_path / "run", "--no-figures").stderr == ""


def test_held_out_recordings_are_not_estimated(arm: Path, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(arm / "run", tmp_path / "run")
    head = tmp_path / "run" / "run.toml"
    head.write_text(head.read_text().replace('role = "estimation"', 'role = "validation"', 1))
    found = json.loads(loopshape("frf", tmp_path / "run", "--no-figures", "--json").stdout)
    assert [one["recording"] for one in found["frfs"]] == ["angle-02"]
    assert [path.name for path in (tmp_path / "run" / "frf").glob("*.npz")] == ["angle-02.theta2.npz"]


def test_a_saturated_pwm_is_said(tmp_path: Path) -> None:
    hot = SMALL_STUDY.replace("amplitude_rad = 0.1", "amplitude_rad = 2.5").replace("f_low_hz = 0.5", "f_low_hz = 8.0")
    (tmp_path / "study.toml").write_text(hot.replace(", { theta2_deg = 15.0, p_ab_bar = 0.8 }", ""))
    done = loopshape("measure", tmp_path / "study.toml", "--out", tmp_path / "run")
    assert "the PWM of recording angle.parquet is saturated for" in done.stderr


def test_two_writers_of_one_run_are_kept_apart(tmp_path: Path) -> None:
    from loopshape.io.folder_lock import alone, locked

    holds = (
        "import sys; from pathlib import Path; from loopshape.io.run.run_folder import alone\n"
        "with alone(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    )
    words = [sys.executable, "-c", holds, str(tmp_path)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(ls.errors.WrongUseError, match="another process is writing"), alone(tmp_path):
            pass
        other.communicate("")
    with alone(tmp_path), locked(tmp_path):  # a step of writing within the hold that this process has
        pass
    with alone(tmp_path), pytest.raises(ls.errors.WrongUseError, match="another process is writing"), alone(tmp_path):
        pass
