"""A recording from a rig is on the disk as it arrives: a lost line, a kill or a power cut keeps what came."""

import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from axis_study import experiment, measured, simulated, study_text, table, target, write_study
from python_target_line import Faults, Running
from run_files import finished, read_journal, verify

import loopshape as ls
from loopshape.toolbox.rig.target.stream_log import ARRIVING, EARLIER, keep_arrived, open_stream_log, read_arriving
from loopshape.toolbox.rig.verbs.machine import ended_early

NAMES = ["x_rad", "u_v"]


def written(folder, blocks, seed=1):
    """An arriving file of blocks of these lengths: its bytes, and where each block ends with how many rows."""
    rng, ends = np.random.default_rng(seed), []
    rows = rng.standard_normal((sum(blocks), 2))
    with open_stream_log(folder, "one", {"kind": "none"}, 1000.0, NAMES) as append:
        for k, count in enumerate(blocks):
            part = rows[sum(blocks[:k]) : sum(blocks[:k]) + count]
            append({name: part[:, j] for j, name in enumerate(NAMES)})
            ends.append(((folder / f"one{ARRIVING}").stat().st_size, sum(blocks[: k + 1])))
    return rows, ends


def rows_of(path):
    columns = read_arriving(path)[1]
    return np.column_stack([columns[name] for name in NAMES])


def test_cut_anywhere_the_whole_blocks_before_the_cut_are_there(tmp_path):
    rows, ends = written(tmp_path, [3, 1, 5])
    path = tmp_path / f"one{ARRIVING}"
    data = path.read_bytes()
    head = data.index(b"\n") + 1
    for cut in range(head, len(data) + 1):
        path.write_bytes(data[:cut])
        expected = max([count for end, count in ends if end <= cut], default=0)
        np.testing.assert_array_equal(rows_of(path), rows[:expected])


def test_changed_anywhere_nothing_wrong_is_read(tmp_path):
    rows, _ = written(tmp_path, [3, 1, 5])
    path = tmp_path / f"one{ARRIVING}"
    data = path.read_bytes()
    for at in range(len(data)):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        try:
            found = rows_of(path)
        except (ls.errors.UnreadableInputError, KeyError):
            continue
        np.testing.assert_array_equal(found, rows[: len(found)])
        assert at > len(data) - 100 or len(found) < len(rows)


def test_a_head_that_is_torn_is_put_aside(tmp_path):
    (tmp_path / f"one{ARRIVING}").write_bytes(b'{"format": "loopsh')
    assert keep_arrived(tmp_path) == []
    assert [p.name for p in (tmp_path / EARLIER).iterdir()] == [f"one-1{ARRIVING}"]


def expected_rows(study, name):
    return np.column_stack([simulated(study, name)[key] for key in ("r1", "n1", "z1", "s1", "u1")])


def kept_rows(run, name="one-1"):
    return pd.read_parquet(run / EARLIER / f"{name}.parquet")


@pytest.mark.parametrize("event", ["pull", "silent"])
def test_a_lost_line_keeps_what_came_and_the_same_command_goes_on(tmp_path, event, monkeypatch):
    from loopshape.toolbox.rig.target import session

    monkeypatch.setattr(session, "ANSWER_S", 0.05)
    study, run = write_study(tmp_path, study_text(experiment(periods=6))), tmp_path / "run"
    with Running(target, Faults(event=event, when="run", at=1000)) as running:
        with pytest.raises(ls.LoopshapeError):
            measured(study, run, running.port)
        running.silent = False
        kept, truth = kept_rows(run), expected_rows(study, "one")
        assert 200 < len(kept) < len(truth)
        np.testing.assert_array_equal(kept.to_numpy()[:, 1:], truth[: len(kept)])
        np.testing.assert_array_equal(kept["t_s"], np.arange(len(kept)) / 1000.0)
        assert finished(run) == set()
        assert measured(study, run, running.port) == []
    assert finished(run) == {"one"}
    assert not list(run.glob(f"*{ARRIVING}"))
    assert [line["ticks"] for line in read_journal(run)[0] if line["event"] == "kept"] == [len(kept)]
    assert not [one for one in verify(run) if one.sound is False]


def test_a_host_that_is_killed_keeps_what_came(tmp_path):
    """As by a power cut, but for what the disk had not been told: that is a second's at most."""
    text = study_text(experiment(periods=120), target=("place = false", "watchdog_ms = 3000"))
    study, run = write_study(tmp_path, text), tmp_path / "run"
    with Running(lambda: target(fast=False, emulated=False)) as running:
        words = [
            sys.executable,
            "-m",
            "loopshape.cli.main",
            "measure",
            study,
            "--out",
            run,
            "--port",
            running.port,
            "--arm",
        ]
        process = subprocess.Popen(list(map(str, words)), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            end = time.monotonic() + 40.0
            while not ((r := running.target.recording) and r.tick > 1500):
                assert process.poll() is None
                assert time.monotonic() < end
                time.sleep(0.01)
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait(10)
        made = np.array([np.frombuffer(one) for one in running.target.made])
    assert any(one.what == f"one{ARRIVING}" and one.sound is None for one in verify(run))
    ((path, ticks),) = keep_arrived(run)
    assert ticks > 1000
    np.testing.assert_array_equal(pd.read_parquet(path).to_numpy()[:, 1:], made[:ticks])


def test_what_a_limit_ended_is_made_again_on_request_alone(tmp_path):
    """The machine is put right in between: its disturbance is gone; the earlier table is kept."""
    large = experiment("large", injection="plant_input", unit="v", amplitude=4.0)
    text = study_text(experiment("small"), large, angle="low_rad = -3.0, high_rad = 0.16")
    study, run = write_study(tmp_path, text), tmp_path / "run"

    with Running(target) as running:
        assert len(measured(study, run, running.port)) == 1
        before, first = finished(run), table(run, "large", "plant_input")
        assert len(measured(study, run, running.port)) == 1  # not asked for: nothing is made
        assert not (run / EARLIER).exists()
    lame = lambda: target(ignores_limits=False)  # noqa: E731
    with Running(lame) as running:
        running.target.machine.gain = 0.0  # it does not move, and passes no limit
        assert ended_early(ls.rig.measure(study, run, port=running.port, arm=True, again=True)) == []
    assert finished(run) == before
    assert ls.read(run).recording("large").info.file == "large.again-1.parquet"
    assert table(run, "large", "plant_input")["s1"].size > first["s1"].size
    np.testing.assert_array_equal(pd.read_parquet(run / EARLIER / "large-1.parquet")["angle1_rad"], first["s1"])
    assert [path.name for path in sorted(run.glob("*.parquet"))] == ["large.again-1.parquet", "small.parquet"]
    assert not [one for one in verify(run) if one.sound is False]
