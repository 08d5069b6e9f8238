"""Higher supply: identified, tuned and stepped anew at the same requirements, everything else as it was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopshape.core.units import db, deg, rad
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.requirement.weight import Objective
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.margins import Margins
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording
from loopshape.design.tune import Search, tune
from loopshape.identify.fit import fit, structure_by_name
from loopshape.identify.frequency_response import estimate_frf
from loopshape.loop.verdict import check
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.linear import Linearisation, linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.rig.simulated import header, measure
from loopshape.toolbox.rig.study import Study
from loopshape.toolbox.schedules.schedule import Schedule, schedule
from loopshape.toolbox.validation.remeasured import recorded_steps


@dataclass(frozen=True, eq=False)
class AtSupply:
    """What one supply gives: controllers with margins by recording, linearisations, and steps."""

    supply_bar: float
    robust: Controller
    robust_margins: Mapping[str, Margins]
    own: Schedule
    own_margins: Mapping[str, Margins]
    lin: Mapping[str, Linearisation]
    small: list[dict]
    large: list[dict]
    rejection: Mapping[str, Sequence[float]]
    chosen: Mapping[tuple[float, ...], Controller]
    fitted: Mapping[tuple[float, ...], tuple[float, float, float]]


def at_supply(study: Study, asked: Requirements, supply_bar: float, settings: Mapping[str, Any]) -> AtSupply:
    """Identify, tune one controller for all points and one for each, and step with both."""
    mine, arm = replace(study, changes={"supply_bar": supply_bar}), Arm1()
    loop = header(mine, arm).loop("theta2")
    frfs = [estimate_frf(recording, loop) for recording in measure(mine, arm)]
    fits = [fit(frf, structure_by_name("third_order")) for frf in frfs]
    search = Search(starts=settings["starts"], draws=settings["draws"])
    robust = tune(frfs, asked, fits, search=search).controller
    own = own_ones(frfs, asked, robust, fits, settings)
    sets = {"robust": [robust] * len(frfs), "own": [p.own for p in own.points]}
    if supply_bar == settings["disturbance_at_bar"]:
        required = replace(asked, objective=Objective(0.0, 1.0, settings["disturbance_below_hz"]))
        other = tune(frfs, required, fits, search=search).controller
        sets["robust, low lines"] = [other] * len(frfs)
        sets["own, low lines"] = [tune([frf], required, fits, explain=False, search=search).controller for frf in frfs]
    numbers = constants(ARM1_PARAMETERS.vector({"supply_bar": supply_bar}))
    pressure = pressure_controller(supply_bar)
    return AtSupply(
        supply_bar,
        robust,
        check(frfs, robust, asked, fits).margins,
        own,
        {
            p.recording: check([f], p.own, asked, fits).margins[f.recording]
            for p, f in zip(own.points, frfs, strict=True)
        },
        {p.recording: linearise(numbers, **p.operating_point) for p in own.points},
        small_steps(own, sets, pressure, supply_bar, settings),
        large_steps(robust, pressure, supply_bar, settings),
        {
            word: [rejection_db(f, c, settings["disturbance_below_hz"]) for f, c in zip(frfs, each, strict=True)]
            for word, each in sets.items()
        },
        {tuple(p.operating_point.values()): c for p, c in zip(own.points, list(sets.values())[-1], strict=True)},
        {tuple(p.operating_point.values()): numbers_of(f) for p, f in zip(own.points, fits, strict=True)},
    )


def own_ones(
    frfs: Sequence[FRF], asked: Requirements, robust: Controller, fits: Sequence[Fit], settings: Mapping[str, Any]
) -> Schedule:
    """A controller for each point; where the search did not better the robust one it is repeated with more starts."""
    found = schedule(frfs, asked, robust, fits, bounds=False, starts=settings["starts"])
    again = {
        frf.recording: schedule([frf], asked, robust, fits, bounds=False, seed=1, starts=settings["starts_again"])
        for frf, p in zip(frfs, found.points, strict=True)
        if not p.tuned
    }
    return replace(
        found, points=tuple(again[p.recording].points[0] if p.recording in again else p for p in found.points)
    )


def rejection_db(frf: FRF, controller: Controller, below_hz: float) -> float:
    """Mean of 1/|S| in dB on the valid lines up to a frequency."""
    lines = frf.valid_lines()
    low = lines.frequency_hz <= below_hz
    return float(np.mean(db(1.0 + controller.response(lines.frequency_hz[low]) * lines.siso[low])))


def numbers_of(one: Fit) -> tuple[float, float, float]:
    """kappa in rad/(V s3), f in Hz and zeta of a third-order fit."""
    kappa, f_hz, zeta = (one[name].value for name in ("kappa", "f_hz", "zeta"))
    return kappa, f_hz, zeta


def pressure_controller(supply_bar: float) -> Controller:
    """The arm's own, its gain divided by how much faster both valves are at (0 deg, 1 bar): the same loop gain."""
    usual = next(c for c in Arm1().default_controllers(1000.0) if c.loop == "p_ab")
    gains = [
        linearise(constants(ARM1_PARAMETERS.vector({"supply_bar": s})), 0.0, 1.0).mean_gains.sum()
        for s in (1.0, supply_bar)
    ]
    blocks = tuple(
        Block(b.kind, {"gain": b.parameters["gain"] * gains[0] / gains[1]}) if b.kind == "gain" else b
        for b in usual.blocks
    )
    return replace(usual, blocks=blocks)


def step(
    controllers: Sequence[Controller], point: Mapping[str, float], size_deg: float, settings: Mapping[str, Any],
    name: str, supply_bar: float,
) -> Experiment:  # fmt: skip
    """A step of the angle from rest at a point."""
    arm, rate = Arm1(), 1000.0
    n = round((settings["step_at_s"] + settings["step_lasts_s"]) * rate)
    references = np.tile(arm.setpoint(point), (n, 1))
    references[round(settings["step_at_s"] * rate) :, 0] += rad(size_deg)
    loops = arm.loop_setups(controllers, "reference")
    return Experiment(
        name, "staircase", loops, rate, references, np.zeros((n, 2)), "reference", dict(point),
        seed=settings["seed"], parameters={"supply_bar": supply_bar},
    )  # fmt: skip


def looked_at(recording: Recording, e: Experiment, size_deg: float, at_s: float) -> dict[str, float]:
    """Settling, rise, overshoot, the integral of |error| over the step's size, greatest speed, time of saturation."""
    (found,) = recorded_steps(recording, e.loops[0])
    after = recording.column("t_s") >= at_s
    u = np.abs(np.stack([recording.column(f"u_{k}_v")[after] for k in "ab"])).max(axis=0)
    speed = np.abs(deg(recording.column("true_velocity_rad_s")))[after].max()
    m = found.measured
    return {
        "settling_s": m.settling_time_s, "settling_5_s": m.settling_time_5_s, "rise_s": m.rise_time_s,
        "mean_error_s": float(np.abs(deg(e.references[after, 0] - recording.column("true_theta2_rad")[after])).sum()
                              / recording.rate_hz / abs(size_deg)),
        "overshoot_deg": m.overshoot * abs(size_deg), "greatest_speed_deg_s": float(speed),
        "saturated_s": float((u >= 1.0).sum() / recording.rate_hz), "greatest_u_v": float(u.max()),
    }  # fmt: skip


def run_steps(made: Sequence[tuple[dict, Experiment, float]], at_s: float) -> list[dict]:
    """Simulate steps; a line each. One that ended early says so and has no numbers."""
    out = []
    for (row, e, size), recording in zip(
        made, Arm1().simulate([e for _, e, _ in made], threads=1, states=True), strict=True
    ):
        early = recording.info.ended_early
        out.append(
            {**row, "size_deg": size, "ended": early or "", **({} if early else looked_at(recording, e, size, at_s))}
        )
    return out


def small_steps(
    own: Schedule, sets: Mapping[str, Sequence[Controller]], pressure: Controller, supply_bar: float,
    settings: Mapping[str, Any],
) -> list[dict]:  # fmt: skip
    """At each point a small step towards the middle with each of the point's controllers."""
    made = []
    for word, controllers in sets.items():
        for p, c in zip(own.points, controllers, strict=True):
            size = settings["small_step_deg"] * (-1.0 if p.operating_point["theta2_deg"] > 0.0 else 1.0)
            e = step((c, pressure), p.operating_point, size, settings, f"{word}-{p.recording}", supply_bar)
            made.append(({"supply_bar": supply_bar, **p.operating_point, "controller": word}, e, size))
    return run_steps(made, settings["step_at_s"])


def large_steps(robust: Controller, pressure: Controller, supply_bar: float, settings: Mapping[str, Any]) -> list[dict]:
    """Steps about the middle with the robust controller, where valves saturate."""
    made = []
    for begin, size in settings["large_steps_deg"]:
        point = {"theta2_deg": begin, "p_ab_bar": settings["large_p_ab_bar"]}
        e = step((robust, pressure), point, size, settings, f"large-{size:g}", supply_bar)
        made.append(({"supply_bar": supply_bar, **point, "controller": "robust"}, e, size))
    middle = {"theta2_deg": 0.0, "p_ab_bar": settings["large_p_ab_bar"]}
    return [*run_steps(made, settings["step_at_s"]), full_command(middle, pressure, supply_bar, settings)]


def full_command(
    point: Mapping[str, float], pressure: Controller, supply_bar: float, settings: Mapping[str, Any]
) -> dict:
    """z_theta2 = 1 V from rest with the loops open: how soon the valves alone turn the joint."""
    arm, rate, n = Arm1(), 1000.0, 1000
    injected = np.tile([1.0, 0.0], (n, 1))
    loops = arm.loop_setups((arm.default_controllers(rate)[0], pressure), "control")
    e = Experiment(
        "full", "open_loop", loops, rate, np.tile(arm.setpoint(point), (n, 1)), injected, "control", dict(point),
        closed_loop=False, seed=settings["seed"], parameters={"supply_bar": supply_bar},
    )  # fmt: skip
    recording = arm.simulate([e], threads=1, states=True)[0]
    angle, t = deg(recording.column("true_theta2_rad")), recording.column("t_s")
    through = settings["through_deg"]
    times = float(t[np.argmax(angle >= through)]) if (angle >= through).any() else np.nan
    speed = float(np.abs(deg(recording.column("true_velocity_rad_s"))).max())
    return {
        "supply_bar": supply_bar,
        **point,
        "controller": "full command",
        "through_s": times,
        "greatest_speed_deg_s": speed,
    }


def supply_row(one: AtSupply) -> dict[str, float]:
    """A line of the table of supplies."""
    names = [p.recording for p in one.own.points]
    kappa = np.array([one.lin[n].third_order()[0] for n in names])
    ratio = np.array([one.lin[n].exhaust / one.lin[n].fill for n in names])
    at = [p.operating_point for p in one.own.points]
    lowest = int(np.argmin([one.robust_margins[n].bandwidth_hz for n in names]))
    return {
        "supply_bar": one.supply_bar,
        "robust_lowest_hz": min(one.robust_margins[n].bandwidth_hz for n in names),
        "at_theta2_deg": at[lowest]["theta2_deg"], "at_p_ab_bar": at[lowest]["p_ab_bar"],
        "robust_mean_hz": float(np.mean([one.robust_margins[n].bandwidth_hz for n in names])),
        "own_lowest_hz": min(p.own_hz for p in one.own.points), "own_highest_hz": max(p.own_hz for p in one.own.points),
        "own_mean_hz": float(np.mean([p.own_hz for p in one.own.points])),
        "robust_peak_cs_db": max(one.robust_margins[n].control_peak_db for n in names),
        "own_mean_peak_cs_db": float(np.mean([one.own_margins[n].control_peak_db for n in names])),
        "kappa_least": kappa.min(), "kappa_most": kappa.max(), "kappa_ratio": kappa.max() / kappa.min(),
        "exhaust_over_fill_least": ratio.min(), "exhaust_over_fill_most": ratio.max(),
        "kappa_at_0_1": float(next(k for k, p in zip(kappa, at, strict=True) if tuple(p.values()) == (0.0, 1.0))),
        "robust_gain": one.robust.blocks[0].parameters["gain"], "notch_hz": one.robust.blocks[2].parameters["f1_hz"],
    }  # fmt: skip


def point_rows(one: AtSupply) -> list[dict]:
    """A line for each point: bandwidths, margins that bind, kappa."""
    return [
        {
            "supply_bar": one.supply_bar, **p.operating_point, "robust_hz": p.robust_hz, "own_hz": p.own_hz,
            "own_peak_cs_db": one.own_margins[p.recording].control_peak_db,
            "kappa": one.lin[p.recording].third_order()[0], "f_hz": one.lin[p.recording].third_order()[1],
            "own_found": p.tuned,
            "own_gain": p.own.blocks[0].parameters["gain"], "own_notch_hz": p.own.blocks[2].parameters["f1_hz"],
            **{f"rejection_db {word}": each[k] for word, each in one.rejection.items()},
        }
        for k, p in enumerate(one.own.points)
    ]  # fmt: skip
