"""The arms of an exam: drawn without telling their order, and made by the examiner or by the library's own model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import examiner
import numpy as np
from examiner import EFFECTS, OUTSIDE, draw_case, draw_magnitude, seal

from loopshape.core.errors import WrongUseError
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.toolbox.rig.registry import diagnosable

PLANT = "arm-1dof"
LEAD_S = 4.0  # a replayed arm stands so long at its first references
TRIES = 20  # other spread and signals for an arm that leaves its range


class Case(NamedTuple):
    """One arm to be made: `variant` is the form that makes its effects, of the examiner or of the library."""

    name: str
    kind: str
    labels: Mapping[str, float]
    variant: int
    run_seed: int
    nonce: str
    library: bool = False

    @property
    def seal(self) -> str:
        """Hash of labels and nonce; the nonce holds kind, variant and seed too."""
        return seal(self.labels, f"{self.kind}/{self.variant}/{self.run_seed}/{self.nonce}")


def case_list(plan: Mapping[str, int], seed: int, library: bool) -> list[Case]:
    """All cases in an order that tells nothing, the same for the same plan and seed."""
    rng = np.random.default_rng([seed, int(library)])
    forms = catalogue() if library else {}
    drawn: list[tuple[str, dict[str, float], int]] = []
    for name, variant in rounds(forms, plan["single"], rng):
        form = forms[name][variant] if library else None
        drawn.append(("single", {name: magnitude_in(form, rng) if form else draw_magnitude(name, rng)}, variant))
    drawn += [("healthy", {}, 0)] * plan["healthy"]
    outside = rounds({name: (None,) for name in OUTSIDE}, plan.get("unknown", 0), rng)
    drawn += [("unknown", {name: draw_magnitude(name, rng)}, variant) for name, variant in outside]
    drawn += [("pair", draw_case("pair", rng), k % 2) for k in range(plan.get("pair", 0))]
    order = [drawn[k] for k in rng.permutation(len(drawn))]
    return [
        Case(f"case-{k:03d}", kind, labels, variant, int(rng.integers(2**31)), rng.bytes(16).hex(), library)
        for k, (kind, labels, variant) in enumerate(order, start=1)
    ]


def rounds(forms: Mapping[str, Sequence[Any]], count: int, rng: np.random.Generator) -> list[tuple[str, int]]:
    """Names with forms, round after round in one shuffled order; each round takes a name's next form."""
    many = {name: len(of) for name, of in forms.items()} or dict.fromkeys(EFFECTS, 2)
    order = [str(name) for name in rng.permutation(sorted(many))]
    first = rng.permutation(len(order))
    return [
        (order[at], int(first[at] + lap) % many[order[at]]) for lap, at in (divmod(k, len(order)) for k in range(count))
    ]


def made(case: Case) -> Run:
    """The run of a case; an arm that leaves its range is drawn again, with the same effects."""
    for k in range(TRIES):
        try:
            if case.library:
                return library_run(case.labels, case.variant, case.run_seed + k)
            return examiner.make_run(case.labels, case.run_seed + k, variant=case.variant)
        except WrongUseError as error:
            last = error
    raise last


def catalogue() -> dict[str, list[EffectForm]]:
    """The library's forms by effect, where the form's own number carries the magnitude."""
    out: dict[str, list[EffectForm]] = {}
    for form in diagnosable(PLANT).effects:
        if form.usual[0] > 0.0:
            out.setdefault(form.effect, []).append(form)
    return out


def magnitude_in(form: EffectForm, rng: np.random.Generator) -> float:
    """A magnitude in a form's usual range, uniform in its logarithm, of either sign where both may be."""
    size = float(f"{np.exp(rng.uniform(*np.log(form.usual))):.4g}")
    return -size if form.free[0].low < 0.0 and rng.random() < 0.5 else size


def library_run(labels: Mapping[str, float], variant: int, seed: int) -> Run:
    """A session's signals on the library's own arm with its own form of the effects, tolerances and new noise."""
    plant, session, rng = diagnosable(PLANT), examiner.make_run({}, seed), np.random.default_rng([seed, 1])
    forms = [(catalogue()[name][variant], m) for name, m in labels.items()]
    phi = [x for f, m in forms for x in (m / f.scale, *(free.starts[0] for free in f.free[1:]))]
    phi += rng.uniform(-1.0, 1.0, len(plant.spread)).tolist()
    moves = Hypothesis(plant, tuple(f for f, _ in forms)).moves(np.array(phi))
    moves |= {"range_angle_deg": 60.0, "range_low_bar": 0.05, "range_high_bar": 1.5}  # as wide as the generator's own
    lead = round(LEAD_S * session.rate_hz)
    again = [_again(session, r, lead, int(rng.integers(2**31))) for r in session.recordings]
    done = plant.simulate(again, changes=moves, threads=1)
    for d in done:
        if d.info.ended_early:
            raise WrongUseError("the arm left its range", d.info.ended_early, "ask for a smaller effect")
    cut = [
        Recording(
            r.info,
            r.rate_hz,
            {k: v[-r.columns["t_s"].size :] for k, v in d.columns.items()} | {"t_s": r.columns["t_s"]},
        )
        for d, r in zip(done, session.recordings, strict=True)
    ]
    return replace(session, recordings=tuple(cut))


def _again(session: Run, r: Recording, lead: int, seed: int) -> Experiment:
    """A session's recording to be done again, after a lead at its first references where the loops are closed."""
    driven = [str(loop.injected if r.info.closed_loop else loop.control) for loop in session.loops]
    references = np.stack([r.column(str(loop.reference)) for loop in session.loops], axis=1)
    before = ((lead if r.info.closed_loop else 0, 0), (0, 0))
    return Experiment(
        r.info.name, r.info.kind, session.loops, r.rate_hz, np.pad(references, before, mode="edge"),
        np.pad(np.stack([r.column(name) for name in driven], axis=1), before), r.info.injection,
        r.info.operating_point, r.info.excites, r.info.role, r.info.closed_loop, seed=seed, pwm=session.pwm,
    )  # fmt: skip
