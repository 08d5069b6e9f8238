"""The arm's workload for benchmarks: tracking steps of +-20 deg and 0.2 bar, default controllers."""

from __future__ import annotations

import numpy as np

from loopshape.data.signal.experiment import Experiment
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, P_IN, constants

SECONDS = 100.0


def references(seconds: float = SECONDS) -> np.ndarray:
    """Setpoints (n, 2) in rad and Pa: a step every 2.5 s."""
    levels = np.radians([0.0, 20.0, -20.0, 10.0, -10.0])
    tick = np.arange(round(1000 * seconds))
    angle = levels[(tick // 2500) % 5]
    pressure = np.where((tick // 5000) % 2 == 0, 1.0e5, 1.2e5)
    return np.ascontiguousarray(np.stack([angle, pressure], axis=1))


def biquads() -> np.ndarray:
    """Both loops' sections (2, 4, 5), the shorter one padded with unity."""
    out = np.zeros((2, 4, 5))
    out[:, :, 0] = 1.0
    for k, controller in enumerate(Arm1().default_controllers(1000.0)):
        sections = controller.biquads()
        out[k, : len(sections)] = sections
    return out


def start() -> np.ndarray:
    """The arm at rest at (0 deg, 1 bar), state in SI."""
    c = constants(ARM1_PARAMETERS.vector())
    return rest(c, 0.0, 1.0, float(c[P_IN]))


def all_effects() -> dict[str, float]:
    """Parameter changes that switch every effect on, each by its first form in the middle of what usually occurs."""
    first = {form.effect: form for form in reversed(Arm1.effects)}
    moves = [form.at(0.5 * sum(form.usual)).moves for form in first.values()]
    return {name: value for move in moves for name, value in move.items()}


def experiments(count: int, seconds: float = SECONDS) -> list[Experiment]:
    """The workload as experiments, each with its own noise."""
    plant = Arm1()
    loops = plant.loop_setups(plant.default_controllers(1000.0), "reference")
    r = references(seconds) * np.array([1.0, 1e-5])
    return [
        Experiment(
            name=f"w{k}",
            kind="staircase",
            loops=loops,
            rate_hz=1000.0,
            references=r.copy(),
            injected=np.zeros_like(r),
            injection="reference",
            operating_point={"theta2_deg": 0.0, "p_ab_bar": 1.0},
            seed=k,
            parameters={"range_low_bar": 0.0, "range_high_bar": 10.0},
        )
        for k in range(count)
    ]
