"""A recording that is read a stretch at a time is imported, looked at and estimated as one that is held whole."""

import h5py
import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo, Settings
from run_files import check_recordings, verify
from scipy.signal import lfilter

import loopshape as ls
from loopshape.core import stretches
from loopshape.core.stretches import LongSignal, extent
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.quality import faults
from loopshape.identify.spectra import transforms
from loopshape.io.run import tables
from loopshape.io.run.run_folder import holds
from loopshape.toolbox.formats.tables import sources
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.formats.tables.spool import Spool

ROWS = 20_000
RATE_HZ = 1000.0
MAP = """
format = "loopshape-map/1"
rate_hz = 1000.0
[time]
from = "t"
unit = "s"
[columns]
n_v = { from = "n", unit = "V" }
u_v = { from = "u", unit = "mV" }
y_m = { from = "y", unit = "m", sign = -1 }
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
WELCH = Settings(resolution_hz=1.0)


@pytest.fixture
def by_stretches(monkeypatch):
    """Switches reading by stretches on: a few thousand rows are long, a few hundred a stretch."""

    def switch():
        monkeypatch.setattr(stretches, "LONG", 5000)
        for module in (stretches, tables, sources, faults):
            monkeypatch.setattr(module, "AT_ONCE", 4096)
        monkeypatch.setattr(transforms, "PART", 1500)
        monkeypatch.setattr(transforms, "SHARE", 100)
        monkeypatch.setattr(sources, "LONG", 5000)
        monkeypatch.setattr(tables, "LONG", 5000)
        monkeypatch.setattr(sources, "LONG_TEXT", 1000)

    return switch


def signals():
    rng = np.random.default_rng(3)
    n = np.round(rng.standard_normal(ROWS), 3)
    y = lfilter([0.0, 0.1], [1.0, -0.9], n) + 0.01 * rng.standard_normal(ROWS)
    return {"t": np.arange(ROWS) / RATE_HZ, "n": n, "u": 1000.0 * (n - 0.1 * y), "y": y}


def written(folder, ending, columns):
    path = folder / f"r.{ending}"
    if ending == "parquet":
        tables.write_table(path, columns)
    elif ending == "mat":
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in columns.items():
                file[name] = values[None, :]
    else:
        rows = np.stack(list(columns.values()), axis=1)
        np.savetxt(path, rows, "%.17g", delimiter=",", header=",".join(columns), comments="")
    return path


def imported(folder, name, ending, columns=None, text=MAP):
    folder.mkdir(exist_ok=True)
    (folder / "map.toml").write_text(text)
    run = import_file(written(folder, ending, columns or signals()), folder / "map.toml", folder)
    ls.write(run, folder / name)
    assert holds(folder / name, run.recordings[0])
    return folder / name


@pytest.mark.long
@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet", "mat"])
def test_import_and_frf(tmp_path, by_stretches, ending):
    whole = ls.read(imported(tmp_path, "whole", ending))
    expected = estimate_frf(whole.recordings[0], whole.loop("axis"), WELCH)
    said = check_recordings(whole)
    columns = {name: whole.recordings[0].column(name) for name in whole.recordings[0].columns}
    by_stretches()
    folder = imported(tmp_path, "long", ending)
    long = ls.read(folder)
    assert isinstance(long.recordings[0].signal("u_v"), LongSignal)
    for name, values in columns.items():
        np.testing.assert_array_equal(long.recordings[0].column(name), values)
    found = estimate_frf(long.recordings[0], long.loop("axis"), WELCH)
    np.testing.assert_allclose(found.response, expected.response, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9)
    assert found.notes == expected.notes
    assert check_recordings(long) == said == []
    assert all(finding.sound is not False for finding in verify(folder))


def test_noise_of_a_long_recording_is_estimated_by_segments(tmp_path, by_stretches):
    by_stretches()
    run = ls.read(imported(tmp_path, "long", "parquet"))
    assert "Welch" in estimate_frf(run.recordings[0], run.loop("axis")).method
    assert "local" in estimate_frf(run.recordings[0], run.loop("axis"), Settings(method="local")).method


def test_a_sweep_of_a_long_recording_is_estimated_as_one_that_is_held_whole(tmp_path, by_stretches):
    half = ROWS // 2  # up and down again: one way alone is estimated in parts
    t, slope = np.arange(half) / RATE_HZ, np.log(100.0) * RATE_HZ / half
    n = np.sin(2.0 * np.pi / slope * (np.exp(slope * t) - 1.0))
    n = np.concatenate([n, n[::-1], np.zeros(ROWS - 2 * half)])
    y = lfilter([0.0, 0.1], [1.0, -0.9], n + 0.05 * n**2) + 0.001 * np.random.default_rng(4).standard_normal(ROWS)
    loop = LoopSetup("axis", None, "n_v", "u_v", "y_m", None)
    info = RecordingInfo("r.parquet", "sweep", "controller_input", excites="axis")
    columns = {"n_v": n, "u_v": n - 0.1 * y, "y_m": y}
    ls.write(ls.Run(RATE_HZ, (loop,), (ls.Recording(info, RATE_HZ, columns),)), tmp_path / "run")

    def estimated():
        return estimate_frf(ls.read(tmp_path / "run").recordings[0], loop)

    held = estimated()
    by_stretches()
    read = estimated()
    assert "harmonic" in held.method
    assert held.method == read.method
    assert np.array_equal(read.frequency_hz, held.frequency_hz)
    assert np.allclose(read.response, held.response, rtol=1e-9)
    assert np.allclose(read.variance, held.variance, rtol=1e-6)


def test_a_value_that_is_no_number_is_named_by_its_row(tmp_path, by_stretches):
    by_stretches()
    columns = signals()
    columns["y"][12_345] = np.nan
    with pytest.raises(ls.errors.BadSignalError, match="first in row 12346"):
        imported(tmp_path, "nan", "csv", columns)
    rows = (tmp_path / "r.csv").read_text().replace("nan", "broken")
    (tmp_path / "r.csv").write_text(rows)
    with pytest.raises(ls.errors.UnreadableInputError, match="'broken' in row 12345"):
        import_file(tmp_path / "r.csv", tmp_path / "map.toml", tmp_path)


def test_lost_samples_and_missing_columns_are_refused(tmp_path, by_stretches):
    by_stretches()
    columns = signals()
    columns["t"] = columns["t"] + 0.05 * (np.arange(ROWS) > 9000)
    with pytest.raises(ls.errors.BadSignalError, match="leave the rate of 1000 Hz at row 9001"):
        imported(tmp_path, "gap", "csv", columns)
    with pytest.raises(ls.errors.WrongUseError, match="holds nothing of this name"):
        imported(tmp_path, "gone", "csv", {k: v for k, v in signals().items() if k != "u"})


def test_rows_that_the_map_takes(tmp_path, by_stretches):
    by_stretches()
    text = MAP.replace("[recording]\n", "[recording]\nfrom_row = 5001\nto_row = 16000\n")
    run = ls.read(imported(tmp_path, "cut", "csv", text=text))
    np.testing.assert_array_equal(run.recordings[0].column("n_v"), signals()["n"][5000:16_000])


def test_spikes_and_clipping_are_named_by_their_rows(tmp_path, by_stretches):
    columns = signals()
    columns["y"] = np.clip(columns["y"], -0.4, 0.4)
    columns["u"][[7000, 15_000]] += 50_000.0
    by_stretches()
    said = check_recordings(ls.read(imported(tmp_path, "faults", "csv", columns)))
    assert any("spike" in s and "row 7000 " in s and "so in 2 of 5 stretches" in s for s in said)
    assert any("saturated?" in s and "so in 5 of 5 stretches" in s for s in said)


def test_a_spool_reads_anywhere(tmp_path):
    rng = np.random.default_rng(0)
    parts = [(rng.standard_normal(k), rng.standard_normal(k)) for k in (5, 1, 7)]
    spool = Spool(2, tmp_path)
    for part in parts:
        spool.add(part)
    assert list(tmp_path.iterdir()) == []  # nothing is left behind, whatever ends the process
    for column in (0, 1):
        expected = np.concatenate([part[column] for part in parts])
        for start in range(14):
            for stop in range(14):
                np.testing.assert_array_equal(spool.signal(column)[start:stop], expected[start:stop])


def test_extent_is_that_of_the_whole(monkeypatch):
    monkeypatch.setattr(stretches, "AT_ONCE", 7)
    x = 1e6 + np.random.default_rng(0).standard_normal(100)
    found = extent(x)
    assert (found.size, found.least, found.most) == (100, x.min(), x.max())
    np.testing.assert_allclose([found.mean, found.std], [x.mean(), x.std()], rtol=1e-9)  # eps mean/std


def test_a_signal_whose_squares_no_float_holds_has_no_finite_spread():
    seen = extent(np.array([1e200, -1e200, 0.0]))
    assert (seen.least, seen.most, seen.std) == (-1e200, 1e200, np.inf)
