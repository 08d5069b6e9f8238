"""Two-inertia motor bench of the University of Tokyo: current to motor's and load's angle, by multisines.

The package simulates at most 500 ticks a second; this bench moves up to 250 Hz and was sampled at 2.5 kHz. It is told
in slow motion: a fifth of every speed, `PACE` times longer, inertias times its square. Delays are in slow ms.
"""

from __future__ import annotations

from collections import namedtuple

import numba
import numpy as np
from common import DATA, Case, Numbers, Piece, Real, tolerant
from scipy.io import loadmat

import loopshape as ls

PACE, PERIOD, RATE_HZ = 5.0, 2500, 2500.0
SLIDES = 0.05  # rad a slow s
WINDOW_S = 0.3
PERIODS = {"A": (3, 4, 11), "B": (3, 4, 11)}  # of each multisine; the last is held out
NAMES = ("motor_inertia", "load_inertia", "stiffness", "loss", "motor_damping", "motor_coulomb", "load_damping",
         "load_coulomb", "offset", "rest")  # fmt: skip
P = namedtuple("P", NAMES)


@numba.njit(nogil=True, error_model="numpy")
def motion(t, x, u, p):  # type: ignore[no-untyped-def]
    """Motor and load on a shaft, efforts in ampere; states motor, load and their speeds."""
    through = p.stiffness * (x[0] - x[1] - p.rest) + p.loss * (x[2] - x[3])
    motor = u[0] - p.motor_damping * x[2] - p.motor_coulomb * np.tanh(x[2] / SLIDES) - through + p.offset
    load = u[1] - p.load_damping * x[3] - p.load_coulomb * np.tanh(x[3] / SLIDES) + through
    return x[2], x[3], motor / p.motor_inertia, load / p.load_inertia


def model(n: Numbers) -> ls.gap.Model:
    """The bench with these numbers; a number of 0 is one that the model does not have."""

    def own(name: str, unit: str, tolerance: float, effect: str = "") -> ls.gap.ModelParameter:
        effect = effect or f"parameter_error@{name}"
        return ls.gap.ModelParameter(name, n[name], unit, tolerant(n[name], tolerance), effect if n[name] else "none")

    return ls.gap.Model(
        "bench", motion, ("motor", "load", "motor_speed", "load_speed"),
        (
            own("motor_inertia", "A s2/rad", 0.03), own("load_inertia", "A s2/rad", 0.03),
            own("stiffness", "A/rad", 0.03), own("loss", "A s/rad", 0.15),
            own("motor_damping", "A s/rad", 0.15, "viscous_error@motor"),
            own("motor_coulomb", "A", 0.15, "coulomb_friction@motor"),
            own("load_damping", "A s/rad", 0.15, "viscous_error@load"),
            own("load_coulomb", "A", 0.15, "coulomb_friction@load"),
            own("offset", "A", 0.5, "none"), own("rest", "rad", 0.5, "none"),
        ),
        (ls.gap.Input("drive", "iq_a", n["factor"], unit="A"), ls.gap.Input("push", None, unit="A")),
        (
            ls.gap.Output("motor_encoder", "motor", "motor_rad", n["motor_scale"], unit="rad"),
            ls.gap.Output("load_encoder", "load", "load_rad", n["load_scale"], unit="rad"),
        ),
        (
            ls.gap.Port("motor", "drive", "motor", "motor_speed", unit="A"),
            ls.gap.Port("load", "push", "load", "load_speed", unit="A"),
        ),
        window_s=WINDOW_S, derived=lambda v: P(*v),
    )  # fmt: skip


def pieces() -> list[Piece]:
    """Some periods of both multisines; the load's sign is turned, both angles are about their means."""
    out = []
    for kind, periods in PERIODS.items():
        table = loadmat(DATA / "tokyo_bench" / f"MultisineType{kind}.mat")
        current, motor, load = (np.ravel(table[k]).astype(float) for k in ("iq_adx", "theta_mx", "theta_my"))
        columns = {"iq_a": current, "motor_rad": motor - motor.mean(), "load_rad": load.mean() - load}
        for k in periods:
            rows = slice(PERIOD * k, PERIOD * (k + 1))
            regime = {"odd_lines": float(kind == "B")}
            own = {name: values[rows] for name, values in columns.items()}
            out.append(Piece(f"{kind}{k}", RATE_HZ / PACE, own, regime, k == periods[-1]))
    return out


def cases(n: Numbers) -> list[Case]:
    """Twins: none of single effects; a gain of the drive would be both inertias, stiffness and losses at once, a delay
    of the drive one of both encoders. What rubs at the motor or at the load parts by the resonance between them."""
    jm, jl, k = n["motor_inertia"], n["load_inertia"], n["stiffness"]
    return [
        Case("motor_inertia_half_more", {"motor_inertia": 1.5 * jm}, "parameter_error@motor_inertia", -0.5 * jm),
        Case("motor_inertia_less", {"motor_inertia": 0.7 * jm}, "parameter_error@motor_inertia", 0.3 * jm),
        Case("load_inertia_more", {"load_inertia": 1.2 * jl}, "parameter_error@load_inertia", -0.2 * jl),
        Case("stiffness_less", {"stiffness": 0.8 * k}, "parameter_error@stiffness", 0.2 * k),
        Case("load_inertia_halved", {"load_inertia": 0.5 * jl}, "parameter_error@load_inertia", 0.5 * jl),
        Case("stiffness_more", {"stiffness": 1.2 * k}, "parameter_error@stiffness", -0.2 * k),
        Case("gain_more", {"factor": 1.2}, "actuator_gain_error@drive", 1.0 / 1.2 - 1.0),
        Case("gain_less", {"factor": 0.8}, "actuator_gain_error@drive", 0.25),
        Case("delay", {"late.iq_a": n["late.iq_a"] - 4.0}, "actuator_delay@drive", 4.0),
        Case("encoder_late", {"late.load_rad": 4.0}, "sensor_delay@load_encoder", 4.0),
        Case("scale", {"load_scale": 1.1}, "sensor_gain@load_encoder", 0.1),
    ]


BENCH = Real(
    "tokyo", "tokyo_bench", model, pieces,
    {"motor_inertia": 0.5, "load_inertia": 0.5, "stiffness": 2000.0, "loss": 0.3, "motor_damping": 0.3,
     "motor_coulomb": 0.0, "load_damping": 0.3, "load_coulomb": 0.5, "offset": -0.1, "rest": 1e-4, "factor": 1.0,
     "motor_scale": 1.0, "load_scale": 1.0, "late.iq_a": 1.0},
    cases, fixed=("motor_coulomb", "factor", "motor_scale", "load_scale"),
    box={"offset": (-2.0, 2.0), "rest": (-0.05, 0.05), "late.iq_a": (-6.0, 15.0),
         "load_coulomb": (0.0, 5.0), "motor_damping": (0.0, 20.0), "load_damping": (0.0, 20.0)},
)  # fmt: skip
