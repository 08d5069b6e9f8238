"""What a run folder refuses, and the sentence a user gets."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from run_files import add_recording, check_recordings, start_run

import loopshape as ls
from loopshape.io.run.tables import TableColumns, check_rate, write_table

HEAD = 'format = "loopshape-run/1"\nrate_hz = 100.0\n'
LOOP = '[[loop]]\nname = "x"\ncontrol = "z_v"\noutput = "x_m"\n'
ENTRY = '[[recording]]\nfile = "r01.parquet"\nkind = "sweep"\ninjection = "control"\n'


def folder_with(tmp_path, text, data=None):
    (tmp_path / "run.toml").write_text(text)
    n = np.arange(20)
    write_table(tmp_path / "r01.parquet", data or {"t_s": n / 100.0, "z_v": np.sin(n), "x_m": np.cos(n)})
    return tmp_path


def refused(tmp_path, text, *words, error=ls.errors.WrongUseError):
    with pytest.raises(error) as caught:
        ls.read(folder_with(tmp_path, text))
    for word in words:
        assert word in str(caught.value)


def test_the_smallest_run_is_read(tmp_path):
    assert ls.read(folder_with(tmp_path, HEAD + LOOP + ENTRY)).recordings[0].info.closed_loop is False


def test_words_that_do_not_fit(tmp_path):
    refused(
        tmp_path,
        HEAD.replace("run/1", "run/9"),
        "loopshape-run/1",
        "loopshape-run/9",
        error=ls.errors.UnreadableInputError,
    )
    refused(tmp_path, "rate_hz = 1.0\n", "no format", error=ls.errors.UnreadableInputError)
    refused(tmp_path, 'format = "loopshape-run/1"\n', "no rate_hz")
    refused(tmp_path, HEAD.replace("100.0", "-1"), "rate_hz", "positive")
    refused(tmp_path, HEAD.replace("100.0", "nan"), "rate_hz", "finite number")
    refused(tmp_path, HEAD.replace("100.0", "1" + "0" * 400), "rate_hz", "finite number")
    refused(tmp_path, HEAD.replace("100.0", "true"), "rate_hz", "finite number")
    refused(tmp_path, HEAD + "plant = 3\n", "plant", "text")
    refused(tmp_path, HEAD + "[pwm]\nfrequency_hz = 'x'\n", "pwm", "frequency_hz")
    refused(tmp_path, HEAD + "loop = 3\n", "loop", "list of tables")


def test_loops_that_do_not_fit(tmp_path):
    refused(tmp_path, HEAD + LOOP.replace('control = "z_v"', ""), "run.toml, loop 'x'", "no control")
    refused(tmp_path, HEAD + LOOP + 'colour = "red"\n', "unknown key", "'colour'", "reference")
    refused(tmp_path, HEAD + LOOP + LOOP, "two loops have one name", "'x'")
    refused(tmp_path, HEAD + LOOP.replace("x_m", "x"), "loop 'x'", "must end in its unit")
    refused(tmp_path, HEAD + LOOP.replace('"x_m"', '"x_m + p_bar"'), "adds different units")
    refused(tmp_path, HEAD + LOOP + "controller = []\n", "no block")
    refused(tmp_path, HEAD + LOOP + "controller = [3]\n", "controller", "list of tables")
    refused(tmp_path, HEAD + LOOP + "controller = [{ kind = [1] }]\n", "kind", "text")
    refused(tmp_path, HEAD + LOOP + 'controller = [{ kind = "lead" }]\n', "block is not known", "lead_lag")
    refused(tmp_path, HEAD + LOOP + 'controller = [{ kind = "gain", gain = "1" }]\n', "gain", "finite number")
    discretised = 'discretisation = "euler"\ncontroller = [{ kind = "gain", gain = 1 }]\n'
    refused(tmp_path, HEAD + LOOP + discretised, "euler", "tustin")


def test_recordings_that_do_not_fit(tmp_path):
    start = HEAD + LOOP
    refused(tmp_path, start + ENTRY.replace('kind = "sweep"', ""), "recording 'r01.parquet'", "no kind")
    refused(tmp_path, start + ENTRY.replace("sweep", "wobble"), "wobble", "multisine")
    refused(tmp_path, start + ENTRY.replace('"control"', '"valve"'), "valve", "plant_input")
    refused(tmp_path, start + ENTRY + 'role = "both"\n', "both", "validation")
    refused(tmp_path, start + ENTRY + "closed_loop = 1\n", "closed_loop", "true or false")
    refused(tmp_path, start + ENTRY + "rate = 1\n", "unknown key", "'rate'")
    refused(tmp_path, start + ENTRY + 'excites = "y"\n', "excites names no loop", "'y'", "x")
    refused(tmp_path, start + ENTRY + "period_s = 0\n", "period_s", "positive")
    refused(tmp_path, start + ENTRY + "operating_point = { a = 'b' }\n", "operating_point", "finite number")
    refused(tmp_path, start + ENTRY + ENTRY, "two recordings have one name", "'r01'")
    refused(
        tmp_path, start + ENTRY.replace("r01", "r02"), "missing", "r02.parquet", error=ls.errors.UnreadableInputError
    )
    refused(tmp_path, start + ENTRY.replace(".parquet", ".xlsx"), "table's kind", ".csv.gz")


def test_further_excited_loops_that_do_not_fit(tmp_path):
    start = HEAD + LOOP + LOOP.replace('"x"', '"y"')
    refused(tmp_path, start + ENTRY + 'excites_also = ["y"]\n', "excites_also goes with excites", "y alone", "first")
    excited = start + ENTRY + 'excites = "x"\n'
    refused(tmp_path, excited + 'excites_also = ["q"]\n', "recording 'r01.parquet': excites_also names no loop", "x, y")
    refused(tmp_path, excited + 'excites_also = ["y", "y"]\n', "named twice", "x, y, y", "each once")
    refused(tmp_path, excited + 'excites_also = ["x"]\n', "named twice", "x, x")
    for wrong in ('"y"', "3", "[3]", '[""]', "{}"):
        refused(tmp_path, excited + f"excites_also = {wrong}\n", "excites_also", "list of texts in quotes")
    folder_with(tmp_path, excited + "excites_also = []\n")
    assert ls.read(tmp_path).recordings[0].info.excited == ("x",)


def test_outputs_that_do_not_fit(tmp_path):
    refused(tmp_path, HEAD + 'outputs = "x_m"\n', "run.toml: outputs must be a list of texts")
    refused(tmp_path, HEAD + 'outputs = ["x"]\n', "run.toml: a column's name must end in its unit", "'x'", "_m_s2")
    refused(tmp_path, HEAD + 'outputs = ["x_m", "x_m + p_bar"]\n', "one of outputs adds different units", "x_m + p_bar")
    refused(tmp_path, HEAD + 'outputs = ["x_m - y_m"]\n', "a column or a sum of columns", "x_m - y_m")
    refused(tmp_path, HEAD + 'outputs = ["x_m+y_m", "x_m + y_m"]\n', "two outputs have one name", "x_m + y_m")
    with pytest.raises(ls.errors.WrongUseError, match="the run: one of outputs adds different units"):
        start_run(tmp_path / "new", replace(run(), outputs=("x_m + z_v",)))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "name", ["../r01.parquet", "/etc/r01.parquet", "a\\\\r01.parquet", "..", "sub/r01.parquet", ""]
)
def test_a_recording_stays_inside_its_folder(tmp_path, name):
    refused(tmp_path, HEAD + ENTRY.replace("r01.parquet", name), "plain name", error=ls.errors.UnreadableInputError)


def test_a_link_that_leaves_the_folder_is_refused(tmp_path):
    outside = tmp_path / "outside.parquet"
    write_table(outside, {"x_m": np.ones(3)})
    (tmp_path / "run").mkdir()
    folder = folder_with(tmp_path / "run", HEAD + ENTRY)
    (folder / "r01.parquet").unlink()
    (folder / "r01.parquet").symlink_to(outside)
    with pytest.raises(ls.errors.UnreadableInputError, match="leaves its folder"):
        ls.read(folder)


def test_a_run_is_a_folder_with_run_toml(tmp_path):
    with pytest.raises(ls.errors.UnreadableInputError, match="a run is a folder"):
        ls.read(tmp_path / "nothing")
    with pytest.raises(ls.errors.UnreadableInputError, match=r"has a run\.toml; received .* without one; write one"):
        ls.read(tmp_path)


def test_damaged_files(tmp_path):
    (tmp_path / "run.toml").write_bytes(b"\xff\xfe = [")
    with pytest.raises(ls.errors.UnreadableInputError, match=r"run\.toml cannot be read as TOML"):
        ls.read(tmp_path)
    (tmp_path / "run.toml").write_text("a = " + "[" * 5000)
    with pytest.raises(ls.errors.UnreadableInputError, match="TOML"):
        ls.read(tmp_path)
    folder_with(tmp_path, HEAD + LOOP + ENTRY)
    whole = (tmp_path / "r01.parquet").read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", whole[:-20] + b"x" * 20):
        (tmp_path / "r01.parquet").write_bytes(damaged)
        with pytest.raises(ls.errors.UnreadableInputError, match=r"r01\.parquet cannot be read as Parquet"):
            ls.read(tmp_path).recordings[0].column("x_m")


def test_a_text_column_is_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"x_m": ["a", "b"]}), tmp_path / "r.parquet")
    with pytest.raises(ls.errors.UnreadableInputError, match=r"x_m of r\.parquet is not of numbers; received string"):
        TableColumns(tmp_path / "r.parquet")["x_m"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a_v,b_v\n1,2\n3,oops\n", r"b_v.*'oops' in row 1"),
        ("a_v,b_v\n1,2,3\n", r"names 2 columns; received rows of 3"),
        ("a_v,b_v\n1,2\n1,2,3\n", r"cannot be read as CSV"),
        ("a_v,a_v\n1,2\n", r"a name of its own"),
        ("", r"is empty"),
        ("a_v,b_v\n", r"a header and no rows"),
    ],
)
def test_damaged_csv(tmp_path, text, words):
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(ls.errors.UnreadableInputError, match=words):
        TableColumns(tmp_path / "r.csv")["b_v"]


def test_a_cut_gzip_is_refused(tmp_path):
    import gzip

    whole = gzip.compress(b"a_v\n" + b"\n".join(b"%d" % (k**3) for k in range(2000)))
    (tmp_path / "r.csv.gz").write_bytes(whole[:500])
    with pytest.raises(ls.errors.UnreadableInputError, match="cannot be read as CSV"):
        TableColumns(tmp_path / "r.csv.gz")["a_v"]
    (tmp_path / "r.csv.gz").write_bytes(b"a_v\n1\n")
    with pytest.raises(ls.errors.UnreadableInputError, match="cannot be read as CSV"):
        list(TableColumns(tmp_path / "r.csv.gz"))


def test_stamps_that_leave_the_rate(tmp_path):
    t = np.arange(100) / 100.0
    with pytest.raises(
        ls.errors.BadSignalError, match=r"at row 51; received a step of 0\.03 s where 0\.01 s is due, 1 such"
    ):
        check_rate(t + 0.02 * (np.arange(100) > 50), 100.0)
    with pytest.raises(ls.errors.BadSignalError, match=r"all 100 of them keep 100\.1 Hz"):
        check_rate(np.arange(100) / 100.1, 100.0)
    with pytest.raises(ls.errors.BadSignalError, match="no time stamp in row 3"):
        check_rate(np.where(np.arange(100) == 3, np.nan, t), 100.0)
    folder = folder_with(tmp_path, HEAD + ENTRY, {"t_s": 2.0 * t, "x_m": t})
    with pytest.raises(ls.errors.BadSignalError, match=r"r01\.parquet leave the rate of 100 Hz"):
        ls.read(folder).recordings[0].column("x_m")


def run(*recordings, rate_hz=100.0, plant=None):
    return ls.Run(rate_hz, (LoopSetup("x", None, "n_m", "z_v", "x_m", None),), recordings, plant)


def recording(**changes):
    n = np.arange(50)
    data = {"n_m": np.sin(n), "z_v": np.sin(2.0 * n), "x_m": np.sin(3.0 * n)}
    info = RecordingInfo("r01.parquet", "sweep", "controller_input", excites="x")
    return replace(ls.Recording(info, 100.0, data), **changes)


def test_a_foreign_folder_is_not_written_into(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ls.errors.WrongUseError, match=r"no run is not written into.*thesis\.txt"):
        start_run(tmp_path, run())
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


def test_another_run_is_not_overwritten(tmp_path):
    ls.write(run(recording()), tmp_path)
    with pytest.raises(ls.errors.WrongUseError, match="already holds another run; received different plant, rate_hz"):
        start_run(tmp_path, run(rate_hz=200.0, plant="arm-1dof"))


def test_recordings_that_are_not_added(tmp_path):
    ls.write(run(recording()), tmp_path)
    info = recording().info
    with pytest.raises(ls.errors.WrongUseError, match="already holds a recording of this name; received 'r01'"):
        add_recording(tmp_path, recording())
    with pytest.raises(ls.errors.WrongUseError, match=r"at 100 Hz; received r02\.parquet at 50 Hz"):
        add_recording(tmp_path, recording(info=replace(info, file="r02.parquet"), rate_hz=50.0))
    with pytest.raises(ls.errors.WrongUseError, match=r"a \.parquet file"):
        add_recording(tmp_path, recording(info=replace(info, file="r02.csv")))
    with pytest.raises(ls.errors.UnreadableInputError, match="plain name"):
        add_recording(tmp_path, recording(info=replace(info, file="../r02.parquet")))
    with pytest.raises(ls.errors.WrongUseError, match="excites names no loop"):
        add_recording(tmp_path, recording(info=replace(info, file="r02.parquet", excites="y")))
    with pytest.raises(ls.errors.WrongUseError, match="excites_also names no loop"):
        add_recording(tmp_path, recording(info=replace(info, file="r02.parquet", excites_also=("y",))))
    with pytest.raises(ls.errors.WrongUseError, match="equally long"):
        add_recording(tmp_path, recording(info=replace(info, file="r02.parquet"), columns={"a_v": [1.0], "b_v": []}))
    data = {"t_s": np.arange(5.0)}
    with pytest.raises(ls.errors.BadSignalError, match="leave the rate"):
        add_recording(tmp_path, recording(info=replace(info, file="r02.parquet"), columns=data))
    assert len(ls.read(tmp_path).recordings) == 1


def test_a_signal_that_must_move_and_does_not():
    for name in ("n_m", "z_v", "x_m"):
        data = dict(recording().columns) | {name: np.full(50, 2.5)}
        with pytest.raises(
            ls.errors.BadSignalError, match=rf"{name} of recording r01\.parquet does not move.*2\.5 in all 50"
        ):
            check_recordings(run(recording(columns=data)))


def test_values_that_are_not_numbers():
    data = dict(recording().columns) | {"other_v": np.where(np.arange(50) == 7, np.nan, 1.0)}
    with pytest.raises(ls.errors.BadSignalError, match=r"other_v.*1 values that are not numbers.*row 7"):
        check_recordings(run(recording(columns=data)))
    with pytest.raises(ls.errors.BadSignalError, match="has no rows"):
        check_recordings(run(recording(columns={"x_m": np.empty(0)})))
