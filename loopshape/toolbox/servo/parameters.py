"""The servo axis' numbers in one table, and the constants that its kernel computes with.

    mass x'' + viscous x' + stiffness x = force

Effects move the rows whose source says "neutral": at the tabled value they are the identity bit for bit; rows that
"shape" another act once that other has left its neutral value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from loopshape.core.units import TWO_PI, Array
from loopshape.toolbox.gap.nouns.plant import ParameterTable, rows

#: what run.toml may give under [parameters]
NOMINAL = ("mass_kg", "viscous_ns_m", "stiffness_n_m")


AXIS_PARAMETERS = ParameterTable(
    rows(
        "body",
        ("mass_kg", 100.0, "kg", 1e-6, 1e9, "all that moves, seen at the force"),
        ("viscous_ns_m", 200.0, "N s/m", 0.0, 1e12, "guide and motor"),
        ("stiffness_n_m", 0.0, "N/m", 0.0, 1e15, "spring to the ground, 0 where there is none"),
    )
    + rows(
        "guide",
        ("coulomb_n", 0.0, "N", 0.0, 1e9, "neutral 0: mean of both directions; the friction effects"),
        ("coulomb_m_s", 1e-3, "m/s", 1e-9, 1e3, "shapes coulomb_n: speed of the transition"),
        ("coulomb_asymmetry", 0.0, "1", -1.0, 1.0, "shapes both frictions: (up - down)/(up + down)"),
        ("viscous_asymmetry", 0.0, "1", -1.0, 1.0, "neutral 0: the same of the viscous friction; asymmetric_friction"),
        ("stribeck_share", 0.0, "1", 0.0, 10.0, "shapes coulomb_n: additional share at rest; stribeck_friction"),
        ("stribeck_m_s", 1e-2, "m/s", 1e-9, 1e3, "shapes stribeck_share: its speed"),
        ("stribeck_power", 2.0, "1", 0.5, 4.0, "shapes stribeck_share: exp(-|v/v_s|^power)"),
        ("presliding_n", 0.0, "N", 0.0, 1e9, "neutral 0: Dahl friction; effect coulomb_friction"),
        ("presliding_m", 1e-5, "m", 1e-12, 1e3, "shapes presliding_n: travel of yielding"),
        (
            "drag_ns2_m2",
            0.0,
            "N s2/m2",
            -1e12,
            1e12,
            "neutral 0: drag with the square of the speed; a rival, no effect",
        ),
    )
    + rows(
        "spring",
        ("cubic_n_m3", 0.0, "N/m3", 0.0, 1e18, "neutral 0; effect hardening_stiffness"),
        ("cubic_centre_m", 0.0, "m", -1e3, 1e3, "shapes cubic_n_m3: where it pulls no way"),
    )
    + rows(
        "drive",
        ("force_offset_n", 0.0, "N", -1e9, 1e9, "neutral 0: added to the force; effect force_offset"),
        ("force_limit_n", 0.0, "N", 0.0, 1e9, "neutral 0: no limit; effect force_saturation"),
        ("force_limit_soft", 0.0, "1", 0.0, 1.0, "shapes force_limit_n: 0 cuts, 1 bends as tanh"),
    )
    + rows(
        "transmission",
        ("sensor_play_m", 0.0, "m", 0.0, 1e3, "neutral 0: whole play before the sensor; effect backlash"),
        ("drive_play_m", 0.0, "m", 0.0, 1e3, "shapes flexible_share: whole play of the coupling; effect backlash"),
        ("flexible_share", 0.0, "1", 0.0, 0.9, "neutral 0: share of the mass beyond the coupling; effect flexibility"),
        ("flexible_hz", 20.0, "Hz", 1e-6, 1e6, "shapes flexible_share: free-free frequency"),
        ("flexible_damping", 0.02, "1", 0.0, 2.0, "shapes flexible_share: relative damping, free-free"),
    )
    + rows(
        "controller",
        ("loop_delay_ms", 0.0, "ms", 0.0, 1000.0, "neutral 0: the force comes late; effect loop_delay"),
        ("force_lag_ms", 0.0, "ms", 0.0, 1000.0, "neutral 0: first-order lag of the force; effect loop_delay"),
    )
    + rows(
        "sensor",
        ("position_noise_m", 1e-6, "m", 0.0, 1.0, "an encoder's, rms"),
        ("position_step_m", 0.0, "m", 0.0, 1.0, "resolution; 0 switches it off"),
        ("range_m", 1.0, "m", 1e-6, 1e3, "half the travel about 0; a simulation stops there"),
    )
)

#: places of the kernel's constants, SI
(
    MASS, VISCOUS, STIFFNESS, COULOMB, SPEED, LEVELS, SIDES, STRIBECK, STRIBECK_SPEED, STRIBECK_POWER, DAHL, DAHL_M,
    DRAG, CUBIC, CENTRE, OFFSET, LIMIT, LIMIT_SOFT, PLAY, DRIVE_PLAY, SHARE, SPRING, DAMPER, DELAY, LAG,
) = range(25)  # fmt: skip
_UNSCALED = (
    "mass_kg", "viscous_ns_m", "stiffness_n_m", "coulomb_n", "coulomb_m_s", "coulomb_asymmetry", "viscous_asymmetry",
    "stribeck_share", "stribeck_m_s", "stribeck_power", "presliding_n", "presliding_m", "drag_ns2_m2", "cubic_n_m3",
    "cubic_centre_m", "force_offset_n", "force_limit_n", "force_limit_soft", "sensor_play_m", "drive_play_m",
    "flexible_share",
)  # fmt: skip


def constants(vector: Array) -> Array:
    """The kernel's constants (25,), SI, from a parameter vector of `AXIS_PARAMETERS`."""
    p = dict(zip(AXIS_PARAMETERS.names, vector.tolist(), strict=True))
    share = p["flexible_share"]
    reduced_kg = share * (1.0 - share) * p["mass_kg"]
    turn = TWO_PI * p["flexible_hz"]
    spring = [reduced_kg * turn**2, 2.0 * p["flexible_damping"] * reduced_kg * turn]
    return np.array([*(p[n] for n in _UNSCALED), *spring, 1e-3 * p["loop_delay_ms"], 1e-3 * p["force_lag_ms"]])


def with_nominal(nominal: Mapping[str, float]) -> ParameterTable:
    """The table with other nominal values; refuses unknown names and values out of bounds."""
    AXIS_PARAMETERS.vector(nominal)
    return ParameterTable(tuple(replace(r, value=float(nominal.get(r.name, r.value))) for r in AXIS_PARAMETERS.rows))
