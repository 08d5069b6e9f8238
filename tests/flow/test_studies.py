"""`make studies` lists the project's studies and runs them, each in a process of its own."""

import sys
from types import SimpleNamespace

import pytest
import studies as command
import typer

import loopshape as ls

SAYS_THREADS = 'import os\nprint("threads", os.environ["OMP_NUM_THREADS"], os.environ["NUMBA_NUM_THREADS"])\n'


@pytest.fixture
def studies(tmp_path):
    def make(**scripts):
        for name, script in scripts.items():
            folder = tmp_path / "experiments" / name
            folder.mkdir(parents=True)
            (folder / "run.py").write_text(script)
            (folder / "README.md").write_text(f"# Does {name} hold?\n\nMore.\n")
        return tmp_path / "experiments"

    return make


@pytest.fixture
def run(capfd):
    """What the command prints and its exit code."""

    def call(*names, **options):
        try:
            command.studies(list(names), **{"everything": False, "jobs": 0} | options)
            code = 0
        except typer.Exit as ended:
            code = ended.exit_code
        return SimpleNamespace(exit_code=code, **capfd.readouterr()._asdict())

    return call


def test_without_a_name_it_lists_studies_and_their_questions(studies, run):
    lines = run(experiments=studies(ripple="", lag="")).out.splitlines()
    assert [line.split(maxsplit=1) for line in lines] == [["lag", "Does lag hold?"], ["ripple", "Does ripple hold?"]]


def test_a_named_study_runs_alone_and_with_one_thread(studies, run):
    result = run("ripple", experiments=studies(ripple=SAYS_THREADS, lag="raise SystemExit(3)"))
    assert result.exit_code == 0
    assert "threads 1 1" in result.out
    assert "lag" not in result.out


def test_a_study_that_fails_is_exit_code_1_and_does_not_stop_the_others(studies, run):
    folder = studies(a="raise ValueError('broken')", b="print('b ran')")
    result = run(everything=True, experiments=folder)
    assert result.exit_code == 1
    assert "b ran" in result.out
    assert "a FAILED" in result.err
    assert "broken" in result.err


def test_a_study_that_lacks_what_it_needs_is_exit_code_2(studies, run):
    folder = studies(a="import sys; print('install the extra', file=sys.stderr); sys.exit(2)")
    result = run("a", experiments=folder)
    assert result.exit_code == 2
    assert "install the extra" in result.err


def test_the_scoreboard_comes_after_those_it_reads(studies, run, tmp_path, monkeypatch):
    name = "open('made', 'a').write('{}')"
    folder = studies(**{"lab/scoreboard": name.format("last")}, z="import time; time.sleep(0.3); " + name.format("z"))
    monkeypatch.chdir(tmp_path)
    assert run(everything=True, experiments=folder).exit_code == 0
    assert (tmp_path / "made").read_text() == "zlast"


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("nope", {}, "there is no such study; received nope"),
        ("../a", {}, "there is no such study; received ../a"),
        ("a", {"everything": True}, "name studies or ask for --all, not both"),
        ("a", {"jobs": -1}, "the number of studies at the same time"),
    ],
)
def test_what_cannot_be_run_is_refused(studies, run, name, options, sentence):
    with pytest.raises(ls.LoopshapeError, match=sentence):
        run(name, **options, experiments=studies(a=""))


def test_a_folder_without_studies_is_said(run, tmp_path):
    with pytest.raises(ls.LoopshapeError, match="the project's studies are not here"):
        run(experiments=tmp_path)


def test_python_is_the_one_that_runs(studies, run):
    folder = studies(a="import sys; print(sys.executable)")
    assert sys.executable in run("a", experiments=folder).out
