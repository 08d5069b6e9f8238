"""A recording of hours is imported, looked at and estimated in the memory of a stretch of it."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from memory_limit import in_a_child
from pyarrow.csv import WriteOptions, write_csv
from scipy.signal import lfilter

import loopshape as ls
from loopshape.io.run import tables

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits are set as Linux has them")

AT_A_TIME = 1_000_000
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
BEFORE = """
from loopshape.core import stretches
from loopshape.io.run import tables
from loopshape.toolbox.formats.tables import sources
from loopshape.cli.estimate.frf import estimate_and_report
from loopshape.toolbox.formats.commands.import_file import import_run
from loopshape.cli.output import Output
file, given, out = map(Path, sys.argv[1:4])
from loopshape.identify.quality import faults
stretches.LONG = sources.LONG = tables.LONG = sources.LONG_TEXT = int(sys.argv[4])
tables.KEPT_BYTES = int(sys.argv[5])
stretches.AT_ONCE = sources.AT_ONCE = tables.AT_ONCE = faults.AT_ONCE = int(sys.argv[6])
import pandas, pyarrow.parquet, numpy as np
import scipy.linalg, scipy.signal, scipy.optimize
import loopshape.identify.frequency_response
from loopshape.core.kernels.spectra import cross_spectra
square = np.eye(300) * 2.0
np.linalg.inv(scipy.linalg.inv(square @ square))  # what the libraries reserve once
cross_spectra([np.ones(64)] * 3, 16, 8)
"""
IMPORT = "import_run(file, given, out, Output(False, True))"
FRF = "estimate_and_report(out, Output(False, True), figures=False, resolution_hz=RESOLUTION)"

SWEEPS = """
from loopshape.core import stretches
from loopshape.data.signal import excitation_kind
from loopshape.identify.local import long_sweeps, sweeps
from loopshape.identify.spectra import transforms
from loopshape.identify.frequency_response import estimate_frf
from loopshape.io.run import tables
from loopshape.io.run.run_folder import read_run
import scipy.signal  # loaded when a sweep is thinned: no memory of the recording's
folder = Path(sys.argv[1])
stretches.LONG = tables.LONG = 100_000
tables.KEPT_BYTES, transforms.PART, long_sweeps.PART = 10_000_000, 50_000, 1 << 17
for module in (stretches, tables, excitation_kind, sweeps, long_sweeps):
    module.AT_ONCE = 1 << 16
def estimated(run):
    run = read_run(run)
    return estimate_frf(run.recordings[0], run.loop("axis"))
estimated(folder / "short")
"""


def noise(rng, first, rows, of):
    return rng.standard_normal(rows)


def sweep(rng, first, rows, of):
    """Rows from `first` on of a sine from 0.5 Hz to 4 kHz at 10 kHz within `of` rows."""
    growth = np.log(8000.0) / of
    turns = 0.5e-4 * np.expm1(growth * np.arange(first, first + rows)) / growth
    return np.sin(2.0 * np.pi * np.mod(turns, 1.0))


def recorded(folder, rows, drawn=noise):
    """A CSV of 3 columns of so many rows of noise, or of a sweep, through a loop, and its map."""
    rng, taps, state = np.random.default_rng(0), 0.9 ** np.arange(60), np.zeros(59)
    with pa.OSFile(str(folder / "r.csv"), "w") as file:
        for first in range(0, rows, AT_A_TIME):
            n = np.round(drawn(rng, first, min(AT_A_TIME, rows - first), rows), 3)
            y, state = lfilter(taps, 1.0, n, zi=state)
            y = np.round(y + 0.01 * rng.standard_normal(n.size), 4)
            table = pa.table({"n": n, "u": np.round(n - 0.1 * y, 4), "y": y})
            write_csv(table, file, WriteOptions(include_header=first == 0, quoting_header="none"))
    (folder / "map.toml").write_text(MAP.replace('"noise"', f'"{drawn.__name__}"'))
    return folder / "r.csv", folder / "map.toml", folder / "run"


@pytest.mark.long
@pytest.mark.parametrize("long_rows", [200_000, pytest.param(10**10, marks=pytest.mark.xfail(strict=True))])
def test_minutes_in_the_memory_of_seconds(tmp_path, long_rows):
    """1.6 million rows of 3 columns and a time are 51 MB; held whole, which must fail, they need several times that."""
    files = recorded(tmp_path, 1_600_000)
    given = (*files, long_rows, 10_000_000, 1 << 16)
    in_a_child(BEFORE, IMPORT, 110_000_000, *given, timeout_s=200.0)
    in_a_child(BEFORE, FRF.replace("RESOLUTION", "10.0"), 110_000_000, *given, timeout_s=200.0)


def swept(folder, rows, both_ways):
    """A run of one sweep of 1 to 80 Hz at 1 kHz, one way or both."""
    t, growth = np.arange(rows) / 1000.0, np.log(80.0) * 1000.0 / rows * (1.0 + both_ways)
    n = np.sin(2.0 * np.pi / growth * np.expm1(growth * t))
    n[rows // 2 :] = n[: rows - rows // 2][::-1] if both_ways else n[rows // 2 :]
    y = lfilter([0.0, 0.1], [1.0, -0.9], n) + 0.001 * np.random.default_rng(4).standard_normal(rows)
    info = RecordingInfo("r.parquet", "sweep", "controller_input", excites="axis")
    recording = ls.Recording(info, 1000.0, {"n_v": n, "u_v": n - 0.1 * y, "y_m": y})
    ls.write(ls.Run(1000.0, (LoopSetup("axis", None, "n_v", "u_v", "y_m", None),), (recording,)), folder)


@pytest.mark.long
@pytest.mark.parametrize(
    ("both_ways", "columns"),
    [
        pytest.param(True, 10, marks=pytest.mark.xfail(reason="both ways takes more than ten columns: open")),
        (False, 3),
    ],
)
def test_a_long_sweep_in_some_of_its_columns(tmp_path, monkeypatch, both_ways, columns):
    """Both ways its signals one after the other, transformed in parts: whole, as before, it took 14 columns and more.

    One way a stretch of it at a time, so that its length does not count: 3 columns are less than its file holds.
    """
    monkeypatch.setattr(tables, "AT_ONCE", 1 << 16)  # groups of rows as short against the file as real ones are
    rows = 1_500_000
    swept(tmp_path / "long", rows, both_ways)
    swept(tmp_path / "short", 40_000, both_ways)
    in_a_child(SWEEPS, "estimated(folder / 'long')", 8.0 * columns * rows, tmp_path)


@pytest.mark.long
@pytest.mark.hour
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("drawn", [noise, sweep])
def test_two_hours_at_10_khz_within_one_and_a_half_gigabytes(tmp_path, drawn):
    files = recorded(tmp_path, 72_000_000, drawn)
    given = (*files, 8_000_000, 192_000_000, 1 << 20)
    most = in_a_child(BEFORE, IMPORT, 1_200_000_000, *given, timeout_s=900.0)
    files[0].unlink()
    assert most < 1.5e9
    assert in_a_child(BEFORE, FRF.replace("RESOLUTION", "None"), 1_200_000_000, *given, timeout_s=900.0) < 1.5e9
    (files[2] / "r.parquet").unlink()
