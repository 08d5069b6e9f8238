"""Which effect: every form of every effect fitted, first coarsely, then the best of them with all their slopes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.gap.diagnose import fitting
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.fitting import Fitted
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis
from loopshape.toolbox.gap.tolerances import TOL


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
    few = 2
    hopeless = 25.0  # of cost: at the highest temperature a probability of 5e-5, and less of what is plain
    return [f for k, f in enumerate(ordered) if k < few or f.cost < ordered[0].cost + hopeless]


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
_TINY = 1e-100  # of a start, and its inverse: squares of what lies between are numbers


def started(evidence: Evidence, hypotheses: Sequence[Hypothesis], base: Fitted, brief: bool = False) -> list[Guess]:
    """Each hypothesis at its best start, the magnitude scaled and the tolerance answering, by straight lines.

    `brief` tries one start each, and follows the recordings whole; the numbers of the base's effects answer too where
    prices are not calibrated without that.
    """
    every = [(h, h.starts(base.phi)[: 1 if brief else None]) for h in hypotheses]
    near, tried = base.hypothesis.moves(base.phi), [h.moves(phi) for h, starts in every for phi in starts]
    residuals = iter(evidence.residuals(tried) if brief else evidence.nearby(near, tried))
    slopes = base.slopes.copy()
    slopes[:, : base.hypothesis.n_free if not brief or evidence.plant.calibrated else 0] = 0.0
    known = np.column_stack([slopes, base.residual])
    table = fitting.normal(evidence, known, base.residual).squares
    out = []
    for hypothesis, starts in every:
        guesses = []
        for phi in starts:
            residual = np.nan_to_num(next(residuals), nan=1e9, posinf=1e9, neginf=-1e9)
            products = fitting.products(evidence, known, residual)
            squares = evidence.mean_squares(residual)
            guesses += _guesses(hypothesis, phi, replace(base, slopes=slopes), table, products, squares)
        out.append(min(guesses, key=lambda g: g.cost))
    return out


def _guesses(
    hypothesis: Hypothesis, phi: Array, base: Fitted, table: Array, products: Array, squares: Array
) -> list[Guess]:
    """The base's numbers moved once; and the newest magnitude with them, scaled as if its effect went in proportion.

    All by cell: `table` (cells, k, k) of the products of the base's slopes and its residual, `products` (cells, k) of
    them with the residual at this start, whose mean squares are `squares` (cells,).
    """
    place = base.hypothesis.n_free  # the newest magnitude stands behind those of the base, before the spread
    n_spread = base.phi.size - place
    mine = np.concatenate([np.arange(place), np.arange(phi.size - n_spread, phi.size)])
    free = np.zeros(phi.size, dtype=bool)
    free[mine] = np.any(base.slopes != 0.0, axis=0)
    h = np.zeros((len(squares), phi.size, phi.size))
    g = np.zeros((len(squares), phi.size))
    h[:, mine[:, None], mine] = table[:, :-1, :-1]
    g[:, mine] = products[:, :-1]
    out = [_guess(hypothesis, phi, fitting.Normal(h, g), squares, fitting.weights(squares), free)]
    across, own = products[:, -1], table[:, -1, -1]
    changed = np.maximum(squares - 2.0 * across + own, 0.0)  # rounding is left where the start changes nothing
    if _TINY < abs(start := phi[place]) < 1.0 / _TINY and np.any(changed > _ROUNDING * (squares + own)):
        h[:, place, place] = changed / start**2
        h[:, place, mine] = (products[:, :-1] - table[:, -1, :-1]) / start
        h[:, mine, place] = h[:, place, mine]
        g[:, place] = (squares - across) / start
        weight = fitting.weights(np.minimum(squares, base.mean_squares))
        free[place] = True
        out.append(_guess(hypothesis, phi, fitting.Normal(h, g), squares, weight, free))
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
    """The best form of each effect (or pair), best first; one that is another and more has to be clearly better."""
    best: dict[str, Fitted] = {}
    more = 7.5  # of cost: what a second effect costs at the highest temperature
    for f in sorted(fitted, key=lambda f: f.cost + more * sum(bool(form.extends) for form in f.hypothesis.forms)):
        best.setdefault(f.hypothesis.name, f)
    return sorted(best.values(), key=lambda f: f.cost)


@dataclass(frozen=True, eq=False)
class LeftOut:
    """What leaving each recording out of a fit gives: mean squares (cells,) of its prediction, phi (recordings, p)."""

    squares: Array
    phi: Array

    @property
    def cost(self) -> float:
        """Sum over cells of log(1 + ms)."""
        return fitting.cost(self.squares)


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
    return LeftOut(left, np.array(moved))


def share_left(fitted: Fitted, healthy: Fitted, reached: float = 1.0) -> float:
    """Share of the healthy model's gap, rms beyond the noise floor, that a hypothesis leaves; 1 without a gap.

    With `reached` (a mean square) beyond what can be reached at all: the rest is not its form's.
    """
    left, gap = (float(f.mean_squares.mean()) - 1.0 for f in (fitted, healthy))
    if gap <= max(left, 0.0):
        return 1.0
    return float(np.sqrt(max(left - max(reached - 1.0, 0.0), 0.0) / gap))


def deviation_of_magnitude(
    evidence: Evidence,
    fitted: Fitted,
    left: LeftOut,
    healthy: Fitted,
    place: int,
    ceilings: Mapping[str, float] | None = None,
) -> float:
    """Standard deviation of a form's magnitude: recordings, tolerance, and forms that are never quite right.

    Recordings by the jackknife (Efron 1982); what the data cannot tell from the spread by the covariance under its
    prior. For the form `form_error` of the magnitude, chosen after an exam whose intervals without it covered 39 %, and
    `of_what_is_left` times the share of the gap that the form leaves: what arms of one form of the catalogue showed
    when the others were fitted (`experiments/effects`, forms.csv). What a nameless push at the place (`ceilings`, mean
    squares; the best where the place has none) leaves as well is really unmodelled, and counts `of_the_unmodelled`.
    """
    at = sum(len(f.free) for f in fitted.hypothesis.forms[:place])
    scale = fitted.hypothesis.forms[place].scale
    values = scale * left.phi[:, at]
    n = len(values)
    jackknife = (n - 1) / n * float(np.sum((values - values.mean()) ** 2))
    name = fitted.hypothesis.forms[place].effect.partition("@")[2]
    reached = ceilings.get(name, min(ceilings.values())) if ceilings else 1.0
    whole, own = share_left(fitted, healthy), share_left(fitted, healthy, reached)
    unmodelled = TOL.of_the_unmodelled * np.sqrt(max(whole**2 - own**2, 0.0))
    form = np.linalg.norm([TOL.form_error, TOL.of_what_is_left * own, unmodelled]) * scale * float(fitted.phi[at])
    return float(np.sqrt(jackknife + scale**2 * _prior_variance(evidence, fitted, at) + form**2))


def _prior_variance(evidence: Evidence, fitted: Fitted, at: int) -> float:
    """Variance of one number where the spread is uniform in -1..1 and a cell counts for a few observations."""
    free = np.any(fitted.slopes != 0.0, axis=0)
    if not free[at]:
        return 0.0
    squares = fitting.normal(evidence, fitted.slopes[:, free], fitted.residual).squares
    worth = 20.0  # independent observations that a cell is taken for
    information = worth * np.tensordot(fitting.weights(fitted.mean_squares), squares, 1)
    spread = np.flatnonzero(free) >= fitted.hypothesis.n_free
    information[spread, spread] += 3.0
    return float(np.linalg.pinv(information)[np.sum(free[:at]), np.sum(free[:at])])
