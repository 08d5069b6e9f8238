"""Names that recordings cannot tell apart stand together, and a pair's main effect is the one that moves the most."""

from types import SimpleNamespace

import numpy as np
import pytest

from loopshape.toolbox.gap.diagnose import attribute, decide, fitting
from loopshape.toolbox.gap.diagnose.decide import decided
from loopshape.toolbox.gap.diagnose.evidence import Cell, Evidence
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis
from loopshape.toolbox.gap.diagnose.told_apart import Scale, groups, main_effect
from loopshape.toolbox.gap.nouns.effect import EffectForm, Free

ROWS = 60
CELLS = tuple(Cell(f"r{k}", "a", ROWS * k, ROWS * (k + 1), 1.0) for k in range(6))
RNG = np.random.default_rng(8)
PUSH, OTHER, UNMODELLED = RNG.standard_normal((3, ROWS * len(CELLS)))
SHAPES = {"push": PUSH, "late": PUSH + 0.01 * OTHER, "rub": OTHER}


class Bench:
    """Residuals of straight lines: `late` is `push` but for a hundredth, `rub` is something else."""

    spread = ()
    effects = tuple(
        EffectForm(n, "only", n, "1", (Free(n, -900.0, 900.0, (1.0,)),), usual=(0.1, 900.0)) for n in SHAPES
    )
    parameters = SimpleNamespace(rows=(), index={}.get)

    def __init__(self, measured):
        self.measured = measured

    def residuals(self, prepared, moves):
        return {"a": self.measured - sum((moves.get(n, 0.0) * x for n, x in SHAPES.items()), np.zeros(PUSH.size))}


def found(measured):
    """Evidence, every effect and the two pairs with `rub` fitted, and what the best leaves."""
    plant = Bench(measured)
    evidence = Evidence(plant, [None], 1, CELLS)
    healthy = attribute.healthy(evidence)
    push, late, rub = plant.effects
    made = [(), (push,), (late,), (rub,), (push, rub), (late, rub)]
    fits = [fitting.at(evidence, h, np.zeros(h.n_free), np.zeros((PUSH.size, h.n_free)))
            for h in (Hypothesis(plant, forms) for forms in made)]  # fmt: skip
    fits = [fitting.improve(evidence, f, 4, all_slopes=True) for f in fits]
    scored = {c.name: c for c in (decide.candidate(evidence, f, healthy) for f in fits)}
    left = 1.0 + decide.discrepancy(["a"] * len(CELLS), [c.left.squares for c in scored.values()])
    return evidence, scored, Scale(evidence, left)


def test_names_whose_predictions_differ_by_less_than_what_is_left_are_a_group():
    _, scored, scale = found(10.0 * PUSH + 3.0 * UNMODELLED)
    assert not scale.apart(scored["push"], scored["late"])
    assert scale.apart(scored["push"], scored["rub"])
    assert scale.apart(scored["push"], scored["push+rub"])  # one effect is never told by two
    said = {"push": 0.5, "rub": 0.1, "late": 0.35, "unknown": 0.03, "none": 0.02}
    assert groups(scale, scored, said) == [("push", "late"), ("rub",)]
    assert groups(scale, scored, dict(said, unknown=0.9))[0] == ("unknown",)  # nothing stands for it


def test_where_little_is_left_the_same_names_are_told_apart():
    _, scored, scale = found(400.0 * PUSH)  # late is off by four floors, and the best by none
    assert scored["late"].fitted.magnitudes[0] == pytest.approx(400.0, rel=0.01)
    assert scale.apart(scored["push"], scored["late"])


@pytest.mark.parametrize(("push", "rub", "main"), [(10.0, 3.0, "push"), (3.0, 10.0, "rub")])
def test_the_main_effect_of_a_pair_moves_most(push, rub, main):
    evidence, scored, _ = found(push * PUSH + rub * OTHER + UNMODELLED)
    assert main_effect(evidence, scored["push+rub"]) == main


def test_a_refused_pair_leaves_its_probability_to_its_main_effect():
    pairs, seen = {"late+rub"}, {"late+rub": 0.9, "rub": 0.05, "late": 0.03, "unknown": 0.01, "none": 0.01}
    after = {"late+rub": 3.0, "rub": 6.0}
    assert next(iter(decided(seen, pairs, 50.0, after, 3.0))) == "rub"
    out = decided(seen, pairs, 50.0, after, 3.0, main="late")
    assert next(iter(out)) == "late"
    assert sum(out.values()) == pytest.approx(1.0)


def test_a_second_effect_that_does_not_matter_is_none():
    pairs, seen = {"late+rub"}, {"late+rub": 0.9, "rub": 0.05, "late": 0.03, "unknown": 0.01, "none": 0.01}
    after = {"late+rub": 0.9, "rub": 2.5}  # 2.3 floors are the second's, and the noise is reached
    assert next(iter(decided(seen, pairs, 50.0, after, 1.0, matters=1.0, main="rub"))) == "late+rub"
    assert next(iter(decided(seen, pairs, 50.0, after, 1.0, matters=5.0, main="rub"))) == "rub"
