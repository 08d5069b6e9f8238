"""Loops on which verdicts were wrong with confidence: the cases themselves, and thousands of harder random loops."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "certificate")]  # the study's own files, and the certificate's loops

import spoiled  # noqa: E402
from cases import CASES, Row  # noqa: E402
from loops import (  # noqa: E402
    GAINS,
    LINEAR,
    LOGARITHMIC,
    RATE_HZ,
    Case,
    between,
    limit,
    measured,
    pair,
    product,
    real,
    unstable_poles,
)

from loopshape.data.control.controller import Block, Controller  # noqa: E402
from loopshape.data.requirement.requirements import Requirements  # noqa: E402
from loopshape.data.response.model import TransferFunction  # noqa: E402
from loopshape.loop.loops import loops_of  # noqa: E402
from loopshape.loop.stability.stability import closed_loop_stability  # noqa: E402

LOOPS, NOISES = 500, (1e-6, 0.01, 0.03, 0.1)
STEPS = (0.3, 0.5, 0.7, 0.9, 1.1, 1.4, 2.0, 3.0)
TOLD = ("declared", "recorded loop", "nothing")
COLUMNS = ("told", "noise", "unstable_poles", "loops", "stable", "right", "undecided", "wrong")
REASONS = {
    "errors of the lines": ("-1 lies within", "errors of L"),
    "resonances between lines": ("a resonance between", "resonances between", "neither noise"),
    "L passes -1": ("L passes",),
    "turns or bends between lines": ("L bends",),
    "the last line": ("|L| is still",),
    "the first line": ("|L| is", "the phase of L"),
    "integrators": ("the number of integrators",),
    "unstable poles": ("the number of unstable poles",),
    "others": ("",),
}


@dataclass(frozen=True, eq=False)
class Answer:
    """One loop, what was told of its plant, and what was answered."""

    case: Case
    told: str
    noise: float
    outcome: str
    reason: str

    @property
    def wrong(self) -> bool:
        """Stable called unstable or unstable called stable."""
        return self.outcome != "undecided" and (self.outcome == "stable") != (self.case.unstable == 0)


def harder(rng: np.random.Generator) -> Case:
    """0 to 3 integrators, 0 to 2 unstable poles, up to three lightly damped modes between lines, delay in a third."""
    lines = (LINEAR, LOGARITHMIC)[int(rng.integers(2))]
    integrators, growing = int(rng.integers(0, 4)), int(rng.integers(0, 3))
    num = product(*(real(between(rng, 0.3, 3.0)) for _ in range(max(integrators - 1, 0) + growing)))
    den = product(*(real(between(rng, 8.0, 40.0)) for _ in range(3)))
    if growing == 1:
        den = product(den, real(between(rng, 0.5, 3.0), -1.0))
    if growing == 2:
        den = product(den, pair(between(rng, 0.5, 4.0), -between(rng, 0.05, 0.5)))
    for _ in range(int(rng.integers(0, 4))):
        f_hz = between(rng, 3.0, 40.0)
        den = product(den, pair(f_hz, between(rng, 0.003, 0.05)))
        num = product(num, pair(f_hz * between(rng, 0.8, 1.25), between(rng, 0.003, 0.05)))
    den = np.concatenate([den, np.zeros(integrators)])
    scale = 1.0 / abs(TransferFunction(num, den).response([5.0])[0])
    plant = TransferFunction(scale * num, den, between(rng, 0.002, 0.02) if rng.random() < 1.0 / 3.0 else 0.0)
    counts = np.array([unstable_poles(plant, g) for g in GAINS])
    changes = np.flatnonzero(np.diff(counts))
    step = float(rng.choice(STEPS))
    gain = limit(plant, counts, int(rng.choice(changes))) * step if changes.size else float(rng.choice(GAINS))
    return Case("harder", plant, lines, "", gain, step if changes.size else 0.0, unstable_poles(plant, gain))


def _controller(gain: float) -> Controller:
    return Controller("axis", (Block("gain", {"gain": float(gain)}),), RATE_HZ)


def answers(seed: int, noise: float) -> Iterator[Answer]:
    """All loops at a level of noise, with everything declared, and with the recorded loop or nothing in its place."""
    rng = np.random.default_rng([seed, round(1e7 * noise)])
    for _ in range(LOOPS):
        drawn = harder(rng)
        frf = replace(measured(drawn, rng, noise), loop="axis", recording="one")
        stable = [g for g in GAINS[::4] if unstable_poles(drawn.plant, g) == 0]
        wish = Requirements("axis", integrators=drawn.plant.integrators())
        told = {"declared": (frf, replace(wish, unstable_poles=drawn.plant.unstable_poles())), "nothing": (frf, wish)}
        if stable:
            told["recorded loop"] = replace(frf, recorded_under=_controller(rng.choice(stable))), wish
        for name, (one, asked) in told.items():
            (loop,), _ = loops_of([one], _controller(drawn.gain), asked)
            found = closed_loop_stability(loop)
            yield Answer(drawn, name, noise, found.outcome, found.reason)


def rows(made: list[Answer]) -> Iterator[list]:
    """By what was told, noise and unstable poles of the plant."""
    for told in TOLD:
        for noise in NOISES:
            for growing in range(3):
                mine = [x for x in made if (x.told, x.noise, x.case.plant.unstable_poles()) == (told, noise, growing)]
                undecided, wrong = sum(x.outcome == "undecided" for x in mine), sum(x.wrong for x in mine)
                stable = sum(x.case.unstable == 0 for x in mine)
                yield [told, noise, growing, len(mine), stable, len(mine) - undecided - wrong, undecided, wrong]


def reasons(made: list[Answer]) -> Iterator[list]:
    """How many declared loops are undecided for which reason, by noise."""
    mine = [x for x in made if x.told == "declared" and x.outcome == "undecided"]
    kinds = [next(name for name, starts in REASONS.items() if x.reason.startswith(starts)) for x in mine]
    for name in REASONS:
        pairs = zip(kinds, mine, strict=True)
        found = [x.noise for kind, x in pairs if kind == name]
        yield [name, *(found.count(noise) for noise in NOISES)]


def _write(name: str, columns: tuple[str, ...], table: Iterator[list] | list) -> None:
    with (HERE / name).open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(columns)
        out.writerows(table)


def main() -> int:
    """Write cases.csv, random_loops.csv, reasons.csv, spoiled.csv and law.csv; 1 where an answer is wrong."""
    found: list[Row] = [row for make in CASES for row in make()]
    _write("cases.csv", Row._fields, [list(row) for row in found])
    made = [x for noise in NOISES for x in answers(14, noise)]
    _write("random_loops.csv", COLUMNS, rows(made))
    _write("reasons.csv", ("reason", *(f"noise {x:g}" for x in NOISES)), reasons(made))
    wrong = sum(x.wrong for x in made)
    print(f"{len(made)} answers on {LOOPS * len(NOISES)} random loops, {wrong} wrong")
    for row in found:
        print(", ".join(map(str, row)))
    return int(wrong > 0) | spoiled.main()


if __name__ == "__main__":
    sys.exit(main())
