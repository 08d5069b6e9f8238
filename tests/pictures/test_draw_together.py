"""Pictures of several loops: what is plotted, under which labels."""

import numpy as np
import pytest
from conversions import TWO_PI, db
from several_cases import frf_of, gain

import loopshape as ls
from loopshape.loop.verdict import check_loops
from loopshape.view.verdict.together import determinant, disk_margins, loci, singular_values, summary, together_page

F = np.geomspace(0.05, 50.0, 150)
S = 1j * TWO_PI * F
CONTROLLERS = [gain("theta1"), gain("theta2")]
WISHED = ls.Requirements(disk_margin=0.6, sensitivity_peak_db=8.0, complementary_peak_db=6.0)


def case(units):
    G = np.array([[1.0, 0.4], [-0.4, 1.0]]) * (5.0 / (S * (0.02 * S + 1.0)))[:, None, None]
    frf = frf_of(F, G, 0.02, units=units, loop="theta1+theta2")
    required = WISHED if units is None else ls.Requirements(disk_margin=0.6, modulus_margin=0.4)
    checked = check_loops([frf], CONTROLLERS, together=required)
    verdict, (loops,) = checked.verdict, checked.loops
    return loops, verdict, required


@pytest.fixture(scope="module")
def alike():
    return case(None)


def by_gid(ax):
    return {line.get_gid(): line for line in ax.lines if line.get_gid()}


def test_loci_are_the_eigenvalues_of_l(alike):
    loops = alike[0]
    lines = by_gid(loci(loops))
    drawn = [lines[f"locus {k}"].get_xdata() + 1j * lines[f"locus {k}"].get_ydata() for k in (1, 2)]
    np.testing.assert_allclose(np.prod(1.0 + np.array(drawn), axis=0), loops.determinant, rtol=1e-9)
    assert max(np.abs(np.diff(one) / one[1:]).max() for one in drawn) < 0.3  # no jumps from one to the other
    assert lines["critical point"].get_xdata()[0] == -1.0


def test_the_determinant_keeps_its_phase(alike):
    line = by_gid(determinant(alike[0]))["det(I + L)"]
    drawn = line.get_xdata() + 1j * line.get_ydata()
    np.testing.assert_allclose(np.angle(drawn / alike[0].determinant), 0.0, atol=1e-9)


def test_singular_values_stand_under_their_limit(alike):
    ax = singular_values(alike[0], "S", 8.0, scaled=False)
    lines = by_gid(ax)
    np.testing.assert_allclose(lines["largest"].get_ydata(), db(np.linalg.norm(alike[0].S, 2, axis=(1, 2))))
    assert lines["limit"].get_ydata()[0] == 8.0
    assert ax.get_ylabel() == "singular values of S [dB]"
    assert ax.get_xlabel() == "frequency [Hz]"


def test_disk_margins_of_all_are_below_those_of_each(alike):
    loops, verdict, _ = alike
    lines = by_gid(disk_margins(loops, verdict.margins["exact"], 0.6))
    together = lines["together"].get_ydata()
    for name in loops.names:
        assert np.all(together <= lines[name].get_ydata() * (1.0 + 1e-9))
    assert together.min() == pytest.approx(verdict.margins["exact"].disk_margin, rel=0.05)
    assert lines["limit"].get_ydata()[0] == 0.6


def test_the_summary_names_every_loop_and_all(alike):
    _, verdict, _ = alike
    each = {one.loop: one.margins["exact"] for one in verdict.each}
    ax = summary(each, verdict.margins["exact"], 0.6)
    assert [t.get_text() for t in ax.get_yticklabels()] == [
        r"$\theta_{1}$",
        r"$\theta_{2}$",
        "all at once",
        "in and out",
    ]


@pytest.mark.parametrize("units", [None, ["rad", "bar"]])
def test_the_page_has_its_six_panels(units, alike):
    loops, verdict, required = alike if units is None else case(units)
    each = {one.loop: one.margins["exact"] for one in verdict.each}
    figure = together_page(loops, verdict.margins["exact"], each, required)
    assert len(figure.axes) == 6
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert ("singular values of S [dB]" in labels) == (units is None)
    assert ("µ(S) [dB]" in labels) == (units is not None)
    figure.savefig("/dev/null", format="png")
    words = " ".join(text.get_text() for text in figure.texts)
    assert "stable" in words
    assert "disk margin" in words
