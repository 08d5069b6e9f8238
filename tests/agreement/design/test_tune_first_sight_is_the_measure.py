"""What starts of a tuning are picked by is what rows measure; fewer lines tell the same; the count is that of roots."""

import numpy as np
import pytest
from tune_plants import DELAYED, GAIN, LEAD, LOW_PASS, NOTCH, frf, problem_of, required, servos

from loopshape.core.kernels.loops.encirclements import NO_FIT, count_unstable
from loopshape.core.kernels.loops.flat_loops import mark_peaks, series
from loopshape.core.kernels.loops.quick_evaluate import quick_evaluate
from loopshape.data.control.block import series_response
from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.search import initial_point
from loopshape.design.starts import glanced, scaled_start

LIMITS = {"sensitivity_peak_db": 6.0, "phase_margin_deg": 35.0, "gain_margin_db": 5.0, "control_peak_db": 20.0}
MASKED = LIMITS | {"masks": [{"response": "S", "points": [[0.6, -20.0], [6.0, 3.0]]}]}


WEIGHTED = {
    "weights": [
        {"response": "S", "points": [[0.6, 20.0], [60.0, -6.0]]},
        {"response": "T", "points": [[1.0, -20.0], [300.0, 10.0]]},
        {"response": "CS", "points": [[1.0, -40.0], [300.0, 0.0]]},
        {"response": "PS", "points": [[1.0, -30.0], [300.0, -20.0]]},
    ],
    "objective": "weighted_norm",
}
DISK = {"disk_margin": 0.6, "complementary_peak_db": 5.0}


@pytest.mark.parametrize("limits", [LIMITS, MASKED, WEIGHTED, WEIGHTED | {"weighted_norm": 2.0}, DISK])
def test_merit_and_count_are_those_of_rows(limits: dict) -> None:
    p = problem_of(servos(0.01, 300), required(GAIN, LEAD, NOTCH, LOW_PASS, **limits))
    q, rng = glanced(p), np.random.default_rng(3)
    apart, seen = [], 0
    for _ in range(150):
        x = p.low + rng.random(p.low.size) * (p.high - p.low)
        e = Evaluation(p, x)
        merit, _ = quick_evaluate(q, 1.0, e.C, e.C[p.above], e.below, np.inf)
        measured = initial_point(p, x).merit
        assert np.isfinite(merit) == np.isfinite(measured)
        if np.isfinite(merit):
            seen += 1
            apart.append(abs(merit - measured) / (1.0 + abs(measured)))
    assert seen > 20
    assert np.median(apart) < 1e-3
    assert np.mean(np.array(apart) < 0.02) > 0.9  # where 1 + L bends between lines the two read chords differently


def test_a_start_has_the_largest_gain_that_holds() -> None:
    p = problem_of([frf(DELAYED, 400)], required(GAIN, **LIMITS))
    seen = scaled_start(p, glanced(p), np.log([0.01]), 30)
    more = initial_point(p, seen.x + 1e-3).measures
    assert initial_point(p, seen.x - 1e-3).measures.worst >= 0.0
    assert more.worst < 0.0


def test_coarse_lines_keep_resonances_and_measure_alike() -> None:
    p = problem_of(servos(0.0, 2000), required(GAIN, LEAD, NOTCH, LOW_PASS, **LIMITS))
    assert p.coarse.f.size < 0.3 * p.f.size
    rng, apart = np.random.default_rng(0), []
    for _ in range(200):
        x = scaled_start(p, glanced(p), p.low + rng.random(p.low.size) * (p.high - p.low)).x
        full, few = initial_point(p, x), initial_point(p.coarse, x)
        if full.measures.stable and full.measures.worst >= 0.0:
            apart.append(abs(few.merit - full.merit))
        if len(apart) == 25:
            break
    assert len(apart) >= 10
    assert np.median(apart) < 0.02


def test_the_count_is_that_of_the_closed_loop_s_roots() -> None:
    rng = np.random.default_rng(11)
    f = np.geomspace(1e-4, 1e3, 40_000)
    s, nothing, counts = 2j * np.pi * f, np.zeros(0, dtype=complex), set()
    for _ in range(120):
        integrators = int(rng.integers(0, 3))
        den = np.polymul(np.poly(-rng.uniform(0.5, 20.0, 3)), [1.0] + [0.0] * integrators)
        num = rng.uniform(0.1, 300.0) * np.atleast_1d(np.poly(rng.uniform(-10.0, 2.0, int(rng.integers(0, 3)))))
        if num[-1] < 0.0:
            num = -num
        L = np.polyval(num, s) / np.polyval(den, s)
        roots = np.roots(np.polyadd(num, den))
        if np.abs(roots.real).min() < 0.02:
            continue
        counts.add(int(np.sum(roots.real > 0.0)))
        assert count_unstable(L, integrators, 0, nothing) == np.sum(roots.real > 0.0)
    assert counts >= {0, 2}
    assert count_unstable(np.array([-5.0 + 0.1j, -0.1 + 0j]), 0, 0, nothing) == NO_FIT


def test_sections_in_series_are_the_blocks() -> None:
    p = problem_of([frf(DELAYED, 200)], required(GAIN, LEAD, NOTCH, LOW_PASS, **LIMITS))
    x = 0.5 * (p.low + p.high)
    sections = [block.section() for block in p.blocks(x)]
    plain = np.prod([np.polyval(num[::-1], p.s) / np.polyval(den[::-1], p.s) for num, den in sections], axis=0)
    np.testing.assert_allclose(series(Evaluation(p, x).sections, p.s), plain, rtol=1e-13)
    np.testing.assert_allclose(series_response(p.blocks(x), p.s), plain, rtol=1e-13)


def test_peaks_are_marked_with_their_neighbours_and_the_largest_of_each_loop() -> None:
    size, first = np.array([0.0, 3.0, 1.0, -np.inf, 2.0, 2.5, 0.5, 0.0, 0.0]), np.array([0, 4, 9])
    for level, expected in ((0.9, [0, 1, 2, 4, 5, 6]), (9.0, [1, 5])):
        marked = np.zeros(9, dtype=bool)
        assert mark_peaks(size, np.full(2, level), first, 10.0, 4, marked) == len(expected)
        assert np.flatnonzero(marked).tolist() == expected
