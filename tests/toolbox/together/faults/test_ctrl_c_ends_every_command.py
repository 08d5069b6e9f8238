"""Ctrl-C at any moment of any long command: within two seconds, one sentence, exit code 130, nothing half written."""

import os
import shutil
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import pytest

from loopshape.io.files import examples_folder

EXAMPLES = examples_folder()
ARM, BENCH = EXAMPLES / "arm", EXAMPLES / "motor_bench"
SOON_S = 2.0
MOMENTS = (0.1, 0.35, 0.6, 0.85)  # of the processor time that the command takes from when it can hear a signal
BEGINNING = "import loopshape.core.interrupts"  # until then Python itself begins, and nothing of ours hears one
LOADING = (3.0, 4.0, 5.0, 6.0)  # processor time over that of the beginning: the program loads its commands
LONGEST_S = 12.0  # of processor time: no command is followed longer before it is interrupted
CAMPAIGN = 'format = "loopshape-campaign/1"\nstudy = "identify.toml"\ndraws = 4\nseed = 1\n'
FIT = ("--structure", "rational", "--numerator", "2", "--denominator", "4", "--delay", "--weighting", "relative")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run with FRFs, fits and a controller, and an arm's run to diagnose: what the commands begin from."""
    folder = tmp_path_factory.mktemp("whole")
    shutil.copytree(ARM, folder / "arm")
    (folder / "arm" / "campaign.toml").write_text(CAMPAIGN)
    run = folder / "run"
    for words in (
        ("import", BENCH / "multisine_type_a.parquet", "--map", BENCH / "map.toml", "--out", run),
        ("frf", run, "--no-figures"), ("fit", run, *FIT), ("measure", ARM / "gap.toml", "--out", folder / "told"),
    ):  # fmt: skip
        code, _, _, err = ended(folder, words, 300.0)
        assert code in (0, 1), err
    shutil.copy(BENCH / "controller.toml", folder / "controller.toml")
    return folder


def commands(folder):
    """Words by command, in a folder with what they need."""
    run, require = folder / "run", ("--require", BENCH / "requirements.toml")
    return {
        "import": (
            "import", BENCH / "multisine_type_a.parquet", "--map", BENCH / "map.toml", "--out", run, "--replace"
        ),
        "frf": ("frf", run),
        "fit": ("fit", run, "--structure", "auto"),
        "tune": ("tune", run, *require, "--out", folder / "tuned.toml"),
        "check": ("check", run, folder / "controller.toml", *require),
        "report": ("report", run, "--controller", folder / "controller.toml", *require),
        "gap": ("gap", folder / "told"),
        "measure": ("measure", ARM / "identify.toml", "--out", folder / "measured"),
        "campaign": ("campaign", folder / "arm" / "campaign.toml", "--out", folder / "many", "--workers", "2"),
        "demo": ("demo", "--out", folder / "demo"),
    }  # fmt: skip


def started(folder, *words):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores it
    try:
        return subprocess.Popen(
            [sys.executable, *map(str, words)], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    finally:
        signal.signal(signal.SIGINT, before)


@cache
def beginning_s():
    """Processor time of Python's own beginning: a loaded machine makes it later, not longer."""
    least = 10.0
    for _ in range(5):
        with subprocess.Popen([sys.executable, "-c", BEGINNING]) as process:
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == 0
        least = min(least, used.ru_utime + used.ru_stime)
    return least


def wait_until_spent(process, cpu_s):
    """Processor time of the process when it has had so much, or when it is done."""
    spent_s = 0.0
    while process.poll() is None and spent_s < cpu_s:
        try:
            spent_s = 1e-9 * int(Path(f"/proc/{process.pid}/schedstat").read_text().split()[0])
        except (OSError, IndexError):
            break
        time.sleep(0.001)
    return spent_s


def ended(folder, words, more_s=None, spent=LOADING[0]):
    """Exit code, processor seconds from when it could hear a signal, seconds after the interrupt, standard error.

    The interrupt comes when the process has had `spent` times the processor time of Python's beginning and `more_s`
    more: a loaded machine makes that later, not another moment of the command.
    """
    with started(folder, "-m", "loopshape", *words) as process:
        begun_s = spent * beginning_s()
        took_s = wait_until_spent(process, begun_s + (LONGEST_S if more_s is None else more_s)) - begun_s
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        late_s = time.monotonic()
        _, err = process.communicate(timeout=250)
    return process.returncode, took_s, time.monotonic() - late_s, err


def made_from(whole, folder):
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(whole, folder)
    return folder


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="processor time is read as Linux has it")
@pytest.mark.parametrize("spent", LOADING)
def test_an_interrupt_while_the_program_loads_ends_it_as_any_other(tmp_path, spent):
    code, _, late_s, err = ended(tmp_path, ("effects", "servo-axis"), 0.0, spent)
    assert (code, err.splitlines()) == (130, [err.strip()]), err
    assert err.startswith("loopshape: interrupted")
    assert late_s < SOON_S


LOST = """
import signal, time
from loopshape.core.interrupts import ended_soon
class Dying:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
with ended_soon("interrupted; test", lambda: None):
    Dying()
    time.sleep(30)
"""


@pytest.mark.long
def test_an_interrupt_that_falls_into_a_callback_ends_the_program_all_the_same(tmp_path):
    begun = time.monotonic()
    with started(tmp_path, "-c", LOST) as process:
        _, err = process.communicate(timeout=25)
    assert (process.returncode, err) == (130, "loopshape: interrupted; test\n")
    assert time.monotonic() - begun < SOON_S + 2.0


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(x, marks=pytest.mark.hour) if x in ("gap", "fit", "demo", "campaign") else x
        for x in commands(EXAMPLES)
    ],
)
def test_an_interrupted_command_ends_soon_and_leaves_nothing_half(whole, tmp_path, name):
    folder = made_from(whole, tmp_path / "work")
    words = commands(folder)[name]
    code, took_s, _, err = ended(folder, words)
    if code != 130:  # the first one reads files that the next ones have at hand
        made_from(whole, folder)
        code, took_s, _, err = ended(folder, words)
    assert code in (0, 1, 130), err
    ends = (0, 1) if code == 130 else (code,)  # one that was too slow to be followed may be quicker later
    worst_s, hits = 0.0, 0
    for moment in MOMENTS:
        made_from(whole, folder)
        found, _, late_s, err = ended(folder, words, moment * took_s)
        if found in ends:
            continue  # it was quicker this time
        hits += 1
        worst_s = max(worst_s, late_s)
        assert found == 130, err
        said = [line for line in err.splitlines() if not line.startswith("warning: ")]
        assert len(said) == 1, err
        assert said[0].startswith("loopshape: "), err
        assert late_s < SOON_S, f"{late_s:.2f} s"
        assert not [path.name for path in folder.rglob("*.part")]
    assert hits >= len(MOMENTS) - 1
    again, _, _, err = ended(folder, words)  # what the last one left serves the next one
    assert again in (*ends, 130), err
    print(f"{name}: {worst_s:.2f} s at most")
