"""The gap map: a cell for every row, coloured by its size where it stands out, with its labels and units."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Rectangle

import loopshape as ls
from loopshape.toolbox.gap.nouns.gap_table import GapRow, GapTable
from loopshape.toolbox.gap.pictures.table import gap_map
from loopshape.view.style import figure_of, new_figure, png

BANDS = ((0.464, 1.0), (1.0, 2.15), (2.15, 4.64))
ANGLES = (-15.0, 0.0, 15.0)


def row(path: str, loop: str, angle: float, band: tuple[float, float], size: float, p_value: float) -> GapRow:
    return GapRow(
        path=path, recording=f"{loop}-{angle:g}", simulated=f"{loop}-{angle:g}", loop=loop,
        operating_point={"theta2_deg": angle, "p_ab_bar": 1.0}, amplitude=0.035,
        amplitude_unit="rad" if loop == "theta2" else "bar", band_hz=band, lines=20, size=size, noise=0.004,
        z2=1.0, p_value=p_value, gain_db=0.1, phase_deg=1.0,
    )  # fmt: skip


def table() -> GapTable:
    rows = [
        row(path, loop, angle, band, 0.02 * 3.0**k, 1e-9 if k else 0.5)
        for path, loop in (("z_theta2 -> theta2", "theta2"), ("u_a -> p_a", "theta2"), ("u_a -> p_a", "p_ab"))
        for angle in ANGLES
        for k, band in enumerate(BANDS)
    ]
    return GapTable("real", "sim", tuple(rows[1:]))  # the first cell has no lines that both runs know


def cells(ax: Axes, gid: str) -> list[Rectangle]:
    return [p for p in ax.patches if isinstance(p, Rectangle) and p.get_gid() == gid]


def test_every_row_is_one_cell_coloured_where_it_stands_out() -> None:
    shown = table()
    ax = gap_map(shown)
    loud, quiet = cells(ax, "significant"), cells(ax, "not significant")
    assert len(loud) == sum(shown.significant(r) for r in shown.rows)
    assert len(loud) + len(quiet) == len(shown.rows)
    corners = {p.get_xy() for p in loud + quiet}
    assert len(corners) == len(shown.rows)  # none covers another
    assert {x for x, _ in corners} == {0, 1, 2}  # operating points, both loops' side by side


def test_larger_differences_are_darker_so_that_grey_keeps_the_order() -> None:
    sizes = (0.01, 0.03, 0.1, 0.3, 1.0)
    rows = tuple(row("z_p -> p_a+p_b", "p_ab", float(k), BANDS[0], size, 0.0) for k, size in enumerate(sizes))
    found = sorted(cells(gap_map(replace(table(), rows=rows)), "significant"), key=lambda p: p.get_xy()[0])
    light = [float(np.dot((0.299, 0.587, 0.114), to_rgb(p.get_facecolor()))) for p in found]
    assert len(light) == len(sizes)
    assert np.all(np.diff(light) < -0.08)
    assert light[0] < 0.95  # and the lightest is not the paper


def test_the_numbers_are_the_sizes_or_twice_the_noise() -> None:
    texts = [t.get_text() for t in gap_map(table()).texts]
    assert texts.count("6.0") == 9
    assert texts.count("18") == 9
    assert texts.count("< 2.0") == 8
    noisy = replace(table(), rows=tuple(replace(r, noise=0.05) for r in table().rows))
    assert [t.get_text() for t in gap_map(noisy).texts].count("< 10") == 8


def test_paths_bands_and_points_are_written_with_their_units() -> None:
    ax = gap_map(table())
    named = [t.get_text() for t in ax.texts if t.get_gid() == "path"]
    assert named[0] == r"$z_{\theta_{2}}$ → $\theta_{2}$"
    assert named[1:] == [r"$u_{A}$ → $p_{A}$, $\theta_{2}$ excited", r"$u_{A}$ → $p_{A}$, $p_{AB}$ excited"]
    assert ax.get_ylabel() == "band [Hz]"
    assert ax.get_xlabel() == "$\\theta_{2}$ [deg]\n$p_{AB}$ [bar]"
    assert [t.get_text() for t in ax.get_xticklabels()] == ["−15\n1", "0\n1", "15\n1"]
    injected = [t.get_text() for t in ax.texts if t.get_gid() == "injected"]
    assert injected == ["injected\n0.035 rad in $\\theta_{2}$\n0.035 bar in $p_{AB}$"]
    bar = figure_of(ax).axes[1]
    assert " ".join(bar.get_ylabel().split()) == "|difference| / |response| [%]"


def test_bands_rise_downwards_within_each_path() -> None:
    ax = gap_map(table())
    places = dict(zip((t.get_text() for t in ax.get_yticklabels()[-3:]), ax.get_yticks()[-3:], strict=True))
    assert list(places) == ["0.46–1", "1–2.1", "2.1–4.6"]
    assert list(places.values()) == sorted(places.values())
    low, high = ax.get_ylim()
    assert low > high  # the first path stands on top


def test_a_second_experiment_at_the_same_point_stands_in_a_block_of_its_own() -> None:
    again = [replace(r, recording=f"odd{r.operating_point['theta2_deg']:g}", amplitude=0.07) for r in table().rows]
    both = replace(table(), rows=(*table().rows, *(r for r in again if r.loop == "theta2")))
    ax = gap_map(both)
    assert ax.get_xlim() == (0.0, 6.0)
    assert len([t for t in ax.texts if t.get_gid() == "injected"]) == 2


def test_many_columns_hold_no_numbers() -> None:
    rows = tuple(row("z_p -> p_a+p_b", "p_ab", float(a), BANDS[0], 0.2, 0.0) for a in range(24))
    ax = gap_map(replace(table(), rows=rows))
    assert not [t for t in ax.texts if t.get_text() == "20"]
    assert len(cells(ax, "significant")) == 24


def test_it_draws_into_a_given_axes_and_prints() -> None:
    figure = new_figure(1, 1, (5.0, 4.0))
    assert gap_map(table(), ax=figure.axes[0]) is figure.axes[0]
    assert png(figure).startswith(b"\x89PNG")


def test_a_table_without_rows_is_refused() -> None:
    with pytest.raises(ls.errors.WrongUseError, match="needs a table with FRF rows"):
        gap_map(GapTable("real", "sim", ()))
