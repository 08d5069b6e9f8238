"""A warm start: an existing controller's blocks as a point of the structure to be tuned."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.control.block import BlockTemplate, Free
from loopshape.data.control.controller import Block, Controller
from loopshape.design.problem.problem import Problem


def warm_start(p: Problem, controller: Controller) -> tuple[Array, tuple[str, ...]]:
    """x of the structure nearest to a controller, and what had to be moved for it.

    The k-th block of a kind stands for the structure's k-th of that kind; blocks in series commute, so the order of
    kinds does not matter. Values outside bounds go to the bound, fixed and tied parameters to what the structure says.
    Refuses a controller with other kinds or numbers of blocks.
    """
    have, want = _kinds(controller.blocks), _kinds(p.templates)
    if have != want:
        raise WrongUseError(
            f"the controller to start from does not fit the structure of loop {p.requirements.loop!r}",
            f"it has {_words(have)}",
            f"the structure has {_words(want)}: bring the one or the other in line",
        )
    mine = _in_order(p.templates, controller.blocks)
    notes = [note for template, block in zip(p.templates, mine, strict=True) for note in _moved(template, block)]
    x = np.log([min(max(_value(mine[v.block], v.name), v.low), v.high) for v in p.variables])
    return x, tuple(notes)


def _value(block: Block, name: str) -> float:
    return block.parameters[name]


def _kinds(blocks: tuple[Block, ...] | tuple[BlockTemplate, ...]) -> dict[str, int]:
    kinds = [block.kind for block in blocks]
    return {kind: kinds.count(kind) for kind in sorted(set(kinds))}


def _words(kinds: dict[str, int]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "no block"


def _in_order(templates: tuple[BlockTemplate, ...], blocks: tuple[Block, ...]) -> list[Block]:
    """Blocks in the templates' order, the k-th of a kind for the k-th."""
    left = {kind: [b for b in blocks if b.kind == kind] for kind in {t.kind for t in templates}}
    return [left[t.kind].pop(0) for t in templates]


def _moved(template: BlockTemplate, block: Block) -> Iterator[str]:
    """What a block loses in a template, a sentence each."""
    for name, value in block.parameters.items():
        wanted, tied = template.parameters.get(name), template.tie.get(name)
        where = f"{name} of the {template.kind} block is {value:.4g}"
        if tied is not None:
            if value != block.parameters[tied]:
                yield f"{where}; the structure ties it to {tied}, {block.parameters[tied]:.4g}"
        elif isinstance(wanted, Free):
            if not wanted.low <= value <= wanted.high:
                yield f"{where}, outside its bounds; started from {min(max(value, wanted.low), wanted.high):.4g}"
        elif wanted != value:
            yield f"{where}; the structure fixes it at {wanted:.4g}"
