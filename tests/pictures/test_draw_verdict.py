"""The margins map: every recording against the wish, outcomes told by their marks, intervals as bars."""

from dataclasses import replace

import loop_nouns
import numpy as np
import picture_nouns as nouns
import pytest
from matplotlib.axes import Axes

import loopshape as ls
from loopshape.loop.points import point_outcome
from loopshape.view.style import figure_of
from loopshape.view.verdict import verdicts
from loopshape.view.verdict.verdicts import MARKS

OUTCOMES = ("passed", "undecided", "failed")


def by_gid(ax: Axes, gid: str) -> list:
    return [line for line in ax.lines if line.get_gid() == gid]


def test_every_recording_stands_against_the_wish() -> None:
    verdict = nouns.verdict()
    figure = verdicts.margins_map(verdict)
    gain, reduction, *_ = figure.axes
    drawn = np.concatenate([line.get_ydata() for gid in (*OUTCOMES, "unstable") for line in by_gid(gain, gid)])
    assert sorted(drawn) == sorted(m.gain_margin_db for m in verdict.margins.values())
    assert list(by_gid(gain, "unstable")[0].get_xdata()) == [7]
    assert by_gid(gain, "required")[0].get_ydata()[0] == 6.0
    assert len(by_gid(reduction, "without end")[0].get_xdata()) == 24
    assert gain.get_ylabel() == "[dB]"
    assert figure.texts[1].get_text() == "stability undecided: r08"
    assert figure_of(gain) is figure


def test_marks_tell_the_outcomes_and_bars_are_the_intervals() -> None:
    _, _, verdict = loop_nouns.arm()
    line = next(x for x in verdict.lines if x.quantity == "sensitivity_peak_db")
    ax = verdicts.margin(verdict, line)
    marks = {}
    for gid in OUTCOMES:
        (points,) = by_gid(ax, gid)
        marks[gid] = (points.get_marker(), points.get_markerfacecolor())
        for k, value in zip(points.get_xdata(), points.get_ydata(), strict=True):
            m = list(verdict.margins.values())[int(k)]
            assert value == m.sensitivity_peak_db
            assert point_outcome(m, "sensitivity_peak_db", line.required) == gid
    assert marks["passed"][0] == "o"
    assert marks["undecided"] == ("D", "white")
    assert marks["failed"][0] == "x"
    bars = {int(bar.get_xdata()[0]): tuple(bar.get_ydata()) for bar in by_gid(ax, "interval")}
    low, high = ax.get_ylim()
    for k, m in enumerate(verdict.margins.values()):
        one, other = m.intervals["sensitivity_peak_db"]  # no bar where what lies above the band bounds the peak
        assert (k in bars) == (one < other)
        assert bars.get(k, (one, other)) == pytest.approx(np.clip((one, other), low, high))
    assert len(bars) > 20
    assert ax.get_title(loc="left") == "peak |S|, at most 6 dB: FAIL"


def test_an_unstable_loop_is_a_cross_whatever_its_numbers_say_and_is_named() -> None:
    _, _, verdict = loop_nouns.arm()
    found = dict(verdict.margins)
    found["r01"] = replace(found["r01"], stable="unstable")
    figure = verdicts.margins_map(ls.Verdict("theta2", verdict.lines, found))
    (cross,) = by_gid(figure.axes[0], "unstable")
    assert list(cross.get_xdata()) == [0]
    assert cross.get_marker() == MARKS["failed"]["marker"]
    assert figure.texts[1].get_text() == "unstable: r01"


def test_an_interval_without_end_does_not_stretch_the_axes() -> None:
    _, _, verdict = loop_nouns.arm()
    found = dict(verdict.margins)
    found["r01"] = found["r01"].with_readings(
        gain_margin_db=replace(found["r01"]["gain_margin_db"], interval=(3.0, float("inf")))
    )
    ax = verdicts.margin(ls.Verdict("theta2", verdict.lines, found), verdict.lines[0])
    assert np.isfinite(ax.get_ylim()).all()
    assert ax.get_ylim()[1] < 100.0
    (bar,) = [line for line in by_gid(ax, "interval") if line.get_xdata()[0] == 0]
    assert bar.get_ydata()[1] == ax.get_ylim()[1]
