"""The firmware for a Cortex-M4F: it compiles without a warning, fits, is all static, and measures under emulation."""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from commands import invoked
from cortex_m_cases import board, needs_the_board, session

import loopshape as ls
from loopshape.toolbox.rig import cortex_m, emulator
from loopshape.toolbox.rig.target.messages import State

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs" / "board.md").read_text()
KB = 1024


def sections_of(image):
    """Bytes of the firmware's sections."""
    text = subprocess.run(["arm-none-eabi-size", "-A", image], capture_output=True, text=True, check=True).stdout
    return {name: int(size) for name, size in re.findall(r"^\.(\w+) +(\d+)", text, re.M)}


@pytest.mark.parametrize("machine", ["axis", "drive"])
def test_it_compiles_without_a_warning_fits_and_takes_memory_from_nowhere(machine):
    needs_the_board()
    image = cortex_m.firmware(2000.0, f"MACHINE={machine}", "EXTRA=-Werror")
    size = sections_of(image)
    assert size["text"] + size["data"] <= 512 * KB
    assert size["stack"] + size["data"] + size["bss"] <= 128 * KB  # of the F405's 192 KB those that lie in one piece
    names = subprocess.run(["arm-none-eabi-nm", image], capture_output=True, text=True, check=True).stdout
    assert not re.search(r"\b(_?malloc|_?sbrk|_?free|calloc)(_r)?$", names, re.M)


def test_the_map_of_the_page_is_the_firmwares():
    needs_the_board()
    size = sections_of(cortex_m.firmware())
    rows = dict(re.findall(r"^\| `\.(\w+)` \|[^|]*\| ([\d.]+) KB \|", PAGE, re.M))
    assert set(rows) == {"text", "stack", "data", "bss"}
    for name, said in rows.items():
        assert size[name] / KB == pytest.approx(float(said), rel=0.1, abs=0.1), name


def test_the_makefile_is_what_builds_it(tmp_path):
    needs_the_board()
    folder = Path(emulator.__file__).parent / "c_target" / cortex_m.FOLDER
    made = subprocess.run(
        ["make", "-C", folder, f"BUILD={tmp_path}"], capture_output=True, text=True, check=True,
        env={**os.environ, "MAKEFLAGS": ""},
    )  # fmt: skip
    assert "warning" not in made.stdout + made.stderr
    size = sections_of(tmp_path / "target.elf")
    assert (tmp_path / "target.bin").stat().st_size == size["text"] + size["data"]
    assert "stack_end" in (tmp_path / "target.map").read_text()


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--board", "cortex_x"], "a board is not known"), (["--board", "cortex_m", "--drop", "0.1"], "simulated arm's"),
     (["--board", "cortex_m", "--number-bytes", "4"], "received number_bytes"),
     (["--board", "cortex_m", "--rate-hz", "1001"], "divides 168 MHz")],
)  # fmt: skip
def test_what_it_cannot_do_is_refused(words, said):
    result = invoked(["emulator", *words])
    assert isinstance(result.exception, ls.errors.WrongUseError)
    assert said in str(result.exception)


def test_without_its_programs_it_says_so(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(emulator.NoCompilerError, match=r"not here; received 'arm-none-eabi-gcc'; install Debian's"):
        cortex_m.start()


def test_a_port_that_is_taken_is_an_error_in_words():
    with board() as (port, _), pytest.raises(ls.errors.WrongUseError, match="the TCP port cannot be opened"):
        cortex_m.start(int(port.rpartition(":")[2]))


def test_it_answers_with_what_it_is_and_ends_with_whoever_started_it():
    needs_the_board()
    process, port = cortex_m.start()
    with session(port) as one:
        it = one.identity
        assert (it.board, it.most_loops, it.most_sections, it.rate_hz) == ("STM32F4, simulated axis", 2, 32, 2000.0)
        assert one.status().state is State.IDLE
    process.stdin.close()
    process.wait(10)
    process.stdout.close()
    process.stderr.close()


def test_its_line_is_as_fast_as_it_should_be():
    """By the reference manual's formula from the registers as they stand: APB1 over BRR, 16 samples a bit."""
    with board() as (port, monitor):
        with session(port) as one:
            one.status()
        (brr, cr1) = (monitor.word(address) for address in (0x40004408, 0x4000440C))
    assert cr1 >> 15 & 1 == 0
    assert 42e6 / 16.0 / ((brr >> 4) + (brr & 15) / 16.0) == pytest.approx(921_600, rel=0.015)


def exact(frequency_hz, rate_hz):
    """The axis' frequency response under a zero-order hold, from the numbers of axis.c by the matrix exponential."""
    text = (Path(emulator.__file__).parent / "c_target" / cortex_m.FOLDER / "axis.c").read_text()
    j, load, torque, damping, spring, loss = (
        float(re.search(rf"#define {name} ([\d.e-]+)f", text)[1])
        for name in ("MOTOR", "LOAD", "TORQUE", "DAMPING", "SPRING", "LOSS")
    )
    together = np.zeros((5, 5))
    together[0, 1] = together[2, 3] = 1.0
    together[1] = np.array([-spring, -(damping + loss), spring, loss, torque]) / j
    together[3] = np.array([spring, loss, -spring, -loss, 0.0]) / load
    step = scipy.linalg.expm(together / rate_hz)
    z = np.exp(2j * np.pi * frequency_hz / rate_hz)
    return np.array([np.linalg.solve(one * np.eye(4) - step[:4, :4], step[:4, 4])[0] for one in z])


def off_from_the_study(recording):
    """Largest difference of z from the study's controller, 20 (s + a)/(s + 10 a) by Tustin, over the largest z."""
    a, k = 2.0 * np.pi * 3.0, 2.0 * 2000.0
    b, pole = 2.0 * np.array([k + a, a - k]) / a, np.array([k + 10.0 * a, 10.0 * a - k]) / (10.0 * a)
    r, n, y, z = (recording.column(name) for name in ("r_axis_rad", "n_axis_rad", "theta_m_rad", "z_axis_a"))
    return np.abs(scipy.signal.lfilter(b, pole, r + n - y) - z).max() / np.abs(z).max()


@pytest.mark.long
@pytest.mark.timeout(900)
def test_measure_frf_tune_check_and_adopt_on_it(tmp_path, monkeypatch):
    """The commands of the page, one after the other; the truth of the response is the axis' own equations."""
    needs_the_board()
    monkeypatch.chdir(tmp_path)
    for name in ("axis.toml", "requirements.toml"):
        text = (ROOT / "examples" / "rig" / name).read_text()
        text = text.replace("period_s = 4.0, periods = 8", "period_s = 2.0, periods = 3")
        (tmp_path / name).write_text(text.replace('on_limit = "vent"', 'on_limit = "vent"\nwatchdog_ms = 5000'))
    with board() as (port, _):
        said = invoked(["measure", "axis.toml", "--port", port, "--out", "out", "--arm"])
        assert said.exit_code == 0, said.output
    assert invoked(["frf", "out"]).exit_code == 0
    run = ls.read("out")
    assert off_from_the_study(run.recordings[0]) < 1e-5  # numbers of 4 bytes on the line
    P = ls.frf(run)
    truth = exact(P.frequency_hz, 2000.0)
    off = np.abs(np.squeeze(P.response) / truth - 1.0)
    print(f"off by {np.median(off):.2e} in the median, {off.max():.2e} at most")
    assert np.median(off) < 0.01
    tuned = invoked(["tune", "out", "--require", "requirements.toml", "--out", "controller.toml"])
    assert tuned.exit_code == 0, tuned.output
    checked = invoked(["check", "out", "controller.toml", "--require", "requirements.toml"])
    assert checked.exit_code == 0, checked.output
    assert "verdict: pass" in checked.output
    with board() as (port, _):  # the new one takes over
        words = ["--study", "axis.toml", "--require", "requirements.toml", "--port", port, "--out", "adopted", "--arm"]
        tried = invoked(["adopt", "out", "controller.toml", *words])
    assert tried.exit_code == 0, tried.output
    assert "adopted: S is as predicted" in tried.output
