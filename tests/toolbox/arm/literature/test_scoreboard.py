"""The scoreboard is complete and is what the studies wrote; the source's numbers stand once, each with its place."""

import csv
import importlib.util
import re
import sys
from pathlib import Path

import pytest

import loopshape as ls
from loopshape.toolbox.arm import source

ROOT = Path(__file__).resolve().parents[4]
EXPERIMENTS = ROOT / "experiments"
#: tables and figures that the source has, counted in its text, by chapter or appendix
FIGURES = {"1": 4, "2": 6, "3": 16, "4": 18, "5": 12, "A": 8, "B": 3, "C": 7, "D": 13, "E": 1, "F": 3, "G": 7, "H": 9}
TABLES = {"3": 4, "4": 1, "5": 7, "F": 1, "H": 1}
TOPICS = (
    "pwm", "pneumatic_test_setup", "muscle_bench", "equilibria", "arm1_identification", "open_loop_validation",
    "arm1_control", "joint1_alone", "arm2_control", "decoupling", "learning", "beyond",
)  # fmt: skip


def _load():
    spec = importlib.util.spec_from_file_location("scoreboard_run", EXPERIMENTS / "lab" / "scoreboard" / "run.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


board = _load()


def named(kind):
    """Numbers of the figures or tables in items.csv: "figure 2.1-2.6" is six, "table 3.4" one."""
    found = set()
    for item in board.items():
        for part in re.split(r", (?=table|figure)", item.name):
            if not part.startswith(kind):
                continue
            for one in part.removeprefix(kind).strip().split(", "):
                first, _, last = one.partition("-")
                chapter, low = first.split(".")
                found |= {(chapter, k) for k in range(int(low), int((last or first).split(".")[1]) + 1)}
    return found


@pytest.mark.parametrize(("kind", "counted"), [("figure", FIGURES), ("table", TABLES)])
def test_every_figure_and_table_of_the_source_has_a_line(kind, counted):
    assert named(kind) == {(chapter, k) for chapter, n in counted.items() for k in range(1, n + 1)}


def test_every_line_with_a_study_is_scored_by_one_of_its_studies():
    scored = {(score.item, score.study) for score in board.scores()}
    open_ones = [i.name for i in board.items() if i.studies and not any((i.name, s) in scored for s in i.studies)]
    assert open_ones == []


def test_every_score_belongs_to_a_line_and_to_a_study_that_the_line_names():
    studies = {item.name: item.studies for item in board.items()}
    strange = [f"{s.study}: {s.item}" for s in board.scores() if s.study not in studies.get(s.item, ())]
    assert strange == []


def test_what_does_not_agree_says_why():
    assert [f"{s.study}: {s.item}" for s in board.scores() if s.verdict != "agrees" and len(s.why) < 20] == []


def test_numbers_of_the_source_are_named_by_keys_that_exist():
    for score in board.scores():
        assert "{" not in score.says, score


def test_the_page_is_what_the_scoreboard_writes():
    assert (EXPERIMENTS / "README.md").read_text(encoding="utf-8") == board.page(board.items(), board.scores())


@pytest.mark.parametrize("name", TOPICS)
def test_a_study_asks_predicts_and_answers_in_that_order(name):
    folder = EXPERIMENTS / name
    text = (folder / "README.md").read_text(encoding="utf-8")
    places = [text.find(f"**{word}") for word in ("Question", "Prediction", "Outcome")]
    assert -1 not in places
    assert places == sorted(places)
    assert (folder / "study.toml").is_file()
    assert (folder / "run.py").is_file()
    assert list((ROOT / "figures" / name).glob("*.png"))


def test_figures_that_a_study_shows_exist():
    for readme in EXPERIMENTS.glob("*/README.md"):
        for path in re.findall(r"figures/([\w/]+\.png)", readme.read_text(encoding="utf-8")):
            assert (ROOT / "figures" / path).is_file(), f"{readme.parent.name}: {path}"


def test_the_table_of_numbers_is_sound():
    table = source.numbers()
    with (ROOT / "loopshape" / "toolbox" / "arm" / "source.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(table)  # no key twice
    for one in table.values():
        assert one.kind in source.KINDS
        assert one.value == float(one.printed)
        assert 1 <= one.page <= 170
        assert one.what
        assert re.match(r"(figure|figures|table|section|chapter|appendix|abstract|[A-H3-6]\.)", one.place), one


@pytest.mark.parametrize(("printed", "half"), [("6.3", 0.05), ("780", 0.5), ("0.10", 0.005), ("-12.80", 0.005)])
def test_half_a_digit_is_what_rounding_leaves_open(printed, half):
    assert source.Number("k", printed, "1", "measured", "figure 1", 1, "").half_digit == pytest.approx(half)


def test_an_unknown_number_is_refused_with_those_beside_it():
    with pytest.raises(
        ls.errors.WrongUseError, match=r"no such number; received table_5_1\.beta; one of table_5_1\.gain"
    ):
        source.number("table_5_1.beta")


def test_scores_with_other_columns_or_an_unknown_verdict_are_refused(tmp_path):
    path = tmp_path / "a" / "scores.csv"
    path.parent.mkdir()
    path.write_text("item,verdict\nfigure 3.3,agrees\n")
    with pytest.raises(ls.errors.UnreadableInputError, match="other columns"):
        list(board.scores(tmp_path))
    path.write_text("item,quantity,source,ours,verdict,why\nfigure 3.3,a,b,c,maybe,\n")
    with pytest.raises(ls.errors.UnreadableInputError, match="no known verdict"):
        list(board.scores(tmp_path))
