"""Open-loop runs of the arm: variants of one input, gas in a shut muscle, what holds the joint, and what steps cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from loopshape.core.units import Array, deg
from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.model import geometry, muscle, nominal_length
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import experiment, plan

STUDY = Path(__file__).parent / "study.toml"
PA = 1e5  # Pa per bar


@dataclass(frozen=True, eq=False)
class Trace:
    """True states of one run: time in s, angle in deg, pressures in bar, valve commands in V; why it ended early."""

    time_s: Array
    theta2_deg: Array
    p_a_bar: Array
    p_b_bar: Array
    u_a_v: Array
    u_b_v: Array
    ended_early: str | None

    def until(self, end_s: float) -> Trace:
        """The part before a time."""
        n = int(np.searchsorted(self.time_s, end_s))
        columns = (self.time_s, self.theta2_deg, self.p_a_bar, self.p_b_bar, self.u_a_v, self.u_b_v)
        return Trace(*(one[:n] for one in columns), self.ended_early)


def run(
    name: str,
    moves: Mapping[str, float] | None = None,
    *,
    solver: str = "edges",
    steps: int = 1,
) -> Trace:
    """One experiment of study.toml with some parameters moved; the sensors are not looked at."""
    study, plant = read_study(STUDY), Arm1()
    (planned,) = [one for one in plan(study, plant) if one.name == name]
    asked = experiment(study, plant, planned)
    (r,) = plant.simulate(
        [asked],
        solver=solver, changes=dict(moves or {}), threads=1, steps_per_tick=steps, states=True,
    )  # fmt: skip
    states = (deg(r.column("true_theta2_rad")), r.column("true_p_a_bar"), r.column("true_p_b_bar"))
    return Trace(r.column("t_s"), *states, r.column("u_a_v"), r.column("u_b_v"), r.info.ended_early)


def gas_laws(exponent: float) -> dict[str, dict[str, float]]:
    """The gas law as printed, with the absolute pressure, and adiabatic on top of it."""
    absolute = {"gas_absolute_share": 1.0}
    return {"gauge": {}, "absolute": absolute, "adiabatic": absolute | {"polytropic_exponent": exponent}}


def rise_bar_mm(c: Array, p_bar: float, length_m: float) -> float:
    """Rise of a shut muscle's pressure with its length: -n (p + share of p_atm) V'/V, in bar per mm."""
    _, volume, slope = muscle(c, PA * p_bar, length_m, 0.0, 1.0, c[e.TWO_L_A], 0.0)
    return float(-1e-3 * c[k.EXPONENT] * (p_bar + c[k.ABSOLUTE] / PA) * slope / volume)


def length_a_mm(theta2_deg: float) -> float:
    """Length of muscle A in mm at an angle."""
    c, angle = constants(ARM1_PARAMETERS.vector()), np.radians(theta2_deg)
    return 1e3 * float(geometry(c, np.sin(angle), np.cos(angle))[0])


def falls_at_s(trace: Trace, angle_deg: float) -> float:
    """When the arm is first beyond an angle, in s; nan if never."""
    beyond = np.flatnonzero(np.abs(trace.theta2_deg) > angle_deg)
    return float(trace.time_s[beyond[0]]) if beyond.size else float("nan")


@dataclass(frozen=True, eq=False)
class Terms:
    """What holds the joint at 0 deg with both muscles at one pressure, N m/rad, positive holds; (n,) each.

    `stiffness` is r2 k of both; `slope` r2 k' (h - h0): k grows with the length, and a muscle shorter than h0 pushes;
    `geometry` the levers' turning; `gravity`; `gauge` and `absolute` what closed valves add.
    """

    pressure_bar: Array
    stiffness: Array
    slope: Array
    geometry: Array
    gravity: Array
    gauge: Array
    absolute: Array

    @property
    def at_constant_pressure(self) -> Array:
        """Their sum without the gas."""
        return np.asarray(self.stiffness + self.slope + self.geometry + self.gravity)


def joint_terms(moves: Mapping[str, float], pressure_bar: Array) -> Terms:
    """The terms over the pressure of both muscles."""
    c = constants(ARM1_PARAMETERS.vector(moves))
    return Terms(pressure_bar, *np.array([_terms(c, float(p)) for p in pressure_bar]).T)


def _terms(c: Array, p_bar: float) -> tuple[float, ...]:
    small = 1e-5
    ahead, behind, here = geometry(c, np.sin(small), 1.0), geometry(c, np.sin(-small), 1.0), geometry(c, 0.0, 1.0)
    total = np.zeros(5)
    for i in (0, 1):
        h, lever, turning = here[i], here[2 + i], (ahead[2 + i] - behind[2 + i]) / (2.0 * small)
        total += _muscle_terms(c, p_bar, h, lever, turning)
    return total[0], total[1], total[2], -float(c[k.GRAVITY]), total[3], total[4]


def _muscle_terms(c: Array, p_bar: float, h: float, lever: float, turning: float) -> Array:
    """One muscle's: torque is F(h, p) lever, dh/dtheta is -lever."""
    coefficients = [(c[b] + p_bar * c[one]) for b, one in ((k.BK2, k.K2), (k.BK1, k.K1), (k.BK0, k.K0))]
    stiffness, slope = np.polyval(coefficients, h), np.polyval(np.polyder(coefficients), h)
    stretch = h - nominal_length(c, c[e.TWO_L_A], PA * p_bar)
    step = 1.0  # Pa
    pulls = [muscle(c, PA * p_bar + d, h, 0.0, 1.0, c[e.TWO_L_A], 0.0)[0] for d in (-step, step)]
    per_bar = PA * (pulls[1] - pulls[0]) / (2.0 * step)
    gas = [
        1e3 * per_bar * lever**2 * rise_bar_mm(constants(ARM1_PARAMETERS.vector(law)), p_bar, h)
        for law in gas_laws(1.0).values()
    ]
    return np.array([stiffness * lever**2, slope * stretch * lever**2, -stiffness * stretch * turning, gas[0], gas[1]])


def slack_bar(length_m: float) -> float:
    """Pressure in bar below which a muscle of this length is shorter than its nominal length and pushes."""
    c = constants(ARM1_PARAMETERS.vector())
    shrunk = c[e.TWO_L_A] - length_m
    return float(c[k.S2] * shrunk / (c[k.S1] - shrunk))


def zero_bar(pressure_bar: Array, total: Array) -> float:
    """Pressure in bar at which a rising curve passes zero; nan where it does not."""
    if not total.min() < 0.0 < total.max():
        return float("nan")
    return float(np.interp(0.0, total, pressure_bar))
