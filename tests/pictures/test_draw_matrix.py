"""The page of a matrix FRF: what is plotted, labels, dots where an element may be zero, maps of many outputs."""

from dataclasses import replace

import numpy as np
import pytest
from conversions import db
from interaction_nouns import F, coupled_by, matrix_frf

from loopshape.view.plots.matrix import matrix_overview, matrix_page, settled


@pytest.fixture(scope="module")
def frf():
    return matrix_frf(coupled_by(-40.0), error=0.03, seed=1, operating_point={"theta2_deg": 15.0})


def test_a_matrix_has_magnitude_and_phase_of_each_element(frf):
    figure = matrix_page(frf)
    assert len(figure.axes) == 8
    above = figure.axes[0:2] + figure.axes[4:6]
    assert [ax.get_title(loc="left").count("z_") for ax in above] == [1, 1, 1, 1]
    for ax, (i, j) in zip(above, ((0, 0), (0, 1), (1, 0), (1, 1)), strict=True):
        np.testing.assert_allclose(ax.lines[0].get_ydata(), db(frf.response[:, i, j]))
        band = next(p for p in ax.patches if p.get_gid() == "band") if ax.patches else ax.artists
        assert band is not None
    assert above[0].get_ylabel() == "|P| [dB re rad/V]"
    assert figure.axes[2].get_ylabel() == "phase [deg]"
    assert figure.axes[-1].get_xlabel() == "frequency [Hz]"
    assert above[0].get_ylim() == above[1].get_ylim()
    texts = "\n".join(t.get_text() for t in figure.texts)
    assert "FRF matrix, 2 x 2" in texts
    assert "15 deg" in texts


def test_rows_of_different_units_keep_their_own_scales(frf):
    mixed = replace(frf, inputs=("z_theta1_v", "f_n"))
    first, second = matrix_page(mixed).axes[:2]
    assert (first.get_ylabel(), second.get_ylabel()) == ("|P| [dB re rad/V]", "|P| [dB re rad/N]")


def test_phase_of_an_element_lost_in_noise_is_dots():
    P = coupled_by(-40.0)
    C = np.zeros((F.size, 4, 4), dtype=complex)
    C[:, 2, 2] = (5.0 * np.abs(P[:, 0, 1])) ** 2
    figure = matrix_page(matrix_frf(P, C, seed=1))
    assert figure.axes[3].lines[-1].get_xdata().size < 5
    assert figure.axes[2].lines[-1].get_xdata().size == F.size


def test_settled_lines_have_known_neighbours():
    known = np.array([1, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 1], dtype=bool)
    np.testing.assert_array_equal(np.flatnonzero(settled(known)), [0, 1, 2, 12, 13, 14])


def test_many_outputs_are_a_map_of_each_input():
    rng = np.random.default_rng(1)
    G = rng.standard_normal((F.size, 28, 2)) + 1j
    G[:, 5, 1] = 1e-3
    big = matrix_frf(G, np.broadcast_to(1e-2 * np.eye(56), (F.size, 56, 56)), loop="",
                     inputs=("f_1_n", "f_2_n"), outputs=tuple(f"acc{k}_m_s2" for k in range(28)))  # fmt: skip
    figure = matrix_page(big)
    first, second, bar = figure.axes
    assert (first.get_title(loc="left"), second.get_title(loc="left")) == ("input f 1", "input f 2")
    assert [t.get_text() for t in first.get_yticklabels()][:2] == ["acc0", "acc1"]
    assert bar.get_ylabel() == "|P| [dB re m/s²/N]"
    shown = second.collections[0].get_array().reshape(28, F.size)
    assert np.ma.getmaskarray(np.ma.masked_invalid(shown))[5].all()  # it may be zero: white
    np.testing.assert_allclose(shown[0], db(G[:, 0, 1]))
    assert len(matrix_overview(replace(big, loop="x")).axes) == 3


def test_a_phase_that_noise_winds_up_is_shown_within_a_turn():
    P = coupled_by(-40.0)
    P[:, 0, 1] = 0.05 * np.exp(-1j * np.linspace(0.0, 20.0, F.size))
    figure = matrix_page(matrix_frf(P, error=0.01, seed=1))
    shown = figure.axes[3].lines[-1].get_ydata()
    assert -270.0 < np.nanmin(shown) < np.nanmax(shown) <= 90.0
    assert 0 < np.isnan(shown).sum() <= 4
