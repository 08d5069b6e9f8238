"""The 1-DoF arm as a plant: experiments in, recordings out, in parallel over experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, deg, rad
from loopshape.data.control.controller import Block
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.arm.dynamics import closed_loop as kernel
from loopshape.toolbox.arm.dynamics.equilibrium import pressures, rest
from loopshape.toolbox.arm.effect import following
from loopshape.toolbox.arm.effect.effects import FORMS, SPREAD
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, P_IN, constants, sensor_constants
from loopshape.toolbox.arm.simulation import Arm, Driven

SOLVERS = {"edges": kernel.EDGES, "grid": kernel.GRID}
_DEFAULTS: dict[str, tuple[Block, ...]] = {
    "theta2": (
        Block("gain", {"gain": 11.0}),
        Block("lead_lag", {"f1_hz": 2.2, "f2_hz": 18.0}),
        Block("notch", {"f1_hz": 4.5, "f2_hz": 4.5, "damping1": 0.05, "damping2": 5.0}),
        Block("low_pass_2", {"f_hz": 19.0, "damping": 0.55}),
    ),
    "p_ab": (Block("gain", {"gain": 6.0}), Block("low_pass_1", {"f_hz": 10.0})),
}


class Arm1(Arm):
    """One joint, two antagonistic muscles A and B (`Plant`); loops theta2 and p_AB = p_A + p_B."""

    name = "arm-1dof"
    title = "the 1-DoF arm"
    loops: tuple[str, ...] = ("theta2", "p_ab")
    wired: Mapping[str, tuple[str, str]] = {
        "theta2": ("z_theta2_v", "theta2_rad"),
        "p_ab": ("z_p_v", "p_a_bar + p_b_bar"),
    }
    to_si = (1.0, 1e5)
    point_keys = ("theta2_deg", "p_ab_bar")
    controllers = _DEFAULTS
    logged = kernel.LOGGED
    measured = kernel.MEASURED
    solvers: tuple[str, ...] = tuple(SOLVERS)
    parameters = ARM1_PARAMETERS
    effects = FORMS
    spread = SPREAD
    trace_channel = "theta2 [deg]"
    calibrated = True
    places: Mapping[str, tuple[str, ...]] = {
        "flow A": ("p_a",),
        "flow B": ("p_b",),
        "both flows": ("p_a", "p_b"),
        "torque": ("theta2",),
    }
    needs: tuple[str, ...] = ("theta2_rad", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v")
    channels: tuple[Channel, ...] = (
        Channel("theta2", "rad"),
        Channel("p_a", "bar"),
        Channel("p_b", "bar"),
        Channel("z_theta2", "v"),
        Channel("z_p", "v"),
        Channel("u_a", "v"),
        Channel("u_b", "v"),
    )

    def readied(self, run: Run, names: Sequence[str]) -> tuple[Arm1, Run, list[str]]:
        """An arm whose nominal numbers are those that the run states; recordings are followed as they are."""
        own = copy(self)
        own.parameters = self.parameters.holding(dict(run.extra.get("parameters", {})))
        return own, run, list(names)

    def stays_in_range(self, recording: Recording, run: Run) -> bool:
        """Whether the measured angle and pressures lie where the model holds, with a little room for noise."""
        table = self.parameters.vector()
        angle = float(np.abs(deg(recording.column("theta2_rad"))).max())
        low = min(float(recording.column(c).min()) for c in ("p_a_bar", "p_b_bar"))
        high = max(float(recording.column(c).max()) for c in ("p_a_bar", "p_b_bar"))
        widest, bottom, top = (self._value(table, f"range_{k}") for k in ("angle_deg", "low_bar", "high_bar"))
        return angle < 1.1 * widest and low > 0.5 * bottom and high < 1.1 * top

    def prepare(self, recording: Recording, run: Run, longest_s: float | None) -> following.Followed:
        """The recording's commands and what was measured, for `residuals`."""
        f = following.simulated_along(recording, run, longest_s)
        return following.with_capacity_slopes(f, self.parameters.vector(f.parameters))

    def residuals(self, prepared: following.Followed, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus modelled: `p_a`, `p_b` in mbar (u -> p), `theta2` in deg (p -> theta)."""
        return following.residuals(prepared, self.parameters.vector(dict(prepared.parameters) | dict(moves)))

    def residual_rate_hz(self, prepared: following.Followed, channel: str) -> float:
        """How many values a second `residuals` gives of a channel."""
        rows = following.ANGLE_BLOCK if channel == "theta2" else following.P_BLOCK
        return 1.0 / (prepared.row_s * rows)

    def traces(self, prepared: following.Followed, moves: Mapping[str, float]) -> tuple[float, Array, Array]:
        """Time step in s, measured and simulated theta2 in deg (u -> theta2), for the eye."""
        return following.trace(prepared, self.parameters.vector(dict(prepared.parameters) | dict(moves)))

    def shapes(self, prepared: Sequence[Any]) -> None:
        """None: its submodels follow what was measured, and say themselves where a disturbance would act."""

    def paths(self, prepared: following.Followed, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus simulated relative to its noise floor: u -> p_a, u -> p_b, p -> theta2, u -> theta2."""
        return following.paths(prepared, self.parameters.vector(dict(prepared.parameters) | dict(moves)))

    def floors(self, prepared: following.Followed) -> dict[str, float]:
        """Rms that sensors and converters leave in `residuals`, in its units."""
        return following.floors(prepared)

    def setpoint(self, operating_point: Mapping[str, float]) -> tuple[float, float]:
        """The references (rad, bar) at an operating point."""
        return float(rad(operating_point["theta2_deg"])), float(operating_point["p_ab_bar"])

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse a point with other keys than theta2_deg and p_ab_bar, or without an equilibrium in range."""
        self.refuse_other_keys(operating_point)
        vector = self.parameters.vector(changes)
        theta, p_ab = operating_point["theta2_deg"], operating_point["p_ab_bar"]
        low, high, widest = (self._value(vector, f"range_{k}") for k in ("low_bar", "high_bar", "angle_deg"))
        pair = pressures(constants(vector), theta, p_ab)
        if not (abs(theta) < widest and low <= min(pair) and max(pair) <= high):
            raise WrongUseError(
                f"the 1-DoF arm cannot stand there: its model holds for {low:g} to {high:g} bar in each muscle",
                f"theta2 {theta:g} deg, p_AB {p_ab:g} bar, which asks for {pair[0]:.3g} and {pair[1]:.3g} bar",
                "choose a point inside",
            )

    def _integrated(
        self, vector: Array, e: Experiment, how: Driven, solver: str, steps: int, out: Array
    ) -> tuple[int, int]:
        c = constants(vector)
        x = rest(c, e.operating_point["theta2_deg"], e.operating_point["p_ab_bar"], float(c[P_IN]))
        return kernel.run(kernel.at_rest(c, x), sensor_constants(vector), *how, SOLVERS[solver], steps, out)

    def _states(self, logged: Mapping[str, Array]) -> dict[str, Array]:
        columns = {"true_theta2_rad": logged["angle"], "true_velocity_rad_s": logged["velocity"]}
        pressures = {"a": "true_a", "b": "true_b", "c": "p_c"}
        return columns | {f"true_p_{m}_bar": 1e-5 * logged[name] for m, name in pressures.items()}
