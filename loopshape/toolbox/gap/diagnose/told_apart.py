"""Which names these recordings cannot tell apart, and which effect of a pair carries it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.gap.diagnose.decide import Candidate
from loopshape.toolbox.gap.diagnose.evidence import Evidence


@dataclass(frozen=True, eq=False)
class Scale:
    """What the best explanation leaves of each cell, (cells,): mean square over the noise floor, noise included."""

    evidence: Evidence
    left: Array

    def log_ratio(self, of: Candidate) -> Array:
        """Logarithm (cells,) of what an explanation leaves of recordings left out, in units of what the best leaves."""
        return np.asarray(np.log1p(np.maximum(of.left.squares, self.evidence.least) / self.left))

    def apart(self, one: Candidate, other: Candidate) -> bool:
        """Whether the recordings tell two explanations apart.

        They do not where what the two predict differs by less than what even the best one leaves, and neither predicts
        recordings that were left out clearly better, by the scatter over these.
        """
        if len(one.fitted.hypothesis.forms) != len(other.fitted.hypothesis.forms):
            return True
        differing = self.evidence.mean_squares(one.fitted.residual - other.fitted.residual)
        if np.mean(differing / self.left) >= 1.0:
            return True
        by_cell = self.log_ratio(other) - self.log_ratio(one)
        of = np.array([c.recording for c in self.evidence.cells])
        rows = np.array([by_cell[of == name].sum() for name in self.evidence.recordings])
        error = float(rows.std(ddof=1) * np.sqrt(rows.size)) if rows.size > 1 else float("inf")
        clear, deviations = 1.0, 2.0  # of the logarithm of the evidence, and how many standard errors over recordings
        return bool(abs(rows.sum()) >= max(clear, deviations * error))


def groups(scale: Scale, scored: Mapping[str, Candidate], probabilities: Mapping[str, float]) -> list[tuple[str, ...]]:
    """Groups of names that stand for one another, best first, that hold nine tenths together.

    Each begins with its most probable name; what no fit stands behind (none, unknown, what was not worth fitting) is a
    group of its own.
    """
    out: list[list[str]] = []
    for name in probabilities:
        mine = scored.get(name) if name != "none" else None
        alike = [g for g in out if mine and g[0] in scored and g[0] != "none" and not scale.apart(scored[g[0]], mine)]
        if alike:
            alike[0].append(name)
        else:
            out.append([name])
    total = {id(g): sum(probabilities[n] for n in g) for g in out}
    out.sort(key=lambda g: -total[id(g)])
    held = np.cumsum([total[id(g)] for g in out])
    # of the probability that the groups of an answer hold together
    return [tuple(g) for g in out[: int(np.searchsorted(held, 0.9)) + 1]]


def by_recording(scale: Scale, scored: Mapping[str, Candidate]) -> dict[str, str]:
    """Which single effect, or none, predicts each recording best from the others, by what the best leaves of a cell.

    Answers that differ from recording to recording say that no one name holds for the machine.
    """
    single = {n: c for n, c in scored.items() if len(c.fitted.hypothesis.forms) < 2}
    of = np.array([c.recording for c in scale.evidence.cells])
    left = {n: scale.log_ratio(c) for n, c in single.items()}
    return {r: min(left, key=lambda n: float(left[n][of == r].sum())) for r in scale.evidence.recordings}


def main_effect(evidence: Evidence, pair: Candidate) -> str:
    """The effect of a pair that moves the outputs most while the other stays: by what is missing without it."""
    fitted = pair.fitted
    forms, without = fitted.hypothesis.forms, []
    for k in range(len(forms)):
        sizes = [len(f.free) for f in forms]
        start = sum(sizes[:k])
        kept = type(fitted.hypothesis)(fitted.hypothesis.plant, tuple(f for j, f in enumerate(forms) if j != k))
        without.append(kept.moves(np.delete(fitted.phi, range(start, start + sizes[k]))))
    moved = [evidence.mean_squares(r - fitted.residual).mean() for r in evidence.residuals(without)]
    return forms[int(np.argmax(moved))].effect
