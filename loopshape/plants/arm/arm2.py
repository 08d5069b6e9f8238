"""The 2-DoF arm as a plant: experiments in, recordings out, in parallel over experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from loopshape.channel import Channel
from loopshape.controller import Block, Controller
from loopshape.errors import WrongUseError
from loopshape.experiment import Experiment, LoopSetup
from loopshape.kernels.noise import start_state
from loopshape.plants.arm import closed_loop2 as kernel
from loopshape.plants.arm.equilibrium2 import pressures2, rest2
from loopshape.plants.arm.parameters import P_IN
from loopshape.plants.arm.parameters2 import ARM2_PARAMETERS, constants2, named, sensor_constants2
from loopshape.plants.arm.simulation import INJECTIONS, check_request, each, info, period_ticks, sections
from loopshape.recording import Recording
from loopshape.units import Array, rad

POINT_KEYS = ("theta1_deg", "theta2_deg", "p_a_bar", "p_c_bar")
_PRESSURE = (Block("gain", {"gain": 5.0}), Block("low_pass_1", {"f_hz": 4.0}))
_DEFAULTS: dict[str, tuple[Block, ...]] = {
    "theta1": (
        Block("gain", {"gain": 9.9}),
        Block("lead_lag", {"f1_hz": 0.22, "f2_hz": 8.0}),
        Block("notch", {"f1_hz": 1.65, "f2_hz": 1.65, "damping1": 0.1, "damping2": 4.0}),
        Block("low_pass_2", {"f_hz": 6.0, "damping": 0.8}),
    ),
    "theta2": (
        Block("gain", {"gain": 5.7}),
        Block("lead_lag", {"f1_hz": 3.7, "f2_hz": 18.0}),
        Block("notch", {"f1_hz": 4.5, "f2_hz": 4.5, "damping1": 0.06, "damping2": 4.7}),
        Block("low_pass_2", {"f_hz": 12.0, "damping": 0.8}),
    ),
    "p_a": _PRESSURE,
    "p_c": _PRESSURE,
}
_UNITS = {"theta1": "rad", "theta2": "rad", "p_a": "bar", "p_c": "bar"}


class Arm2:
    """Two joints, muscles A and B at theta2, C and D at theta1 (`Plant`, `Rig`); loops theta1, theta2, p_a and p_c.

    It has no catalogue of effects: the gas law alone can be corrected, by `gas_absolute_share` and
    `polytropic_exponent`.
    """

    name = "arm-2dof"
    loops: tuple[str, ...] = tuple(_DEFAULTS)
    solvers: tuple[str, ...] = ("edges",)
    parameters = ARM2_PARAMETERS
    channels: tuple[Channel, ...] = (
        Channel("theta1", "rad"),
        Channel("theta2", "rad"),
        *(Channel(f"p_{m}", "bar") for m in "abcd"),
        *(Channel(f"z_{loop}", "v") for loop in _DEFAULTS),
        *(Channel(f"u_{m}", "v") for m in "abcd"),
    )

    def default_controllers(self, rate_hz: float) -> tuple[Controller, ...]:
        """The source's structures with numbers that hold the printed model (ARM.md, section 10)."""
        return tuple(Controller(loop, blocks, rate_hz) for loop, blocks in _DEFAULTS.items())

    def loop_setups(self, controllers: Sequence[Controller], injection: str) -> tuple[LoopSetup, ...]:
        """Columns of all four loops; what enters at the plant's input is in V."""
        known = {c.loop: c for c in controllers}
        if set(known) != set(self.loops):
            raise WrongUseError(
                "the 2-DoF arm needs a controller for each of its loops theta1, theta2, p_a and p_c",
                ", ".join(known) or "none",
            )
        volts = injection == "plant_input"
        return tuple(
            LoopSetup(
                loop, f"r_{loop}_{unit}", f"n_{loop}_{'v' if volts else unit}", f"z_{loop}_v", f"{loop}_{unit}",
                known[loop],
            )
            for loop, unit in _UNITS.items()
        )  # fmt: skip

    def setpoint(self, operating_point: Mapping[str, float]) -> tuple[float, float, float, float]:
        """The references (rad, rad, bar, bar) at an operating point."""
        theta1, theta2, p_a, p_c = (float(operating_point[key]) for key in POINT_KEYS)
        return float(rad(theta1)), float(rad(theta2)), p_a, p_c

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse a point with other keys than `POINT_KEYS`, or without an equilibrium in range."""
        if set(operating_point) != set(POINT_KEYS):
            raise WrongUseError(
                "an operating point of the 2-DoF arm names theta1_deg, theta2_deg, p_a_bar and p_c_bar",
                f"{dict(operating_point)!r}",
            )
        vector = self.parameters.vector(changes)
        p = named(vector)
        theta1, theta2, p_a, p_c = (operating_point[key] for key in POINT_KEYS)
        four = pressures2(constants2(vector), theta1, theta2, p_a, p_c)
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
        p, c = named(vector), constants2(vector)
        point = [e.operating_point[key] for key in POINT_KEYS]
        x = rest2(c, point[0], point[1], point[2], point[3], float(c[P_IN]))
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


def _columns(e: Experiment, out: Array, n: int) -> dict[str, Array]:
    free = e.injection == "control"  # then what is injected is z itself
    logged = {name: out[:, k] for k, name in enumerate(kernel.LOGGED[: out.shape[1]])}
    columns = {"t_s": np.arange(n) / e.rate_hz}
    for k, loop in enumerate(e.loops):
        in_pa = loop.output.endswith("_bar")
        columns[str(loop.reference)] = e.references[:n, k]
        columns[str(loop.injected)] = np.zeros(n) if free else e.injected[:n, k]
        columns[loop.control] = logged[f"z_{loop.name}"]
        columns[loop.output] = 1e-5 * logged[loop.name] if in_pa else logged[loop.name]
    columns |= {"p_b_bar": 1e-5 * logged["p_b"], "p_d_bar": 1e-5 * logged["p_d"]}
    columns |= {f"u_{m}_v": logged[f"u_{m}"] for m in "abcd"}
    if "capacity" in logged:
        columns |= {f"true_theta{j}_rad": logged[f"angle{j}"] for j in (1, 2)}
        columns |= {f"true_velocity{j}_rad_s": logged[f"velocity{j}"] for j in (1, 2)}
        columns |= {f"true_p_{m}_bar": 1e-5 * logged[f"true_{m}"] for m in "abcd"}
        columns["true_p_capacity_bar"] = 1e-5 * logged["capacity"]
    return columns
