"""The numbers of the 2-DoF arm: the 1-DoF arm's own rows without its effects, and what the second joint adds.

The kernel's constants are those of the 1-DoF arm with every effect at rest, then the second joint's, so that flow,
muscle and geometry of A and B are the same code. Table and equation numbers are the source's (see `parameters`);
the spring's free length is settled in ARM.md, section 9.5.
"""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array, rad
from loopshape.toolbox.arm.effect.effect_parameters import EFFECT_ROWS
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, Sensors, constants, sensor_constants
from loopshape.toolbox.gap.nouns.plant import ParameterTable, rows

SECOND_JOINT_ROWS = (
    rows(
        "muscle",
        ("stiffness_factor_c", 1.0, "1", 0.1, 10.0, "neutral 1: spread of muscle C"),
        ("stiffness_factor_d", 1.0, "1", 0.1, 10.0, "neutral 1: spread of muscle D"),
    )
    + rows(
        "body",
        ("l0_mm", 375.0, "mm", 1.0, 2000.0, "table F.1"),
        ("l01x_mm", 66.7, "mm", -2000.0, 2000.0, "table F.1"),
        ("l01y_mm", 13.7, "mm", -2000.0, 2000.0, "table F.1"),
        ("l1x_mm", 520.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("l1y_mm", 40.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("lsvx_mm", 110.0, "mm", -2000.0, 2000.0, "table F.1, the valves' box"),
        ("lsvy_mm", 26.0, "mm", -2000.0, 2000.0, "table F.1, the valves' box"),
        ("l0c_mm", 20.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("l1c_mm", 35.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("l0d_mm", 20.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("l1d_mm", 105.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("l0s_mm", 170.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("l1s_mm", 185.0, "mm", -2000.0, 2000.0, "table F.1"),
        ("fitting_cd_mm", 180.0, "mm", 0.0, 2000.0, "table F.1, muscles C and D"),
        ("msv_kg", 0.80, "kg", 0.0, 100.0, "table F.1, the valves' box"),
        ("m1_kg", 2.64, "kg", 0.01, 100.0, "table F.1"),
        ("jzz1_kgm2", 0.0893, "kg m2", 0.0, 100.0, "table F.1"),
        ("spring_n_m", 1000.0, "N/m", 0.0, 1e5, "appendix F, k_S"),
        (
            "spring_length_mm",
            339.43492,
            "mm",
            1.0,
            2000.0,
            "free length that balances (0, 0) with 0.4 bar; printed 75 cannot",
        ),
    )
    + rows(
        "range",
        ("range_angle1_deg", 25.0, "deg", 1.0, 90.0, "where the model holds, theta1; range_angle_deg is theta2's"),
    )
)

_EFFECTS = frozenset(row.name for row in EFFECT_ROWS) | {"compression_exponent"}
SHARED_ROWS = tuple(row for row in ARM1_PARAMETERS.rows if row.name not in _EFFECTS)
ARM2_PARAMETERS = ParameterTable(SHARED_ROWS + SECOND_JOINT_ROWS)

FIRST = 101  # constants of the 1-DoF arm before these
(
    FACTOR_C, FACTOR_D, FITTING_CD,
    SQUARE_C, ALONG_C, ACROSS_C, SQUARE_D, ALONG_D, ACROSS_D, SQUARE_S, ALONG_S, ACROSS_S, SPRING, SPRING_LENGTH,
    WEIGHT_X, WEIGHT_Y, INERTIA_1, COUPLING_X, COUPLING_Y,
) = range(FIRST, FIRST + 19)  # fmt: skip
#: 1 where the pressure loops measure and drive both muscles of a pair (`strategies2`), else 0
SHARED = FIRST + 19


def named(vector: Array) -> dict[str, float]:
    """Values by name of a parameter vector of `ARM2_PARAMETERS`."""
    return dict(zip(ARM2_PARAMETERS.names, vector.tolist(), strict=True))


def constants2(vector: Array, shared: float = 0.0) -> Array:
    """The kernel's constants (121,), SI, from a parameter vector of `ARM2_PARAMETERS`; the last one is `shared`."""
    p = named(vector)
    mm = {name[:-3]: 1e-3 * value for name, value in p.items() if name.endswith("_mm")}
    m2, g = p["m2_kg"], p["gravity_m_s2"]
    weight_x = g * (p["msv_kg"] * mm["lsvx"] + p["m1_kg"] * mm["l01x"] + m2 * mm["l1x"])
    weight_y = g * (p["msv_kg"] * mm["lsvy"] + p["m1_kg"] * mm["l01y"] + m2 * mm["l1y"])
    inertia1 = p["msv_kg"] * (mm["lsvx"] ** 2 + mm["lsvy"] ** 2) + p["jzz1_kgm2"]
    inertia1 += p["m1_kg"] * (mm["l01x"] ** 2 + mm["l01y"] ** 2) + m2 * (mm["l1x"] ** 2 + mm["l1y"] ** 2)
    by_place = {
        FACTOR_C: p["stiffness_factor_c"],
        FACTOR_D: p["stiffness_factor_d"],
        FITTING_CD: mm["fitting_cd"],
        SPRING: p["spring_n_m"],
        SPRING_LENGTH: mm["spring_length"],
        WEIGHT_X: weight_x,
        WEIGHT_Y: weight_y,
        INERTIA_1: inertia1,
        COUPLING_X: m2 * mm["l12"] * mm["l1x"],
        COUPLING_Y: m2 * mm["l12"] * mm["l1y"],
        SHARED: shared,
    }
    for side, places, foot in (
        ("c", (SQUARE_C, ALONG_C, ACROSS_C), -mm["l0c"]),
        ("d", (SQUARE_D, ALONG_D, ACROSS_D), mm["l0d"]),
        ("s", (SQUARE_S, ALONG_S, ACROSS_S), mm["l0s"]),
    ):
        by_place |= dict(zip(places, _link(foot, mm["l0"], mm["l01x"] - mm[f"l1{side}"]), strict=True))
    more = [by_place[place] for place in range(FIRST, FIRST + len(by_place))]
    return np.concatenate([constants(ARM1_PARAMETERS.holding(p).vector()), more])


def _link(foot_m: float, height_m: float, radius_m: float) -> tuple[float, float, float]:
    """Of the vector [foot + r cos, height + r sin]: its constant square, and r times its height and its foot."""
    return foot_m**2 + height_m**2 + radius_m**2, radius_m * height_m, radius_m * foot_m


def sensor_constants2(vector: Array) -> Sensors:
    """As the 1-DoF arm's `sensor_constants`, with the limit of theta1."""
    p = named(vector)
    found = sensor_constants(ARM1_PARAMETERS.holding(p).vector())
    return found._replace(limit1_rad=float(rad(p["range_angle1_deg"])))
