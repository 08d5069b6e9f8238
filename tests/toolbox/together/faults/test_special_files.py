"""What is no file in a file's place: pipes, sockets, devices, folders, links. Nothing waits, nothing leaves the run."""

import os
import shutil
import signal
import socket
import subprocess
import sys

import pytest
from bench import command, commands, prepare
from run_files import write_json

import loopshape as ls
from loopshape.io.folder_lock import alone
from loopshape.toolbox.rig.verbs.stop import MARK, driver, marked, started_at

#: each file with the commands that read it
READ = {
    "run/run.toml": ("frf", "verify", "report", "import another"),
    "run/a.parquet": ("frf", "verify", "gap"),
    "run/fits.json": ("check", "fit", "figures", "report"),
    "run/frf/a.axis.npz": ("fit", "check", "export", "tune"),
    "run/journal.jsonl": ("verify", "import another"),
    "controller.toml": ("check", "report"),
    "require.toml": ("tune", "schedule"),
    "prediction.npz": ("compare",),
    "map.toml": ("import",),
    "a.csv": ("import",),
}
PAIRS = [(file, name) for file, names in READ.items() for name in names]


def pipe(path):
    os.mkfifo(path)


def device(path):
    path.symlink_to("/dev/zero")


def folder(path):
    path.mkdir()


def bound(path):
    """A socket, bound from within its folder: a path to it is short."""
    here = os.getcwd()
    os.chdir(path.parent)
    try:
        socket.socket(socket.AF_UNIX).bind(path.name)
    finally:
        os.chdir(here)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return prepare(tmp_path_factory.mktemp("special") / "whole")


@pytest.fixture
def files(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "work")
    return tmp_path / "work"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize(("file", "name"), PAIRS)
def test_what_is_no_file_is_refused_at_once(files, file, name):
    for make in (pipe, device, folder, bound):
        path = files / file
        path.unlink()
        make(path)
        done = command(commands(files)[name], before=lambda: signal.alarm(20))
        assert done.code in ((0, 1, 2) if name == "verify" else (2,)), (make.__name__, done)
        assert ("is no file" in done.out + done.err) or make is folder, (make.__name__, done)
        assert "Traceback" not in done.err
        shutil.rmtree(path) if make is folder else path.unlink()
        path.touch()


@pytest.mark.parametrize(("place", "name"), [("figures", "figures"), ("export", "export"), ("frf", "frf")])
def test_a_folder_that_is_a_link_is_not_written_through(files, tmp_path, place, name):
    (tmp_path / "elsewhere").mkdir()
    shutil.rmtree(files / "run" / place, ignore_errors=True)
    (files / "run" / place).symlink_to(tmp_path / "elsewhere")
    if place == "frf":  # estimated again: there is none to read
        (files / "run" / "fits.json").unlink()
    done = command(commands(files)[name])
    assert done.code == 2
    assert "is a link that leaves its folder" in done.err
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_run_that_was_replaced_has_no_frf_and_no_fault(files):
    words = commands(files)
    command(("frf", files / "run", "--csv", "--no-figures"))
    assert command(words["import --replace"]).code == 0
    done = command(words["verify"])
    assert done.code == 0, done.out
    assert not list((files / "run").rglob("*.npz"))
    assert not list((files / "run").rglob("*.csv"))
    assert "no FRF yet" in command(words["check"]).err


@pytest.fixture
def bystander():
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("noted", [None, "", "1970", 5])
def test_stop_leaves_a_process_alone_that_bears_an_old_number(files, bystander, noted):
    run = files / "run"
    write_json(
        run / MARK,
        {"pid": bystander.pid, "port": "tcp://127.0.0.1:9"} | ({} if noted is None else {"started_at": noted}),
    )
    with alone(run):  # another command is at work there
        done = command(("stop", run))
    assert done.code == 2
    assert "is of a process that has ended" in done.err
    with pytest.raises(subprocess.TimeoutExpired):
        bystander.wait(0.2)


def test_stop_says_of_a_process_that_is_gone_that_it_ended(files, bystander):
    run, when = files / "run", started_at(bystander.pid)
    bystander.kill()
    bystander.wait()
    write_json(run / MARK, {"pid": bystander.pid, "started_at": when, "port": "x"})
    with alone(run):
        done = command(("stop", run))
    assert done.code == 2
    assert "which does not run" in done.err


def test_the_process_that_measures_is_found(files):
    with alone(files / "run"), marked(files / "run", "tcp://127.0.0.1:9"):
        assert driver(files / "run") == os.getpid()
    with pytest.raises(ls.LoopshapeError, match="nothing is measured"):
        driver(files / "run")
