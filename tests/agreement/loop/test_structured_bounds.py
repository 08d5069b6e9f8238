"""Bounds of the structured singular value: two routes, one answer; what they promise holds for the loops themselves."""

from itertools import product

import control
import numpy as np
import pytest
from conversions import TWO_PI
from several_cases import gain, loops, poles, random_plant, response_of

from loopshape.loop.matrix.matrix_margins import broken_twice, gauge_matrix, matrix_margins
from loopshape.loop.matrix.structured import mu_bounds, refined, scaled, two_loops, upper_at


def random_matrices(rng, count, n, spread=1.0):
    """Complex matrices whose rows and columns differ much in size."""
    M = rng.normal(size=(count, n, n)) + 1j * rng.normal(size=(count, n, n))
    return M * np.exp(spread * rng.normal(size=(count, n, 1))) * np.exp(spread * rng.normal(size=(count, 1, n)))


def by_phases(M, steps):
    """The largest spectral radius of M U over a grid of phases: mu from below (Doyle 1982)."""
    n = M.shape[0]
    turns = np.exp(1j * TWO_PI * np.arange(steps) / steps)
    every = np.array([(1.0, *phases) for phases in product(turns, repeat=n - 1)])
    return float(np.abs(np.linalg.eigvals(M[None] * every[:, None, :])).max())


@pytest.mark.parametrize(("n", "steps"), [(2, 2000), (3, 90)])
def test_for_two_and_three_loops_the_upper_bound_is_what_all_phases_reach(n, steps):
    for M in random_matrices(np.random.default_rng(n), 12, n):
        bounds = mu_bounds(M[None])
        reached = by_phases(M, steps)
        assert reached <= bounds.upper[0] * (1.0 + 1e-9)
        assert bounds.upper[0] == pytest.approx(reached, rel=5.0 / steps**2 * 10.0 + 1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_the_bounds_enclose_mu_and_meet(n):
    M = random_matrices(np.random.default_rng(20 + n), 120, n)
    bounds = mu_bounds(M)
    assert np.all(bounds.lower <= bounds.upper * (1.0 + 1e-12))
    gap = bounds.upper / bounds.lower - 1.0
    assert np.median(gap) < 1e-6
    assert gap.max() < (1e-5 if n <= 3 else 0.05)  # 1e-5 is what the search stops at
    delta = bounds.phases / bounds.lower[:, None]
    singular = np.linalg.svd(np.eye(n) - M * delta[:, None, :], compute_uv=False)[:, -1]
    assert np.median(singular / np.abs(M).max(axis=(1, 2))) < 1e-6


def test_an_upper_bound_by_optimisation_finds_nothing_lower():
    from scipy.optimize import minimize

    for M in random_matrices(np.random.default_rng(5), 8, 4, 0.5):

        def size(x, M=M):
            return float(np.log(np.linalg.norm(scaled(M, np.append(x, 0.0)), 2)))

        starts = np.random.default_rng(0).normal(size=(6, 3))
        found = min(
            minimize(size, x, method="Nelder-Mead", options={"maxiter": 4000, "xatol": 1e-9}).fun for x in starts
        )
        assert np.log(mu_bounds(M[None]).upper[0]) < found + 1e-3


def test_it_is_the_norm_for_one_loop_and_the_largest_element_without_coupling():
    rng = np.random.default_rng(0)
    M = random_matrices(rng, 5, 3)
    diagonal = np.where(np.eye(3) > 0.0, M, 0.0)
    assert mu_bounds(diagonal).upper == pytest.approx(np.abs(np.einsum("fii->fi", M)).max(axis=1), rel=1e-5)
    triangular = np.triu(M)
    assert mu_bounds(triangular).upper == pytest.approx(np.abs(np.einsum("fii->fi", M)).max(axis=1), rel=1e-3)
    assert mu_bounds(M[:, :1, :1]).upper == pytest.approx(np.abs(M[:, 0, 0]))


def test_it_does_not_change_with_the_channels_units():
    rng = np.random.default_rng(1)
    M, units = random_matrices(rng, 10, 3), np.exp(3.0 * rng.normal(size=3))
    other = M * units[:, None] / units
    assert mu_bounds(other).upper == pytest.approx(mu_bounds(M).upper, rel=1e-6)


def test_two_loops_have_a_closed_form():
    M = random_matrices(np.random.default_rng(2), 50, 2)
    assert two_loops(M) == pytest.approx(mu_bounds(M).lower, rel=1e-7)
    assert upper_at(M, np.zeros((50, 2))) == pytest.approx(two_loops(M))


def test_a_few_steps_bring_near_scales_nearer():
    M = random_matrices(np.random.default_rng(3), 40, 4)
    best = mu_bounds(M)
    off = best.log_scales + 0.2 * np.random.default_rng(4).normal(size=best.log_scales.shape)
    before, after = upper_at(M, off) / best.upper - 1.0, upper_at(M, refined(M, off)) / best.upper - 1.0
    assert np.all(after <= before + 1e-12)
    assert after.mean() < 0.5 * before.mean()  # measured: 0.3


def closed_plants(count, n, seed):
    """Stable closed loops of random plants: plant, controllers and lines."""
    rng = np.random.default_rng(seed)
    while count:
        plant, integrators, unstable, lowest = random_plant(rng, n)
        controllers = [gain("abc"[k], np.exp(rng.normal())) for k in range(n)]
        if unstable or (poles(*plant, controllers).real > -1e-3).any():
            continue
        f = np.geomspace(0.02 * lowest, 1000.0, 1200)
        yield plant, controllers, f, integrators
        count -= 1


@pytest.mark.long
def test_the_change_that_it_names_destabilises_and_a_smaller_one_does_not():
    for plant, controllers, f, integrators in closed_plants(4, 2, 0):
        G = response_of(f, *plant)
        found = matrix_margins(loops(f, G, controllers, integrators))
        at = np.array([found.at_hz["disk_margin"]])  # on a line, or between two
        (P,), changed = response_of(at, *plant), np.array(found.worst_changes)
        assert gauge_matrix("disk", P, np.array([c.response(at)[0] for c in controllers])).shape == (2, 2)
        C = np.diag([c.response(at)[0] for c in controllers])
        limit = np.linalg.svd(np.eye(2) + np.diag(changed) @ C @ P, compute_uv=False)
        assert limit[-1] < 1e-3 * max(limit[0], 1.0)
        a = 0.98 * found.disk_margin
        rng = np.random.default_rng(1)
        for _ in range(40):  # real gains within the margin: the closed loop keeps all its poles in the left half
            d = 0.5 * a * rng.choice([-1.0, 1.0], 2) * rng.uniform(0.9, 1.0, 2)
            gains = [
                gain(c.loop, c.blocks[0].parameters["gain"] * g)
                for c, g in zip(controllers, (1 + d) / (1 - d), strict=True)
            ]
            assert (poles(*plant, gains).real < 0.0).all()


def test_inputs_and_outputs_at_once_is_no_larger_and_both_ends_alone_are_the_same():
    for plant, controllers, f, integrators in closed_plants(2, 2, 3):
        G = response_of(f, *plant)
        c = np.stack([own.response(f) for own in controllers], axis=1)
        at_inputs = np.linalg.inv(np.eye(2) + c[:, :, None] * G) - 0.5 * np.eye(2)
        at_outputs = gauge_matrix("disk", G, c)
        assert mu_bounds(at_inputs).upper == pytest.approx(mu_bounds(at_outputs).upper, rel=1e-9)
        found = matrix_margins(loops(f, G, controllers, integrators))
        assert found.input_output_disk_margin <= found.disk_margin * (1.0 + 1e-6)
        both = np.eye(4) + broken_twice(G[:3], c[:3])
        assert np.abs(np.linalg.det(both)) == pytest.approx(np.abs(np.linalg.det(np.eye(2) + c[:3, :, None] * G[:3])))


def test_one_loop_agrees_with_python_control():
    s = control.tf("s")
    L = 8.0 / (s * (0.2 * s + 1.0) * (0.05 * s + 1.0))
    w = np.geomspace(0.1, 1000.0, 4000)
    margin, _, _ = control.disk_margins(L, w)
    f = w / TWO_PI
    response = control.frequency_response(L, w).complex[:, None, None]
    found = matrix_margins(loops(f, response, [gain("a")], 1))
    assert found.disk_margin == pytest.approx(margin, rel=1e-9)


def test_several_loops_agree_with_slycot():
    ab13md = pytest.importorskip("slycot").ab13md
    for n in (2, 3, 4, 5):
        M = random_matrices(np.random.default_rng(n), 40, n)
        theirs = [ab13md(one, np.full(n, 1), np.full(n, 2))[0] for one in M]
        assert mu_bounds(M).upper == pytest.approx(theirs, rel=1e-3)
