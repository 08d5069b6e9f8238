"""Measured FRFs in place of recordings: multisines at their lines, which a linear machine answers as the FRF says.

Each recording has every eighth line of an FRF, so that recordings are independent and some can be held out. A line's
input is the reciprocal of its error, or of a hundredth of |G| (of its neighbours' in a dip) where that is more.
What the errors make of the outputs is the floor (`leaves`). A linear machine is as well told small: sizes are its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.controller import hold_and_delay
from loopshape.data.response.frf import FRF, Hold
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.toolbox.gap.nouns.machine import Model
from loopshape.toolbox.gap.nouns.plant import SimulationModel
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.following import FASTEST_HZ, RIPPLE
from loopshape.toolbox.gap.own.plant import OwnMachine

COMBS, HELD_OUT, FEWEST = 8, 4, 24  # recordings an FRF and input, which of them are held out, lines at least
SIZE, LARGER = 1e-3, 30.0  # rms of the first output, and times that at which the model has to be linear too
BENT = 0.01  # share of a derivative that is not linear
SURE, OCTAVES = 0.01, 0.5  # of |G|, or its mean to either side: an error below it weighs no more
TICKS, FOLDED = 10.0, 6.0  # a period of the highest line, and of a line that can be followed at the fastest rate
WINDOWS, BLOCKS = 9.5, (25.0, 40.0)  # of each recording; periods of the highest line in one
#: kinds and numbers that only the size of a motion shows, or a constant
_KINDS = ("coulomb_friction", "backlash", "actuator_saturation", "dead_zone", "force_offset", "sensor_offset")
_NUMBERS = ("viscous_power", "viscous_square", "hardening", "coupling_hardening")
NOTE = (
    f"FRFs of a linear model: {', '.join(_KINDS)} and hardening depend on size or are constants, which no FRF shows, "
    "and are not looked for; record in time to see them"
)


class LinearMachine(OwnMachine):
    """A machine known by FRFs: effects that an FRF cannot show are no hypotheses."""

    def readied(self, run: Run, names: Sequence[str]) -> tuple[SimulationModel, Run, list[str]]:
        """As of any machine of one's own, with linear effects alone."""
        ready, run, names = super().readied(run, names)
        ready.effects = tuple(_finer(f) for f in ready.effects if _is_linear(f))
        return ready, run, names


def _is_linear(form: EffectForm) -> bool:
    numbers = {name.rsplit(".", 1)[-1] for name in (*(f.parameter for f in form.free), *form.fixed)}
    return form.effect.split("@")[0] not in _KINDS and not numbers & set(_NUMBERS)


def _finer(form: EffectForm) -> EffectForm:
    """The form with as many starts more of a coupling's stiffness: at every line of an FRF a resonance weighs."""
    free = [
        replace(f, starts=(*f.starts, *np.sqrt(np.array(f.starts[1:]) * f.starts[:-1]).tolist()))
        if f.parameter.endswith(".coupling") else f
        for f in form.free
    ]  # fmt: skip
    return replace(form, free=tuple(free))


def simulable(model: Model, frfs: Sequence[FRF]) -> tuple[LinearMachine, Run]:
    """The machine, and the run that its FRFs stand for.

    Refuses FRFs of other columns, without an error, or with fewer than FEWEST lines, and a model that is not linear.
    """
    shown = [_shown(model, frf) for frf in frfs]
    top, low = max(f.frequency_hz[-1] for f in shown), min(f.frequency_hz[0] for f in shown)
    rate_hz = float(min(FASTEST_HZ, TICKS * top))
    window_s = model.window_s or float(np.clip(1.0 / low, BLOCKS[0] / top, BLOCKS[1] / top))
    names = set.intersection(*(set(f.outputs) for f in shown))
    outputs = [o for o in model.outputs if o.column in names]
    kept, composed = replace(model, outputs=tuple(outputs), window_s=window_s), Composed(model)
    drawn = [x for k, f in enumerate(shown) for x in _drawn(composed, kept, f, k, rate_hz)]
    floors = np.sqrt(np.mean([errors for _, errors in drawn], axis=0))
    stated = [replace(o, leaves=float(abs(o.factor) * x)) for o, x in zip(outputs, floors, strict=True)]
    return LinearMachine(replace(kept, outputs=tuple(stated))), Run(rate_hz, (), tuple(r for r, _ in drawn))


def _shown(model: Model, frf: FRF) -> FRF:
    """The valid and independent lines of an FRF that can be followed."""
    inputs, outputs = ([x.column for x in ends if x.column] for ends in (model.inputs, model.outputs))
    if not (set(frf.inputs) <= {*inputs} and set(frf.outputs) & {*outputs}):
        raise WrongUseError(
            "an FRF goes from columns of the model's inputs to columns of its outputs",
            f"{', '.join(frf.inputs)} to {', '.join(frf.outputs)}; the model has {', '.join(inputs)} and"
            f" {', '.join(outputs)}", "name them alike in model.toml (column), or by import-frf --inputs --outputs",
        )  # fmt: skip
    valid = frf.valid_lines()
    valid = valid.select(np.arange(0, valid.frequency_hz.size, int(np.ceil(valid.line_overlap))))
    valid = valid.select(valid.frequency_hz <= FASTEST_HZ / FOLDED)
    if valid.frequency_hz.size < FEWEST:
        raise WrongUseError(
            f"a gap is told from {FEWEST} lines of an FRF at least, which are valid, independent and below"
            f" {FASTEST_HZ / FOLDED:g} Hz", f"{valid.frequency_hz.size} lines", "measure finer or longer",
        )  # fmt: skip
    if not np.all(np.max(valid.variance, axis=0) > 0.0):
        raise WrongUseError(
            "a gap of an FRF is told against its error", "an FRF without one (0 everywhere)",
            "state it: import-frf --relative-std 0.02, or FRF.from_arrays(..., std=...)",
        )  # fmt: skip
    return valid


def _drawn(c: Composed, model: Model, frf: FRF, seed: int, rate_hz: float) -> list[tuple[Recording, Array]]:
    """Recordings of an FRF, and mean squares (ny,) of what its errors make of each output's column.

    Inputs are held at the run's rate; where the FRF has the hold of its own rate, it is divided out.
    """
    rng, f = np.random.default_rng(seed), frf.frequency_hz
    places = [frf.outputs.index(o.column) for o in model.outputs]
    hold = hold_and_delay(f, rate_hz, 0.0)
    hold = hold / hold_and_delay(f, frf.rate_hz, 0.0) if frf.hold is Hold.INCLUDED else hold
    ripple = (RIPPLE**2 + (f / (rate_hz - f)) ** 4)[:, None]  # also what a held input has above half the rate, of 1/s
    t = np.arange(round(max(WINDOWS * float(model.window_s or 0.0), 3.2) * rate_hz)) / rate_hz
    out = []
    for j, column in enumerate(frf.inputs):
        g, variance = frf.response[:, places, j], frf.variance[:, places, j]
        near = np.abs(np.log2(f[:, None] / f)) <= OCTAVES
        wide = np.maximum(np.abs(g), np.exp(near @ np.log(np.abs(g) + 1e-300) / near.sum(axis=1)[:, None]))
        size = 1.0 / np.sqrt(np.mean((variance + (SURE * wide) ** 2) / np.median(wide, axis=0) ** 2, axis=1))
        u = size * np.exp(2j * np.pi * rng.random(f.size))
        for m in range(COMBS):
            comb = np.where(np.arange(f.size) % COMBS == m, u, 0.0)
            comb = comb * SIZE / abs(model.outputs[0].factor) / np.sqrt(0.5 * np.sum(np.abs(g[:, 0] * comb) ** 2))
            if m == 0:
                _check_linear(c, frf, column, u * np.max(np.abs(comb)) / np.max(size))
            role = "validation" if m % HELD_OUT == HELD_OUT - 1 else "estimation"
            name = f"{frf.recording or frf.loop or 'frf'}-{column}-lines-{m + 1}.parquet"
            info = RecordingInfo(name, "multisine", "control", role=role, operating_point=frf.operating_point,
                                 parameters=frf.parameters)  # fmt: skip
            columns = {str(i.column): np.zeros(t.size) for i in model.inputs if i.column}
            columns[column] = _signal(t, f, comb)
            columns |= {o.column: _signal(t, f, g[:, k] * hold * comb) for k, o in enumerate(model.outputs)}
            errors = 0.5 * np.sum((variance + ripple * np.abs(g) ** 2).T * np.abs(comb) ** 2, axis=1)
            out.append((Recording(info, rate_hz, columns), errors))
    return out


def _signal(t: Array, f_hz: Array, lines: ComplexArray) -> Array:
    """Sum (n,) of sines of complex amplitudes (nf,)."""
    return np.asarray(sum((np.real(a * np.exp(2j * np.pi * f * t)) for f, a in zip(f_hz, lines, strict=True) if a),
                          np.zeros(t.size)))  # fmt: skip


def _check_linear(c: Composed, frf: FRF, column: str, u: ComplexArray) -> None:
    """Refuse a right-hand side that is not linear where an FRF's motion goes, small and LARGER times as large.

    States are those of the steady state that its own slopes at rest give.
    """
    nx, nu, values = len(c.model.states), len(c.model.inputs), c.values({}, frf.parameters)
    place, rng = [i.column for i in c.model.inputs].index(column), np.random.default_rng(0)

    def slope(x: Array, drive: Array) -> Array:
        return np.array(c.motion(0.0, x, drive, values), dtype=float).ravel()

    def columns(size: Any) -> Array:
        steps = size * np.eye(nx + nu)[: nx + 1 + place]
        return np.array([(slope(s[:nx], s[nx:]) - slope(-s[:nx], -s[nx:])) / (2.0 * size) for s in steps]).T

    slopes = columns(1e-6)
    a, b = slopes[:, :nx], slopes[:, nx + place] * c.model.inputs[place].factor
    s = 2j * np.pi * frf.frequency_hz
    x = np.linalg.solve(s[:, None, None] * np.eye(nx) - a, (b * u[:, None])[:, :, None])[:, :, 0]
    turns = np.exp(2j * np.pi * rng.random((64, s.size)))
    states, drives = np.real(turns @ x), np.outer(np.real(turns @ u), np.eye(nu)[place])
    for size in (1.0, LARGER):
        drive = size * drives * c.model.inputs[place].factor
        linear = size * states @ a.T + np.outer(drive[:, place], slopes[:, nx + place])
        found = np.array([slope(size * one, d) for one, d in zip(states, drive, strict=True)])
        off = np.sqrt(np.mean((found - linear) ** 2, axis=0)) / np.maximum(np.sqrt(np.mean(linear**2, axis=0)), 1e-300)
        if not np.max(off) <= BENT:
            raise WrongUseError(
                "an FRF is compared with a linear model, at rest where states and inputs are 0",
                f"the slope of {c.model.states[int(np.nanargmax(off))]} is {np.nanmax(off):.0%} off a straight line",
                "record in time (loopshape import), or leave out what is not linear: friction, gravity, play, limits",
            )  # fmt: skip
