"""`loopshape gap` end to end on a small run of an arm with a payload: exit code, what is printed, whole files."""

import json

import pytest
from simulated_machines import Arm1, measure, plan, read_study
from small_gap_run import KNOWN, MIDDLE, loopshape, recorded

import loopshape as ls

KEYS = {
    "format": str, "run": str, "plant": str, "verdict": str, "ranking": list, "ambiguity_set": list, "kinds": dict,
    "where": dict, "gap": dict, "submodels": list, "next_experiment": dict, "control": list, "parameters": dict,
    "software": list, "notes": list, "sentence": str, "budget": list, "missing": list, "fix": dict,
    "windows_tried_s": list, "by_recording": dict, "window_s": type(None),
    "floors": list,
}  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gap")
    ls.write(recorded(), folder / "arm")
    return folder


@pytest.fixture(scope="module")
def done(place, module_output):
    files = [place / "out" / name for name in ("gap.json", "gap.png", "next.toml")]
    with module_output() as printed:
        code = loopshape("gap", place / "arm", "--save-answer", files[0], "--report", files[1], "--next", files[2])
    return code, printed[0], files


@pytest.fixture(scope="module")
def module_output():
    """Standard output of a block, for fixtures that live as long as the module."""
    from contextlib import contextmanager, redirect_stdout
    from io import StringIO

    @contextmanager
    def caught():
        text, out = StringIO(), [""]
        with redirect_stdout(text):
            yield out
        out[0] = text.getvalue()

    return caught


@pytest.fixture(scope="module")
def answer(done):
    return json.loads(done[2][0].read_text())


def test_it_names_the_payload_and_says_so_first(done, answer):
    code, printed, _ = done
    assert code == 0
    assert answer["verdict"] == "payload"
    assert " ".join(printed.split("\n\n")[0].split()) == answer["sentence"]
    assert max(len(line) for line in printed.splitlines() if " written to " not in line) <= 80
    first = answer["ranking"][0]
    assert first["interval"][0] < first["magnitude"] < first["interval"][1]
    assert first["magnitude"] == pytest.approx(60.0, abs=6.0)
    assert first["unit"] == "g"


def test_the_json_has_every_key_of_the_format_with_its_type(answer):
    assert {key: type(value) for key, value in answer.items()} == KEYS
    where, gap = answer["where"], answer["gap"]
    assert {"block", "channel", "band_hz", "operating_points"} <= set(where)
    assert where["block"] == "body"
    assert where["channel"] == "theta2"
    assert 0.0 < where["band_hz"][0] <= where["band_hz"][1]
    assert MIDDLE in where["operating_points"]
    assert {"metric", "noise_floor", "before", "after", "shrink", "interval", "recordings"} <= set(gap)
    assert gap["noise_floor"] == 1.0
    assert gap["recordings"] == ["r05.parquet", "r06.parquet"]  # those held out, as files


def test_the_ranking_lists_every_effect_none_and_unknown_and_sums_to_one(answer):
    names = [row["effect"] for row in answer["ranking"]]
    assert {*KNOWN, "none", "unknown"} <= set(names)
    assert len(names) == len(set(names))
    probabilities = [row["probability"] for row in answer["ranking"]]
    assert sum(probabilities) == pytest.approx(1.0)
    assert probabilities == sorted(probabilities, reverse=True)
    assert {name for group in answer["ambiguity_set"] for name in group} <= set(names)
    assert sum(answer["where"]["blocks"].values()) == pytest.approx(1.0)


def test_the_held_out_gap_shrinks_as_the_definition_says(answer):
    gap = answer["gap"]
    assert gap["before"] > 5.0
    assert gap["after"] < 1.5
    assert gap["shrink"] == pytest.approx((gap["before"] - gap["after"]) / (gap["before"] - 1.0))
    assert gap["interval"][0] <= gap["shrink"] <= gap["interval"][1]
    assert gap["rival_after"] > gap["after"]


def test_the_files_are_whole(done):
    assert done[2][1].read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in done[2][0].parent.iterdir()) == ["gap.json", "gap.png", "next.toml"]


def test_the_next_experiment_can_be_measured_as_written(done, answer):
    study = read_study(done[2][2])
    planned = plan(study, Arm1())[0]
    proposal = answer["next_experiment"]
    assert planned.name == proposal["name"]
    assert proposal["parts"][0] == "payload"
    assert proposal["parts"][1] in (*KNOWN, "none")
    assert proposal["separation"] > 2.0
    assert proposal["sentence"] in " ".join(done[1].split())
    assert proposal["study"]["experiment"][0]["name"] == planned.name
    assert all(recording.info.ended_early is None for recording in measure(study, Arm1(), threads=1))
    own = {c.loop: c.blocks for c in Arm1().default_controllers(1000.0)}
    assert {loop.name: loop.controller.blocks for loop in planned.loops if loop.controller} == own


@pytest.mark.long
def test_a_healthy_arm_has_no_gap_and_nothing_to_shrink(place, tmp_path):
    ls.write(recorded({}), tmp_path / "healthy")
    assert loopshape("gap", tmp_path / "healthy", "--save-answer", tmp_path / "gap.json", "--quick", "--quiet") == 0
    found = json.loads((tmp_path / "gap.json").read_text())
    assert found["verdict"] == "none"
    assert found["gap"]["before"] < 1.5
    assert found["gap"]["shrink"] is None
    assert found["gap"]["interval"] is None
    assert found["where"]["block"] == "none"


def test_a_report_that_is_no_png_is_refused_before_anything_is_computed(place, tmp_path, capsys):
    for second in ((), (place / "arm",)):
        code = loopshape(
            "gap", place / "arm", *second, "--save-answer", tmp_path / "gap.json", "--report", tmp_path / "gap.pdf"
        )
        assert code == 2
        assert "a report is a picture as PNG" in capsys.readouterr().err
    assert loopshape("gap", place / "arm", "--save-answer", tmp_path) == 2
    assert "a folder stands where a file is to be written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_two_runs_take_files_too(place, tmp_path):
    words = ("--report", tmp_path / "new" / "two.png", "--save-answer", tmp_path / "new" / "two.json", "--quiet")
    assert loopshape("gap", place / "arm", place / "arm", *words) == 0
    assert json.loads((tmp_path / "new" / "two.json").read_text())["format"] == "loopshape-gap-table/1"


def test_json_prints_the_answer_as_in_every_command(place, capsys):
    capsys.readouterr()
    assert loopshape("gap", place / "arm", place / "arm", "--json") == 0
    assert json.loads(capsys.readouterr().out)["format"] == "loopshape-gap-table/1"
