"""The page of an interaction: what is plotted, labels, limits, verdicts, the coherence's bias."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block
from conversions import db
from interaction_nouns import F, coupled_by, matrix_frf

import loopshape as ls
from loopshape.toolbox.diagrams.coupling.picture import coefficients, interaction_page, relative_gains
from loopshape.view.style import png

NAMES = ("theta1", "theta2")
K = {name: ls.Controller(name, (Block("gain", {"gain": 4.0}),), 1000.0) for name in NAMES}
COHERENT = {
    "multiple_coherence": np.full((F.size, 2), 0.9),
    "partial_coherence": np.full((F.size, 2, 2), 0.8),
    "averages": 20.0,
}


@pytest.fixture(scope="module")
def frf():
    k_db = np.where((F > 2.95) & (F < 3.25), -8.0, -40.0)
    return matrix_frf(coupled_by(k_db), error=0.03, seed=1, operating_point={"theta2_deg": 15.0}, **COHERENT)


def panel(figure, label):
    return next(ax for ax in figure.axes if label in ax.get_ylabel())


def line(ax, gid):
    return next(x for x in ax.lines if x.get_gid() == gid)


def texts(figure):
    return "\n".join(t.get_text() for t in figure.texts)


def test_k_stands_with_its_band_the_limit_and_the_verdicts(frf):
    found = ls.interaction(frf, controllers=K)
    ax = coefficients(found)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), db(found.coefficients[0].coefficient))
    assert line(ax, "limit").get_ydata()[0] == -20.0
    assert ax.get_ylabel() == "|$k_I$| [dB]"
    strips = [p.get_gid() for p in ax.patches if str(p.get_gid()).startswith("verdict")]
    assert strips.count("verdict coupled") == 1
    assert strips.count("verdict decoupled") == 6
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["decoupled", "coupled"]
    assert ax.get_ylim()[0] < -40.0 < -20.0 < ax.get_ylim()[1]
    band = next(p for p in ax.get_children() if p.get_gid() == "band")
    top = band.get_xy()[F.size : 2 * F.size, 1][::-1]
    np.testing.assert_allclose(top, db(found.coefficients[0].high))


def test_a_page_shows_gains_closing_and_coherences(frf):
    found = ls.interaction(frf, controllers=K)
    figure = interaction_page(found)
    assert len(figure.axes) == 6
    gain = panel(figure, "RGA")
    np.testing.assert_allclose(gain.lines[0].get_ydata(), np.abs(found.relative_gain.gain[:, 0, 0]))
    np.testing.assert_allclose(panel(figure, "open [dB]").lines[0].get_ydata(), db(found.equivalents[0].ratio))
    angle = np.degrees(np.angle(found.equivalents[1].ratio))
    np.testing.assert_allclose(panel(figure, "open [deg]").lines[1].get_ydata(), angle)
    multiple = panel(figure, "multiple coherence")
    assert line(multiple, "bias").get_ydata()[0] == pytest.approx(2.0 / 20.0)
    assert line(multiple, "bias").get_linestyle() == "--"
    partial = panel(figure, "partial coherence")
    assert len(partial.lines) == 5
    assert line(partial, "bias").get_ydata()[0] == pytest.approx(1.0 / 19.0)
    assert "of 7 bands 6 decoupled, 1 coupled" in texts(figure)
    assert png(figure)[:4] == b"\x89PNG"


def test_without_controllers_and_coherences_two_panels_are_left(frf):
    bare = replace(frf, multiple_coherence=None, partial_coherence=None)
    figure = interaction_page(ls.interaction(bare))
    assert len(figure.axes) == 2
    assert figure.axes[0].get_xlabel() == figure.axes[1].get_xlabel() == "frequency [Hz]"


def test_k_that_may_be_zero_is_dots():
    P = coupled_by(-40.0)
    C = np.zeros((F.size, 4, 4), dtype=complex)
    C[:, 2, 2] = (5.0 * np.abs(P[:, 0, 1])) ** 2
    ax = coefficients(ls.interaction(matrix_frf(P, C)))
    assert next(x for x in ax.lines if x.get_linestyle() == "-").get_xdata().size == 0
    assert next(x for x in ax.lines if x.get_marker() == ".").get_xdata().size == F.size


def test_three_loops_have_a_curve_and_a_strip_a_pair():
    rng = np.random.default_rng(1)
    G = np.diag([1.0, 0.5, 2.0]) + 0.05 * rng.standard_normal((3, 3))
    found = ls.interaction(matrix_frf(G, error=0.05, seed=1, loop="theta1+theta2+p_a"))
    ax = coefficients(found)
    assert len(ax.get_legend().get_texts()) == 3 + len({v.verdict for v in found.verdicts})
    assert len({p.get_y() for p in ax.patches if str(p.get_gid()).startswith("verdict")}) == 3
    assert len([x for x in relative_gains(found).lines if x.get_gid() != "one"]) == 3


def test_four_loops_give_k_the_width_of_the_page_and_a_key_of_pairs():
    rng = np.random.default_rng(1)
    G = np.diag([1.0, 0.5, 2.0, 1.0]) + 0.05 * rng.standard_normal((4, 4))
    names = "theta1+theta2+p_a+p_c"
    frf = matrix_frf(G, error=0.05, seed=1, loop=names, valid=F > 0.3, multiple_coherence=np.full((F.size, 4), 0.9),
                     partial_coherence=np.full((F.size, 4, 4), 0.9), averages=20.0)  # fmt: skip
    figure = interaction_page(ls.interaction(frf))
    figure.draw_without_rendering()
    first, gain, multiple = figure.axes  # sixteen partial coherences could not be told apart
    assert first.get_position().width > 1.8 * gain.get_position().width
    assert first.get_xlabel() == gain.get_xlabel() == multiple.get_xlabel() == "frequency [Hz]"
    assert len(first.get_legend().get_texts()) == 6 + 1  # dots outside the valid band are no entries
    marks = [a for a in first.get_children() if a.get_gid() == "pair"]
    assert len(marks) == 6
    assert "6 pairs of loops: of" in texts(figure)
