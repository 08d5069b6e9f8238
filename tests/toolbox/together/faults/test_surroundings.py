"""What a command stands in: terminals that know few signs, odd names of folders, clocks that lie, decimal commas."""

import io
import json
import locale
import os
import re
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import typer
from bench import command, commands, in_a_child, prepare
from run_files import read_frfs

import loopshape as ls
from loopshape.cli import main
from loopshape.cli.output import safe

pytestmark = pytest.mark.long

CHAIN = ("import --replace", "frf", "fit", "tune", "check", "report", "plan", "export", "verify")
NO_TEXT = "\udcff\udcfe"  # bytes of another encoding, as Python has them
NAMES = ("nö±χ²", "a\nb", NO_TEXT)
MORE = ("a b", "名前", "$(touch x)", "-rf", "%s%n", "a'\"b", "x" * 200)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return prepare(tmp_path_factory.mktemp("around") / "whole")


def printed(words, encoding):
    """Exit code and bytes of both streams of a command in a terminal of an encoding."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True) for _ in range(2))
    with redirect_stdout(out), redirect_stderr(err), mock.patch.object(sys, "argv", ["loopshape", *map(str, words)]):
        try:
            main.run()
        except SystemExit as ended:
            code = ended.code or 0
    return json.dumps([code, out.buffer.getvalue().decode("latin-1"), err.buffer.getvalue().decode("latin-1")])


@pytest.mark.parametrize(
    "encoding", ["ascii", *(pytest.param(e, marks=pytest.mark.long) for e in ("latin-1", "cp1252"))]
)
def test_every_command_can_be_read_in_a_terminal_of_few_signs(whole, tmp_path, encoding):
    folder = tmp_path / "nö±χ²"
    shutil.copytree(whole, folder)
    for name, words in commands(folder).items():
        text, status = in_a_child(lambda words=words: printed(words, encoding))
        assert status == 0, name
        code, out, err = json.loads(text)
        assert code in (0, 1), (name, err)
        assert out.encode("latin-1").decode(encoding) is not None
        if "--json" in words:
            json.loads(out.encode("latin-1").decode(encoding))


@pytest.mark.long
def test_no_command_passes_an_escape_of_a_file_on_to_the_terminal(whole, tmp_path):
    shutil.copytree(whole, folder := tmp_path / "whole")
    path = folder / "runs" / "axis" / "run.toml"
    path = path if path.exists() else next(folder.rglob("run.toml"))
    text = re.sub(
        r"^notes = \[", 'notes = ["a \\\\u001b]0;owned\\\\u0007 note", ', path.read_text(), count=1, flags=re.M
    )
    assert "owned" in text
    path.write_text(text)
    assert safe("a \x1b]0;owned\x07 note") == "a \\x1b]0;owned\\x07 note"
    for name, words in commands(folder).items():
        text, status = in_a_child(lambda words=words: printed(words, "utf-8"))
        assert status == 0, name
        _, out, err = json.loads(text)
        assert not {"\x1b", "\x07", "\r"} & set(out + err), name


ESCAPE = "\x1b]0;owned\x07"


@pytest.mark.parametrize(
    "words",
    [
        ("frf", "run", f"more{ESCAPE}"), (f"frf{ESCAPE}",), ("frf", "run", f"--no{ESCAPE}"), (f"--no{ESCAPE}",),
        ("frf", "run", "--resolution-hz", ESCAPE), ("frf", f"run{ESCAPE}"), ("shape", f"run{ESCAPE}"),
        ("emulator", "--change", ESCAPE), ("emulator", "--change", f"{ESCAPE}=1"), ("emulator", "--tcp", ESCAPE),
    ],
    ids=range(10),
)  # fmt: skip
def test_no_word_of_the_command_line_steers_the_terminal(words):
    found = command(words)
    assert found.code == 2
    assert not {"\x1b", "\x07"} & set(found.out + found.err), found


@pytest.mark.parametrize("error", [ValueError("a"), typer.BadParameter(f"a{ESCAPE}")])
def test_an_error_of_use_is_shown_whatever_typer_makes_of_it(error):
    assert ESCAPE not in str(getattr(main._shown(error), "message", ""))


def test_a_sign_that_a_terminal_does_not_know_becomes_a_word_and_a_letter_its_number(whole):
    words = ("fit", whole / "run", "--structure", "rational", "--denominator", "1")
    text, _ = in_a_child(lambda: printed(words, "ascii"))
    assert "(+- 95 %)" in json.loads(text)[1]
    text, _ = in_a_child(lambda: printed(("frf", "/nowhere/名"), "ascii"))
    assert "\\u540d" in json.loads(text)[2]


def test_a_process_in_a_plain_terminal(whole):
    plain = {**os.environ, "LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    words = [sys.executable, "-m", "loopshape.cli.main", "fit", str(whole / "run"), "--structure", "third_order"]
    done = subprocess.run(words, capture_output=True, env=plain, check=False)
    assert done.returncode == 0, done.stderr
    assert b"+-" in done.stdout


@pytest.mark.parametrize("name", [*NAMES, *(pytest.param(n, marks=pytest.mark.long) for n in MORE)], ids=ascii)
def test_folders_of_odd_names(whole, tmp_path, name):
    folder = tmp_path / name
    shutil.copytree(whole, folder)
    for step in CHAIN if name in MORE else CHAIN[:5]:
        done = command(commands(folder)[step])
        assert done.code in (0, 1, 2 if name == NO_TEXT else 0), done
        assert "Traceback" not in done.err
    assert [p.name for p in tmp_path.iterdir()] == [name]


def results(folder):
    """Numbers that a chain of commands gave."""
    run = ls.read(folder / "run")
    columns = {name: run.recording("a").column(name) for name in run.recording("a").columns}
    return columns, read_frfs(folder / "run")[0].response


def same_results(folder, whole_folder):
    for found, expected in zip(results(folder)[0].items(), results(whole_folder)[0].items(), strict=True):
        assert found[0] == expected[0]
        np.testing.assert_array_equal(found[1], expected[1])
    np.testing.assert_array_equal(results(folder)[1], results(whole_folder)[1])


@pytest.fixture(scope="module")
def expected(whole, tmp_path_factory):
    folder = tmp_path_factory.mktemp("expected") / "work"
    shutil.copytree(whole, folder)
    for step in CHAIN:
        assert command(commands(folder)[step]).code in (0, 1)
    return folder


@pytest.fixture(scope="module")
def shim(tmp_path_factory):
    """A library that lies about the time."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs a C compiler and LD_PRELOAD")
    made = tmp_path_factory.mktemp("clock") / "clock.so"
    source = Path(__file__).with_name("clock.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", made, source], check=True)
    return made


CHILD = """
import sys
from pathlib import Path
from bench import commands, said_by
folder = Path(sys.argv[1])
for name in sys.argv[2:]:
    code, out, err = said_by(commands(folder)[name]).split("\\0")
    assert code in "01", (name, err)
    assert "Traceback" not in err, err
"""


@pytest.mark.parametrize(
    ("at", "back"),
    [
        pytest.param(0, 0, id="1970", marks=pytest.mark.long),
        pytest.param(4_000_000_000, 0, id="2096", marks=pytest.mark.long),
        pytest.param(1_700_000_000, 3600, id="goes-back"),
    ],
)
def test_clocks_that_lie_change_no_number(whole, expected, shim, tmp_path, at, back):
    folder = tmp_path / "work"
    shutil.copytree(whole, folder)
    there = {
        **os.environ, "LD_PRELOAD": str(shim), "CLOCK_AT": str(at), "CLOCK_BACK": str(back),
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
    }  # fmt: skip
    steps = CHAIN if back == 0 else CHAIN[:3]
    done = subprocess.run([sys.executable, "-c", CHILD, folder, *steps], capture_output=True, text=True, env=there)
    assert done.returncode == 0, done.stderr
    same_results(folder, expected)


@pytest.mark.parametrize("when_s", [0.0, 4e9, -1e9])
def test_files_of_any_age_are_read(whole, tmp_path, when_s):
    folder = tmp_path / "work"
    shutil.copytree(whole, folder)
    for path in folder.rglob("*"):
        os.utime(path, (when_s, when_s))
    for step in ("verify", "check", "fit", "frf"):
        done = command(commands(folder)[step])
        assert done.code in (0, 1), done


@pytest.fixture(scope="module")
def comma(tmp_path_factory):
    """A folder with the German locale, whose numbers have a comma."""
    tool = shutil.which("localedef")
    folder = tmp_path_factory.mktemp("locale")
    words = [tool, "-i", "de_DE", "-f", "UTF-8", folder / "de_DE.UTF-8"]
    if tool is None or subprocess.run(words, capture_output=True, check=False).returncode:
        pytest.skip("this system makes no locale")
    return folder


def test_a_decimal_comma_changes_no_number(whole, expected, comma, tmp_path):
    folder = tmp_path / "work"
    shutil.copytree(whole, folder)

    def german():
        os.environ["LOCPATH"] = str(comma)
        locale.setlocale(locale.LC_ALL, "de_DE.UTF-8")
        assert locale.localeconv()["decimal_point"] == ","

    for step in CHAIN[:5]:
        done = command(commands(folder)[step], before=german)
        assert done.code in (0, 1), done
    same_results(folder, expected)
