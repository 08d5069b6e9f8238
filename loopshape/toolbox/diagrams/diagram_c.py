"""A block diagram's controllers in C99: a header for each, and one that steps them all with the sums between them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from loopshape.core.errors import WrongUseError
from loopshape.data.control.controller import Controller
from loopshape.io.files import write_json, write_text_whole
from loopshape.toolbox.diagrams.diagram import Diagram, Part
from loopshape.toolbox.formats.controllers.controller_export import export_controllers
from loopshape.toolbox.formats.controllers.controller_words import identifier


def export_diagram(folder: Path, D: Diagram, to: str) -> tuple[Path, ...]:
    """Write a diagram's controllers and, as `diagram.h` or `diagram.json`, what leads from one to the other.

    The step takes what is measured (plants' outputs, or sums of nothing else) and what comes from outside, taps of a
    feedforward included, for they look ahead; it gives what enters the plants. A delay of whole samples
    (`Part.delay_samples`) runs as a delay line behind its block, as in `ls.diagrams.simulate`; any other is left to the
    target. Refuses other formats, blocks without a controller, circles of controllers alone, and fixed point.
    """
    if to not in ("c", "json"):
        raise WrongUseError("a diagram is exported in C or JSON", repr(to), "use c or json, or export its controllers")
    if empty := [p.name for p in D.parts if p.what is None]:
        raise WrongUseError("a block of the diagram has no controller yet", ", ".join(empty), "D.with_part(name, C)")
    own = controllers_of(D)
    if any(c.number_format.fixed for c in own):
        raise WrongUseError("a diagram is exported in floating point", "fixed point", "export its controllers alone")
    text = _header(D) if to == "c" else ""
    made = export_controllers(folder, own, to)
    path = folder / f"diagram.{'h' if to == 'c' else 'json'}"
    if to == "c":
        write_text_whole(path, text)
    else:
        write_json(path, {"format": "loopshape-diagram-export/1", **D.to_dict()})
    return (*made, path)


def controllers_of(D: Diagram) -> tuple[Controller, ...]:
    """The controllers of a diagram under the names of their blocks."""
    return tuple(replace(p.what, loop=p.name) for p in D.parts if isinstance(p.what, Controller))


def _header(D: Diagram) -> str:
    steps = _Steps(D)
    outputs = list(dict.fromkeys(name for p in D.parts if p.plants for name in p.inputs))
    for name in outputs:
        steps.value(name)
    steps.fill()
    loops = [p.name for p in D.parts if isinstance(p.what, Controller)]
    delays = {identifier(p.name): p.delay_samples for p in D.parts if p.delay_samples}
    lines = [f'#include "{identifier(name)}.h"' for name in loops]
    lines += [
        "",
        "typedef struct {",
        *(f"    {identifier(n)}_state {identifier(n)};" for n in loops),
        *(
            f"    double {n}_line[{many}];  /* a delay of {many} samples */\n    int {n}_at;"
            for n, many in delays.items()
        ),
        "} diagram_state;",
    ]
    lines += ["", "typedef struct {", *(f"    double {n};" for n in steps.inputs), "} diagram_inputs;"]
    lines += ["", "typedef struct {", *(f"    double {n};" for n in outputs), "} diagram_outputs;"]
    lines += ["", "/* To rest: the states of all controllers become zero. */"]
    lines += ["static inline void diagram_reset(diagram_state *state)", "{"]
    lines += [*(f"    {identifier(n)}_reset(&state->{identifier(n)});" for n in loops)]
    lines += [
        f"    for (state->{n}_at = {many}; state->{n}_at > 0; state->{n}_line[--state->{n}_at] = 0.0) {{\n    }}"
        for n, many in delays.items()
    ] + ["}"]
    lines += ["", "/* One sample: what is measured and comes from outside in, what enters the plants out. */"]
    lines += ["static inline void diagram_step(diagram_state *state, const diagram_inputs *in, diagram_outputs *out)"]
    lines += ["{", *steps.lines, *(f"    out->{n} = {steps.value(n)};" for n in outputs), "}"]
    return "\n".join(["#ifndef DIAGRAM_H", "#define DIAGRAM_H", "", *lines, "", "#endif", ""])


class _Steps:
    """Lines of the step, in the order in which signals are known."""

    def __init__(self, D: Diagram) -> None:
        self.D = D
        self.lines: list[str] = []
        self.inputs: list[str] = []
        self.known: dict[str, str] = {}
        self.under_way: set[str] = set()
        self.delays: list[Part] = []

    def value(self, signal: str) -> str:
        """How a signal is written, after the lines that make it."""
        if signal in self.known:
            return self.known[signal]
        if signal in self.under_way:
            raise WrongUseError("controllers alone close a circle", signal, "put them together as one filter")
        self.under_way.add(signal)
        maker = next((p for p in self.D.parts if signal in p.outputs), None)
        if self._measured(signal) or signal in self.D.external or (maker and not isinstance(maker.what, Controller)):
            self.inputs.append(signal)
            self.known[signal] = f"in->{signal}"
            return self.known[signal]
        if maker is not None and maker.delay_samples:
            name = identifier(maker.name)
            self.lines.append(f"    const double s_{signal} = state->{name}_line[state->{name}_at];")
            self.delays.append(maker)
        elif maker is not None:
            name, into = identifier(maker.name), self.value(maker.inputs[0])
            self.lines.append(f"    const double s_{signal} = {name}_step(&state->{name}, {into});")
        else:
            terms = [(sign, self.value(name)) for sign, name in self.D.terms(signal)]
            text = " ".join(f"{'-' if sign < 0 else '+'} {name}" for sign, name in terms).removeprefix("+ ")
            self.lines.append(f"    const double s_{signal} = {text};")
        self.known[signal] = f"s_{signal}"
        return self.known[signal]

    def fill(self) -> None:
        """Lines that put this sample into each delay line that was read; what fills one may read another."""
        for one in self.delays:  # grows on the way
            self.value(one.inputs[0])
        for one in self.delays:
            name, into = identifier(one.name), self.value(one.inputs[0])
            self.lines.append(f"    state->{name}_line[state->{name}_at] = {name}_step(&state->{name}, {into});")
            self.lines.append(f"    state->{name}_at = (state->{name}_at + 1) % {one.delay_samples};")

    def _measured(self, signal: str) -> bool:
        """Whether it is a plant's output or a sum of nothing else."""
        if any(signal in p.outputs and p.plants for p in self.D.parts):
            return True
        terms = self.D.terms(signal)
        return bool(terms) and all(self._measured(name) for _, name in terms)
