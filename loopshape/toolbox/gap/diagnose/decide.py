"""From what each hypothesis leaves to probabilities: none, every effect, pairs, and unknown.

A hypothesis' energy is what it leaves when each recording is predicted from the others, over a temperature (all
forms are wrong, so differences of fit count less than noise alone would say), plus what it costs to bring in one
or two effects, plus how unusual its magnitude is. `unknown` is a form-free explanation that would leave a share of
the healthy model's gap. Temperature, costs and share were chosen by hand, guided by a grid over development arms and by
the answers of the first sealed exam (`experiments/exam`). An effect that contains another is that one and a second
beside it, so it costs what two effects cost.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.gap.diagnose import fitting
from loopshape.toolbox.gap.diagnose.attribute import LeftOut, deviation_of_magnitude, left_out
from loopshape.toolbox.gap.diagnose.ceiling import Ceiling
from loopshape.toolbox.gap.diagnose.evidence import Evidence, least
from loopshape.toolbox.gap.diagnose.fitting import Fitted
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.toolbox.gap.nouns.plant import SimulationModel
from loopshape.toolbox.gap.tolerances import TOL


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted hypothesis with its score.

    `excess` is what it leaves over noise when recordings are left out, `price` what its effects and magnitudes
    cost, `deviations` are standard deviations of the magnitudes.
    """

    fitted: Fitted
    left: LeftOut
    deviations: tuple[float, ...]
    excess: float
    price: float

    @property
    def energy(self) -> float:
        """At the highest temperature, to choose among forms."""
        return TOL.sharpness * self.excess + self.price

    @property
    def name(self) -> str:
        """Effects joined by +, or none."""
        return self.fitted.hypothesis.name


def unusual(form: EffectForm, magnitude: float) -> float:
    """Energy of a magnitude outside the usual range: square of the logarithm by how much, beyond a slack."""
    low, high = form.usual
    size = max(abs(magnitude), 1e-12)
    off = max(np.log(max(low, 1e-12) / size), np.log(size / high), 0.0)
    return float(TOL.unusual * max(off - TOL.unusual_slack, 0.0) ** 2)


def candidate(
    evidence: Evidence, fitted: Fitted, healthy: Fitted, ceilings: Mapping[str, float] | None = None
) -> Candidate:
    """A fitted hypothesis with its energy; `healthy` is the fit without an effect.

    `ceilings` are mean squares that a nameless push leaves, by place.
    """
    left = left_out(evidence, fitted)
    forms = fitted.hypothesis.forms
    deviations = tuple(deviation_of_magnitude(evidence, fitted, left, healthy, k, ceilings) for k in range(len(forms)))
    cost = (0.0, TOL.one_effect, TOL.two_effects)[len(forms)]
    cost += 0.3 * (fitted.hypothesis.n_free - len(forms))  # beyond the first of each effect
    cost += sum(TOL.two_effects - TOL.one_effect for f in forms if f.extends)
    odd = sum(unusual(f, m) for f, m in zip(forms, fitted.magnitudes, strict=True))
    excess = fitting.cost(np.maximum(left.squares, evidence.least)) - evidence.quiet
    return Candidate(fitted, left, deviations, excess, cost + odd)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What explanations leave of recordings that no fit saw: mean squares (cells,) by name, none among them, and of a
    nameless push at each place; `channels` as of the cells."""

    squares: Mapping[str, Array]
    nameless: Mapping[str, Array]
    channels: tuple[str, ...]


def energies(
    evidence: Evidence,
    none: Candidate,
    scored: Mapping[str, Candidate],
    ceiling: Ceiling | None = None,
    held: HeldOut | None = None,
) -> dict[str, float]:
    """Energy of every name scored, of every other effect of the catalogue, and of `unknown`.

    Where the best explains all but noise its form is right, and differences count for more. With a ceiling `unknown`
    is what it leaves, but no less than `unknown_leaves` of the gap (it has to explain clearly more than a name), and
    everything is told in units of what even the best explanation leaves: a real machine never comes down to its noise.
    Recordings that no fit saw count as those that were left out; a name that was not followed there leaves what none
    does. Of a channel whose floor is known, what the best explanation leaves beyond it is no discrepancy: a good model
    leaves less.
    """
    channels = [c.channel for c in evidence.cells] + list(held.channels if held else ())
    floor = least(evidence.plant, channels)

    def every(left: Array, name: str) -> Array:
        whole = left if held is None else np.concatenate([left, held.squares.get(name, held.squares["none"])])
        return np.maximum(whole, floor)

    squares = {name: every(c.left.squares, name) for name, c in scored.items()}
    idle = every(none.left.squares, "none")
    quiet, scale, nameless = float(np.sum(np.log1p(np.maximum(floor, 1.0)))), np.ones(len(idle)), idle
    if ceiling is not None:
        nameless = ceiling.squares if held is None else np.concatenate([ceiling.squares, held.nameless[ceiling.place]])
        nameless = np.maximum(nameless, np.minimum(1.0, idle) + TOL.unknown_leaves**2 * np.maximum(idle - 1.0, 0.0))
        nameless = np.maximum(nameless, floor)
        scale += np.where(floor > 0.0, 0.0, discrepancy(channels, [*squares.values(), nameless]))

    def excess(values: Array) -> float:
        return float(np.sum(np.log1p(values / scale))) - quiet

    left = {name: excess(values) for name, values in squares.items()}
    healthy = excess(idle)
    best = max(min(left.values()), 0.0)
    sharpness = TOL.sharpness + TOL.sharper * float(np.exp(-best / TOL.explained))
    out = {name: sharpness * left[name] + c.price for name, c in scored.items()}
    healthy_excess = 2.5  # healthy development arms left 1.2 at most; beyond it `none` is not believed
    out["none"] = sharpness * healthy + max(healthy - healthy_excess, 0.0) - healthy_prior(evidence.plant)
    out["unknown"] = TOL.unknown + sharpness * (unknown_excess(evidence, none) if ceiling is None else excess(nameless))
    for form in evidence.plant.effects:  # what was not worth fitting explains no more than nothing does
        out.setdefault(form.effect, sharpness * healthy + TOL.one_effect + TOL.not_fitted)
    return out


def discrepancy(of: Sequence[str], explanations: Sequence[Array]) -> Array:
    """Mean square over the noise floor that the best explanation leaves beyond noise, (cells,), one size a channel.

    `of` are the cells' channels, `explanations` mean squares (cells,) of recordings left out. The median over a
    channel's recordings: a few that one explanation leaves are its own (Kennedy and O'Hagan 2001 for the frame).
    """
    best = min(explanations, key=lambda squares: float(np.sum(np.log1p(squares))))
    channels = np.array(of)
    out = np.zeros(len(channels))
    for name in dict.fromkeys(channels.tolist()):
        mine = channels == name
        out[mine] = max(float(np.median(best[mine])) - 1.0, 0.0)
    return out


def healthy_prior(plant: SimulationModel) -> float:
    """Energy of `none` below 0: it has the prior of all effects together, however many a machine has.

    With a fixed price each, a catalogue twice as large would make a healthy machine half as probable (multiplicity:
    Scott and Berger, Annals of Statistics 38, 2010). Where prices are calibrated they contain it.
    """
    names = {f.effect for f in plant.effects}
    return 0.0 if plant.calibrated else max(float(np.log(len(names))) - TOL.one_effect, 0.0)


def unknown_excess(evidence: Evidence, none: Candidate) -> float:
    """What an explanation that the catalogue does not hold would leave: `unknown_leaves` of the gap's rms."""
    excess = np.maximum(none.fitted.mean_squares - 1.0, 0.0)
    return float(np.sum(np.log1p(1.0 + TOL.unknown_leaves**2 * excess))) - evidence.quiet


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


def decided(
    probabilities: Mapping[str, float],
    pairs: Collection[str],
    before: float,
    after: Mapping[str, float],
    ceiling: float | None = None,
    matters: float = 0.0,
    main: str | None = None,
    *,
    known: bool = False,
) -> dict[str, float]:
    """Probabilities once recordings that no fit saw were followed: `before` floors without an effect, `after` by name.

    All is told in units of the least that is left, by a name or by a nameless push (`ceiling`, None where none is
    known), but no less than the noise; in floors where all of these are `known` to be what a good model leaves. A name
    that takes less than `least_share` of the gap away explains nothing; where no name and no push moves the outputs by
    `matters` floors, or none is left beyond `smallest_gap` known floors, there is no gap that matters.

    A form that does not quite fit may leave up to `unknown_leaves` of the gap. A second effect would take up what the
    first one's form leaves, so a pair has to leave what noise explains, or on a machine that never comes down to it
    `unknown_leaves` of the gap less than the single effect, and its second effect has to matter. Where it does not,
    single effects and `unknown` are judged without pairs, and its probability goes to `main`, the effect of the leading
    pair that moves the machine most: the other takes up what is really unmodelled. Where the leading explanation is
    refuted, `unknown` has most.

    What a form gets wrong repeats in every recording, so that recordings do not add up as evidence against its kind:
    `unknown` and a pair stand at most as far above the best single effects as a wrong form of those is rare.
    """
    out = dict(probabilities)
    singles = [n for n in out if n not in pairs and n not in ("none", "unknown")]
    together = TOL.smallest_gap
    if ceiling is not None:
        least = 1.0 if known else max(1.0, min([ceiling, *after.values()]))
        gap = before - 1.0
        idle = {n for n, left in after.items() if before - left < TOL.least_share * gap}
        if (leader := next(iter(out))) in idle:
            out = _reduced(out, [n for n in out if n not in ("none", "unknown")])
        if before < max(np.hypot(matters, 1.0), TOL.smallest_gap if known else 0.0):
            return _reduced(out, [n for n in out if n != "none"], to="none")
        alone = min((left for n, left in after.items() if n not in pairs), default=before)
        together = max(TOL.smallest_gap, alone - TOL.unknown_leaves * gap)
        together = min(together, float(np.sqrt(max(alone**2 - matters**2, 0.0))))
    if (leader := next(iter(out))) in pairs and after[leader] > together:
        out = _reduced(out, [n for n in out if n in pairs], to=main)
        after = {**after, main: after[leader]} if main is not None else after
    if ceiling is not None:
        after, before = {n: left / least for n, left in after.items()}, before / least
    leader = next(iter(out))
    if leader not in pairs and after.get(leader, 0.0) > max(TOL.explained, TOL.unknown_leaves * before):
        out = _reduced(out, [n for n in out if n not in ("none", "unknown")], to="unknown")
    leader = next(iter(out))
    rare = dict.fromkeys(pairs, TOL.wrong_form_pairs) | ({"unknown": TOL.wrong_form_leaves} if ceiling is None else {})
    return _capped(out, leader, singles, rare[leader]) if leader in rare else out


def _capped(probabilities: Mapping[str, float], leader: str, rivals: Sequence[str], odds: float) -> dict[str, float]:
    """The rivals together have at least `odds` times what the leader has, the leader giving; each in proportion."""
    theirs = sum(probabilities[n] for n in rivals)
    both = probabilities[leader] + theirs
    if theirs <= 0.0 or theirs >= odds * probabilities[leader]:
        return dict(probabilities)
    raised = both * odds / (1.0 + odds) / theirs
    out = {n: p * raised if n in rivals else p for n, p in probabilities.items()} | {leader: both / (1.0 + odds)}
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def _reduced(probabilities: Mapping[str, float], refuted: Sequence[str], to: str | None = None) -> dict[str, float]:
    """Names that are refuted keep a tenth; the rest goes to one name, or to all others in proportion."""
    lost = (1.0 - TOL.refuted_keeps) * sum(probabilities[n] for n in refuted)
    heirs = [n for n in probabilities if n not in refuted and to in (None, n)]
    share = lost / max(sum(probabilities[n] for n in heirs), 1e-300)
    factors = {n: TOL.refuted_keeps if n in refuted else 1.0 + share if n in heirs else 1.0 for n in probabilities}
    out = {n: p * factors[n] for n, p in probabilities.items()}
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def pair_bases(none: Candidate, singles: Mapping[str, Candidate], quiet: float, most: int) -> list[Candidate]:
    """Single effects on which a second may build: the best few, if the best helps and leaves a gap worth it."""
    found = [c for name, c in singles.items() if name != "none"]
    if not found:
        return []
    best = min(c.fitted.cost for c in found)
    gain, whole = none.fitted.cost - best, none.fitted.cost - quiet
    pair_worth, pair_gain = 5.0, 0.1
    if best - quiet < pair_worth or gain < pair_gain * whole:
        return []
    return [c for c in found if none.fitted.cost - c.fitted.cost >= 0.5 * gain][:most]


def pairs_on(base: Candidate, catalogue: Sequence[EffectForm]) -> list[Hypothesis]:
    """The base with every other effect, in each effect's first two forms."""
    seen: dict[str, int] = {}
    out = []
    for f in catalogue:
        seen[f.effect] = seen.get(f.effect, 0) + 1
        if seen[f.effect] <= _FIRST_FORMS:
            out += _beside(base, f)
    return out


def other_forms(base: Candidate, catalogue: Sequence[EffectForm], effect: str) -> list[Hypothesis]:
    """The base with an effect in the forms that `pairs_on` did not try."""
    mine = [f for f in catalogue if f.effect == effect]
    return [h for f in mine[_FIRST_FORMS:] for h in _beside(base, f)]


_FIRST_FORMS = 2


def _beside(base: Candidate, form: EffectForm) -> list[Hypothesis]:
    """The base with a form, if its effect is another and the two can be told apart."""
    forms = base.fitted.hypothesis.forms
    if form.effect in {f.effect for f in forms} or _clash(forms, form):
        return []
    return [Hypothesis(base.fitted.hypothesis.plant, (*forms, form))]


def _clash(forms: Sequence[EffectForm], other: EffectForm) -> bool:
    """Whether two forms move one parameter: then they cannot be told apart."""
    mine = {name for f in forms for name in f.moves([0.0] * len(f.free))}
    return bool(mine & set(other.moves([0.0] * len(other.free))))
