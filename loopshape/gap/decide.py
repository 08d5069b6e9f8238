"""From what each hypothesis leaves to probabilities: none, every effect, pairs, and unknown.

A hypothesis' energy is what it leaves when each recording is predicted from the others, over a temperature (all
forms are wrong, so differences of fit count less than noise alone would say), plus what it costs to bring in one
or two effects, plus how unusual its magnitude is. `unknown` is a form-free explanation that would leave a share of
the healthy model's gap. Temperature, costs and share were fitted on development arms (`experiments/exam`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.effect import EffectForm
from loopshape.gap.attribute import LeftOut, left_out, spread_of_magnitude
from loopshape.gap.evidence import Evidence
from loopshape.gap.fitting import Fitted
from loopshape.gap.hypothesis import Hypothesis

SHARPNESS = 0.4  # one over the temperature
ONE_EFFECT, TWO_EFFECTS = 1.0, 3.5
PER_NUMBER = 0.3  # beyond the first of each effect
EXTENDS, SECOND = 7.0, 3.0  # over the number of recordings: what repeats in none of them is not believed
UNKNOWN, UNKNOWN_LEAVES = 2.5, 0.3
_UNUSUAL, _SLACK = 6.0, 0.15


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted hypothesis with its score: cost left out, standard deviations of its magnitudes, its energy."""

    fitted: Fitted
    left: LeftOut
    deviations: tuple[float, ...]
    energy: float

    @property
    def name(self) -> str:
        """Effects joined by +, or none."""
        return self.fitted.hypothesis.name


def unusual(form: EffectForm, magnitude: float) -> float:
    """Energy of a magnitude outside the usual range: square of the logarithm by how much, beyond a slack."""
    low, high = form.usual
    size = max(abs(magnitude), 1e-12)
    off = max(np.log(max(low, 1e-12) / size), np.log(size / high), 0.0)
    return float(_UNUSUAL * max(off - _SLACK, 0.0) ** 2)


def candidate(evidence: Evidence, fitted: Fitted) -> Candidate:
    """A fitted hypothesis with its energy."""
    left = left_out(evidence, fitted)
    forms = fitted.hypothesis.forms
    deviations = tuple(spread_of_magnitude(fitted, left, k) for k in range(len(forms)))
    cost = (0.0, ONE_EFFECT, TWO_EFFECTS + SECOND / evidence.independent)[len(forms)]
    cost += PER_NUMBER * (fitted.hypothesis.n_free - len(forms))
    cost += sum(EXTENDS / evidence.independent for f in forms if f.extends)
    odd = sum(unusual(f, m) for f, m in zip(forms, fitted.magnitudes, strict=True))
    return Candidate(fitted, left, deviations, SHARPNESS * (left.cost - evidence.quiet) + cost + odd)


def unknown_energy(evidence: Evidence, none: Candidate) -> float:
    """Energy of an explanation that the catalogue does not hold: it would leave UNKNOWN_LEAVES of the gap's rms."""
    excess = np.maximum(none.fitted.mean_squares - 1.0, 0.0)
    left = float(np.sum(np.log1p(1.0 + UNKNOWN_LEAVES**2 * excess))) - evidence.quiet
    return UNKNOWN + SHARPNESS * left


def best_by_name(candidates: Sequence[Candidate]) -> dict[str, Candidate]:
    """The candidate of least energy for each name, best first."""
    best: dict[str, Candidate] = {}
    for c in sorted(candidates, key=lambda c: c.energy):
        best.setdefault(c.name, c)
    return best


def probabilities(energies: Mapping[str, float]) -> dict[str, float]:
    """Boltzmann's weights, most probable first."""
    names = sorted(energies, key=lambda n: energies[n])
    values = np.array([energies[n] for n in names])
    weights = np.exp(-(values - values.min()))
    return dict(zip(names, (weights / weights.sum()).tolist(), strict=True))


def pair_bases(none: Candidate, singles: Mapping[str, Candidate], quiet: float, most: int) -> list[Candidate]:
    """Single effects on which a second may build: the best few, if the best helps and leaves a gap worth it."""
    found = [c for name, c in singles.items() if name != "none"]
    if not found:
        return []
    best = min(c.fitted.cost for c in found)
    gain, whole = none.fitted.cost - best, none.fitted.cost - quiet
    if best - quiet < _PAIR_WORTH or gain < _PAIR_GAIN * whole:
        return []
    return [c for c in found if none.fitted.cost - c.fitted.cost >= 0.5 * gain][:most]


_PAIR_WORTH, _PAIR_GAIN = 5.0, 0.1


def pairs_on(base: Candidate, catalogue: Sequence[EffectForm]) -> list[Hypothesis]:
    """The base with every other effect, in each effect's first two forms."""
    seen: dict[str, int] = {}
    out = []
    forms = base.fitted.hypothesis.forms
    for f in catalogue:
        seen[f.effect] = seen.get(f.effect, 0) + 1
        if seen[f.effect] <= 2 and f.effect not in {g.effect for g in forms} and not _clash(forms, f):
            out.append(Hypothesis(base.fitted.hypothesis.plant, (*forms, f)))
    return out


def _clash(forms: Sequence[EffectForm], other: EffectForm) -> bool:
    """Whether two forms move one parameter: then they cannot be told apart."""
    mine = {name for f in forms for name in f.moves([0.0] * len(f.free))}
    return bool(mine & set(other.moves([0.0] * len(other.free))))
