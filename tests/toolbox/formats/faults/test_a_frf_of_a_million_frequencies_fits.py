"""An FRF of very many frequencies is checked, drawn and reported in bounded memory, and its page stays small."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from bench_nouns import Block
from memory_limit import in_a_child

import loopshape as ls
from loopshape.loop.stability.sampling import between_lines
from loopshape.toolbox.formats.frf.frf_exchange import add_frfs

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="limits are set as Linux has them")

REQUIREMENTS = """
format = "loopshape-requirements/1"
[[loop]]
name = "axis"
phase_margin_deg = 40.0
unstable_poles = 0
"""
BEFORE = """
from loopshape.cli.verify.check import check_run
from loopshape.cli.estimate.figures import figures
from loopshape.toolbox.pages.commands import report
from loopshape.cli.output import Output
def all_of(folder):
    run, controller, require = folder / "run", folder / "controller.toml", folder / "require.toml"
    assert check_run(run, controller, require, Output(False, True), figures=False)[0]
    figures(run, None, controller, require, quiet=True)
    report(run, controller, require, out=folder / "page.html", date="today", figures_mb=0.7, quiet=True)
all_of(Path(sys.argv[1]))  # what the libraries reserve once
"""
WORK = "all_of(Path(sys.argv[2]))"


def written(folder, n):
    """A run of one FRF on n frequencies, with a resonance, and a controller that holds it."""
    folder.mkdir()
    rng, f = np.random.default_rng(0), np.arange(1, n + 1) * (4000.0 / n)
    mode = 0.02 * 180.0**2 / (180.0**2 - f**2 + 3.6j * f)
    P = 10.0 / (1j * f) / (1.0 + 1j * f / 2000.0) * (1.0 + mode)
    P *= 1.0 + 0.01 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    names = {"loop": "axis", "recording": "r", "inputs": ("u_v",), "outputs": ("y_m",)}
    add_frfs(folder / "run", [ls.FRF.from_arrays(f, P, relative_std=0.0142, rate_hz=10_000.0, **names)])
    blocks = (Block("gain", {"gain": 5.0}), Block("lead_lag", {"f1_hz": 30.0, "f2_hz": 300.0}))
    ls.write(ls.Controller(loop="axis", rate_hz=10_000.0, blocks=blocks), folder / "controller.toml")
    (folder / "require.toml").write_text(REQUIREMENTS)
    return folder


@pytest.mark.long
@pytest.mark.parametrize(
    ("frequencies", "most_bytes"),
    [(100_000, 200_000_000), pytest.param(1_000_000, 1_600_000_000, marks=(pytest.mark.long, pytest.mark.hour))],
)
def test_check_figures_and_report(tmp_path, frequencies, most_bytes):
    few, many = written(tmp_path / "few", 1_000), written(tmp_path / "many", frequencies)
    assert in_a_child(BEFORE, WORK, most_bytes, few, many) < 2e9
    assert (many / "page.html").stat().st_size < 10e6
    assert len(list((many / "run" / "figures").glob("*.png"))) >= 5


def most_bytes_of(n):
    """What the search for resonances between n frequencies takes at most."""
    f = np.linspace(1.0, 1000.0, n)
    P = 1.0 / (1.0 + 1j * f / 30.0)
    tracemalloc.start()
    between_lines(f, P, (1e-3 * np.abs(P)) ** 2)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


def test_memory_grows_as_the_frequencies_do():
    most_bytes_of(100)  # what is made once
    assert most_bytes_of(8_000) < 4.4 * most_bytes_of(2_000)
