"""What kernels tell of draws of an error in one pass is what plain arrays of all draws tell."""

import numpy as np
import pytest
from tune_plants import GAIN, LEAD, LOW_PASS, NOTCH, problem_of, required, servos

import loopshape as ls
from loopshape.core.kernels.loops.quick_evaluate import quick_evaluate
from loopshape.data.response.smoothed import BETWEEN, Dense, by_draw, spread
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.search import LARGEST, PENALTY, Goal, initial_point, linear
from loopshape.design.starts import glanced
from loopshape.loop.margin.margins import Reader, kernel

F = np.geomspace(0.1, 100.0, 60)
P = 5.0 / (1j * F * (1.0 + 0.1j * F))


def drawn(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def test_spread_is_that_of_numpy() -> None:
    draws = drawn(np.random.default_rng(1), 50, 30) + 0.5
    rms, std, alike = spread(draws)
    np.testing.assert_allclose(rms, np.sqrt(np.mean(np.abs(draws) ** 2, axis=0)))
    np.testing.assert_allclose(std, np.std(draws, axis=0))
    plain = [
        abs(np.vdot(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b))
        for a, b in zip(draws.T[:-1], draws.T[1:], strict=True)
    ]
    np.testing.assert_allclose(alike, plain)


def test_draws_between_lines_go_straight_and_know_what_the_spline_adds() -> None:
    deviations = 0.01 * np.abs(P) * drawn(np.random.default_rng(2), 400, F.size)
    at = np.sort(np.concatenate([F, np.sqrt(F[20:24] * F[21:25])]))
    found = Dense(F, P, P, deviations).at(at)
    lines = np.isin(at, F)
    np.testing.assert_array_equal(found.deviations[:, lines], deviations)
    np.testing.assert_array_equal(found.response[lines], P)
    k = np.searchsorted(F, at[~lines]) - 1
    share = (at[~lines] - F[k]) / (F[k + 1] - F[k])
    low = 2.0 * F[0] > F
    ln = np.log(np.abs(P[low])) + 1j * np.unwrap(np.angle(P[low]))
    power = np.polyfit(np.log(F[low]), ln, 1)[0]  # of f, which the lowest lines follow
    ahead, back = (F / F[0]) ** -power, (at[~lines] / F[0]) ** power

    def chord(values: np.ndarray) -> np.ndarray:
        flat = values * ahead
        return back * (flat[..., k] * (1.0 - share) + flat[..., k + 1] * share)

    more = np.sqrt(np.mean(np.abs(found.deviations[:, ~lines] - chord(deviations)) ** 2, axis=0))
    np.testing.assert_allclose(more / np.abs(found.response[~lines] - chord(P)), BETWEEN, rtol=1e-6)


@pytest.mark.parametrize("bounded", [True, False])
def test_margins_of_draws_are_those_of_each_loop(bounded: bool) -> None:
    C = 2.0 * (1.0 + 0.2j * F) / (1.0 + 0.01j * F)
    draws, above = 0.05 * np.abs(P) * drawn(np.random.default_rng(3), 40, F.size), np.geomspace(100.0, 400.0, 9)[1:]
    reader = Reader(20.0, (ls.Mask("S", ((1.0, -10.0), (3.0, 3.0))),))
    lines = kernel.Lines(F, C, above, C[-8:])
    one_by_one, _ = reader.read(C * P + C * draws, lines, bounded=bounded)
    at_once = reader.read_drawn(C * P, C, by_draw(draws), lines, bounded=bounded)
    np.testing.assert_allclose(at_once, one_by_one, rtol=1e-9)


def test_a_glance_ends_early_only_where_no_limit_holds_and_nothing_is_gained() -> None:
    limits = {"sensitivity_peak_db": 6.0, "phase_margin_deg": 35.0, "control_peak_db": 20.0}
    p = problem_of(servos(0.01, 300), required(GAIN, LEAD, NOTCH, LOW_PASS, **limits))
    q, rng, ended = glanced(p), np.random.default_rng(4), 0
    for _ in range(150):
        e = Evaluation(p, p.low + rng.random(p.low.size) * (p.high - p.low))
        merit, holds = quick_evaluate(q, 1.0, e.C, e.C[p.above], e.below, np.inf)
        for enough in (merit - 0.1, merit + 0.1, -1.0):
            found, held = quick_evaluate(q, 1.0, e.C, e.C[p.above], e.below, enough)
            assert held == holds
            assert found == merit or (np.isinf(found) and merit >= enough and not holds)
            ended += bool(np.isinf(found) and np.isfinite(merit))
    assert ended > 10


@pytest.mark.long
@pytest.mark.hour
@pytest.mark.parametrize("goal", [LARGEST, Goal(soft=frozenset({"phase_margin_deg"}))])
def test_the_linear_programme_holds_every_row_that_may_bind(goal: Goal) -> None:
    limits = {"sensitivity_peak_db": 6.0, "phase_margin_deg": 35.0, "control_peak_db": 20.0}
    p = problem_of(servos(0.0, 300), required(GAIN, LEAD, **limits))
    m = initial_point(p, 0.5 * (p.low + p.high)).measures
    low, high = np.full(p.low.size, -0.3), np.array([0.3, 0.1, 0.0])
    cost, A, b, lows, highs = linear(m, goal, low, high)
    rng, n = np.random.default_rng(5), low.size
    np.testing.assert_array_equal(cost, [*np.zeros(n), -1.0, 1.0, PENALTY])
    soft = np.array([x in (goal.soft or ()) for x in m.what])
    for _ in range(200):
        dx = low + rng.random(n) * (high - low)
        slowest, rooms = (m.ln_bandwidth + m.bandwidth_slopes @ dx).min(), m.room + m.room_slopes @ dx
        misses = [float(np.max(-rooms[mine], initial=0.0)) for mine in (soft, ~soft)]
        y = np.array([*dx, slowest, *misses])
        assert np.all(A @ y <= b + 1e-9)
        assert np.all(y >= lows)
        assert np.all(y <= highs)
        for k in range(n, y.size):  # and no less will do
            less = y.copy()
            less[k] += 1e-6 if k == n else -1e-6
            assert np.any(A @ less > b + 1e-9) or np.any(less < lows)
