"""Other people's files become run folders, with nothing guessed; machines' own recordings where they are at hand."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest
from conversions import deg
from run_files import check_recordings
from scipy.io import loadmat, savemat

import loopshape as ls
from loopshape.toolbox.formats.logs.mat5 import read_mat5
from loopshape.toolbox.formats.tables.import_file import import_file

DATA = Path(os.environ.get("LOOPSHAPE_DATA", Path(__file__).parents[4] / ".." / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="recordings of real machines are absent: set LOOPSHAPE_DATA")

HEAD = 'format = "loopshape-map/1"\nrate_hz = 100.0\n'
TAIL = """
[[loop]]
name = "axis"
control = "u_v"
output = "theta_rad"

[recording]
kind = "noise"
injection = "control"
excites = "axis"
"""
COLUMNS = """
[columns]
u_v = { from = "u", unit = "mV" }
theta_rad = { from = "theta", unit = "deg", sign = -1, gain = 2.0, offset = 1.0 }
"""
N = 200
U = np.random.default_rng(0).standard_normal(N)
THETA = np.cumsum(U)


def mapped(tmp_path, file, text):
    (tmp_path / "map.toml").write_text(text)
    return import_file(file, tmp_path / "map.toml")


def assert_imported(run):
    recording = run.recordings[0]
    np.testing.assert_allclose(recording.column("u_v"), U / 1000.0, rtol=1e-15)
    np.testing.assert_allclose(deg(recording.column("theta_rad")), -2.0 * THETA + 1.0, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(recording.column("t_s"), np.arange(N) / 100.0)


def write_csv(path, header, separator=",", columns=(U, THETA)):
    rows = [separator.join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join(([header] if header else []) + rows) + "\n")
    return path


def test_csv_with_blanks_in_its_header(tmp_path):
    file = write_csv(tmp_path / "r7.csv", " u,  theta ", ", ")
    run = mapped(tmp_path, file, HEAD + COLUMNS + TAIL)
    assert_imported(run)
    assert run.recordings[0].info.file == "r7.parquet"
    assert run.recordings[0].info.closed_loop is False


def test_outputs_and_further_excited_loops_of_a_map(tmp_path):
    file = write_csv(tmp_path / "r7.csv", "u,theta")
    second = '[[loop]]\nname = "other"\ncontrol = "v_v"\noutput = "theta_rad"\n\n[recording]'
    columns = COLUMNS + 'v_v = { from = "u", unit = "V" }\n'
    tail = TAIL.replace("[recording]", second) + 'excites_also = ["other"]\n'
    run = mapped(tmp_path, file, HEAD + 'outputs = ["theta_rad", "u_v + v_v"]\n' + columns + tail)
    assert run.outputs == ("theta_rad", "u_v + v_v")
    assert run.recordings[0].info.excited == ("axis", "other")
    ls.write(run, tmp_path / "run")
    back = ls.read(tmp_path / "run")
    assert (back.outputs, back.recordings[0].info) == (run.outputs, run.recordings[0].info)


@pytest.mark.parametrize(("word", "separator"), [("tab", "\t"), (";", ";"), ("blank", "  ")])
def test_csv_without_a_header_by_number(tmp_path, word, separator):
    file = write_csv(tmp_path / "r.txt", "a line for people", separator)
    columns = COLUMNS.replace('from = "u"', "column = 1").replace('from = "theta"', "column = 2")
    layout = f'[csv]\nseparator = "{word}"\nheader = false\nskip_rows = 1\n'
    assert_imported(mapped(tmp_path, file, HEAD + layout + columns + TAIL))


def test_csv_with_decimal_commas(tmp_path):
    file = tmp_path / "r.csv"
    file.write_text(
        "u;theta\n"
        + "".join(f"{a!r};{b!r}\n".replace(".", ",") for a, b in zip(U.tolist(), THETA.tolist(), strict=True))
    )
    layout = '[csv]\nseparator = ";"\ndecimal = ","\n'
    assert_imported(mapped(tmp_path, file, HEAD + layout + COLUMNS + TAIL))


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("shape", [(-1, 1), (1, -1)])
def test_mat_of_version_5(tmp_path, shape, compressed):
    data = {"u": U.reshape(shape), "theta": THETA.reshape(shape), "note": "text", "s": {"a": 1.0}}
    savemat(tmp_path / "r.mat", data, do_compression=compressed)
    assert_imported(mapped(tmp_path, tmp_path / "r.mat", HEAD + COLUMNS + TAIL))


def test_a_column_and_a_row_of_an_array(tmp_path):
    savemat(tmp_path / "r.mat", {"data": np.stack([THETA, U], axis=1), "log": np.stack([U, THETA])})
    for picked in ('from = "data", column', 'from = "log", row'):
        first, second = ("2", "1") if "column" in picked else ("1", "2")
        columns = COLUMNS.replace('from = "u"', f"{picked} = {first}").replace('from = "theta"', f"{picked} = {second}")
        assert_imported(mapped(tmp_path, tmp_path / "r.mat", HEAD + columns + TAIL))


def test_mat_of_version_7_3(tmp_path):
    with h5py.File(tmp_path / "r.mat", "w", userblock_size=512) as file:
        file["u"] = U[None, :]  # MATLAB's (n, 1) lies transposed
        file["data"] = np.stack([U, THETA])  # MATLAB's (n, 2)
        file.create_group("#refs#")
    text = HEAD + COLUMNS.replace('from = "theta"', 'from = "data", column = 2') + TAIL
    assert_imported(mapped(tmp_path, tmp_path / "r.mat", text))


def test_npz_and_parquet(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    np.savez(tmp_path / "r.npz", u=U, theta=THETA)
    pq.write_table(pa.table({"u": U, "theta": THETA, "who": ["me"] * N}), tmp_path / "r.parquet")
    assert_imported(mapped(tmp_path, tmp_path / "r.npz", HEAD + COLUMNS + TAIL))
    assert_imported(mapped(tmp_path, tmp_path / "r.parquet", HEAD + COLUMNS + TAIL))


def test_whole_numbers_become_floats(tmp_path):
    savemat(tmp_path / "r.mat", {"u": np.arange(N, dtype=np.uint8)[:, None], "theta": np.arange(N, dtype=np.int16)})
    recording = mapped(tmp_path, tmp_path / "r.mat", HEAD + COLUMNS + TAIL).recordings[0]
    np.testing.assert_allclose(recording.column("u_v"), np.arange(N) / 1000.0)
    assert recording.column("u_v").dtype == np.float64


def test_rows_and_stamps_are_cut_together(tmp_path):
    t = 7.0 + np.arange(N) / 100.0
    t[:50] = 0.0  # a broken start that is left out
    file = write_csv(tmp_path / "r.csv", "t,u,theta", columns=(1000.0 * t, U, THETA))
    text = (
        HEAD + 'time = { from = "t", unit = "ms" }\n' + COLUMNS + TAIL + 'from_row = 51\nto_row = 150\nname = "part"\n'
    )
    recording = mapped(tmp_path, file, text).recordings[0]
    np.testing.assert_allclose(recording.column("u_v"), U[50:150] / 1000.0)
    assert recording.column("t_s")[0] == 0.0
    assert recording.info.name == "part"


def test_resampling_says_what_it_did(tmp_path):
    t = np.arange(N) / 100.0
    t[100:] += 0.25
    file = write_csv(tmp_path / "r.csv", "t,u,theta", columns=(t, np.sin(t), t))
    text = HEAD + 'time = { from = "t", unit = "s" }\nresample = true\n' + COLUMNS + TAIL
    run = mapped(tmp_path, file, text)
    u = run.recordings[0].column("u_v")
    assert u.size == N + 25
    np.testing.assert_allclose(1000.0 * u[120:], np.sin(np.arange(120, u.size) / 100.0), atol=0.01)
    assert "1 gaps of over 1.5 steps, the largest 0.26 s" in run.extra["notes"][1]


def test_several_files_go_into_one_run(tmp_path):
    for name in ("a", "b"):
        ls.write(
            mapped(tmp_path, write_csv(tmp_path / f"{name}.csv", "u,theta"), HEAD + COLUMNS + TAIL), tmp_path / "run"
        )
    back = ls.read(tmp_path / "run")
    assert [r.info.name for r in back.recordings] == ["a", "b"]
    assert back.extra["notes"] == ["a: imported from a.csv", "b: imported from b.csv"]


def test_own_mat_reader_agrees_with_scipy(tmp_path):
    kinds = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
    data = {f"x_{kind}": np.arange(24).reshape(2, 3, 4).astype(kind) for kind in kinds}
    data |= {"small": np.array([[3]], dtype="u1"), "empty": np.empty((0, 3)), "flag": np.array([[True, False]])}
    for compressed in (False, True):
        savemat(tmp_path / "r.mat", data, do_compression=compressed)
        ours, theirs = read_mat5(tmp_path / "r.mat"), loadmat(tmp_path / "r.mat")
        assert set(ours) == set(data)
        for name in data:
            np.testing.assert_array_equal(ours[name], theirs[name])


@needs_data
def test_own_mat_reader_agrees_with_scipy_on_real_files():
    files = sorted(DATA.glob("*/*.mat"))
    for file in files:
        ours, theirs = read_mat5(file), loadmat(file)
        numbers = [name for name, values in ours.items() if values.dtype != object]
        assert numbers
        for name in numbers:
            np.testing.assert_array_equal(ours[name], theirs[name])


@needs_data
def test_tokyo_bench(tmp_path):
    text = """
format = "loopshape-map/1"
rate_hz = 2500.0
[columns]
iq_a = { from = "iq_adx", unit = "A" }
theta_m_rad = { from = "theta_mx", unit = "rad" }
theta_l_rad = { from = "theta_my", unit = "rad", sign = -1 }
[[loop]]
name = "motor"
control = "iq_a"
output = "theta_m_rad"
[recording]
kind = "multisine"
injection = "control"
excites = "motor"
period_s = 1.0
periodic_from_s = 0.0
"""
    source = DATA / "tokyo_bench" / "MultisineTypeA.mat"
    ls.write(mapped(tmp_path, source, text), tmp_path / "run")
    run = ls.read(tmp_path / "run")
    recording = run.recording("MultisineTypeA")
    assert recording.column("t_s").size == 50_000
    np.testing.assert_array_equal(recording.column("theta_l_rad"), -loadmat(source)["theta_my"].ravel())
    spectrum = np.abs(np.fft.rfft(recording.column("iq_a")[-2500:]))
    assert spectrum[11:251].min() > 5.0 * spectrum[251:].max()  # lines at 11 to 250 Hz, on a grid of 1 Hz
    assert check_recordings(run) == []


@needs_data
def test_qube(tmp_path):
    text = """
format = "loopshape-map/1"
rate_hz = 500.0
time = { from = "t", unit = "s" }
[columns]
r_theta_rad = { from = "target_theta", unit = "rad" }
theta_rad = { from = "theta", unit = "rad" }
u_v = { from = "plant_input", unit = "V" }
[[loop]]
name = "theta"
reference = "r_theta_rad"
control = "u_v"
output = "theta_rad"
[recording]
kind = "profile"
injection = "reference"
"""
    source = next(iter(sorted((DATA / "qube").glob("*.csv"))))
    run = mapped(tmp_path, source, text)
    assert run.recordings[0].column("theta_rad").size == 10_000
    assert run.recordings[0].column("u_v")[0] == -10.0  # saturated at the start, as its page says
    assert run.recordings[0].info.closed_loop


@needs_data
def test_pneumatic_cylinder(tmp_path):
    text = """
format = "loopshape-map/1"
rate_hz = 100.0
time = { column = 1, unit = "ms" }
resample = true
csv = { separator = "tab", header = false }
[columns]
stroke_v = { column = 2, unit = "V" }
pressure_bar = { column = 6, unit = "bar" }
force_n = { column = 7, unit = "N" }
[[loop]]
name = "cylinder"
control = "pressure_bar"
output = "force_n"
[recording]
kind = "open_loop"
injection = "control"
"""
    run = mapped(tmp_path, DATA / "pneumatic_cylinder" / "friction_Kidney_1bar.csv", text)
    assert run.recordings[0].column("force_n").size == 5998
    assert run.recordings[0].column("force_n")[0] == 50.346
    assert "resampled to 100 Hz" in run.extra["notes"][1]
    assert "the largest 0.272 s" in run.extra["notes"][1]
