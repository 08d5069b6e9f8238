"""The tour on the motor bench, a process a command, against an interpreter that loads what the command stands on."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

BENCH = Path(__file__).parents[2] / "examples" / "motor_bench"
#: what every command stands on, one with compiled numbers, and one that draws
WORDS = "import typer, pydantic, numpy, pyarrow.parquet"
NUMBERS = f"{WORDS}, scipy.special, scipy.ndimage, scipy.linalg, numba"
PICTURES = f"{NUMBERS}; import matplotlib.figure, matplotlib.backends.backend_agg"
ROUNDS = 3


def commands(run: Path) -> dict[str, tuple[list[str], str]]:
    """Words of each command of the tour, and what loads beneath it."""
    require = ["--require", str(BENCH / "requirements.toml")]
    controller = str(run / "controller.toml")
    model = ["--structure", "rational", "--numerator", "2", "--denominator", "4", "--delay", "--weighting", "relative"]
    table = [str(BENCH / "multisine_type_a.parquet"), "--map", str(BENCH / "map.toml"), "--out", str(run)]
    return {
        "import": (["import", *table], WORDS),
        "frf": (["frf", str(run)], PICTURES),
        "fit": (["fit", str(run), *model], f"{WORDS}, scipy.optimize"),
        "tune": (["tune", str(run), *require, "--out", controller], NUMBERS),
        "check": (["check", str(run), controller, *require], PICTURES),
        "report": (["report", str(run), "--controller", controller, *require], PICTURES),
    }


def cpu_s(words: list[str]) -> float:
    """Seconds of all cores that a process takes, its start included."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}  # as a user's
    process = subprocess.Popen([sys.executable, *words], env=kept, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0, words
    return used.ru_utime + used.ru_stime


def table() -> list[tuple[str, float, float]]:
    """(command, its least seconds, those of the bare loading), after one tour that fills the cache of kernels."""
    found: dict[str, list[tuple[float, float]]] = {}
    for k in range(ROUNDS + 1):
        with tempfile.TemporaryDirectory() as folder:
            for name, (words, bare) in commands(Path(folder) / "bench").items():
                both = cpu_s(["-m", "loopshape", *words]), cpu_s(["-c", bare])
                if k:
                    found.setdefault(name, []).append(both)
    return [(name, *(min(one) for one in zip(*times, strict=True))) for name, times in found.items()]
