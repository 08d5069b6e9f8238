"""Loop pictures: the curves are the loop's own, the worst point has its band, limits are where they were asked."""

from dataclasses import replace

import numpy as np
import picture_nouns as nouns
import pytest
from bench_nouns import Loop
from conversions import db
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

import loopshape as ls
from loopshape.loop.points import band, worst_of
from loopshape.view.labels import point
from loopshape.view.plots import loops as pictures
from loopshape.view.plots.nichols import nichols
from loopshape.view.style import LIMIT


def by_gid(ax: Axes, gid: str | None) -> list:
    return [line for line in ax.lines if line.get_gid() == gid]


def bands(ax: Axes) -> list[np.ndarray]:
    return [patch.get_xy() for patch in ax.patches if patch.get_gid() == "band"]


def test_the_sensitivities_carry_units_and_limits() -> None:
    loops = nouns.loops()[:3]
    figure = pictures.sensitivities(loops, nouns.requirements())
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == ["|S| [dB]", "|T| [dB]", "|CS| [dB re V/rad]", "|PS| [dB re rad/V]"]
    limits = [[(*line.get_xdata(), line.get_ydata()[0]) for line in by_gid(ax, "limit")] for ax in figure.axes]
    assert [[row[2] for row in rows] for rows in limits] == [[6.0], [6.0], [30.0, 0.0], []]
    assert limits[2][1][0] == 30.0  # |CS| at high frequency starts at its own frequency
    for ax, name in zip(figure.axes, ("S", "T", "CS", "PS"), strict=True):
        curves = by_gid(ax, None)
        for loop, line in zip(loops, curves, strict=True):
            assert np.array_equal(line.get_ydata(), db(getattr(loop, name))[loop.plant.valid])


def test_the_loop_page_shows_plant_controller_open_loop_and_sensitivity() -> None:
    loops = nouns.loops()
    figure = pictures.loop_page(loops, nouns.requirements(), verdict=nouns.verdict())
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == [
        "|P| [dB re rad/V]", "phase of P [deg]", "|C| [dB re V/rad]", "phase of C [deg]",
        "|L| [dB]", "phase of L [deg]", "|S| [dB]", "|T| [dB]",
    ]  # fmt: skip
    c = figure.axes[2]
    assert len(c.lines) == 1  # one controller for all operating points is drawn once
    assert np.array_equal(c.lines[0].get_ydata(), db(loops[0].C))
    required = by_gid(figure.axes[4], "bandwidth required")
    assert [line.get_xdata()[0] for line in required] == [1.0]
    assert to_rgba(required[0].get_color()) == to_rgba(LIMIT)
    assert len({ax.get_xlim() for ax in figure.axes}) == 1


def test_the_worst_point_is_thick_named_and_alone_has_a_band() -> None:
    loops = nouns.loops()
    worst = worst_of(loops)
    figure = pictures.loop_page(loops, nouns.requirements())
    widths = [line.get_linewidth() for line in by_gid(figure.axes[0], None)]
    assert [k for k, width in enumerate(widths) if width > 1.5] == [worst.index]
    loop = loops[worst.index]
    for ax, name in ((figure.axes[0], "P"), (figure.axes[6], "S"), (figure.axes[7], "T")):
        (edge,) = bands(ax)
        ends, use = band(loop, name), loop.plant.valid
        lines = np.count_nonzero(use)
        assert np.array_equal(edge[:lines, 1], ends.low_db[use])
        assert np.array_equal(edge[lines : 2 * lines, 1], ends.high_db[use][::-1])
    assert not bands(figure.axes[2])  # the controller is known
    assert f"worst: {point(loop.plant.operating_point)}, " in figure.texts[1].get_text()
    assert f"at {worst.at_hz:.3g} Hz" in figure.texts[1].get_text()


def test_without_a_variance_there_is_no_band() -> None:
    plant = nouns.frf(0.0, 1.0)
    plant = replace(plant, covariance=np.zeros_like(plant.covariance))
    figure = pictures.loop_page([Loop(plant, nouns.controller(), 1, unstable_poles=0)], None)
    assert not any(bands(ax) for ax in figure.axes)


def test_controllers_that_differ_are_drawn_each() -> None:
    loops = [
        Loop(nouns.frf(*point), nouns.controller(gain), unstable_poles=0)
        for point, gain in zip(nouns.POINTS, (9.0, 11.0), strict=False)
    ]
    c = pictures.loop_page(loops, None).axes[2]
    assert len(c.lines) == 2


def test_pictures_without_loops_are_refused() -> None:
    for picture in (nichols, pictures.loop_page, pictures.sensitivities):
        with pytest.raises(ls.errors.WrongUseError, match="at least one"):
            picture([], None)


def test_two_controllers_stand_in_one_figure(tmp_path) -> None:
    f = np.geomspace(1.0, 200.0, 120)
    H = np.exp(-2j * np.pi * f * 0.001) / (1.0 + 2j * np.pi * f * 0.02) ** 2
    P = ls.FRF.from_arrays(f, H, std=1e-5 * np.abs(H), rate_hz=1000.0, loop="x", recording="r1")
    made = {"old": 2.0, "new": 5.0}
    C = {name: ls.controller(ls.gain(k), rate_hz=1000.0, loop="x") for name, k in made.items()}
    figure = ls.plot.bode(P, C, ls.Requirements("x", phase_margin_deg=45.0, integrators=0, unstable_poles=0))
    figure.savefig(tmp_path / "two.png")
    S = next(ax for ax in figure.axes if ax.get_ylabel() == "|S| [dB]")
    for line, k in zip(by_gid(S, None), made.values(), strict=True):
        np.testing.assert_allclose(line.get_ydata(), -20.0 * np.log10(np.abs(1.0 + k * H)), atol=1e-3)
    named = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert {"r1 old", "r1 new"} <= set(named)
    ls.plot.nichols(P, C).figure.savefig(tmp_path / "nichols.png")
