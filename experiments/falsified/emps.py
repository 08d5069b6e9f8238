"""EMPS: a prismatic axis in closed loop, force to position (A. Janot, M. Gautier and M. Brunot 2019)."""

from __future__ import annotations

from collections import namedtuple

import numba
import numpy as np
from common import DATA, Case, Numbers, Piece, Real, tolerant
from scipy.io import loadmat

import loopshape as ls

GTAU = 35.15  # N/V, the drive's gain
#: seconds of both recordings: cruising speed in m/s, and which is held out
CUTS = {"slow": (0.2, 8.0, 0.125), "mixed": (8.0, 16.0, 0.125), "late": (16.0, 24.5, 0.125)}
SLIDES = 2e-3  # m/s, where the sign of the speed is decided
WINDOW_S = 0.4
NAMES = ("mass", "viscous", "viscous_bias", "coulomb", "offset")
P = namedtuple("P", NAMES)


@numba.njit(nogil=True, error_model="numpy")
def motion(t, x, u, p):  # type: ignore[no-untyped-def]
    """Speed and acceleration of the carriage under a force u[0]; drag and friction of each direction."""
    way = np.tanh(x[1] / SLIDES)
    drag = (p.viscous + p.viscous_bias * way) * x[1]
    return x[1], (u[0] - drag - p.coulomb * way + p.offset) / p.mass


def model(n: Numbers) -> ls.gap.Model:
    """The axis with these numbers; a number of 0 is one that the model does not have."""

    def own(name: str, unit: str, tolerance: float, effect: str) -> ls.gap.ModelParameter:
        return ls.gap.ModelParameter(name, n[name], unit, tolerant(n[name], tolerance), effect if n[name] else "none")

    return ls.gap.Model(
        "EMPS", motion, ("position", "speed"),
        (
            own("mass", "kg", 0.03, "parameter_error@mass"), own("viscous", "N s/m", 0.15, "viscous_error@axis"),
            own("viscous_bias", "N s/m", 0.15, "none"), own("coulomb", "N", 0.15, "coulomb_friction@axis"),
            own("offset", "N", 0.15, "force_offset@axis"),
        ),
        (ls.gap.Input("drive", "force_n", n["factor"], unit="N"),),
        (ls.gap.Output("encoder", "position", "position_m", n["scale"], unit="m"),),
        (ls.gap.Port("axis", "drive", "position", "speed", unit="N"),),
        window_s=WINDOW_S, derived=lambda v: P(*v),
    )  # fmt: skip


def pieces() -> list[Piece]:
    """Both recordings in three pieces each; the last of one and the middle of the one with pulses are held out."""
    out = []
    for name, file in (("plain", "DATA_EMPS"), ("pulses", "DATA_EMPS_PULSES")):
        table = loadmat(DATA / "emps" / f"{file}.mat")
        force, position = GTAU * np.ravel(table["vir"]).astype(float), np.ravel(table["qm"]).astype(float)
        for k, (cut, (start, end, speed)) in enumerate(CUTS.items()):
            rows = slice(round(1e3 * start), round(1e3 * end))
            regime = {"pulses": float(name == "pulses"), "speed_m_s": speed}
            columns = {"force_n": force[rows], "position_m": position[rows]}
            out.append(Piece(f"{name}_{cut}", 1e3, columns, regime, (name, k) in (("plain", 2), ("pulses", 1))))
    return out


def cases(n: Numbers) -> list[Case]:
    """Twins: without gravity a gain of the drive, of the encoder and the mass differ by the friction alone, whose
    tolerance takes up a fifth of it; a delay of the drive is one of the encoder, as there is one of each. A mass that
    is halved is no twin of a gain: friction would have to be twice as large too."""

    def scaled(name: str, change: Numbers, label: str, gain: float) -> Case:
        """All three names of one scale; `gain` is what the false model's motion lacks."""
        sizes = {"actuator_gain_error@drive": gain, "sensor_gain@encoder": gain}
        sizes["parameter_error@mass"] = n["mass"] * (1.0 / (1.0 + gain) - 1.0)
        return Case(name, change, label, sizes.pop(label), sizes)

    return [
        Case("mass_halved", {"mass": 0.5 * n["mass"]}, "parameter_error@mass", 0.5 * n["mass"]),
        Case("mass_half_more", {"mass": 1.5 * n["mass"]}, "parameter_error@mass", -0.5 * n["mass"]),
        Case("no_coulomb", {"coulomb": 0.0}, "coulomb_friction@axis", n["coulomb"]),
        Case("half_coulomb", {"coulomb": 0.5 * n["coulomb"]}, "coulomb_friction@axis", 0.5 * n["coulomb"]),
        Case("no_viscous", {"viscous": 0.0, "viscous_bias": 0.0}, "viscous_error@axis", None),
        Case("half_viscous", {"viscous": 0.5 * n["viscous"]}, "viscous_error@axis", 0.5 * n["viscous"]),
        scaled("gain_more", {"factor": 1.2}, "actuator_gain_error@drive", 1.0 / 1.2 - 1.0),
        scaled("gain_less", {"factor": 0.8}, "actuator_gain_error@drive", 0.25),
        scaled("scale_more", {"scale": 1.15}, "sensor_gain@encoder", 0.15),
        Case(
            "delay",
            {"late.force_n": n["late.force_n"] - 4.0},
            "actuator_delay@drive",
            4.0,
            {"sensor_delay@encoder": 4.0},
        ),
        Case("force_offset", {"offset": n["offset"] + 15.0}, "force_offset@axis", -15.0),
    ]


AXIS = Real(
    "emps", "emps", model, pieces,
    {"mass": 95.0, "viscous": 200.0, "viscous_bias": -35.0, "coulomb": 20.0, "offset": -1.0, "factor": 1.0,
     "scale": 1.0, "late.force_n": 0.3},
    cases, fixed=("factor", "scale"),
    box={"viscous_bias": (-150.0, 150.0), "offset": (-20.0, 20.0), "late.force_n": (-6.0, 5.0)},
)  # fmt: skip
