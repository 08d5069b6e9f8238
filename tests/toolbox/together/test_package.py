"""What is shipped: the wheel of the sdist works in a clean environment, and the recipes say what pyproject says."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
from pathlib import Path

import pytest
import yaml

import loopshape

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
RECIPE = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())
CHECK = """
from importlib.resources import files
import loopshape as ls
bench = files("loopshape") / "examples" / "motor_bench"
run = ls.formats.read_table(bench / "multisine_type_a.parquet", bench / "map.toml")
(controller,) = ls.read_controllers(bench / "controller.toml")
(required,) = ls.read_requirements(bench / "requirements.toml")
P = ls.frf(run)
model = ls.fit(P, "rational", numerator=2, denominator=4, delay=True, weighting="relative")
print(ls.__file__, ls.check(P, controller, required, fits=[model]).outcome)
"""


def _run(*command: str | Path, cwd: Path) -> str:
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(command, cwd=cwd, env=clean, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the sdist and the wheel that is made from it."""
    if not (uv := Path(sys.executable).with_name("uv")).exists():
        pytest.skip("uv, which builds the wheel, is not in this environment")
    dist = tmp_path_factory.mktemp("dist")
    _run(uv, "build", "--offline", "--no-build-isolation", "--python", sys.executable, "-o", dist, ROOT, cwd=dist)
    return dist


@pytest.fixture(scope="module")
def installed(built):
    """The `bin` of a new environment: the wheel, and from here the libraries (a path: no editable install)."""
    home = built / "venv"
    venv.create(home, with_pip=False)
    bin_folder = home / "bin"
    (wheel,) = built.glob("*.whl")
    uv = Path(sys.executable).with_name("uv")
    _run(uv, "pip", "install", "--offline", "--no-deps", "--python", bin_folder / "python", wheel, cwd=built)
    (libraries,) = home.glob("lib/python*/site-packages")
    (here,) = {path for path in sys.path if path.endswith("site-packages")}
    (libraries / "libraries_of_the_tests.pth").write_text(here)
    return bin_folder


@pytest.mark.long
def test_the_wheel_checks_the_bench_of_the_tour_where_there_is_no_clone(installed, tmp_path):
    assert _run(installed / "loopshape", "--version", cwd=tmp_path).strip() == loopshape.__version__
    where, outcome = _run(installed / "python", "-c", CHECK, cwd=tmp_path).split()
    assert Path(where).is_relative_to(installed.parent)
    assert outcome == "passed"


@pytest.mark.long
def test_the_examples_of_the_wheel_are_those_of_the_clone(installed, tmp_path):
    _run(installed / "loopshape", "examples", "--out", "examples", cwd=tmp_path)
    ours = {path.relative_to(ROOT) for path in (ROOT / "examples").rglob("*.*") if "__pycache__" not in path.parts}
    theirs = {path.relative_to(tmp_path) for path in (tmp_path / "examples").rglob("*.*")}
    assert theirs == ours
    assert all((tmp_path / path).read_bytes() == (ROOT / path).read_bytes() for path in ours)
    again = subprocess.run([installed / "loopshape", "examples"], cwd=tmp_path, capture_output=True, check=False)
    assert again.returncode == 2


@pytest.mark.long
def test_the_sdist_holds_no_pictures_and_no_studies(built):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as packed:
        names = {Path(name).parts[1] for name in packed.getnames()}
    assert {"loopshape", "examples", "LICENSE", "README.md", "CITATION.cff", "pyproject.toml"} <= names
    assert not names & {"figures", "experiments", "tests"}
    assert sdist.stat().st_size < 2e6


def test_a_folder_named_like_the_package_does_not_shadow_an_editable_install(tmp_path):
    (tmp_path / "loopshape").mkdir()
    (tmp_path / "script.py").write_text("import loopshape; print(loopshape.__version__)")
    assert _run(sys.executable, "script.py", cwd=tmp_path).strip() == loopshape.__version__


def test_the_version_is_the_same_wherever_it_is_written():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert cited["version"] == RECIPE["context"]["version"] == loopshape.__version__
    assert cited["license"] == PROJECT["project"]["license"] == RECIPE["about"]["license"]
    assert "version" not in PROJECT["project"]


def test_the_conda_recipe_needs_what_the_project_needs():
    def split(lines):
        return {re.split(r"\s*(?=>=)", line)[0]: line.split(">=")[1] for line in lines}

    wanted = split(PROJECT["project"]["dependencies"]) | {"python": PROJECT["project"]["requires-python"][2:]}
    wanted["matplotlib-base"] = wanted.pop("matplotlib")  # conda's matplotlib brings Qt
    assert split(RECIPE["requirements"]["run"]) == wanted
    backend = split(PROJECT["build-system"]["requires"])
    assert backend.items() <= split(line for line in RECIPE["requirements"]["host"] if ">=" in line).items()
    ((name, entry),) = PROJECT["project"]["scripts"].items()
    assert RECIPE["build"]["python"]["entry_points"] == [f"{name} = {entry}"]
