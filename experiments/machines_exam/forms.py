"""What a form that does not quite fit leaves: each form is simulated, and followed by the others of its kind.

python experiments/machines_exam/forms.py     writes forms.csv, goes on where it stopped; no specimen of an exam

The inputs are those of healthy carts and booms, and so is the noise. In every window the machine is simulated with one
form at a size within the range of its starts; the same kind's other forms are then fitted to the recordings for
estimation. The share that the best of them leaves of the gap on the recordings for validation is what the right kind in
a wrong form leaves. Where it leaves less than half, a second effect beside it is fitted too: none is there, so what it
takes up is the wrong form's.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own files, however it is started

from run import described, write  # noqa: E402
from specimens import PLACES, STEPS, specimen  # noqa: E402

from loopshape.data.signal.recording import Recording  # noqa: E402
from loopshape.data.signal.run import Run  # noqa: E402
from loopshape.toolbox.gap.diagnose import attribute, decide  # noqa: E402
from loopshape.toolbox.gap.diagnose.evidence import Evidence  # noqa: E402
from loopshape.toolbox.gap.diagnose.fitting import Fitted  # noqa: E402
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis  # noqa: E402
from loopshape.toolbox.gap.nouns.effect import EffectForm, Free  # noqa: E402
from loopshape.toolbox.gap.own import following  # noqa: E402
from loopshape.toolbox.gap.own.following import Followed  # noqa: E402
from loopshape.toolbox.gap.own.plant import OwnMachine  # noqa: E402

SEEDS = (11, 12)
PLAIN = 5.0  # floors, below which a gap is no measure of a share
HALF = 0.5
HEADER = ("plant", "seed", "effect", "form", "best_other_form", "before", "after", "share", "second", "after_both")


class Simulated(OwnMachine):
    """The machine with recordings put in the place of those that would be prepared."""

    prepared: Mapping[str, Followed]

    def prepare(self, recording: Recording, run: Run, longest_s: float | None) -> Followed:
        """The recording of this name."""
        return self.prepared[recording.info.name]


def main() -> None:
    """Every form of every kind that has several, on each plant and seed."""
    path = HERE / "forms.csv"
    rows = list(csv.reader(path.open()))[1:] if path.exists() else []
    done = {tuple(row[:4]) for row in rows}
    for plant in PLACES:
        for seed in SEEDS:
            s = specimen("healthy", plant, "none", seed)
            ready, _, _ = OwnMachine(described(plant)).readied(s.run, [r.info.name for r in s.run.recordings])
            for form in ready.effects:
                if others(ready.effects, form) and (plant, str(seed), form.effect, form.form) not in done:
                    rows.append([plant, str(seed), form.effect, form.form, *left(ready, s.run, form, seed)])
                    print(*rows[-1], flush=True)
                    write(path, HEADER, rows)


def others(effects: tuple[EffectForm, ...], form: EffectForm) -> tuple[EffectForm, ...]:
    """The same kind's forms that do not contain this one."""
    return tuple(f for f in effects if f.effect == form.effect and not contains(f, form))


def contains(whole: EffectForm, part: EffectForm) -> bool:
    """Whether a form frees all that another frees, with the same numbers fixed."""
    freed = {f.parameter for f in whole.free}
    return {f.parameter for f in part.free} <= freed and part.fixed.items() <= whole.fixed.items()


def left(ready: OwnMachine, run: Run, form: EffectForm, seed: int) -> tuple[str, ...]:
    """The best other form, floors before and after it on recordings for validation, the share left, and so with two."""
    rng = np.random.default_rng([seed, len(form.form), len(form.effect)])
    moves = form.moves([drawn(free, rng) for free in form.free])
    kind = others(ready.effects, form)
    plant = Simulated(ready.model, (*kind, *(f for f in ready.effects if f.effect != form.effect)), ready.composed)
    plant.prepared = {r.info.name: simulated(ready, r, run, moves, rng) for r in run.recordings}
    if not all(np.all(np.isfinite(f.y)) for f in plant.prepared.values()):
        return ("too stiff to simulate", *("nan",) * 5)
    names = {
        role: [r.info.name for r in run.recordings if r.info.role == role] for role in ("estimation", "validation")
    }
    evidence = Evidence.of(plant, run, names["estimation"], 1e9)
    base = attribute.healthy(evidence)
    best = attribute.screened(evidence, [Hypothesis(plant, (f,)) for f in kind], base, rounds=5)
    found = attribute.again(evidence, min(best, key=lambda f: f.cost), rounds=3)
    before, after = (floors(plant, names["validation"], f) for f in (base, found))
    share = np.sqrt(max(after**2 - 1.0, 0.0)) / before if before > PLAIN else np.nan
    second, both = beside(evidence, found, names["validation"]) if 0.0 < share < HALF else ("", "nan")
    return found.hypothesis.forms[0].form, f"{before:.2f}", f"{after:.2f}", f"{share:.4f}", second, both


def beside(evidence: Evidence, single: Fitted, held_out: list[str]) -> tuple[str, str]:
    """The best second effect beside a form, and the floors that both leave of recordings held out."""
    base = decide.candidate(evidence, single, single)
    pairs = attribute.screened(evidence, decide.pairs_on(base, evidence.plant.effects), single, rounds=1, brief=True)
    best = min((attribute.again(evidence, f, rounds=2) for f in attribute.best_forms(pairs)[:2]), key=lambda f: f.cost)
    return best.hypothesis.forms[-1].effect, f"{floors(evidence.plant, held_out, best):.2f}"


def drawn(free: Free, rng: np.random.Generator) -> float:
    """A number between half the smallest and one and a half of the largest of its starts, of a start's sign."""
    start = float(rng.choice(free.starts))
    sizes = np.abs(free.starts)
    size = np.exp(rng.uniform(np.log(0.5 * sizes.min()), np.log(1.5 * sizes.max()))) if sizes.min() > 0 else start
    return float(np.clip(np.sign(start) * abs(size), free.low, free.high))


def simulated(
    plant: OwnMachine, r: Recording, run: Run, moves: Mapping[str, float], rng: np.random.Generator
) -> Followed:
    """The recording's windows in a row, simulated with an effect from where they began, with noise and steps."""
    f = plant.prepare(r, run, None)
    noise, step = STEPS[plant.model.name]
    made = following.repeated(plant.composed, f, moves, 1.0)
    return replace(made, y=step * np.round((made.y + noise * rng.standard_normal(made.y.shape)) / step))


def floors(plant: OwnMachine, names: list[str], fitted: Fitted) -> float:
    """Rms over recordings of what a hypothesis leaves, in floors."""
    moves = fitted.hypothesis.moves(fitted.phi)
    squares = [v for n in names for v in plant.paths(plant.prepared[n], moves).values()]
    return float(np.sqrt(np.mean([np.mean(np.minimum(v**2, 1e8)) for v in squares])))


if __name__ == "__main__":
    main()
