"""What recordings can tell of a machine at all, before an effect is looked for in them."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose import attribute, windows
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.fitting import Fitted
from loopshape.toolbox.gap.diagnose.hypothesis import candidates
from loopshape.toolbox.gap.nouns.gap_report import Visible
from loopshape.toolbox.gap.nouns.plant import SimulationModel

BRIEF_S = 12.0  # of every recording


def identifiability(
    plant: SimulationModel, run: Run, threads: int | None = None, say: windows.Log = lambda step: None
) -> list[Visible]:
    """How small each effect may be to be seen in the recordings for estimation, and which others it looks like.

    Each effect is brought into the nominal model at a size that its machine is moved by, the tolerances and initial
    states answer by straight lines, and what is left is compared (signatures; cosines as in Belsley, Kuh and Welsch
    1980). Seen is what moves the outputs by as much as matters, or by the noise floor where that is more. Misleads
    where an effect acts far from in proportion, and a machine that has other faults shows less.
    """
    names = [r.info.name for r in run.recordings if r.info.role == "estimation"]
    plant, run, names = windows.chosen(plant, run, names, threads, say).readied(run, names)
    evidence = Evidence.of(plant, run, names, BRIEF_S, threads, BRIEF_S)
    say("nominal machine")
    base = attribute.healthy(evidence)
    say("effects")
    found = _signatures(evidence, base)
    shapes = plant.shapes(evidence.prepared)
    least = 1.0 if shapes is None else max(1.0, float(np.mean([shapes.least(p) for p in evidence.prepared])))
    out = []
    for name, (magnitude, unit, signature) in found.items():
        size = float(np.sqrt(np.mean(signature**2)))
        # cosine from which two effects are one to these recordings
        alike = tuple(n for n, (_, _, x) in found.items() if n != name and _cosine(signature, x) >= 0.95)
        out.append(Visible(name, abs(magnitude) * least / size if size > 0.0 else None, unit, alike))
    return out


def _signatures(evidence: Evidence, base: Fitted) -> dict[str, tuple[float, str, Array]]:
    """By effect: magnitude, unit, and what it does in floors (n,) beside what tolerances would take up; the largest of
    its forms' starts."""
    every = [(h, phi) for h in candidates(evidence.plant) for phi in h.starts(base.phi)]
    moved = evidence.nearby(base.hypothesis.moves(base.phi), [h.moves(phi) for h, phi in every])
    floor = np.concatenate([np.full(c.stop - c.start, c.floor) for c in evidence.cells])
    slopes = base.slopes / floor[:, None]
    h = slopes.T @ slopes / len(floor)
    hold = 1.0 / 3.0  # inverse variance of a tolerance that is uniform in -1..1, over its own
    taken = np.linalg.pinv(h + hold * 1e-3 * np.diag(np.diag(h)) + 1e-12 * np.eye(len(h))) if h.size else h
    out: dict[str, tuple[float, str, Array]] = {}
    for (hypothesis, phi), residual in zip(every, moved, strict=True):
        x = np.nan_to_num((base.residual - residual) / floor, nan=0.0, posinf=0.0, neginf=0.0)
        x = np.clip(x, -_MOST, _MOST)
        x = x - slopes @ (taken @ (slopes.T @ x / len(floor))) if h.size else x
        form = hypothesis.forms[0]
        known = out.get(form.effect)
        if known is None or np.sum(x**2) > np.sum(known[2] ** 2):
            out[form.effect] = (hypothesis.magnitudes(phi)[0], form.unit, x)
    return out


_MOST = 1e3  # floors: what runs away tells no shape


def _cosine(one: Array, other: Array) -> float:
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return abs(float(one @ other)) / size if size > 0.0 else 0.0
