"""Blocks of the target in Python, from docs/protocol.md alone: diagrams as they come, and as they run."""

import math
from collections import deque
from dataclasses import dataclass

from python_target_schedule import RefusedError, fields, inside


def biquad(section: tuple[float, ...], state: list[float], x: float) -> float:
    """Transposed direct form II."""
    b0, b1, b2, a1, a2 = section
    y = b0 * x + state[0]
    state[0] = b1 * x - a1 * y + state[1]
    state[1] = b2 * x - a2 * y
    return y


@dataclass
class Block:
    """A weighted sum of signals through sections, so many computations late, at every so many-th tick."""

    every: int
    delay: int
    terms: list[tuple[int, float]]
    sections: list[tuple[float, ...]]

    @classmethod
    def read(cls, payload: bytes, signals: int) -> "Block":
        """BLOCK, or the refusal that it earns."""
        if len(payload) < 6:
            raise RefusedError(2, "too short")
        _, every, delay, count = fields("BBHB", payload[:5])
        end = 5 + 9 * count
        terms = [fields("Bd", payload[k : k + 9]) for k in range(5, end, 9)]
        if len(payload) <= end:
            raise RefusedError(2, "no number of sections")
        numbers = fields(f"{5 * payload[end]}d", payload[end + 1 :])
        inside(every > 0 and count > 0, f"every {every}, {count} terms")
        inside(all(signal < signals and math.isfinite(weight) for signal, weight in terms), f"terms {terms}")
        inside(all(map(math.isfinite, numbers)), "a coefficient is not finite")
        return cls(every, delay, terms, [numbers[k : k + 5] for k in range(0, len(numbers), 5)])

    def rest(self) -> None:
        """All that it remembers is zero, and it is its turn."""
        self.states = [[0.0, 0.0] for _ in self.sections]
        self.late, self.value, self.wait = deque([0.0] * self.delay), 0.0, 0


def known(blocks: list[Block], first: int) -> bool:
    """Whether each block reads what is known before it."""
    read = [(k, signal - first) for k, one in enumerate(blocks) for signal, _ in one.terms if signal >= first]
    return all(b < len(blocks) and (b < k or blocks[b].delay > 0) for k, b in read)


def turn(blocks: list[Block], signals: list[float]) -> list[float]:
    """What all blocks give at this tick, from references and outputs."""
    for one in blocks:
        if one.wait == 0 and one.delay:
            one.value = one.late.popleft()
    for one in blocks:
        if one.wait:
            one.wait -= 1
            continue
        one.wait = one.every - 1
        total = 0.0
        for signal, weight in one.terms:
            total += weight * (signals[signal] if signal < len(signals) else blocks[signal - len(signals)].value)
        for section, state in zip(one.sections, one.states, strict=True):
            total = biquad(section, state, total)
        if one.delay:
            one.late.append(total)
        else:
            one.value = total
    return [one.value for one in blocks]
