"""`loopshape check` of several loops on a small run: exit codes, tables, JSON, JUnit and the figure."""

import json
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from coupled_run import REQUIREMENTS, F, checked, coupled_run, matrix
from run_files import read_required, write_frfs
from several_cases import gain

import loopshape as ls
from loopshape.io.requirements import OWN
from loopshape.testing import ControllerTest, assert_controller


@pytest.fixture
def run(tmp_path):
    return coupled_run(tmp_path)


def test_what_holds_passes_and_is_drawn(run):
    done = checked(run, "--junit", str(run / "j.xml"), "--details")
    assert done.exit_code == 0, done.output
    for words in ("Loop a: pass", "Loop b: pass", "Loop a + b: pass", "All loops at once"):
        assert words in done.output
    assert done.stdout.startswith("verdict: pass: ")
    assert (run / "figures" / "loop_a+b.png").stat().st_size > 20_000
    suites = ET.parse(run / "j.xml").getroot()
    assert [suite.get("name") for suite in suites] == ["a", "b", "a + b"]
    assert {suite.get("failures") for suite in suites} == {"0"}
    assert [case.get("name") for case in suites[2]] == ["disk_margin", "sensitivity_peak_db", "stability in exact"]


def test_a_profile_limits_each_loop_with_the_others_closed(run):
    """A phase margin that the requirements do not ask: of a profile of one's own that no loop meets, and its words."""
    text = OWN.read_text(encoding="utf-8").replace(
        "limits = { gain_margin_db = 6.0, phase_margin_deg = 45.0 }", "limits = { phase_margin_deg = 89.9 }"
    )
    (run / "mine.toml").write_text(text, encoding="utf-8")
    done = checked(run, "--no-figures", "--profile", f"{run / 'mine.toml'}:converter", "--json")
    assert done.exit_code == 1, done.output
    told = json.loads(done.stdout)
    assert not told["passed"]
    assert "phase_margin_deg" in json.dumps(told)
    done = checked(run, "--no-figures", "--profile", "converter")
    assert done.exit_code == 0, done.output
    assert "power electronics" in done.output


def test_what_is_missed_is_exit_code_1_and_says_which(run):
    (run / "r.toml").write_text(REQUIREMENTS.format(disk=1.9))
    done = checked(run, "--json", "--no-figures")
    assert done.exit_code == 1
    told = json.loads(done.stdout)
    assert (told["outcome"], told["passed"], told["figures"]) == ("failed", False, [])
    *each, together = told["loops"]
    assert [(one["loop"], one["outcome"]) for one in each] == [("a", "passed"), ("b", "passed")]
    assert [line["outcome"] for line in together["lines"]] == ["failed", "passed"]
    margins = together["margins"]["exact"]
    assert margins["stable"] == "stable"
    low, high = margins["intervals"]["disk_margin"]
    assert low < margins["disk_margin"] < high
    assert set(margins["worst_changes"]) == {"a", "b"}
    assert margins["phase_margin_deg"] == pytest.approx(2.0 * np.degrees(np.arctan(margins["disk_margin"] / 2.0)))


def test_quiet_says_nothing(run):
    done = checked(run, "--quiet", "--no-figures")
    assert (done.exit_code, done.output) == (0, "")


def test_a_run_of_single_loops_is_refused(tmp_path, run):
    folder = tmp_path / "single"
    one = matrix(0.0)
    write_frfs(folder, [type(one)(F, one.response[:, :1, :1], one.covariance[:, :1, :1], one.valid, one.inputs[:1],
                                  one.outputs[:1], "m", "exact", "a", one.rate_hz)])  # fmt: skip
    done = checked(folder, by=run)
    assert isinstance(done.exception, ls.errors.WrongUseError)
    assert "frf RUN --matrix" in str(done.exception)


def test_the_worst_operating_point_stands_in_the_line():
    matrices = [matrix(0.1, "one"), matrix(0.6, "two")]
    found = ls.check(matrices, [gain("a"), gain("b")], together=ls.Requirements(disk_margin=0.3))
    assert set(found.margins) == {"one", "two"}
    assert found.lines[0].recording == min(found.margins, key=lambda name: found.margins[name].disk_margin)


def test_the_recorded_loops_stand_for_what_is_not_declared():
    controllers = [gain("a"), gain("b")]
    found = ls.check([matrix(0.3)], controllers, recorded_under=[gain("b", 0.5), gain("a", 0.5)])
    assert found.margins["exact"].stable == "stable"
    assert "recorded and stood" in found.margins["exact"].stability_reason
    assert not found.warnings
    assumed = ls.check([matrix(0.3)], controllers)
    assert assumed.margins["exact"].stable == "undecided"
    assert "the number of unstable poles of the whole plant is not known" in assumed.margins["exact"].stability_reason
    assert any("2 integrators" in text for text in assumed.warnings)
    opened = ls.check([replace(matrix(0.3), open_loop=True)], controllers)
    assert opened.margins["exact"].stable == "stable"


def test_the_table_several_is_read(run):
    asked = ls.Requirements(disk_margin=0.5, sensitivity_peak_db=8.0, integrators=2, unstable_poles=0)
    assert vars(read_required(run / "r.toml")[1]) == vars(asked)
    assert [one.loop for one in ls.read_requirements(run / "r.toml")] == ["a", "b"]
    (run / "r.toml").write_text('format = "loopshape-requirements/1"\n[[loop]]\nname = "a"\n')
    assert read_required(run / "r.toml")[1] is None


def test_a_projects_own_tests_hold_all_loops(run):
    given = run, run / "c.toml", run / "r.toml"
    assert_controller(*given)
    test = ControllerTest(*given)
    wanted = [f"{loop}: {name}" for loop in ("a", "b") for name in ("modulus_margin", "stability")]
    wanted += [f"all loops: {name}" for name in ("disk_margin", "sensitivity_peak_db", "stability")]
    assert list(test.cases) == wanted
    for case in wanted:
        test.assert_case(case)
    (run / "r.toml").write_text(REQUIREMENTS.format(disk=1.9))
    with pytest.raises(AssertionError, match=r"disk_margin of loop a \+ b"):
        ControllerTest(*given).assert_case("all loops: disk_margin")
    with pytest.raises(AssertionError, match="disk_margin"):
        assert_controller(*given)


def test_what_read_gives_of_requirements_is_checked_as_the_command_does(run):
    told = json.loads(checked(run, "--no-figures", "--json").stdout)["loops"]
    verdict = ls.check(matrix(0.3), ls.read(run / "c.toml"), ls.read(run / "r.toml"))
    assert [json.loads(json.dumps(part.to_dict())) for part in verdict.parts] == told
