"""Double pendulum with a drive at each joint: torques to both angles (dfki-ric-underactuated-lab, design A.0)."""

from __future__ import annotations

from collections import namedtuple

import numba
import numpy as np
import pandas as pd
from common import DATA, Case, Numbers, Piece, Real, tolerant

import loopshape as ls

GRAVITY, LINK, RATE_HZ = 9.81, 0.3, 500.0  # m/s2; m, length of link 1; as stamped, resampled
SLIDES = 0.2  # rad/s
TORQUE = "tau_meas"  # by the drives' current: the commanded one leaves more
#: trajectory: seconds of a piece, and which is held out
CUTS = {"00": ((1.0, 5.5), (5.5, 10.0)), "02": ((1.0, 5.5), (5.5, 10.0)), "03": ((1.0, 5.5),), "05": ((1.0, 5.5),),
        "13": ((1.0, 5.5),)}  # fmt: skip
HELD_OUT = ("00_2", "02_2", "13_1")
NAMES = ("moment1", "inertia1", "mass2", "centre2", "inertia2", "viscous1", "coulomb1", "viscous2", "coulomb2")
P = namedtuple("P", NAMES)


@numba.njit(nogil=True, error_model="numpy")
def motion(t, x, u, p):  # type: ignore[no-untyped-def]
    """Two links (angle 1 hangs at 0, angle 2 is relative to it); states both angles and both speeds."""
    c, s, moment2 = np.cos(x[1]), np.sin(x[1]), p.mass2 * p.centre2
    m22 = p.inertia2
    m12 = p.inertia2 + LINK * moment2 * c
    m11 = p.inertia1 + p.inertia2 + p.mass2 * LINK**2 + 2.0 * LINK * moment2 * c
    bend = LINK * moment2 * s
    low = GRAVITY * moment2 * np.sin(x[0] + x[1])
    a = u[0] + bend * (2.0 * x[2] * x[3] + x[3] ** 2) - GRAVITY * (p.moment1 + p.mass2 * LINK) * np.sin(x[0]) - low
    a -= p.viscous1 * x[2] + p.coulomb1 * np.tanh(x[2] / SLIDES)
    b = u[1] - bend * x[2] ** 2 - low - p.viscous2 * x[3] - p.coulomb2 * np.tanh(x[3] / SLIDES)
    det = m11 * m22 - m12 * m12
    return x[2], x[3], (m22 * a - m12 * b) / det, (m11 * b - m12 * a) / det


def model(n: Numbers) -> ls.gap.Model:
    """The pendulum with these numbers; a number of 0 is one that the model does not have."""

    def own(name: str, unit: str, tolerance: float, effect: str = "") -> ls.gap.ModelParameter:
        effect = effect or f"parameter_error@{name}"
        return ls.gap.ModelParameter(name, n[name], unit, tolerant(n[name], tolerance), effect if n[name] else "none")

    return ls.gap.Model(
        "double pendulum", motion, ("angle1", "angle2", "speed1", "speed2"),
        (
            own("moment1", "kg m", 0.03), own("inertia1", "kg m2", 0.03), own("mass2", "kg", 0.03),
            own("centre2", "m", 0.03, "length_error@link2"), own("inertia2", "kg m2", 0.03),
            own("viscous1", "N m s/rad", 0.2, "viscous_error@joint1"),
            own("coulomb1", "N m", 0.2, "coulomb_friction@joint1"),
            own("viscous2", "N m s/rad", 0.2, "viscous_error@joint2"),
            own("coulomb2", "N m", 0.2, "coulomb_friction@joint2"),
        ),
        (
            ls.gap.Input("motor1", "torque1_nm", n["factor1"], unit="N m"),
            ls.gap.Input("motor2", "torque2_nm", n["factor2"], unit="N m"),
        ),
        (
            ls.gap.Output("encoder1", "angle1", "angle1_rad", n["scale1"], unit="rad"),
            ls.gap.Output("encoder2", "angle2", "angle2_rad", n["scale2"], unit="rad"),
        ),
        (
            ls.gap.Port("joint1", "motor1", "angle1", "speed1", unit="N m"),
            ls.gap.Port("joint2", "motor2", "angle2", "speed2", unit="N m"),
        ),
        window_s=0.3, derived=lambda v: P(*v),
    )  # fmt: skip


def pieces() -> list[Piece]:
    """Pieces of the five trajectories at a constant rate: one joint driven, or both, small and over the top."""
    out = []
    for number, cuts in CUTS.items():
        table = pd.read_parquet(DATA / "double_pendulum" / f"trajectory_{number}.parquet")
        stamps = table["time"].to_numpy(dtype=float)
        names = {
            "torque1_nm": f"{TORQUE}1",
            "torque2_nm": f"{TORQUE}2",
            "angle1_rad": "pos_meas1",
            "angle2_rad": "pos_meas2",
        }
        for k, (start, end) in enumerate(cuts):
            t = np.arange(start, end, 1.0 / RATE_HZ)
            columns = {new: np.interp(t, stamps, table[old].to_numpy(dtype=float)) for new, old in names.items()}
            regime = {f"level{j}": float(np.round(table[f"tau_con{j}"].abs().max(), 1)) for j in (1, 2)}
            name = f"{number}_{k + 1}"
            out.append(Piece(f"t{name}", RATE_HZ, columns, regime, name in HELD_OUT))
    return out


def cases(n: Numbers) -> list[Case]:
    """Twins: in the equations mass 2 appears beside moment 1 and inertia 1 (what hangs at the elbow), so a change of
    mass 2 with centre 2 held is one of its moment; no single number repeats it. A delay of one motor is none of one
    encoder, as both encoders see both motors."""

    def parts(name: str, share: float, label: str) -> Case:
        way = "more" if share > 1.0 else "less"
        return Case(f"{name}_{way}", {name: share * n[name]}, label, (1.0 - share) * n[name])

    return [
        parts("mass2", 0.5, "parameter_error@mass2"), parts("mass2", 1.5, "parameter_error@mass2"),
        parts("centre2", 1.25, "length_error@link2"), parts("inertia2", 1.6, "parameter_error@inertia2"),
        parts("moment1", 0.25, "parameter_error@moment1"), parts("inertia1", 2.0, "parameter_error@inertia1"),
        Case("no_coulomb2", {"coulomb2": 0.0}, "coulomb_friction@joint2", n["coulomb2"]),
        Case("gain2_less", {"factor2": 0.6 * n["factor2"]}, "actuator_gain_error@motor2", 1.0 / 0.6 - 1.0),
        Case("scale2_more", {"scale2": 1.12}, "sensor_gain@encoder2", 0.12),
        Case("scale2_less", {"scale2": 0.85}, "sensor_gain@encoder2", -0.15),
    ]  # fmt: skip


PENDULUM = Real(
    "double_pendulum", "double_pendulum", model, pieces,
    {"moment1": 0.168, "inertia1": 0.0535, "mass2": 0.604, "centre2": 0.184, "inertia2": 0.0239, "viscous1": 0.0,
     "coulomb1": 0.08, "viscous2": 0.01, "coulomb2": 0.08, "factor1": 1.0, "factor2": 1.0, "scale1": 1.0, "scale2": 1.0,
     "late.torque1_nm": 0.0, "late.torque2_nm": 1.0},
    cases, fixed=("late.torque1_nm", "viscous1", "factor1", "factor2", "scale1", "scale2"),
    box={"late.torque2_nm": (-6.0, 10.0), "viscous2": (0.0, 0.5),
         "coulomb1": (0.0, 1.0), "coulomb2": (0.0, 1.0)},
)  # fmt: skip
