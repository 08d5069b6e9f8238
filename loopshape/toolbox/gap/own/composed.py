"""A model with everything that effects may change, by name: its own parameters, actuators, sensors, forces at ports."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numba
import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.toolbox.gap.nouns.machine import Input, Model, Output, Port
from loopshape.toolbox.gap.nouns.plant import Parameter, ParameterTable
from loopshape.toolbox.gap.own import kernel
from loopshape.toolbox.gap.own.signals import ACTUATOR, SENSOR

INPUT, OUTPUT, PORT, CHANGE = "input", "output", "port", "change"
_SEED = 1
_ALIKE = 1e-9  # of rates that are one


@dataclass(frozen=True, eq=False)
class Composed:
    """The model, compiled. Moves are by name: `mass`, `change.mass`, `input.motor.delay_ms`, `port.joint.coulomb`."""

    model: Model

    @property
    def window_s(self) -> float:
        """Seconds that the simulation is left to itself; of a model that leaves it open, until one is chosen, 1."""
        return self.model.window_s or 1.0

    @cached_property
    def motion(self) -> Any:
        """The right-hand side, compiled where numba can; refuses one that does not give a derivative a state."""
        motion = kernel.compiled(self.model.motion)
        try:
            self._tried(motion)
        except numba.core.errors.NumbaError:
            motion = self.model.motion
            self._tried(motion)
        return motion

    @cached_property
    def law(self) -> Any:
        """Efforts of actuators' laws within the motion, compiled."""
        return kernel.no_law if self.model.law is None else kernel.compiled(self.model.law)

    @property
    def is_compiled(self) -> bool:
        """Whether numba took the right-hand side; if not, all takes some hundred times as long."""
        return isinstance(self.motion, numba.core.dispatcher.Dispatcher)

    def _tried(self, motion: Any) -> Array:
        nx = len(self.model.states)
        with np.errstate(all="ignore"):
            found = np.atleast_1d(np.array(motion(0.0, np.zeros(nx), self._still, self.values({})), dtype=float))
        if found.shape != (nx,):
            raise WrongUseError(
                f"the right-hand side of {self.model.name} gives one derivative a state",
                f"{found.size} for {nx} states", f"return those of {', '.join(self.model.states)}, in this order",
            )  # fmt: skip
        return found

    @cached_property
    def _still(self) -> Array:
        return np.zeros(len(self.model.inputs))

    @cached_property
    def run(self) -> Any:
        """The kernel with the motion in it; plain where the motion is. Ports where nothing acts are left out."""
        whole = kernel.windows if self.is_compiled else getattr(kernel.windows, "py_func", kernel.windows)
        motion, law = self.motion, self.law

        def run(m: Mapping[str, float], p: Any, x0: Array, driving: kernel.Driving, out: Array) -> None:
            f, nx = self.forces(m), len(self.model.states)
            acts = np.flatnonzero((f != self._idle).any(axis=1))
            moves = acts if (f[acts][:, [kernel.BRISTLES, kernel.INERTIA]] > 0.0).any() else acts[:0]
            kept = nx + kernel.PER_PORT * moves[:, None] + np.arange(kernel.PER_PORT)
            x0 = np.concatenate([x0[:, :nx], x0[:, kept.ravel()]], axis=1)
            own = nx + kernel.PER_PORT * np.arange(acts.size) if moves.size else np.full(acts.size, -1)
            places = np.column_stack([self.places[acts], acts, own])
            with np.errstate(all="ignore"):  # a wrong hypothesis may run away; that is no crash
                whole(motion, law, kernel.Acting(p, f[acts], places), x0, driving, out)

        return run

    @cached_property
    def _idle(self) -> Array:
        """What acts at the ports of a model without effects."""
        return self.forces({})

    @cached_property
    def _tuple(self) -> Any:
        return namedtuple("Parameters", [p.name for p in self.model.parameters] or ["none"])

    def of(self, model: Model) -> Composed:
        """Another model of the same right-hand side and parameters, which is not compiled anew."""
        other = Composed(model)
        other.__dict__.update(motion=self.motion, law=self.law, _tuple=self._tuple)
        return other

    def values(self, m: Mapping[str, float], constants: Mapping[str, float] | None = None) -> Any:
        """The simulator's parameters, by name, or what the model derives of them.

        `constants` of a recording stand for nominal values: a tolerance moves them by the same share.
        """
        nominal, here = self.model.values(), constants or {}
        shares = {n: here[n] / v if n in here and v else 1.0 for n, v in nominal.items()}
        moved = {n: shares[n] * m[n] if n in m and v else here.get(n, m.get(n, v)) for n, v in nominal.items()}
        own = tuple(float(v + m.get(f"{CHANGE}.{n}", 0.0)) for n, v in moved.items())
        return self._tuple(*(own or (0.0,))) if self.model.derived is None else self.model.derived(own)

    def actuator(self, j: int, m: Mapping[str, float]) -> dict[str, float]:
        """Numbers of the j-th input's actuator."""
        return {key: m.get(name, v) for key, name, v in self._names[0][j]}

    def sensor(self, k: int, m: Mapping[str, float]) -> dict[str, float]:
        """Numbers of the k-th output's sensor."""
        return {key: m.get(name, v) for key, name, v in self._names[1][k]}

    def forces(self, m: Mapping[str, float]) -> Array:
        """What acts at the ports (nports, fields)."""
        rows = [[m.get(name, v) for _, name, v in names] for names in self._names[2]]
        return np.array(rows, dtype=float).reshape(-1, len(kernel.FIELDS))

    @cached_property
    def _names(self) -> tuple[list[list[tuple[str, str, float]]], ...]:
        """Of each input, output and port its numbers: (number, its name among moves, its neutral value)."""

        def rows(kind: str, places: Iterable[Input | Output | Port], numbers: Mapping[str, float]) -> Any:
            return [[(key, f"{kind}.{p.name}.{key}", v) for key, v in numbers.items()] for p in places]

        acts, reads = ({key: v for key, (v, _) in of.items()} for of in (ACTUATOR, SENSOR))
        fields = {key: NEUTRAL.get(key, 0.0) for key in kernel.FIELDS}
        of = self.model
        return rows(INPUT, of.inputs, acts), rows(OUTPUT, of.outputs, reads), rows(PORT, of.ports, fields)

    @cached_property
    def places(self) -> np.ndarray:
        """Indices of the ports' inputs, positions and speeds (nports, 3)."""
        inputs, states = [i.name for i in self.model.inputs], self.model.states
        rows = [(inputs.index(p.input), states.index(p.position), states.index(p.speed)) for p in self.model.ports]
        return np.array(rows, dtype=np.int64).reshape(-1, 3)

    @cached_property
    def speeds(self) -> dict[int, int]:
        """State -> the state that is its derivative, wherever the right-hand side says so at every state tried."""
        rng, nx = np.random.default_rng(_SEED), len(self.model.states)
        tried = rng.normal(size=(4, nx))
        found = np.array([self.motion(0.0, x, self._still, self.values({})) for x in tried], dtype=float)
        same = [(i, j) for i in range(nx) for j in range(nx) if i != j and np.array_equal(found[:, i], tried[:, j])]
        return dict(same)

    @cached_property
    def fastest(self) -> float:
        """Rate in 1/s of the model's fastest mode near rest, where nothing is clamped."""
        nx, values = len(self.model.states), self.values({})
        near_rest = 1e-3
        at = near_rest * np.random.default_rng(_SEED).normal(size=nx)
        step = 1e-6
        rows = [np.array(self.motion(0.0, at + step * e, self._still, values), dtype=float).ravel() for e in np.eye(nx)]
        slopes = (np.array(rows) - np.array(self.motion(0.0, at, self._still, values), dtype=float).ravel()) / step
        return float(np.max(np.abs(np.linalg.eigvals(slopes)))) if np.all(np.isfinite(slopes)) else 0.0

    @cached_property
    def lags(self) -> dict[int, float]:
        """State -> its rate in 1/s, where it follows the inputs alone and has forgotten its start in half a window.

        Such a state is known from the inputs; estimated within a window it would be told from a speed by nothing.
        """
        nx, values = len(self.model.states), self.values({})
        seen = {self.model.states.index(o.state) for o in self.model.outputs}
        tried = np.random.default_rng(_SEED).normal(size=(4, nx))
        out = {}
        for k in set(range(nx)) - seen - set(self.speeds.values()):
            other = tried + np.eye(nx)[k]
            alone = np.where(np.arange(nx) == k, tried, 0.0)
            at = [[float(self.motion(0.0, x, self._still, values)[k]) for x in rows] for rows in (tried, other, alone)]
            rates = np.subtract(at[0], at[1])
            if np.ptp(rates) <= _ALIKE * rates[0] and np.allclose(at[0], at[2], rtol=_ALIKE, atol=0.0):
                out[k] = float(rates[0])
        forgotten = 4.0  # time constants a window
        return {k: rate for k, rate in out.items() if rate * self.window_s > forgotten}

    @cached_property
    def hidden(self) -> list[int]:
        """States that are neither measured nor the derivative of one that is, nor known from the inputs."""
        seen = {self.model.states.index(o.state) for o in self.model.outputs}
        seen |= {self.speeds[k] for k in seen if k in self.speeds}
        return [k for k in range(len(self.model.states)) if k not in seen and k not in self.lags]

    def free_states(self, m: Mapping[str, float]) -> np.ndarray:
        """Places in the extended state whose initial value is estimated."""
        nx, forces = len(self.model.states), self.forces(m)
        out = [k for k in range(nx) if k not in self.lags]
        for j in range(len(self.model.ports)):
            at = nx + kernel.PER_PORT * j
            out += [at + kernel.BRISTLE] * bool(forces[j, kernel.BRISTLES] > 0.0)
            out += [at + kernel.MOTOR, at + kernel.MOTOR_SPEED] * bool(forces[j, kernel.INERTIA] > 0.0)
        return np.array(out, dtype=np.int64)

    def extended_ranges(self, ranges: Array) -> Array:
        """Ranges of the extended state: bristles bend by a hundredth of what the joint moves."""
        own = [[0.01 * ranges[position], ranges[position], ranges[speed]] for _, position, speed in self.places]
        return np.concatenate([ranges, *own])

    @cached_property
    def table(self) -> ParameterTable:
        """Every name that a move may have, with its neutral value."""
        m = self.model
        rows = [_row(p.name, p.value, p.unit, "model") for p in m.parameters]
        rows += [_row(f"{CHANGE}.{p.name}", 0.0, p.unit, p.name) for p in m.parameters]
        rows += [
            _row(f"{INPUT}.{i.name}.{k}", v, u or i.unit, i.name) for i in m.inputs for k, (v, u) in ACTUATOR.items()
        ]
        rows += [
            _row(f"{OUTPUT}.{o.name}.{k}", v, u or o.unit, o.name) for o in m.outputs for k, (v, u) in SENSOR.items()
        ]
        rows += [
            _row(f"{PORT}.{p.name}.{k}", NEUTRAL.get(k, 0.0), _unit(k, p.unit), p.name)
            for p in m.ports
            for k in kernel.FIELDS
        ]
        return ParameterTable(tuple(rows))


#: units of a port's numbers, of its effort e and its travel q
_UNITS = {
    "viscous": "{e} s/{q}", "coulomb": "{e}", "coulomb_speed": "{q}/s", "bristle": "{q}", "stribeck_speed": "{q}/s",
    "stiffness": "{e}/{q}", "hardening": "1/{q}2", "rest": "{q}", "offset": "{e}", "coupling": "{e}/{q}",
    "coupling_damping": "{e} s/{q}", "play": "{q}", "inertia": "{e} s2/{q}", "viscous_speed": "{q}/s",
    "coupling_hardening": "1/{q}2", "motor_damping": "{e} s/{q}", "load_square": "1/{e}",
}  # fmt: skip


def _unit(field: str, effort: str) -> str:
    """Of a port's number; "" where its effort has no unit that is known."""
    travel = {"N m": "rad", "N": "m"}.get(effort)
    return _UNITS.get(field, "1").format(e=effort, q=travel) if travel else ""


NEUTRAL = {"coulomb_speed": 1.0, "stribeck_speed": 1.0, "viscous_speed": 1.0}


def _row(name: str, value: float, unit: str, block: str) -> Parameter:
    return Parameter(name, value, unit, -np.inf, np.inf, block, "user's model")
