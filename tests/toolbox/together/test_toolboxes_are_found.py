"""Toolboxes by entry points: ours, a stranger's that is installed, and a broken one, which harms nothing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from loopshape.core.toolboxes import found

ROOT = Path(__file__).parents[3]
PLUGIN = ROOT / "examples" / "plugin"


def installed(folder, name, entry):
    """What an installation leaves of a package: the names of its entry points."""
    info = folder / f"{name}-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text(f"[loopshape.toolboxes]\n{entry}\n")
    return folder


def python(folder, *words, module=()):
    folder.mkdir(exist_ok=True)
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, *(module or ("-m", "loopshape")), *map(str, words)]
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        cwd=folder,
        timeout=120,
        check=False,
    )


def test_ours_are_found_and_their_folders_are_those_of_the_package():
    folders = {path.name for path in (ROOT / "loopshape" / "toolbox").iterdir() if (path / "__init__.py").exists()}
    assert set(found().toolboxes) >= folders
    assert found().broken == ()


def test_one_that_cannot_be_loaded_is_said_and_harms_nothing(tmp_path):
    (tmp_path / "wrecked.py").write_text("raise RuntimeError('no licence')\n")
    (tmp_path / "empty.py").write_text("TOOLBOX = 3\n")
    installed(tmp_path, "wrecked", "wrecked = wrecked:TOOLBOX\nempty = empty:TOOLBOX\ngone = gone:TOOLBOX")
    made = python(tmp_path, "--version")
    assert made.returncode == 0
    (one, two, three) = sorted(made.stderr.splitlines())
    assert "the toolbox empty of the package wrecked was left out: TypeError" in one
    assert "the toolbox gone" in two
    assert "RuntimeError: no licence" in three


def test_nobody_replaces_a_toolbox_of_ours_or_a_command_that_is_there(tmp_path):
    (tmp_path / "bold.py").write_text(
        "from loopshape.core.toolboxes import Command, Toolbox\n"
        "def check():\n    print('bold')\n"
        "TOOLBOX = Toolbox('bold', '', commands=(Command('Verify', 'check', 'bold:check', 'loopshape check'),))\n"
    )
    made = python(installed(tmp_path, "bold", "bold = bold:TOOLBOX\ngap = bold:TOOLBOX"), "check")
    assert "the toolbox gap of the package bold was left out" in made.stderr
    assert "the command check was left out" in made.stderr
    assert "bold\n" not in made.stdout


def test_a_toolbox_s_verb_stands_beside_those_of_the_bench_and_hides_none(tmp_path):
    (tmp_path / "bold.py").write_text(
        "from loopshape.core.toolboxes import Toolbox\n"
        "def half(x: float):\n    return x / 2\n"
        "check = gap = half\n"
        "TOOLBOX = Toolbox('bold', '', verbs={name: 'bold' for name in ('half', 'check', 'gap', 'interaction')})\n"
    )
    words = (
        "import loopshape as ls; print(ls.half(3.0), ls.check.__module__, ls.gap.__name__, ls.interaction.__module__);"
        "print(dir(ls).count('half'), dir(ls).count('check')); ls.half('3')"
    )
    made = python(installed(tmp_path, "bold", "bold = bold:TOOLBOX"), words, module=("-c",))
    ours = "loopshape.toolbox.diagrams.coupling.interaction"
    assert made.stdout.split() == ["1.5", "loopshape.verbs.chain", "loopshape.gap", ours, "1", "1"]
    assert "x of ls.half must be a number; received '3'" in made.stderr


def test_a_command_that_cannot_be_loaded_is_left_out_alone(tmp_path):
    (tmp_path / "half.py").write_text(
        "from loopshape.core.toolboxes import Command, Toolbox\n"
        "TOOLBOX = Toolbox('half', '', commands=(Command('Start', 'half', 'half:nothing', 'loopshape half'),))\n"
    )
    made = python(installed(tmp_path, "half", "half = half:TOOLBOX"), "--help")
    assert made.returncode == 0
    assert "the command half was left out: AttributeError" in made.stderr
    assert "  check " in made.stdout


@pytest.fixture
def plugin(tmp_path):
    """The example of a stranger's toolbox, as an installation leaves it."""
    (tmp_path / "loopshape_scope.py").write_text((PLUGIN / "loopshape_scope.py").read_text())
    return installed(tmp_path, "loopshape_scope", "scope = loopshape_scope:TOOLBOX")


@pytest.mark.long
def test_the_stranger_s_command_block_and_reader(plugin, tmp_path):
    recording = tmp_path / "trace.scope"
    recording.write_text("u y\n" + "\n".join(f"{k % 7} {k % 5}" for k in range(3000)))
    assert "u: 2\n" in python(plugin, "scope", recording).stdout
    assert "  scope " in python(plugin, "--help").stdout
    words = "import loopshape as ls; print(ls.scope.soft_notch(50.0).kind, 'scope' in dir(ls))"
    assert python(plugin, words, module=("-c",)).stdout.split() == ["notch", "True"]
    drafted = python(plugin, "import", recording, "--out", tmp_path / "run")
    assert "trace.scope" in drafted.stdout + drafted.stderr
    assert "of this kind is not read" not in drafted.stdout + drafted.stderr
    without = python(tmp_path / "nothing", "import", recording, "--out", tmp_path / "run")
    assert "of this kind is not read" in without.stderr


def test_the_example_is_short():
    lines = [(PLUGIN / name).read_text().splitlines() for name in ("loopshape_scope.py", "pyproject.toml")]
    assert sum(map(len, lines)) < 60
