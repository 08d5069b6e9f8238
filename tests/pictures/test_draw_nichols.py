"""Nichols charts: contours and limits satisfy their definitions, regions hold 95 %, the worst point is named."""

from dataclasses import replace

import loop_nouns
import numpy as np
import picture_nouns as nouns
import pytest
from conversions import db, deg, from_db, rad
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.path import Path

from loopshape.loop.points import worst_of
from loopshape.view.labels import point
from loopshape.view.plots.curves import loop_phase_deg
from loopshape.view.plots.nichols import REGION_DB, chosen_lines, nichols
from loopshape.view.plots.nichols_guides import constant_s, constant_t, error_region, nichols_coordinates, turns
from loopshape.view.style import figure_of


def by_gid(ax: Axes, gid: str | None) -> list:
    return [line for line in ax.lines if line.get_gid() == gid]


def regions(ax: Axes) -> list[np.ndarray]:
    return [patch.get_xy() for patch in ax.patches if patch.get_gid() == "region"]


def open_loop(phase_deg: np.ndarray, size_db: np.ndarray) -> np.ndarray:
    return from_db(size_db) * np.exp(1j * rad(phase_deg))


@pytest.mark.parametrize("level", [12.0, 6.0, 1.0, 0.0, -6.0, -20.0])
def test_contours_of_constant_sensitivity_hold_it(level: float) -> None:
    phase, size = nichols_coordinates(constant_s(level))
    L = open_loop(phase, size)
    assert np.allclose(db(1.0 / (1.0 + L)), level, atol=1e-6)
    assert np.all(np.abs(np.diff(phase)) < 180.0)
    assert np.all((phase <= 0.0) & (phase >= -360.0))


@pytest.mark.parametrize("level", [9.0, 3.0, 0.5, 0.0, -6.0, -20.0])
def test_contours_of_constant_complementary_sensitivity_hold_it(level: float) -> None:
    phase, size = nichols_coordinates(constant_t(level))
    L = open_loop(phase, size)
    assert np.allclose(db(L / (1.0 + L)), level, atol=1e-6)
    assert np.all(np.abs(np.diff(phase)) < 180.0)


def test_contours_as_drawn_hold_the_level_on_their_label_and_are_told_apart_without_colour() -> None:
    ax = nichols(nouns.loops()[:2], nouns.requirements())
    drawn = [line for line in ax.lines if str(line.get_gid()).endswith("dB")]
    names = {line.get_gid() for line in drawn}
    assert {"|S| 3 dB", "|S| 0 dB", "|S| −6 dB", "|T| 3 dB", "|T| 0 dB", "|T| −6 dB"} <= names
    assert "|S| 6 dB" not in names  # the limit itself stands there
    for line in drawn:
        L = open_loop(*line.get_data())
        value = 1.0 / (1.0 + L) if line.get_gid().startswith("|S|") else L / (1.0 + L)
        assert np.allclose(db(value), float(line.get_gid()[4:-3].replace("−", "-")), atol=1e-6)
        assert len(set(to_rgb(line.get_color()))) == 1  # grey
        assert (line.get_linestyle() == "-") == line.get_gid().startswith("|S|")
    labels = {text.get_text() for text in ax.texts}
    assert any(text.startswith("|S|") for text in labels)
    assert any(text.startswith("|T|") for text in labels)
    assert labels & names == {text for text in labels if text.startswith("|")}


def test_what_lies_around_minus_180_is_repeated_over_the_axes() -> None:
    assert {-540.0, -180.0, 180.0} <= {shift - 180.0 for shift in turns(-540.0, 180.0)}
    assert 0.0 in turns(-225.0, -135.0)


def test_the_limit_satisfies_the_definition_and_is_repeated() -> None:
    ax = nichols(nouns.loops(), nouns.requirements())
    limits = by_gid(ax, "limit |S|")
    assert limits
    for line in limits:
        assert np.allclose(np.abs(1.0 + open_loop(*line.get_data())), 1.0 / from_db(6.0))
    centres = {round(float(line.get_xdata()[0] / 180.0)) % 2 for line in limits}
    assert centres == {1}


def test_the_cross_shows_the_required_margins() -> None:
    ax = nichols(nouns.loops()[:2], nouns.requirements(gain_reduction_margin_db=4.0))
    crosses = [line.get_data() for line in by_gid(ax, "phase margin")]
    assert any(list(x) == [-215.0, -145.0] and list(y) == [0.0, 0.0] for x, y in crosses)
    gains = [line.get_data() for line in by_gid(ax, "gain margin")]
    assert any(list(x) == [-180.0, -180.0] and list(y) == [-6.0, 4.0] for x, y in gains)


def test_the_sharper_of_peak_and_modulus_margin_is_the_limit() -> None:
    ax = nichols(nouns.loops()[:2], nouns.requirements(modulus_margin=0.6))
    line = by_gid(ax, "limit |S|")[0]
    assert np.allclose(np.abs(1.0 + open_loop(*line.get_data())), 0.6)


def test_the_curves_are_the_open_loops_and_the_worst_is_drawn_last() -> None:
    loops = nouns.loops()
    ax = nichols(loops, None)
    curves = by_gid(ax, None)
    assert len(curves) == 24
    worst = worst_of(loops).index
    order = [k for k in range(24) if k != worst] + [worst]
    for k, line in zip(order, curves, strict=True):
        phase, size = line.get_data()
        L, plant = loops[k].L, loops[k].plant
        scribble = (np.abs(L) < 0.25) & (plant.relative_std[:, 0, 0] > 0.03)  # far from -1 noise is dots, no curve
        assert np.allclose(open_loop(phase, size)[np.isfinite(size)], L[plant.valid & ~scribble])
        assert -270.0 < phase[0] <= 90.0
    assert curves[-1].get_linewidth() > 1.5 * max(line.get_linewidth() for line in curves[:-1])
    assert ax.get_xlabel() == "open-loop phase [deg]"
    assert ax.get_ylabel() == "open-loop magnitude |L| [dB]"
    assert np.all(ax.get_xticks() % 90.0 == 0.0)
    assert ax.get_xlim()[0] <= -225.0
    assert ax.get_xlim()[1] >= -135.0


def test_without_requirements_nothing_is_forbidden_and_minus_one_still_shows() -> None:
    ax = nichols(nouns.loops()[:1], None)
    assert not by_gid(ax, "limit |S|")
    assert not by_gid(ax, "phase margin")
    assert [-180.0] in [list(line.get_xdata()) for line in by_gid(ax, "critical point")]


def test_the_worst_point_is_named_with_its_frequency() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    ax = nichols(loops, requirements, verdict=verdict)
    worst = worst_of(loops, verdict)
    assert verdict.lines[2].quantity == "sensitivity_peak_db"
    assert verdict.lines[2].outcome == "failed"
    assert loops[worst.index].plant.recording == verdict.lines[2].recording
    (mark,) = by_gid(ax, "worst")
    k = int(np.argmin(np.abs(loops[worst.index].frequency_hz - worst.at_hz)))
    assert mark.get_ydata()[0] == db(loops[worst.index].L)[k]
    assert f"{worst.at_hz:.3g} Hz" in {text.get_text() for text in ax.texts}
    named = figure_of(ax).texts[1].get_text()
    at = point(loops[worst.index].plant.operating_point)  # not the name of its recording
    assert at
    assert f"worst: {at}, " in named
    assert "misses peak |S|" in named
    legend = {text.get_text() for text in ax.get_legend().get_texts()}
    assert f"worst: {at}" in legend
    assert {"|S| constant", "|T| constant", "|S| at most 6 dB", "95 % of L at a frequency"} <= legend


@pytest.mark.parametrize("relative", [0.01, 0.2, 0.5])
def test_a_region_holds_95_percent_of_the_draws(relative: float) -> None:
    rng = np.random.default_rng(5)
    centre = 0.7 * np.exp(1j * rad(-150.0))
    deviation = relative * abs(centre)
    drawn = centre + deviation * np.sqrt(0.5) * (rng.standard_normal(20000) + 1j * rng.standard_normal(20000))
    edge = Path(np.column_stack(error_region(centre, deviation, -150.0 - 360.0, points=721)))
    phase = -150.0 - 360.0 + deg(np.angle(drawn / centre))
    share = np.mean(edge.contains_points(np.column_stack([phase, db(drawn)])))
    assert abs(share - 0.95) < 5.0 * np.sqrt(0.95 * 0.05 / 20000)


def test_a_region_that_holds_the_origin_is_not_drawn() -> None:
    assert np.isnan(error_region(0.5 + 0.0j, 0.3, 0.0)).all()
    assert np.isfinite(error_region(0.5 + 0.0j, 0.28, 0.0)).all()


def test_regions_are_few_stand_near_minus_one_and_have_the_size_of_the_error() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    ax = nichols(loops, requirements, verdict=verdict)
    assert 3 <= len(regions(ax)) <= 12
    loop = loops[worst_of(loops, verdict).index]
    phase, known = loop_phase_deg(loop)
    rows = chosen_lines(loop, phase, known, 8)
    assert int(np.argmin(np.abs(1.0 + loop.L))) in rows
    assert np.all(np.abs(db(loop.L[rows])) <= REGION_DB)
    drawn = [open_loop(*edge.T) for edge in regions(ax)]
    radius = 1.7308 * np.abs(loop.C) * np.sqrt(loop.plant.variance[:, 0, 0])  # sqrt(-ln 0.05)
    for k in rows:
        distance = [np.abs(edge - loop.L[k]) for edge in drawn]
        assert any(np.allclose(one, radius[k], rtol=1e-4) for one in distance)


def test_the_lines_as_measured_are_dots_on_the_curves_branch() -> None:
    frf = loop_nouns.noisy(loop_nouns.plant())
    loop, verdict = loop_nouns.checked(frf, loop_nouns.gain(), loop_nouns.required())
    ax = nichols([loop], loop_nouns.required(), verdict=verdict)
    (dots,) = by_gid(ax, "measured")
    x, y = dots.get_data()
    assert x.size <= 300
    assert np.all(np.min(np.abs(open_loop(x, y)[:, None] / frf.siso - 1.0), axis=1) < 1e-9)
    (curve,) = by_gid(ax, None)
    assert np.max(np.abs(x - np.interp(y, curve.get_ydata()[::-1], curve.get_xdata()[::-1]))) < 60.0


def test_frequencies_stand_along_the_worst_curve() -> None:
    loop = nouns.loops()[0]
    ax = nichols([loop], None)
    phase, _ = loop_phase_deg(loop)
    words = {text.get_text() for text in ax.texts}
    for mark in by_gid(ax, "frequency"):
        (k,) = np.flatnonzero(phase == mark.get_xdata()[0])
        assert f"{loop.frequency_hz[k]:.2g}" in words


def test_a_curve_of_noise_alone_is_dots() -> None:
    plant = nouns.frf(0.0, 1.0)
    loud = replace(plant, covariance=4.0 * np.abs(plant.response) ** 2 + 0j)
    loops = [replace(nouns.loops()[0], plant=loud), nouns.loops()[1]]
    ax = nichols(loops, None)
    assert len([line for line in by_gid(ax, None) if line.get_xdata().size]) == 1
    assert len(by_gid(ax, "not valid")) == 2
