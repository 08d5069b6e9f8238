"""The sensitivity atlas: every cell is |S| at its line, rows are sorted, outcomes are told without colour."""

from dataclasses import replace

import loop_nouns
import numpy as np
import picture_nouns as nouns
import pytest
from bench_nouns import Loop
from conversions import db
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh

import loopshape as ls
from loopshape.loop.points import point_outcome
from loopshape.toolbox.schedules.atlas import (
    beyond,
    cells,
    ink_on,
    levels_with,
    luminance,
    missed_colours,
    near_colours,
    room_colours,
    sensitivity_atlas,
    sorted_points,
    zero_crossings,
)


def rows(ax: Axes) -> list[QuadMesh]:
    return [mesh for mesh in ax.collections if isinstance(mesh, QuadMesh)]


def by_gid(ax: Axes, gid: str) -> list:
    return [line for line in ax.lines if line.get_gid() == gid]


@pytest.mark.long
def test_cells_are_the_sensitivity_at_their_lines() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    ax = sensitivity_atlas(loops, requirements, verdict=verdict).axes[0]
    meshes = rows(ax)
    assert len(meshes) == 24
    for mesh, k in zip(meshes, sorted_points(loops), strict=True):
        loop = loops[k]
        assert mesh.get_gid() == loop.plant.recording
        assert np.array_equal(mesh.get_array().compressed(), db(loop.S))
        edges = mesh.get_coordinates()[0, :, 0]
        assert np.all((edges[:-1] < loop.frequency_hz) & (loop.frequency_hz < edges[1:]))


def test_rows_are_sorted_by_the_operating_coordinates_and_named_by_them() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    points = [tuple(loops[k].plant.operating_point.values()) for k in sorted_points(loops)]
    assert points == sorted(points)
    ax = sensitivity_atlas(loops, requirements, verdict=verdict).axes[0]
    names = [tick.get_text() for tick in ax.get_yticklabels()]
    assert names[0] == "−30, 0.8"
    assert names[-1] == "30, 1.4"
    assert ax.get_ylim() == (23.5, -0.5)  # the first row on top
    (text,) = [text.get_text() for text in ax.texts if text.get_gid() == "rows"]
    assert "deg" in text
    assert "bar" in text
    assert ax.get_xlabel() == "frequency [Hz]"


def test_peaks_carry_value_interval_and_a_mark_of_the_outcome() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    ax = sensitivity_atlas(loops, requirements, verdict=verdict).axes[0]
    seen = {}
    for place, k in enumerate(sorted_points(loops)):
        m = verdict.margins[loops[k].plant.recording]
        outcome = point_outcome(m, "sensitivity_peak_db", 6.0)
        (mark,) = [line for line in by_gid(ax, outcome) if line.get_ydata()[0] == place]
        seen[outcome] = mark.get_marker()
        low, high = m.intervals["sensitivity_peak_db"]
        (text,) = [t.get_text() for t in ax.texts if t.get_position()[1] == place and t.get_gid() == "peak value"]
        assert float(text.split(" ")[0]) == pytest.approx(m.sensitivity_peak_db, abs=0.06)
        assert float(text.split("(")[1].split(" ")[0]) == pytest.approx(low, abs=0.06)
        assert float(text.split(" to ")[1].rstrip(")")) == pytest.approx(high, abs=0.06)
    assert set(seen) == {"passed", "undecided", "failed"}
    assert len(set(seen.values())) == 3
    assert len(by_gid(ax, "peak")) == 24
    legend = [text.get_text() for text in ax.get_legend().get_texts()]
    assert legend == ["passed", "undecided", "failed"]


def test_cells_beyond_the_limit_are_framed_and_no_others() -> None:
    loops = [loop for loop in nouns.loops() if loop.plant.operating_point["p_ab_bar"] == 1.0]
    limit = float(np.median([np.max(db(loop.S[loop.plant.valid])) for loop in loops]))
    ax = sensitivity_atlas(loops, nouns.requirements(sensitivity_peak_db=limit)).axes[0]
    frames = [patch for patch in ax.patches if patch.get_gid() == "beyond the limit"]
    assert frames
    inside = {k: [] for k in range(len(loops))}
    for frame in frames:
        inside[round(frame.get_y() + 0.46)].append((frame.get_x(), frame.get_x() + frame.get_width()))
    for place, k in enumerate(sorted_points(loops)):
        use = loops[k].plant.valid
        f, over = loops[k].frequency_hz[use], db(loops[k].S)[use] > limit
        framed = np.array([any(a < x < b for a, b in inside[place]) for x in f])
        assert np.array_equal(framed, over)


def test_thin_lines_part_what_is_damped_from_what_is_amplified() -> None:
    edges = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert list(zero_crossings(edges, np.array([-2.0, -1.0, 1.0, np.nan, -1.0]))) == [3.0]
    ax = sensitivity_atlas(nouns.loops()[:1], None).axes[0]
    (lines,) = [c for c in ax.collections if c.get_gid() == "0 dB"]
    f, size = nouns.loops()[0].frequency_hz, db(nouns.loops()[0].S)
    first = f[np.flatnonzero(size > 0.0)[0]]
    assert lines.get_segments()[0][0, 0] < first < lines.get_segments()[0][0, 0] + 0.05


def test_maps_print_each_value_in_its_cell_and_mark_the_outcome() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    figure = sensitivity_atlas(loops, requirements, verdict=verdict)
    maps = {ax.get_title(loc="left").split(" ≥")[0].split(" ≤")[0]: ax for ax in figure.axes}
    ax, line = maps["gain margin"], verdict.lines[0]
    assert ax.get_title(loc="left") == "gain margin ≥ 6 dB"
    values = {text.get_position(): text.get_text() for text in ax.texts if text.get_gid() == "value"}
    assert len(values) == 24
    xs, ys = [-30.0, -15.0, 0.0, 15.0, 30.0], [0.8, 1.0, 1.2, 1.4, 1.6, 1.8]
    hatches = {"passed": None, "undecided": "....", "failed": "////"}
    found = set()
    for loop in loops:
        place = xs.index(loop.plant.operating_point["theta2_deg"]), ys.index(loop.plant.operating_point["p_ab_bar"])
        m = verdict.margins[loop.plant.recording]
        assert float(values[place]) == pytest.approx(m.gain_margin_db, rel=0.006)
        (cell,) = [p for p in ax.patches if p.get_gid() in hatches and p.get_xy() == (place[0] - 0.5, place[1] - 0.5)]
        found.add(cell.get_gid())
        assert cell.get_gid() == point_outcome(m, "gain_margin_db", 6.0)
        assert cell.get_hatch() == hatches[cell.get_gid()]
    assert found == set(hatches)
    (frame,) = [patch for patch in ax.patches if patch.get_gid() == "worst"]
    worst = next(loop for loop in loops if loop.plant.recording == line.recording)
    assert xs[round(frame.get_x() + 0.48)] == worst.plant.operating_point["theta2_deg"]
    assert ax.get_xlabel().endswith("[deg]")
    assert ax.get_ylabel().endswith("[bar]")


def test_an_unstable_row_is_hatched_and_says_so() -> None:
    loops, requirements, verdict = loop_nouns.arm()
    some = [loops[0], loops[1]]
    names = [loop.plant.recording for loop in some]
    margins = {names[0]: replace(verdict.margins[names[0]], stable="unstable"), names[1]: verdict.margins[names[1]]}
    ax = sensitivity_atlas(some, requirements, verdict=ls.Verdict("theta2", (), margins)).axes[0]
    (hatched,) = [patch for patch in ax.patches if patch.get_gid() == "unstable"]
    assert hatched.get_hatch() == "////"
    assert "unstable" in {text.get_text() for text in ax.texts}
    assert len(by_gid(ax, "failed")) == 1


def test_points_without_coordinates_stand_by_recording_on_their_own_lines() -> None:
    one = nouns.frf(0.0, 1.0, operating_point={})
    other = nouns.frf(15.0, 1.0, operating_point={}).select(np.arange(0, 900, 3))
    loops = [Loop(frf, nouns.controller(), 1, unstable_poles=0) for frf in (one, other)]
    figure = sensitivity_atlas(loops, nouns.requirements())
    ax = figure.axes[0]
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["r08", "r09"]
    assert [mesh.get_array().compressed().size for mesh in rows(ax)] == [frf.valid.sum() for frf in (one, other)]
    assert len(figure.axes) == 2  # the map and its scale


def test_one_point_is_an_atlas_too() -> None:
    frf = loop_nouns.noisy(loop_nouns.plant())
    loop, verdict = loop_nouns.checked(frf, loop_nouns.gain(), loop_nouns.required())
    ax = sensitivity_atlas([loop], loop_nouns.required(), verdict=verdict).axes[0]
    assert len(rows(ax)) == 1
    assert len(by_gid(ax, "failed")) == 1


def test_lines_that_leave_a_gap_leave_one_in_the_row() -> None:
    f = np.concatenate([np.arange(1.0, 2.0, 0.05), np.arange(4.0, 5.0, 0.05)])
    values = np.arange(f.size, dtype=float)
    edges, shown = cells(f, values)
    assert edges.size == shown.size + 1
    assert np.all(np.diff(edges) > 0.0)
    gap = int(np.flatnonzero(np.isnan(shown))[0])
    assert np.count_nonzero(np.isnan(shown)) == 1
    assert 1.95 < edges[gap] < 2.0
    assert 3.95 < edges[gap + 1] < 4.0
    assert np.array_equal(shown[~np.isnan(shown)], values)
    assert beyond(edges, shown, values[19] - 0.5)[0] == (edges[gap - 1], edges[gap])


def test_a_grid_without_gaps_has_none_and_a_single_line_is_a_cell() -> None:
    for f in (np.geomspace(0.1, 100.0, 50), np.arange(1.0, 40.0)):
        edges, shown = cells(f, f)
        assert np.isfinite(shown).all()
        assert np.all((edges[:-1] < f) & (f < edges[1:]))
    edges, shown = cells(np.array([2.0]), np.array([1.0]))
    assert edges[0] < 2.0 < edges[1]


def test_the_limit_is_one_of_the_levels() -> None:
    for limit in (4.0, 6.0, 6.02, 0.5):
        levels = levels_with(limit)
        assert limit in levels
        assert 0.0 in levels
        assert levels == sorted(levels)


def test_colours_grow_darker_with_the_sensitivity_so_that_grey_paper_keeps_the_order() -> None:
    shades = [*room_colours(6), *near_colours(2), *missed_colours(6)]
    light = [luminance(shade) for shade in shades]
    assert np.all(np.diff(light) < 0.0)
    for shade in shades:  # at least 4.5 : 1 (WCAG 2, contrast of text)
        other = luminance(ink_on(shade))
        high, low = max(other, luminance(shade)), min(other, luminance(shade))
        assert (high + 0.05) / (low + 0.05) > 4.5
