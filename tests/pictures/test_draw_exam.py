"""Pictures of an exam show every answer where it belongs, with words and limits that fit."""

from dataclasses import replace

import numpy as np
import pytest
from exam_pictures import (
    RIGHT,
    WRONG,
    confusion_figure,
    confusion_map,
    reliability,
    reliability_figure,
    shrink_figure,
    shrinks,
)
from examiner.score import Marked, calibrated
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from loopshape.view.style import png

BARS = {"must": 0.8, "aim": 0.95}
CONFUSION = {
    "leak": {"leak": 2, "hose_lag": 1},
    "hose_lag": {"hose_lag": 3},
    "none": {"none": 18, "leak": 2},
    "unknown": {"none": 1, "unknown": 4},
    "pair": {"pair": 1, "wrong pair": 1, "failed": 1},
}


def marked(truth: str, shrink: float | None, said: str | None = None) -> Marked:
    return Marked(
        "case-001", "single", truth, 0, said or truth, 0.9, 1, True, 1, True, 1, 1.0, 1.0, 0.0, True, shrink, 60.0
    )


def cells(ax: Axes, gid: str) -> dict[tuple[float, float], Rectangle]:
    return {p.get_xy(): p for p in ax.patches if isinstance(p, Rectangle) and p.get_gid() == gid}


def test_every_count_stands_in_its_cell() -> None:
    ax = confusion_map(CONFUSION)
    columns = [t.get_text() for t in ax.get_xticklabels()]
    rows = [t.get_text() for t in ax.get_yticklabels()]
    assert columns == ["hose lag", "leak", "none", "unknown", "pair", "wrong pair", "failed"]
    assert rows == ["hose lag", "leak", "none", "unknown", "pair"]
    shown = {(t.get_position()[0] - 0.5, round(t.get_position()[1] - 0.52)): t.get_text() for t in ax.texts}
    for truth, row in CONFUSION.items():
        for verdict, count in row.items():
            at = (columns.index(verdict.replace("_", " ")), rows.index(truth.replace("_", " ")))
            assert shown[at] == str(count)
            assert at in cells(ax, "right" if truth == verdict else "wrong")
    assert len(shown) == sum(len(row) for row in CONFUSION.values())


def test_right_and_wrong_differ_in_colour_and_larger_shares_are_darker() -> None:
    ax = confusion_map(CONFUSION)
    right, wrong = cells(ax, "right"), cells(ax, "wrong")
    assert RIGHT != WRONG
    assert right[(0, 0)].get_alpha() == pytest.approx(1.0)  # 3 of 3
    assert right[(1, 1)].get_alpha() == pytest.approx(0.75)  # 2 of 3
    assert wrong[(0, 1)].get_alpha() < right[(1, 1)].get_alpha()


def test_reliability_shows_each_bin_at_its_mean_confidence_with_its_count() -> None:
    rng = np.random.default_rng(2)
    confidence = rng.random(200)
    found = calibrated(confidence, (rng.random(200) < confidence).astype(float))
    ax = reliability(found)
    points = ax.containers[0].lines[0]
    assert np.allclose(points.get_xdata(), [b.confidence for b in found.bins])
    assert np.allclose(points.get_ydata(), [b.right.value for b in found.bins])
    counts = [t.get_text() for t in ax.texts if t.get_gid() == "count"]
    assert sum(map(int, counts)) == 200
    assert "calibrated" in [t.get_text() for t in ax.get_legend().get_texts()]


def test_shrinks_stand_in_the_line_of_their_effect_and_the_best_is_uppermost() -> None:
    cases = [marked("leak", 0.5), marked("leak", 0.7), marked("payload", 0.9), marked("gas_law", None)]
    ax = shrinks([*cases, marked("backlash", -3.0)], **BARS)
    assert [t.get_text() for t in ax.get_yticklabels()] == ["backlash", "leak", "payload"]
    shown = {float(line.get_ydata()[0]): line.get_xdata() for line in ax.lines if line.get_gid() == "shrink"}
    assert np.allclose(shown[1.0], [0.5, 0.7])
    assert ax.get_xlim()[0] < float(shown[0.0][0]) < 0.0  # far below: at the edge, and seen
    labels = [t.get_text() for t in ax.get_legend().get_texts()]
    assert labels == ["must of the median, 80%", "aim of the median, 95%", "median of all, 60%"]


def test_figures_say_their_numbers_and_are_drawn_without_answers_too() -> None:
    figure = confusion_figure(CONFUSION)
    assert any("28 of 34 answers right" in t.get_text() for t in figure.texts)
    cases = [marked("leak", 0.5), marked("leak", None), marked("leak", None, "payload")]
    assert any("2 single effects named right, 1 without" in t.get_text() for t in shrink_figure(cases, **BARS).texts)
    for empty in (
        confusion_figure({}),
        reliability_figure(calibrated(np.zeros(0), np.zeros(0))),
        shrink_figure([], **BARS),
    ):
        assert png(empty).startswith(b"\x89PNG")
    assert png(shrink_figure([replace(cases[0], truth="payload")], **BARS)).startswith(b"\x89PNG")
