"""A run of one FRF on very many frequencies: its check, figures and report beside reading it, in time and memory."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import loopshape as ls
from loopshape.data.control.block import Block
from loopshape.toolbox.formats.frf.frf_exchange import add_frfs

FREQUENCIES = 1_000_000
REQUIREMENTS = (
    'format = "loopshape-requirements/1"\n[[loop]]\nname = "axis"\nunstable_poles = 0\nphase_margin_deg = 40.0\n'
)
READING = (
    "import sys; from pathlib import Path; from loopshape.io.write.frfs import read_frfs; read_frfs(Path(sys.argv[1]))"
)


def written(folder: Path) -> list[str]:
    """The run, and the words that name it with its controller and requirements."""
    rng, f = np.random.default_rng(0), np.arange(1, FREQUENCIES + 1) * (4000.0 / FREQUENCIES)
    mode = 0.02 * 180.0**2 / (180.0**2 - f**2 + 3.6j * f)
    P = 10.0 / (1j * f) / (1.0 + 1j * f / 2000.0) * (1.0 + mode)
    P *= 1.0 + 0.01 * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    names = {"loop": "axis", "recording": "r", "inputs": ("u_v",), "outputs": ("y_m",)}
    add_frfs(folder / "run", [ls.FRF.from_arrays(f, P, relative_std=0.0142, rate_hz=10_000.0, **names)])
    blocks = (Block("gain", {"gain": 5.0}), Block("lead_lag", {"f1_hz": 30.0, "f2_hz": 300.0}))
    ls.write(ls.Controller(loop="axis", rate_hz=10_000.0, blocks=blocks), folder / "c.toml")
    (folder / "r.toml").write_text(REQUIREMENTS)
    return [str(folder / "run"), str(folder / "c.toml"), str(folder / "r.toml")]


#: what is counted of a process is at least what its parent holds: a small one starts it
WATCH = """
import os, subprocess, sys
with subprocess.Popen([sys.executable, *sys.argv[1:]], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as child:
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
print(child.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss)
"""


def spent(words: list[str]) -> tuple[float, float]:
    """Processor time in s and most memory in MB of a Python process."""
    watched = subprocess.run([sys.executable, "-c", WATCH, *words], capture_output=True, text=True, check=True)
    code, seconds, kilobytes = watched.stdout.split()
    assert code == "0", words
    return float(seconds), 1e-3 * float(kilobytes)


def table() -> list[tuple[str, float, str]]:
    """Lines of the table: what, seconds, and the ratio with the memory in words."""
    with tempfile.TemporaryDirectory() as name:
        run, controller, require = written(Path(name))
        reading, megabytes = spent(["-c", READING, run])
        lines = [("reading an FRF of a million frequencies", reading, f"s of one core, {megabytes:.0f} MB")]
        given = ["--controller", controller, "--require", require]
        for what, words in (
            ("  check, without figures", ["check", run, controller, "--require", require, "--no-figures"]),
            ("  check with figures", ["check", run, controller, "--require", require]),
            ("  figures", ["figures", run, *given]),
            ("  report", ["report", run, *given]),
        ):
            taken, megabytes = spent(["-m", "loopshape.cli.main", *words])
            lines.append((what, taken, f"s, {taken / reading:.1f} times reading; {megabytes:.0f} MB"))
        size = 1e-6 * (Path(run) / "report.html").stat().st_size
    return [*lines, ("  size of the report", size, "MB")]
