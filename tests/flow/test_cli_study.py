"""`loopshape study` lists the project's studies and runs them, each in a process of its own."""

import json
import sys

import pytest
from typer.testing import CliRunner

from loopshape.cli.main import app
from loopshape.core.errors import LoopshapeError

SAYS_THREADS = 'import os\nprint("threads", os.environ["OMP_NUM_THREADS"], os.environ["NUMBA_NUM_THREADS"])\n'


@pytest.fixture
def studies(tmp_path):
    def make(**scripts):
        for name, script in scripts.items():
            folder = tmp_path / "experiments" / name
            folder.mkdir(parents=True)
            (folder / "run.py").write_text(script)
            (folder / "README.md").write_text(f"# Does {name} hold?\n\nMore.\n")
        return str(tmp_path / "experiments")

    return make


def run(*arguments):
    result = CliRunner().invoke(app, ["study", *arguments])
    if isinstance(result.exception, LoopshapeError):
        raise result.exception
    return result


def test_without_a_name_it_lists_studies_and_their_questions(studies):
    folder = studies(ripple="", lag="")
    assert json.loads(run("--experiments", folder, "--json").stdout) == {
        "studies": [
            {"study": "lag", "question": "Does lag hold?"},
            {"study": "ripple", "question": "Does ripple hold?"},
        ]
    }


def test_a_named_study_runs_alone_and_with_one_thread(studies):
    folder = studies(ripple=SAYS_THREADS, lag="raise SystemExit(3)")
    result = run("ripple", "--experiments", folder)
    assert result.exit_code == 0
    assert "threads 1 1" in result.stdout
    assert "lag" not in result.stdout


def test_a_study_that_fails_is_exit_code_1_and_does_not_stop_the_others(studies):
    folder = studies(a="raise ValueError('broken')", b="print('b ran')")
    result = run("--all", "--experiments", folder)
    assert result.exit_code == 1
    assert "b ran" in result.stdout
    assert "a FAILED" in result.stderr
    assert "broken" in result.stderr


def test_a_study_that_lacks_what_it_needs_is_exit_code_2(studies):
    folder = studies(a="import sys; print('install the extra', file=sys.stderr); sys.exit(2)")
    result = run("a", "--experiments", folder, "--json")
    assert result.exit_code == 2
    assert json.loads(result.stdout)["studies"][0]["exit_code"] == 2
    assert "install the extra" in result.stderr


def test_the_scoreboard_comes_after_those_it_reads(studies, tmp_path, monkeypatch):
    name = "open('made', 'a').write('{}')"
    folder = studies(scoreboard=name.format("last"), z="import time; time.sleep(0.3); " + name.format("z"))
    monkeypatch.chdir(tmp_path)
    assert run("--all", "--experiments", folder, "--quiet").exit_code == 0
    assert (tmp_path / "made").read_text() == "zlast"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nope",), "there is no such study; received nope"),
        (("../a",), "there is no such study; received ../a"),
        (("a", "--all"), "name studies or ask for --all, not both"),
        (("a", "--jobs", "-1"), "the number of studies at the same time"),
    ],
)
def test_what_cannot_be_run_is_refused(studies, arguments, sentence):
    with pytest.raises(LoopshapeError, match=sentence):
        run(*arguments, "--experiments", studies(a=""))


def test_a_folder_without_studies_is_said(tmp_path):
    with pytest.raises(LoopshapeError, match="the project's studies are not here"):
        run("--experiments", str(tmp_path))


def test_python_is_the_one_that_runs(studies):
    folder = studies(a="import sys; print(sys.executable)")
    assert sys.executable in run("a", "--experiments", folder).stdout
