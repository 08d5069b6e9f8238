"""The demo as a newcomer runs it: it passes, and every figure that it names is there."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_the_demo_passes_and_draws_every_figure_it_names(tmp_path):
    command = [sys.executable, "-m", "loopshape.cli.main", "demo", "--out", str(tmp_path), "--json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    told = json.loads(done.stdout)
    assert told["passed"] is True
    assert len(told["figures"]) > 20
    assert all(Path(figure).stat().st_size > 10_000 for figure in told["figures"])
