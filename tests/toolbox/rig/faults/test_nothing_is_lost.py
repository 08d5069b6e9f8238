"""Kills, full disks and damaged files: no finished recording is lost, no half of one is taken for good."""

import os
import random
import resource
import signal
import time
from functools import partial

import numpy as np
import pytest
from run_files import finished, verify

import loopshape as ls

RECORDINGS = 24
STUDY = f"""
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{{ theta2_deg = 0.0, p_ab_bar = 1.0 }}]
[[experiment]]
name = "angle"
excites = "theta2"
realisations = {RECORDINGS}
excitation = {{ kind = "multisine", f_low_hz = 2.0, f_high_hz = 9.0, period_s = 1.0, ramp_s = 0.1, amplitude_deg = 1 }}
"""
pytestmark = [pytest.mark.long, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("kills") / "study.toml"
    path.write_text(STUDY)
    ls.rig.measure(path, path.parent / "whole")  # compiled before any child is made
    return path


def child(work):
    """Do work in a child; gives its process number. What it raises is its exit code 2, an interrupt 3."""
    pid = os.fork()
    if pid:
        return pid
    code = 0
    try:
        work()
    except ls.LoopshapeError:
        code = 2
    except BaseException:
        code = 3
    os._exit(code)


def is_sound(run):
    """Nothing that the run lists is missing, changed or unreadable; gives the names."""
    if not (run / "run.toml").exists():
        return set()
    assert [f for f in verify(run) if f.sound is False] == []
    return finished(run)


def is_the_whole(run, study):
    """Every recording is, number by number, that of a measurement nobody disturbed."""
    whole = ls.read(study.parent / "whole")
    assert finished(run) == {r.info.name for r in whole.recordings}
    for r in ls.read(run).recordings:
        there = whole.recording(r.info.name)
        assert all(np.array_equal(r.column(name), there.column(name)) for name in there.columns)


@pytest.mark.parametrize("many", [40, pytest.param(400, marks=(pytest.mark.long, pytest.mark.hour))])
def test_kills_at_random_times(study, many):
    rng, have, kills, turn = random.Random(many), set(), 0, 0
    run = study.parent / f"kills-{many}-0"
    while kills < many:
        pid = child(partial(ls.rig.measure, study, run))
        time.sleep(rng.uniform(0.0, 0.06))
        os.kill(pid, signal.SIGKILL)
        _, status = os.waitpid(pid, 0)
        kills += os.WIFSIGNALED(status)
        now = is_sound(run) if kills % 5 == 0 else finished(run)
        assert have <= now  # what was finished stays
        have = now
        if len(have) == RECORDINGS:
            is_the_whole(run, study)
            turn, have = turn + 1, set()
            run = study.parent / f"kills-{many}-{turn}"
    ls.rig.measure(study, run)
    is_sound(run)
    is_the_whole(run, study)


CALLS = ("replace", "fsync", "open", "close", "write", "unlink")


def killed_at(number, work):
    """Work that kills its own process just before its so-manieth call to the system that touches a file."""
    left = number

    def stand_in(call):
        def called(*given, **named):
            nonlocal left
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*given, **named)

        return called

    for name in CALLS:
        setattr(os, name, stand_in(getattr(os, name)))
    work()


@pytest.mark.long
def test_a_kill_before_each_single_step_of_writing(study):
    """A recording takes some fifteen calls: the kills fall before each of them, with none, one or two finished."""
    run, died = study.parent / "steps-0", 0
    for number in range(48):
        before = is_sound(run)
        if len(before) == RECORDINGS:
            before, run = set(), study.parent / f"steps-{number}"
        pid = child(partial(killed_at, number, partial(ls.rig.measure, study, run)))
        _, status = os.waitpid(pid, 0)
        died += os.WIFSIGNALED(status)
        assert before <= is_sound(run)
    assert died >= 40
    ls.rig.measure(study, run)
    is_the_whole(run, study)
    assert [p.name for p in run.iterdir() if p.name.endswith(".part")] == []


@pytest.mark.parametrize("room_bytes", [0, 100, 5_000, 30_000])
def test_a_full_disk_ends_in_a_sentence_and_the_work_goes_on_later(study, room_bytes, tmp_path):
    def on_a_full_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (room_bytes, resource.RLIM_INFINITY))
        ls.rig.measure(study, tmp_path / "run")

    _, status = os.waitpid(child(on_a_full_disk), 0)
    assert os.WIFEXITED(status)
    assert os.WEXITSTATUS(status) == 2
    is_sound(tmp_path / "run")
    ls.rig.measure(study, tmp_path / "run")
    is_the_whole(tmp_path / "run", study)


def test_run_toml_cut_short_is_said_and_not_written_over(study, tmp_path):
    run = tmp_path / "run"
    ls.rig.measure(study, run)
    content = (run / "run.toml").read_bytes()
    tables = {path: path.read_bytes() for path in run.glob("*.parquet")}
    for size in range(0, len(content), 397):
        (run / "run.toml").write_bytes(content[:size])
        with pytest.raises(ls.LoopshapeError):
            ls.rig.measure(study, run)
        assert (run / "run.toml").read_bytes() == content[:size]
    assert {path: path.read_bytes() for path in run.glob("*.parquet")} == tables
    (run / "run.toml").write_bytes(content)
    is_the_whole(run, study)


def test_a_table_cut_short_is_not_read(study, tmp_path):
    run = tmp_path / "run"
    ls.rig.measure(study, run)
    path = run / "angle-r1.parquet"
    content = path.read_bytes()
    for size in range(0, len(content), 1 + len(content) // 40):
        path.write_bytes(content[:size])
        with pytest.raises(ls.errors.UnreadableInputError):
            ls.read(run).recording("angle-r1").column("theta2_rad")
