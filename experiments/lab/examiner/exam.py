"""A sealed arm's run: the session, done on an arm with these effects, as a rig would have recorded it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import brentq

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, rad
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run

from .arm import BAR, PERIOD_S, TICK_S, Arm
from .forms import build
from .mechanics import body_torque, geometry, joint_torque, nominal_length, stiffness
from .record import at_rest, record
from .session import ANGLE, LOOPS, PRESSURE, PWM, RATE_HZ, Plan, plans

PRESSURE_NOISE_BAR, ANGLE_NOISE_DEG = 1e-3, 0.02
LEAD_S = 10.0  # under control before the recording begins
PAUSE_S = 5.0


def make_run(
    labels: Mapping[str, float], seed: int, *, variant: int = 0, noise: bool = True, ordinary: bool = True
) -> Run:
    """The run of an arm with the effects `labels` (name -> magnitude in GAP.md's unit; {} is a healthy arm).

    The seed draws manufacturing tolerance, signals, noise and what came before each recording; `variant` picks among an
    effect's forms. Without `noise` converters stay; without `ordinary` the arm is the nominal one. Refuses an effect
    it does not have; raises where the arm leaves its range.
    """
    parts = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3)]
    arm = build(labels, parts[0], variant, ordinary)
    lost = labels.get("lost_commands", 0.0)
    recordings, session_s = [], 0.0
    for plan in plans(parts[1]):
        columns = _record(arm, plan, parts[2], session_s, lost, noise)
        recordings.append(Recording(plan.info, RATE_HZ, columns))
        session_s += LEAD_S + PAUSE_S + plan.setpoints.shape[0] / RATE_HZ
    return Run(rate_hz=RATE_HZ, loops=LOOPS, recordings=tuple(recordings), plant="arm-1dof", pwm=PWM)


def _record(
    arm: Arm, plan: Plan, rng: np.random.Generator, session_s: float, lost: float, noise: bool
) -> dict[str, Array]:
    """Columns of one recording, its lead-in cut off."""
    lead = round(LEAD_S * RATE_HZ)
    setpoints = np.concatenate([_lead_in(plan.setpoints[0], lead, rng), plan.setpoints])
    n = setpoints.shape[0]
    before = np.zeros((lead, 2))
    sizes = [float(rad(ANGLE_NOISE_DEG)), PRESSURE_NOISE_BAR, PRESSURE_NOISE_BAR]
    drawn = rng.standard_normal((n, 3)) * sizes * float(noise)
    dropped = (rng.random(round(n * TICK_S / PERIOD_S) + 1) < lost).astype(float)
    y = start(arm, *setpoints[0])
    out, left = record(
        arm, y, setpoints, np.concatenate([before, plan.injected]), np.concatenate([before, plan.forced]),
        n if plan.info.closed_loop else lead, drawn, dropped, ANGLE.biquads(), PRESSURE.biquads(), session_s,
    )  # fmt: skip
    if left < n:
        raise WrongUseError(
            f"the arm left its range in {plan.info.file}",
            f"{left / RATE_HZ - LEAD_S:.2f} s",
            "ask for a smaller effect",
        )
    return _columns(plan, out[lead:])


def _lead_in(first: Array, n: int, rng: np.random.Generator) -> Array:
    """Setpoints (n, 2) before a recording: two places near by, then where it begins."""
    lead = np.tile(first, (n, 1))
    for part in (slice(0, 3 * n // 10), slice(3 * n // 10, 6 * n // 10)):
        lead[part, 0] += rad(rng.uniform(-6.0, 6.0))
        lead[part, 1] += rng.uniform(-0.08, 0.08)
    return lead


def _columns(plan: Plan, out: Array) -> dict[str, Array]:
    """The table of a 1-DoF arm (FORMAT.md)."""
    angle, p_a, p_b, z, z_p = out.T
    columns = {
        "t_s": np.arange(out.shape[0]) / RATE_HZ,
        "r_theta2_rad": plan.setpoints[:, 0],
        "n_theta2_rad": plan.injected[:, 0],
        "z_theta2_v": z,
        "theta2_rad": angle,
        "r_p_ab_bar": plan.setpoints[:, 1],
        "n_p_ab_bar": plan.injected[:, 1],
        "z_p_v": z_p,
        "p_a_bar": p_a,
        "p_b_bar": p_b,
        "u_a_v": z + z_p,
        "u_b_v": -z + z_p,
    }
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def start(arm: Arm, theta_rad: float, p_ab_bar: float) -> Array:
    """States (53,) of an arm at rest at an angle and a sum of pressures."""

    def torque(p_a_bar: float) -> float:
        return _static_torque(arm, theta_rad, p_a_bar, p_ab_bar - p_a_bar)

    low, high = 0.02 * p_ab_bar, 0.98 * p_ab_bar
    p_a = brentq(torque, low, high) if torque(low) * torque(high) < 0.0 else 0.5 * p_ab_bar
    return at_rest(arm, theta_rad, p_a * BAR, (p_ab_bar - p_a) * BAR)


def _static_torque(arm: Arm, theta_rad: float, p_a_bar: float, p_b_bar: float) -> float:
    ha, hb, slope_a, slope_b = geometry(theta_rad)
    relaxed = arm.creep_gain * (1.0 - arm.creep_share) if arm.creep_share > 0.0 else 1.0
    pull_a = arm.stiffness_a * stiffness(p_a_bar, ha) * (ha - nominal_length(p_a_bar) - arm.offset_a_m)
    pull_b = arm.stiffness_b * stiffness(p_b_bar, hb) * (hb - nominal_length(p_b_bar))
    return float(
        -relaxed * (pull_a * slope_a + pull_b * slope_b)
        + body_torque(arm, theta_rad, 1.0, arm.payload_kg)
        + joint_torque(arm, theta_rad, 0.0)
    )
