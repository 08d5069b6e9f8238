"""Undecided loops followed: what a verdict orders is measured, up to three times, and the loop is checked again."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "certificate")]

from spoiled import Spoiled, draw  # noqa: E402

from loopshape.core.units import Array  # noqa: E402
from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.data.response.frf_arrays import valid_lines  # noqa: E402
from loopshape.data.result.verdict import Order, SettledBy, Verdict  # noqa: E402
from loopshape.loop.verdict import check  # noqa: E402

KINDS, ROUNDS = ("hole", "poor band", "low edge", "high edge", "sound"), 3
COLUMNS = (
    "kind",
    "undecided",
    "decided after 1",
    "after 2",
    "after 3",
    "wrong",
    "no measurement",
    "median s",
    "most s",
)


@dataclass(frozen=True, eq=False)
class Followed:
    """An undecided loop, its outcome after each round, the seconds of each, and what was wrong; last its verdict."""

    name: str
    outcomes: tuple[str, ...]
    seconds: tuple[float, ...]
    wrong: str
    last: Verdict

    def decided(self, rounds: int) -> bool:
        """Whether it is decided after so many rounds."""
        return "undecided" not in self.outcomes[: rounds + 1][-1:]


def relative(frf: FRF, at_hz: Array) -> Array:
    """Relative deviation (n,) of an FRF's lines at other frequencies; as at its ends beyond them."""
    return np.asarray(np.interp(np.log(at_hz), np.log(frf.frequency_hz), frf.relative_std[:, 0, 0]))


def measured(rng: np.random.Generator, one: Spoiled, first: FRF, order: Order) -> tuple[FRF, float]:
    """The loop's FRF with an order carried out, and the seconds that it takes.

    Lines at the order's distance stand in place of those that were in its band. The lines of the `first` FRF count as
    one period of any distance; a later order's seconds are counted from the periods that its band's lines have had.
    """
    apart = order.resolution_hz
    k = np.arange(max(np.ceil(order.low_hz / apart - 1e-6), 1.0), np.floor(order.high_hz / apart + 1e-6) + 1.0)
    new = apart * k
    had = float(np.median((relative(first, new) / relative(one.frf, new)) ** 2))
    std = relative(one.frf, new) / np.sqrt(apart * order.seconds)
    P = one.plant.response(new)
    error = std * np.sqrt(0.5) * (rng.standard_normal(new.size) + 1j * rng.standard_normal(new.size))
    old = (one.frf.frequency_hz < order.low_hz) | (one.frf.frequency_hz > order.high_hz)
    f = np.append(one.frf.frequency_hz[old], new)
    response = np.append(one.frf.siso[old], P * (1.0 + error))
    every = np.append(one.frf.relative_std[old, 0, 0], std)
    f, at = np.unique(f, return_index=True)
    response, every = response[at], every[at]
    made = replace(
        one.frf,
        frequency_hz=f,
        response=response[:, None, None],
        covariance=((every * np.abs(response)) ** 2)[:, None, None] + 0j,
        valid=valid_lines(f, every, np.ones(f.size, dtype=bool)),
    )
    return made, order.seconds * max(had, 1.0)


def follow(seed: int, kind: str, k: int) -> Followed | None:
    """The k-th loop of a kind followed as far as three rounds, None where it is decided from the start."""
    one = draw(np.random.default_rng([seed, KINDS.index(kind), k]), kind)
    rng, first = np.random.default_rng([seed, 99, KINDS.index(kind), k]), one.frf
    verdict = check([one.frf], one.controller, one.asked)
    outcomes, seconds, wrong = [verdict.outcome.value], [], ""
    if outcomes[0] != "undecided":
        return None
    while outcomes[-1] == "undecided" and len(outcomes) <= ROUNDS:
        orders = [order for order in verdict.orders if order.by is SettledBy.MEASUREMENT]
        if not orders:
            break
        spent = 0.0
        for order in orders:
            frf, taken = measured(rng, one, first, order)
            one, spent = replace(one, frf=frf), spent + taken
        verdict = check([one.frf], one.controller, one.asked)
        outcomes, seconds = [*outcomes, verdict.outcome.value], [*seconds, spent]
        wrong = one.wrong(outcomes[-1])
    return Followed(f"{kind} {k}", tuple(outcomes), tuple(seconds), wrong, verdict)


def followed(count: int, seed: int, kind: str) -> Iterator[Followed]:
    """So many undecided loops of a kind."""
    k = 0
    while count:
        one = follow(seed, kind, k)
        k += 1
        if one is not None:
            count -= 1
            yield one


def row(kind: str, made: list[Followed]) -> list:
    """A kind's row of the table."""
    after = [sum(x.decided(n) for x in made) for n in range(1, ROUNDS + 1)]
    spent = [sum(x.seconds) for x in made if x.seconds] or [0.0]
    alone = sum(not x.seconds for x in made)
    times = f"{np.median(spent):.3g}", f"{max(spent):.3g}"
    return [kind, len(made), *after, sum(bool(x.wrong) for x in made), alone, *times]


def why(one: Followed) -> str:
    """What a loop that stays undecided lacks."""
    margins = next(iter(one.last.margins.values()))
    if margins.stable == "undecided":
        return margins.stability_reason
    return ", ".join(f"{x.quantity} {x.interval} {x.bound}" for x in one.last.lines if x.outcome == "undecided")


def _write(rows: list[list]) -> None:
    with (HERE / "orders.csv").open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(COLUMNS)
        out.writerows(rows)


def main(count: int = 40, seed: int = 29) -> int:
    """Write orders.csv; 1 where an answer is wrong."""
    rows, reasons = [], Counter()
    every: list[Followed] = []
    for kind in KINDS:
        made = list(followed(count, seed, kind))
        every += made
        rows.append(row(kind, made))
        print(*rows[-1], sep=", ", flush=True)
        for one in made:
            if one.wrong or not one.decided(ROUNDS):
                print(f"  {one.name}: {one.outcomes} {one.wrong} {why(one)}", flush=True)
                reasons[why(one).split(",")[0]] += 1
        _write([*rows, row("all", every)])
    print(*row("all", every), sep=", ")
    print(reasons)
    return int(any(x.wrong for x in every))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
