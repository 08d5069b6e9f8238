"""Margins of noisy FRFs: corrected for the extreme value's bias, with intervals of the stated coverage."""

from dataclasses import replace

import numpy as np
import pytest
from bench_nouns import Block, Loop, TransferFunction
from conversions import TWO_PI

import loopshape as ls
from loopshape.identify.smooth.smoothing import smoothed
from loopshape.loop.margin.margins import margins

RATE = 1000.0
F = np.geomspace(0.1, 60.0, 400)
# an integrator with two lags and a delay: the true peak of |S| is 8.4 dB
LAGS = np.polymul([1.0 / (TWO_PI * 8.0), 1.0], [1.0 / (TWO_PI * 20.0), 1.0])
PLANT = TransferFunction([51.8], np.polymul([1.0, 0.0], LAGS), 0.0027)
CONTROLLER = ls.Controller("axis", (Block("gain", {"gain": 1.0}),), RATE)
DB = ("gain_margin_db", "sensitivity_peak_db", "complementary_peak_db", "process_peak_db")
RELATIVE = ("modulus_margin", "delay_margin_s", "disk_margin", "bandwidth_hz")
RUNS = 120


def frf(response, std, recording="r1"):
    return ls.FRF(
        F, response[:, None, None], (std * np.abs(PLANT.response(F)))[:, None, None] ** 2 + 0j,
        np.ones(F.size, dtype=bool), ("z_v",), ("y_rad",), "made up", recording=recording, loop="axis", rate_hz=RATE,
    )  # fmt: skip


def draw(std, rng):
    noise = np.sqrt(0.5) * (rng.standard_normal(F.size) + 1j * rng.standard_normal(F.size))
    return frf(PLANT.response(F) * (1.0 + std * noise), std)


def with_intervals(measured):
    plant, scatter = smoothed(measured)
    return margins(Loop(plant, CONTROLLER, 1, raw=measured, scatter=scatter, unstable_poles=0))


TRUTH = margins(Loop(frf(PLANT.response(F), 0.0), CONTROLLER, 1, unstable_poles=0))


@pytest.fixture(scope="module", params=[0.02, 0.05, 0.10])
def runs(request):
    rng = np.random.default_rng(1)
    measured = [draw(request.param, rng) for _ in range(RUNS)]
    raw = [margins(Loop(one, CONTROLLER, 1, unstable_poles=0)) for one in measured]
    return request.param, raw, [with_intervals(one) for one in measured]


def median(found, name):
    return np.median([getattr(m, name) for m in found])


def test_the_loop_is_the_one_of_the_question():
    assert TRUTH.sensitivity_peak_db == pytest.approx(8.4, abs=0.05)


@pytest.mark.long
def test_lines_at_face_value_are_biased_by_what_the_issue_says(runs):
    std, raw, _ = runs
    if std > 0.02:
        assert median(raw, "sensitivity_peak_db") - TRUTH.sensitivity_peak_db > (0.5 if std == 0.05 else 1.4)


@pytest.mark.long
def test_medians_are_true(runs):
    _, _, found = runs
    for name in DB:
        assert median(found, name) == pytest.approx(getattr(TRUTH, name), abs=0.2), name
    assert median(found, "phase_margin_deg") == pytest.approx(TRUTH.phase_margin_deg, abs=1.0)


@pytest.mark.long
@pytest.mark.parametrize("name", [*DB, "phase_margin_deg", *RELATIVE])
def test_intervals_hold_the_truth_as_often_as_they_say(runs, name):
    _, _, found = runs
    ends = np.array([m.intervals[name] for m in found])
    inside = np.sum((ends[:, 0] <= getattr(TRUTH, name)) & (getattr(TRUTH, name) <= ends[:, 1]))
    assert 105 <= inside <= 120  # binomial, 120 runs of 0.95: less than 105 once in 2000; 0.88 and less is told by it


@pytest.mark.long
def test_intervals_are_as_wide_as_the_scatter_of_what_they_hold(runs):
    _, _, found = runs
    for name in DB:
        ends = np.array([m.intervals[name] for m in found])
        half, spread = np.median(ends[:, 1] - ends[:, 0]) / 2.0, np.std([getattr(m, name) for m in found])
        assert 1.5 < half / spread < 2.7, name  # 1.96 of normal errors


@pytest.mark.long
def test_crossings_have_intervals(runs):
    _, _, found = runs
    hits = [low <= TRUTH.crossings_hz[0] <= high for m in found for low, high in m.crossing_intervals_hz[:1]]
    assert np.mean(hits) > 0.85
    assert all(len(m.crossings_hz) == len(m.crossing_intervals_hz) for m in found)
    assert np.mean([len(m.crossings_hz) == len(TRUTH.crossings_hz) for m in found]) > 0.9  # noise makes no crossings


def test_errors_shrink_as_one_over_the_root_of_the_lines_noise():
    rng = np.random.default_rng(2)
    halves = []
    for std in (0.01, 0.04):
        ends = np.array([with_intervals(draw(std, rng)).intervals["sensitivity_peak_db"] for _ in range(12)])
        halves.append(np.median(ends[:, 1] - ends[:, 0]))
    assert 2.3 < halves[1] / halves[0] < 4.4  # 4 with windows of one width; they widen with the noise


def test_a_noise_free_frf_is_left_as_it_is():
    exact = frf(PLANT.response(F), 0.0)
    plant, scatter = smoothed(exact)
    assert plant is not exact
    np.testing.assert_array_equal(plant.response, exact.response)
    assert not scatter.deviations.any()


def test_a_resonance_as_narrow_as_a_few_lines_is_not_smeared():
    w = TWO_PI * 4.0
    sharp = TransferFunction([1.0], [1 / w**2, 2 * 0.01 / w, 1.0]).response(F)
    noise = np.random.default_rng(3).standard_normal((2, F.size))
    measured = replace(
        frf(sharp * (1 + 0.02 * np.sqrt(0.5) * (noise[0] + 1j * noise[1])), 0.0),
        covariance=(0.02 * np.abs(sharp))[:, None, None] ** 2 + 0j,
    )
    plant, _ = smoothed(measured)
    k = int(np.argmax(np.abs(sharp)))
    near, far = slice(k - 3, k + 4), slice(0, 60)
    assert np.all(np.abs(plant.siso[near] / sharp[near] - 1) < 0.08)
    assert np.std(plant.siso[far] / sharp[far]) < 0.4 * np.std(measured.siso[far] / sharp[far])


def wish(**words):
    return ls.Requirements("axis", integrators=1, **words)


def outcome(std, seed, **words):
    verdict = ls.check([draw(std, np.random.default_rng(seed))], CONTROLLER, wish(**words))
    return verdict.lines[0]


@pytest.mark.parametrize(("required", "expected"), [(12.0, "passed"), (8.4, "undecided"), (6.0, "failed")])
def test_a_requirement_is_passed_failed_or_not_decided(required, expected):
    found = [outcome(0.05, seed, sensitivity_peak_db=required).outcome for seed in range(8)]
    assert found.count(expected) >= 7


def test_an_undecided_line_says_how_much_more_measuring_would_decide():
    tried = (outcome(0.10, seed, sensitivity_peak_db=8.7) for seed in range(20))
    line = next(one for one in tried if one.outcome == "undecided")
    assert line.longer > 1.0
    low, high = line.interval
    half = (high - line.value) if line.value < line.required else (line.value - low)
    # the interval shrinks as one over the root of the time: just so far that it ends at the limit
    assert half / np.sqrt(line.longer) == pytest.approx(abs(line.required - line.value), rel=1e-9)
    assert line.slack < 0.0


def test_the_verdict_is_as_undecided_as_its_lines():
    verdict = ls.check(
        [draw(0.05, np.random.default_rng(0))], CONTROLLER, wish(sensitivity_peak_db=8.4, gain_margin_db=1.0)
    )
    assert (verdict.outcome, verdict.passed) == ("undecided", False)
