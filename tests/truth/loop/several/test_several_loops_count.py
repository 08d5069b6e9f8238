"""The count of det(I + L): what it decides is what the eigenvalues say, for several hundred plants."""

import numpy as np
import pytest
from bench_nouns import Loop
from conversions import TWO_PI
from several_cases import (
    crossing_somewhere,
    frf_of,
    gain,
    log_uniform,
    loops,
    noisy,
    pi,
    poles,
    random_controllers,
    random_plant,
    response_of,
)

from loopshape.loop.matrix.determinant import closed_loops_stability, count_from_held
from loopshape.loop.stability.obstacles import Undecided


def random_case(rng, n, low, high, lines=600):
    """Loops whose lines start at a share of the lowest corner, and their closed-loop poles."""
    plant, integrators, unstable, lowest = random_plant(rng, n)
    controllers, corner = random_controllers(rng, n)
    f = np.geomspace(min(lowest, corner) * log_uniform(rng, low, high), 3000.0, lines)
    G = response_of(f, *plant)
    controllers = crossing_somewhere(rng, f, G, controllers, lines // 2)
    return loops(f, G, controllers, integrators, unstable), poles(*plant, controllers), plant


@pytest.mark.long
@pytest.mark.parametrize(
    ("n", "count", "least"),
    [
        (1, 100, 0.9),
        (2, 110, 0.7),
        pytest.param(3, 60, 0.55, marks=pytest.mark.hour),
        pytest.param(4, 25, 0.3, marks=pytest.mark.hour),
    ],
)
def test_from_lines_below_the_lowest_corner_the_count_is_never_wrong(n, count, least):
    rng = np.random.default_rng(10 + n)
    cases = [random_case(rng, n, 0.01, 0.3) for _ in range(count)]
    found = [(closed_loops_stability(case), int(np.sum(p.real > 0.0))) for case, p, _ in cases]
    decided = [(one, unstable) for one, unstable in found if one.outcome != "undecided"]
    for one, unstable in decided:
        assert one.unstable_poles == unstable
        assert (one.outcome == "stable") == (unstable == 0)
    assert len(decided) > least * count  # the rest has a crossover below its first line
    assert {unstable == 0 for _, unstable in decided} == {True, False}


@pytest.mark.long
@pytest.mark.parametrize("low", [pytest.param(0.01, marks=pytest.mark.hour), 0.5])
def test_from_loops_that_stood_nothing_has_to_be_declared(low):
    rng = np.random.default_rng(3)
    outcomes = []
    while len(outcomes) < 60:
        held, before, plant = random_case(rng, 2, low, 4.0 * low, 600)
        if (before.real > 0.0).any():
            continue
        other, _ = random_controllers(rng, 2)
        f = held.frequency_hz
        new = [
            gain(c.loop, c.blocks[0].parameters["gain"] * log_uniform(rng, 0.3, 40.0), *c.blocks[1:])
            for c in held.controllers
        ]
        new = new if rng.random() < 0.5 else crossing_somewhere(rng, f, held.P, other, 300)
        made = Loop(held.plant, new, None, 0, recorded_under=held.controllers)
        count = count_from_held(made)
        unstable = int(np.sum(poles(*plant, new).real > 0.0))
        if not isinstance(count, Undecided):
            assert count == unstable
            assert closed_loops_stability(made).outcome == ("unstable" if unstable else "stable")
        outcomes.append((isinstance(count, Undecided), unstable > 0))
    assert outcomes.count((False, False)) > 15
    assert outcomes.count((False, True)) > 2


F = np.geomspace(0.001, 300.0, 1500)
S = 1j * TWO_PI * F


def bad_pair():
    """1/(s + 1) [[1, 2], [2, 1]]: det P(0) < 0 while both diagonal elements are positive."""
    return np.array([[1.0, 2.0], [2.0, 1.0]]) / (S / TWO_PI + 1.0)[:, None, None]


def test_each_loop_alone_stands_and_the_pair_falls():
    controllers = [gain("a", 2.0, pi(0.5)), gain("b", 2.0, pi(0.5))]
    for k in range(2):
        alone = closed_loops_stability(loops(F, bad_pair()[:, k : k + 1, k : k + 1], controllers[k : k + 1]))
        assert (alone.outcome, alone.unstable_poles) == ("stable", 0)
    both = closed_loops_stability(loops(F, bad_pair(), controllers))
    assert (both.outcome, both.unstable_poles) == ("unstable", 1)


def test_the_other_pairing_stands():
    controllers = [gain("a", 2.0, pi(0.5)), gain("b", 2.0, pi(0.5))]
    assert closed_loops_stability(loops(F, bad_pair()[:, ::-1], controllers)).outcome == "stable"


@pytest.mark.long
def test_without_coupling_it_is_the_sum_of_the_single_counts():
    one = 60.0 / (S * (0.02 * S + 1.0) * (0.01 * S + 1.0))  # unstable at a gain above 2.5
    for gains, unstable in (((1.0, 1.0), 0), ((1.0, 4.0), 2), ((4.0, 4.0), 4)):
        G = np.zeros((F.size, 2, 2), dtype=complex)
        G[:, 0, 0] = G[:, 1, 1] = one
        found = closed_loops_stability(loops(F, G, [gain("a", gains[0]), gain("b", gains[1])], 2))
        assert found.unstable_poles == unstable


@pytest.mark.parametrize("declared", [0, 4, 5])
def test_integrators_that_do_not_fit_are_not_believed(declared):
    G = np.array([[1.0, 0.3], [-0.2, 1.0]]) * (3.0 / (S * (0.01 * S + 1.0)))[:, None, None]
    found = closed_loops_stability(loops(F, G, [gain("a"), gain("b")], declared))
    assert found.outcome == "undecided"
    assert f"do not fit {declared} integrators" in found.reason
    assert closed_loops_stability(loops(F, G, [gain("a"), gain("b")], 2)).outcome == "stable"


def undecided(f, G, controllers=None, integrators=2, **fields):
    found = closed_loops_stability(loops(f, G, controllers or [gain("a"), gain("b")], integrators, **fields))
    assert (found.outcome, found.unstable_poles) == ("undecided", None)
    return found


def pair_of(f, k=3.0):
    s = 1j * TWO_PI * f
    return np.array([[1.0, 0.3], [-0.2, 0.1]]) * (k / (s * (0.01 * s + 1.0)))[:, None, None]


def test_undecided_where_a_crossover_lies_below_the_first_line_and_it_says_where():
    f = F[F > 0.2]
    found = undecided(f, pair_of(f))
    assert "its crossover lies lower" in found.reason
    assert found.band_hz[0] < 0.1 * 3.0 / TWO_PI < found.band_hz[1]


def test_undecided_where_the_lines_end_too_soon():
    f = F[F < 0.3]
    assert "measure higher" in undecided(f, pair_of(f)).reason


def test_undecided_where_integrators_are_not_known():
    assert "declare integrators" in undecided(F, pair_of(F), integrators=None).reason


@pytest.mark.long
def test_undecided_where_noise_covers_the_limit_and_not_beside_it():
    G = np.array([[1.0, 0.3], [-0.2, 1.0]]) * (60.0 / (S * (0.02 * S + 1.0) * (0.01 * S + 1.0)))[:, None, None]
    near = [gain("a", 1.05 * 1.4885), gain("b", 1.05 * 1.4885)]  # unstable from 1.4885 on
    assert closed_loops_stability(loops(F, G, near, 2)).outcome != "undecided"
    found = undecided(F, G, near, relative=0.3)
    assert "uncertainty" in found.reason or "errors" in found.reason
    assert closed_loops_stability(loops(F, G, [gain("a", 0.3), gain("b", 0.3)], 2, relative=0.05)).outcome == "stable"


def test_a_declaration_that_the_recorded_loops_contradict_is_not_believed():
    controllers = (gain("a"), gain("b"))
    G = np.array([[1.0, 0.3], [-0.2, 1.0]]) * (3.0 / (S * (0.01 * S + 1.0)))[:, None, None]
    for unstable, outcome in ((0, "stable"), (1, "undecided")):
        made = Loop(frf_of(F, G), controllers, 2, unstable, recorded_under=controllers)
        found = closed_loops_stability(made)
        assert found.outcome == outcome
    assert "one of them is wrong" in found.reason


def test_what_lies_above_the_judged_lines_is_not_overlooked():
    G = pair_of(F)
    above = np.linspace(310.0, 400.0, 20)
    beyond = frf_of(above, np.tile(5.0 * np.eye(2), (20, 1, 1)) + 0j)
    made = Loop(frf_of(F, G), (gain("a"), gain("b")), 2, 0, beyond=beyond)
    assert "above the band that is known well" in closed_loops_stability(made).reason


def test_a_line_on_the_limit_itself_is_undecided_without_a_warning():
    f = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    one = np.array([-4.0j, -2.0j, -1.0 + 0.0j, -0.3, -0.2, -0.1])
    G = np.zeros((6, 2, 2), dtype=complex)
    G[:, 0, 0] = G[:, 1, 1] = one
    found = undecided(f, G)
    assert found.reason


@pytest.mark.parametrize("share", [1.0 - 1e-4, 1.0 + 1e-4])
def test_an_eigenvalue_as_good_as_on_the_limit_is_undecided_however_large_the_others(share):
    # alone the first loop is unstable above a gain of 2.5; the second stays stable and makes det(I + L) large
    G = np.zeros((F.size, 2, 2), dtype=complex)
    G[:, 0, 0] = 60.0 / (S * (0.02 * S + 1.0) * (0.01 * S + 1.0))
    G[:, 1, 1] = 600.0 / (S + 1.0)
    near = closed_loops_stability(loops(F, G, [gain("a", 2.5 * share), gain("b")], 1))
    assert near.outcome == "undecided"
    assert "an eigenvalue of L passes -1" in near.reason


@pytest.mark.long
def test_noise_alone_changes_no_answer():
    rng = np.random.default_rng(0)
    f = np.arange(0.1, 12.0, 0.1)
    s = 1j * TWO_PI * f
    G = np.array([[1.0, 0.3], [-0.3, 1.0]]) * (3.0 / (s * (0.02 * s + 1.0)))[:, None, None]
    controllers = (gain("a"), gain("b"))
    found = [
        closed_loops_stability(Loop(noisy(frf_of(f, G, 0.05), rng), controllers, 2, unstable_poles=0)).outcome
        for _ in range(60)
    ]
    assert "unstable" not in found
    assert found.count("stable") > 50


@pytest.mark.long
def test_loci_that_start_off_the_real_axis_or_about_the_limit_are_counted_right():
    rng, wrong, decided = np.random.default_rng(7), [], []
    f = np.geomspace(0.002, 500.0, 400)
    for _ in range(110):
        n = int(rng.integers(2, 4))
        gains = -np.eye(n) + rng.normal(size=(n, n)) * log_uniform(rng, 0.01, 1.0)
        corners = np.diag(TWO_PI * np.exp(rng.uniform(-1.0, 3.0, n)))
        controllers = [gain("abc"[k]) for k in range(n)]
        found = closed_loops_stability(loops(f, response_of(f, -corners, corners, gains), controllers))
        unstable = int(np.sum(poles(-corners, corners, gains, controllers).real > 0.0))
        if found.unstable_poles is not None:
            decided.append(unstable > 0)
            wrong += [(found, unstable)] if found.unstable_poles != unstable else []
    assert not wrong
    assert decided.count(True) > 30
    assert decided.count(False) > 10
