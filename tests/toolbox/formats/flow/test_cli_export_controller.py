"""export-controller end to end: a controller file becomes JSON, MATLAB and C, and settings survive their files."""

import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest
import typer
from bench_nouns import Block, LoopSetup
from run_files import write_controllers
from scipy import signal
from typer.testing import CliRunner

import loopshape as ls
from loopshape.io.config_table import ConfigTable
from loopshape.io.run.run_tables import loop_table, read_loops
from loopshape.io.write.frf_words import frf_header, frf_words
from loopshape.toolbox.formats.commands.export import export_controller
from loopshape.toolbox.formats.controllers.controller_words import comment, identifier

RATE_HZ = 1000.0
BLOCKS = (
    Block("gain", {"gain": 0.37}),
    Block("lead_lag", {"f1_hz": 2.2, "f2_hz": 18.0}),
    Block("notch", {"f1_hz": 4.5, "f2_hz": 4.5, "damping1": 0.05, "damping2": 0.8}),
    Block("gain", {"gain": -3.0}),
    Block("pi", {"f_hz": 0.7}),
)
FINE = ls.Controller("theta 2", BLOCKS, RATE_HZ, prewarp_hz=5.0, computation_delay_s=0.0005, precision="single")
COARSE = ls.Controller("p_ab", (Block("gain", {"gain": 1 / 3}),), RATE_HZ, added_hold=True, precision="q2.30")
PLAIN = ls.Controller("p_cd", BLOCKS[1:3], RATE_HZ)


def export(*words, code=0):
    app = typer.Typer()
    app.command()(export_controller)
    done = CliRunner().invoke(app, [str(word) for word in words])
    if code == 2:
        assert isinstance(done.exception, ls.LoopshapeError) or done.exit_code == 2
        return str(done.exception)
    assert done.exit_code == code, done.output + repr(done.exception)
    return done.stdout


@pytest.fixture
def file(tmp_path):
    write_controllers(tmp_path / "c.toml", (FINE, COARSE, PLAIN))
    return tmp_path / "c.toml"


def assert_same(mine, theirs):
    for field in fields(ls.Controller):
        assert getattr(mine, field.name) == getattr(theirs, field.name)


def test_settings_survive_a_controller_file(file):
    for mine, theirs in zip((FINE, COARSE, PLAIN), ls.read_controllers(file), strict=True):
        assert_same(mine, theirs)
        assert mine.digest == theirs.digest
    words = {"prewarp_hz", "computation_delay_s", "added_hold", "precision"}
    text = file.read_text()
    assert {word: text.count(f"{word} = ") for word in words} == dict.fromkeys(words, 1) | {"precision": 2}


def test_settings_survive_a_run_and_a_frf():
    recorded = replace(FINE, computation_delay_s=0.0, added_hold=False)
    table = loop_table(LoopSetup("theta 2", "r_rad", "n_rad", "z_v", "y_rad", recorded))
    assert_same(recorded, read_loops(ConfigTable({"loop": [table]}, "run.toml"), RATE_HZ)[0].controller)
    one = np.ones((3, 1, 1), dtype=complex)
    for recorded_under in (FINE, PLAIN):
        frf = ls.FRF(
            np.arange(1.0, 4.0), one, one, np.ones(3, dtype=bool), ("u",), ("y",), "test", "r01", "theta 2", RATE_HZ,
            recorded_under=recorded_under,
        )  # fmt: skip
        back = frf_words(json.loads(json.dumps(frf_header(frf))), "x")["recorded_under"]
        assert_same(
            ls.Controller("theta 2", **{f.name: getattr(recorded_under, f.name) for f in fields(recorded_under)[1:]}),
            back,
        )


def test_json(file, tmp_path):
    told = json.loads(export(file, "--to", "json", "--out", tmp_path / "out", "--json"))
    assert [one["loop"] for one in told["exported"]] == ["theta 2", "p_ab", "p_cd"]
    names = ["controller_theta_2.json", "controller_p_ab.json", "controller_p_cd.json"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(names)
    for name, controller in zip(names, (FINE, COARSE, PLAIN), strict=True):
        table = json.loads((tmp_path / "out" / name).read_text())
        assert table["format"] == "loopshape-biquads/1"
        assert table["form"] == "direct form II transposed"
        for word in (
            "loop",
            "rate_hz",
            "discretisation",
            "prewarp_hz",
            "computation_delay_s",
            "added_hold",
            "precision",
        ):
            assert table[word] == getattr(controller, word)
        assert table["digest"] == controller.digest
        blocks = tuple(Block.from_table(one["block"]) for one in table["sections"])
        assert blocks == controller.blocks
    coarse = json.loads((tmp_path / "out" / "controller_p_ab.json").read_text())
    assert coarse["fixed_point"] == {"integer_bits": 2, "fraction_bits": 30, "signal_limit": 2**29 - 1}
    assert coarse["sections"][0]["integers"]["b0"] == 357913941


def test_what_people_read(file, tmp_path):
    text = export(file, "--to", "c", "--out", tmp_path / "out")
    assert re.search(r"controller_theta_2\.h +theta 2 +[0-9a-f]{16} +single +5 ", text)
    assert re.search(r"controller_p_ab\.h +p_ab +[0-9a-f]{16} +q2\.30 +1 ", text)
    header = (tmp_path / "out" / "controller_theta_2.h").read_text()
    assert FINE.digest in header
    assert "exact at 5.0 Hz" in header
    assert export(file, "--to", "c", "--out", tmp_path / "two", "--quiet") == ""
    assert (tmp_path / "two" / "controller_theta_2.h").read_text() == header  # same controller, same bytes


def test_refusals(file, tmp_path):
    assert "format for controllers is not known" in export(file, "--to", "rust", "--out", tmp_path / "out", code=2)
    assert "does not exist" in export(tmp_path / "none.toml", "--to", "c", "--out", tmp_path / "out", code=2)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("loop", "name"),
    [
        ("theta2", "controller_theta2"),
        ("2nd axis", "controller_2nd_axis"),
        ("__a--b__", "controller_a_b"),
        ("θ2", "controller_u03b82"),
        ("int", "controller_int"),
        ("*/ int x; /*", "controller_int_x"),
    ],
)
def test_names_are_identifiers(loop, name):
    assert identifier(loop) == name


def test_long_names_stay_apart_and_short():
    one, two = identifier("x" * 100 + "a"), identifier("x" * 100 + "b")
    assert one != two
    assert len(one + "_coefficients") <= 63
    assert len(identifier("a" * 33 + "_" * 3 + "b" * 9)) <= 51


def test_comments_end_nowhere_and_stay_ascii():
    assert comment("theta2, p_ab") == "theta2, p_ab"
    said = comment("*/ /* ??/ \\ \n % { } θ")
    assert said.isascii()
    assert not set(said) & set("*/\\?%{}\n")


# A reader of the little MATLAB that is written: what it does not know makes the test fail.
TOKEN = re.compile(
    r"(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<word>[A-Za-z]\w*)|(?P<sign>[-+*/=()\[\],;:>])|(?P<space>\s+)"
)
STATEMENTS = [
    r"function \[ sos , g , Ts , C , delay_s \] = (?P<name>\w+) \( \)",
    r"g = (?P<g>-?\s?\S+) ;",
    r"Ts = 1 / (?P<rate>\S+) ;",
    r"delay_s = (?P<delay>\S+) ;",
    r"if nargout > 3",
    r"C = tf \( g , 1 , Ts \) ;",
    r"for k = 1 : size \( sos , 1 \)",
    r"C = C \* tf \( sos \( k , 1 : 3 \) , sos \( k , 4 : 6 \) , Ts \) ;",
    "end",
    "end",
    "end",
]


def tokens(line):
    code, found, at = line.split("%", 1)[0], [], 0
    while at < len(code):
        match = TOKEN.match(code, at)
        assert match, f"not MATLAB: {code[at:]!r}"
        at = match.end()
        if match.lastgroup != "space":
            found.append(match.group())
    return found


def read_matlab(text):
    """Words of the function, and its matrix row by row, from tokens; in the order of `STATEMENTS`."""
    assert text.isascii()
    rows, statements, inside = [], [], False
    for line in text.splitlines():
        if line.strip() in ("sos = [", "];"):
            inside = line.strip() != "];"
        elif inside:
            numbers = line.split("%", 1)[0].split()  # in a matrix a blank separates: -1 is a number, - 1 would be two
            assert all(re.fullmatch(r"-?\d+(\.\d*)?(e[+-]?\d+)?", one) for one in numbers)
            rows.append([float(one) for one in numbers])
        elif words := " ".join(tokens(line)):
            statements.append(words)
    assert not inside
    assert len(statements) == len(STATEMENTS)
    found = {}
    for statement, pattern in zip(statements, STATEMENTS, strict=True):
        match = re.fullmatch(pattern, statement)
        assert match, f"{statement!r} is not {pattern!r}"
        found |= match.groupdict()
    return found, np.array(rows)


def test_matlab(file, tmp_path):
    export(file, "--to", "matlab", "--out", tmp_path / "out")
    f = np.geomspace(0.1, 450.0, 50)
    for controller in (FINE, COARSE, PLAIN):
        name = identifier(controller.loop)
        words, sos = read_matlab((tmp_path / "out" / f"{name}.m").read_text())
        assert words["name"] == name
        assert (float(words["rate"]), float(words["delay"])) == (RATE_HZ, controller.computation_delay_s)
        gain = float(words["g"].replace(" ", ""))
        sections = controller.biquads()
        kept = [row for block, row in zip(controller.blocks, sections, strict=True) if block.kind != "gain"]
        expected = np.insert(kept, 3, 1.0, axis=1) if kept else np.array([[1.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
        np.testing.assert_array_equal(sos, expected)  # every digit
        found = gain * signal.freqz_sos(sos, worN=2.0 * np.pi * f / RATE_HZ)[1]
        np.testing.assert_allclose(found * controller.outside(f), controller.response(f), rtol=1e-7)
