"""How far is a size off where an effect has another form than the one fitted? Arms of one form, judged by the others.

`python experiments/effects/forms.py [EFFECT...]` writes forms.csv. Each form of the catalogue is simulated on the
library's own arm, with tolerances and noise, at the upper end of its usual magnitudes; the effect's other forms are
fitted, and the one that leaves least is what a catalogue without the true form would have answered.
"""

from __future__ import annotations

import csv
import os
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

sys.path.insert(0, str(Path(__file__).parents[1] / "lab"))
from exam_cases import PLANT, catalogue, library_run

from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose import attribute
from loopshape.toolbox.gap.diagnose.diagnose import BRIEF_S, PERIODIC_S
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis
from loopshape.toolbox.gap.tolerances import TOL
from loopshape.toolbox.rig.registry import diagnosable

TABLE = Path(__file__).parent / "forms.csv"
COLUMNS = ["effect", "true_form", "fitted_form", "healthy_excess", "excess", "share_left", "log_ratio"]
SEED, ROUNDS = 3000, 3


def main(effects: list[str]) -> None:
    """Write the rows of these effects, or of all, and say by how much a size is off for what its form leaves."""
    known = catalogue()
    rows = [] if not TABLE.exists() else [r for r in read() if r["effect"] not in (effects or known)]
    for effect in effects or known:
        for k in range(len(known[effect])):
            rows += judged(effect, k)
            write(rows)
    fits, factor = of_what_is_left()
    print(f"{fits} fits leave a fifth of the gap or less: a size is off by {factor:.2f} times the share left")


def judged(effect: str, k: int) -> list[dict[str, object]]:
    """The row of one true form; none where the effect has no other."""
    forms = catalogue()[effect]
    others = [f for f in diagnosable(PLANT).effects if f.effect == effect and f.form != forms[k].form]
    if not others:
        return []
    size = forms[k].usual[1]
    run = library_run({effect: size}, k, SEED + k)
    evidence = evidence_of(run)
    base = attribute.healthy(evidence)
    found = attribute.screened(evidence, [Hypothesis(evidence.plant, (f,)) for f in others], base)
    best = attribute.again(evidence, min(found, key=lambda f: f.cost), rounds=ROUNDS)
    ratio = best.magnitudes[0] / size
    values = [effect, forms[k].form, best.hypothesis.form, base.cost - evidence.quiet, best.cost - evidence.quiet,
              attribute.share_left(best, base), float(np.log(ratio)) if ratio > 0.0 else float("-inf")]  # fmt: skip
    return [dict(zip(COLUMNS, values, strict=True))]


def evidence_of(run: Run) -> Evidence:
    """Its estimation recordings, as briefly as a diagnosis first looks at them."""
    plant, run, names = diagnosable(PLANT).readied(
        run, [r.info.name for r in run.recordings if r.info.role == "estimation"]
    )
    return Evidence.of(plant, run, names, PERIODIC_S, 1, BRIEF_S)


def of_what_is_left() -> tuple[int, float]:
    """How many fits leave a fifth of the gap at most, and how much a size is off for the share that they leave.

    The logarithm by which a size is off is taken as normal with the deviation hypot(form_error, factor * share); the
    factor is the most likely one.
    """
    pairs = [(float(r["share_left"]), float(r["log_ratio"])) for r in read()]
    near = [pair for pair in pairs if pair[0] < TOL.unknown_leaves]
    share, error = np.array(near).T

    def surprise(factor: float) -> float:
        variance = TOL.form_error**2 + (factor * share) ** 2
        return float(np.sum(0.5 * np.log(variance) + 0.5 * error**2 / variance))

    return len(near), float(minimize_scalar(surprise, bounds=(0.0, 20.0), method="bounded").x)


def read() -> list[dict[str, str]]:
    """The table as it stands."""
    with TABLE.open() as file:
        return list(csv.DictReader(file))


def write(rows: list) -> None:
    """The table, three digits."""
    with TABLE.open("w", newline="") as file:
        out = csv.DictWriter(file, COLUMNS)
        out.writeheader()
        out.writerows([{k: f"{float(v):.3f}" if k in COLUMNS[3:] else v for k, v in r.items()} for r in rows])


if __name__ == "__main__":
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    main(sys.argv[1:])
