"""Every command that writes, killed before any step of its writing or at any time, and given again.

Commands give the same bytes for the same input, so the truth is plain: after a kill each file is the one from before or
the one that a whole command leaves, and the same command given again ends as if nothing had happened.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from bench import command
from run_files import verify
from wide_bench import commands, prepare

import loopshape as ls

#: commands that write
WRITING = (
    "import another", "import --replace", "import a third", "frf otherwise", "fit otherwise", "tune", "predict",
    "report", "figures", "export", "import-frf", "import-frf --replace", "check --matrix --junit",
    "check --save-verdict", "export-controller", "export-excitation", "measure", "simulate",
    "campaign", "campaign --merge",
)  # fmt: skip
#: before these a command is given that leaves another file in the place of its own
AFTER = {"tune": "controller.toml", "predict": "prediction.npz", "check --save-verdict": "verdict.json"}
QUICK = (("import --replace", 4), ("frf otherwise", 2), ("check --save-verdict", 5), ("measure", 9), ("tune", 1))
CALLS = ("replace", "fsync", "open", "close", "write", "unlink")
pytestmark = [pytest.mark.long, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return prepare(tmp_path_factory.mktemp("kills") / "whole")


@pytest.fixture(scope="module")
def place(whole):
    """Makes the same files anew, always at one place."""
    folder = whole.with_name("work")

    def make(name):
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(whole, folder)
        if name in AFTER:
            (folder / AFTER[name]).write_bytes(b"made earlier")
        return folder

    return make


@pytest.fixture(scope="module")
def undisturbed(place):
    """Files before a command, after it, what it printed, and how many steps it took; each command is run once."""
    known = {}

    def of(name):
        if name not in known:
            folder = place(name)
            before, steps = tree(folder), folder.with_name("steps")
            done = command(commands(folder)[name], before=lambda: counted(steps))
            assert done.code in (0, 1), done
            known[name] = before, tree(folder), done, len(steps.read_bytes())
        return known[name]

    return of


def tree(folder):
    """Every file by its path in the folder, but journals, which bear times, and what is still being written."""
    paths = {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}
    passing = ("/.", "journal.jsonl")
    return {name: path.read_bytes() for name, path in paths.items() if not any(word in f"/{name}" for word in passing)}


def counted(path):
    """Note each call to the system that touches a file as one byte of a file."""
    out = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    write = os.write
    stand_in(lambda: write(out, b"."))


def killed_before(step):
    """End this process as a power cut does before its so-manieth call to the system that touches a file."""
    left = [step]

    def one():
        left[0] -= 1
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)

    stand_in(one)


def stand_in(first):
    """Do something before each such call."""

    def wrapped(call):
        def called(*given, **named):
            first()
            return call(*given, **named)

        return called

    for name in CALLS:
        setattr(os, name, wrapped(getattr(os, name)))


def killed_after(seconds):
    """End this process so many seconds from now."""
    threading.Thread(target=lambda: (time.sleep(seconds), os.kill(os.getpid(), signal.SIGKILL)), daemon=True).start()


def is_old_or_new(folder, before, after):
    """Every file is that from before or that of the whole command; none is missing but what the command removes, and
    what of a run that replaces another still lies whole beside it."""
    found = tree(folder)
    for name, content in found.items():
        assert content in (before.get(name), after.get(name)) or name.endswith("run.toml"), name
    waiting = {path.name for path in folder.rglob(".*/*")}
    missing = {name for name in before if name in after} - set(found)
    assert {Path(name).name for name in missing} <= waiting, missing
    if "run.toml" in waiting:  # neither the old run nor the new one, until the same call puts it in order
        return
    for run in [*folder.glob("*/run.toml"), *folder.glob("*/d*/run.toml")]:
        assert [one for one in verify(run.parent) if one.sound is False and one.what != "FRFs"] == []  # yet to be made


def kill_and_go_on(name, place, undisturbed, ending):
    """One kill; gives whether the command was ended by it. The number of a process that ended is free again."""
    before, after, whole, _ = undisturbed(name)
    folder = place(name)
    done = command(commands(folder)[name], before=ending)
    is_old_or_new(folder, before, after)
    again = command(commands(folder)[name])
    assert again.code == whole.code, again
    assert tree(folder) == after
    assert list(folder.rglob(".*")) == []
    return done.code is None


@pytest.mark.parametrize(("name", "step"), QUICK)
def test_a_kill_before_a_step_of_writing(name, step, place, undisturbed):
    assert kill_and_go_on(name, place, undisturbed, lambda: killed_before(step))


@pytest.mark.long
@pytest.mark.parametrize("name", WRITING)
def test_kills_before_steps_of_writing(name, place, undisturbed):
    steps = undisturbed(name)[3]
    some = sorted({round(k * (steps - 1) / 4) for k in range(5)})
    for step in range(steps) if name == "import --replace" else some:  # which alone moves several files, one by one
        assert kill_and_go_on(name, place, undisturbed, lambda step=step: killed_before(step)), (
            f"step {step} of {steps}"
        )


@pytest.mark.long
def test_kills_at_random_times(place, undisturbed):
    rng, kills = random.Random(15), 0
    while kills < 30:
        name = rng.choice(WRITING)
        kills += kill_and_go_on(name, place, undisturbed, lambda: killed_after(rng.uniform(0.0, 0.25)))


def children_of(pid):
    """The processes that a process started: a campaign's workers, and what multiprocessing keeps beside them."""
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def gone(pid):
    """Whether a process ended, whoever is to hear of it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return True


def wait_until(is_so):
    until = time.monotonic() + 60.0
    while not is_so():
        assert time.monotonic() < until
        time.sleep(0.01)


def finished_tables(out):
    """When each table that a run lists was written."""
    runs = [toml.parent for toml in out.rglob("run.toml")]
    tables = [run / recording.info.file for run in runs for recording in ls.read(run).recordings]
    return {table: table.stat().st_mtime_ns for table in tables}


def through_kills(words, out, kills, rng, environment):
    """Give a command until it ends by itself, with up to so many kills before; gives how many there were."""
    for count in range(kills + 1):
        before = finished_tables(out)
        process = subprocess.Popen([sys.executable, "-m", "loopshape.cli.main", *map(str, words)], env=environment)
        try:
            assert process.wait(rng.uniform(0.0, 4.0) if count < kills else 120.0) == 0
        except subprocess.TimeoutExpired:
            children = children_of(process.pid)
            process.kill()
            process.wait()
            wait_until(lambda children=children: all(map(gone, children)))
        after = {table: table.stat().st_mtime_ns for table in before if table.exists()}
        assert after.items() <= before.items()  # what was finished is not made again
        if process.returncode == 0:
            return count
    raise AssertionError(words)


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc to find the workers")
@pytest.mark.parametrize("kills", [1, pytest.param(40, marks=pytest.mark.hour)])
def test_campaigns_and_their_workers_at_random_times(kills, whole, tmp_path):
    rng, there = random.Random(15), 0
    campaign = ("campaign", whole / "more_draws.toml", "--quiet", "--workers", "2", "--out")
    environment = os.environ | {"TMPDIR": str(tmp_path / "temporary")}
    (tmp_path / "temporary").mkdir()
    assert command((*campaign, tmp_path / "true")).code == 0
    while there < kills:
        out = tmp_path / f"out{there}"
        merged = there > 0 and rng.random() < 0.5
        for more in (("--part", "1/2"), ("--part", "2/2"), ("--merge",)) if merged else ((),):
            there += through_kills((*campaign, out, *more), out, min(3, kills - there), rng, environment)
        assert tree(out) == tree(tmp_path / "true")
        assert list(out.rglob(".*")) == list((tmp_path / "temporary").iterdir()) == []
