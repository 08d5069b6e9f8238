"""Run + Plant to GapReport: the whole diagnosis in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from loopshape.errors import BadSignalError
from loopshape.gap import attribute, decide
from loopshape.gap.decide import Candidate
from loopshape.gap.evidence import Evidence
from loopshape.gap.hypothesis import candidates
from loopshape.plant import Followable
from loopshape.run import Run

Say = Callable[[str], None]
PERIODIC_S = 10.0  # of a recording that repeats itself so much tells all
REFINED = 4  # single effects whose slopes are all taken anew
PAIR_BASES, PAIRS_REFINED = 3, 3


@dataclass(frozen=True, eq=False)
class Attribution:
    """Every hypothesis that was scored, and the probabilities of names, most probable first."""

    evidence: Evidence
    none: Candidate
    scored: dict[str, Candidate]
    energies: dict[str, float]
    probabilities: dict[str, float]

    @property
    def verdict(self) -> str:
        """The most probable name."""
        return next(iter(self.probabilities))

    @property
    def leading(self) -> Candidate:
        """The candidate of the verdict; for unknown, the best effect; for none, the healthy arm."""
        if self.verdict in self.scored:
            return self.scored[self.verdict]
        return next(c for n, c in self.scored.items() if n != "none")

    @property
    def rival(self) -> Candidate | None:
        """The most probable other effect or pair."""
        named = [n for n in self.probabilities if n in self.scored and n not in ("none", self.leading.name)]
        return self.scored[named[0]] if named else None


def attribute_effect(plant: Followable, run: Run, names: Sequence[str], *, threads: int | None, say: Say) -> Attribution:
    """Fit every effect in every form to the recordings named, then pairs if one effect is not enough."""
    evidence = Evidence.of(plant, run, names, PERIODIC_S, threads)
    if not evidence.cells:
        raise BadSignalError("no recording is long enough to be followed", ", ".join(names), "record more than 2 s")
    say("healthy arm")
    healthy = attribute.healthy(evidence)
    none = decide.candidate(evidence, healthy)
    say("single effects")
    coarse = attribute.screened(evidence, candidates(plant), healthy)
    best = attribute.best_forms(coarse)
    say("best effects")
    fine = attribute.refined(evidence, _both_forms(best[:REFINED], coarse))
    singles = decide.best_by_name([decide.candidate(evidence, f) for f in [*fine, *best[REFINED:]]])
    everything = list(singles.values())
    for base in decide.pair_bases(evidence, none, singles, PAIR_BASES):
        say(f"pairs with {base.name}")
        found = attribute.screened(evidence, decide.pairs_on(base, plant.effects), base.fitted, rounds=1)
        refined = attribute.refined(evidence, attribute.best_forms(found)[:PAIRS_REFINED], rounds=2)
        everything += [decide.candidate(evidence, f) for f in refined]
    scored = decide.best_by_name([none, *everything])
    energies = {name: c.energy for name, c in scored.items()} | {"unknown": decide.unknown_energy(evidence, none)}
    for form in plant.effects:  # what was not worth fitting explains no more than nothing does
        energies.setdefault(form.effect, none.energy + decide.ONE_EFFECT + _NOT_FITTED)
    return Attribution(evidence, none, scored, energies, decide.probabilities(energies))


_NOT_FITTED = 3.0


def _both_forms(best: Sequence[attribute.Fitted], coarse: Sequence[attribute.Fitted]) -> list[attribute.Fitted]:
    """The best form of each effect, and the second best of the first two effects where it is near."""
    out = list(best)
    for leader in best[:2]:
        same = [f for f in coarse if f.hypothesis.name == leader.hypothesis.name and f is not leader]
        out += [f for f in sorted(same, key=lambda f: f.cost)[:1] if f.cost < leader.cost + _NEAR]
    return out


_NEAR = 6.0


