"""What both arms share as plants: setups of their loops, experiments in parallel, recordings out."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import Array
from loopshape.data.control.controller import Block, Controller
from loopshape.data.signal.experiment import Experiment, LoopSetup, shared_unit
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.arm.dynamics import closed_loop as kernel
from loopshape.toolbox.gap.noise import start_state
from loopshape.toolbox.gap.nouns.plant import ParameterTable
from loopshape.toolbox.rig.settings import decoupling_matrix
from loopshape.toolbox.schedules.gain_scheduled import Follows, GainScheduled

#: what drives an arm: its controllers, what goes in, and the pulses
Driven = tuple[kernel.Controllers, kernel.Inputs, kernel.Pwm]
INJECTIONS = {
    "controller_input": kernel.CONTROLLER_INPUT,
    "plant_input": kernel.PLANT_INPUT,
    "reference": kernel.CONTROLLER_INPUT,
    "control": kernel.CONTROL,
}
ENDED = {
    kernel.LEFT_ANGLE: "the angle left the model's range",
    kernel.LEFT_PRESSURE: "a muscle's pressure left the model's range",
    kernel.NOT_FINITE: "the state is no longer a number",
    kernel.LEFT_THETA1: "theta1 left the model's range",
    kernel.LEFT_THETA2: "theta2 left the model's range",
}


class Arm:
    """What both arms are as plants (`Plant`, `Rig`): controllers and setups of their loops, experiments in parallel.

    An arm has its `title`, its loops as `wired` (the column of z and what is measured, by loop), factors `to_si` of its
    references, and its `point_keys`; `_integrated` runs its kernel.
    """

    title: str
    wired: Mapping[str, tuple[str, str]]
    to_si: tuple[float, ...]
    point_keys: tuple[str, ...]
    controllers: Mapping[str, tuple[Block, ...]]
    parameters: ParameterTable
    solvers: tuple[str, ...]
    logged: tuple[str, ...]
    measured: int

    def default_controllers(self, rate_hz: float) -> tuple[Controller, ...]:
        """The source's structures with numbers that hold the printed model."""
        return tuple(Controller(loop, blocks, rate_hz) for loop, blocks in self.controllers.items())

    def loop_setups(self, controllers: Sequence[Controller], injection: str) -> tuple[LoopSetup, ...]:
        """Columns of all loops; what enters at the plant's input is in V."""
        known = {c.loop: c for c in controllers}
        if set(known) != set(self.wired):
            raise WrongUseError(
                f"{self.title} needs a controller for each of its loops {_listed(list(self.wired))}",
                ", ".join(known) or "none",
            )
        setups = []
        for loop, (control, output) in self.wired.items():
            unit = shared_unit(output, f"the output of loop {loop}")
            injected = f"n_{loop}_{'v' if injection == 'plant_input' else unit}"
            setups.append(LoopSetup(loop, f"r_{loop}_{unit}", injected, control, output, known[loop]))
        return tuple(setups)

    def refuse_other_keys(self, operating_point: Mapping[str, float]) -> None:
        """Refuse an operating point with other keys than the arm's."""
        if set(operating_point) != set(self.point_keys):
            raise WrongUseError(
                f"an operating point of {self.title} names {_listed(self.point_keys)}", f"{dict(operating_point)!r}"
            )

    def check_settings(self, rate_hz: float, changes: Mapping[str, float]) -> None:
        """Refuse unknown or out-of-bounds parameters, and a PWM period that is no whole number of samples."""
        period_ticks(rate_hz, self._value(self.parameters.vector(changes), "pwm_frequency_hz"))

    def _value(self, vector: Array, name: str) -> float:
        return float(vector[self.parameters.index(name)])

    def simulate(
        self,
        experiments: Sequence[Experiment],
        *,
        solver: str = "edges",
        changes: Mapping[str, float] | None = None,
        threads: int | None = None,
        steps_per_tick: int = 1,
        states: bool = False,
    ) -> list[Recording]:
        """One recording an experiment, in order; kernels run in parallel on `threads` (default: all cores).

        A simulation that leaves the model's range stops there: its recording ends early and says when and
        why. `states` adds the true states as columns. Same experiments and seeds, same recordings, whatever
        the number of threads.
        """
        refuse_unknown("a solver is not known", solver, self.solvers)
        if steps_per_tick < 1:
            raise WrongUseError("a tick is integrated in one step or more", f"{steps_per_tick!r}")

        def one(experiment: Experiment) -> Recording:
            return self._run(experiment, solver, dict(changes or {}), steps_per_tick, states)

        workers = min(len(experiments), threads or os.cpu_count() or 1)
        if workers <= 1:
            return [one(e) for e in experiments]
        with ThreadPoolExecutor(workers) as pool:
            return list(pool.map(one, experiments))

    def _run(self, e: Experiment, solver: str, changes: dict[str, float], steps: int, states: bool) -> Recording:
        vector = self.parameters.vector({f"pwm_{k}": float(v) for k, v in e.pwm.items()} | changes | dict(e.parameters))
        injected = np.ascontiguousarray(e.injected)
        injected.setflags(write=False)  # one kind of array, one compiled kernel
        references = np.ascontiguousarray(e.references * np.array(self.to_si))
        inputs = kernel.Inputs(references, injected, INJECTIONS[e.injection], e.closed_loop, start_state(e.seed))
        ticks = period_ticks(e.rate_hz, self._value(vector, "pwm_frequency_hz"))
        pwm = kernel.Pwm(1.0 / e.rate_hz, ticks, self._value(vector, "pwm_dead_zone"))
        out = np.empty((e.samples, len(self.logged) if states else self.measured))
        ended, n = self._integrated(vector, e, (controllers(e), inputs, pwm), solver, steps, out)
        early = None if ended == kernel.COMPLETE else f"{ENDED[ended]} at {n / e.rate_hz:.3f} s"
        return Recording(RecordingInfo.of(e, early), e.rate_hz, self._columns(e, out[:n]))

    def _integrated(
        self, vector: Array, e: Experiment, how: Driven, solver: str, steps: int, out: Array
    ) -> tuple[int, int]:
        """Run the kernel into `out`; gives why it ended and how many rows are filled."""
        raise NotImplementedError

    def _states(self, logged: Mapping[str, Array]) -> dict[str, Array]:
        """Columns of the true states."""
        raise NotImplementedError

    def _columns(self, e: Experiment, out: Array) -> dict[str, Array]:
        n, free = len(out), e.injection == "control"  # then what is injected is z itself
        logged = dict(zip(self.logged, out.T, strict=False))
        seen = self.logged[: self.measured]
        measured = {f"{name}_rad": logged[name] for name in seen if name.startswith("theta")}
        measured |= {f"{name}_bar": 1e-5 * logged[name] for name in seen if name.startswith("p_")}
        columns = {"t_s": np.arange(n) / e.rate_hz}
        controls = [name for name in seen if name.startswith("z_")]
        for k, (loop, control) in enumerate(zip(e.loops, controls, strict=True)):
            columns[str(loop.reference)] = e.references[:n, k]
            columns[str(loop.injected)] = np.zeros(n) if free else e.injected[:n, k]
            columns[loop.control] = logged[control]
            if loop.output in measured:
                columns[loop.output] = measured[loop.output]
        columns |= {name: values for name, values in measured.items() if name not in columns}
        columns |= {f"{name}_v": logged[name] for name in seen if name.startswith("u_")}
        return columns | (self._states(logged) if len(logged) > self.measured else {})


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def period_ticks(rate_hz: float, pwm_hz: float) -> int:
    """Controller samples in a PWM period; refuses a period that is no whole number of them."""
    ticks = rate_hz / pwm_hz
    if abs(ticks - round(ticks)) > 1e-9 or ticks < 1:
        raise WrongUseError(
            "a PWM period must be a whole number of controller samples", f"{pwm_hz:g} Hz at {rate_hz:g} Hz"
        )
    return round(ticks)


def controllers(e: Experiment) -> kernel.Controllers:
    """The loops' controllers with their schedules and decoupling, as the kernels take them."""
    loops = e.loops
    signals = [(loop.name, what) for what in (Follows.REFERENCE, Follows.OUTPUT) for loop in loops]
    plain = kernel.plain_controllers(*(sections(loop, e) for loop in loops))
    own = [loop.schedule for loop in loops]
    made = tuple(one.tables(signals) if isinstance(one, GainScheduled) else plain.schedules[0] for one in own)
    scheduled = np.array([one is not None for one in own])
    return plain._replace(schedules=made, scheduled=scheduled, decoupling=decoupling_matrix(loops))


def sections(loop: LoopSetup, e: Experiment) -> Array:
    """Biquads (n, 5) of a loop's controller, idle ones where it has a schedule; refuses one at another rate."""
    runs = loop.schedule or loop.controller
    if runs is None or runs.rate_hz != e.rate_hz:
        raise WrongUseError(f"loop {loop.name} needs a controller at the rig's rate {e.rate_hz:g} Hz")
    return np.zeros((1, 5)) if loop.controller is None else loop.controller.biquads()
