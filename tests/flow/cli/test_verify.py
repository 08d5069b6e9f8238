"""`loopshape verify`: a run is what was recorded, or it is said what is not; a damaged table is never read as good."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_nouns import RecordingInfo
from commands import invoked
from run_files import add_recording, read_journal, read_toml, start_run, verify, write_toml

import loopshape as ls
from loopshape import __version__
from loopshape.io.provenance import file_sha256, versions
from loopshape.io.run.journal import FILE, note

RATE = 100.0


def recording(name, seed=1):
    noise = np.random.default_rng(seed).normal(size=500)
    info = RecordingInfo(f"{name}.parquet", "open_loop", "control", closed_loop=False)
    return ls.Recording(info, RATE, {"z_a_v": noise, "y_rad": 2.0 * noise})


@pytest.fixture
def run(tmp_path):
    study = tmp_path / "study.toml"
    study.write_text("# a study\n")
    folder = tmp_path / "run"
    extra = {"study_sha256": file_sha256(study), "provenance": {**versions(), "seed": 3}}
    start_run(folder, ls.Run(RATE, (), (), None, {}, extra))
    add_recording(folder, recording("a", 1))
    add_recording(folder, recording("b", 2))
    return folder


def outcomes(folder, study=None):
    return {finding.what: finding.sound for finding in verify(folder, study)}


def test_a_run_as_it_was_written_is_sound(run):
    assert set(outcomes(run, run.parent / "study.toml").values()) == {True}
    result = invoked(["verify", str(run), "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout)["sound"] is True


@pytest.mark.parametrize("place", [4, 0.3, 0.6, -1])
def test_a_single_changed_bit_is_found_and_the_table_is_not_read(run, place):
    path = run / "b.parquet"
    data = bytearray(path.read_bytes())
    data[int(place * len(data)) if isinstance(place, float) else place] ^= 1
    path.write_bytes(data)
    assert outcomes(run)["table b.parquet"] is False
    assert outcomes(run)["table a.parquet"] is True
    assert invoked(["verify", str(run)]).exit_code == 1
    with pytest.raises(ls.errors.UnreadableInputError):
        ls.read(run).recording("b").column("y_rad")


def test_a_table_of_another_recording_is_found(run):
    (run / "b.parquet").write_bytes((run / "a.parquet").read_bytes())
    assert outcomes(run)["table b.parquet"] is False
    with pytest.raises(ls.errors.UnreadableInputError, match="is not the file that was written"):
        ls.read(run).recording("b").column("y_rad")


def test_another_study_is_found(run, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text("# another study\n")
    assert outcomes(run, other)["study other.toml"] is False


def test_a_recording_taken_out_after_it_was_finished_is_found(run):
    table = read_toml(run / "run.toml")
    write_toml(run / "run.toml", table | {"recording": table["recording"][:1]})
    found = outcomes(run)
    assert found["journal"] is False
    assert found["b.parquet"] is None  # a table that the run does not list


def test_what_has_no_hash_cannot_be_told(run):
    table = read_toml(run / "run.toml")
    entries = [{k: v for k, v in entry.items() if k != "sha256"} for entry in table["recording"]]
    write_toml(run / "run.toml", {k: v for k, v in table.items() if k != "provenance"} | {"recording": entries})
    found = outcomes(run)
    assert found["table a.parquet"] is None
    assert found["origin"] is None


def test_values_that_are_no_numbers_are_found(run):
    bad = recording("c", 3)
    add_recording(run, ls.Recording(bad.info, RATE, {**bad.columns, "y_rad": np.full(500, np.nan)}))
    assert outcomes(run)["columns of c.parquet"] is False


def test_a_table_says_in_itself_where_it_comes_from(run):
    said = json.loads(pq.read_schema(run / "a.parquet").metadata[b"loopshape"])
    assert said["made_by"]["loopshape"] == __version__
    assert said["study_sha256"] == read_toml(run / "run.toml")["study_sha256"]
    assert said["recording"]["kind"] == "open_loop"
    assert said["provenance"]["seed"] == 3


def test_the_same_recording_twice_gives_the_same_file(run, tmp_path):
    again = tmp_path / "again"
    start_run(again, ls.Run(RATE, (), (), None, {}, dict(ls.read(run).extra)))
    add_recording(again, recording("a", 1))
    assert (again / "a.parquet").read_bytes() == (run / "a.parquet").read_bytes()


def test_a_torn_line_of_the_journal_is_counted_and_the_next_one_stands_alone(run):
    whole = (run / FILE).read_bytes()
    (run / FILE).write_bytes(whole[:-20])
    note(run, "resumed")
    lines, torn = read_journal(run)
    assert [line["event"] for line in lines] == ["finished", "resumed"]
    assert torn == 1


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\n", b"[]\n{}\n1\n", b'{"event": 3}\n', b"{" * 5000 + b"\n"])
def test_a_journal_of_something_else_says_nothing_and_harms_nobody(run, content):
    (run / FILE).write_bytes(content)
    assert read_journal(run)[0] == []
