"""Realisations of multisines: noise between periods, distortion between draws, blocks that solve a matrix exactly."""

from dataclasses import replace

import excitations
import numpy as np
import pytest
from bench_nouns import LoopSetup, RecordingInfo
from scipy.signal import lfilter
from scipy.stats import f as f_distribution

import loopshape as ls
from loopshape.identify.frequency_response import estimate_frf, estimate_realisations
from loopshape.identify.matrix.matrix import estimate_matrix

RATE, PERIOD, N = 100.0, 4.0, 400
LOOP = LoopSetup("axis", None, None, "z_v", "y_rad", None)
# rings for 0.1 s: settled after the first of the periods
A, B = np.poly([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j)]).real, np.array([0.0, 0.05, 0.02])
LEVEL, PERIODS = 0.05, 4


def multisine(seed, periods=PERIODS + 1):
    return excitations.multisine(0.25, 20.0, PERIOD, RATE, periods=periods, seed=seed, ramp_s=0.0)


def info(name="r.parquet", **said):
    words = {"period_s": PERIOD, "periodic_from_s": PERIOD, "excites": "axis", "closed_loop": False} | said
    return RecordingInfo(name, "multisine", "control", **words)


def draws(count, cube, level=LEVEL, seed=1):
    """Recordings of draws on a plant whose input bends, u + cube u³."""
    rng, made = np.random.default_rng(seed), []
    for k in range(count):
        u = multisine(seed + k)
        u = 0.7 * u / u.std()
        y = lfilter(B, A, u + cube * u**3) + level * rng.standard_normal(u.size)
        made.append(ls.Recording(info(f"r{k}.parquet"), RATE, {"z_v": u, "y_rad": y}))
    return made


def known_noise(recordings, frf):
    """Variance (nf,) that white noise of `LEVEL` leaves in the mean of recordings."""
    lines = np.round(frf.frequency_hz * PERIOD).astype(int)
    each = [LEVEL**2 / N / PERIODS / np.abs(np.fft.rfft(r.column("z_v")[-N:])[lines] / N) ** 2 for r in recordings]
    return np.mean(each, axis=0) / len(recordings)


def noise_and_total(frf):
    return frf.noise_covariance[:, 0, 0].real, frf.covariance[:, 0, 0].real


def sets(count, cube):
    recordings = draws(6 * count, cube)
    return [recordings[k : k + 6] for k in range(0, len(recordings), 6)]


@pytest.mark.parametrize("cube", [0.0, 0.3])
def test_the_noise_part_is_the_noise_that_was_put_in(cube):
    found = []
    for some in sets(30, cube):
        frf = estimate_realisations(some, LOOP)
        found.append(np.mean(noise_and_total(frf)[0] / known_noise(some, frf)))
    # 30 sets of 80 lines, six recordings, 3 degrees of freedom: 1 % of chance
    assert np.mean(found) == pytest.approx(1.0, abs=0.04)


def test_on_a_linear_plant_the_total_is_the_noise_and_on_a_bent_one_it_is_more():
    for cube, low, high in ((0.0, 0.93, 1.07), (0.3, 3.0, np.inf)):
        frfs = [estimate_realisations(some, LOOP) for some in sets(20, cube)]
        noise, total = np.mean([noise_and_total(x) for x in frfs], axis=0)
        assert low < np.mean(total / noise) < high


def test_the_total_is_the_scatter_about_the_best_linear_approximation():
    best = estimate_realisations(draws(400, 0.3, level=0.0, seed=10_000), LOOP).siso
    frfs = [estimate_realisations(some, LOOP) for some in sets(30, 0.3)]
    error = np.mean([np.abs(x.siso - best) ** 2 for x in frfs])
    assert np.mean([x.covariance[:, 0, 0].real for x in frfs]) == pytest.approx(error, rel=0.1)


def test_the_public_verb_takes_draws_together_where_asked_to():
    """With 300 other draws as the truth 95 % of lines lie within the interval of four draws, and fewer of one's."""
    best = estimate_realisations(draws(300, 0.3, level=0.0, seed=10_000), LOOP).siso
    run = ls.Run(RATE, (LOOP,), draws(40, 0.3))
    each = ls.frfs(run)
    fours = [ls.frfs(replace(run, recordings=run.recordings[k : k + 4]), realisations=True) for k in range(0, 40, 4)]
    assert (len(each), {len(one) for one in fours}) == (40, {1})
    shares = [np.mean([within(one, best) for one in some]) for some in (each, [f for (f,) in fours])]
    assert shares[1] == pytest.approx(0.95, abs=0.03)
    assert shares[0] < 0.8


def within(frf, best):
    """Share of lines whose 95 % circle holds the truth."""
    reach = f_distribution.isf(0.05, 2, frf.variance_freedom)
    return np.mean(np.abs(frf.siso - best) ** 2 < reach * frf.covariance[:, 0, 0].real)


def test_a_period_stated_one_sample_wrong_is_found_and_said():
    (recording,) = draws(1, 0.0, level=0.0)
    right = estimate_frf(recording, LOOP)
    for stated in (N - 1, N + 1):
        wrong = ls.Recording(info(period_s=stated / RATE), RATE, recording.columns)
        frf = estimate_frf(wrong, LOOP)
        assert any(f"repeats every {N} samples" in note and f"not every {stated}" in note for note in frf.notes)
        np.testing.assert_array_equal(frf.frequency_hz, right.frequency_hz)
        np.testing.assert_allclose(frf.siso, right.siso, rtol=1e-8)
    assert not any("repeats every" in note for note in right.notes)


# x+ = AM x + BM u, y = CM x
AM, BM = np.diag([0.9, 0.6]), np.array([[0.1, 0.15], [0.05, 0.3]])
CM = np.array([[0.6, 0.1], [0.2, 0.5]])
LOOPS = tuple(LoopSetup(f"l{k}", None, None, f"z{k}_v", f"y{k}_rad", None) for k in (0, 1))


def matrix(f_hz):
    z = np.exp(2j * np.pi * np.asarray(f_hz) / RATE)
    return CM @ np.linalg.solve(z[:, None, None] * np.eye(2) - AM, BM.astype(complex))


def outputs(u):
    x, y = np.zeros(2), np.empty_like(u)
    for k in range(len(u)):
        y[k] = CM @ x
        x = AM @ x + BM @ u[k]
    return y


def together(number, u):
    y = outputs(u)
    words = info(f"r{number}.parquet", excites="l0", excites_also=("l1",))
    return ls.Recording(words, RATE, {f"z{k}_v": u[:, k] for k in (0, 1)} | {f"y{k}_rad": y[:, k] for k in (0, 1)})


def block(seed, first=0):
    whole = np.stack([multisine(seed + k, 4) for k in (0, 1)], axis=1)
    return [together(first + k, whole * signs) for k, signs in enumerate(([1.0, 1.0], [1.0, -1.0]))]


@pytest.mark.parametrize("blocks", [1, 2])
def test_orthogonal_multisines_solve_the_matrix_exactly_without_noise(blocks):
    recordings = [r for k in range(blocks) for r in block(10 * k, 2 * k)]
    frf = estimate_matrix(ls.Run(RATE, LOOPS, recordings), recordings)
    np.testing.assert_allclose(frf.response, matrix(frf.frequency_hz), rtol=1e-8, atol=1e-12)
    assert (frf.noise_covariance is None) == (blocks == 1)


def test_sets_that_cannot_be_solved_are_refused():
    first, second = block(0)
    with pytest.raises(ls.errors.WrongUseError, match="as many recordings, or a multiple"):
        estimate_matrix(ls.Run(RATE, LOOPS, [first]), [first])
    same = ls.Recording(second.info, RATE, first.columns)
    with pytest.raises(ls.errors.BadSignalError, match="cannot be separated"):
        estimate_matrix(ls.Run(RATE, LOOPS, [first, same]), [first, same])
    with pytest.raises(ls.errors.WrongUseError, match="realisations are two recordings or more"):
        estimate_realisations(draws(1, 0.0), LOOP)


def test_loops_excited_a_different_number_of_times_are_refused():
    first = block(0)[0]
    said = [info(f"r{k}.parquet", excites=loop) for k, loop in enumerate(("l0", "l0", "l1"))]
    alone = [ls.Recording(words, RATE, first.columns) for words in said]
    with pytest.raises(ls.errors.WrongUseError, match="as many recordings of each loop"):
        estimate_matrix(ls.Run(RATE, LOOPS, alone), alone)
