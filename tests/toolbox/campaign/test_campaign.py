"""Many machines: the same to the last bit whoever simulates them, whoever dies on the way; nothing finished is lost."""

import csv
import fcntl
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest
from run_files import verify
from simulated_machines import Arm1

import loopshape as ls
from loopshape.toolbox.campaign.files import read_campaign
from loopshape.toolbox.campaign.machines import Part
from loopshape.toolbox.formats.tables.replacing import replace_run
from loopshape.toolbox.rig.effects import asked

STUDY = """
format = "loopshape-study/1"
rig = "simulated"
plant = "arm-1dof"
seed = 4
operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }, { theta2_deg = 15.0, p_ab_bar = 1.0 }]
[[experiment]]
name = "angle"
excites = "theta2"
excitation = { kind = "multisine", f_low_hz = 0.5, f_high_hz = 10.0, period_s = 4.0, periods = 2, amplitude_deg = 2.0 }
"""
CAMPAIGN = """
format = "loopshape-campaign/1"
study = "study.toml"
amplitudes = [0.5, 1.0]
effects = ["", "gas_law=0.8"]
draws = 2
seed = 1
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "study.toml").write_text(STUDY)
    (folder / "campaign.toml").write_text(CAMPAIGN)
    return folder / "campaign.toml"


def command(campaign, out, *options):
    return [sys.executable, "-m", "loopshape.cli.main", "campaign", str(campaign), "--out", str(out), *options]


@pytest.fixture(scope="module")
def alone(campaign):
    """All of it by one process."""
    out = campaign.parent / "alone"
    subprocess.run(command(campaign, out, "--workers", "1"), check=True, capture_output=True)
    return out


def content(out):
    kept = (path for path in sorted(out.rglob("*")) if path.is_file() and path.name != "journal.jsonl")
    return {str(path.relative_to(out)): path.read_bytes() for path in kept}


def wait_for(out, recordings, process):
    until = time.monotonic() + 120.0
    while len(list(out.rglob("*.parquet"))) < recordings:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.02)


@pytest.mark.short
def test_every_machine_has_its_run_and_a_line_of_the_table(alone):
    with (alone / "index.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 2 * 2 * 2
    for line in lines:
        run = ls.read(alone / line["machine"])
        assert len(run.recordings) == 2
        assert "parameters" not in run.extra  # what was drawn stands in the table alone
    assert len({line["m2_kg"] for line in lines}) == 2  # a draw is one machine under all amplitudes and effects
    assert all(0.99 * 0.533 <= float(line["m2_kg"]) <= 1.01 * 0.533 for line in lines)


def test_amplitudes_scale_what_is_injected(alone):
    half, whole = (ls.read(alone / f"d000000-x{x}").recordings[0].column("n_theta2_rad") for x in ("0.5", "1"))
    assert (2.0 * half == whole).all()


def test_noise_differs_from_machine_to_machine(alone):
    one, other = (ls.read(alone / f"d00000{k}-x1").recordings[0].column("p_a_bar")[:5] for k in (0, 1))
    assert (one != other).any()


@pytest.mark.hour
@pytest.mark.long
@pytest.mark.short
def test_two_processes_give_the_same_to_the_last_bit(campaign, alone):
    out = campaign.parent / "two"
    subprocess.run(command(campaign, out, "--workers", "2"), check=True, capture_output=True)
    assert content(out) == content(alone)


@pytest.mark.long
def test_a_campaign_that_was_killed_goes_on_to_the_same_result(campaign, alone):
    out = campaign.parent / "killed"
    process = subprocess.Popen(command(campaign, out, "--workers", "1"), stderr=subprocess.PIPE)
    wait_for(out, 3, process)
    process.kill()
    process.communicate()
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet") if not path.name.startswith(".")}
    runs = [toml.parent for toml in out.glob("*/run.toml")]
    listed = [run / recording.info.file for run in runs for recording in ls.read(run).recordings]
    subprocess.run(command(campaign, out, "--workers", "1"), check=True, capture_output=True)
    assert content(out) == content(alone)
    assert all(path.stat().st_mtime_ns == before[path] for path in listed)  # what was finished was not made again


def workers_of(pid):
    """The worker processes of a campaign, which are its children."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(c) for c in children if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()]


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc to find the workers")
def test_a_worker_that_is_killed_loses_its_own_unfinished_table_alone(campaign, alone):
    out = campaign.parent / "robbed"
    process = subprocess.Popen(command(campaign, out, "--workers", "2"), stderr=subprocess.PIPE, text=True)
    wait_for(out, 2, process)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("angle*.parquet")}
    os.kill(workers_of(process.pid)[0], signal.SIGKILL)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert content(out) == content(alone)
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc to find the workers")
def test_a_recording_that_ends_every_worker_ends_in_a_sentence(campaign):
    from loopshape.toolbox.campaign.parallel import carried_out

    with pytest.raises(ls.errors.RigError, match="a worker process ended unasked"):
        list(carried_out(os._exit, [7], 1))


@pytest.mark.long
def test_parts_that_were_recorded_apart_are_merged_to_the_same_bytes(campaign, alone):
    out = campaign.parent / "parts"
    at_once = [subprocess.Popen(command(campaign, out, "--part", f"{k}/3", "--workers", "1")) for k in (1, 3)]
    assert [process.wait(timeout=120) for process in at_once] == [0, 0]
    early = subprocess.run(command(campaign, out, "--merge"), capture_output=True, text=True, check=False)
    assert early.returncode == 2
    assert "parts of the campaign are missing; received part-2-of-3" in early.stderr
    second = ls.campaign(campaign, out, part=(2, 3), workers=1)
    assert (second.folder, second.machines, second.recordings) == (out / "part-2-of-3", 8, 5)
    before = {path.name for path in out.glob("part-2-of-3/d*")}
    assert 0 < len(before) < 8
    subprocess.run(command(campaign, out, "--merge"), check=True)
    assert content(out) == content(alone)
    assert not list(out.glob("part-*"))
    assert all(finding.sound is not False for toml in out.glob("*/run.toml") for finding in verify(toml.parent))


@pytest.mark.long
def test_parts_that_are_not_whole_are_not_merged(campaign):
    out = campaign.parent / "not-whole"
    for k in (1, 2):
        subprocess.run(command(campaign, out, "--part", f"{k}/2", "--workers", "1"), check=True)
    toml = out / "part-2-of-2" / "d000001-x1" / "run.toml"
    toml.write_text(toml.read_text().partition("[[recording]]")[0])
    done = subprocess.run(command(campaign, out, "--merge"), capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "d000001-x1 lacks angle-01, angle-02" in done.stderr
    assert len(list(out.glob("part-*"))) == 2


@pytest.mark.hour
@pytest.mark.long
def test_a_cluster_that_loses_a_worker_gives_the_same_to_the_last_bit(campaign, alone):
    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    from distributed import LocalCluster

    out = campaign.parent / "cluster"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1", silence_logs=50
        ) as cluster:
            process = subprocess.Popen(
                command(campaign, out, "--cluster", cluster.scheduler_address), stderr=subprocess.PIPE
            )
            wait_for(out, 2, process)
            victim = next(iter(cluster.workers.values())).pid
            os.kill(victim, signal.SIGKILL)
            _, said = process.communicate(timeout=240)
    assert process.returncode == 0, said.decode()
    assert content(out) == content(alone)


def test_a_run_is_not_replaced_while_its_campaign_records(campaign, alone):
    """The campaign's hold is on its folder; that of the machine comes and goes with each table."""
    before, machine = content(alone), next(path for path in sorted(alone.iterdir()) if path.is_dir())
    run = ls.read(machine)
    handle = os.open(alone, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)  # as another process holds it
        with pytest.raises(ls.LoopshapeError, match="another process is writing this run"):
            replace_run(machine, run)
    finally:
        os.close(handle)
    assert content(alone) == before


def read(campaign, *changes):
    text = CAMPAIGN
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = campaign.with_name("changed.toml")
    path.write_text(text)
    return read_campaign(path, lambda plant, words: asked(Arm1(), words) if words else {})


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('study = "study.toml"', 'study = "../study.toml"', "must be a plain name inside its folder"),
        ("amplitudes = [0.5, 1.0]", "amplitudes = [0.0]", "amplitudes are positive factors"),
        ("draws = 2", "draws = 100000000", "at most 10000000 machines"),
        ("draws = 2", "machines = 2", "unknown key; received 'machines'"),
        ('"gas_law=0.8"', '"gaslaw"', "arm-1dof has no such effect"),
    ],
)
def test_a_campaign_that_cannot_be_is_refused(campaign, old, new, sentence):
    with pytest.raises(ls.LoopshapeError, match=sentence):
        read(campaign, (old, new))


def test_a_bare_name_is_a_usual_magnitude_and_sets_are_joined(campaign):
    asked_for, file = read(campaign, ('["", "gas_law=0.8"]', '["gas_law + payload=0.1"]'))
    assert file == Path(campaign.parent / "study.toml")
    assert asked_for.effects[0]["payload"] == 0.1
    assert asked_for.effects[0]["gas_law"] > 0.0


@pytest.mark.long
def test_a_cluster_that_is_not_there_is_said():
    from loopshape.toolbox.campaign.parallel import carried_out

    pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
    with pytest.raises(ls.errors.RigError, match="no cluster answers there"):
        list(carried_out(print, [], cluster="tcp://127.0.0.1:9"))


@pytest.mark.long
@pytest.mark.parametrize("part", ["0/3", "4/3", "1", "a/b", "-1/3"])
def test_a_part_that_a_campaign_does_not_have_is_refused(campaign, part):
    words = command(campaign, campaign.parent / "none", "--part", part)
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "1/8 to 8/8" in done.stderr


def test_every_recording_is_in_one_part_and_parts_are_of_one_size():
    for count in (0, 1, 7, 1000):
        for of in (1, 2, 3, 8):
            parts = [Part(k, of).recordings(count) for k in range(1, of + 1)]
            assert [number for part in parts for number in part] == list(range(count))
            assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_a_campaign_of_version_1_opens():
    kept = Path(__file__).parents[2] / "helpers/kept/campaign-1.toml"
    found, _ = read_campaign(kept, lambda plant, names: dict.fromkeys(names, 1.0))
    assert (found.amplitudes, found.effects, found.draws) == ((0.5, 1.0), ({}, {"coulomb_friction=0.5": 1.0}), 2)
