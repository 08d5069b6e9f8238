"""A loop's block diagram: blocks from signal to signal, sums of signals, and the one block that is tuned.

Blocks and sums name what they give out; a name that nothing gives out comes from outside (a setpoint, a disturbance).
Signs stand in the sums: a loop that closes through `e = "r - y"` is closed with negative feedback.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.gate import pass_fields
from loopshape.core.json_ready import json_ready
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.toolbox.learning.taps import Feedforward

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from loopshape.data.result.equivalent import Equivalent

_TERM = re.compile(r"\s*([+-]?)\s*([A-Za-z_]\w*)")


@dataclass(frozen=True, eq=False)
class Part:
    """A block of a diagram, from the signals `inputs` to the signals `outputs` (one name each, or several).

    `what` is a measured plant (an FRF, or one for each operating point, channels in the order of the signals), a
    controller or fixed filter (a delay is a gain of 1 with a computation delay), or a feedforward's taps; nothing where
    it is to be tuned. `integrators` and `unstable_poles` are a plant's, where its recordings do not tell;
    `requirements` are those of a controller that closes an inner loop.

    >>> import loopshape as ls
    >>> ls.diagrams.Part("C2", "e", "u2", ls.controller(ls.gain(2.0), rate_hz=1000.0))
    Part C2: e -> u2, Controller: gain at 1000 Hz
    """

    name: str
    inputs: str | Sequence[str]
    outputs: str | Sequence[str]
    what: FRF | Sequence[FRF] | Controller | Feedforward | None = None
    integrators: int | None = None
    unstable_poles: int | None = None
    requirements: Requirements | None = None

    def __post_init__(self) -> None:
        pass_fields(self)
        for name in ("inputs", "outputs"):
            value = getattr(self, name)
            object.__setattr__(self, name, (value,) if isinstance(value, str) else tuple(value))
        if isinstance(self.what, FRF):
            object.__setattr__(self, "what", (self.what,))
        elif isinstance(self.what, Sequence):
            object.__setattr__(self, "what", tuple(self.what))
        shapes = {one.response.shape[1:] for one in self.plants} or {(1, 1)}
        if shapes != {(len(self.outputs), len(self.inputs))}:
            raise WrongUseError(
                f"block {self.name} has another number of signals than channels",
                f"{len(self.outputs)} outputs and {len(self.inputs)} inputs for {sorted(shapes)}",
                "name one signal for each channel, in the FRF's order",
            )

    @property
    def plants(self) -> tuple[FRF, ...]:
        """The FRFs of a plant, one an operating point; none of another block."""
        return self.what if isinstance(self.what, tuple) else ()

    @property
    def delay_samples(self) -> int:
        """Whole samples of delay behind a controller or filter; 0 where its delay is not whole, and of other blocks."""
        if not isinstance(self.what, Controller):
            return 0
        samples = self.what.computation_delay_s * self.what.rate_hz
        return round(samples) if abs(samples - round(samples)) < 1e-6 else 0

    def __repr__(self) -> str:
        """One line: its name, signals and what it is."""
        what = f"{len(self.plants)} FRF{'s' * (len(self.plants) > 1)}" if self.plants else self.what or "to be tuned"
        return f"Part {self.name}: {', '.join(self.inputs)} -> {', '.join(self.outputs)}, {what}"


@dataclass(frozen=True, eq=False)
class Diagram:
    """A block diagram around one controller that is tuned: `parts`, `sums` of signals, and the `tuned` part's name.

    A sum is written `"r - y"`; `name` heads pictures and files. Verbs that take a plant (`ls.check`, `ls.tune`,
    `ls.limits.bound`, `ls.shape`) take a diagram: the plant that the tuned part meets is found from it
    (`ls.diagrams.equivalent`), with the covariance of all that was measured.

    Refuses two makers of one signal, sums of sums in a circle, controllers of several rates, and plants with different
    numbers of operating points.

    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(1.0, 400.0, 80)
    >>> P = ls.FRF.from_arrays(f_hz, 1.0 / (1.0 + 1j * f_hz / 10.0), relative_std=0.01, rate_hz=1000.0)
    >>> ls.diagrams.Diagram((ls.diagrams.Part("C", "e", "u"), ls.diagrams.Part("P", "u", "y", P)), {"e": "r - y"}, "C")
    Diagram: C, P; C is tuned, from outside: r
    """

    parts: tuple[Part, ...]
    sums: Mapping[str, str]
    tuned: str
    name: str = ""
    _terms: Mapping[str, tuple[tuple[float, str], ...]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        pass_fields(self)
        object.__setattr__(self, "parts", tuple(self.parts))
        object.__setattr__(self, "sums", dict(self.sums))
        object.__setattr__(self, "_terms", {name: _terms(name, text) for name, text in self.sums.items()})
        made = Counter([*self.sums, *self.outputs])
        if twice := [name for name, count in made.items() if count > 1]:
            raise WrongUseError("a signal comes from one block or sum", ", ".join(twice), "rename one of them")
        if twice := [name for name, count in Counter(one.name for one in self.parts).items() if count > 1]:
            raise WrongUseError("two blocks have one name", ", ".join(twice), "rename one of them")
        if self.part(self.tuned).plants:
            raise WrongUseError("what is tuned is a controller", f"block {self.tuned} is a plant", "name another block")
        for name in self.sums:
            self._refuse_circle(name, ())
        self._check_rates()

    def _refuse_circle(self, name: str, before: tuple[str, ...]) -> None:
        if name in before:
            raise WrongUseError("sums add each other in a circle", " -> ".join([*before, name]), "write them out")
        for _, term in self._terms.get(name, ()):
            self._refuse_circle(term, (*before, name))

    def _check_rates(self) -> None:
        many = {len(one.plants) for one in self.parts if one.plants}
        if not many or len(many - {1}) > 1:
            raise WrongUseError(
                "the plants of a diagram have one FRF for each operating point", f"{sorted(many)} FRFs",
                "give each plant as many, or one that serves all",
            )  # fmt: skip
        rates = {one.what.rate_hz for one in self.parts if isinstance(one.what, Controller | Feedforward)}
        if len(rates) > 1:
            raise WrongUseError(
                "the controllers of a diagram run at one rate", ", ".join(f"{rate:g} Hz" for rate in sorted(rates)),
                "fold a faster filter into its plant: ls.diagrams.multirate",
            )  # fmt: skip

    def __repr__(self) -> str:
        """One line: its blocks, which one is tuned, and what comes from outside."""
        names = ", ".join(one.name for one in self.parts)
        return (
            f"Diagram{f' {self.name}' if self.name else ''}: {names}; {self.tuned} is tuned, from outside:"
            f" {', '.join(self.external)}"
        )

    def part(self, name: str) -> Part:
        """A block by its name."""
        for one in self.parts:
            if one.name == name:
                return one
        raise WrongUseError("the diagram has no such block", name, f"it has {', '.join(p.name for p in self.parts)}")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Signals that blocks give out, in order."""
        return tuple(name for one in self.parts for name in one.outputs)

    @property
    def external(self) -> tuple[str, ...]:
        """Signals that nothing gives out: setpoints, disturbances."""
        read = [name for terms in self._terms.values() for _, name in terms]
        read += [name for one in self.parts for name in one.inputs]
        return tuple(dict.fromkeys(name for name in read if name not in (*self.sums, *self.outputs)))

    @property
    def points(self) -> int:
        """How many operating points the plants have."""
        return max(len(one.plants) for one in self.parts)

    @property
    def rate_hz(self) -> float:
        """The controllers' rate, else that of the plants."""
        rates = [one.what.rate_hz for one in self.parts if isinstance(one.what, Controller | Feedforward)]
        return max([*rates, *(frf.rate_hz for one in self.parts for frf in one.plants)]) if not rates else rates[0]

    def terms(self, signal: str) -> tuple[tuple[float, str], ...]:
        """Signs and signals that a sum adds; none of another signal."""
        return self._terms.get(signal, ())

    def with_part(self, name: str, what: Controller | Feedforward | Sequence[FRF] | None) -> Diagram:
        """The same with something else in a block: the controller that was tuned, say."""
        self.part(name)
        return replace(self, parts=tuple(replace(p, what=what) if p.name == name else p for p in self.parts))

    def wiring(self) -> tuple[Array, Array]:
        """Signs from all blocks' outputs to all blocks' inputs (inputs, outputs), and from each named signal too.

        The second is (inputs, signals) over `signals`: what something added at a signal does to each input.
        """
        rows = [self.reading(name) for one in self.parts for name in one.inputs]
        return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])

    @property
    def signals(self) -> tuple[str, ...]:
        """All signals: from outside, of blocks, of sums."""
        return (*self.external, *self.outputs, *self.sums)

    def reading(self, signal: str) -> tuple[Array, Array]:
        """What a signal is made of: signs of the blocks' outputs, and of what is added at each of `signals`."""
        if signal not in self.signals:
            raise WrongUseError("the diagram has no such signal", signal, f"it has {', '.join(self.signals)}")
        by_output, by_signal = np.zeros(len(self.outputs)), np.zeros(len(self.signals))
        by_signal[self.signals.index(signal)] = 1.0
        if signal in self.outputs:
            by_output[self.outputs.index(signal)] = 1.0
        for sign, term in self.terms(signal):
            outputs, signals = self.reading(term)
            by_output, by_signal = by_output + sign * outputs, by_signal + sign * signals
        return by_output, by_signal

    def followers(self, without: Iterable[str] = ()) -> dict[str, set[str]]:
        """Blocks that each block drives directly; those of `without` are taken out."""
        out = set(without)
        makers = {name: one.name for one in self.parts for name in one.outputs}
        found: dict[str, set[str]] = {one.name: set() for one in self.parts if one.name not in out}
        for one in self.parts:
            if one.name in out:
                continue
            for by_output, _ in map(self.reading, one.inputs):
                sources = {makers[self.outputs[k]] for k in np.flatnonzero(by_output)}
                for source in sources - out:
                    found[source].add(one.name)
        return found

    def in_circle(self, name: str, without: Iterable[str] = ()) -> set[str]:
        """Blocks on a circle through a block (that block too), with those of `without` taken out; none without one."""
        after = self.followers(without)
        reachable = {one: _reached(after, one) for one in after}
        return {one for one in reachable[name] if name in reachable[one]}

    def equivalent(self) -> Equivalent:
        """What `ls.diagrams.equivalent` finds."""
        from loopshape.toolbox.diagrams.equivalent import equivalent

        return equivalent(self)

    def figure(self) -> Figure:
        """The diagram, plants blue and the tuned block orange, in a figure of its size."""
        from loopshape.toolbox.diagrams.picture import diagram
        from loopshape.view.style import figure_of

        return figure_of(diagram(self))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: the diagram with what stands in its blocks."""
        parts = [_part_table(one) for one in self.parts]
        return {"name": self.name, "tuned": self.tuned, "sums": dict(self.sums), "parts": parts}


def _reached(after: Mapping[str, set[str]], name: str) -> set[str]:
    found: set[str] = set()
    left = [*after[name]]
    while left:
        one = left.pop()
        if one not in found:
            found.add(one)
            left += after[one]
    return found


def _terms(name: str, text: str) -> tuple[tuple[float, str], ...]:
    """Signs and names of a sum; refuses what is neither."""
    found, at = [], 0
    while match := _TERM.match(text, at):
        if at and not match[1]:
            break
        found.append((-1.0 if match[1] == "-" else 1.0, match[2]))
        at = match.end()
    if not found or text[at:].strip():
        raise WrongUseError(f"the sum {name} is signals with signs", repr(text), 'write it as "r - y"')
    return tuple(found)


def _part_table(one: Part) -> dict[str, Any]:
    table: dict[str, Any] = {"name": one.name, "in": list(one.inputs), "out": list(one.outputs)}
    if one.plants:
        table["plant"] = [{"recording": p.recording, "loop": p.loop, "digest": p.digest} for p in one.plants]
    elif isinstance(one.what, Controller):
        c = one.what
        blocks = [block.to_table() for block in c.blocks]
        table["controller"] = {"rate_hz": c.rate_hz, "digest": c.digest, "blocks": blocks}
        table["controller"]["computation_delay_s"] = c.computation_delay_s
    elif isinstance(one.what, Feedforward):
        table["feedforward"] = one.what.to_dict()
    made: dict[str, Any] = json_ready(table, None)
    return made
