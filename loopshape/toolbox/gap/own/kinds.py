"""A user's own kinds of effects: a force in a file of the user's, composed around any model, whatever it came from."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.toolbox.gap.nouns.machine import Kind, Model, ModelParameter
from loopshape.toolbox.gap.own import kernel


def with_kinds(model: Model, kinds: Sequence[Kind]) -> Model:
    """The model with a force a kind; each is `name@port`, and 0 where its first number is."""
    for kind in kinds:
        model = _with(model, kind)
    return model


def _with(model: Model, kind: Kind) -> Model:
    port = next((p for p in model.ports if p.name == kind.port), None)
    if port is None:
        ports = ", ".join(p.name for p in model.ports)
        raise WrongUseError(f"kind {kind.name} acts at a port of {model.name}", f"{kind.port!r}", f"it has {ports}")
    drive = [i.name for i in model.inputs].index(port.input)
    motion = _pushed(model.motion, kind.force, drive, *(model.states.index(s) for s in (port.position, port.speed)))
    numbers = _numbers(kind)
    law = None if model.law is None else _within(model.law)
    return replace(model, motion=motion, parameters=(*model.parameters, *numbers), derived=_both(model), law=law)


def _within(law: Callable[..., Any]) -> Callable[..., Any]:
    """The laws of actuators; p is what the model had, and the kind's numbers."""
    base = kernel.compiled(law)

    def within(j, q, v, x, u, p):  # type: ignore[no-untyped-def]
        return base(j, q, v, x, u, p[0])

    return within


def _numbers(kind: Kind) -> list[ModelParameter]:
    """The kind's numbers as parameters: the first is its magnitude, the second may change with it, the rest stay."""
    names = [f"{kind.name}_{n.name}" for n in kind.numbers]
    first = replace(kind.numbers[0], name=names[0], effect=f"{kind.name}@{kind.port}", shaped_by=(names[1:] or [""])[0])
    rest = [replace(n, name=name, effect="none") for n, name in zip(kind.numbers[1:], names[1:], strict=True)]
    return [first, *rest]


def _pushed(motion: Callable[..., Any], force: Callable[..., Any], drive: int, q: int, v: int) -> Callable[..., Any]:
    """The right-hand side less a force at an input; p is what the model had, and the kind's numbers."""
    base, against = kernel.compiled(motion), kernel.compiled(force)

    def pushed(t, x, u, p):  # type: ignore[no-untyped-def]
        left = u.copy()
        left[drive] -= against(x[q], x[v], p[1])
        return base(t, x, left, p[0])

    return pushed


def _both(model: Model) -> Callable[[tuple[float, ...]], Any]:
    """What the model derives of its own values, and the values behind them."""
    count = len(model.parameters)
    named = namedtuple("Parameters", [p.name for p in model.parameters] or ["none"])  # type: ignore[misc]
    own = model.derived or (lambda values: named(*(values or (0.0,))))

    def both(values: tuple[float, ...]) -> Any:
        return own(values[:count]), values[count:]

    return both
