"""Which effect: every form of every effect fitted, first coarsely, then the best of them with all their slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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


def screened(
    evidence: Evidence, hypotheses: Sequence[Hypothesis], base: Fitted, rounds: int = 2, brief: bool = False
) -> list[Fitted]:
    """Each hypothesis that may matter, fitted from its best start with the slopes of the spread taken from `base`.

    What a start, scaled at best, leaves is a first guess; the best of them are fitted. `brief` tries one start each.
    """
    guesses = sorted(started(evidence, hypotheses, base, brief), key=lambda f: f.cost)
    chosen = worth_fitting(guesses, base)
    evidence.residuals([f.hypothesis.moves(f.phi) for f in chosen])  # in parallel, and remembered
    true = [fitting.at(evidence, f.hypothesis, f.phi, f.slopes) for f in chosen]
    return [fitting.improve(evidence, f, rounds, all_slopes=False) for f in true]


def worth_fitting(guesses: Sequence[Fitted], base: Fitted) -> list[Fitted]:
    """The guesses, best first, that gain a quarter of what the best gains, and at least a few."""
    gains = [base.cost - g.cost for g in guesses]
    enough = sum(gain > 0.25 * gains[0] for gain in gains)
    return list(guesses[: min(max(enough, 8), 20)])


def started(evidence: Evidence, hypotheses: Sequence[Hypothesis], base: Fitted, brief: bool = False) -> list[Fitted]:
    """Each hypothesis at its best start, the magnitude scaled and the spread answering, both by straight lines."""
    n_spread = len(evidence.plant.spread)
    every = [(h, h.starts(base.phi)[: 1 if brief else None]) for h in hypotheses]
    residuals = iter(evidence.residuals([h.moves(phi) for h, starts in every for phi in starts]))
    out = []
    for hypothesis, starts in every:
        tried = []
        for phi in starts:
            residual = np.nan_to_num(next(residuals), nan=1e9, posinf=1e9, neginf=-1e9)
            slopes = np.zeros((residual.size, phi.size))
            slopes[:, : base.hypothesis.n_free] = base.slopes[:, : base.hypothesis.n_free]
            slopes[:, phi.size - n_spread :] = base.slopes[:, base.phi.size - n_spread :]
            fitted = Fitted(hypothesis, phi, residual, evidence.mean_squares(residual), slopes)
            tried += [_answered(evidence, fitted, n_spread), _scaled(evidence, fitted, base)]
        out.append(min(tried, key=lambda f: f.cost))
    return out


def _scaled(evidence: Evidence, fitted: Fitted, base: Fitted) -> Fitted:
    """The newest magnitude scaled as if its effect went in proportion, and the spread moved, once."""
    hypothesis = fitted.hypothesis
    place = sum(len(f.free) for f in hypothesis.forms[:-1])
    start = fitted.phi[place]
    if start == 0.0 or not np.all(np.isfinite(fitted.residual)):
        return fitted
    slopes = fitted.slopes.copy()
    slopes[:, place] = (fitted.residual - base.residual) / start
    free = np.zeros(fitted.phi.size, dtype=bool)
    free[[place, *range(hypothesis.n_free, fitted.phi.size)]] = True
    line = replace(fitted, slopes=slopes)
    step = fitting.box_step(line, fitting.weights(evidence, np.minimum(fitted.mean_squares, base.mean_squares)), free)
    moved = fitted.residual + slopes @ step
    return replace(fitted, phi=fitted.phi + step, residual=moved, mean_squares=evidence.mean_squares(moved))


def _answered(evidence: Evidence, fitted: Fitted, n_spread: int) -> Fitted:
    """The spread moved once, its effect taken from the slopes."""
    residual = np.nan_to_num(fitted.residual, nan=1e9, posinf=1e9, neginf=-1e9)
    fitted = replace(fitted, residual=residual, mean_squares=evidence.mean_squares(residual))
    free = np.zeros(fitted.phi.size, dtype=bool)
    free[fitted.phi.size - n_spread :] = True
    step = fitting.box_step(fitted, fitting.weights(evidence, fitted.mean_squares), free)
    moved = residual + fitted.slopes @ step
    return replace(fitted, phi=fitted.phi + step, residual=moved, mean_squares=evidence.mean_squares(moved))


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
    w = fitting.weights(evidence, fitted.mean_squares)
    free = np.any(fitted.slopes != 0.0, axis=0)
    left = np.array(fitted.mean_squares)
    moved = []
    for name in evidence.recordings:
        mask = np.ones(w.size)
        own = [k for k, c in enumerate(evidence.cells) if c.recording == name]
        for k in own:
            mask[evidence.cells[k].part] = 0.0
        step = fitting.box_step(fitted, w * mask, free) if mask.any() else np.zeros(free.size)
        for k in own:
            cell = evidence.cells[k]
            predicted = fitted.residual[cell.part] + fitted.slopes[cell.part] @ step
            left[k] = np.mean((predicted / cell.floor) ** 2)
        moved.append(fitted.phi + step)
    return LeftOut(fitting.cost(left), np.array(moved))


def deviation_of_magnitude(evidence: Evidence, fitted: Fitted, left: LeftOut, place: int) -> float:
    """Standard deviation of a form's magnitude: recordings, tolerance, and forms that are never quite right.

    Recordings by the jackknife (Efron 1982); what the data cannot tell from the spread by the covariance under its
    prior; for the form FORM_ERROR of the magnitude, chosen after an exam whose intervals without it covered 39 %.
    """
    at = sum(len(f.free) for f in fitted.hypothesis.forms[:place])
    scale = fitted.hypothesis.forms[place].scale
    values = scale * left.phi[:, at]
    n = len(values)
    jackknife = (n - 1) / n * float(np.sum((values - values.mean()) ** 2))
    form = FORM_ERROR * scale * float(fitted.phi[at])
    return float(np.sqrt(jackknife + scale**2 * _prior_variance(evidence, fitted, at) + form**2))


FORM_ERROR = 0.04
_WORTH = 20.0  # independent observations that a cell is taken for


def _prior_variance(evidence: Evidence, fitted: Fitted, at: int) -> float:
    """Variance of one number where the spread is uniform in -1..1 and a cell counts for a few observations."""
    free = np.any(fitted.slopes != 0.0, axis=0)
    if not free[at]:
        return 0.0
    w = fitting.weights(evidence, fitted.mean_squares)
    slopes = fitted.slopes[:, free]
    information = _WORTH * (slopes.T @ (slopes * w[:, None]))
    spread = np.flatnonzero(free) >= fitted.hypothesis.n_free
    information[spread, spread] += 3.0
    return float(np.linalg.pinv(information)[np.sum(free[:at]), np.sum(free[:at])])
