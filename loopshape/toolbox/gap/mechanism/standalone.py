"""A fitted effect as Python that stands alone: numpy and the fitted numbers, nothing of this package.

The text is made of the equations that were fitted: the kernel's own with the numbers that are 0 folded away, and of
signals the table beside them.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

from loopshape.toolbox.gap.nouns.effect import Fix
from loopshape.toolbox.gap.nouns.machine import Model, Port
from loopshape.toolbox.gap.own import kernel
from loopshape.toolbox.gap.own.composed import INPUT, NEUTRAL, OUTPUT, PORT
from loopshape.toolbox.gap.own.signals import ACTUATOR, SAMPLE, SENSOR

_CALL = "(position, speed, command, t, state)"
_HEAD = '''"""What a gap diagnosis found missing in {model}, as plain Python: {of}.

Equation: {form}{source}.{given}

`PARAMETERS` are new values of the model's own parameters. Every function gives what to add to the signal named in its
first line: position and speed at the place, `command` the input there (of a sensor its reading), t in s. `state` is a
dict that is its memory: empty at first, one for each function and simulation. Call it once a step, in equal steps, and
hold what it gives; only a function that leaves `state` empty can be called by a solver that goes back in time.
"""

import numpy as np

PARAMETERS = {parameters}
'''
_BRISTLES = """
mean = 0.5 * (speed + state.get("speed", speed))
most = BRISTLE * level(mean) / COULOMB
kept = np.exp(-abs(mean) * dt / most)
bend = state["bend"] = kept * state.get("bend", 0.0) + (1.0 - kept) * most * np.sign(mean)
"""
_MOTOR = """
motor, spin = state.get("motor", position), state.get("spin", speed)
steps, through = max(1, int(np.ceil(dt / 1e-4))), 0.0
h = dt / steps
for k in range(steps):  # the motor through the step to come, from which the link gets the mean
    force = coupled(motor + 0.5 * h * spin - position - (k + 0.5) * h * speed, spin - speed)
    spin += h * (command - MOTOR_DAMPING * spin - force) / INERTIA
    motor += h * spin
    through += force / steps
state["motor"], state["spin"] = motor, spin
"""


def function_file(fix: Fix, model: Model, names: Collection[str]) -> str:
    """Python of the parameters of a fix that are named: new values, and a function a place."""
    moves = {c.parameter: c.new for c in fix.parameters if c.parameter in names}
    parameters = [c for c in fix.parameters if c.parameter in names and c.parameter in model.values()]
    rows = [f"    {c.parameter!r}: {c.new!r},  # {c.old:.9g}, {_plain(c.unit)}" for c in parameters]
    head = _HEAD.format(
        model=_plain(model.name), of=_plain(fix.of), form=_plain(fix.form),
        source=f" ({_plain(fix.source)})" if fix.source else "",
        given="" if fix.file is None else "\nThe patched model beside this file holds the rest of the change.",
        parameters="\n".join(["{", *rows, "}"]) if rows else "{}",
    )  # fmt: skip
    return "\n\n".join([head, *_functions(model, moves)])


def _functions(model: Model, moves: Mapping[str, float]) -> Iterator[str]:
    for port in model.ports:
        if n := numbers_of(moves, PORT, port.name):
            yield _force(port, {**dict.fromkeys(kernel.FIELDS, 0.0), **NEUTRAL, **n})
    for at, places, neutral in ((INPUT, model.inputs, ACTUATOR), (OUTPUT, model.outputs, SENSOR)):
        for place in places:
            if n := numbers_of(moves, at, place.name):
                yield _signal(at, place, {k: v for k, (v, _) in neutral.items()}, n)


def numbers_of(moves: Mapping[str, float], at: str, name: str) -> dict[str, float]:
    """What moved at a port, an input or a sensor, by its own name there."""
    start = f"{at}.{name}."
    return {k.removeprefix(start): v for k, v in moves.items() if k.startswith(start)}


def _force(port: Port, n: Mapping[str, float]) -> str:
    """What acts at a port, as a function of its position and speed."""
    parts, lines, terms = list[Callable[..., Any]](), [""], list[str]()
    if bent := n.get("bristle", 0.0) > 0.0 and n.get("coulomb", 0.0) > 0.0:
        lines.append(_BRISTLES)
    coupled = n.get("inertia", 0.0) > 0.0
    if any(n.get(key) for key in ("coulomb", "load", "driven_back", "load_square")):
        parts += [kernel.level, kernel.friction]
        terms.append(f"-friction(speed, {'bend' if bent else '0.0'}, {'through' if coupled else 'command'})")
    if n.get("viscous") or n.get("stiffness") or n.get("offset"):
        parts.append(kernel.resisting)
        terms.append("-resisting(position, speed)")
    if coupled:
        parts.append(kernel.coupled)
        lines.append(_MOTOR)
        terms.insert(0, "through - command")
    if bent or coupled:
        lines[0] = 'dt = max(t - state.get("t", t), 0.0)'
        lines.append('state["t"], state["speed"] = t, speed')
    body = [f"{ast.unparse(_Folded(n).visit(_tree(part)))}\n" for part in parts]
    reads = "; sensors and a law of the actuator read state['motor'] and state['spin']" if coupled else ""
    reads += "; command is what the actuator gives" if port.input.endswith("_effort") else ""
    title = (
        f"Force to add to {_plain(port.input)}, in {_plain(port.unit) or 'its unit'}, at {_plain(port.name)}{reads}."
    )
    return _function(f"force_at_{_identifier(port.name)}", title, n, [*body, *lines, f"return {' '.join(terms)}"])


def _signal(at: str, place: Any, neutral: Mapping[str, float], moved: Mapping[str, float]) -> str:
    """What an actuator makes of its command, or a sensor of the truth, sample by sample."""
    n = {**neutral, **moved}
    first, done = ["value = command"], [SAMPLE[k] for k in SAMPLE if k in moved and not (k == "limit" and n["knee"])]
    if "lag_ms" in moved:
        first.append('dt, state["t"] = max(t - state.get("t", t), 0.0), t')
    what, name = ("command of", "command_of") if at == INPUT else ("reading of", "reading_of")
    title = f"Change of the {what} {_plain(place.name)}, in {_plain(place.unit) or 'its unit'}."
    lines = [*first, *done, "return value - command"]
    return _function(f"{name}_{_identifier(place.name)}", title, n, lines)


def _function(name: str, title: str, n: Mapping[str, float], parts: Sequence[str]) -> str:
    """A function of these lines, with the numbers that they use at its head."""
    body = "\n".join(textwrap.dedent(part).lstrip("\n").rstrip(" ") for part in parts if part)
    used = {node.id for node in ast.walk(ast.parse(f"def f():\n{textwrap.indent(body, '    ')}"))
            if isinstance(node, ast.Name)}  # fmt: skip
    numbers = [f"{key.upper()} = {float(value)!r}" for key, value in n.items() if key.upper() in used]
    text = "\n".join([f'"""{title}"""', *numbers, *([""] if body.startswith("def ") else []), body])
    return f"def {name}{_CALL}:\n{textwrap.indent(text, '    ')}\n"


def _tree(function: Callable[..., Any]) -> ast.FunctionDef:
    """A compiled function of the kernel as it was written, without numba, types and its docstring."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(getattr(function, "py_func", function)))).body[0]
    assert isinstance(tree, ast.FunctionDef)
    tree.decorator_list, tree.returns, tree.args.args, tree.body = [], None, tree.args.args[2:], tree.body[1:]
    for argument in tree.args.args:
        argument.annotation = None
    return tree


class _Folded(ast.NodeTransformer):
    """A kernel's function of a port's numbers `f[j, NAME]`: names for numbers, and what vanishes left out."""

    def __init__(self, numbers: Mapping[str, float]) -> None:
        self._numbers = numbers

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        """What is behind a return that the numbers decided, left out."""
        self.generic_visit(node)
        ends = [k for k, line in enumerate(node.body) if isinstance(line, ast.Return)]
        node.body = node.body[: ends[0] + 1]
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        """f[j, NAME] as the number's name, or as 0."""
        assert isinstance(node.slice, ast.Tuple)
        assert isinstance(node.slice.elts[1], ast.Name)
        key = kernel.FIELDS[getattr(kernel, node.slice.elts[1].id)]
        return ast.Name(key.upper(), ast.Load()) if self._numbers.get(key, 0.0) != 0.0 else ast.Constant(0.0)

    def visit_Call(self, node: ast.Call) -> ast.Call:
        """Calls within the kernel without the port's numbers."""
        if isinstance(node.func, ast.Name) and hasattr(kernel, node.func.id):
            node.args = node.args[2:]
        self.generic_visit(node)
        return node

    def visit_If(self, node: ast.If) -> ast.If | list[ast.stmt]:
        """A branch that the numbers decide, decided."""
        self.generic_visit(node)
        known = {key.upper(): value for key, value in self._numbers.items()}
        try:
            holds = eval(compile(ast.Expression(ast.fix_missing_locations(node.test)), "", "eval"), {}, known)
        except NameError:
            return node
        return node.body if holds else node.orelse

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Products with 0 and 1, sums and differences with 0."""
        self.generic_visit(node)
        left, right = (getattr(side, "value", None) for side in (node.left, node.right))
        if isinstance(node.op, ast.Mult) and 0.0 in (left, right):
            return ast.Constant(0.0)
        if right == (1.0 if isinstance(node.op, ast.Mult) else 0.0) and isinstance(
            node.op, ast.Mult | ast.Add | ast.Sub
        ):
            return node.left
        if left == (1.0 if isinstance(node.op, ast.Mult) else 0.0) and isinstance(node.op, ast.Mult | ast.Add):
            return node.right
        return node


def _identifier(name: str) -> str:
    return re.sub(r"\W", lambda found: f"_{ord(found[0]):x}_", name)


def _plain(text: str) -> str:
    """A user's word in one line of a text that quotes end."""
    return "".join(c if c.isprintable() and c not in '"\\' else "_" for c in text)
