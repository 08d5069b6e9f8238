"""Which effect: every form of every effect fitted, first coarsely, then the best of them with all their slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array
from loopshape.diagnose import fitting
from loopshape.diagnose.evidence import Evidence
from loopshape.diagnose.fitting import Fitted
from loopshape.diagnose.hypothesis import Hypothesis


def healthy(evidence: Evidence) -> Fitted:
    """The nominal model with the manufacturing tolerance fitted."""
    none = Hypothesis(evidence.plant)
    phi = np.zeros(len(evidence.plant.spread))
    start = fitting.at(evidence, none, phi, np.zeros((evidence.cells[-1].stop, phi.size)))
    return fitting.improve(evidence, start, 4, all_slopes=True)


@dataclass(frozen=True, eq=False)
class Guess:
    """A hypothesis at a start moved once by straight lines, and the cost that they promise."""

    hypothesis: Hypothesis
    phi: Array
    cost: float


def screened(
    evidence: Evidence, hypotheses: Sequence[Hypothesis], base: Fitted, rounds: int = 2, brief: bool = False
) -> list[Fitted]:
    """Each hypothesis that may matter, fitted from its best start with the slopes of the spread taken from `base`.

    What a start, scaled at best, leaves is a first guess; the best of them are fitted. `brief` tries one start each.
    """
    guesses = sorted(started(evidence, hypotheses, base, brief), key=lambda g: g.cost)
    chosen = worth_fitting(guesses, base)
    evidence.residuals([g.hypothesis.moves(g.phi) for g in chosen])  # in parallel, and remembered
    found = [fitting.at(evidence, g.hypothesis, g.phi, _spread_slopes(base, g.phi.size)) for g in chosen]
    found = [fitting.improve(evidence, f, 1, all_slopes=False) for f in found]
    near = within_reach(found)
    return [fitting.improve(evidence, f, rounds - 1, all_slopes=False) if f in near else f for f in found]


def within_reach(fitted: Sequence[Fitted]) -> list[Fitted]:
    """Those, best first, that may still come near the best: the first few, and whatever costs little more."""
    ordered = sorted(fitted, key=lambda f: f.cost)
    return [f for k, f in enumerate(ordered) if k < _FEW or f.cost < ordered[0].cost + _HOPELESS]


_FEW = 2
_HOPELESS = 25.0  # of cost: at the highest temperature a probability of 5e-5, and less of what is plain


def _spread_slopes(base: Fitted, p: int) -> Array:
    """Slopes (n, p) with those of the base's spread at their end."""
    n_spread = base.phi.size - base.hypothesis.n_free
    return np.pad(base.slopes[:, base.phi.size - n_spread :], ((0, 0), (p - n_spread, 0)))


def worth_fitting(guesses: Sequence[Guess], base: Fitted) -> list[Guess]:
    """The guesses, best first, that gain a quarter of what the best gains, and at least a few."""
    gains = [base.cost - g.cost for g in guesses]
    enough = sum(gain > 0.25 * gains[0] for gain in gains)
    return list(guesses[: min(max(enough, 8), 20)])


#: share of mean squares below which a start is taken to change nothing
_ROUNDING = 1e-10


def started(evidence: Evidence, hypotheses: Sequence[Hypothesis], base: Fitted, brief: bool = False) -> list[Guess]:
    """Each hypothesis at its best start, the magnitude scaled and the spread answering, both by straight lines."""
    every = [(h, h.starts(base.phi)[: 1 if brief else None]) for h in hypotheses]
    residuals = iter(evidence.residuals([h.moves(phi) for h, starts in every for phi in starts]))
    n_spread = base.phi.size - base.hypothesis.n_free
    known = np.column_stack([base.slopes[:, base.phi.size - n_spread :], base.residual])
    table = fitting.normal(evidence, known, base.residual).squares
    out = []
    for hypothesis, starts in every:
        tried = []
        for phi in starts:
            residual = np.nan_to_num(next(residuals), nan=1e9, posinf=1e9, neginf=-1e9)
            products = fitting.products(evidence, known, residual)
            squares = evidence.mean_squares(residual)
            tried += _guesses(hypothesis, phi, base, table, products, squares)
        out.append(min(tried, key=lambda g: g.cost))
    return out


def _guesses(
    hypothesis: Hypothesis, phi: Array, base: Fitted, table: Array, products: Array, squares: Array
) -> list[Guess]:
    """The spread moved once; and the newest magnitude with it, scaled as if its effect went in proportion.

    All by cell: `table` (cells, k, k) of the products of the spread's slopes and the base's residual, `products`
    (cells, k) of them with the residual at this start, whose mean squares are `squares` (cells,).
    """
    n_spread = products.shape[1] - 1
    spread = np.zeros(phi.size, dtype=bool)
    spread[phi.size - n_spread :] = True
    h = np.zeros((len(squares), phi.size, phi.size))
    g = np.zeros((len(squares), phi.size))
    h[:, phi.size - n_spread :, phi.size - n_spread :] = table[:, :-1, :-1]
    g[:, phi.size - n_spread :] = products[:, :-1]
    out = [_guess(hypothesis, phi, fitting.Normal(h, g), squares, fitting.weights(squares), spread)]
    place = sum(len(f.free) for f in hypothesis.forms[:-1])
    across, own = products[:, -1], table[:, -1, -1]
    changed = np.maximum(squares - 2.0 * across + own, 0.0)  # rounding is left where the start changes nothing
    if (start := phi[place]) != 0.0 and np.any(changed > _ROUNDING * (squares + own)):
        h[:, place, place] = changed / start**2
        h[:, place, phi.size - n_spread :] = (products[:, :-1] - table[:, -1, :-1]) / start
        h[:, phi.size - n_spread :, place] = h[:, place, phi.size - n_spread :]
        g[:, place] = (squares - across) / start
        weight = fitting.weights(np.minimum(squares, base.mean_squares))
        spread[place] = True
        out.append(_guess(hypothesis, phi, fitting.Normal(h, g), squares, weight, spread))
    return out


def _guess(
    hypothesis: Hypothesis, phi: Array, equations: fitting.Normal, squares: Array, weight: Array, free: Array
) -> Guess:
    step = fitting.box_step(hypothesis, phi, equations, weight, free)
    left = squares + 2.0 * equations.products @ step + equations.squares @ step @ step
    return Guess(hypothesis, phi + step, fitting.cost(np.maximum(left, 0.0)))


def again(evidence: Evidence, fitted: Fitted, rounds: int) -> Fitted:
    """The same hypothesis from its numbers on other evidence, with all slopes anew."""
    start = fitting.at(evidence, fitted.hypothesis, fitted.phi, np.zeros((evidence.cells[-1].stop, fitted.phi.size)))
    return fitting.improve(evidence, start, rounds, all_slopes=True)


def best_forms(fitted: Sequence[Fitted]) -> list[Fitted]:
    """The best form of each effect (or pair), best first."""
    best: dict[str, Fitted] = {}
    for f in sorted(fitted, key=lambda f: f.cost):
        best.setdefault(f.hypothesis.name, f)
    return list(best.values())


@dataclass(frozen=True, eq=False)
class LeftOut:
    """What leaving each recording out of a fit gives: cost of predicting it, and the numbers phi (recordings, p)."""

    cost: float
    phi: Array


def left_out(evidence: Evidence, fitted: Fitted) -> LeftOut:
    """Each recording predicted from the others: numbers moved to fit those, by the slopes."""
    weight = fitting.weights(fitted.mean_squares)
    equations = fitting.normal(evidence, fitted.slopes, fitted.residual)
    free = np.any(fitted.slopes != 0.0, axis=0)
    left = np.array(fitted.mean_squares)
    moved = []
    for name in evidence.recordings:
        own = np.array([c.recording == name for c in evidence.cells])
        step = np.zeros(free.size)
        if not own.all():
            step = fitting.box_step(fitted.hypothesis, fitted.phi, equations, np.where(own, 0.0, weight), free)
        change = 2.0 * equations.products @ step + equations.squares @ step @ step
        left[own] = np.maximum(fitted.mean_squares + change, 0.0)[own]
        moved.append(fitted.phi + step)
    return LeftOut(fitting.cost(left), np.array(moved))


def share_left(fitted: Fitted, healthy: Fitted) -> float:
    """Share of the healthy model's gap, rms beyond the noise floor, that a hypothesis leaves; 1 without a gap."""
    left, gap = (max(float(f.mean_squares.mean()) - 1.0, 0.0) for f in (fitted, healthy))
    return float(np.sqrt(left / gap)) if gap > left else 1.0


def deviation_of_magnitude(evidence: Evidence, fitted: Fitted, left: LeftOut, healthy: Fitted, place: int) -> float:
    """Standard deviation of a form's magnitude: recordings, tolerance, and forms that are never quite right.

    Recordings by the jackknife (Efron 1982); what the data cannot tell from the spread by the covariance under its
    prior. For the form FORM_ERROR of the magnitude, chosen after an exam whose intervals without it covered 39 %, and
    OF_WHAT_IS_LEFT times the share of the gap that the form leaves: what arms of one form of the catalogue showed when
    the others were fitted (`experiments/effects`, forms.csv).
    """
    at = sum(len(f.free) for f in fitted.hypothesis.forms[:place])
    scale = fitted.hypothesis.forms[place].scale
    values = scale * left.phi[:, at]
    n = len(values)
    jackknife = (n - 1) / n * float(np.sum((values - values.mean()) ** 2))
    form = np.hypot(FORM_ERROR, OF_WHAT_IS_LEFT * share_left(fitted, healthy)) * scale * float(fitted.phi[at])
    return float(np.sqrt(jackknife + scale**2 * _prior_variance(evidence, fitted, at) + form**2))


FORM_ERROR, OF_WHAT_IS_LEFT = 0.04, 1.6
_WORTH = 20.0  # independent observations that a cell is taken for


def _prior_variance(evidence: Evidence, fitted: Fitted, at: int) -> float:
    """Variance of one number where the spread is uniform in -1..1 and a cell counts for a few observations."""
    free = np.any(fitted.slopes != 0.0, axis=0)
    if not free[at]:
        return 0.0
    squares = fitting.normal(evidence, fitted.slopes[:, free], fitted.residual).squares
    information = _WORTH * np.tensordot(fitting.weights(fitted.mean_squares), squares, 1)
    spread = np.flatnonzero(free) >= fitted.hypothesis.n_free
    information[spread, spread] += 3.0
    return float(np.linalg.pinv(information)[np.sum(free[:at]), np.sum(free[:at])])
