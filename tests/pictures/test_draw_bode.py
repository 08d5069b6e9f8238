"""The Bode page: bands, measured frequencies, margins and peaks where the verdict has them, and its files."""

import loop_nouns
import numpy as np
import picture_nouns as nouns
import pytest
from bench_nouns import Loop
from conversions import db
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

import loopshape as ls
from loopshape.loop.points import band
from loopshape.view.plots.bode import bode_page
from loopshape.view.plots.curves import loop_phase_deg

pytestmark = pytest.mark.short


def by_gid(ax: Axes, gid: str | None) -> list:
    return [line for line in ax.lines if line.get_gid() == gid]


@pytest.fixture(scope="module")
def page() -> tuple[Figure, Loop, ls.Verdict]:
    frf = loop_nouns.noisy(loop_nouns.plant())
    loop, verdict = loop_nouns.checked(frf, loop_nouns.gain(), loop_nouns.required(complementary_peak_db=6.0))
    return bode_page(loop, loop_nouns.required(complementary_peak_db=6.0), verdict=verdict), loop, verdict


def test_labels_and_units(page: tuple[Figure, Loop, ls.Verdict]) -> None:
    labels = [ax.get_ylabel() for ax in page[0].axes]
    assert labels == [
        "|P| [dB re rad/V]", "phase of P [deg]", "|C| [dB re V/rad]", "phase of C [deg]",
        "|L| [dB]", "phase of L [deg]", "|S| [dB]", "|T| [dB]",
    ]  # fmt: skip
    assert [ax.get_xlabel() for ax in page[0].axes[-2:]] == ["frequency [Hz]"] * 2
    assert "|1 + L| = " in page[0].texts[1].get_text() or "least |1 + L|" in page[0].texts[1].get_text()


def test_curves_are_the_loops_own_between_their_bands(page: tuple[Figure, Loop, ls.Verdict]) -> None:
    figure, loop, _ = page
    for k, name in ((0, "P"), (4, "L"), (6, "S"), (7, "T")):
        curve = by_gid(figure.axes[k], None)[0]
        own = db(loop.plant.siso if name == "P" else getattr(loop, name))
        assert np.array_equal(curve.get_ydata(), own)
        (edge,) = [patch.get_xy() for patch in figure.axes[k].patches if patch.get_gid() == "band"]
        assert np.array_equal(edge[: own.size, 1], band(loop, name).low_db)
        assert np.all(edge[: own.size, 1] <= own)
    assert not [patch for ax in figure.axes[2:4] for patch in ax.patches if patch.get_gid() == "band"]
    phases = [patch.get_xy() for patch in figure.axes[5].patches if patch.get_gid() == "band"]
    phase, _ = loop_phase_deg(loop)
    lines = loop.frequency_hz.size
    assert np.allclose(phases[0][:lines, 1], phase + band(loop, "L").low_deg)


def test_lines_as_measured_are_dots_near_the_curve(page: tuple[Figure, Loop, ls.Verdict]) -> None:
    figure, loop, _ = page
    raw = loop.raw
    (dots,) = by_gid(figure.axes[0], "measured")
    assert np.array_equal(dots.get_ydata(), db(raw.siso))
    (dots,) = by_gid(figure.axes[5], "measured")
    phase, _ = loop_phase_deg(loop)
    near = np.interp(np.log(dots.get_xdata()), np.log(loop.frequency_hz), phase)
    assert np.max(np.abs(dots.get_ydata() - near)) < 60.0  # 10 % noise: 4 degrees of deviation; a turn would be 360


def test_margins_and_peaks_stand_where_the_verdict_has_them(page: tuple[Figure, Loop, ls.Verdict]) -> None:
    figure, _, verdict = page
    m = verdict.margins["noisy"]
    (bar,) = by_gid(figure.axes[4], "gain margin")
    assert list(bar.get_xdata()) == [m.at_hz["gain_margin_db"]] * 2
    assert list(bar.get_ydata()) == [-m.gain_margin_db, 0.0]
    (bar,) = by_gid(figure.axes[5], "phase margin")
    assert bar.get_ydata()[0] == -180.0
    assert np.ptp(bar.get_ydata()) == pytest.approx(m.phase_margin_deg)
    (dot,) = by_gid(figure.axes[4], "bandwidth")
    assert (dot.get_xdata()[0], dot.get_ydata()[0]) == (m.bandwidth_hz, 0.0)
    for ax, quantity in ((figure.axes[6], "sensitivity_peak_db"), (figure.axes[7], "complementary_peak_db")):
        (dot,) = by_gid(ax, "peak")
        assert (dot.get_xdata()[0], dot.get_ydata()[0]) == (m.at_hz[quantity], getattr(m, quantity))
        reach = [bar.get_segments()[0][:, 1] for bar in ax.collections if isinstance(bar, LineCollection)]
        assert any(np.allclose(ends, m.intervals[quantity]) for ends in reach)
        low, high = m.intervals[quantity]
        assert f"(95 %: {low:.2f} to {high:.2f})" in ax.get_title(loc="left")
    assert figure.axes[4].get_title(loc="left").startswith(f"gain margin {m.gain_margin_db:.2f} dB (95 %: ")


def test_limits_are_drawn(page: tuple[Figure, Loop, ls.Verdict]) -> None:
    figure, _, _ = page
    for ax in figure.axes[6:]:
        (limit,) = by_gid(ax, "limit")
        assert list(limit.get_ydata()) == [6.0, 6.0]
        low, high = ax.get_ylim()
        assert low < 6.0 < high


def test_a_margin_beyond_the_last_line_is_said_to_lie_above_it() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    found = [verdict.margins[x.plant.recording] for x in loops]
    k = next(k for k, m in enumerate(found) if m.sensitivity_peak_db > 9.0 and "sensitivity_peak_db" in m.bounds)
    figure = bode_page(loops[k], requirements, verdict=verdict)
    assert f"above {loops[k].frequency_hz[-1]:.3g} Hz" in figure.axes[6].get_title(loc="left")


def test_without_a_verdict_and_smoothing_the_page_has_neither_margins_nor_dots() -> None:
    figure = bode_page(nouns.loops()[0], None)
    gids = {line.get_gid() for ax in figure.axes for line in ax.lines}
    assert not gids & {"gain margin", "phase margin", "peak", "measured"}
