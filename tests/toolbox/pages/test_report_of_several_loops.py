"""The report of loops that are checked together."""

import re

from coupled_run import REQUIREMENTS, coupled_run

import loopshape as ls
from loopshape.verbs import runs


def test_the_report_says_of_each_loop_and_of_all_what_check_says(tmp_path):
    run = coupled_run(tmp_path)
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
