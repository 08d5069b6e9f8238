"""The page of logs: each block of it writes the file that it says, and the draft of its map gives the plant."""

import re
from pathlib import Path

import numpy as np
import pytest

import loopshape as ls
from loopshape.toolbox.formats.drafts.draft_map import draft_map, write_draft
from loopshape.toolbox.formats.tables.import_file import import_file

PAGE = (Path(__file__).parents[4] / "docs/logs.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.S)
LOOP = next(block for block in BLOCKS if "speed" in block)
STATES_UNITS = ("tdms", "mf4", "csv")
NEEDS = {
    "tdms": "nptdms", "mf4": "asammdf", "mat": "scipy", "json": "json", "wav": "scipy", "mcap": "mcap", "csv": "csv",
    "bag": "rosbags",
}  # fmt: skip


def written(ending, folder, monkeypatch):
    """The file that the page's block writes, behind the loop that is in it."""
    pytest.importorskip(NEEDS[ending])
    monkeypatch.chdir(folder)
    exec(LOOP + next(block for block in BLOCKS if f"try.{ending}" in block), {})
    return folder / f"try.{ending}"


def plant(f_hz, rate_hz=500.0):
    """10/(s (s + 2)) as the page's loop steps it: Euler's rule, the control of a sample in that sample's speed."""
    z = np.exp(2j * np.pi * f_hz / rate_hz)
    s = rate_hz * (z - 1.0)
    return 10.0 * z / (s * (s + 2.0))


def test_every_block_is_tried():
    assert {ending for block in BLOCKS for ending in re.findall(r"try\.(\w+)", block)} == set(NEEDS)


@pytest.mark.long
@pytest.mark.parametrize("ending", ["tdms", "mf4", "mat", "json", "csv", "bag"])
def test_the_draft_is_taken_and_the_response_is_the_plant(ending, tmp_path, monkeypatch):
    file = written(ending, tmp_path, monkeypatch)
    draft = draft_map(file)
    assert not draft.open
    assert draft.rate_hz == pytest.approx(500.0)
    assert {rule["unit"] for rule in draft.table["columns"].values()} == {"rad" if ending in STATES_UNITS else "1"}
    write_draft(tmp_path / "m.toml", draft, file)
    frf = ls.frf(import_file(file, tmp_path / "m.toml", accept_draft=True))
    mine = frf.valid_lines()
    wrong = np.abs(mine.siso / plant(mine.frequency_hz) - 1.0)
    assert mine.frequency_hz.size > 20
    assert np.median(wrong) < 0.02


def test_what_names_no_channel_is_asked(tmp_path, monkeypatch):
    draft = draft_map(written("wav", tmp_path, monkeypatch))
    assert draft.rate_hz == 500.0
    assert draft.open


def test_messages_in_json_keep_their_stamps(tmp_path, monkeypatch):
    assert draft_map(written("mcap", tmp_path, monkeypatch)).rate_hz == 200.0
