"""The encirclement certificate on thousands of random loops with known poles: how often right, wrong, undecided."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own files, however it is started

from hidden import alarms, detection  # noqa: E402
from loops import KINDS, SPOILED, STEPS, Case, case, checked, loop, measured, peer, spoiled  # noqa: E402

from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.loop.stability.sampling import between_lines  # noqa: E402
from loopshape.loop.stability.stability import Stability, closed_loop_stability  # noqa: E402

LOOPS = 400
NOISES, FLOORS = (1e-6, 0.02, 0.05, 0.1), (0.1, 0.3, 0.5)
COLUMNS = (
    "kind", "noise", "loops", "stable", "right", "undecided", "wrong", "wrong_and_seen", "wrong_number",
    "undecided_far", "control_wrong", "no_band",
)  # fmt: skip
STEP_COLUMNS = ("step", "noise", "loops", "right", "undecided", "wrong")
REASON_COLUMNS = ("reason", *(f"noise {x:g}" for x in NOISES))
REASONS = {
    "errors of the lines": ("-1 lies within", "errors of L"),
    "resonances between lines": ("a resonance between", "resonances between", "neither noise"),
    "L passes -1": ("L passes",),
    "turns or bends between lines": ("L bends",),
    "ends": ("|L| is", "the phase of L"),
    "all": ("",),
}


@dataclass(frozen=True, eq=False)
class Trial:
    """One measurement of a loop, what was answered, and whether the tails of its sharpest pole leave the noise."""

    case: Case
    noise: float
    found: Stability
    peer: int
    seen: bool

    @property
    def wrong(self) -> bool:
        """Stable called unstable or unstable called stable."""
        return self.found.outcome != "undecided" and (self.found.outcome == "stable") != (self.case.unstable == 0)


def trials(kind: str) -> Iterator[Trial]:
    """All loops of a kind at all levels of noise."""
    rng = np.random.default_rng([5, (*KINDS, "noise floor", *SPOILED).index(kind)])
    for _ in range(LOOPS):
        if kind in SPOILED:
            drawn = case(rng, str(rng.choice(KINDS[:-1])))
            for noise in NOISES:
                frf = spoiled(drawn, rng, noise, kind)
                yield Trial(
                    drawn, noise, closed_loop_stability(checked(drawn, frf)), peer(drawn, frf), seen(drawn, frf)
                )
            continue
        drawn = case(rng, kind if kind in KINDS else "one integrator")
        for noise in NOISES if kind in KINDS else FLOORS:
            frf = measured(drawn, rng, noise) if kind in KINDS else measured(drawn, rng, 0.02, noise)
            found = closed_loop_stability(loop(drawn, frf))
            yield Trial(drawn, noise, found, peer(drawn, frf), seen(drawn, frf))


def seen(drawn: Case, frf: FRF) -> bool:
    """Whether the sharpest pole's residue is one that is found for sure, or no pole lies inside the lines."""
    f_hz, residue = drawn.mode
    f = frf.frequency_hz
    if not f[1] < f_hz < f[-2]:
        return True
    visible = between_lines(f, frf.siso, frf.variance[:, 0, 0]).visible_residue
    return bool(residue > visible[int(np.searchsorted(f, f_hz)) - 1])


def summary(kind: str, noise: float, made: list[Trial]) -> list:
    """A row of the first table."""
    undecided = [t for t in made if t.found.outcome == "undecided"]
    wrong = [t for t in made if t.wrong]
    number = [t for t in made if not t.wrong and t not in undecided and t.found.unstable_poles != t.case.unstable]
    return [
        kind, noise, len(made), sum(t.case.unstable == 0 for t in made),
        len(made) - len(undecided) - len(wrong) - len(number), len(undecided), len(wrong), sum(t.seen for t in wrong),
        len(number), sum(t.case.step in (0.5, 2.0) for t in undecided),
        sum((t.peer == 0) != (t.case.unstable == 0) for t in made), sum(t.found.band_hz is None for t in undecided),
    ]  # fmt: skip


def step_row(step: float, noise: float, made: list[Trial]) -> list:
    """A row of the second table: how far the gain lies from the limit."""
    here = [t for t in made if t.case.step == step and t.noise == noise]
    undecided, wrong = sum(t.found.outcome == "undecided" for t in here), sum(t.wrong for t in here)
    return [step, noise, len(here), len(here) - undecided - wrong, undecided, wrong]


def reason_rows(made: list[Trial]) -> list[list]:
    """A row a reason: how many answers of each level of noise were left open by it."""

    def count(starts: tuple[str, ...], noise: float) -> int:
        return sum(
            t.noise == noise and t.found.outcome == "undecided" and t.found.reason.startswith(starts) for t in made
        )

    return [[name, *(count(starts, noise) for noise in NOISES)] for name, starts in REASONS.items()]


def written(name: str, columns: tuple[str, ...], rows: list[list]) -> None:
    """Write a table and show it."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    for row in (columns, *rows):
        print("  ".join(str(cell) for cell in row), flush=True)


def main() -> None:
    """Write the tables; some ten minutes on one core (OMP_NUM_THREADS=1)."""
    every: list[Trial] = []
    rows = []
    for kind in (*KINDS, "noise floor", *SPOILED):
        made = list(trials(kind))
        rows += [
            summary(kind, noise, [t for t in made if t.noise == noise]) for noise in sorted({t.noise for t in made})
        ]
        every += made if kind in KINDS else []
    written("answers.csv", COLUMNS, rows)
    written("steps.csv", STEP_COLUMNS, [step_row(step, noise, every) for noise in NOISES for step in STEPS])
    written("reasons.csv", REASON_COLUMNS, reason_rows(every))
    written("alarms.csv", ("lines", "noise", "overlap", "records", "records_with_a_pole"), list(alarms()))
    written(
        "detection.csv",
        ("noise", "width_over_gap", "tail_over_noise", "records", "found", "peak_bounded"),
        list(detection()),
    )


if __name__ == "__main__":
    main()
