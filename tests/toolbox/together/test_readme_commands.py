"""Commands of the README and of the how-to pages run as they stand, in a copy of the project's examples."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from text_layout import looked_at

import loopshape as ls

ROOT = Path(__file__).parents[3]
README = (ROOT / "README.md").read_text()
HOW_TO = [
    ROOT / "docs" / f"{name}.md" for name in ("tour", "own", "rig", "ci", "arm", "several", "gap", "machine", "adopt")
]
PAGES = "\n".join([README, *(page.read_text() for page in HOW_TO)])


def blocks() -> dict[str, str]:
    """Console blocks by the name in the comment before them; `winch` runs in `test_docs_page_of_your_own_machine`."""
    return dict(re.findall(r"<!-- (\w+) -->\n```console\n(.*?)```", PAGES, flags=re.S))


@pytest.mark.long
# the demo of the arm is the whole of its block; the double pendulum takes 80 s of a free core
@pytest.mark.parametrize(
    "name",
    ["tour", "own", "careful",
     *(pytest.param(name, marks=pytest.mark.hour) for name in ("rig", "arm", "several", "gap")),
     pytest.param("machine", marks=pytest.mark.timeout(900)),
     *(pytest.param(name, marks=[pytest.mark.hour, pytest.mark.timeout(900)]) for name in ("board", "adopt"))],
)  # fmt: skip
def test_block_runs(name: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    here = Path(sys.executable).parent
    script = blocks()[name].replace("$PWD/.venv/bin", str(here))
    if name in ("rig", "board", "adopt"):
        for program in ("cc",) if name == "rig" else ("arm-none-eabi-gcc", "qemu-system-arm", "make"):
            if shutil.which(program) is None:
                pytest.skip(f"there is no {program}, which the emulator needs")
        script = script.replace("4040", str(_free_port()))
        for study in (tmp_path / "examples" / "rig").glob("*.toml"):  # a busy machine's host may be late
            text = study.read_text().replace("watchdog_ms = 250\n", "")
            study.write_text(text.replace('on_limit = "vent"', 'watchdog_ms = 5000\non_limit = "vent"'))
    if name == "arm":  # the whole identification belongs to `make demo`: two points of it here
        _shorten(tmp_path / "examples" / "arm" / "identify.toml")
    environment = looked_at() | {"PATH": f"{here}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True,
        check=False, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    if name == "rig":
        assert "no motion; --arm lets it move" in done.stdout
        assert "every file is what was written" in done.stdout
        assert "the target is in state idle" in done.stdout
    elif name == "adopt":
        assert "adopted: S is as predicted" in done.stdout
    elif name == "careful":
        assert "enough for a verdict on these requirements (pass)" in done.stdout
    elif name == "gap":
        answer = json.loads((tmp_path / "out" / "gap" / "gap.json").read_text())
        assert answer["verdict"] == "gas_law"
        assert answer["gap"]["shrink"] > 0.9
    elif name == "machine":
        for line in _printed_on("machine"):
            assert _stands_in(line, done.stdout), line
        assert (tmp_path / "out" / "swing" / "gap_fix.py").exists()
    elif name == "several":
        assert "theta1 and theta2, 0.5 to 1 Hz: decoupled" in done.stdout
        assert "theta1 and theta2, 1 to 2 Hz: coupled" in done.stdout
        assert len(list((tmp_path / "out" / "arm2" / "export").glob("*.csv"))) == 5
    else:
        assert "\nverdict: pass: " in done.stdout


def _printed_on(page: str) -> list[str]:
    """Lines of a page's first block of text, those that are broken joined; "..." stands for what is left out."""
    block = re.search(r"```text\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text(), flags=re.S)
    assert block
    return [" ".join(line.split()) for line in block[1].replace("\n  ", " ").splitlines() if line.strip(". ")]


def _stands_in(line: str, printed: str) -> bool:
    """The same words, and numbers within 5 %, percentages within 2 points: another processor rounds otherwise."""
    number = r"(?<![\w.])\d+(?:\.\d+)?"
    words = r"(\d+(?:\.\d+)?)".join(map(re.escape, re.split(number, line)))
    alike = [
        pytest.approx(float(x[0]), rel=0.05, abs=2.0 if line[x.end() :].startswith("%") else 0.0)
        for x in re.finditer(number, line)
    ]
    found = re.finditer(words, " ".join(printed.split()))
    return any([float(x) for x in one.groups()] == alike for one in found)


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def _shorten(study: Path) -> None:
    text = study.read_text()
    start, end = text.index("operating_points = ["), text.index("[[loop]]")
    points = "operating_points = [{ theta2_deg = 0.0, p_ab_bar = 1.0 }, { theta2_deg = 15.0, p_ab_bar = 0.8 }]\n\n"
    text = text[:start] + points + text[end:]
    parts = re.split(r"(?=\[\[experiment\]\])", text)
    study.write_text("".join(part for part in parts if "-high" not in part))


def test_every_command_line_shown_is_run_by_a_test() -> None:
    console = "\n".join(re.findall(r"```console\n(.*?)```", PAGES, flags=re.S))
    shown = set(re.findall(r"^loopshape .*", console, flags=re.M))
    run = set(re.findall(r"^loopshape .*", "\n".join(blocks().values()), flags=re.M))
    assert len(run) >= 25
    assert shown == run


@pytest.mark.long
def test_the_python_of_the_readme_runs() -> None:
    (shown,) = re.findall(r"```python\n(.*?)```", README, flags=re.S)
    (printed,) = re.findall(r"```text\n(.*?)```", README, flags=re.S)
    done = subprocess.run([sys.executable, "-c", shown], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout == printed
    assert max(map(len, printed.splitlines())) <= 80


def test_the_workflow_shown_is_the_one_that_is_tested() -> None:
    (shown,) = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "ci.md").read_text(), flags=re.S)
    assert shown == (ROOT / "examples" / "ci" / "check-controllers.yml").read_text()


@pytest.mark.parametrize("page", [ROOT / "README.md", *HOW_TO], ids=lambda page: page.stem)
def test_what_a_page_shows_exists(page: Path) -> None:
    text = page.read_text()
    assert all((page.parent / path).exists() for path in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text))
    named = re.findall(r"`((?:examples|experiments|loopshape|docs)/[\w./]*)`", text)
    assert named
    assert all((ROOT / path).exists() for path in named)


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= 120


@pytest.mark.long
def test_the_numbers_of_the_tour_hold(tmp_path: Path) -> None:
    """53-54 Hz at -82 dB, 77 Hz at -37 dB, zeros 53.9 and poles 76.2 Hz, 36.6 Hz of bandwidth."""
    import numpy as np
    from conversions import db
    from run_files import read_fits, read_frfs

    from loopshape.cli.estimate.fit import fit_run
    from loopshape.cli.estimate.frf import estimate_and_report
    from loopshape.cli.output import Output
    from loopshape.identify.fit import modes
    from loopshape.toolbox.formats.commands.import_file import import_run

    bench, quiet = ROOT / "examples" / "motor_bench", Output(quiet=True)
    import_run(bench / "multisine_type_a.parquet", bench / "map.toml", tmp_path, quiet)
    estimate_and_report(tmp_path, quiet, figures=False)
    fit_run(tmp_path, quiet, structure="rational", numerator=2, denominator=4, delay=True, weighting="relative")
    (frf,), fits = read_frfs(tmp_path), read_fits(tmp_path)
    size = db(frf.siso)
    low = (frf.frequency_hz > 40) & (frf.frequency_hz < 65)
    assert frf.frequency_hz[low][np.argmin(size[low])] in (53.0, 54.0)
    assert size[low].min() == pytest.approx(-82.0, abs=0.5)
    assert frf.frequency_hz[np.argmax(np.where(frf.frequency_hz > 60, size, -np.inf))] == 77.0
    assert size[frf.frequency_hz == 77.0][0] == pytest.approx(-37.4, abs=0.5)
    found = {e.name: e.value for e in modes(fits[0])}
    assert found["zero1_f_hz"] == pytest.approx(53.9, abs=0.1)
    assert found["pole2_f_hz"] == pytest.approx(76.2, abs=0.1)
    tuned = ls.tune([frf], ls.read_requirements(bench / "requirements.toml")[0], fits=fits)
    assert tuned.feasible
    assert tuned.bandwidth_hz == pytest.approx(36.6, abs=0.3)
