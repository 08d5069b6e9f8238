"""Scores of hand-made answers are what counting by hand gives, with the intervals of the literature."""

import json

import numpy as np
import pytest
from examiner.labels import BLOCKS
from examiner.score import (
    BARS,
    FAILED,
    Label,
    against_bars,
    as_csv,
    as_json,
    calibrated,
    ece,
    mark,
    score,
    share,
    spread,
)
from scipy.stats import binom


def answer(verdict, *others, p=0.9, magnitude=None, interval=None, block=None, shrink=None, time_s=50.0):
    """An answer whose verdict has the probability p and whose other names share the rest, each less than before."""
    rest = (1.0 - p) * np.array([0.6 * 0.5**k for k in range(len(others))])
    first = {"effect": verdict, "probability": p}
    if magnitude is not None:
        first |= {"magnitude": magnitude, "interval": list(interval or (magnitude - 1.0, magnitude + 1.0))}
    ranking = [first, *({"effect": n, "probability": float(q)} for n, q in zip(others, rest, strict=True))]
    place = block or "+".join(sorted(BLOCKS.get(part, part) for part in verdict.split("+")))
    return {
        "verdict": verdict, "ranking": ranking, "ambiguity_set": [[verdict, *others[:1]]], "where": {"block": place},
        "gap": {"shrink": shrink}, "time_s": time_s,
    }  # fmt: skip


def single(name, size, given, case="case-001", variant=0):
    return mark(Label(case, "single", {name: size}, variant), given)


FAILS = {"run": "case-009", "verdict": FAILED, "ranking": [], "error": "...", "time_s": 3.0}
EXAM = [
    single("payload", 50.0, answer("payload", "base_tilt", magnitude=55.0, interval=(52.0, 60.0), shrink=0.9)),
    single("base_tilt", -5.0, answer("base_tilt", "none", magnitude=5.0, shrink=0.5), variant=1),
    single("leak", 0.2, answer("hose_lag", "leak", "none", p=0.5)),
    single("backlash", 0.5, answer("unknown", "none", "backlash", p=0.6)),
    single("hose_lag", 2.0, answer("hose_lag+payload", "hose_lag", p=0.7, magnitude=2.0)),
    single("loop_delay", 4.0, FAILS),
    mark(Label("h1", "healthy", {}, 0), answer("none", "leak")),
    mark(Label("h2", "healthy", {}, 0), answer("leak", "none")),
    mark(Label("u1", "unknown", {"flow_drift": 0.3}, 0), answer("unknown", "leak")),
    mark(Label("u2", "unknown", {"exhaust_clog": 0.3}, 0), answer("valve_delay", "unknown")),
    mark(Label("p1", "pair", {"leak": 0.2, "payload": 50.0}, 0), answer("leak+payload", "leak")),
    mark(Label("p2", "pair", {"leak": 0.2, "payload": 50.0}, 0), answer("payload", "leak", time_s=120.0)),
    mark(Label("p3", "pair", {"leak": 0.2, "payload": 50.0}, 0), answer("backlash+gas_law", "none")),
]


@pytest.fixture(scope="module")
def scores():
    return score(EXAM)


@pytest.mark.parametrize(
    ("name", "right", "of"),
    [
        ("single", 2, 6),
        ("first_two", 4, 6),
        ("block", 3, 6),
        ("false_alarms", 1, 2),
        ("unknown", 1, 2),
        ("unknown_or_block", 2, 2),
        ("pairs", 1, 3),
        ("pairs_one", 2, 3),
        ("magnitude", 1, 2),
        ("interval_coverage", 0, 2),
        ("set_coverage", 9, 13),
    ],
)
def test_counts_are_those_by_hand(scores, name, right, of):
    found = getattr(scores, name)
    assert (found.right, found.of) == (right, of)
    assert found.value == pytest.approx(right / of)
    assert found.interval[0] <= found.value <= found.interval[1]


def test_the_truth_s_rank_counts_pairs_none_and_unknown_as_wrong_answers():
    assert [m.rank for m in EXAM[:6]] == [1, 1, 2, 3, 2, None]


def test_magnitudes_are_signed(scores):
    assert EXAM[0].magnitude_error == pytest.approx(0.1)
    assert EXAM[1].magnitude_error == pytest.approx(2.0)  # the size is right, the sign is wrong
    assert scores.magnitude_error.median == pytest.approx(1.05)


def test_shrink_counts_only_where_the_effect_was_named_right(scores):
    assert scores.shrink.of == 2
    assert scores.shrink.median == pytest.approx(0.7)
    assert single("leak", 0.2, answer("hose_lag", shrink=0.9)).shrink is None
    none = score([single("leak", 0.2, answer("leak")), *EXAM[:2]])
    assert (none.no_gap_to_shrink, none.shrink.of) == (1, 2)


def test_by_effect_by_variant_and_confusion(scores):
    assert scores.by_effect["payload"].value == 1.0
    assert scores.by_variant["1"][:2] == (1, 1)
    assert scores.by_form["leak/0"][:2] == (0, 1)
    assert scores.confusion["pair"] == {"pair": 1, "payload": 1, "wrong pair": 1}
    assert scores.confusion["hose_lag"] == {"pair": 1}
    assert sum(sum(row.values()) for row in scores.confusion.values()) == len(EXAM)
    assert scores.failed == 1


def test_time(scores):
    assert scores.time_s.largest == 120.0
    assert scores.time_s.median == 50.0


@pytest.mark.parametrize(
    ("right", "of", "level", "low", "high"),
    [
        (0, 20, 0.95, 0.0, 0.1684),
        (0, 20, 0.90, 0.0, 0.1391),  # its upper end is one-sided 95 %: 0 of 20 proves less than 14 %
        (1, 10, 0.95, 0.0025, 0.4450),
        (5, 10, 0.95, 0.1871, 0.8129),
        (10, 10, 0.95, 0.6915, 1.0),
    ],
)
def test_clopper_and_pearson_s_intervals(right, of, level, low, high):
    """Newcombe, Statistics in Medicine 17 (1998) 857, and the definition: both tails of the binomial."""
    found = share(right, of, level).interval
    assert found == pytest.approx((low, high), abs=1e-4)
    if right < of:
        assert binom.cdf(right, of, found[1]) == pytest.approx(0.5 * (1.0 - level))
    if right > 0:
        assert binom.sf(right - 1, of, found[0]) == pytest.approx(0.5 * (1.0 - level))


def test_the_median_s_interval_holds_it_in_95_of_100_samples():
    rng = np.random.default_rng(4)
    true = spread(list(rng.gamma(2.0, size=200001))).median
    held = [
        s.interval[0] <= true <= s.interval[1] for s in (spread(list(rng.gamma(2.0, size=25))) for _ in range(2000))
    ]
    assert 0.94 < np.mean(held) < 0.985


def test_calibration_error_by_hand():
    confidence = np.array([0.91, 0.93, 0.95, 0.97, 0.55, 0.53])
    right = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    found = calibrated(confidence, right)
    assert found.ece == pytest.approx((4 * abs(0.75 - 0.94) + 2 * abs(0.5 - 0.54)) / 6)
    assert [b.right.of for b in found.bins] == [2, 4]
    assert [b.confidence for b in found.bins] == pytest.approx([0.54, 0.94])
    assert found.ece_adaptive == pytest.approx(np.mean(np.abs(confidence - right)))  # each answer a bin of its own


def test_the_null_of_the_calibration_error_is_its_distribution_under_perfect_answers():
    rng = np.random.default_rng(7)
    confidence = rng.beta(5.0, 1.0, 104)
    found = calibrated(confidence, np.ones(104))
    bins = np.minimum((confidence * 10).astype(int), 9)
    fresh = [ece(confidence, (rng.random(104) < confidence).astype(float), bins) for _ in range(3000)]
    assert found.null_mean == pytest.approx(np.mean(fresh), rel=0.03)
    assert found.null_95 == pytest.approx(np.quantile(fresh, 0.95), rel=0.05)
    assert found == calibrated(confidence, np.ones(104))  # seeded
    sure = calibrated(np.full(20, 1.0), np.ones(20))
    assert (sure.ece, sure.null_mean, sure.null_95) == (0.0, 0.0, 0.0)


def test_the_null_falls_with_the_root_of_the_number_of_answers():
    rng = np.random.default_rng(8)
    few, many = (calibrated(c, np.zeros(c.size)) for c in (rng.random(100), rng.random(1600)))
    assert few.null_mean / many.null_mean == pytest.approx(4.0, rel=0.15)


def test_bars(scores):
    lines = {line.bar.score: line for line in against_bars(scores)}
    assert set(lines) == {bar.score for bar in BARS}
    assert lines["single"].met == "missed"
    assert lines["time_s"].met == "aim"
    assert lines["false_alarms"].met == "missed"
    assert lines["set_coverage"].met == "-"  # no bar
    healthy = {line.bar.score: line.met for line in against_bars(score(EXAM[6:7]))}
    assert healthy["false_alarms"] == "aim"
    assert healthy["single"] == "-"  # no cases


def test_json_and_csv_hold_everything(scores):
    words = as_json(scores)
    assert words["single"] == {
        "right": 2,
        "of": 6,
        "value": pytest.approx(1 / 3),
        "interval": list(scores.single.interval),
    }
    assert words["calibration"]["bins"][0]["right"]["of"] == 1
    json.dumps(words)
    table = as_csv(EXAM).splitlines()
    assert len(table) == 1 + len(EXAM)
    assert table[0].startswith("case,kind,truth,variant,verdict,probability,rank,")


def test_no_answers_give_numbers_that_say_so():
    empty = score([])
    assert empty.single.interval == (0.0, 1.0)
    assert np.isnan(empty.calibration.ece)
    assert {line.met for line in against_bars(empty)} == {"-"}
