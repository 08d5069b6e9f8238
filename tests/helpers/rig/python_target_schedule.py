"""Schedules of the target in Python, from docs/protocol.md alone: as they come, and as they run."""

import math
import struct
from dataclasses import dataclass, field
from itertools import pairwise, product


class RefusedError(Exception):
    """A request that is refused: its code and a sentence."""


def fields(form: str, payload: bytes) -> tuple:
    """The payload as these fields, or NO 2."""
    if struct.calcsize("<" + form) != len(payload):
        raise RefusedError(2, f"the payload has {len(payload)} bytes, not {struct.calcsize('<' + form)}")
    return struct.unpack("<" + form, payload)


def inside(fine: bool, sentence: str) -> None:
    """NO 3 with this sentence where it is not fine."""
    if not fine:
        raise RefusedError(3, sentence)


@dataclass
class Variable:
    """What a schedule follows: a source's number, a factor, and the knots."""

    source: int
    scale: float
    knots: tuple[float, ...]
    place: float = math.nan

    def moved(self, signals: list[float], share: float) -> None:
        """On to the place of this tick."""
        step = self.scale * signals[self.source] - self.place
        self.place = self.scale * signals[self.source] if math.isnan(step) else self.place + share * step

    def weights(self) -> list[tuple[int, float]]:
        """Knots around the place, and their weights."""
        k = self.knots
        if len(k) == 1 or not self.place > k[0]:
            return [(0, 1.0), (min(1, len(k) - 1), 0.0)]
        below = max(i for i in range(len(k) - 1) if i == 0 or self.place >= k[i])
        part = min((self.place - k[below]) / (k[below + 1] - k[below]), 1.0)
        return [(below, 1.0 - part), (below + 1, part)]


@dataclass
class Schedule:
    """A controller whose coefficients follow an operating point."""

    sections: int
    share: float
    variables: list[Variable]
    rows: list[tuple[float, ...]] = field(default_factory=list)

    @classmethod
    def read(cls, payload: bytes, loops: int) -> "Schedule":
        """SCHEDULE, or the refusal that it earns."""
        if len(payload) < 11:
            raise RefusedError(2, "too short")
        count, sections, share = struct.unpack("<BBd", payload[1:11])
        inside(1 <= count <= 3 and sections > 0 and 0.0 < share <= 1.0, f"{count} variables, {sections}, {share}")
        at, found = 11, []
        for _ in range(count):
            source, scale, knots = fields("BdB", payload[at : at + 10])
            values = fields(f"{knots}d", payload[at + 10 : at + 10 + 8 * knots])
            inside(source < 2 * loops and math.isfinite(scale) and scale != 0.0 and knots > 0, f"source {source}")
            inside(all(map(math.isfinite, values)) and all(a < b for a, b in pairwise(values)), f"knots {values}")
            found.append(Variable(source, scale, values))
            at += 10 + 8 * knots
        fields("", payload[at:])
        return cls(sections, share, found)

    def __post_init__(self) -> None:
        self.most = math.prod(len(v.knots) for v in self.variables) * self.sections
        self.rest()

    def take(self, first: int, rows: list[tuple[float, ...]]) -> None:
        """NODES in order, or a refusal."""
        inside(first == len(self.rows) and first + len(rows) <= self.most, f"row {first} is out of order")
        for k, row in enumerate(rows):
            inside(all(map(math.isfinite, row)), "a coefficient is not finite")
            sign = ([*self.rows, *rows[: k + 1]][(first + k) % self.sections])[3]
            inside(sign * row[3] > 0.0, f"a0 is {row[3]}")
        self.rows += rows

    def rest(self) -> None:
        """Past signals zero, and no place."""
        self.past = [[0.0, 0.0] for _ in range(self.sections + 1)]
        for v in self.variables:
            v.place = math.nan

    def now(self) -> list[list[float]]:
        """b0 b1 b2 a1 a2 of each section at the place."""
        sums = [[0.0] * 6 for _ in range(self.sections)]
        for corner in product((0, 1), repeat=len(self.variables)):
            weight, node = 1.0, 0
            for up, v in zip(reversed(corner), self.variables, strict=True):
                knot, part = v.weights()[up]
                weight, node = weight * part, node * len(v.knots) + knot
            if weight > 0.0:
                for k, total in enumerate(sums):
                    row = self.rows[node * self.sections + k]
                    sums[k] = [a + weight * b for a, b in zip(total, row, strict=True)]
        return [[b / a0 for b in (b0, b1, b2, a1, a2)] for b0, b1, b2, a0, a1, a2 in sums]

    def step(self, signals: list[float], x: float) -> float:
        """One tick: on to the operating point, then through the sections in direct form I."""
        for v in self.variables:
            v.moved(signals, self.share)
        for k, (b0, b1, b2, a1, a2) in enumerate(self.now()):
            y = b0 * x + b1 * self.past[k][0] + b2 * self.past[k][1]
            y = y - (a1 * self.past[k + 1][0] + a2 * self.past[k + 1][1])
            self.past[k] = [x, self.past[k][0]]
            x = y
        self.past[-1] = [x, self.past[-1][0]]
        return x
