"""What a start promises, counted by cell, is what whole residual vectors give; what containing an effect costs."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from loopshape.toolbox.gap.diagnose import attribute, decide, fitting
from loopshape.toolbox.gap.diagnose.evidence import Cell, Evidence
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis
from loopshape.toolbox.gap.nouns.effect import EffectForm, Free, Spread
from loopshape.toolbox.gap.tolerances import TOL

CELLS = (Cell("r1", "a", 0, 40, 0.5), Cell("r1", "b", 40, 100, 2.0), Cell("r2", "a", 100, 170, 0.5))
RNG = np.random.default_rng(5)
OWN, SPREAD = RNG.standard_normal(170), RNG.standard_normal((170, 2))
MEASURED = 1.7 * OWN + SPREAD @ [0.4, -0.3] + 0.05 * RNG.standard_normal(170)


class Line:
    """A plant whose residuals go with its effect and with two numbers of its tolerance in straight lines."""

    spread = (Spread("one", ("s1",), 1.0, adds=True), Spread("two", ("s2",), 1.0, adds=True))
    effects = (EffectForm("load", "only", "body", "1", (Free("load", -5.0, 5.0, (0.5, 2.0)),), usual=(0.1, 5.0)),)

    parameters = SimpleNamespace(rows=(SimpleNamespace(value=0.0),) * 2, index={"s1": 0, "s2": 1}.get)

    def residuals(self, prepared, moves):
        out = MEASURED - moves.get("load", 0.0) * OWN - SPREAD @ [moves["s1"], moves["s2"]]
        return {"a": out}


@pytest.fixture
def evidence():
    return Evidence(Line(), [None], 1, CELLS)


def test_a_straight_line_is_guessed_whole(evidence):
    base = attribute.healthy(evidence)
    (guess,) = attribute.started(evidence, [Hypothesis(evidence.plant, evidence.plant.effects)], base)
    (found,) = evidence.residuals([guess.hypothesis.moves(guess.phi)])
    assert guess.cost == pytest.approx(fitting.cost(evidence.mean_squares(found)), rel=1e-9)
    assert guess.phi[0] == pytest.approx(1.7, abs=0.02)  # five standard deviations


def test_a_step_by_cells_is_the_weighted_least_squares_step(evidence):
    h = Hypothesis(evidence.plant, evidence.plant.effects)
    slopes, residual = -np.column_stack([OWN, SPREAD]), MEASURED
    weight = np.array([1.0, 0.3, 0.7])
    rows = np.concatenate(
        [np.full(c.stop - c.start, w / (c.stop - c.start)) / c.floor**2 for c, w in zip(CELLS, weight, strict=True)]
    )
    held = np.sqrt(0.05) * np.eye(3)[1:]  # the light hold on the tolerance
    table = np.vstack([slopes * np.sqrt(rows)[:, None], held])
    want = np.linalg.lstsq(table, np.concatenate([-residual * np.sqrt(rows), np.zeros(2)]), rcond=None)[0]
    step = fitting.box_step(h, np.zeros(3), fitting.normal(evidence, slopes, residual), weight, np.ones(3, dtype=bool))
    assert np.allclose(step, want, atol=1e-7)


def test_leaving_a_recording_out_predicts_it_from_the_others(evidence):
    fitted = attribute.healthy(evidence)
    left = attribute.left_out(evidence, fitted)
    moved = fitted.residual + fitted.slopes @ (left.phi[1] - fitted.phi)
    want = np.array(fitted.mean_squares)
    want[2] = evidence.mean_squares(moved)[2]
    first = fitted.residual + fitted.slopes @ (left.phi[0] - fitted.phi)
    want[:2] = evidence.mean_squares(first)[:2]
    assert left.cost == pytest.approx(fitting.cost(want), rel=1e-9)


def test_an_effect_that_contains_another_costs_what_two_effects_cost(evidence):
    (form,) = evidence.plant.effects
    fits = [attribute.healthy(evidence)]
    for f in (form, replace(form, extends="weight")):
        (guess,) = attribute.started(evidence, [Hypothesis(evidence.plant, (f,))], fits[0])
        fits.append(fitting.at(evidence, guess.hypothesis, guess.phi, -np.column_stack([OWN, SPREAD])))
    none, alone, containing = (decide.candidate(evidence, f, fits[0]).price for f in fits)
    assert (none, alone) == (0.0, TOL.one_effect)
    assert containing == pytest.approx(TOL.two_effects)


def test_a_size_is_as_sure_as_its_form_fits(evidence):
    none = attribute.healthy(evidence)
    (guess,) = attribute.started(evidence, [Hypothesis(evidence.plant, evidence.plant.effects)], none)
    found = fitting.at(evidence, guess.hypothesis, guess.phi, -np.column_stack([OWN, SPREAD]))
    left = attribute.left_out(evidence, found)
    found = replace(found, mean_squares=np.full(3, 5.0))  # two noise floors are left

    def deviation(gap_floors):
        gap = replace(none, mean_squares=np.full(3, 1.0 + gap_floors**2))
        return attribute.deviation_of_magnitude(evidence, found, left, gap, 0)

    wider = np.sqrt(deviation(20.0) ** 2 - deviation(1e9) ** 2)  # of 20 a tenth is left, of 1e9 nothing
    assert wider == pytest.approx(TOL.of_what_is_left * 0.1 * found.magnitudes[0], rel=1e-6)
    assert attribute.share_left(none, none) == 1.0


def test_two_numbers_that_rounding_alone_tells_apart_share_the_step():
    # an effect that is the change of a tolerance: its products come from differences, 1e-8 below what they should be
    h, g = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-8]]), np.array([1.0, 1.0])
    step = fitting._solve(h, g, np.full(2, -9.0), np.full(2, 9.0), np.ones(2, dtype=bool))
    assert step.sum() == pytest.approx(1.0, rel=1e-4)


class Idle(Line):
    """A plant on which the effect does nothing but round the last digits another way."""

    def residuals(self, prepared, moves):
        out = MEASURED - SPREAD @ [moves["s1"], moves["s2"]]
        return {"a": out * (1.0 + 3e-16 * (moves.get("load", 0.0) != 0.0))}


def test_a_start_that_changes_nothing_is_left_as_it_is():
    evidence = Evidence(Idle(), [None], 1, CELLS)
    base = attribute.healthy(evidence)
    (guess,) = attribute.started(evidence, [Hypothesis(evidence.plant, evidence.plant.effects)], base)
    assert guess.cost == pytest.approx(fitting.cost(base.mean_squares), rel=1e-6)
