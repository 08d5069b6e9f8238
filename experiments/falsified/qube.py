"""QUBE: an inverted pendulum on a driven arm in closed loop, voltage to both angles (McGill DECAR)."""

from __future__ import annotations

from collections import namedtuple

import numba
import numpy as np
import pandas as pd
from common import DATA, Case, Numbers, Piece, Real, tolerant

import loopshape as ls

EXCITED = {"a": (2000, 4000), "b": (4000, 6000), "c": (6000, 8000)}  # rows at 500 Hz, whose targets differ
HELD_OUT = (("1", "c"), ("2", "b"))
REACH, GRAVITY = 0.085, 9.81  # m, the arm's length by the data sheet; m/s2
SLIDES = 0.05  # rad/s
WINDOW_S = 0.2
NAMES = ("arm_inertia", "damping", "coulomb", "mass", "half_length", "pivot_damping", "lean")
P = namedtuple("P", NAMES)


@numba.njit(nogil=True, error_model="numpy")
def motion(t, x, u, p):  # type: ignore[no-untyped-def]
    """Arm and pendulum (0 is upright) under torques u; states arm, pendulum, and their speeds."""
    s, c = np.sin(x[1]), np.cos(x[1])
    second = 4.0 / 3.0 * p.mass * p.half_length**2  # of a rod about its end
    across = p.mass * p.half_length * REACH * c
    arm = p.arm_inertia + p.mass * REACH**2 + second * s * s
    a = u[0] - p.damping * x[2] - p.coulomb * np.tanh(x[2] / SLIDES)
    a += p.mass * p.half_length * REACH * s * x[3] ** 2 - 2.0 * second * s * c * x[2] * x[3]
    b = u[1] + second * s * c * x[2] ** 2 - p.pivot_damping * x[3]
    b += p.mass * GRAVITY * p.half_length * np.sin(x[1] + p.lean)
    det = arm * second - across * across
    return x[2], x[3], (second * a - across * b) / det, (arm * b - across * a) / det


def model(n: Numbers) -> ls.gap.Model:
    """The pendulum drive with these numbers; a number of 0 is one that the model does not have."""

    def own(name: str, unit: str, tolerance: float, effect: str) -> ls.gap.ModelParameter:
        return ls.gap.ModelParameter(name, n[name], unit, tolerant(n[name], tolerance), effect if n[name] else "none")

    return ls.gap.Model(
        "QUBE", motion, ("arm", "pendulum", "arm_speed", "pendulum_speed"),
        (
            own("arm_inertia", "kg m2", 0.03, "parameter_error@arm_inertia"),
            own("damping", "N m s/rad", 0.15, "viscous_error@arm"), own("coulomb", "N m", 0.15, "coulomb_friction@arm"),
            own("mass", "kg", 0.03, "parameter_error@mass"), own("half_length", "m", 0.02, "length_error@pendulum"),
            own("pivot_damping", "N m s/rad", 0.3, "viscous_error@pivot"),
            ls.gap.ModelParameter("lean", n["lean"], "rad", 0.0, "base_tilt@base", (-0.1, 0.1)),
        ),
        (ls.gap.Input("drive", "u_v", n["factor"], unit="N m"), ls.gap.Input("push", None, unit="N m")),
        (
            ls.gap.Output("arm_encoder", "arm", "theta_rad", n["arm_scale"], unit="rad"),
            ls.gap.Output("pendulum_encoder", "pendulum", "alpha_rad", n["pendulum_scale"], unit="rad"),
        ),
        (
            ls.gap.Port("arm", "drive", "arm", "arm_speed", unit="N m"),
            ls.gap.Port("pivot", "push", "pendulum", "pendulum_speed", unit="N m"),
        ),
        window_s=WINDOW_S, derived=lambda v: P(*v),
    )  # fmt: skip


def pieces() -> list[Piece]:
    """The excited rows of both recordings in three pieces each, one of each held out."""
    out = []
    for name, path in zip("12", sorted((DATA / "qube").glob("*.csv")), strict=True):
        table = pd.read_csv(path, skipinitialspace=True)
        for cut, (start, end) in EXCITED.items():
            rows = table.iloc[start:end]
            columns = {
                new: rows[old].to_numpy(dtype=float)
                for new, old in (("u_v", "plant_input"), ("theta_rad", "theta"), ("alpha_rad", "alpha"))
            }
            regime = {"recording": float(name), "target_rad": float(rows["target_theta"].mean())}
            out.append(Piece(f"r{name}{cut}", 500.0, columns, regime, (name, cut) in HELD_OUT))
    return out


def cases(n: Numbers) -> list[Case]:
    """Twins: an offset of the pendulum's encoder and a lean of the base are one thing in small angles. A delay of the
    drive is one of both encoders, so no single effect; the pendulum's own motion fixes length against mass and gain."""
    m, half, j = n["mass"], n["half_length"], n["arm_inertia"]
    return [
        Case("mass_halved", {"mass": 0.5 * m}, "parameter_error@mass", 0.5 * m),
        Case("mass_half_more", {"mass": 1.5 * m}, "parameter_error@mass", -0.5 * m),
        Case("length_more", {"half_length": 1.1 * half}, "length_error@pendulum", -0.1 * half),
        Case("arm_inertia_half_more", {"arm_inertia": 1.5 * j}, "parameter_error@arm_inertia", -0.5 * j),
        Case("no_coulomb", {"coulomb": 0.0}, "coulomb_friction@arm", n["coulomb"]),
        Case("no_viscous", {"damping": 0.0}, "viscous_error@arm", n["damping"]),
        Case("half_viscous", {"damping": 0.5 * n["damping"]}, "viscous_error@arm", 0.5 * n["damping"]),
        Case("gain_more", {"factor": 1.2 * n["factor"]}, "actuator_gain_error@drive", 1.0 / 1.2 - 1.0),
        Case("gain_less", {"factor": 0.8 * n["factor"]}, "actuator_gain_error@drive", 0.25),
        Case("delay", {"late.u_v": n["late.u_v"] - 6.0}, "actuator_delay@drive", 6.0),
        Case("encoder_late", {"late.alpha_rad": 6.0}, "sensor_delay@pendulum_encoder", 6.0),
        Case("scale", {"pendulum_scale": 1.15}, "sensor_gain@pendulum_encoder", 0.15),
        Case(
            "encoder_offset",
            {"plus.alpha_rad": 0.03},
            "sensor_offset@pendulum_encoder",
            0.03,
            {"base_tilt@base": -0.03},
        ),
    ]


DRIVE = Real(
    "qube", "qube", model, pieces,
    {"arm_inertia": 1.5e-4, "damping": 3e-4, "coulomb": 1e-3, "mass": 0.024, "half_length": 0.0645,
     "pivot_damping": 0.0, "lean": 0.001, "factor": 0.005, "arm_scale": 1.0, "pendulum_scale": 1.0, "late.u_v": 1.0},
    cases, fixed=("factor", "pivot_damping", "arm_scale", "pendulum_scale"),
    box={"lean": (-0.1, 0.1), "late.u_v": (-6.0, 9.0)},
)  # fmt: skip
