"""What every command shares: --version, --json as a flag; and words that tell a user what a number rests on."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import typer
from bench_nouns import Estimate, LoopSetup, RecordingInfo
from conversions import TWO_PI
from study_signals import Multisine
from typer.testing import CliRunner

import loopshape as ls
from loopshape import __version__
from loopshape.cli.main import COMMANDS, app
from loopshape.core.toolboxes import function_at
from loopshape.view.labels import plus_minus, root_cells

pytestmark = pytest.mark.short

RATE = 100.0
CONTROLLER = """
format = "loopshape-controllers/1"
rate_hz = 100.0

[[loop]]
name = "axis"
controller = [{ kind = "gain", gain = 2.0 }]
"""


def loopshape(*words):
    done = CliRunner().invoke(app, [str(word) for word in words])
    code = 2 if isinstance(done.exception, ls.LoopshapeError) else done.exit_code
    return code, done.stdout, f"{done.stderr}{done.exception or ''}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of a first-order plant, 5/(s + 5) held at 100 Hz, under a multisine with a little sensor noise."""
    place = tmp_path_factory.mktemp("words")
    u = Multisine(0.25, 40.0, 4.0, 1.0, periods=6, seed=1).signal(RATE)
    a = np.exp(-5.0 / RATE)
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = a * y[k - 1] + (1.0 - a) * u[k - 1]
    y += 0.002 * np.random.default_rng(1).standard_normal(u.size)
    info = RecordingInfo(
        "r1.parquet", "multisine", "control", excites="axis", closed_loop=False, period_s=4.0, periodic_from_s=1.0
    )
    loop = LoopSetup("axis", None, None, "z_v", "y_rad", None)
    ls.write(ls.Run(RATE, (loop,), (ls.Recording(info, RATE, {"z_v": u, "y_rad": y}),)), place / "run")
    assert loopshape("frf", place / "run", "--no-figures", "--quiet")[0] == 0
    (place / "c.toml").write_text(CONTROLLER)
    return place


def test_the_version_is_printed():
    assert loopshape("--version") == (0, f"{__version__}\n", "")


def test_json_is_a_flag_in_every_command_that_answers():
    commands = typer.main.get_command(app).commands
    for name, command in commands.items():
        options = {flag: p for p in command.params for flag in p.opts}
        if name == "emulator":  # serves until it is stopped, and has no answer
            assert "--json" not in options
            continue
        assert "--json" in options, name
        assert options["--json"].is_flag, name


def test_a_check_without_requirements_reports_margins_without_verdict(folder):
    code, said, why = loopshape("check", folder / "run", folder / "c.toml", "--no-figures")
    assert code == 0, why
    assert "Margins of loop axis" in said
    assert said.splitlines()[0] == "no requirement given; reported without verdict"
    assert max(map(len, said.splitlines())) <= 80
    assert "pass" not in said
    code, said, _ = loopshape("check", folder / "run", folder / "c.toml", "--no-figures", "--json")
    told = json.loads(said)
    assert (code, told["passed"], told["outcome"]) == (0, None, None)
    margins = told["loops"][0]["margins"]["r1"]
    # |2 P| = 1 at w = 5 sqrt(3) in continuous time; the hold's half sample takes 2.5 degrees of the 120
    assert margins["bandwidth_hz"] == pytest.approx(5.0 * np.sqrt(3.0) / TWO_PI, rel=0.02)
    assert margins["phase_margin_deg"] == pytest.approx(120.0 - np.degrees(0.005 * 5.0 * np.sqrt(3.0)), abs=1.5)


def test_a_kept_verdict_needs_requirements(folder, tmp_path):
    code, _, why = loopshape("check", folder / "run", folder / "c.toml", "--save-verdict", tmp_path / "v.json")
    assert code == 2
    assert "--require" in why


def test_a_plan_for_what_is_known_already_proposes_nothing(folder):
    words = ("plan", folder / "run", "--at", 2.0)
    code, said, _ = loopshape(*words, "--std-percent", 30.0)
    assert code == 0
    assert said.startswith("r1 already has a std of ")
    assert "no further experiment is proposed" in said
    assert not list(Path(folder / "run").glob("plan_*"))
    told = json.loads(loopshape(*words, "--std-percent", 30.0, "--json")[1])
    assert told["satisfied"]
    assert told["study"] is None
    assert told["std_before"] < 0.3
    told = json.loads(loopshape(*words, "--std-percent", 0.001, "--json")[1])
    assert not told["satisfied"]


def roots(f_hz, std_hz, damping):
    return root_cells(Estimate("pole1_f_hz", f_hz, "Hz", std_hz), Estimate("pole1_damping", damping, "1", 0.0), 40.0)


def test_real_roots_are_time_constants_and_far_ones_bounds():
    assert roots(2.0, 0.02, 0.5) == ["2.000 ± 0.039", "0.5 ± 0", None]
    assert roots(41.0, 0.02, 0.5)[0] == "41.000 ± 0.039, above the measured frequencies"
    assert roots(1.0 / TWO_PI, 0.01 / TWO_PI, 1.0) == [None, None, "1.000 ± 0.020"]
    assert roots(1.0 / TWO_PI, 0.01 / TWO_PI, -1.0) == [None, None, "1.000 ± 0.020, right half plane"]
    far = roots(2.3e5, 8.7e14, -1.0)[2]
    assert far == "below 0.004, above the measured frequencies, right half plane"
    assert roots(20.0, 30.0, 1.0)[2] == "about 0.008, not known"


def test_value_and_half_width_end_at_the_same_decimal():
    assert plus_minus(2253.41, 20.04) == "2253 ± 20"
    assert plus_minus(0.000118663, 1.32e-5) == "0.000119 ± 0.000013"
    assert plus_minus(4.9469, 0.0319) == "4.947 ± 0.032"
    assert plus_minus(-3.21e-15, 2.2e-16) == "(-3.21 ± 0.22)e-15"
    assert plus_minus(3.0, math.inf) == "3 ± inf"


def test_a_first_order_fit_prints_its_time_constant_and_no_delay(folder):
    code, said, _ = loopshape("fit", folder / "run", "--structure", "rational", "--high-hz", 5.0, "--delay")
    assert code == 0
    row = next(line for line in said.splitlines() if "pole1" in line)
    constant, spread = (float(x) for x in row.split("pole1")[1].replace("-", " ").split(" ± "))
    assert abs(constant - 0.2) < max(2.0 * spread, 0.004)
    assert "e-39" not in said


def test_the_help_groups_every_command_under_a_heading():
    """Headings in the order of the work, each command once."""
    told = loopshape("--help")[1]
    listed = [one.name for commands in COMMANDS.values() for one in commands]
    assert sorted(listed) == sorted(typer.main.get_command(app).commands)
    assert [told.index(f"{heading}:") for heading in COMMANDS] == sorted(told.index(f"{h}:") for h in COMMANDS)


def test_the_help_cuts_no_description_at_80_columns():
    """Each command's line ends with its sentence's own full stop, nothing is left out and nothing is folded."""
    told = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).stdout
    assert max(map(len, told.splitlines())) <= 80
    listed = told[told.index("Start:") :].splitlines()
    for commands in COMMANDS.values():
        for one in commands:
            (line,) = [line for line in listed if line.split()[:1] == [one.name]]
            assert line.endswith("."), line
            assert not line.endswith("..."), line
            assert function_at(one.at).__doc__.startswith(line.split(maxsplit=1)[1]), one.name


@pytest.mark.long
@pytest.mark.parametrize("name", [one.name for commands in COMMANDS.values() for one in commands])
def test_every_command_has_an_example_that_it_takes(name):
    """The words of the example are parsed by the command itself: a wrong option would be refused."""
    example = next(one.example for commands in COMMANDS.values() for one in commands if one.name == name)
    program, first, *words = example.split()
    command = typer.main.get_command(app).commands[name]
    assert (program, first) == ("loopshape", name)
    assert command.make_context(name, words).info_name == name
    assert example.split()[-1] in loopshape(name, "--help")[1]


def test_each_option_is_said_in_one_line():
    """72 characters: with its name one line of a terminal of 110 columns, whatever its default adds."""
    commands = typer.main.get_command(app).commands
    said = {f"{name} {p.opts[0]}": p.help or "" for name, command in commands.items() for p in command.params}
    assert {key: words for key, words in said.items() if len(words) > 72 or "\n" in words} == {}
