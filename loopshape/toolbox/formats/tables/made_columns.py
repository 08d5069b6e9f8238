"""Columns that a map makes of other columns: sums with signs and factors, and what a known controller answers.

    theta_rad = { sum = "r_rad - e_rad" }                  # of columns of this map, in their stored units
    mean_m = { sum = "0.5 left_m + 0.5 right_m" }
    z_v = { sum = "r_rad - theta_rad", controller = "axis" }   # the control, not logged: C of that loop, from rest

`reference`, `injected` and `control` of a `[[loop]]`, and an `output` with a difference or a factor, may be such sums
too; each becomes a column `LOOP_KEY_unit`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.stretches import LongSignal, Signal
from loopshape.core.units import SUFFIXES
from loopshape.data.control.controller import Controller
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import LoopSetup
from loopshape.io.config_table import ConfigTable

_TERM = re.compile(r"\s*([+-]?)\s*(?:(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s*\*?\s*)?([A-Za-z_]\w*)")
_SIGNALS = ("reference", "injected", "control", "output")

Terms = tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class MadeRule:
    """A stored column as a sum of factors times columns, passed through the controller of a loop where one is named."""

    stored: str
    terms: Terms
    controller: str | None = None


def read_terms(text: str, where: str) -> Terms:
    """Factors and columns of `"r_rad - 2 e_rad"`; refuses what is no such sum."""
    found: list[tuple[float, str]] = []
    at = 0
    while at < len(text.rstrip()):
        term = _TERM.match(text, at)
        if term is None or (found and not term[1]):
            raise WrongUseError(
                f"{where}: a sum of columns is not understood",
                repr(text),
                'write "r_rad - e_rad" or "0.5 a_m + 0.5 b_m"',
            )
        found.append((float(f"{term[1]}{term[2] or 1}"), term[3]))
        at = term.end()
    return tuple(found)


def read_made(stored: str, words: ConfigTable) -> MadeRule:
    """One rule with `sum`; refuses terms of several units, and a sum in another unit than its column's."""
    words.only("sum", "controller")
    made = MadeRule(stored, read_terms(words.text("sum"), words.where), words.maybe_text("controller"))
    _unit_of(made, words.where)
    return made


def _unit_of(made: MadeRule, where: str) -> str:
    """The unit of the terms; without a controller it must be the column's."""
    units = {Channel.from_column(name).unit for _, name in made.terms}
    own = Channel.from_column(made.stored).unit
    if len(units) != 1 or (made.controller is None and units != {own}):
        raise WrongUseError(
            f"{where}: a sum has one unit", f"terms in {', '.join(sorted(units))}, a column in {own}",
            _one_unit(made, own),
        )  # fmt: skip
    return units.pop()


def _one_unit(made: MadeRule, own: str) -> str:
    """The cure for a sum of several units: a gain in the rule of a column makes one unit of another."""
    other = next(((f, n) for f, n in made.terms if Channel.from_column(n).unit != own), None)
    if other is None:
        return f"end the column's name in _{Channel.from_column(made.terms[0][1]).unit}"
    factor, name = other
    stem = name.removesuffix(f"_{Channel.from_column(name).unit}")
    rule = f'{stem}_{own} = {{ from = ..., unit = "{SUFFIXES[own]}", gain = {abs(factor):g} }}'
    return f"bring {name} to the other's unit by a gain under [columns], {rule}, and add that without the factor"


def made_of_loops(words: ConfigTable) -> tuple[ConfigTable, tuple[MadeRule, ...]]:
    """A map's words with each sum under `[[loop]]` replaced by a column's name, and the rules of these columns."""
    loops, rules = [], []
    for loop in words.tables("loop"):
        table = dict(loop.table)
        for key in _SIGNALS:
            text = table.get(key)
            if not isinstance(text, str) or _is_plain(text, key):
                continue
            terms = read_terms(text, loop.where)
            unit = Channel.from_column(terms[0][1]).unit
            stored = re.sub(r"\W", "_", f"{table.get('name', 'loop')}_{key}_{unit}")
            rules.append(MadeRule(stored, terms))
            _unit_of(rules[-1], loop.where)
            table[key] = stored
        loops.append(table)
    return ConfigTable({**words.table, "loop": loops} if loops else words.table, words.where), tuple(rules)


def _is_plain(text: str, key: str) -> bool:
    """Whether a signal is a column, or an output that is a sum of columns, which a run itself may hold."""
    parts = text.split("+") if key == "output" else [text]
    return all(part.strip().isidentifier() for part in parts)


def check_made(made: Sequence[MadeRule], columns: set[str], loops: Sequence[LoopSetup], where: str) -> None:
    """Refuse sums of columns that are not there, or stand below, and controllers that the map does not hold."""
    known = set(columns)
    controllers = {loop.name for loop in loops if loop.controller is not None}
    for rule in made:
        if missing := sorted({name for _, name in rule.terms} - known):
            raise WrongUseError(
                f"{where}: the sum for {rule.stored} names columns that are not there", ", ".join(missing),
                f"columns above it are {', '.join(sorted(known)) or 'none'}",
            )  # fmt: skip
        if rule.controller is not None and rule.controller not in controllers:
            raise WrongUseError(
                f"{where}: {rule.stored} needs the controller of a loop", repr(rule.controller),
                "write controller = [...] under the [[loop]] of this name",
            )  # fmt: skip
        known.add(rule.stored)


def make_columns(
    columns: Mapping[str, Signal], made: Sequence[MadeRule], loops: Sequence[LoopSetup]
) -> tuple[dict[str, Signal], list[str]]:
    """Columns (n,) with those that are made of them, and a sentence for each control that was computed."""
    found, notes = dict(columns), []
    controllers = {loop.name: loop.controller for loop in loops}
    for rule in made:
        value = _sum(found, rule.terms)
        controller = controllers.get(rule.controller or "")
        if controller is not None:
            value = answered(controller, np.asarray(value))
            notes.append(
                f"{rule.stored} was not logged: it is what the controller of {rule.controller} answers to"
                f" {_text(rule.terms)} from rest. Limits, another start and whatever else the machine's own controller"
                " did are not in it"
            )
        found[rule.stored] = value
    return found, notes


def _sum(columns: Mapping[str, Signal], terms: Terms) -> Signal:
    parts = [columns[name] for _, name in terms]
    if any(isinstance(part, LongSignal) for part in parts):
        return LongSignal(parts[0].size, lambda start, stop: _added(terms, [part[start:stop] for part in parts]))
    return _added(terms, [np.asarray(part) for part in parts])


def _added(terms: Terms, parts: Sequence[np.ndarray]) -> np.ndarray:
    return np.asarray(sum(factor * part for (factor, _), part in zip(terms, parts, strict=True)))


def _text(terms: Terms) -> str:
    text = " ".join(
        f"{'-' if factor < 0 else '+'} {'' if abs(factor) == 1 else f'{abs(factor):g} '}{name}"
        for factor, name in terms
    )
    return text.removeprefix("+ ")


def answered(controller: Controller, error: np.ndarray) -> np.ndarray:
    """What a controller's sections answer (n,) to an error (n,), from rest."""
    from scipy.signal import lfilter

    out = np.asarray(error, dtype=float)
    for b0, b1, b2, a1, a2 in controller.biquads():
        out = np.asarray(lfilter([b0, b1, b2], [1.0, a1, a2], out))
    return out
