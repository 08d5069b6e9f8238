"""What an import refuses, and the sentence a user gets; a newcomer's mistakes are in a table of their own."""

import h5py
import numpy as np
import pytest
from fuzz_cases import said
from scipy.io import savemat

import loopshape as ls
from loopshape.toolbox.formats.tables.import_file import import_file

MAP = """
format = "loopshape-map/1"
rate_hz = 100.0
time = { from = "t", unit = "s" }

[columns]
u_v = { from = "u", unit = "V" }
x_m = { from = "x", unit = "mm" }

[[loop]]
name = "axis"
control = "u_v"
output = "x_m"

[recording]
kind = "noise"
injection = "control"
"""
N = 60


def table(**changes):
    n = np.arange(N)
    return {"t": n / 100.0, "u": np.sin(n), "x": np.cos(n)} | changes


def refused(tmp_path, *words, text=MAP, error=ls.errors.WrongUseError, file=None, **changes):
    (tmp_path / "map.toml").write_text(text)
    if file is None:
        file = tmp_path / "r.npz"
        np.savez(file, **table(**changes))
    with pytest.raises(error) as caught:
        import_file(file, tmp_path / "map.toml")
    for word in words:
        assert word in str(caught.value)


def rows_of(file):
    return import_file(file, file.with_name("map.toml")).recordings[0].column("u_v").size


def without(line):
    assert line in MAP
    return MAP.replace(line, "")


def test_maps_that_do_not_fit(tmp_path):
    refused(tmp_path, "no format", text=without('format = "loopshape-map/1"'), error=ls.errors.UnreadableInputError)
    refused(tmp_path, "map.toml", "no rate_hz", text=without("rate_hz = 100.0"))
    refused(tmp_path, "no recording", text=MAP.split("[recording]", maxsplit=1)[0])
    refused(tmp_path, "no loop", text=without('[[loop]]\nname = "axis"\ncontrol = "u_v"\noutput = "x_m"\n'))
    refused(tmp_path, "no kind", text=without('kind = "noise"'))
    refused(tmp_path, "unknown key", "'rate'", "resample", text="rate = 3\n" + MAP)
    refused(tmp_path, "recording: unknown key", "'file'", text=MAP + 'file = "a"\n')
    refused(tmp_path, "columns, u_v: unknown key", "'scale'", "gain", text=MAP.replace('"V"', '"V", scale = 2'))
    refused(
        tmp_path, "resample needs the stamps", text="resample = true\n" + without('time = { from = "t", unit = "s" }')
    )
    refused(tmp_path, "excites_also goes with excites", "axis alone", text=MAP + 'excites_also = ["axis"]\n')
    twice = MAP + 'excites = "axis"\nexcites_also = ["axis"]\n'
    refused(tmp_path, "map.toml, recording: an excited loop is named twice", text=twice)
    refused(tmp_path, "wobble", "multisine", text=MAP.replace("noise", "wobble"))
    refused(tmp_path, "plain name", text=MAP + 'name = "../x"\n', error=ls.errors.UnreadableInputError)
    refused(tmp_path, "no dot", text=MAP + 'name = "a.b"\n')
    refused(tmp_path, "separator is one character", text='csv = { separator = ",," }\n' + MAP)
    refused(tmp_path, "decimal", "are the same", text='csv = { decimal = "," }\n' + MAP)


def test_columns_that_do_not_fit(tmp_path):
    refused(tmp_path, "holds nothing of this name", "'uu'", "t, u, x", text=MAP.replace('"u"', '"uu"'))
    refused(tmp_path, "ends in _v", "'A'", "end the name in _a", text=MAP.replace('"V"', '"A"'))
    refused(tmp_path, "sign is 1 or -1", "2", text=MAP.replace('"V"', '"V", sign = 2'))
    refused(tmp_path, "no from", text=MAP.replace('from = "u", ', ""))
    refused(tmp_path, "must end in its unit", "'u'", text=MAP.replace("u_v = {", "u = {"))
    refused(tmp_path, "t_s is made from rate_hz", text=MAP.replace("u_v = {", "t_s = {"))
    refused(tmp_path, "does not make", "y_m", "u_v, x_m", text=MAP.replace('output = "x_m"', 'output = "y_m"'))
    sums = 'outputs = ["x_m + y_m"]\n' + MAP
    refused(tmp_path, "map.toml: outputs name columns that [columns] does not make", "y_m", "u_v, x_m", text=sums)
    refused(tmp_path, "adds different units", text='outputs = ["x_m + u_v"]\n' + MAP)
    refused(tmp_path, "list of texts", text='outputs = "x_m"\n' + MAP)
    refused(tmp_path, "counts from 1", text=MAP.replace('"V"', '"V", column = 0'))
    refused(tmp_path, "has one dimension", text=MAP.replace('"V"', '"V", column = 1'))
    refused(tmp_path, "60 x 2", "counted from 1", u=np.ones((N, 2)))
    refused(tmp_path, "60 x 2", "column 3", text=MAP.replace('"V"', '"V", column = 3'), u=np.ones((N, 2)))
    refused(tmp_path, "60 x 2 x 2", u=np.ones((N, 2, 2)))
    refused(tmp_path, "not an array of real numbers", "complex128", u=np.ones(N) * 1j)
    refused(tmp_path, "not an array of real numbers", "<U1", u=np.array(["a"] * N))
    refused(tmp_path, "differ in length", "u_v 59", "x_m 60", u=np.ones(N - 1))


def test_rows_that_do_not_fit(tmp_path):
    refused(tmp_path, "to_row lies above from_row", text=MAP + "from_row = 9\nto_row = 3\n")
    refused(tmp_path, "has 60 rows", "rows 1 to 61", text=MAP + "to_row = 61\n")
    nan = np.where(np.arange(N) == 4, np.nan, 1.0)
    refused(tmp_path, "1 values that are not numbers", "row 5", u=nan, error=ls.errors.BadSignalError)


def test_stamps_that_do_not_fit(tmp_path):
    t = np.arange(N) / 100.0
    gap = t + 0.1 * (np.arange(N) > 20)
    refused(tmp_path, "leave the rate of 100 Hz at row 21", "resample = true", t=gap, error=ls.errors.BadSignalError)
    resampled = "resample = true\n" + MAP
    back = t - 0.1 * (np.arange(N) > 20)
    refused(tmp_path, "do not rise at row 22", text=resampled, t=back, error=ls.errors.BadSignalError)
    refused(tmp_path, "check the unit of time", text=resampled, t=1000.0 * t)


def test_files_that_cannot_be_read(tmp_path):
    missing = {"error": ls.errors.UnreadableInputError, "file": tmp_path / "none.mat"}
    refused(tmp_path, "does not exist", "none.mat", **missing)
    refused(tmp_path, "of this kind", ".npz", error=ls.errors.UnreadableInputError, file=tmp_path / "r.xlsx")
    with pytest.raises(ls.errors.UnreadableInputError, match=r"none\.toml"):
        import_file(tmp_path / "r.npz", tmp_path / "none.toml")


@pytest.mark.parametrize("ending", ["mat", "npz", "parquet", "csv"])
@pytest.mark.parametrize(
    "content", [b"", b"\x00" * 9, b"\x00\xff" * 300, b"MATLAB 5.0 MAT-file".ljust(126) + b"IM" + b"\x0e" * 40]
)
def test_foreign_content(tmp_path, ending, content):
    (tmp_path / f"r.{ending}").write_bytes(content)
    refused(tmp_path, f"r.{ending}", error=ls.errors.UnreadableInputError, file=tmp_path / f"r.{ending}")


@pytest.mark.parametrize("kind", ["mat5", "mat5z", "mat73", "npz"])
def test_damaged_content_ends_in_a_sentence_or_in_as_many_rows(tmp_path, kind):
    file = tmp_path / ("r.npz" if kind == "npz" else "r.mat")
    if kind == "npz":
        np.savez(file, **table())
    elif kind == "mat73":
        with h5py.File(file, "w") as made:
            for name, values in table().items():
                made[name] = values[None, :]
    else:
        savemat(file, table(), do_compression=kind == "mat5z")
    (tmp_path / "map.toml").write_text(MAP)
    whole, rng, rows = file.read_bytes(), np.random.default_rng(0), []
    for cut in rng.integers(1, len(whole), 40):
        flipped = bytearray(whole)
        flipped[cut - 1] ^= 0x55
        file.write_bytes(whole[:cut])
        assert said(lambda: import_file(file, tmp_path / "map.toml"))
        file.write_bytes(bytes(flipped))
        assert said(lambda: rows.append(rows_of(file))) or rows.pop() == N


def test_nothing_is_unpickled(tmp_path):
    np.savez(tmp_path / "p.npz", **table(u=np.array([{"a": 1}] * N, dtype=object)))
    refused(
        tmp_path,
        "p.npz cannot be read as NPZ",
        "allow_pickle",
        error=ls.errors.UnreadableInputError,
        file=tmp_path / "p.npz",
    )


def test_links_in_a_mat_file_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as secret:
        secret["u"] = np.ones(N)
    with h5py.File(tmp_path / "r.mat", "w") as file:
        file["t"], file["x"] = np.arange(N) / 100.0, np.ones(N)
        file["u"] = h5py.ExternalLink("secret.h5", "/u")
    refused(tmp_path, "holds nothing of this name", "'u'", "t, x", file=tmp_path / "r.mat")


def test_a_structure_is_no_signal_and_its_members_are_named(tmp_path):
    savemat(tmp_path / "r.mat", table(u={"a": 1.0}))
    refused(tmp_path, "holds nothing of this name", "it holds t, u.a, x", file=tmp_path / "r.mat")


def test_a_headerless_table_is_picked_by_number(tmp_path):
    (tmp_path / "r.csv").write_text("1,2,3\n4,5,6\n")
    text = "csv = { header = false }\n" + MAP
    refused(tmp_path, "no header", "column = 1 to 3", text=text, file=tmp_path / "r.csv")
    numbered = text.replace('from = "u"', "column = 4")
    refused(tmp_path, "no header", "column=4", text=numbered, file=tmp_path / "r.csv")
