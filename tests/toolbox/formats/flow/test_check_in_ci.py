"""A check as a build server runs it: the workflow's own commands on the shipped controller, baseline, pytest."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from commands import invoked
from run_files import read_verdicts

import loopshape as ls
from loopshape.cli.output import Output

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[4]
WORKFLOW = ROOT / "examples" / "ci" / "check-controllers.yml"
BENCH = ROOT / "examples" / "motor_bench"
REQUIRE = BENCH / "requirements.toml"


def steps() -> list[dict[str, str]]:
    """The steps of the workflow's one job: its YAML is lists and tables by indentation, texts plain or after a bar."""
    text = WORKFLOW.read_text()
    assert "\t" not in text
    found: list[dict[str, str]] = []
    for step in re.split(r"^      - ", text[text.index("    steps:\n") :], flags=re.M)[1:]:
        keys = re.findall(r"^(?:        )?([\w-]+): ?(.*\n(?:          .*\n)*)", step, flags=re.M)
        found.append({key: re.sub(r"^\|\n", "", value).replace("\n          ", "\n").strip() for key, value in keys})
    return found


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the examples in which the workflow's commands have run, up to the check."""
    folder = tmp_path_factory.mktemp("bench")
    shutil.copytree(ROOT / "examples", folder / "examples")
    for step in steps():
        if step.get("run", "").startswith("loopshape import"):
            assert bash(step["run"], folder).returncode == 0
    return folder


def bash(script: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a step's script as a runner does."""
    here = Path(sys.executable).parent
    environment = os.environ | {"PATH": f"{here}:{os.environ['PATH']}", "GITHUB_STEP_SUMMARY": str(cwd / "summary.md")}
    command = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False, timeout=300)


@dataclass(frozen=True)
class Done:
    """What a command left: its exit code and its words."""

    returncode: int
    stdout: str
    stderr: str


def check(folder: Path, *words: object, run: str = "out/bench") -> Done:
    """`loopshape check` on the bench's run; the controller is the first word, a refusal ends as the program does."""
    controller, *rest = words
    rest += [] if "--require" in rest else ["--require", REQUIRE]
    done = invoked([*map(str, ("check", folder / run, controller, "--no-figures", *rest))])
    refused = isinstance(done.exception, ls.LoopshapeError)
    assert refused or isinstance(done.exception, SystemExit | None), done.output + repr(done.exception)
    return Done(2 if refused else done.exit_code, done.stdout, str(done.exception) if refused else done.stderr)


def with_gain(folder: Path, factor: float) -> Path:
    """The shipped controller with another gain."""
    (own,) = ls.read_controllers(BENCH / "controller.toml")
    gain = own.blocks[0].parameters["gain"]
    path = folder / f"gain-{factor:g}.toml"
    text = (BENCH / "controller.toml").read_text()
    assert text.count(f"gain = {gain!r}") == 1
    path.write_text(text.replace(f"gain = {gain!r}", f"gain = {factor * gain!r}"))
    return path


def requirement(folder: Path, name: str, **limits: float) -> Path:
    """A requirements file of the loop."""
    lines = [f"{key} = {value!r}" for key, value in limits.items()]
    head = ['format = "loopshape-requirements/1"', "[[loop]]", 'name = "motor"', "unstable_poles = 0"]
    path = folder / f"{name}.toml"
    path.write_text("\n".join([*head, *lines]) + "\n")
    return path


def test_the_workflow_has_the_steps_that_a_runner_takes() -> None:
    found = steps()
    assert [step.get("uses", step.get("run", "")).split()[0] for step in found] == [
        "actions/checkout@v4", "actions/setup-python@v5", "python", "loopshape", "loopshape", "cat",
        "actions/upload-artifact@v4",
    ]  # fmt: skip
    assert found[2]["run"] == "python -m pip install loopshape"
    assert all(step["if"] == "always()" for step in found[5:])
    assert WORKFLOW.read_text().startswith("#")


def test_the_shipped_controller_passes_by_the_workflows_own_commands(bench: Path) -> None:
    *_, checks, summary, _ = steps()
    done = bash(checks["run"], bench)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("verdict: pass: ")
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert re.search(r"Against the baseline: unchanged \(0 margins worse, 0 better, \d+ unchanged\)", done.stdout)
    assert bash(summary["run"], bench).returncode == 0
    assert (bench / "summary.md").read_text().startswith("## loopshape check: pass\n")
    assert {suite.get("failures") for suite in ET.parse(bench / "out" / "verdict.xml").getroot()} == {"0"}
    (kept,), (made,) = (read_verdicts(path) for path in (BENCH / "verdict.json", bench / "out" / "verdict.json"))
    assert made.data == kept.data
    assert list((bench / "out" / "bench" / "figures").glob("nichols_*.png"))


def test_the_baseline_is_of_the_shipped_controller_and_its_recording() -> None:
    (kept,), (own,) = read_verdicts(BENCH / "verdict.json"), ls.read_controllers(BENCH / "controller.toml")
    assert [block.to_table() for block in kept.controllers[0].blocks] == [block.to_table() for block in own.blocks]
    assert kept.outcome == "passed"
    assert str(ROOT) not in (BENCH / "verdict.json").read_text()


def test_a_controller_that_got_worse_fails_unless_that_is_allowed(bench: Path) -> None:
    slow = with_gain(bench, 0.9)  # meets every requirement, at a lower bandwidth
    words = (slow, "--require", requirement(bench, "easy", bandwidth_hz=10.0), "--baseline", BENCH / "verdict.json")
    done = check(bench, *words, "--junit", bench / "slow.xml", "--markdown", bench / "slow.md")
    assert done.returncode == 1
    assert done.stdout.startswith("verdict: pass, and worse than the baseline: ")
    assert "bandwidth_hz of loop motor is worse by " in done.stdout
    table = check(bench, *words, "--details").stdout.splitlines()
    line = next(x for x in table if x.startswith("bandwidth_hz") and "exact" in x)
    assert "worse" in line
    assert "loop motor: another controller, the same data" in done.stdout
    budget = next(k for k, x in enumerate(table) if x.startswith("Phase budget of loop motor at "))
    assert "where the phase margin of type-a is read" in table[budget]
    assert [x.split()[:2] for x in table[budget + 2 : budget + 5]] == [["1", "gain"], ["2", "lead_lag"], ["3", "notch"]]
    assert 'type="worse"' in (bench / "slow.xml").read_text()
    assert re.search(r"^\| bandwidth_hz \| motor \| Hz \| .* \| exact \| type-a \| 1 \| worse \|$",
                     (bench / "slow.md").read_text(), flags=re.M)  # fmt: skip
    allowed = check(bench, *words, "--allow-worse", "--junit", bench / "slow.xml")
    assert allowed.returncode == 0
    assert allowed.stdout.startswith("verdict: pass: ")
    assert "worse (" in allowed.stdout
    assert 'type="worse"' not in (bench / "slow.xml").read_text()


def test_controller_and_data_that_both_changed_are_told_apart(bench: Path) -> None:
    again = (BENCH / "verdict.json").read_text()
    (kept,) = read_verdicts(BENCH / "verdict.json")
    remeasured = bench / "remeasured.json"
    remeasured.write_text(again.replace(kept.data["type-a"], "0" * 16))
    done = check(bench, with_gain(bench, 0.8), "--baseline", remeasured, "--json", "--require", REQUIRE)
    found = json.loads(done.stdout)["baseline"]
    assert found["by_controller"]["outcome"] == "worse"
    assert found["by_plant"]["outcome"] == "unchanged"
    assert found["notes"][0] == "loop motor: another controller, other data"
    assert done.returncode == 1


def test_a_missed_requirement_is_1_and_wrong_use_is_2(bench: Path) -> None:
    own = BENCH / "controller.toml"
    missed = check(bench, own, "--require", requirement(bench, "missed", bandwidth_hz=500.0))
    assert missed.returncode == 1
    assert missed.stdout.startswith("verdict: FAIL: bandwidth_hz of loop motor: required")
    for words, said in (
        ((own, "--allow-worse"), "--allow-worse needs a baseline"),
        ((own, "--baseline", "none.json"), "a file does not exist"),
        ((own, "--baseline", REQUIRE), "cannot be read as JSON"),
        ((own, "--baseline", bench / "out" / "bench" / "fits.json"), "not of the format loopshape-verdict/3"),
    ):
        wrong = check(bench, *words)
        assert wrong.returncode == 2
        assert said in wrong.stderr


def test_quiet_prints_nothing_and_json_is_one_object_without_nan(bench: Path) -> None:
    slow = bench / "slow.toml"  # it crosses below the first line, and the fit is not good enough to lead there
    slow.write_text(re.sub(r"gain = [0-9.]+", "gain = 1.5", (BENCH / "controller.toml").read_text()))
    for words in (("--quiet",), ("--json",), ()):
        done = check(bench, slow, *words)
        assert done.returncode == 1
        assert ("warning: " in done.stderr) == (words != ("--quiet",))
        if words == ("--quiet",):
            assert (done.stdout, done.stderr) == ("", "")
        if words == ("--json",):
            found = json.loads(done.stdout, parse_constant=pytest.fail)
            assert found["outcome"] == "failed"  # it is slower than the bandwidth that is required
            assert '"nan"' not in done.stdout
        if not words:
            assert done.stdout.startswith("verdict: FAIL")


def test_what_was_not_found_is_null_in_json() -> None:
    from verdict_cases import checked, margins

    found = checked({"r1": margins({"disk_margin": float("nan")})}).to_dict()["margins"]["r1"]
    assert found["disk_margin"] is None
    assert found["bandwidth_hz"] == margins().bandwidth_hz


def test_an_undecided_line_says_how_much_more_measuring_would_decide(capsys: pytest.CaptureFixture[str]) -> None:
    from verdict_cases import checked, line, margins

    from loopshape.cli.verify.check import report_verdicts

    points = {"r1": margins(stable="undecided", reason="why", band_hz=(0.0, 2.5))}
    lines = [line("gain_margin_db", "undecided", longer=3.1), line("modulus_margin", "undecided", longer=float("inf"))]
    verdict = checked(points, lines)
    report_verdicts([verdict], Output())
    shown = capsys.readouterr()
    assert "undecided: 3.1 times the data would decide" in shown.out
    assert "undecided: on the limit" in shown.out
    assert shown.err == "warning: loop axis is undecided at r1: why; measure below 2.5 Hz\n"
    report_verdicts([verdict], Output(quiet=True))
    assert capsys.readouterr() == ("", "")


TESTS = """
import pytest
from loopshape.testing import ControllerTest, assert_controller

REQUIRE = {require!r}
OWN, HOT, SLOW, KEPT, EASY = {own!r}, {hot!r}, {slow!r}, {kept!r}, {easy!r}
CASES = ControllerTest("out/bench", HOT, REQUIRE)


def test_own():
    assert_controller("out/bench", OWN, REQUIRE, baseline=KEPT)


def test_hot():
    assert_controller("out/bench", HOT, REQUIRE, baseline=KEPT)


def test_slow():
    assert_controller("out/bench", SLOW, EASY, baseline=KEPT)


def test_slow_allowed():
    assert_controller("out/bench", SLOW, EASY, baseline=KEPT, allow_worse=True)


@pytest.mark.parametrize("case", CASES.cases)
def test_each(case):
    CASES.assert_case(case)
"""


def test_the_pytest_helper_fails_with_the_verdict_as_its_message(bench: Path) -> None:
    words = {"own": BENCH / "controller.toml", "hot": with_gain(bench, 1.6), "kept": BENCH / "verdict.json"}
    words |= {"slow": with_gain(bench, 0.9), "easy": requirement(bench, "easy", bandwidth_hz=10.0)}
    text = TESTS.format(require=str(REQUIRE), **{name: str(path) for name, path in words.items()})
    (bench / "test_controllers.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-rA", "test_controllers.py"]
    done = subprocess.run(command, cwd=bench, capture_output=True, text=True, check=False, timeout=300)
    ends = re.findall(r"^(PASSED|FAILED) test_controllers\.py::(.*?)(?: - .*)?$", done.stdout, flags=re.M)
    outcomes = {name: word for word, name in ends}
    assert done.returncode == 1, done.stdout
    assert outcomes["test_own"] == "PASSED"
    assert outcomes["test_hot"] == "FAILED"
    assert (outcomes["test_slow"], outcomes["test_slow_allowed"]) == ("FAILED", "PASSED")
    assert outcomes["test_each[motor: bandwidth_hz]"] == "PASSED"
    assert outcomes["test_each[motor: sensitivity_peak_db]"] == "FAILED"
    assert outcomes["test_each[motor: stability]"] == "PASSED"
    assert re.search(r"E +sensitivity_peak_db +6 +[\d.]+ +[\d.]+ \.\. [\d.]+ +FAIL", done.stdout)
    assert re.search(
        r"E +sensitivity_peak_db of loop motor: pass \(at most 6 dB\) to FAIL \(at most 6 dB\)", done.stdout
    )
    assert re.search(r"E +bandwidth_hz of loop motor is worse by [\d.]+ Hz: [\d.]+ to [\d.]+ Hz in type-a", done.stdout)
    assert "check_all(" not in done.stdout  # the message, not the helper's own lines


def test_the_pytest_helper_needs_neither_typer_nor_matplotlib_nor_pytest() -> None:
    heavy = "{'typer', 'rich', 'matplotlib', 'pytest', 'pandas'}"
    code = f"import sys, loopshape.testing; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_case_that_nobody_asked_for_is_refused() -> None:
    from loopshape.testing import ControllerTest

    with pytest.raises(ls.errors.WrongUseError, match="a case is not one of the requirements"):
        ControllerTest("none", "none", REQUIRE).assert_case("motor: gain")


def test_the_headline_names_what_fails_before_what_is_undecided() -> None:
    from verdict_cases import checked, line, margins

    from loopshape.data.result.verdict_words import headline

    lines = [line("gain_margin_db", "undecided"), line("modulus_margin", "failed"), line("phase_margin_deg", "passed")]
    said = headline([checked({"r1": margins()}, lines)])
    assert said.startswith("modulus_margin of loop axis: required ")
    assert said.endswith("; 1 more not met or undecided")
    alone = headline([checked({"r1": margins(stable="unstable", reason="why")}, lines[2:])])
    assert alone == "loop axis is unstable at r1: why"
