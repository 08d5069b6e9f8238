"""Two at once, links that lead out, changed words, dying workers: nothing is lost, mixed up or written elsewhere."""

import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Block, Channel, Experiment, LoopSetup, RecordingInfo
from run_files import CsvShape, add_recording, finished, read_toml, start_run, verify, write_frfs, write_toml
from simulated_machines import Arm1, read_study
from study_signals import Multisine

import loopshape as ls
from loopshape.io.csv_text import read_csv_table
from loopshape.io.folder_lock import alone
from loopshape.io.run.journal import FILE as JOURNAL
from loopshape.toolbox.campaign import processes
from loopshape.toolbox.campaign.files import write_index
from loopshape.toolbox.campaign.machines import Campaign
from loopshape.toolbox.campaign.parallel import carried_out
from loopshape.toolbox.formats.controllers.excitation_export import export_signals
from loopshape.toolbox.formats.tables.replacing import replace_run

RATE = 100.0
STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }]
[parameters]
m2_kg = 1.0
[effects]
"joint_friction:1" = 0.2
[[experiment]]
name = "angle"
excites = "theta2"
excitation = { kind = "multisine", f_low_hz = 1.0, f_high_hz = 9.0, period_s = 2.0, periods = 3, amplitude_deg = 1.0 }
"""
CAMPAIGN = 'format = "loopshape-campaign/1"\nstudy = "study.toml"\ndraws = 300\nseed = 1\n'
HEADER = ls.Run(RATE, (), (), None, {}, {"study_sha256": "1"})


def recording(name, seed=1):
    info = RecordingInfo(f"{name}.parquet", "open_loop", "control", closed_loop=False)
    return ls.Recording(info, RATE, {"z_v": np.random.default_rng(seed).normal(size=50)})


@pytest.fixture
def run(tmp_path):
    start_run(tmp_path / "run", HEADER)
    add_recording(tmp_path / "run", recording("a"))
    return tmp_path / "run"


def by_another(run, line):
    """A line of Python done by another process."""
    head = "from pathlib import Path\nfrom test_hard_use import *\nrun = Path(sys.argv[1])\n"
    there = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    return subprocess.run(
        [sys.executable, "-c", head + line, str(run)], capture_output=True, text=True, env=there, check=False
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "line", ["start_run(run, HEADER)", "add_recording(run, recording('b'))", "replace_run(run, HEADER)"]
)
def test_what_one_process_writes_no_other_touches(run, line):
    (run / ".b.parquet.1-2.part").write_bytes(b"half of what is being written")
    before = (run / "run.toml").read_bytes()
    with alone(run):
        done = by_another(run, line)
        assert "another process is writing this run" in done.stderr
        assert (run / "run.toml").read_bytes() == before
        assert (run / ".b.parquet.1-2.part").exists()
        add_recording(run, recording("b"))  # whoever holds it goes on
    assert finished(run) == {"a", "b"}


def test_a_run_that_is_moved_while_it_is_written_ends_in_a_sentence(run):
    with alone(run):
        run.rename(run.with_name("moved"))
        with pytest.raises(ls.errors.UnreadableInputError, match="does not exist"):
            add_recording(run, recording("b"))
    assert finished(run.with_name("moved")) == {"a"}


def test_a_journal_that_is_a_link_is_not_written_through(run, tmp_path):
    (tmp_path / "elsewhere").write_text("mine\n")
    (run / JOURNAL).unlink()
    (run / JOURNAL).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ls.errors.UnreadableInputError, match="cannot be written"):
        add_recording(run, recording("b"))
    assert (tmp_path / "elsewhere").read_text() == "mine\n"
    assert finished(run) == {"a", "b"}  # what was recorded is not lost


def test_a_folder_of_frfs_that_is_a_link_is_neither_written_nor_emptied(run, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine.npz").write_bytes(b"mine")
    (run / "frf").symlink_to(tmp_path / "elsewhere")
    f = np.arange(1.0, 4.0)
    frf = ls.FRF(f, np.ones((3, 1, 1), complex), np.ones((3, 1, 1), complex), f > 0, ("z_v",), ("x_m",), "made up")
    with pytest.raises(ls.errors.UnreadableInputError, match="leaves its folder"):
        write_frfs(run, [frf])
    replace_run(run, HEADER)
    assert [p.name for p in (tmp_path / "elsewhere").iterdir()] == ["mine.npz"]
    assert finished(run) == set()


@pytest.mark.parametrize(
    "words", [{"recording": 3}, {"recording": [3]}, {"notes": 3}, {"notes": "x"}, {"parameters": 1}]
)
def test_a_run_of_odd_words_is_not_gone_on_with(run, words):
    write_toml(run / "run.toml", read_toml(run / "run.toml") | words)
    with pytest.raises(ls.LoopshapeError):
        start_run(run, replace(HEADER, extra={**HEADER.extra, "notes": ["new"]}))


@pytest.mark.parametrize("what", ["folder", "link"])
def test_verify_says_what_stands_in_the_place_of_a_journal(run, what):
    (run / JOURNAL).unlink()
    (run / JOURNAL).mkdir() if what == "folder" else (run / JOURNAL).symlink_to("nowhere")
    assert {f.what: f.sound for f in verify(run)}["journal"] is None


def test_verify_looks_at_tables_of_text_too(run):
    (run / "t.csv").write_text("t_s,z_v\n0.0,1\n0.01,\n")
    entry = {"file": "t.csv", "kind": "open_loop", "injection": "control"}
    table = read_toml(run / "run.toml")
    write_toml(run / "run.toml", table | {"recording": [*table["recording"], entry]})
    found = {f.what: f.sound for f in verify(run)}
    assert found["table t.csv"] is None
    assert found["columns of t.csv"] is False  # an empty cell


def test_rows_that_are_not_there_can_be_skipped_in_no_time(tmp_path):
    (tmp_path / "a.csv").write_text("1,2\n")
    with pytest.raises(ls.errors.UnreadableInputError):
        read_csv_table(tmp_path / "a.csv", CsvShape(header=False, skip_rows=2**62))


@pytest.mark.parametrize("numbers", [{"f_high_hz": 1e12}, {"period_s": 1e300}, {"crest_iterations": 2**62}])
def test_a_multisine_that_would_fill_memory_or_days_is_refused(numbers):
    with pytest.raises(ls.errors.WrongUseError, match="crest_iterations at most"):
        Multisine(**{"f_low_hz": 1.0, "f_high_hz": 9.0, "period_s": 2.0, "amplitude": 1.0} | numbers)


def test_more_periods_than_can_be_made_are_refused():
    with pytest.raises(ls.errors.WrongUseError, match="a signal is too long"):
        Multisine(1.0, 9.0, 2.0, 1.0, periods=2**40).signal(1000.0)


@pytest.fixture
def files(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    return tmp_path


def machines(files, **words):
    plant = Arm1()
    return list(Campaign(read_study(files / "study.toml"), **words).machines(plant.spread, plant.parameters))


def test_machines_are_drawn_about_the_studys_parameters(files):
    masses = [machine.hidden["m2_kg"] for machine in machines(files, draws=20)]
    assert all(0.98 <= mass <= 1.02 for mass in masses)
    assert len(set(masses)) == 20


def test_a_set_of_effects_stands_in_for_the_studys_own(files):
    one, other = machines(files, effects=({"joint_friction": 0.1}, {"gas_law": 0.8}))
    assert dict(one.study.effects) == {"joint_friction": 0.1}
    assert set(other.study.effects) == {"joint_friction:1", "gas_law"}


@pytest.mark.parametrize("words", [{"amplitudes": (1.0, 1.0000001)}, {"effects": ({}, {})}])
def test_machines_of_one_name_are_refused(files, words):
    with pytest.raises(ls.errors.WrongUseError, match="two machines of a campaign have one name"):
        machines(files, **words)


def test_draws_of_a_plant_without_a_spread_are_refused(files):
    with pytest.raises(ls.errors.WrongUseError, match="has no manufacturing tolerance"):
        list(Campaign(read_study(files / "study.toml"), draws=2).machines((), Arm1().parameters))


def test_a_long_set_of_effects_makes_a_name_that_a_folder_can_have(files):
    many = {f"effect_{k}": 0.123456 * k for k in range(60)}
    one, other = machines(files, effects=(many, many | {"effect_59": 0.5}))
    assert len(one.name) <= 120
    assert one.name != other.name


def test_another_campaign_is_not_mixed_into_a_folder(files, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    write_index(out, machines(files, draws=2, seed=1))
    write_index(out, machines(files, draws=3, seed=1))  # more draws are welcome
    before = (out / "index.csv").read_bytes()
    for other in ({"draws": 3, "seed": 2}, {"draws": 2, "seed": 1}, {"draws": 3, "seed": 1, "amplitudes": (0.5, 1.0)}):
        with pytest.raises(ls.errors.WrongUseError, match="holds the machines of another campaign"):
            write_index(out, machines(files, **other))
    assert (out / "index.csv").read_bytes() == before


@pytest.mark.parametrize("there", [{"index.csv": "my,own\n1,2\n"}, {"letter.txt": "mine"}])
def test_a_folder_that_is_no_campaigns_is_left_alone(files, tmp_path, there):
    out = tmp_path / "out"
    out.mkdir()
    for name, text in there.items():
        (out / name).write_text(text)
    with pytest.raises(ls.LoopshapeError):
        write_index(out, machines(files))
    assert {p.name: p.read_text() for p in out.iterdir()} == there


@pytest.mark.parametrize("workers", [-1, 1000, 10**9])
def test_workers_that_no_machine_has_are_refused(workers):
    with pytest.raises(ls.errors.WrongUseError, match="the number of workers"):
        list(carried_out(print, [], workers))


def campaign(files, out):
    words = [sys.executable, "-m", "loopshape.cli.main", "campaign", str(files / "campaign.toml"), "--out", str(out)]
    return [*words, "--workers", "2"]


def of_session(session):
    """Living processes of a session, by number, with their command lines."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, its = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(its) == session and state != "Z":
                found[int(folder.name)] = (folder / "cmdline").read_text()
        except OSError:
            continue
    return found


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize(("how", "code"), [("ctrl-c", 130), ("terminate", 130), ("killed", -9)])
def test_however_a_campaign_ends_no_process_is_left_and_nothing_finished_is_lost(files, how, code):
    out = files / "out"
    with (files / "said").open("w") as said:
        process = subprocess.Popen(campaign(files, out), stdout=said, stderr=said, start_new_session=True)
    until = time.monotonic() + 60.0
    while len(list(out.rglob("run.toml"))) < 2:  # which comes with its first recording
        assert process.poll() is None, (files / "said").read_text()
        assert time.monotonic() < until
        time.sleep(0.02)
    if how == "ctrl-c":
        os.killpg(process.pid, signal.SIGINT)
    else:
        os.kill(process.pid, signal.SIGTERM if how == "terminate" else signal.SIGKILL)
    assert process.wait(timeout=60) == code, (files / "said").read_text()
    assert "Traceback" not in (files / "said").read_text()
    while of_session(process.pid) and time.monotonic() < until:
        time.sleep(0.1)
    assert of_session(process.pid) == {}
    runs = [toml.parent for toml in out.glob("*/run.toml")]
    assert all(f.sound is not False for run in runs for f in verify(run))
    assert any(finished(run) for run in runs)


DEAF = """
import signal
from loopshape.toolbox.campaign.processes import by_processes

def deaf(job):
    blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    return lambda: blocked

if __name__ == "__main__":
    print(*[told for _, told in by_processes(deaf, range(6), 2)])
"""


OVERLAP = """
import sys, time
from functools import partial
from pathlib import Path
from loopshape.toolbox.campaign.processes import by_processes

def told_when_the_next_is_at_work(folder, job):
    (folder / str(job)).touch()
    return partial(wait_for, folder, job)

def wait_for(folder, job):
    while 0 < job < 5 and not (folder / str(job + 1)).exists():
        time.sleep(0.01)
    return job

if __name__ == "__main__":
    print(*[told for _, told in by_processes(partial(told_when_the_next_is_at_work, Path(sys.argv[1])), range(6), 1)])
"""


@pytest.mark.timeout(60)
def test_the_next_recording_is_made_while_one_waits_for_the_disk(tmp_path):
    """Not the very first: a process has one job until it has answered, so that few jobs are shared out evenly."""
    (tmp_path / "overlap.py").write_text(OVERLAP)
    words = [sys.executable, str(tmp_path / "overlap.py"), str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "1", "2", "3", "4", "5"]


def test_no_worker_hears_ctrl_c_not_even_the_first_of_an_interpreter(tmp_path):
    (tmp_path / "deaf.py").write_text(DEAF)
    done = subprocess.run([sys.executable, str(tmp_path / "deaf.py")], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True"] * 6


def test_a_worker_whose_parent_goes_with_an_answer_unread_ends_without_a_word():
    ours, its = multiprocessing.get_context("spawn").Pipe()  # closed with data unread, its end is reset, not ended
    worker = multiprocessing.get_context("spawn").Process(
        target=processes._serve, args=(partial(partial, abs), its), daemon=True
    )
    worker.start()
    its.close()
    ours.send(-1)
    assert ours.poll(60)
    ours.close()
    worker.join(60)
    assert worker.exitcode == 0


@pytest.mark.long
def test_a_full_disk_ends_a_campaign_in_a_sentence(files):
    def little_room():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))

    done = subprocess.run(
        [*campaign(files, files / "out")[:-1], "1"], capture_output=True, text=True, preexec_fn=little_room, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr


def experiment(name, *, reference="r_x_m", size=1.0, injection="reference"):
    loop = LoopSetup("x", reference, None, "z_v", "x_m", ls.Controller("x", (Block("gain", {"gain": 1.0}),), RATE))
    wave = size * np.sin(np.arange(20.0))[:, None]
    return Experiment(
        name, "none", (loop,), RATE, references=wave, injected=0.0 * wave, injection=injection,
        closed_loop=injection != "control", operating_point={},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("to", "experiments", "sentence"),
    [
        ("c", [experiment("é"), experiment("ö")], "two experiments have one name in C"),
        ("c", [experiment("a", size=1e39)], "does not fit in a float of C"),
        ("mat", [experiment("a", reference="_r_m")], "none that MATLAB takes"),
        ("mat", [experiment("a", reference="référence_m")], "none that MATLAB takes"),
    ],
)
def test_signals_that_another_program_would_misread_are_refused(tmp_path, to, experiments, sentence):
    with pytest.raises(ls.errors.WrongUseError, match=sentence):
        export_signals(tmp_path / "out", experiments, to)


@pytest.mark.parametrize("injection", ["reference", "control"])
@pytest.mark.parametrize("to", ["csv", "mat", "c"])
def test_signals_of_a_loop_without_some_columns_are_written(tmp_path, to, injection):
    (path,) = export_signals(tmp_path, [experiment("a", reference=None, injection=injection)], to)
    assert path.stat().st_size > 0
    assert b"None" not in path.read_bytes()
    assert Channel.from_column("z_v").unit == "v"
