"""What became of a baseline, in the Markdown summary and in JUnit XML."""

from xml.etree import ElementTree as ET

from verdict_cases import FOUND, checked, failures, line, margins, rows, summary, write_junit

from loopshape.toolbox.validation.kept.baseline import compare


def compared():
    """A comparison in which something of every kind has changed."""
    before = checked({name: margins() for name in ("r1", "r2", "r3", "old")}, [line("gain_margin_db"), line()])
    return compare([before], [FOUND])


def test_the_summary_says_what_changed():
    text = summary([FOUND], {"Against the baseline": compared()})
    assert text == summary([FOUND], {"Against the baseline": compared()})
    _, outcomes, changes, _ = rows(text)
    assert outcomes[2][:3] == ["gain_margin_db", "axis", "pass"]  # the outcome that got worse comes first
    assert {row[0] for row in outcomes} >= {"stability in r2", "stability in r3"}
    assert changes[2][0] == "gain_margin_db"
    assert "- gone: old of loop axis" in text


def test_junit_fails_what_is_worse_than_the_baseline_unless_that_is_allowed(tmp_path):
    write_junit(tmp_path / "j.xml", [FOUND], compared())
    worse = {key for key, (kind, _) in failures(tmp_path / "j.xml").items() if kind == "worse"}
    assert ("baseline.axis", "outcome of gain_margin_db") in worse
    assert ("baseline.axis", "stability in r3") in worse
    assert ("baseline", "old of loop axis is there") in worse
    write_junit(tmp_path / "allowed.xml", [FOUND], compared(), allow_worse=True)
    assert {kind for kind, _ in failures(tmp_path / "allowed.xml").values()} == {"missed", "undecided"}
    suites = ET.parse(tmp_path / "j.xml").getroot()
    assert [suite.get("name") for suite in suites] == ["axis", "baseline"]
    assert suites[1].get("failures") == str(len(worse))
