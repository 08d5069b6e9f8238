"""The report of loops that are checked together."""

import re

import numpy as np
import pytest
from conversions import TWO_PI
from run_files import write_controllers, write_matrices
from several_cases import frf_of, gain, noisy

import loopshape as ls
from loopshape.verbs import runs

F = np.arange(0.1, 20.0, 0.1)
S = 1j * TWO_PI * F
REQUIREMENTS = """
format = "loopshape-requirements/1"

[[loop]]
name = "a"
modulus_margin = 0.5

[[loop]]
name = "b"
modulus_margin = 0.5

[several]
disk_margin = {disk}
sensitivity_peak_db = 8.0
integrators = 2
unstable_poles = 0
"""


def matrix(coupling, recording="exact"):
    G = np.array([[1.0, coupling], [-coupling, 1.0]]) * (4.0 / (S * (0.02 * S + 1.0)))[:, None, None]
    return noisy(frf_of(F, G, 0.01, loop="a+b", recording=recording), np.random.default_rng(0))


@pytest.fixture
def run(tmp_path):
    write_matrices(tmp_path, [matrix(0.3)])
    write_controllers(tmp_path / "c.toml", [gain("a"), gain("b")])
    (tmp_path / "r.toml").write_text(REQUIREMENTS.format(disk=0.5))
    return tmp_path


def test_the_report_says_of_each_loop_and_of_all_what_check_says(run):
    (run / "r.toml").write_text(REQUIREMENTS.format(disk=1.9))
    checked = runs.check(run, run / "c.toml", run / "r.toml").checks.verdicts
    page = ls.report(run, controllers=run / "c.toml", requirements=run / "r.toml", date="d").read_text(encoding="utf-8")
    for one in checked:
        assert re.search(rf'<div class="card {one.outcome.value}"><h3>.*? Loop {re.escape(one.loop)}: ', page)
        assert f"Requirements of loop {one.loop}, each at its worst" in page
        assert f"Margins of loop {one.loop}: " in page
    assert [one.outcome.value for one in checked] == ["passed", "passed", "failed"]
    assert "disk margin: required ≥ 1.9, found " in page
    assert "encirclements of 0 by det(I + L)" in page
    assert "Loops a + b at once at exact: eigenvalues of L" in page
    assert "No frequency response of a single loop" not in page
    assert "No fitted models" not in page
