"""Which of the parts that look between lines decide verdicts: each is switched off, and every verdict asked again."""

from __future__ import annotations

import csv
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "certificate"), str(HERE.parent / "examiner_cases")]

import real  # noqa: E402
import spoiled  # noqa: E402
from loops import KINDS, RATE_HZ, SPOILED, case, measured  # noqa: E402
from loops import spoiled as spoiled_lines  # noqa: E402
from parts import PARTS, Part, heard  # noqa: E402

from loopshape.data.control.controller import Block, Controller  # noqa: E402
from loopshape.data.requirement.requirements import Requirements  # noqa: E402
from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.loop.verdict import check  # noqa: E402

SEED, NOISES, FLOORS = 31, (1e-6, 0.02, 0.05, 0.1), (0.1, 0.3, 0.5)
#: loops of each cell of the certificate study, of each kind of the examiners' study and of its sound ones, at count 1
OF_CERTIFICATE, OF_EXAMINER, SOUND = 30, 100, 800
COLUMNS = (
    "loops", "part", "how", "verdicts", "spoke", "changed", "stability_changed", "to_undecided", "from_undecided",
    "right_to_wrong", "wrong_to_right", "sound_undecided",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Question:
    """A loop, what is asked of it, and what is true: `stable`, and whether every limit `holds`; None where unknown."""

    kind: str
    frf: FRF
    controller: Controller
    asked: Requirements
    stable: bool | None = None
    holds: bool | None = None

    def answered(self) -> tuple[str, ...]:
        """Stability, outcome and the outcome of each line; of an FRF of its own, which nothing remembers."""
        found = check([replace(self.frf)], self.controller, self.asked)
        (margins,) = found.margins.values()
        return margins.stable, found.outcome.value, *(line.outcome for line in found.lines)

    def wrong(self, answer: tuple[str, ...]) -> bool:
        """Stability or outcome against the truth; nothing is wrong that is undecided or of unknown truth."""
        if self.stable is None:
            return False
        stability, outcome = answer[:2]
        good = self.stable and self.holds
        against = "passed" if not good else "failed"
        return outcome == against or stability == ("unstable" if self.stable else "stable")


def of_certificate(count: int) -> Iterator[Question]:
    """Loops of the certificate study, limits clear of their true margins."""
    for k, kind in enumerate((*KINDS, "noise floor", *SPOILED)):
        for n in range(count):
            rng = np.random.default_rng([SEED, k, n])
            whole, floor = kind in KINDS, kind == "noise floor"
            drawn = case(rng, kind if whole else "one integrator" if floor else str(rng.choice(KINDS[:-1])))
            exact = spoiled.truth(drawn.plant, drawn.gain)
            asked, holds = spoiled.requirements(rng, exact, drawn.plant, zero=False)
            controller = Controller("axis", (Block("gain", {"gain": drawn.gain}),), RATE_HZ)
            for noise in FLOORS if floor else NOISES:
                if kind in SPOILED:
                    frf = spoiled_lines(drawn, rng, noise, kind)
                else:
                    frf = measured(drawn, rng, noise) if whole else measured(drawn, rng, 0.02, noise)
                if frf.valid.any():
                    own = replace(frf, loop="axis", recording="one")
                    yield Question("certificate", own, controller, asked, drawn.unstable == 0, holds)


def of_examiner(count: int, sound: int) -> Iterator[Question]:
    """Loops of the examiners' study; its sound ones are those of its own table."""
    for k, kind in enumerate(spoiled.KINDS):
        if kind == "fit":  # fits decide of poles, not between lines
            continue
        for n in range(sound if kind == "sound" else count):
            one = spoiled.draw(np.random.default_rng([28, k, n]), kind)
            name = "examiner, sound" if kind == "sound" else "examiner"
            yield Question(name, one.frf, one.controller, one.asked, one.stable, one.holds)


def of_real() -> Iterator[Question]:
    """Elements of real recordings under drawn controllers."""
    for k, (name, frf) in enumerate(real.elements()):
        for own, controller, asked in real.asked(np.random.default_rng([SEED, 99, k]), name, frf):
            yield Question("real", own, controller, asked)


def counted(question: Question, before: tuple[str, ...], after: tuple[str, ...]) -> list[str]:
    """What became of an answer."""
    words = ["changed"] * (before != after) + ["stability_changed"] * (before[0] != after[0])
    words += ["to_undecided"] * (before[1] != "undecided" == after[1])
    words += ["from_undecided"] * (before[1] == "undecided" != after[1])
    was, now = question.wrong(before), question.wrong(after)
    words += ["right_to_wrong"] * (now and not was) + ["wrong_to_right"] * (was and not now)
    good = question.kind == "examiner, sound" and question.stable and question.holds
    return words + ["sound_undecided"] * (bool(good) and after[1] == "undecided")


def studied(questions: Iterator[Question], parts: tuple[Part, ...]) -> dict[tuple[str, str, str], Counter[str]]:
    """Counts by kind of loop, part and how it is off; the rows of no part say how many there are and are wrong."""
    found: dict[tuple[str, str, str], Counter[str]] = {}
    for n, question in enumerate(questions):
        if n % 100 == 0:
            print(n, question.kind, round(time.process_time()), flush=True)
        said: set[str] = set()
        with heard(parts, said):
            before = question.answered()
        whole = found.setdefault((question.kind, "none", ""), Counter())
        whole.update(["verdicts", *counted(question, before, before), *["wrong"] * question.wrong(before)])
        whole.update(["undecided"] * (before[1] == "undecided"))
        for part in parts:
            mine = found.setdefault((question.kind, part.name, part.how), Counter())
            spoke = f"{part.site[0].__name__}.{part.site[1]}" in said
            after = before
            if spoke:
                with part.off():
                    after = question.answered()
            mine.update(["verdicts", *["spoke"] * spoke, *counted(question, before, after)])
    return found


def main(percent: int = 100) -> None:
    """Write parts.csv; some twenty minutes on one core (OMP_NUM_THREADS=1) at 100 percent of the loops."""
    started = time.process_time()
    share = percent / 100.0

    def questions() -> Iterator[Question]:
        yield from of_certificate(round(OF_CERTIFICATE * share))
        yield from of_examiner(round(OF_EXAMINER * share), round(SOUND * share))
        yield from of_real()

    found = studied(questions(), PARTS)
    with (HERE / "parts.csv").open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(COLUMNS)
        for key, row in found.items():
            out.writerow([*key, *(row[name] for name in COLUMNS[3:])])
    for key, row in found.items():
        print(*key, dict(row))
    print(f"{time.process_time() - started:.0f} s")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
