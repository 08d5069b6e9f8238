"""The demo as a newcomer runs it: it passes, every figure that it names is there and every figure can be read."""

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from text_layout import unreadable
from typer.testing import CliRunner

from loopshape.cli import pictures
from loopshape.cli.main import app


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_the_demo_passes_and_draws_every_figure_it_names(tmp_path, monkeypatch):
    found: dict[str, list[str]] = {}
    save = pictures.save

    def save_and_look(figure: Figure, path: Path) -> Path:
        kept = save(figure, path)
        found[str(kept)] = unreadable(figure)
        return kept

    monkeypatch.setattr(pictures, "save", save_and_look)
    done = CliRunner().invoke(app, ["demo", "--out", str(tmp_path), "--json"])
    assert done.exit_code == 0, done.output[-3000:]
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["passed"] is True
    assert len(told["figures"]) > 20
    assert all(Path(figure).stat().st_size > 10_000 for figure in told["figures"])
    assert {name: lines for name, lines in found.items() if lines} == {}
    assert set(found) == set(told["figures"])
