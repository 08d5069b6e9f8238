"""A structure contains what is left of it where a block does nothing: it never ends lower than that."""

import numpy as np
import pytest
from tune_plants import DELAYED, GAIN, LEAD, LOW_PASS, NOTCH, PI, frf, problem_of, required, servo, servos

from loopshape.design.problem.evaluation import Evaluation
from loopshape.design.starts import embedded, neutral, substructures, without_one
from loopshape.design.tune import Search, tune

LIMITS = {"sensitivity_peak_db": 6.0}
LEAD_LAG = LEAD | {"f2_hz": {"min": 1.0, "max": 4000.0}}
PLANTS = {
    "three loads": servos(0.0, 60),
    "one load": [frf(servo(1.0), 60, "one", 0.5, 1500.0)],
    "delay": [frf(DELAYED, 60)],
}


def found_by(plant: str, structure: tuple[dict, ...], seed: int):
    return tune(PLANTS[plant], required(*structure, **LIMITS), explain=False, search=Search(seed=seed, starts=3))


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.hour)])
@pytest.mark.parametrize(
    ("plant", "less", "more"),
    [
        ("three loads", (GAIN, LEAD_LAG), (GAIN, LEAD_LAG, NOTCH)),
        ("one load", (GAIN, LEAD_LAG, NOTCH), (GAIN, LEAD_LAG, NOTCH, LEAD_LAG)),
        ("one load", (GAIN, PI, LEAD_LAG), (GAIN, PI, LEAD_LAG, LEAD_LAG)),
        ("delay", (GAIN, LEAD_LAG, LOW_PASS), (GAIN, LEAD_LAG, NOTCH, LOW_PASS)),
    ],
)
def test_one_block_more_never_costs(plant: str, less: tuple[dict, ...], more: tuple[dict, ...], seed: int) -> None:
    small, large = found_by(plant, less, seed), found_by(plant, more, seed)
    assert small.feasible
    assert large.feasible
    assert large.objective > small.objective - 1e-3


def test_what_is_embedded_is_the_same_controller() -> None:
    p = problem_of(PLANTS["three loads"], required(GAIN, LEAD_LAG, NOTCH, LEAD_LAG, LOW_PASS, **LIMITS))
    rng = np.random.default_rng(0)
    assert len(without_one(p)) == 3  # both leads and the notch
    for k, less in without_one(p):
        x = less.low + rng.random(less.low.size) * (less.high - less.low)
        assert np.allclose(Evaluation(p, embedded(p, k, x)).L, Evaluation(less, x).L, rtol=1e-12)


def test_contained_structures_are_each_named_once_and_their_number_is_bounded() -> None:
    p = problem_of(PLANTS["delay"], required(GAIN, NOTCH, NOTCH, LOW_PASS, **LIMITS))
    assert [[t.kind for t in one.templates] for one in substructures(p)] == [
        ["gain", "notch", "low_pass_2"],
        ["gain", "low_pass_2"],
    ]
    many = problem_of(PLANTS["delay"], required(GAIN, *[NOTCH, LEAD_LAG] * 4, **LIMITS))
    assert len(substructures(many)) == 7


def test_a_block_that_must_do_something_contains_nothing() -> None:
    apart = LEAD | {"f1_hz": {"min": 1.0, "max": 5.0}, "f2_hz": {"min": 6.0, "max": 50.0}}
    tied = {
        "kind": "notch",
        "f1_hz": 40.0,
        "f2_hz": "f1_hz",
        "damping1": {"min": 0.1, "max": 0.9},
        "damping2": "damping1",
    }
    templates = required(GAIN, apart, tied, LOW_PASS, **LIMITS).structure
    assert [neutral(t) is None for t in templates] == [True, True, False, True]
