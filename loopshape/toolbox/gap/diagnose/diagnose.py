"""Run + Plant to GapReport: the whole diagnosis in order."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import stdtrit

from loopshape.core.units import Array
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose import attribute, decide, shrink, told_apart, windows
from loopshape.toolbox.gap.diagnose.ceiling import Nameless, nameless
from loopshape.toolbox.gap.diagnose.decide import Candidate
from loopshape.toolbox.gap.diagnose.evidence import Evidence, Moves
from loopshape.toolbox.gap.diagnose.hypothesis import candidates
from loopshape.toolbox.gap.nouns.effect import Fix, fix_of
from loopshape.toolbox.gap.nouns.gap_report import (
    BudgetPart,
    BudgetStep,
    Curve,
    Floor,
    FloorSource,
    GapReport,
    Ranked,
    Shrink,
    Trace,
    Where,
    percent,
)
from loopshape.toolbox.gap.nouns.plant import SimulationModel, Statable
from loopshape.toolbox.gap.recordings import locate
from loopshape.toolbox.gap.recordings.next_experiment import propose
from loopshape.toolbox.gap.recordings.next_recording import repeat
from loopshape.toolbox.gap.recordings.replay import tables as _tables
from loopshape.toolbox.gap.recordings.software import software_check
from loopshape.toolbox.gap.recordings.suitable import comparable, suitable
from loopshape.toolbox.gap.tolerances import TOL

PERIODIC_S = 10.0  # of a recording that repeats itself so much tells all
BRIEF_S = 12.0  # of every recording, for a first look at all forms
PAIR_BASES, PAIRS_REFINED = 3, 3


@dataclass(frozen=True, eq=False)
class Attribution:
    """Every hypothesis that was scored, and the probabilities of names, most probable first."""

    evidence: Evidence
    none: Candidate
    scored: dict[str, Candidate]
    energies: dict[str, float]
    probabilities: dict[str, float]
    nameless: Nameless | None = None
    budget: tuple[BudgetStep, ...] = ()
    ceilings: Mapping[str, Array] = field(default_factory=dict)

    @property
    def scale(self) -> told_apart.Scale:
        """What even the best explanation leaves."""
        cells, left = self.evidence.cells, [c.left.squares for c in self.scored.values()]
        if self.nameless is not None:
            left.append(self.nameless.best.squares)
        return told_apart.Scale(self.evidence, 1.0 + decide.discrepancy([c.channel for c in cells], left))

    @property
    def verdict(self) -> str:
        """The most probable name."""
        return next(iter(self.probabilities))

    @property
    def nearest(self) -> str:
        """Where something unknown would act: the place of the budget's ceiling."""
        return next((step.effects[0] for step in self.budget if step.step is BudgetPart.CEILING), "unknown")

    @property
    def leading(self) -> Candidate:
        """The candidate of the verdict; for unknown, the best effect; for none, the healthy machine."""
        if self.verdict in self.scored:
            return self.scored[self.verdict]
        return next(self.scored[n] for n in self.probabilities if n in self.scored and n != "none")

    @property
    def rival(self) -> Candidate | None:
        """The most probable other effect or pair."""
        named = [n for n in self.probabilities if n in self.scored and n not in ("none", self.leading.name)]
        return self.scored[named[0]] if named else None


def attribute_effect(
    plant: SimulationModel,
    run: Run,
    names: Sequence[str],
    *,
    threads: int | None,
    say: windows.Log,
    baseline: Run | None = None,
) -> Attribution:
    """Fit every effect in every form to the recordings named, then pairs if one effect is not enough.

    The floor of each output is what the healthy machine leaves of a `baseline`, where there is one.
    """
    plant, run, names = windows.chosen(plant, run, names, threads, say, baseline).readied(run, names)
    evidence = Evidence.of(plant, run, names, PERIODIC_S, threads)
    brief = Evidence.of(plant, run, names, PERIODIC_S, threads, BRIEF_S)
    say("healthy machine")
    first_pass = attribute.healthy(brief)
    healthy = attribute.again(evidence, first_pass, rounds=2)
    none = decide.candidate(evidence, healthy, healthy)
    say("what a nameless force would explain")
    found = nameless(evidence, healthy.hypothesis.moves(healthy.phi), healthy.residual)
    reached = found.reached if found else None
    say("single effects")
    coarse = attribute.screened(brief, candidates(plant), first_pass)
    best = attribute.best_forms(coarse)
    say("best effects")
    # single effects whose slopes are all taken anew
    fine = [attribute.again(evidence, f, rounds=3) for f in _both_forms(attribute.within_reach(best[:4]), coarse)]
    singles = decide.best_by_name([decide.candidate(evidence, f, healthy, reached) for f in fine])
    everything = list(singles.values())
    for base in decide.pair_bases(none, singles, evidence.quiet, PAIR_BASES):
        say(f"pairs with {base.name}")
        everything += _pairs(evidence, brief, base, healthy, reached)
    scored = decide.best_by_name([none, *everything])
    energies = decide.energies(evidence, none, scored, found.best if found else None)
    probabilities = decide.probabilities(energies)
    return _with_budget(Attribution(evidence, none, scored, energies, probabilities, found))


def _with_budget(
    a: Attribution, held_out: Sequence[Array] = (), ceilings: Mapping[str, Array] | None = None
) -> Attribution:
    """Where the gap goes, by mean squares (recordings, paths, windows): of none, the leaders, and a push at each place.

    By recordings that were left out of the fit where none is held out.
    """
    leaders, count = _leaders(a), len(a.evidence.recordings)
    squares = held_out or [c.left.squares.reshape(count, -1, 1) for c in (a.none, *(a.scored[n] for n in leaders))]
    if ceilings is None:
        ceilings = {c.place: c.squares.reshape(count, -1, 1) for c in a.nameless.ceilings} if a.nameless else {}
    after = dict(zip(leaders, squares[1:], strict=True))
    singles, best = [n for n in leaders if "+" not in n], sorted(leaders, key=lambda n: float(after[n].mean()))[:1]
    steps: list[tuple[BudgetPart, tuple[str, ...], Array]] = [(BudgetPart.BEST_NAME, (n,), after[n]) for n in singles]
    steps += [(BudgetPart.BEST_SET, tuple(n.split("+")), after[n]) for n in best]
    if ceilings:
        place = min(ceilings, key=lambda name: float(ceilings[name].mean()))
        steps.append((BudgetPart.CEILING, (place,), ceilings[place]))
    return replace(a, budget=shrink.budget(squares[0], steps), ceilings=ceilings)


def _leaders(a: Attribution) -> list[str]:
    """The most probable pair and the most probable single effect that were fitted."""
    pairs = {n for n, c in a.scored.items() if len(c.fitted.hypothesis.forms) > 1}
    named = [n for n in a.probabilities if n in a.scored and n != "none"]
    return [*[n for n in named if n in pairs][:1], *[n for n in named if n not in pairs][:1]]


def _pairs(
    evidence: Evidence,
    brief: Evidence,
    base: Candidate,
    healthy: attribute.Fitted,
    reached: Mapping[str, float] | None,
) -> list[Candidate]:
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
    return [decide.candidate(evidence, f, healthy, reached) for f in refined]


def _both_forms(best: Sequence[attribute.Fitted], coarse: Sequence[attribute.Fitted]) -> list[attribute.Fitted]:
    """The best form of each effect, and the second best of the first two effects where it is near."""
    out = list(best)
    for leader in best[:2]:
        same = [f for f in coarse if f.hypothesis.name == leader.hypothesis.name and f is not leader]
        out += [f for f in sorted(same, key=lambda f: f.cost)[:1] if f.cost < leader.cost + 6.0]
    return out


def diagnose(
    plant: SimulationModel,
    run: Run,
    name: str,
    *,
    baseline: Run | None = None,
    threads: int | None = None,
    table: bool = True,
    say: windows.Log = lambda step: None,
) -> GapReport:
    """The whole diagnosis of a run. What its recordings cannot tell stands in the report's notes.

    `baseline` is a run of the same machine known to be good: what the model leaves there is the floor. Raises
    BadSignalError where no recording can be followed at all, WrongUseError for a baseline that is not comparable. The
    answer misleads where a gap comes from something outside the catalogue that looks like a member of it: see
    `ambiguity` and `unknown`.
    """
    differences: list[str] = []
    if baseline is not None:
        differences, baseline = comparable(plant, run, baseline)
    notes, usable = suitable(plant, run)
    notes += differences
    stated = plant.stated if isinstance(plant, Statable) else frozenset[str]()
    estimation = [r for r in usable if r.info.role == "estimation"]
    validation = [r for r in usable if r.info.role == "validation"]
    say("software")
    software = software_check(replace(run, recordings=tuple(usable)))
    names = [r.info.name for r in estimation]
    a = attribute_effect(plant, run, names, threads=threads, say=say, baseline=baseline)
    plant = a.evidence.plant  # with the run's own nominal numbers
    say("held-out recordings")
    if validation:
        a = _decided(a, run, validation)
    chosen, rival = a.leading.fitted, a.rival
    many = [f.hypothesis.moves(f.phi) for f in (a.none.fitted, chosen, *([rival.fitted] if rival else []))]
    every = shrink.levels(plant, run, usable, many)
    healed = a.verdict not in ("none", "unknown")
    gap = _held_out(a, every, [r.info.file for r in validation]) if validation else None
    tables = _tables(plant, run, usable, many, say, notes) if table else (None, None)
    say("next experiment")
    other = (rival.name, many[2]) if rival else (a.none.name, many[0])
    first = (a.leading.name, many[1])
    proposal = propose(plant, run, first, other, threads) or repeat(plant, run, usable, first, other)
    ranking = ranked(a)
    place = locate.where(run, a.evidence, a.none, a.probabilities, a.nearest)
    return GapReport(
        run=name,
        plant=plant.name,
        verdict=a.verdict,
        ranking=ranking,
        ambiguity=told_apart.groups(a.scale, a.scored, a.probabilities),
        where=place,
        gap=gap,
        submodels=shrink.submodels(every[0], every[1] if healed else None, every[2] if rival and healed else None),
        software=software,
        table=tables[0],
        table_after=tables[1] if healed else None,
        traces=_traces(plant, run, validation or estimation, many),
        sentence=sentence(name, a, ranking, place, gap),
        budget=a.budget,
        missing=_missing(a, many[1]),
        by_recording=told_apart.by_recording(a.scale, a.scored),
        window_s=getattr(plant, "window_s", None),
        windows_s=getattr(plant, "windows_s", ()),
        floors=_floors(a.evidence, stated),
        moves=many[1] if healed else many[0],
        fix=_fix(a, many[1]),
        notes=notes,
        proposal=proposal,
    )


def _held_out(a: Attribution, every: Sequence[shrink.Levels], files: Sequence[str]) -> shrink.Shrink:
    """The gap of held-out recordings before and with the leading effect, and with its rival."""
    held = [shrink.chosen(level, "validation") for level in every]
    after, of = (held[0], None) if a.verdict == "none" else (held[1], a.leading.name)
    rival = (a.rival.name, held[2]) if a.rival and a.verdict not in ("none", "unknown") else None
    return shrink.summary(held[0], after, of, rival, files)


def _decided(a: Attribution, run: Run, held_out: Sequence[Recording]) -> Attribution:
    """With a budget by recordings that no fit saw, and judged again by them where prices are not calibrated."""
    plant = a.evidence.plant
    prepared = [plant.prepare(r, run, None) for r in held_out]
    ceilings = a.nameless.held_out(prepared, a.none.fitted.hypothesis.moves(a.none.fitted.phi)) if a.nameless else {}
    channels = tuple(dict.fromkeys(c.channel for c in a.evidence.cells)) * len(held_out)
    found: dict[str, Array] = {}
    wanted = ["none", *(_leaders(a) if a.nameless is None else _tracked(a))]
    while new := [n for n in wanted if n not in found]:
        moves = [c.fitted.hypothesis.moves(c.fitted.phi) for c in (a.scored[n] for n in new)]
        found |= dict(zip(new, (level.squares for level in shrink.levels(plant, run, held_out, moves)), strict=True))
        if a.nameless is not None:
            squares, pushed = ({n: x.mean(axis=2).ravel() for n, x in of.items()} for of in (found, ceilings))
            held = decide.HeldOut(squares, pushed, channels)
            energies = decide.energies(a.evidence, a.none, a.scored, a.nameless.best, held)
            a = replace(a, energies=energies, probabilities=decide.probabilities(energies))
        wanted = _leaders(a)
    leading = _leaders(a)
    a = _with_budget(a, [found["none"], *(found[n] for n in leading)], ceilings)
    if plant.calibrated:
        return a
    pairs = {n for n in a.scored if "+" in n}
    sizes = {n: float(np.sqrt(x.mean())) for n, x in found.items()}
    after, ceiling, matters, main = {n: sizes[n] for n in leading}, None, 0.0, None
    if a.nameless is not None:
        ceiling = float(np.sqrt(ceilings[a.nameless.best.place].mean()))
        matters = float(np.sqrt(np.mean([a.nameless.shapes.least(p) ** 2 for p in prepared])))
        main = next((told_apart.main_effect(a.evidence, a.scored[n]) for n in leading if n in pairs), None)
        main = main if main in a.scored else None
    known = bool(a.evidence.least.all())
    found_out = decide.decided(a.probabilities, pairs, sizes["none"], after, ceiling, matters, main, known=known)
    return replace(a, probabilities=found_out)


def _tracked(a: Attribution) -> list[str]:
    """Names that are followed on held-out recordings: the leaders, and others as long as they are probable."""
    leaders = _leaders(a)
    searched, rare = 6, 0.01
    others = [n for n, p in a.probabilities.items() if p >= rare and n in a.scored and n not in ("none", *leaders)]
    return [*leaders, *others[: searched - len(leaders)]]


def _floors(evidence: Evidence, stated: Collection[str]) -> tuple[Floor, ...]:
    """The floor of each output of a machine of the user's own, rms over its recordings; `stated` are those of it."""
    plant, out = evidence.plant, []
    if not isinstance(plant, Statable):
        return ()
    for channel, unit in plant.units.items():
        rms = float(np.sqrt(np.mean([c.floor**2 for c in evidence.cells if c.channel == channel])))
        known = FloorSource.BASELINE if channel in plant.stated else FloorSource.ESTIMATED
        out.append(Floor(channel, rms, unit, FloorSource.STATED if channel in stated else known))
    return tuple(out)


def _missing(a: Attribution, moves: Moves) -> tuple[Curve, ...]:
    """Curves of what would close the gap at each place, the one that explains most first."""
    if a.nameless is None:
        return ()
    before = next(step.gap for step in a.budget if step.step is BudgetPart.BEFORE)
    shares = {name: _share(before, float(np.sqrt(x.mean()))) for name, x in a.ceilings.items()}
    order = sorted(a.ceilings, key=lambda name: float(a.ceilings[name].mean()))
    return tuple(curve for name in order for curve in a.nameless.curves(name, moves, shares[name]))


def _fix(a: Attribution, moves: Moves) -> Fix | None:
    """The change of the model that the verdict stands for, of unknown that of the nearest name; None for none."""
    forms = () if a.verdict == "none" else a.leading.fitted.hypothesis.forms
    nominal = {row.name: (row.value, row.unit) for row in a.evidence.plant.parameters.rows}
    return fix_of(forms, moves, nominal, a.verdict == a.leading.name) if forms else None


def _share(before: float, after: float) -> float | None:
    return None if before < TOL.smallest_gap else (before - after) / (before - 1.0)


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
        width = float(stdtrit(n - 1, 0.975)) if n > 1 else float("nan")
        parts = {
            f.effect: (m, (m - width * d, m + width * d) if n > 1 else None, f.unit)
            for f, m, d in zip(forms, found.fitted.magnitudes, found.deviations, strict=True)
        }
        quantities = {f.effect: f.quantity for f in forms if f.quantity}
        if len(forms) == 1:
            m, interval, unit = parts[name]
            out.append(Ranked(name, probability, m, interval, unit, forms[0].form, quantities=quantities))
        else:
            form = found.fitted.hypothesis.form
            out.append(Ranked(name, probability, form=form, parts=parts, quantities=quantities))
    return out


def sentence(name: str, a: Attribution, ranking: Sequence[Ranked], place: Where, gap: Shrink | None) -> str:
    """The diagnosis in one sentence."""
    first = ranking[0]
    if a.verdict == "none":
        left = "what a good model leaves" if a.evidence.least.any() else "noise"
        return f"{name}: no gap beyond {left} and manufacturing tolerance (probability {percent(first.probability)})."
    if a.verdict == "unknown":
        near = a.leading.name.replace("_", " ")
        steps = {step.step: step for step in a.budget}
        if (ceiling := steps.get(BudgetPart.CEILING)) is not None:
            nearest = steps[BudgetPart.BEST_NAME].share or 0.0
            return (
                f"{name}: a gap that no known effect explains (probability {percent(first.probability)}): a force or"
                f" signal at {ceiling.effects[0]} would take {ceiling.share or 0.0:.0%} of it away, the nearest effect,"
                f" {near}, {nearest:.0%}; plainest in {place.channel} at"
                f" {place.band_hz[0]:.2g}-{place.band_hz[1]:.2g} Hz."
            )
        return (
            f"{name}: a gap that no known effect explains (probability {percent(first.probability)}), plainest in "
            f"{place.channel} at {place.band_hz[0]:.2g}-{place.band_hz[1]:.2g} Hz; the nearest is {near}."
        )
    comma = {name: "," if name in first.quantities else "" for name in first.sizes}
    what = " with ".join(f"{name.replace('_', ' ')}{comma[name]} {size}" for name, (size, _) in first.sizes.items())
    text = f"{name}: {what} (probability {percent(first.probability)}) in {place.block}"
    if gap is None or gap.shrink is None:
        return f"{text}; no held-out gap to shrink."
    floor = "what a good model leaves" if a.evidence.least.all() else "the noise floor"
    return (
        f"{text}; with it the held-out gap shrinks from {gap.before:.1f} to {gap.after:.1f} times {floor},"
        f" by {gap.shrink:.0%} of what exceeds it."
    )


def _traces(plant: SimulationModel, run: Run, recordings: Sequence[Recording], many: Sequence[Moves]) -> list[Trace]:
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
