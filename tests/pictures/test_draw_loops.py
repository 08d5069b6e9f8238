"""Loop pictures: the curves are the loop's own, the limits are where the definitions put them."""

import numpy as np
import picture_nouns as nouns
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba

from loopshape.draw import loops as pictures
from loopshape.draw.contours import constant_s, constant_t, nichols_coordinates, turns
from loopshape.draw.style import LIMIT
from loopshape.errors import WrongUseError
from loopshape.loop import Loop
from loopshape.units import db, from_db, rad


def by_gid(ax: Axes, gid: str) -> list:
    return [line for line in ax.lines if line.get_gid() == gid]


def open_loop(phase_deg: np.ndarray, size_db: np.ndarray) -> np.ndarray:
    return from_db(size_db) * np.exp(1j * rad(phase_deg))


@pytest.mark.parametrize("level", [12.0, 6.0, 1.0, 0.0, -6.0, -20.0])
def test_contours_of_constant_sensitivity_hold_it(level: float) -> None:
    phase, size = nichols_coordinates(constant_s(level))
    L = open_loop(phase, size)
    assert np.allclose(db(1.0 / (1.0 + L)), level, atol=1e-6)
    assert np.all(np.abs(np.diff(phase)) < 180.0)
    assert np.all((phase <= 0.0) & (phase >= -360.0))


@pytest.mark.parametrize("level", [9.0, 3.0, 0.5])
def test_contours_of_constant_complementary_sensitivity_hold_it(level: float) -> None:
    L = open_loop(*nichols_coordinates(constant_t(level)))
    assert np.allclose(db(L / (1.0 + L)), level, atol=1e-6)


def test_what_lies_around_minus_180_is_repeated_over_the_axes() -> None:
    assert {-540.0, -180.0, 180.0} <= {shift - 180.0 for shift in turns(-540.0, 180.0)}
    assert 0.0 in turns(-225.0, -135.0)


def test_the_nichols_limit_satisfies_the_definition_and_is_repeated() -> None:
    ax = pictures.nichols(nouns.loops(), nouns.requirements())
    limits = by_gid(ax, "limit |S|")
    assert limits
    for line in limits:
        assert np.allclose(np.abs(1.0 + open_loop(*line.get_data())), 1.0 / from_db(6.0))
    centres = {round(float(line.get_xdata()[0] / 180.0)) % 2 for line in limits}
    assert centres == {1}


def test_the_nichols_cross_shows_the_margins_wished() -> None:
    ax = pictures.nichols(nouns.loops()[:2], nouns.requirements(gain_reduction_margin_db=4.0))
    crosses = [line.get_data() for line in by_gid(ax, "phase margin")]
    assert any(list(x) == [-215.0, -145.0] and list(y) == [0.0, 0.0] for x, y in crosses)
    gains = [line.get_data() for line in by_gid(ax, "gain margin")]
    assert any(list(x) == [-180.0, -180.0] and list(y) == [-6.0, 4.0] for x, y in gains)


def test_the_sharper_of_peak_and_modulus_margin_is_the_limit() -> None:
    ax = pictures.nichols(nouns.loops()[:2], nouns.requirements(modulus_margin=0.6))
    line = by_gid(ax, "limit |S|")[0]
    assert np.allclose(np.abs(1.0 + open_loop(*line.get_data())), 0.6)


def test_the_nichols_curves_are_the_open_loops() -> None:
    loops = nouns.loops()
    ax = pictures.nichols(loops, None)
    curves = [line for line in ax.lines if line.get_gid() is None]
    assert len(curves) == 24
    for loop, line in zip(loops, curves, strict=True):
        phase, size = line.get_data()
        assert np.allclose(open_loop(phase, size), loop.L[loop.plant.trusted])
        assert -270.0 < phase[0] <= 90.0
    assert ax.get_xlabel() == "open-loop phase [deg]"
    assert ax.get_ylabel() == "open-loop magnitude |L| [dB]"
    ticks = ax.get_xticks()
    assert np.all(ticks % 90.0 == 0.0)
    assert ax.get_xlim()[0] <= -225.0
    assert ax.get_xlim()[1] >= -135.0


def test_without_requirements_nothing_is_forbidden() -> None:
    ax = pictures.nichols(nouns.loops()[:1], None)
    assert not by_gid(ax, "limit |S|")
    assert not by_gid(ax, "phase margin")


def test_the_sensitivities_carry_units_and_limits() -> None:
    loops = nouns.loops()[:3]
    figure = pictures.sensitivities(loops, nouns.requirements())
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == ["|S| [dB]", "|T| [dB]", "|CS| [dB re V/rad]", "|PS| [dB re rad/V]"]
    limits = [[(*line.get_xdata(), line.get_ydata()[0]) for line in by_gid(ax, "limit")] for ax in figure.axes]
    assert [[row[2] for row in rows] for rows in limits] == [[6.0], [6.0], [30.0, 0.0], []]
    assert limits[2][1][0] == 30.0  # |CS| at high frequency starts at its own frequency
    for ax, name in zip(figure.axes, ("S", "T", "CS", "PS"), strict=True):
        curves = [line for line in ax.lines if line.get_gid() is None]
        for loop, line in zip(loops, curves, strict=True):
            assert np.array_equal(line.get_ydata(), db(getattr(loop, name))[loop.plant.trusted])


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
    wished = by_gid(figure.axes[4], "bandwidth wished")
    assert [line.get_xdata()[0] for line in wished] == [1.0]
    assert to_rgba(wished[0].get_color()) == to_rgba(LIMIT)
    assert len({ax.get_xlim() for ax in figure.axes}) == 1


def test_controllers_that_differ_are_drawn_each() -> None:
    loops = [
        Loop(nouns.frf(*point), nouns.controller(gain)) for point, gain in zip(nouns.POINTS, (9.0, 11.0), strict=False)
    ]
    c = pictures.loop_page(loops, None).axes[2]
    assert len(c.lines) == 2


def test_pictures_without_loops_are_refused() -> None:
    for picture in (pictures.nichols, pictures.loop_page, pictures.sensitivities):
        with pytest.raises(WrongUseError, match="at least one"):
            picture([], None)
