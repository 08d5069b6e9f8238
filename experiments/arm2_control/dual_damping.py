"""What p_A's loop does to the damping of theta2, by the dual strategy and by pairs: linear and simulated."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from arm2_closed import ClosedLinear2, close2

from loopshape.core.units import hz, rad
from loopshape.data.control.controller import Block, Controller
from loopshape.data.signal.experiment import Experiment
from loopshape.loop.predict.indicators import indicators
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.arm.dynamics.equilibrium2 import pressures2
from loopshape.toolbox.arm.dynamics.linear2 import Linearisation2, linearise2, linearise_pairs2
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.arm.strategies2 import DUAL, PAIRS, Strategy
from loopshape.toolbox.validation.remeasured import recorded_steps

DAMPING = (
    "strategy", "theta2_gain_factor", "gain_v_bar", "pressure_hz", "theta2_hz", "overshoot_percent", "rise_time_s",
    "settling_time_s", "mode_hz", "mode_damping",
)  # fmt: skip
SIMULATED = (
    "strategy", "step_deg", "gain_v_bar", "overshoot_percent", "rise_time_s", "settling_time_s", "settling_time_5_s",
    "ended_early",
)  # fmt: skip
NUMBERS = constants2(ARM2_PARAMETERS.vector())
THETA2 = 1
GRID_HZ = np.geomspace(0.003, 30.0, 4000)


def read_settings(path: Path) -> dict[str, Any]:
    """The study's settings; refuses another format."""
    with path.open("rb") as file:
        settings = tomllib.load(file)
    if settings.pop("format") != "loopshape-settings/1":
        raise SystemExit(f"{path.name}: another format than loopshape-settings/1")
    return settings


def points(settings: Mapping[str, Any]) -> dict[str, tuple[Strategy, tuple[float, ...]]]:
    """The same equilibrium in both strategies' words."""
    dual = tuple(settings["point"][key] for key in DUAL.point_keys)
    four = pressures2(NUMBERS, *dual)
    pairs = (dual[0], dual[1], four[0] + four[1], four[2] + four[3])
    return {"dual": (DUAL, dual), "pairs": (PAIRS, pairs)}


def controllers(strategy: Strategy, gain: float, rate_hz: float, factor: float = 1.0) -> tuple[Controller, ...]:
    """The dual arm's own four under either strategy's names, with A's pressure loop's gain, and theta2's changed."""
    own = dict(zip(strategy.loops, DUAL.controllers.values(), strict=True))
    held = strategy.loops[2]
    own["theta2"] = scaled(own["theta2"], factor)
    own[held] = (Block("gain", {"gain": gain}), Block("low_pass_1", {"f_hz": value("table_5_6.lowpass")}))
    return tuple(Controller(loop, blocks, rate_hz) for loop, blocks in own.items())


def scaled(blocks: Sequence[Block], factor: float) -> tuple[Block, ...]:
    """A controller with its gain times a factor."""
    return tuple(Block("gain", {"gain": factor * b.parameters["gain"]}) if b.kind == "gain" else b for b in blocks)


def linear_rows(settings: Mapping[str, Any]) -> list[list]:
    """A line a strategy, gain of theta2's controller and gain of p_A's."""
    rows = []
    for name, (strategy, point) in points(settings).items():
        lin = (linearise2 if strategy is DUAL else linearise_pairs2)(NUMBERS, *point)
        for factor in settings["theta2_gain_factors"]:
            for gain in settings["gains_v_bar"]:
                rows.append([name, factor, gain, *_linear(lin, strategy, gain, factor, settings)])
    return rows


def _linear(
    lin: Linearisation2, strategy: Strategy, gain: float, factor: float, settings: Mapping[str, Any]
) -> list[str]:
    cs = controllers(strategy, gain, settings["rate_hz"], factor)
    loop = close2(lin, cs, settings["delay_samples"])
    seconds = settings["linear_seconds"]
    y = loop.step(THETA2, seconds)[:, THETA2]
    found = indicators(np.arange(y.size) / loop.rate_hz, y, final=1.0)
    mode_hz, damping = leading(loop, THETA2)
    own = [crossing_hz(lin, cs[k], k) for k in (2, THETA2)]
    if not loop.stable:
        return [*(f"{x:.3g}" for x in own), "", "", "", f"{mode_hz:.3g}", f"{damping:.4g}"]
    numbers = (*own, 100.0 * found.overshoot, found.rise_time_s, found.settling_time_s)
    return [*(f"{x:.3g}" for x in numbers), f"{mode_hz:.3g}", f"{damping:.4g}"]


def crossing_hz(lin: Linearisation2, of: Controller, k: int) -> float:
    """First 0 dB crossing of one loop alone, all others open; nan where there is none."""
    size = np.abs(lin.response(GRID_HZ)[:, k, k] * of.response(GRID_HZ))
    below = np.flatnonzero(size < 1.0)
    if not below.size or below[0] == 0:
        return float("nan")
    at = below[0]
    share = np.log(size[at - 1]) / np.log(size[at - 1] / size[at])
    return float(GRID_HZ[at - 1] * (GRID_HZ[at] / GRID_HZ[at - 1]) ** share)


def leading(loop: ClosedLinear2, k: int) -> tuple[float, float]:
    """Frequency in Hz and damping of the oscillation with the largest share in the step of loop k."""
    z, right = np.linalg.eig(loop.dynamics)
    left = np.linalg.solve(right, loop.inputs[:, k].astype(complex))
    share = np.abs((loop.outputs[k] @ right) * left / (z - 1.0))
    swings = np.imag(z) > 1e-9
    if not swings.any():
        return float("nan"), 1.0
    pole = np.log(z[swings][np.argmax(share[swings])]) * loop.rate_hz
    return hz(abs(pole)), float(-pole.real / abs(pole))


def simulated_rows(settings: Mapping[str, Any]) -> list[list]:
    """A line a strategy, step of theta2 and gain of p_A's loop, on the simulated arm."""
    rows = []
    for name, (strategy, point) in points(settings).items():
        plant = Arm2(strategy)
        for size in settings["simulated_steps_deg"]:
            todo = [_experiment(plant, point, size, gain, settings) for gain in settings["simulated_gains_v_bar"]]
            for gain, e, r in zip(
                settings["simulated_gains_v_bar"], todo, plant.simulate(todo, threads=1), strict=True
            ):
                if r.info.ended_early:
                    rows.append([name, size, gain, "", "", "", "", r.info.ended_early])
                    continue
                (one,) = recorded_steps(r, e.loops[THETA2])
                m = one.measured
                numbers = (100.0 * m.overshoot, m.rise_time_s, m.settling_time_s, m.settling_time_5_s)
                rows.append([name, size, gain, *(f"{x:.3g}" for x in numbers), ""])
    return rows


def _experiment(
    plant: Arm2, point: Sequence[float], size_deg: float, gain: float, settings: Mapping[str, Any]
) -> Experiment:
    rate, keys = settings["rate_hz"], plant.strategy.point_keys
    start = dict(zip(keys, point, strict=True))
    n = round(settings["simulated_seconds"] * rate)
    references = np.tile(plant.setpoint(start), (n, 1))
    references[round(settings["step_at_s"] * rate) :, THETA2] += float(rad(size_deg))
    loops = plant.loop_setups(controllers(plant.strategy, gain, rate), "reference")
    return Experiment(
        f"{plant.name}-{size_deg:g}-{gain:g}", "staircase", loops, rate, references=references,
        injected=np.zeros((n, 4)), injection="reference", operating_point=start, seed=settings["seed"],
    )  # fmt: skip
