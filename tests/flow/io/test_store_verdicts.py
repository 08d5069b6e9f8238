"""Kept verdicts come back as they were; the Markdown summary says all, escapes names, and is the same every time."""

import json
import re
from dataclasses import fields
from html.parser import HTMLParser
from xml.etree import ElementTree as ET

import numpy as np
from bench_nouns import LIMITS
from markdown_it import MarkdownIt
from verdict_cases import FOUND, LINES, POINTS, checked, failures, line, margins, rows, summary, write_junit

import loopshape as ls
from loopshape.io.files import read_json
from loopshape.io.write.verdicts import read_verdicts, write_verdicts


def same(one, other):
    """Equal field by field, NaN equal to NaN, kinds included."""
    assert one.table() == other.table()
    for field in (field for field in fields(ls.Margins) if field.name != "readings"):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        assert type(mine) is type(theirs)
        np.testing.assert_equal(theirs, mine)


def test_a_verdict_comes_back_as_it_was(tmp_path):
    write_verdicts(tmp_path / "deep" / "v.json", [FOUND, checked({"r1": margins()}, loop="second")])
    one, second = read_verdicts(tmp_path / "deep" / "v.json")
    assert one.lines == LINES
    assert list(one.margins) == list(POINTS)
    for name, mine in POINTS.items():
        same(one.margins[name], mine)
    assert (one.loop, one.warnings, one.outcome) == ("axis", ("be careful",), "failed")
    assert one.data == {"r1": "a-r1", "r2": "a-r2", "r3": "a-r3"}
    assert [vars(own) for own in one.controllers] == [vars(own) for own in FOUND.controllers]
    assert second.loop == "second"


def test_the_same_verdict_gives_the_same_bytes_in_strict_json(tmp_path):
    for name in ("a.json", "b.json"):
        write_verdicts(tmp_path / name, [FOUND])
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()

    def no_constants(word):
        raise AssertionError(word)

    json.loads((tmp_path / "a.json").read_text(), parse_constant=no_constants)
    write_verdicts(tmp_path / "b.json", read_verdicts(tmp_path / "a.json"))
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_verdict_without_margins_that_came_later_is_read(tmp_path):
    write_verdicts(tmp_path / "v.json", [checked({"r1": margins()})])
    data = read_json(tmp_path / "v.json")
    del data["loops"][0]["margins"]["r1"]["process_peak_db"]
    (tmp_path / "v.json").write_text(json.dumps(data))
    (one,) = read_verdicts(tmp_path / "v.json")
    assert np.isnan(one.margins["r1"]["process_peak_db"].value)


def test_the_summary_says_verdict_requirements_and_margins():
    text = summary([FOUND])
    assert text.startswith("## loopshape check: **FAIL**\n")
    assert "Of 4 requirements 1 missed, 1 undecided; stable at 1 of 3 operating points." in text
    assert "- loop axis is undecided at r2: why; measure 0.1 to 2 Hz" in text
    assert "- be careful" in text
    requirements, points = rows(text)
    by_name = {row[0]: row for row in requirements}
    assert by_name["phase_margin_deg"][1:4] == ["at least 30 deg", "40", "38 .. 42.5"]
    assert by_name["gain_margin_db"][-1] == "undecided: 2.2 times the data would decide"
    assert by_name["sensitivity_peak_db"][-2:] == ["-", "FAIL"]
    assert by_name["sensitivity_peak_db"][1] == "at most 6 dB"
    assert "<details><summary>Margins of loop axis at each operating point</summary>\n\n| operating" in text
    assert points[2][2] == "inf (9.9 .. 10.1)"
    assert [row[1] for row in points[2:]] == ["stable", "undecided: why; measure 0.1 to 2 Hz", "unstable: 2 poles"]


class Cells(HTMLParser):
    """Texts of a page's table cells, and the tags that it has."""

    def __init__(self, page):
        super().__init__()
        self.cells, self.tags = [], set()
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_data(self, data):
        if self.cells:
            self.cells[-1] += data


def test_names_change_no_table_and_bring_no_mark_up():
    names = ["a|b", "x\ny", "*bold*", "_em_", "<img src=x>", "[a](http://b)", "`c`", "a\\|b", "&lt;", "# head", "~~a~~"]
    names += ["- a", "1. a", "a_b_c", "<b>", "\\", "|", "![x](y)", "<!-- x"]
    found = checked(
        {name: margins() for name in names},
        [line(recording="a|b")],
        loop="l|<b>\n- *",
        warnings=["- *a*", "# b", "1. c"],
    )
    text = summary([found])
    shown = Cells(MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"]).render(text))
    wanted = [name.replace("\n", " ") for name in names]
    width = 2 + len(LIMITS)
    points = shown.cells[-len(names) * width :]
    assert [cell.strip() for cell in points[::width]] == wanted
    assert shown.tags == {
        "h2",
        "h3",
        "p",
        "ul",
        "li",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
        "details",
        "summary",
    }
    assert re.findall(r"(?<!\\)<\S*", text) == ["<details><summary>Margins", "</summary>", "</details>"]


def test_junit_tells_missed_from_undecided_and_says_intervals(tmp_path):
    write_junit(tmp_path / "j.xml", [FOUND])
    found = failures(tmp_path / "j.xml")
    name = "loopshape.axis"
    assert {key[1]: kind for key, (kind, _) in found.items()} == {
        "gain_margin_db": "undecided",
        "sensitivity_peak_db": "missed",
        "stability in r2": "undecided",
        "stability in r3": "missed",
    }
    assert found[name, "gain_margin_db"][1] == (
        "required at least 5 dB, found 5.5 dB (95 %: 4 .. 7 dB) at 3 Hz in r1 (slack -1 dB): 2.2 times the data would"
        " decide"
    )
    assert found[name, "stability in r2"][1] == "undecided: why; measure 0.1 to 2 Hz"
    (suite,) = ET.parse(tmp_path / "j.xml").getroot()
    assert suite.attrib == {"name": "axis", "tests": "7", "failures": "4", "errors": "0"}
