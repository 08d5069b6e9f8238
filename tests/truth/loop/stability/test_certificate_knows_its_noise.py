"""Errors of the lines leave a count open where they may make it wrong, and do not where they cannot."""

import numpy as np
import pytest
from conversions import TWO_PI
from drawn_loops import LINES, PLANTS, by_roots, errors, frf_of, limit_gain, loop_of, unseen_damping, with_mode

from loopshape.data.response.smoothed import spread
from loopshape.loop.margin.between import without_narrow
from loopshape.loop.stability.obstacles import chance_of_error, radius_of
from loopshape.loop.stability.sampling import between_lines
from loopshape.loop.stability.stability import closed_loop_stability
from loopshape.loop.tolerances import TOL

STABLE = ("one integrator", "two integrators", "three integrators", "unstable pole")


def answer(plant, std, gain, rng, **settings):
    return closed_loop_stability(loop_of(plant, frf_of(LINES, plant.response(LINES), std, rng), gain, **settings))


@pytest.mark.long
@pytest.mark.parametrize("name", STABLE)
@pytest.mark.parametrize("noise", [1e-6, 0.02, 0.05, 0.1])
def test_near_a_limit_noise_leaves_it_open_and_never_makes_it_wrong(name, noise):
    plant, rng = PLANTS[name], np.random.default_rng(4)
    limit, decided = limit_gain(plant), 0
    for step in (0.9, 0.97, 1.03, 1.1) * 4:
        found = answer(plant, noise * np.abs(plant.response(LINES)), step * limit, rng)
        assert found.outcome == "undecided" or found.unstable_poles == by_roots(plant, step * limit)
        decided += found.outcome != "undecided"
    assert (decided == 16) if noise == 1e-6 else (decided >= (12 if noise == 0.02 else 1))


@pytest.mark.parametrize("name", STABLE)
@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_far_from_its_limits_a_loop_is_decided(name, noise):
    plant, rng = PLANTS[name], np.random.default_rng(5)
    for gain in (1.0, 3.0 * limit_gain(plant)):
        found = answer(plant, noise * np.abs(plant.response(LINES)), gain, rng)
        assert found.unstable_poles == by_roots(plant, gain)
        assert found.outcome == ("unstable" if by_roots(plant, gain) else "stable")


@pytest.mark.parametrize("name", STABLE)
def test_a_noise_floor_far_above_l_does_not_spoil_the_count(name):
    # at the last line |L| is below 0.01 and its error 0.3
    plant, rng = PLANTS[name], np.random.default_rng(6)
    std = 0.01 * np.abs(plant.response(LINES)) + 0.3 * (LINES / LINES[-1]) ** 2
    assert abs(plant.response(LINES[-1:])[0]) < 0.03
    for _ in range(5):
        assert answer(plant, std, 1.0, rng).outcome == "stable"


def test_a_floor_of_the_size_of_one_leaves_it_open():
    plant = PLANTS["one integrator"]
    std = 0.01 * np.abs(plant.response(LINES)) + np.where(LINES > 40.0, 2.0, 0.0)
    found = answer(plant, std, 1.0, np.random.default_rng(7))
    assert found.outcome == "undecided"
    assert found.band_hz[0] > 38.0


def test_raw_lines_are_left_open_where_their_neighbours_would_decide():
    plant = PLANTS["one integrator"]
    std, gain = 0.05 * np.abs(plant.response(LINES)), 0.85 * limit_gain(plant)
    raw, smooth = (answer(plant, std, gain, np.random.default_rng(8), smooth=s) for s in (False, True))
    assert smooth.outcome == "stable"
    assert raw.outcome == "undecided"


def test_the_band_to_measure_is_where_minus_one_is_covered():
    plant = PLANTS["two integrators"]
    found = answer(plant, 0.1 * np.abs(plant.response(LINES)), 0.98 * limit_gain(plant), np.random.default_rng(9))
    assert found.outcome == "undecided"
    crossing = np.roots(np.polyadd(plant.den, limit_gain(plant) * plant.num))
    at_hz = np.abs(crossing[np.argmax(crossing.real)].imag) / TWO_PI
    assert found.band_hz[0] < at_hz < found.band_hz[1]
    assert found.band_hz[1] < 2.0 * at_hz


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.02, 0.03, 0.05, 0.1])
def test_a_start_on_the_real_axis_is_as_unsure_as_the_first_line(noise):
    # k/(s/a - 1) with L(0) = -0.98 is unstable; noise on the first line may show -1.02
    plant = PLANTS["unstable pole"]
    gain = 0.98 / abs(plant.num[0])
    assert by_roots(plant, gain) == 1
    rng = np.random.default_rng(10)
    outcomes = [
        answer(plant, noise * np.abs(plant.response(LINES)), gain, rng, smooth=False).outcome for _ in range(60)
    ]
    assert "stable" not in outcomes


@pytest.mark.long
@pytest.mark.parametrize(("std", "decided"), [(0.06, 1.0), (0.1, 0.85), (0.17, 0.0), (0.25, 0.0)])
@pytest.mark.parametrize("shared", [1, 6])
def test_the_chance_is_never_less_than_how_often_the_winding_comes_out_wrong(std, decided, shared):
    # sixty lines that pass zero at 0.3, each with its own error, or `shared` neighbours with one in common
    rng, ends = np.random.default_rng(13), (0.3 - 3.0j, 0.3 + 3.0j)
    path, chances, wrong = 0.3 + 1j * np.linspace(-1.5, 1.5, 60), [], []

    def drawn():
        white = errors(rng, 60 + shared - 1)
        return std * np.convolve(white, np.ones(shared), "valid") / np.sqrt(shared)

    *_, alike = spread(np.array([drawn() for _ in range(200)]))
    for _ in range(1000):
        g = path + drawn()
        whole = np.concatenate([ends[:1], g, ends[1:]])
        wrong.append(abs(np.sum(np.angle(whole[1:] / whole[:-1])) - np.angle(ends[1] / ends[0])) > 1.0)
        chances.append(chance_of_error(np.abs(g) / std, alike)[0])
    assert np.mean(chances) >= np.mean(wrong)
    sure = np.array(chances) < TOL.wrong_count
    assert not np.any(np.array(wrong)[sure])
    assert np.mean(sure) >= decided - 0.1
    assert (np.mean(wrong) > 0.02) == (std == 0.25)


def test_the_chance_of_all_lines_together_is_the_normal_one():
    # the error moves the path as one: it passes zero with the chance that a normal number exceeds the distance
    rng = np.random.default_rng(12)
    path, draws = 0.2 + 1j * np.linspace(-3.0, 3.0, 2001), 0.1 * errors(rng, 20_000)
    other_side = np.mean(0.2 + draws.real < 0.0)
    chance, _ = chance_of_error(np.abs(path) / 0.1, spread(np.tile(draws[:200, None], path.size))[2])
    assert chance == pytest.approx(other_side, rel=0.4)


def test_a_variance_known_badly_counts_for_less():
    g, std = np.array([0.4 + 0.0j]), np.array([0.1])
    assert radius_of(g, std)[0] == pytest.approx(4.0)
    assert radius_of(g, std, 6.0)[0] < 2.5
    assert radius_of(g, std, 1e6)[0] == pytest.approx(4.0, rel=1e-3)
    assert np.isinf(radius_of(g, np.zeros(1))[0])


def scattered(plant, f_hz, width_hz, rng):
    """Lines as friction leaves them: off by 2 % and 5 % more about a resonance, in every period the same."""
    scatter = 0.02 + 0.05 / np.hypot(1.0, (LINES - f_hz) / width_hz)
    P = plant.response(LINES) * (1.0 + scatter * errors(rng, LINES.size))
    return frf_of(LINES, P, 0.003 * np.abs(P))


@pytest.mark.long
def test_lines_that_scatter_all_along_more_than_their_variance_says_are_counted_where_that_is_far_from_minus_one():
    rng, width_hz = np.random.default_rng(4), 0.15
    for _ in range(8):
        f_hz, plant = rng.uniform(12.0, 25.0), PLANTS["two integrators"]
        peak = rng.choice([-10.0, 10.0]) * abs(plant.response([f_hz])[0])
        plant = with_mode(plant, f_hz, width_hz / f_hz, peak)
        frf = scattered(plant, f_hz, width_hz, rng)
        for gain in (0.3, 0.5, 1.0):
            found = closed_loop_stability(loop_of(plant, frf, gain))
            assert found.unstable_poles == by_roots(plant, gain), (f_hz, gain, found.reason)


@pytest.mark.long
def test_among_such_lines_resonances_are_counted_or_left_open_or_sharper_than_the_answer_says():
    rng, decided = np.random.default_rng(8), 0
    for _ in range(5):
        f_hz, plant = rng.uniform(12.0, 25.0), PLANTS["two integrators"]
        for place in (0.0, rng.uniform(-0.3, 0.3)):
            peak = rng.choice([-1.0, 1.0]) * rng.uniform(3.0, 30.0) * abs(plant.response([f_hz])[0])
            plant = with_mode(plant, f_hz + place, np.exp(rng.uniform(np.log(0.01), np.log(0.15))) / f_hz, peak)
        frf = scattered(plant, f_hz, 0.1, rng)
        sharpest = min(-p.real / abs(p) for p in plant.poles() if p.imag > 0.0)
        for gain in (0.1, 0.3, 1.0):
            found = closed_loop_stability(loop := loop_of(plant, frf, gain))
            if found.outcome != "undecided":
                shown = between_lines(LINES, without_narrow(loop), frf.variance[:, 0, 0])
                unseen = unseen_damping(loop, shown.visible_residue)
                assert found.unstable_poles == by_roots(plant, gain) or sharpest < unseen
                decided += 1
    assert decided > 7
