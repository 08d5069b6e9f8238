"""Appendix D of DCT 2007.002: Poiseuille or throttles, and why PTS2 rattles (experiments/pneumatic_test_setup)."""

import sys
from pathlib import Path

import numpy as np
import pytest

from loopshape.toolbox.arm.source import number, value

sys.path.insert(0, str(Path(__file__).parents[5] / "experiments" / "pneumatic_test_setup"))

import pneumatic_models as models

END_S = value("figure_d_9.duration")


@pytest.fixture(scope="module")
def radau():
    return models.implicit(models.pts2(models.bench()), END_S)


def tail_error(run, true):
    late = run.t_s > END_S - 0.2
    return np.abs(run.q_kg_s[late, 1] - np.interp(run.t_s[late], true.t_s, true.q_kg_s[:, 1])).max()


def third_order(step_s, kind=np.float64):
    return models.explicit(models.pts2(models.bench()), END_S, step_s, models.BOGACKI_SHAMPINE, kind)


def test_two_routes_agree(radau):
    fine = models.explicit(models.pts2(models.bench()), END_S, 5e-6, keep=100)
    np.testing.assert_allclose(fine.p_bar, radau.p_bar, atol=1e-5)


def test_mass_is_conserved_whatever_rattles(radau):
    c = models.pts2(models.bench())
    for run in (radau, third_order(1e-3)):
        stored = 1e5 * run.p_bar @ c[models.HEAD : models.HEAD + 4] / c[models.RT]
        assert np.ptp(stored - run.supplied_kg) < 1e-12 * stored[0]


def test_one_throttle_from_a_constant_pressure_fills_by_its_closed_form():
    c = models.pts3(models.bench(capacity_l=1e6))
    run = models.implicit(c, 1.0)
    np.testing.assert_allclose(run.p_bar[:, 1], models.filled_bar(c, run.t_s, 1.0), atol=1e-6)


def test_jacobian_is_the_slope_of_the_rates():
    b = models.bench()
    for c in (models.pts1(b), models.pts2(b), models.pts3(b)):
        n = (c.size - models.HEAD) // 3
        x, q, up, down, jac = (
            np.r_[np.linspace(9e4, 2e4, n), 0.0],
            np.empty(n),
            *np.empty((2, n + 1)),
            np.empty((n + 1,) * 2),
        )
        models.slopes(c, x, 1.0, 1e-6, jac)
        for k, step in enumerate(np.eye(n + 1)):
            models.rates(c, x + step, 1.0, q, up)
            models.rates(c, x - step, 1.0, q, down)
            np.testing.assert_allclose(jac[:, k], 0.5 * (up - down), atol=1e-8 * np.abs(jac).max())


def test_pts2_rattles_from_about_where_the_source_says_and_radau_does_not(radau):
    run, flow = third_order(1e-4), radau.q_kg_s[:, 1]
    off = np.abs(run.q_kg_s[:, 1] - np.interp(run.t_s, radau.t_s, flow))
    onset = run.t_s[np.flatnonzero((off > 0.05 * flow.max()) & (run.t_s > 0.02))[0]]
    assert onset == pytest.approx(value("figure_d_9.unstable_from"), abs=number("figure_d_9.unstable_from").half_digit)
    assert np.all(np.diff(flow[40 : round(1.2 * 2000)]) < 0.0)  # while it fills, it only falls
    assert flow[-400:].max() < 2e-3 * flow.max()


def test_the_rattling_goes_with_the_step(radau):
    coarse, fine = (tail_error(third_order(h), radau) for h in (2e-4, 1e-4))
    assert coarse / fine == pytest.approx(2.0, rel=0.1)


def test_the_rattling_does_not_go_with_the_digits(radau):
    few, many = (tail_error(third_order(1e-4, kind), radau) for kind in (np.float32, np.float64))
    assert few == pytest.approx(many, rel=0.01)


def test_q_in_does_not_rattle(radau):
    run = third_order(1e-3)
    late = run.t_s > END_S - 0.2
    supply = np.abs(run.q_kg_s[late, 0] - np.interp(run.t_s[late], radau.t_s, radau.q_kg_s[:, 0])).max()
    assert supply < 0.02 * tail_error(run, radau)


def test_poiseuille_by_hose_dimensions_is_unstable_by_its_solver_and_not_laminar():
    b = models.bench()
    c = models.pts1(b)
    assert not np.isfinite(models.explicit(c, 0.2, 1e-3, models.BOGACKI_SHAMPINE).p_bar).all()
    np.testing.assert_allclose(
        models.explicit(c, 0.2, 2e-5, models.BOGACKI_SHAMPINE).p_bar[-1], models.implicit(c, 0.2).p_bar[-1], atol=1e-3
    )
    peak = models.implicit(c, 0.2).q_kg_s[1:, 1].max()
    assert 4.0 * peak / (np.pi * 2e-3 * b.hose_radius_mm * b.viscosity_pa_s) > 2300.0


def test_pts3_is_the_limit_of_pts2_in_proportion_to_the_small_volumes():
    def apart(factor):
        b = models.bench(small_factor=factor)
        return np.abs(models.implicit(models.pts2(b), END_S).p_bar[:, -1] - without).max()

    without = models.implicit(models.pts3(models.bench()), END_S).p_bar[:, -1]
    assert apart(0.5) / apart(0.25) == pytest.approx(2.0, rel=0.01)


def test_pulsed_runs_are_independent_of_their_step(monkeypatch):
    c, edges = (
        models.pts2(models.bench()),
        models.block_edges(value("figure_d_10.frequency"), value("figure_d_10.duty"), 0.2),
    )
    fine = models.pulsed(c, 0.2, edges)
    monkeypatch.setitem(models.SETTINGS["runs"], "pulsed_step_s", 2e-5)
    np.testing.assert_allclose(models.pulsed(c, 0.2, edges).p_bar[:, -1], fine.p_bar[:, -1], atol=1e-5)
