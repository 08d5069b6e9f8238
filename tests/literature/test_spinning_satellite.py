"""The spinning satellite: each loop by itself has infinite margins, both together next to none.

Skogestad and Postlethwaite, Multivariable Feedback Control, 2nd edition, section 3.7.1: G = [[s - a², a (s + 1)],
[-a (s + 1), s - a²]]/(s² + a²), a = 10, K = I. Closed-loop poles twice at -1; one loop at a time L = 1/s; the largest
singular value of T is 10.05 at low frequency; with gains 1 + e and 1 - e stability is lost at |e| = 1/sqrt(a² + 1).
"""

import numpy as np
import pytest
from conversions import TWO_PI, from_db
from several_cases import frf_of, gain, loops

import loopshape as ls
from loopshape.loop.matrix.matrix_margins import matrix_margins

A = 10.0
F = np.sort(np.concatenate([np.geomspace(2e-4, 1e3, 1300), np.linspace(1.55, 1.63, 300)]))


def satellite(f, damping=1e-3):
    """With a little damping of its nutation, which the lines resolve: the count needs poles off the axis."""
    s = 1j * TWO_PI * f
    G = np.stack([s - A * A, A * (s + 1.0), -A * (s + 1.0), s - A * A], axis=1).reshape(-1, 2, 2)
    return G / (s * s + 2.0 * damping * A * s + A * A)[:, None, None]


BOTH = (gain("a"), gain("b"))


@pytest.fixture(scope="module")
def margins():
    return matrix_margins(loops(F, satellite(F), BOTH))


def test_it_is_stable_with_no_room(margins):
    assert (margins.stable, margins.unstable_poles) == ("stable", 0)
    edge = 1.0 / np.sqrt(A * A + 1.0)
    by_gains = max(2.0 * edge / (2.0 - edge), 2.0 * edge / (2.0 + edge))  # d = 2 (g - 1)/(g + 1) of 1 + e and 1 - e
    assert margins.disk_margin < by_gains
    assert margins.disk_margin == pytest.approx(0.09975, rel=1e-3)  # the same by python-control with slycot's AB13MD
    assert margins.gain_margin_db == pytest.approx(0.867, abs=0.002)
    assert margins.phase_margin_deg == pytest.approx(5.71, abs=0.01)


def test_the_peaks_of_s_and_t(margins):
    assert from_db(margins.complementary_peak_db) == pytest.approx(10.05, abs=0.01)
    assert margins.modulus_margin == pytest.approx(1.0 / 10.05, rel=1e-2)


@pytest.mark.long
@pytest.mark.parametrize(("share", "stable"), [(0.9, True), (0.98, True), (1.02, False), (1.1, False)])
def test_gains_just_inside_and_outside(share, stable):
    e = share / np.sqrt(A * A + 1.0)
    found = matrix_margins(loops(F, satellite(F), (gain("a", 1.0 + e), gain("b", 1.0 - e))))
    assert found.stable == ("stable" if stable else "unstable")


@pytest.mark.long
def test_a_check_passes_each_loop_and_fails_the_pair():
    required = [ls.Requirements(name, gain_margin_db=6.0, phase_margin_deg=45.0, modulus_margin=0.6) for name in "ab"]
    wanted = ls.Requirements(disk_margin=0.5, integrators=0, unstable_poles=0)
    found = ls.check([frf_of(F, satellite(F), loop="a+b")], BOTH, required, together=wanted)
    for verdict in found.each:
        assert verdict.passed
        assert [line.outcome for line in verdict.lines] == ["passed"] * 3
        margins = verdict.margins["exact"]
        assert margins.phase_margin_deg == pytest.approx(90.0, abs=0.1)
        assert margins.disk_margin > 1.9
    (line,) = found.lines
    assert (line.quantity, line.outcome) == ("disk_margin", "failed")
    assert (found.outcome, found.passed) == ("failed", False)
