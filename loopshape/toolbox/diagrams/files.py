"""A block diagram in a file, with a run's FRFs in the place of its plants: what `check` and `tune` read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from loopshape.core.errors import WrongUseError
from loopshape.data.algebra.operations import channels
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.io.config_table import ConfigTable, read_words
from loopshape.io.run.run_tables import CONTROLLER_KEYS
from loopshape.io.schema import read
from loopshape.io.write.frfs import read_all_loops, read_frfs
from loopshape.toolbox.diagrams.diagram import Diagram, Part

FORMAT = "loopshape-diagram/1"
_KEYS = ("name", "in", "out", "plant", "integrators", "unstable_poles")


def read_diagram(path: Path, run: Path) -> Diagram:
    """The diagram of a file. A plant is a loop of the run (`plant = "x"`), or channels of its matrices.

    FRFs of several plants go together where they have one operating point; a plant with a single one serves all.
    Refuses another format, unknown keys, a loop without FRFs, and operating points that another plant lacks.
    """
    words = read_words(path, FORMAT)
    words.only("format", "name", "rate_hz", "tuned", "sums", "block")
    words.need("rate_hz", "tuned", "sums", "block")
    rate_hz, sums = words.positive("rate_hz"), words.inner("sums")
    parts = [_part(table, rate_hz, run) for table in words.tables("block")]
    most = max((one.plants for one in parts), key=len, default=())
    made = [_ordered(one, most) for one in parts]
    return Diagram(
        tuple(made), {name: sums.text(name) for name in sums.table}, words.text("tuned"), words.text("name", "")
    )


def _part(words: ConfigTable, rate_hz: float, run: Path) -> Part:
    words.only(*_KEYS, *CONTROLLER_KEYS)
    words.need("name", "in", "out")
    what: Any = None
    if "plant" in words.table and "controller" in words.table:
        raise WrongUseError(f"{words.where}: a block is a plant or a controller", "both", "leave one out")
    if "plant" in words.table:
        what = _plants(words, run)
    elif "controller" in words.table:
        own = {key: value for key, value in words.table.items() if key in ("name", *CONTROLLER_KEYS)}
        what = read(Controller, own, words.where, rate_hz=rate_hz)
    poles = [words.whole(key, 0) if key in words.table else None for key in ("integrators", "unstable_poles")]
    return Part(words.text("name"), _signals(words, "in"), _signals(words, "out"), what, poles[0], poles[1])


def _signals(words: ConfigTable, key: str) -> tuple[str, ...]:
    return (words.text(key),) if isinstance(words.table[key], str) else words.list_of_texts(key)


def _plants(words: ConfigTable, run: Path) -> tuple[FRF, ...]:
    if isinstance(words.table["plant"], str):
        name = words.text("plant")
        found = tuple(frf for frf in read_frfs(run) if frf.loop == name)
        if not found:
            known = dict.fromkeys(frf.loop for frf in read_frfs(run))
            raise WrongUseError(f"{words.where}: the run has no FRF of this loop", name, f"it has {', '.join(known)}")
        return found
    picked = words.inner("plant")
    picked.only("inputs", "outputs")
    inputs, outputs = picked.list_of_texts("inputs"), picked.list_of_texts("outputs")
    return tuple(channels(frf, outputs, inputs) for frf in read_all_loops(run))


def _ordered(one: Part, points: Sequence[FRF]) -> Part:
    """A plant's FRFs in the order of the operating points."""
    if len(one.plants) < 2:
        return one
    by_point = {tuple(sorted(frf.operating_point.items())): frf for frf in one.plants}
    found = [by_point.get(tuple(sorted(at.operating_point.items()))) for at in points]
    if None in found:
        raise WrongUseError(
            f"plant {one.name} was not measured at every operating point of the others",
            f"{len(one.plants)} FRFs, {len(points)} points", "measure it there, or leave those points out of the run",
        )  # fmt: skip
    return Part(one.name, one.inputs, one.outputs, tuple(f for f in found if f), one.integrators, one.unstable_poles)
