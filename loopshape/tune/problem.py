"""A tuning problem: free parameters of a structure, measured plants, and L with its exact slopes.

Parameters are optimised as logarithms. All lines of all operating points lie in one flat array, so one
evaluation is a handful of array operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.controller import Block, Controller, series_response
from loopshape.errors import WrongUseError
from loopshape.loop import Loop, above_hz
from loopshape.requirements import BlockTemplate, Free, Requirements
from loopshape.units import Array, ComplexArray


@dataclass(frozen=True)
class Variable:
    """One free parameter: which block, which name, and its bounds."""

    block: int
    name: str
    low: float
    high: float
    start: float | None


@dataclass(frozen=True, eq=False)
class Problem:
    """Plants on flat lines, the structure, and the requirements of one loop.

    `first` (points + 1,) are the places where operating points begin in the flat arrays; `line` maps each
    flat line to its unique frequency, at which the controller is evaluated once. The arrays with `below` do
    the same for the models' lines below the measured ones, which only the count of encirclements sees.
    """

    requirements: Requirements
    templates: tuple[BlockTemplate, ...]
    variables: tuple[Variable, ...]
    rate_hz: float
    names: tuple[str, ...]
    f: Array
    P: ComplexArray
    first: np.ndarray
    unique_s: ComplexArray
    line: np.ndarray
    integrators: np.ndarray
    unstable: np.ndarray
    P_below: ComplexArray
    s_below: ComplexArray
    first_below: np.ndarray
    f_above: Array

    @property
    def low(self) -> Array:
        """Lower bounds of x."""
        return np.log([v.low for v in self.variables])

    @property
    def high(self) -> Array:
        """Upper bounds of x."""
        return np.log([v.high for v in self.variables])

    def blocks(self, x: Array) -> tuple[Block, ...]:
        """Blocks at x."""
        values: list[dict[str, float]] = [{} for _ in self.templates]
        for v, value in zip(self.variables, np.exp(x), strict=True):
            values[v.block][v.name] = min(max(float(value), v.low), v.high)
        return tuple(t.block(values[k]) for k, t in enumerate(self.templates))

    def controller(self, x: Array) -> Controller:
        """Controller at x."""
        return Controller(self.requirements.loop, self.blocks(x), self.rate_hz)

    def response(self, x: Array) -> ComplexArray:
        """C on the flat lines."""
        return series_response(self.blocks(x), self.unique_s)[self.line]

    def below(self, x: Array) -> ComplexArray:
        """L below the lowest lines, by the models of the plants, flat."""
        return series_response(self.blocks(x), self.s_below) * self.P_below

    def above(self, x: Array) -> tuple[ComplexArray, ComplexArray]:
        """C above the last lines, where it is CS, and its slopes d ln C/d x."""
        s = Controller(self.requirements.loop, self.blocks(x), self.rate_hz).s_at(self.f_above)
        return series_response(self.blocks(x), s), self._slopes(x, s)

    def place(self, at: int) -> tuple[str, float]:
        """Operating point and frequency in Hz of a flat line, or of a frequency above all lines."""
        if at >= self.f.size:
            return "every operating point", float(self.f_above[at - self.f.size])
        return self.names[int(np.searchsorted(self.first, at, side="right")) - 1], float(self.f[at])

    def slopes(self, x: Array) -> ComplexArray:
        """d ln C/d x (variables, flat lines), exact."""
        return self._slopes(x, self.unique_s)[:, self.line]

    def _slopes(self, x: Array, s: ComplexArray) -> ComplexArray:
        blocks = self.blocks(x)
        by_block = [b.log_slopes(s) for b in blocks]
        rows = []
        for v in self.variables:
            template, block = self.templates[v.block], blocks[v.block]
            names = [v.name, *(k for k, target in template.tie.items() if target == v.name)]
            rows.append(sum(block.parameters[v.name] * by_block[v.block][name] for name in names))
        return np.array(rows)


def problem(loops: Sequence[Loop], requirements: Requirements, rate_hz: float) -> Problem:
    """Problem from loops (their controllers do not matter) and requirements with a structure."""
    templates = requirements.structure
    if not templates:
        raise WrongUseError(
            f"the requirements of loop {requirements.loop!r} name no structure to tune",
            "",
            "add structure = [ { kind = ..., ... } ] with min and max for what may move",
        )
    near = ("sensitivity_peak_db", "modulus_margin", "phase_margin_deg", "gain_margin_db", "delay_margin_s")
    if all(getattr(requirements, name) is None for name in near):
        raise WrongUseError(
            f"the requirements of loop {requirements.loop!r} let the loop come as near to -1 as it likes",
            "no limit on a margin or on |S|",
            f"give one of {', '.join(near)}",
        )
    variables = tuple(
        Variable(k, name, value.low, value.high, value.start)
        for k, template in enumerate(templates)
        for name, value in template.parameters.items()
        if isinstance(value, Free)
    )
    if not variables:
        raise WrongUseError(f"the structure of loop {requirements.loop!r} has nothing free to tune")
    unknown = [loop.plant.recording for loop in loops if loop.integrators is None]
    if unknown:
        raise WrongUseError(
            f"the number of integrators of the plant in loop {requirements.loop!r} is not known",
            f"lowest lines that fit no whole number at {', '.join(unknown)}",
            "declare integrators in the requirements' [[loop]], or fit a model that follows the lines",
        )
    f = np.concatenate([loop.frequency_hz for loop in loops])
    unique, line = np.unique(f, return_inverse=True)
    unit = Controller(requirements.loop, (Block("gain", {"gain": 1.0}),), rate_hz)
    return Problem(
        requirements=requirements,
        templates=templates,
        variables=variables,
        rate_hz=rate_hz,
        names=tuple(loop.plant.recording for loop in loops),
        f=f,
        P=np.concatenate([loop.plant.siso for loop in loops]),
        first=np.concatenate([[0], np.cumsum([loop.frequency_hz.size for loop in loops])]),
        unique_s=unit.s_at(unique),
        line=line,
        integrators=np.array([loop.integrators or 0 for loop in loops]) + sum(t.kind == "pi" for t in templates),
        unstable=np.array([loop.unstable_poles for loop in loops]),
        P_below=np.concatenate([loop.P_below for loop in loops]),
        s_below=unit.s_at(np.concatenate([loop.below_hz for loop in loops])),
        f_above=above_hz(min(float(loop.frequency_hz[-1]) for loop in loops), rate_hz),
        first_below=np.concatenate([[0], np.cumsum([loop.below_hz.size for loop in loops])]),
    )
