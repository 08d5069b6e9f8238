"""Run + Plant to GapReport: the whole diagnosis in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from loopshape.data.gap_report import GapReport, Ranked, Shrink, Trace, Where
from loopshape.data.plant import Followable
from loopshape.data.recording import Recording
from loopshape.data.run import Run
from loopshape.diagnose import attribute, decide, locate, shrink
from loopshape.diagnose.decide import Candidate
from loopshape.diagnose.evidence import Evidence, Moves
from loopshape.diagnose.hypothesis import candidates
from loopshape.diagnose.next_experiment import propose
from loopshape.diagnose.next_recording import repeat
from loopshape.diagnose.replay import tables as _tables
from loopshape.diagnose.software import software_check
from loopshape.diagnose.suitable import suitable

Say = Callable[[str], None]
PERIODIC_S = 10.0  # of a recording that repeats itself so much tells all
BRIEF_S = 12.0  # of every recording, for a first look at all forms
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
        """The candidate of the verdict; for unknown, the best effect; for none, the healthy machine."""
        if self.verdict in self.scored:
            return self.scored[self.verdict]
        return next(c for n, c in self.scored.items() if n != "none")

    @property
    def rival(self) -> Candidate | None:
        """The most probable other effect or pair."""
        named = [n for n in self.probabilities if n in self.scored and n not in ("none", self.leading.name)]
        return self.scored[named[0]] if named else None


def attribute_effect(
    plant: Followable, run: Run, names: Sequence[str], *, threads: int | None, say: Say
) -> Attribution:
    """Fit every effect in every form to the recordings named, then pairs if one effect is not enough."""
    plant, run, names = plant.readied(run, names)
    evidence = Evidence.of(plant, run, names, PERIODIC_S, threads)
    brief = Evidence.of(plant, run, names, PERIODIC_S, threads, BRIEF_S)
    say("healthy machine")
    rough = attribute.healthy(brief)
    healthy = attribute.again(evidence, rough, rounds=2)
    none = decide.candidate(evidence, healthy, healthy)
    say("single effects")
    coarse = attribute.screened(brief, candidates(plant), rough)
    best = attribute.best_forms(coarse)
    say("best effects")
    fine = [attribute.again(evidence, f, rounds=3) for f in _both_forms(attribute.within_reach(best[:REFINED]), coarse)]
    singles = decide.best_by_name([decide.candidate(evidence, f, healthy) for f in fine])
    everything = list(singles.values())
    for base in decide.pair_bases(none, singles, evidence.quiet, PAIR_BASES):
        say(f"pairs with {base.name}")
        everything += _pairs(evidence, brief, base, healthy)
    scored = decide.best_by_name([none, *everything])
    energies = decide.energies(evidence, none, scored)
    return Attribution(evidence, none, scored, energies, decide.probabilities(energies))


def _pairs(evidence: Evidence, brief: Evidence, base: Candidate, healthy: attribute.Fitted) -> list[Candidate]:
    """The best pairs with a base; of the leading second effect all forms."""
    effects = evidence.plant.effects
    ground = attribute.again(brief, base.fitted, rounds=1)
    found = attribute.screened(brief, decide.pairs_on(base, effects), ground, rounds=1, brief=True)
    leading = attribute.best_forms(found)[0].hypothesis.forms[-1].effect
    others = decide.other_forms(base, effects, leading)
    if others:
        found += attribute.screened(brief, others, ground, rounds=1, brief=True)
    refined = [
        attribute.again(evidence, f, rounds=2)
        for f in attribute.within_reach(attribute.best_forms(found)[:PAIRS_REFINED])
    ]
    return [decide.candidate(evidence, f, healthy) for f in refined]


def _both_forms(best: Sequence[attribute.Fitted], coarse: Sequence[attribute.Fitted]) -> list[attribute.Fitted]:
    """The best form of each effect, and the second best of the first two effects where it is near."""
    out = list(best)
    for leader in best[:2]:
        same = [f for f in coarse if f.hypothesis.name == leader.hypothesis.name and f is not leader]
        out += [f for f in sorted(same, key=lambda f: f.cost)[:1] if f.cost < leader.cost + _NEAR]
    return out


_NEAR = 6.0


def diagnose(
    plant: Followable,
    run: Run,
    name: str,
    *,
    threads: int | None = None,
    table: bool = True,
    say: Say = lambda step: None,
) -> GapReport:
    """The whole diagnosis of a run. What its recordings cannot tell stands in the report's notes.

    Raises BadSignalError where no recording can be followed at all. The answer misleads where a gap comes from
    something outside the catalogue that looks like a member of it: see `ambiguity` and `unknown`.
    """
    notes, usable = suitable(plant, run)
    estimation = [r for r in usable if r.info.role == "estimation"]
    validation = [r for r in usable if r.info.role == "validation"]
    say("software")
    software = software_check(replace(run, recordings=tuple(usable)))
    names = [r.info.name for r in estimation]
    a = attribute_effect(plant, run, names, threads=threads, say=say)
    plant = a.evidence.plant  # with the run's own nominal numbers
    say("held-out recordings")
    if validation and not plant.calibrated:
        a = _judged(a, run, validation)
    chosen, rival = a.leading.fitted, a.rival
    many = [f.hypothesis.moves(f.phi) for f in (a.none.fitted, chosen, *([rival.fitted] if rival else []))]
    every = shrink.levels(plant, run, usable, many)
    held = [shrink.chosen(level, "validation") for level in every] if validation else []
    healed = a.verdict not in ("none", "unknown")
    gap = None
    if validation:
        after = held[1] if healed else held[0]
        files = [r.info.file for r in validation]
        gap = shrink.summary(held[0], after, (rival.name, held[2]) if rival and healed else None, files)
    tables = _tables(plant, run, usable, many, say, notes) if table else (None, None)
    say("next experiment")
    other = (rival.name, many[2]) if rival else (a.none.name, many[0])
    first = (a.leading.name, many[1])
    proposal = propose(plant, run, first, other, threads) or repeat(plant, run, usable, first, other)
    ranking = ranked(a)
    place = locate.where(run, a.evidence, a.none, a.probabilities)
    return GapReport(
        run=name,
        plant=plant.name,
        verdict=a.verdict,
        ranking=ranking,
        ambiguity=ambiguity(a.probabilities),
        where=place,
        gap=gap,
        submodels=shrink.submodels(every[0], every[1] if healed else None, every[2] if rival and healed else None),
        software=software,
        table=tables[0],
        table_after=tables[1] if healed else None,
        traces=_traces(plant, run, validation or estimation, many),
        sentence=sentence(name, a, ranking, place, gap),
        moves=many[1] if healed else many[0],
        notes=notes,
        proposal=proposal,
    )


def _judged(a: Attribution, run: Run, held_out: Sequence[Recording]) -> Attribution:
    """Judged again by recordings that no fit saw: the leading pair and the leading single effect."""
    pairs = {n for n, c in a.scored.items() if len(c.fitted.hypothesis.forms) > 1}
    named = [n for n in a.probabilities if n in a.scored and n != "none"]
    leading = [*[n for n in named if n in pairs][:1], *[n for n in named if n not in pairs][:1]]
    many = [a.none, *(a.scored[n] for n in leading)]
    floors = shrink.levels(a.evidence.plant, run, held_out, [c.fitted.hypothesis.moves(c.fitted.phi) for c in many])
    after = {n: left.size for n, left in zip(leading, floors[1:], strict=True)}
    return replace(a, probabilities=decide.judged(a.probabilities, pairs, floors[0].size, after))


def ranked(a: Attribution) -> list[Ranked]:
    """All names with probabilities; magnitudes with 95 % intervals where a fit stands behind."""
    out = []
    for name, probability in a.probabilities.items():
        found = a.scored.get(name)
        forms = found.fitted.hypothesis.forms if found else ()
        if found is None or not forms:
            out.append(Ranked(name, probability))
            continue
        n = len(a.evidence.recordings)
        width = float(student.ppf(0.975, n - 1)) if n > 1 else float("nan")
        parts = {
            f.effect: (m, (m - width * d, m + width * d) if n > 1 else None, f.unit)
            for f, m, d in zip(forms, found.fitted.magnitudes, found.deviations, strict=True)
        }
        if len(forms) == 1:
            m, interval, unit = parts[name]
            out.append(Ranked(name, probability, m, interval, unit, forms[0].form))
        else:
            out.append(Ranked(name, probability, form=found.fitted.hypothesis.form, parts=parts))
    return out


def ambiguity(probabilities: Mapping[str, float]) -> list[str]:
    """The most probable names that together hold nine tenths."""
    out, total = [], 0.0
    for name, p in probabilities.items():
        out.append(name)
        total += p
        if total >= AMBIGUITY:
            break
    return out


AMBIGUITY = 0.9


def sentence(name: str, a: Attribution, ranking: Sequence[Ranked], place: Where, gap: Shrink | None) -> str:
    """The diagnosis in one sentence."""
    first = ranking[0]
    if a.verdict == "none":
        return f"{name}: no gap beyond noise and manufacturing tolerance (probability {first.probability:.0%})."
    if a.verdict == "unknown":
        near = a.leading.name.replace("_", " ")
        return (
            f"{name}: a gap that no known effect explains (probability {first.probability:.0%}), plainest in "
            f"{place.channel} at {place.band_hz[0]:.2g}-{place.band_hz[1]:.2g} Hz; the nearest is {near}."
        )
    sizes = [(first.effect, (first.magnitude, first.interval, first.unit))] if not first.parts else first.parts.items()
    what = " with ".join(f"{effect.replace('_', ' ')} {m:.3g} {_unit(unit)}".strip() for effect, (m, _, unit) in sizes)
    text = f"{name}: {what} (probability {first.probability:.0%}) in {place.block}"
    if gap is None or gap.shrink is None:
        return f"{text}; no held-out gap to shrink."
    return (
        f"{text}; with it the held-out gap shrinks from {gap.before:.1f} to {gap.after:.1f} times the noise floor"
        f" ({gap.shrink:.0%})."
    )


def _unit(unit: str | None) -> str:
    return "" if unit in (None, "1") else str(unit)


def _traces(plant: Followable, run: Run, recordings: Sequence[Recording], many: Sequence[Moves]) -> list[Trace]:
    """For each recording measured, nominal and with the effect."""
    out = []
    for r in recordings:
        prepared = plant.prepare(r, run, None)
        step, measured, nominal = plant.traces(prepared, many[0])
        _, _, healed = plant.traces(prepared, many[1])
        out.append(
            Trace(
                r.info.name,
                plant.trace_channel,
                np.asarray(step * np.arange(len(measured)), dtype=float),
                measured,
                nominal,
                healed,
            )
        )
    return out
