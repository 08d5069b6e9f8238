"""The 2-DoF arm as a plant: experiments in, recordings out, in parallel over experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.kernels.noise import start_state
from loopshape.core.units import Array, rad
from loopshape.data.channel import Channel
from loopshape.data.controller import Controller
from loopshape.data.experiment import Experiment, LoopSetup, shared_unit
from loopshape.data.recording import Recording
from loopshape.model.arm import closed_loop2 as kernel
from loopshape.model.arm.equilibrium2 import resting
from loopshape.model.arm.parameters import P_IN
from loopshape.model.arm.parameters2 import ARM2_PARAMETERS, constants2, named, sensor_constants2
from loopshape.model.arm.simulation import INJECTIONS, check_request, each, info, period_ticks, sections
from loopshape.model.arm.strategies2 import DUAL, Strategy


class Arm2:
    """Two joints, muscles A and B at theta2, C and D at theta1 (`Plant`, `Rig`), driven by a strategy.

    By default the source's: loops theta1, theta2, p_a and p_c; `PAIRS` has theta1, theta2, p_ab and p_cd. It has no
    catalogue of effects: the gas law alone can be corrected, by `gas_absolute_share` and `polytropic_exponent`.
    """

    solvers: tuple[str, ...] = ("edges",)
    parameters = ARM2_PARAMETERS

    def __init__(self, strategy: Strategy = DUAL) -> None:
        self.strategy = strategy
        self.name = strategy.plant
        self.loops: tuple[str, ...] = strategy.loops
        self.channels: tuple[Channel, ...] = (
            Channel("theta1", "rad"),
            Channel("theta2", "rad"),
            *(Channel(f"p_{m}", "bar") for m in "abcd"),
            *(Channel(f"z_{loop}", "v") for loop in strategy.loops),
            *(Channel(f"u_{m}", "v") for m in "abcd"),
        )

    def default_controllers(self, rate_hz: float) -> tuple[Controller, ...]:
        """The source's structures with numbers that hold the printed model (`strategies2`)."""
        return tuple(Controller(loop, blocks, rate_hz) for loop, blocks in self.strategy.controllers.items())

    def loop_setups(self, controllers: Sequence[Controller], injection: str) -> tuple[LoopSetup, ...]:
        """Columns of all four loops; what enters at the plant's input is in V."""
        known = {c.loop: c for c in controllers}
        if set(known) != set(self.loops):
            raise WrongUseError(
                f"the 2-DoF arm needs a controller for each of its loops {_listed(self.loops)}",
                ", ".join(known) or "none",
            )
        volts = injection == "plant_input"
        setups = []
        for loop, output in self.strategy.outputs.items():
            unit = shared_unit(output, f"the output of loop {loop}")
            injected = f"n_{loop}_{'v' if volts else unit}"
            setups.append(LoopSetup(loop, f"r_{loop}_{unit}", injected, f"z_{loop}_v", output, known[loop]))
        return tuple(setups)

    def setpoint(self, operating_point: Mapping[str, float]) -> tuple[float, float, float, float]:
        """The references (rad, rad, bar, bar) at an operating point."""
        theta1, theta2, first, second = (float(operating_point[key]) for key in self.strategy.point_keys)
        return float(rad(theta1)), float(rad(theta2)), first, second

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse a point with other keys than the strategy's `point_keys`, or without an equilibrium in range."""
        keys = self.strategy.point_keys
        if set(operating_point) != set(keys):
            raise WrongUseError(
                f"an operating point of the 2-DoF arm names {_listed(keys)}",
                f"{dict(operating_point)!r}",
            )
        vector = self.parameters.vector(changes)
        p = named(vector)
        theta1, theta2, first, second = (operating_point[key] for key in keys)
        four = self.strategy.four(constants2(vector), theta1, theta2, first, second)
        inside = all(p["range_low_bar"] <= one <= p["range_high_bar"] for one in four)
        if not (abs(theta1) < p["range_angle1_deg"] and abs(theta2) < p["range_angle_deg"] and inside):
            raise WrongUseError(
                f"the 2-DoF arm cannot stand there: its model holds for {p['range_low_bar']:g} to "
                f"{p['range_high_bar']:g} bar in each muscle, theta1 within {p['range_angle1_deg']:g} deg and theta2 "
                f"within {p['range_angle_deg']:g} deg",
                f"theta1 {theta1:g} deg, theta2 {theta2:g} deg, which asks for "
                + ", ".join(f"p_{m} {one:.3g}" for m, one in zip("ABCD", four, strict=True))
                + " bar",
                "choose a point inside",
            )

    def check_settings(self, rate_hz: float, changes: Mapping[str, float]) -> None:
        """Refuse unknown or out-of-bounds parameters, and a PWM period that is no whole number of samples."""
        period_ticks(rate_hz, named(self.parameters.vector(changes))["pwm_frequency_hz"])

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
        check_request(solver, self.solvers, steps_per_tick)

        def one(experiment: Experiment) -> Recording:
            return self._run(experiment, dict(changes or {}), steps_per_tick, states)

        return each(experiments, one, threads)

    def _run(self, e: Experiment, changes: dict[str, float], steps: int, states: bool) -> Recording:
        vector = self.parameters.vector({f"pwm_{k}": float(v) for k, v in e.pwm.items()} | changes | dict(e.parameters))
        p, c = named(vector), constants2(vector, self.strategy.shared)
        x = self._rest(c, e.operating_point)
        k1, k2, k3, k4 = controllers = [sections(loop, e) for loop in e.loops]
        state = np.zeros((4, max(b.shape[0] for b in controllers), 2))
        references = np.ascontiguousarray(e.references * np.array([1.0, 1.0, 1e5, 1e5]))
        injected = np.ascontiguousarray(e.injected)
        injected.setflags(write=False)  # one kind of array, one compiled kernel
        out = np.empty((e.samples, len(kernel.LOGGED) if states else kernel.MEASURED))
        ended, n = kernel.run2(
            c, sensor_constants2(vector), x, k1, k2, k3, k4, state, references, injected, INJECTIONS[e.injection],
            e.closed_loop, 1.0 / e.rate_hz, period_ticks(e.rate_hz, p["pwm_frequency_hz"]), p["pwm_dead_zone"],
            steps, start_state(e.seed), out,
        )  # fmt: skip
        return Recording(info(e, ended, n), e.rate_hz, _columns(e, out[:n], n))

    def _rest(self, c: Array, operating_point: Mapping[str, float]) -> Array:
        """State (9,) at rest at an operating point; refuses one without an equilibrium."""
        point = [float(operating_point[key]) for key in self.strategy.point_keys]
        four = self.strategy.four(c, point[0], point[1], point[2], point[3])
        names = (key.removesuffix("_bar").removeprefix("p_").upper() for key in self.strategy.point_keys[2:])
        asked = ", ".join(f"p_{name} {bar:g} bar" for name, bar in zip(names, point[2:], strict=True))
        return resting(four, point[0], point[1], float(c[P_IN]), asked)


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _columns(e: Experiment, out: Array, n: int) -> dict[str, Array]:
    free = e.injection == "control"  # then what is injected is z itself
    logged = {name: out[:, k] for k, name in enumerate(kernel.LOGGED[: out.shape[1]])}
    measured = {f"theta{j}_rad": logged[f"theta{j}"] for j in (1, 2)}
    measured |= {f"p_{m}_bar": 1e-5 * logged[f"p_{m}"] for m in "abcd"}
    columns = {"t_s": np.arange(n) / e.rate_hz}
    for k, loop in enumerate(e.loops):
        columns[str(loop.reference)] = e.references[:n, k]
        columns[str(loop.injected)] = np.zeros(n) if free else e.injected[:n, k]
        columns[loop.control] = out[:, kernel.Z + k]
        if loop.output in measured:
            columns[loop.output] = measured[loop.output]
    columns |= {name: values for name, values in measured.items() if name not in columns}
    columns |= {f"u_{m}_v": logged[f"u_{m}"] for m in "abcd"}
    if "capacity" in logged:
        columns |= {f"true_theta{j}_rad": logged[f"angle{j}"] for j in (1, 2)}
        columns |= {f"true_velocity{j}_rad_s": logged[f"velocity{j}"] for j in (1, 2)}
        columns |= {f"true_p_{m}_bar": 1e-5 * logged[f"true_{m}"] for m in "abcd"}
        columns["true_p_capacity_bar"] = 1e-5 * logged["capacity"]
    return columns
