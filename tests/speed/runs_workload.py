"""Import of a CSV file beside reading it, and memory of `verify` and `frf` by number and size of recordings."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from million_workload import spent

import loopshape as ls
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import RecordingInfo

ROWS = 3_000_000
MAP = """
format = "loopshape-map/1"
rate_hz = 10000.0
[columns]
n_v = { from = "n", unit = "V" }
u_v = { from = "u", unit = "V" }
y_m = { from = "y", unit = "m" }
[[loop]]
name = "axis"
injected = "n_v"
control = "u_v"
output = "y_m"
[recording]
kind = "noise"
injection = "controller_input"
excites = "axis"
"""
READING = "import sys, pyarrow.csv; pyarrow.csv.read_csv(sys.argv[1])"


def importing() -> tuple[float, float, float, float]:
    """Processor times in s and most memory in MB of importing a CSV file of three columns, and of reading it."""
    import pyarrow as pa
    from pyarrow.csv import write_csv

    with tempfile.TemporaryDirectory() as name:
        folder, rng = Path(name), np.random.default_rng(0)
        columns = {what: np.round(rng.standard_normal(ROWS), 3) for what in "nuy"}
        write_csv(pa.table(columns), folder / "r.csv")
        (folder / "map.toml").write_text(MAP)
        words = ["import", str(folder / "r.csv"), "--map", str(folder / "map.toml"), "--out", str(folder / "run")]
        ours = spent(["-m", "loopshape.cli.main", *words])
        return *ours, *spent(["-c", READING, str(folder / "r.csv")])


def written(folder: Path, recordings: int, rows: int) -> Path:
    """A run of so many recordings of so many rows, three columns each."""
    rng = np.random.default_rng(0)
    u = rng.integers(-500, 500, rows) / 100.0
    y = 0.5 * np.convolve(u, 0.9 ** np.arange(50))[: u.size]
    loop = LoopSetup("a", reference="r_m", injected=None, control="z_v", output="y_m", controller=None)
    every = tuple(
        ls.Recording(
            RecordingInfo(f"r{k:03d}.parquet", "noise", "reference", excites="a"),
            1000.0,
            {"r_m": u, "z_v": u - y, "y_m": np.round(y + 0.01 * k, 3)},
        )
        for k in range(recordings)
    )
    ls.write(ls.Run(rate_hz=1000.0, loops=(loop,), recordings=every), folder)
    return folder


def megabytes(recordings: int, rows: int) -> tuple[float, float]:
    """Most memory of `verify` and of `frf` on a run of so many recordings of so many rows."""
    with tempfile.TemporaryDirectory() as name:
        run = str(written(Path(name) / "run", recordings, rows))
        given = (["verify", run], ["frf", run, "--resolution-hz", "1", "--no-figures"])
        verified, estimated = (spent(["-m", "loopshape.cli.main", *words])[1] for words in given)
    return verified, estimated
