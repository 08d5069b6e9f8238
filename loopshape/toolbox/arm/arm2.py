"""The 2-DoF arm as a plant: experiments in, recordings out, in parallel over experiments."""

from __future__ import annotations

from collections.abc import Mapping

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, rad
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import Experiment
from loopshape.toolbox.arm.dynamics import closed_loop2 as kernel
from loopshape.toolbox.arm.dynamics.equilibrium2 import resting
from loopshape.toolbox.arm.parameters import P_IN
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2, named, sensor_constants2
from loopshape.toolbox.arm.simulation import Arm, Driven
from loopshape.toolbox.arm.strategies2 import DUAL, PAIRS, Strategy


class Arm2(Arm):
    """Two joints, muscles A and B at theta2, C and D at theta1 (`Plant`, `Rig`), driven by a strategy.

    By default the source's: loops theta1, theta2, p_a and p_c; `PAIRS` has theta1, theta2, p_ab and p_cd. It has no
    catalogue of effects: the gas law alone can be corrected, by `gas_absolute_share` and `polytropic_exponent`.
    """

    title = "the 2-DoF arm"
    to_si = (1.0, 1.0, 1e5, 1e5)
    solvers: tuple[str, ...] = ("edges",)
    parameters = ARM2_PARAMETERS
    logged = kernel.LOGGED
    measured = kernel.MEASURED

    def __init__(self, strategy: Strategy = DUAL) -> None:
        self.strategy = strategy
        self.name = strategy.plant
        self.controllers = strategy.controllers
        self.point_keys: tuple[str, ...] = strategy.point_keys
        self.wired = {loop: (f"z_{loop}_v", output) for loop, output in strategy.outputs.items()}
        self.loops: tuple[str, ...] = strategy.loops
        self.channels: tuple[Channel, ...] = (
            Channel("theta1", "rad"),
            Channel("theta2", "rad"),
            *(Channel(f"p_{m}", "bar") for m in "abcd"),
            *(Channel(f"z_{loop}", "v") for loop in strategy.loops),
            *(Channel(f"u_{m}", "v") for m in "abcd"),
        )

    def setpoint(self, operating_point: Mapping[str, float]) -> tuple[float, float, float, float]:
        """The references (rad, rad, bar, bar) at an operating point."""
        theta1, theta2, first, second = (float(operating_point[key]) for key in self.strategy.point_keys)
        return float(rad(theta1)), float(rad(theta2)), first, second

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse a point with other keys than the strategy's `point_keys`, or without an equilibrium in range."""
        self.refuse_other_keys(operating_point)
        vector = self.parameters.vector(changes)
        p = named(vector)
        theta1, theta2, first, second = (operating_point[key] for key in self.point_keys)
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

    def _integrated(
        self, vector: Array, e: Experiment, how: Driven, solver: str, steps: int, out: Array
    ) -> tuple[int, int]:
        c = constants2(vector, self.strategy.shared)
        x = self._rest(c, e.operating_point)
        return kernel.run2(c, sensor_constants2(vector), x, *how, steps, out)

    def _states(self, logged: Mapping[str, Array]) -> dict[str, Array]:
        columns = {f"true_theta{j}_rad": logged[f"angle{j}"] for j in (1, 2)}
        columns |= {f"true_velocity{j}_rad_s": logged[f"velocity{j}"] for j in (1, 2)}
        columns |= {f"true_p_{m}_bar": 1e-5 * logged[f"true_{m}"] for m in "abcd"}
        return columns | {"true_p_capacity_bar": 1e-5 * logged["capacity"]}

    def _rest(self, c: Array, operating_point: Mapping[str, float]) -> Array:
        """State (9,) at rest at an operating point; refuses one without an equilibrium."""
        point = [float(operating_point[key]) for key in self.strategy.point_keys]
        four = self.strategy.four(c, point[0], point[1], point[2], point[3])
        names = (key.removesuffix("_bar").removeprefix("p_").upper() for key in self.strategy.point_keys[2:])
        asked = ", ".join(f"p_{name} {bar:g} bar" for name, bar in zip(names, point[2:], strict=True))
        return resting(four, point[0], point[1], float(c[P_IN]), asked)


def arm2_pairs() -> Arm2:
    """The 2-DoF arm with what each muscle of a pair is measured and driven by in common."""
    return Arm2(PAIRS)
