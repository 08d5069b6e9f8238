"""The controllers of a block diagram as blocks that a target runs: sums of signals through sections."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.signal.experiment import LoopSetup
from loopshape.toolbox.diagrams.diagram import Diagram, Part
from loopshape.toolbox.diagrams.wired import Wired
from loopshape.toolbox.rig.target.frames import LONGEST_PAYLOAD

MOST_STATES = 600


@dataclass(frozen=True, eq=False)
class Block:
    """`terms` (signal, weight) added up through `sections` (n, 5), `delay` computations late, every so many ticks."""

    terms: tuple[tuple[int, float], ...]
    sections: Array
    delay: int = 0
    every: int = 1

    def payload(self, index: int) -> bytes:
        """Payload of BLOCK. Refuses what does not fit into one message."""
        out = struct.pack("<BBHB", index, self.every, self.delay, len(self.terms))
        out += b"".join(struct.pack("<Bd", *term) for term in self.terms)
        out += struct.pack("<B", len(self.sections)) + np.asarray(self.sections, "<f8").tobytes()
        if len(out) > LONGEST_PAYLOAD:
            raise WrongUseError("a block fits into one message", f"{len(out)} bytes", "use fewer sections or signals")
        return out


def blocks(wired: Wired, loops: Sequence[LoopSetup], rate_hz: float) -> tuple[tuple[Block, ...], dict[str, int]]:
    """The blocks in an order in which each knows what it reads, and by loop the block that gives its z.

    Refuses columns that no loop has, blocks without a controller, taps that look ahead, a circle without a delay, and
    rates that are no whole part of the target's.
    """
    every, signals = _every(wired.diagram, rate_hz), _Signals(wired, _sources(wired, loops))
    given = {loop.name: name for loop in loops if (name := wired.gives(loop)) is not None}
    parts = signals.order(given.values())
    number = {**signals.source, **{p.outputs[0]: 2 * len(loops) + k for k, p in enumerate(parts)}}
    made = [_block(p, signals.terms(p.inputs[0]), number, every) for p in parts]
    outputs = {}
    for loop, signal in given.items():
        terms = signals.terms(signal)
        if list(terms.values()) == [1.0] and (only := next(iter(terms))) not in signals.source:
            outputs[loop] = number[only] - 2 * len(loops)
        else:
            outputs[loop] = len(made)
            made.append(Block(_weights(terms, number), np.zeros((0, 5)), 0, every))
    return tuple(made), outputs


def own_radius(made: Sequence[Block], first: int) -> float | None:
    """The largest |z| of the poles of blocks that read each other, alone: references and outputs at rest.

    `first` is the number of the first block's signal. Above 1 (beyond an integrator's rounding) the blocks are unstable
    by themselves. None where there are more than `MOST_STATES` states, which takes too long.
    """
    sizes = [2 * len(one.sections) + one.delay for one in made]
    if (n := sum(sizes)) == 0 or n > MOST_STATES:
        return None if n else 0.0
    starts = np.cumsum([0, *sizes])
    states = [np.eye(n)[a:b] for a, b in pairwise(starts)]
    values = [state[-1] if one.delay else np.zeros(n) for one, state in zip(made, states, strict=True)]
    after = []
    for k, (one, state) in enumerate(zip(made, states, strict=True)):
        total = sum((w * values[s - first] for s, w in one.terms if s >= first), np.zeros(n))
        moved = []
        pairs = state[: 2 * len(one.sections)].reshape(-1, 2, n)
        for (b0, b1, b2, a1, a2), (s1, s2) in zip(one.sections, pairs, strict=True):
            out = b0 * total + s1
            moved += [b1 * total - a1 * out + s2, b2 * total - a2 * out]
            total = out
        if one.delay:
            moved += [total, *state[2 * len(one.sections) : -1]]
        else:
            values[k] = total
        after += moved
    return float(np.abs(np.linalg.eigvals(np.array(after))).max())


def _sources(wired: Wired, loops: Sequence[LoopSetup]) -> dict[str, int]:
    """Numbers of the signals that are references and outputs."""
    columns: dict[str | None, int] = {}
    for k, loop in enumerate(loops):
        columns.setdefault(loop.reference, k)
        columns.setdefault(loop.output, len(loops) + k)
    known = {*columns, *(loop.control for loop in loops), None}
    if unknown := [f"{name} is {column}" for name, column in wired.columns.items() if column not in known]:
        raise WrongUseError(
            "a signal is wired to no loop's column", ", ".join(unknown), f"use {', '.join(sorted(filter(None, known)))}"
        )
    return {name: columns[column] for name, column in wired.columns.items() if column in columns and column}


class _Signals:
    """What a diagram's signals are made of: references, outputs and controllers' outputs, with weights."""

    def __init__(self, wired: Wired, source: Mapping[str, int]) -> None:
        self.source, self._wired = source, wired
        self._parts = {p.outputs[0]: p for p in wired.diagram.parts if isinstance(p.what, Controller)}

    def terms(self, signal: str) -> dict[str, float]:
        """Weights by name; refuses what is not known on the target."""
        if signal in self.source or signal in self._parts:
            return {signal: 1.0}
        if signal in self._wired.columns and signal in self._wired.diagram.external:
            return {}
        if not (terms := self._wired.diagram.terms(signal)):
            raise WrongUseError(
                "a signal of the diagram is not known on the target", self._described(signal),
                "wire it to a loop's reference or output, or to None where nothing moves it",
            )  # fmt: skip
        out: dict[str, float] = {}
        for sign, name in terms:
            for one, weight in self.terms(name).items():
                out[one] = out.get(one, 0.0) + sign * weight
        return {name: weight for name, weight in out.items() if weight != 0.0}

    def order(self, signals: Iterable[str]) -> list[Part]:
        """Controllers that lead to these signals, each behind those that it reads at once."""
        reads: dict[str, set[str]] = {}
        left = {name for signal in signals for name in self.terms(signal) if name in self._parts}
        while left:
            name = left.pop()
            reads[name] = {one for one in self.terms(self._parts[name].inputs[0]) if one in self._parts}
            left |= reads[name] - set(reads)
        known, found = {name for name in reads if self._parts[name].delay_samples}, []
        while rest := [name for name in self._parts if name in reads and name not in found]:
            if not (ready := [name for name in rest if reads[name] <= known]):
                names = ", ".join(self._parts[name].name for name in rest)
                raise WrongUseError("controllers alone close a circle", names, "put a delay into it")
            found.append(ready[0])
            known.add(ready[0])
        return [self._parts[name] for name in found]

    def _described(self, signal: str) -> str:
        maker = next((p for p in self._wired.diagram.parts if signal in p.outputs), None)
        what = "comes from outside" if maker is None else f"is what {maker.name} gives"
        return f"{signal} {what}"


def _weights(terms: Mapping[str, float], number: Mapping[str, int]) -> tuple[tuple[int, float], ...]:
    return tuple((number[name], weight) for name, weight in terms.items()) or ((0, 0.0),)


def _block(part: Part, terms: Mapping[str, float], number: Mapping[str, int], every: int) -> Block:
    assert isinstance(part.what, Controller)
    asked = part.what.computation_delay_s * part.what.rate_hz
    if abs(asked - part.delay_samples) > 1e-6 or asked > 65535.5:
        raise WrongUseError(
            f"the delay of {part.name} is no whole number of its samples up to 65535", f"{asked:g}", "take the next one"
        )
    return Block(_weights(terms, number), part.what.biquads(), part.delay_samples, every)


def _every(D: Diagram, rate_hz: float) -> int:
    every = rate_hz / D.rate_hz
    if not 0.5 < every < 255.5 or abs(every - round(every)) > 1e-9 * every:
        raise WrongUseError(
            "a diagram runs at the target's rate or a whole part of it",
            f"{D.rate_hz:g} Hz, the target {rate_hz:g} Hz", "tune it at such a rate",
        )  # fmt: skip
    return round(every)
