"""Datasets in LeRobot's layout, written here by pyarrow after its info.json: read as the numbers that went in."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from run_files import CsvShape

import loopshape as ls
from loopshape.toolbox.formats.drafts.draft_map import draft_map
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.formats.tables.sources import Place, open_source

FPS = 30
JOINTS = ["shoulder_pan.pos", "shoulder_lift.pos", "gripper.pos"]
ROWS = {0: 150, 1: 240, 2: 180}  # frames of each episode


def command(episode):
    """Commanded and measured angles (n, 3) in degrees: an arm that lags behind its leader."""
    rng = np.random.default_rng(episode)
    u = np.cumsum(rng.normal(size=(ROWS[episode], 3)), axis=0)
    y = np.zeros_like(u)
    for k in range(1, len(u)):
        y[k] = 0.6 * y[k - 1] + 0.4 * u[k - 1]
    return u, y


def frames(episode):
    u, y = command(episode)
    k = np.arange(ROWS[episode])
    return {
        "action": u.astype(np.float32), "observation.state": y.astype(np.float32),
        "timestamp": (k / FPS).astype(np.float32), "frame_index": k,
        "episode_index": np.full(k.size, episode), "index": k + sum(n for e, n in ROWS.items() if e < episode),
        "task_index": np.zeros(k.size, dtype=int),
    }  # fmt: skip


def write(root, version, *, names=JOINTS, kind=None):
    """`meta/info.json` and the Parquet files of a dataset; v2.1 a file an episode, v3.0 one file of all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    template = {
        "v2.1": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "v3.0": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    }[version]
    features = {c: {"dtype": "float32", "shape": [3], "names": names} for c in ("action", "observation.state")}
    features |= {"timestamp": {"dtype": "float32", "shape": [1], "names": None}}
    info = {
        "codebase_version": version, "robot_type": "so101_follower", "total_episodes": 3, "chunks_size": 1000,
        "fps": FPS, "splits": {"train": "0:3"}, "data_path": template, "features": features,
    }  # fmt: skip
    folder = root / "data" / "chunk-000"
    folder.mkdir(parents=True)
    (root / "meta").mkdir()
    (root / "meta" / "info.json").write_text(json.dumps(info))
    lists = kind or pa.list_(pa.float32())
    tables = [
        pa.table({c: pa.array(list(x), type=lists) if x.ndim > 1 else pa.array(x) for c, x in frames(e).items()})
        for e in ROWS
    ]
    if version == "v3.0":
        pq.write_table(pa.concat_tables(tables), folder / "file-000.parquet", row_group_size=200)
        return [folder / "file-000.parquet"]
    files = [folder / f"episode_{e:06d}.parquet" for e in ROWS]
    for file, table in zip(files, tables, strict=True):
        pq.write_table(table, file)
    return files


PAGE = (Path(__file__).parents[4] / "docs/logs.md").read_text()
MAP = re.search(r"```toml\n(# pan.toml\n.*?)```", PAGE, re.S)[1].replace("episodes = [0, 1, 2]\n", "")


def mapped(tmp_path, file, more=""):
    (tmp_path / "map.toml").write_text(MAP + more)
    return import_file(file, tmp_path / "map.toml")


def signal(file, name):
    return np.asarray(open_source(file, CsvShape()).signal(Place(name)))


def test_an_episode_a_file_by_the_names_of_info_json(tmp_path):
    file = write(tmp_path, "v2.1")[1]
    u, y = command(1)
    np.testing.assert_array_equal(signal(file, "action.shoulder_lift.pos"), u[:, 1].astype(np.float32))
    run = mapped(tmp_path, file)
    (recording,) = run.recordings
    assert recording.info.file == "episode_000001.parquet"
    np.testing.assert_allclose(recording.column("pan_rad"), np.radians(y[:, 0]), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("names", [{"motors": JOINTS}, {"axes": JOINTS}])
def test_names_by_kind_as_older_datasets_have_them(tmp_path, names):
    assert "action.gripper.pos" in open_source(write(tmp_path, "v2.1", names=names)[0], CsvShape()).names


@pytest.mark.parametrize("names", [None, ["dim"], ["pos", "pos", "gripper"]])
def test_without_a_name_for_each_entry_signals_go_by_number(tmp_path, names):
    file = write(tmp_path, "v2.1", names=names)[0]
    np.testing.assert_array_equal(signal(file, "action[2]"), command(0)[0][:, 2].astype(np.float32))


def test_lists_of_a_fixed_size_and_without_a_dataset(tmp_path):
    import pyarrow as pa

    file = write(tmp_path, "v2.1", kind=pa.list_(pa.float32(), 3))[0]
    file = file.rename(tmp_path / "alone.parquet")
    (tmp_path / "meta" / "info.json").unlink()
    np.testing.assert_array_equal(signal(file, "observation.state[1]"), command(0)[1][:, 1].astype(np.float32))


def test_several_episodes_in_a_file_are_a_recording_each(tmp_path):
    (file,) = write(tmp_path, "v3.0")
    run = mapped(tmp_path, file)
    assert [r.info.file for r in run.recordings] == [f"file-000-episode-{e}.parquet" for e in ROWS]
    for episode, recording in zip(ROWS, run.recordings, strict=True):
        expected = np.radians(command(episode)[0][:, 0])
        np.testing.assert_allclose(recording.column("pan_command_rad"), expected, rtol=1e-6, atol=1e-7)
    some = mapped(tmp_path, file, 'episodes = [2]\nrole = "validation"\n')
    assert [(r.info.file, r.info.role) for r in some.recordings] == [("file-000-episode-2.parquet", "validation")]
    with pytest.raises(ls.errors.WrongUseError, match="it holds 0, 1, 2"):
        mapped(tmp_path, file, "episodes = [3]\n")


def test_the_key_episodes_is_of_files_that_hold_several(tmp_path):
    file = write(tmp_path, "v2.1")[0]
    with pytest.raises(ls.errors.WrongUseError, match="one recording"):
        mapped(tmp_path, file, "episodes = [0]\n")
    with pytest.raises(ls.errors.WrongUseError, match="whole numbers"):
        mapped(tmp_path, file, "episodes = [0.5]\n")


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_a_draft_takes_rate_and_parts_from_the_format_and_asks_the_units(tmp_path, version):
    file = write(tmp_path, version)[-1]
    draft = draft_map(file)
    assert draft.rate_hz == FPS
    assert draft.roles == {"action.shoulder_pan.pos": "control", "observation.state.shoulder_pan.pos": "output"}
    assert all(rule["unit"] == "1" for rule in draft.table["columns"].values())
    assert any("LeRobot states no units" in question for question in draft.open)
    assert any("action.gripper.pos and observation.state.gripper.pos" in guess for guess in draft.guesses)
    assert any("3 episodes (0 to 2)" in guess for guess in draft.guesses) == (version == "v3.0")


def test_episodes_in_pieces_and_lists_that_differ_are_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    lists = pa.array([[1.0, 2.0], [3.0], [4.0, 5.0, 6.0]])
    pq.write_table(pa.table({"x": lists, "y": [1.0, 2.0, 3.0]}), tmp_path / "a.parquet")
    with pytest.raises(ls.errors.UnreadableInputError, match="differ in length"):
        signal(tmp_path / "a.parquet", "x[0]")
    pq.write_table(pa.table({"x": lists[:2], "y": [1.0, 2.0]}), tmp_path / "b.parquet")
    assert open_source(tmp_path / "b.parquet", CsvShape()).names == ("x", "y")  # as before: a column not of numbers
    with pytest.raises(ls.LoopshapeError):
        signal(tmp_path / "b.parquet", "x")
    pq.write_table(pa.table({"x": pa.array([None, None], type=lists.type), "y": [1.0, 2.0]}), tmp_path / "d.parquet")
    with pytest.raises(ls.errors.UnreadableInputError, match="differ in length"):
        signal(tmp_path / "d.parquet", "x[0]")
    pairs = pa.array([[math.pi, 1.0]] * 3)
    pq.write_table(pa.table({"x": pairs, "episode_index": [0, 1, 0]}), tmp_path / "c.parquet")
    with pytest.raises(ls.errors.BadSignalError, match="do not lie together"):
        open_source(tmp_path / "c.parquet", CsvShape())
