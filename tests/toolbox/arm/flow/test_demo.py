"""The demo as a newcomer runs it: it passes, every figure that it names is there, and it writes no other."""

import json
from pathlib import Path

import pytest
from commands import invoked


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_the_demo_passes_and_draws_every_figure_it_names(tmp_path):
    done = invoked(["demo", "--out", str(tmp_path), "--json"])
    assert done.exit_code == 0, done.output[-3000:]
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["passed"] is True
    assert len(told["figures"]) > 20
    assert all(Path(figure).stat().st_size > 10_000 for figure in told["figures"])
    assert set(map(str, tmp_path.rglob("*.png"))) == set(told["figures"])
