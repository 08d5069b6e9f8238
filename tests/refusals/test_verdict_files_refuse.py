"""A verdict's file that is foreign, damaged, of another version or changed by hand is refused with a sentence."""

import json
from pathlib import Path

import pytest
from run_files import read_json, read_verdicts, write_verdicts
from verdict_cases import checked, line, margins

import loopshape as ls


@pytest.fixture
def kept(tmp_path):
    path = tmp_path / "verdict.json"
    write_verdicts(path, [checked({"r1": margins()}, [line()])])
    return path


def refused(path, *words, error=ls.errors.UnreadableInputError):
    with pytest.raises(ls.LoopshapeError) as caught:
        read_verdicts(path)
    assert type(caught.value) is error
    for word in words:
        assert word in str(caught.value)


def changed(path, change):
    data = read_json(path)
    change(data, data["loops"][0])
    path.write_text(json.dumps(data))
    return path


def test_a_file_that_is_not_there(tmp_path):
    refused(tmp_path / "none.json", "a file does not exist", "none.json")


@pytest.mark.parametrize("text", ["", "no json", "\x00\x01", '{"format": "loopshape-verd', '{"a": 1} {"b": 2}'])
def test_a_file_that_is_no_json(tmp_path, text):
    (tmp_path / "v.json").write_text(text)
    refused(tmp_path / "v.json", "v.json cannot be read as JSON")


@pytest.mark.parametrize("text", ["[]", "3", "{}", '{"format": "loopshape-fits/1", "fits": []}', '{"format": 1}'])
def test_a_file_of_another_kind(tmp_path, text):
    (tmp_path / "v.json").write_text(text)
    refused(tmp_path / "v.json", "is not of the format loopshape-verdict/3", "--save-verdict")


def test_a_file_of_another_version(kept):
    changed(kept, lambda data, _: data.update(format="loopshape-verdict/4"))
    refused(kept, "loopshape-verdict/4", "another version of loopshape")


def test_a_file_of_the_first_version_is_read_in_the_words_of_this_one():
    (one,) = read_verdicts(Path(__file__).parent / "data" / "verdict_1.json")
    lines = {line.quantity: line for line in one.lines}
    line = lines["gain_margin_db"]
    assert (line.required, line.value, line.slack) == (5.0, 7.979275303807414, 2.8654306280045816)
    assert one.margins["type-a"].detuning.lost.required == 5.999999999999998


def test_an_operating_point_of_the_first_version_keeps_its_name(tmp_path):
    text = (Path(__file__).parent / "data" / "verdict_1.json").read_text()
    (tmp_path / "v.json").write_text(text.replace('"type-a"', '"found"'))
    (one,) = read_verdicts(tmp_path / "v.json")
    assert [*one.data] == [*one.margins] == ["found"]


def test_a_file_that_an_earlier_program_kept_is_read_and_written_as_it_was(tmp_path):
    """`verdict_2.json` was written before margins were a mapping of readings."""
    file = Path(__file__).parent / "data" / "verdict_2.json"
    raw, found = read_json(file), read_verdicts(file)
    was, (one,) = raw["loops"][0]["margins"]["r1"], found
    read = one.margins["r1"]["phase_margin_deg"]
    assert (read.value, list(read.interval)) == (was["phase_margin_deg"], was["intervals"]["phase_margin_deg"])
    assert read.at_hz == was["at_hz"]["phase_margin_deg"]
    assert one.margins["r1"]["complementary_bandwidth_hz"].bound == was["bounds"].get("complementary_bandwidth_hz")
    assert one.outcome == raw["loops"][0]["outcome"]
    write_verdicts(tmp_path / "v.json", found)
    now = read_json(tmp_path / "v.json")
    assert now.pop("format") == "loopshape-verdict/3"
    assert raw.pop("format") == "loopshape-verdict/2"
    for loop in now["loops"]:
        (loop["controller"],) = loop.pop("controllers")
        assert [line.pop("measure_from_hz") for line in loop["lines"]] == [None] * len(loop["lines"])
    assert now == raw


def test_a_file_without_a_verdict(kept):
    changed(kept, lambda data, _: data.update(loops=[]))
    refused(kept, "holds no verdict")


def test_every_cut_of_a_file_is_refused(kept):
    text = kept.read_text()
    for end in range(0, len(text) - 2, 97):
        kept.write_text(text[:end])
        refused(kept, "verdict.json")


def drop(*keys):
    def change(_, loop):
        for key in keys[:-1]:
            loop = loop[key]
        del loop[keys[-1]]

    return change


def put(value, *keys):
    def change(_, loop):
        for key in keys[:-1]:
            loop = loop[key]
        loop[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (drop("margins"), "margins"),
        (drop("controllers"), "controllers"),
        (drop("margins", "r1", "bandwidth_hz"), "bandwidth_hz"),
        (drop("lines", 0, "outcome"), "outcome"),
        (drop("data", "r1"), "operating points"),
        (drop("controllers", 0, "rate_hz"), "rate_hz"),
        (put(1, "more"), "unknown key; received 'more'"),
        (put(1, "margins", "r1", "more"), "unknown key; received 'more'"),
        (put("high", "margins", "r1", "bandwidth_hz"), "high"),
        (put(True, "margins", "r1", "bandwidth_hz"), "True"),
        (put(None, "margins", "r1", "bandwidth_hz"), "None"),
        (put(3, "margins", "r1", "stable"), "3"),
        (put("fine", "margins", "r1", "stable"), "'fine'"),
        (put([1.0], "lines", 0, "interval"), "verdicts"),
        (put({"a": [1.0, 2.0, 3.0]}, "margins", "r1", "intervals"), "verdicts"),
        (put([], "controllers", 0, "controller"), "no block"),
        (put(-1.0, "controllers", 0, "rate_hz"), "positive"),
    ],
)
def test_a_damaged_file(kept, change, said):
    refused(changed(kept, change), "verdict.json cannot be read as verdicts", said)


def test_an_outcome_that_is_not_that_of_its_lines(kept):
    refused(changed(kept, put("failed", "lines", 0, "outcome")), "outcome 'passed', and its lines say 'failed'")


def test_two_verdicts_of_one_loop(kept):
    refused(changed(kept, lambda data, loop: data["loops"].append(loop)), "two verdicts have one name")
    with pytest.raises(ls.errors.WrongUseError, match="two verdicts have one name"):
        write_verdicts(kept, [checked({"r1": margins()}), checked({"r1": margins()})])


def test_no_verdict_to_write(tmp_path):
    with pytest.raises(ls.errors.WrongUseError, match="holds at least one"):
        write_verdicts(tmp_path / "v.json", [])
    assert not (tmp_path / "v.json").exists()
