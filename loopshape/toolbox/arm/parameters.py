"""The arm's numbers in one table, and the constants that its kernel computes with.

Sources name tables, equations and appendices of S.N. van den Brink, Modelling and control of a robotic arm
actuated by nonlinear artificial muscles, DCT 2007.002 (2007). Effects move the rows whose source says
"neutral": at the tabled value they are the identity bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from loopshape.core.units import Array, rad
from loopshape.toolbox.arm.effect.effect_parameters import EFFECT_ROWS, effect_constants
from loopshape.toolbox.gap.nouns.plant import ParameterTable, rows

ARM1_PARAMETERS = ParameterTable(
    rows(
        "valve",
        ("pwm_frequency_hz", 50.0, "Hz", 1.0, 1000.0, "3.13, appendix C"),
        ("pwm_dead_zone", 0.01, "1", 0.0, 0.5, "figure C.6"),
    )
    + rows(
        "supply",
        ("supply_bar", 1.0, "bar", 0.1, 10.0, "section 3.3, gauge"),
        ("atmosphere_bar", 1.01325, "bar", 0.5, 1.2, "section 3.3"),
        ("throttle_factor", 0.59, "1", 0.1, 1.0, "appendix D"),
        ("throttle_in_mm", 0.40, "mm", 0.05, 5.0, "table 3.3, radius"),
        ("throttle_supply_mm", 0.52, "mm", 0.05, 5.0, "table 3.3, radius"),
        ("throttle_out_mm", 0.72, "mm", 0.05, 5.0, "table 3.3, radius"),
        ("capacity_m3", 0.01, "m3", 1e-4, 1.0, "table 3.3"),
    )
    + rows(
        "gas",
        ("gas_constant_j_kgk", 287.0, "J/(kg K)", 100.0, 1000.0, "table 3.3"),
        ("temperature_k", 293.0, "K", 200.0, 400.0, "table 3.3"),
        ("gas_absolute_share", 0.0, "1", 0.0, 1.0, "neutral 0: gauge pressure as printed in 3.20; effect gas_law"),
        ("polytropic_exponent", 1.0, "1", 1.0, 1.67, "neutral 1: isothermal; effect gas_law"),
        ("compression_exponent", 1.0, "1", 1.0, 1.67, "neutral 1: as above, in the p dV/dt term alone; effect gas_law"),
    )
    + rows(
        "muscle",
        ("braid_length_mm", 127.4, "mm", 10.0, 1000.0, "section 3.4, L"),
        ("braid_turns", 1.25, "1", 0.1, 10.0, "section 3.4, n"),
        ("end_diameter_mm", 25.0, "mm", 1.0, 200.0, "section 3.4, d1"),
        ("nominal_length_s1_m", 0.117, "m", 0.0, 1.0, "section 3.4, (3.45-3.52)"),
        ("nominal_length_s2_bar", 0.232, "bar", 0.01, 10.0, "section 3.4, (3.45-3.52)"),
        ("stiffness_b_bar", -3.97, "bar", -100.0, 100.0, "table 4.1, experiment"),
        ("stiffness_k0", -0.442, "1e5 N/(m bar)", -100.0, 100.0, "table 4.1, experiment"),
        ("stiffness_k1", 5.06, "1e5 N/(m2 bar)", -1000.0, 1000.0, "table 4.1, experiment"),
        ("stiffness_k2", -12.80, "1e5 N/(m3 bar)", -1000.0, 1000.0, "table 4.1, experiment"),
        ("stiffness_c0", 0.82, "1", -100.0, 100.0, "table 4.1, experiment"),
        ("stiffness_c1", 0.85, "1", -100.0, 100.0, "table 4.1, experiment"),
        ("damping_ns_m", 40.0, "N s/m", 0.0, 1e4, "4.12, after the arm's identification"),
        ("damping_per_bar_ns_m", 1.94, "N s/(m bar)", 0.0, 1e4, "table 4.1"),
        ("stiffness_factor_a", 1.0, "1", 0.1, 10.0, "neutral 1: spread of muscle A"),
        ("stiffness_factor_b", 1.0, "1", 0.1, 10.0, "neutral 1: spread of muscle B"),
    )
    + rows(
        "body",
        ("l11x_mm", 453.3, "mm", 0.0, 2000.0, "tables 3.4, F.1"),
        ("l11y_mm", 26.3, "mm", -2000.0, 2000.0, "tables 3.4, F.1"),
        ("lab_mm", 123.3, "mm", 0.0, 2000.0, "tables 3.4, F.1"),
        ("l1a_mm", 76.0, "mm", 0.0, 2000.0, "tables 3.4, F.1"),
        ("l1b_mm", 24.0, "mm", 0.0, 2000.0, "tables 3.4, F.1"),
        ("l12_mm", 176.0, "mm", 0.0, 2000.0, "tables 3.4, F.1"),
        ("l2a_mm", 142.0, "mm", 0.0, 2000.0, "tables 3.4, F.1"),
        ("l2b_mm", 210.0, "mm", 0.0, 2000.0, "tables 3.4, F.1"),
        ("fitting_mm", 140.0, "mm", 0.0, 2000.0, "tables 3.4, F.1, muscles A and B"),
        ("m2_kg", 0.533, "kg", 0.01, 100.0, "tables 3.4, F.1"),
        ("jzz2_kgm2", 0.00570, "kg m2", 0.0, 100.0, "tables 3.4, F.1"),
        ("gravity_m_s2", 9.81, "m/s2", 0.0, 100.0, "F.67"),
    )
    + rows(
        "sensor",
        ("angle_noise_deg", 0.02, "deg", 0.0, 10.0, "manufacturing tolerance, rms"),
        ("pressure_noise_bar", 0.001, "bar", 0.0, 1.0, "manufacturing tolerance, rms"),
        ("converter_bits", 12.0, "1", 0.0, 52.0, "manufacturing tolerance; 0 switches the converters off"),
        ("angle_span_deg", 270.0, "deg", 1.0, 3600.0, "potentiometer's span, centred"),
        ("pressure_span_bar", 2.0, "bar", 0.1, 100.0, "pressure sensor's span, from 0"),
    )
    + rows(
        "range",
        ("range_angle_deg", 45.0, "deg", 1.0, 90.0, "where the model holds; a simulation stops there"),
        ("range_low_bar", 0.15, "bar", 0.0, 10.0, "where the model holds; a simulation stops there"),
        ("range_high_bar", 1.2, "bar", 0.0, 100.0, "where the model holds; a simulation stops there"),
    )
    + EFFECT_ROWS
)

#: places of the kernel's constants, SI, in the vector that `constants` computes from the parameters
RT, BETA_IN, BETA_S, BETA_OUT, P_IN, P_ATM2, V_C = range(7)
X, YA, YB, R_A, R_B, FITTING, INERTIA, GRAVITY = range(7, 15)
FOUR_L2, N_PI, D1_SQ3, D1_X4, TWO_L, S1, S2 = range(15, 22)
BK0, BK1, BK2, K0, K1, K2, D0, D1, FACTOR_A, FACTOR_B = range(22, 32)
ABSOLUTE, EXPONENT = 32, 33


def constants(vector: Array) -> Array:
    """The kernel's constants (101,), SI, from a parameter vector of `ARM1_PARAMETERS`."""
    p = dict(zip(ARM1_PARAMETERS.names, vector.tolist(), strict=True))
    gas = 1.0 / (2.0 * p["gas_constant_j_kgk"] * p["temperature_k"])
    beta = {
        k: p["throttle_factor"] * np.sqrt(2.0) * np.pi * (1e-3 * p[f"throttle_{k}_mm"]) ** 2
        for k in ("in", "supply", "out")
    }
    # the density's 1/(2 R T) goes under the root with the pressures; beta takes its root along
    betas = [beta[k] * np.sqrt(gas) for k in ("in", "supply", "out")]
    mm = {k[:-3]: 1e-3 * v for k, v in p.items() if k.endswith("_mm")}
    inertia = p["m2_kg"] * mm["l12"] ** 2 + p["jzz2_kgm2"] + p["payload_kg"] * p["payload_radius_m"] ** 2
    gravity = p["gravity_m_s2"] * (p["m2_kg"] * mm["l12"] + p["payload_kg"] * p["payload_radius_m"])
    by_place = {
        RT: p["gas_constant_j_kgk"] * p["temperature_k"],
        BETA_IN: betas[0],
        BETA_S: betas[1],
        BETA_OUT: betas[2],
        P_IN: 1e5 * (p["supply_bar"] - p["supply_drop_bar"]),
        P_ATM2: 2e5 * p["atmosphere_bar"],
        V_C: p["capacity_m3"],
        X: mm["l11x"] - mm["lab"],
        YA: mm["l11y"] - mm["l1a"],
        YB: mm["l11y"] + mm["l1b"],
        R_A: mm["l12"] - mm["l2a"],
        R_B: mm["l12"] - mm["l2b"],
        FITTING: mm["fitting"],
        INERTIA: (1.0 - p["flexible_share"]) * inertia,
        GRAVITY: (1.0 - p["flexible_share"] * p["flexible_gravity"]) * gravity,
        ABSOLUTE: 1e5 * p["atmosphere_bar"] * p["gas_absolute_share"],
        EXPONENT: p["polytropic_exponent"],
    }
    by_place |= _muscle(p, mm) | effect_constants(p, inertia, gravity)
    return np.array([float(by_place[place]) for place in range(len(by_place))])


def _muscle(p: Mapping[str, float], mm: Mapping[str, float]) -> dict[int, float]:
    """Braid, stiffness and damping of a muscle, and both muscles' factors."""
    k0, k1, k2 = (1e5 * p[f"stiffness_k{j}"] for j in range(3))
    bar, c0, c1 = p["stiffness_b_bar"], p["stiffness_c0"], p["stiffness_c1"]
    whole, half = 1.0 + p["stiffness_error"], 0.5 * p["stiffness_mismatch"]
    return {
        FOUR_L2: 4.0 * mm["braid_length"] ** 2,
        N_PI: p["braid_turns"] * np.pi,
        D1_SQ3: 3.0 * mm["end_diameter"] ** 2,
        D1_X4: 4.0 * mm["end_diameter"],
        TWO_L: 2.0 * mm["braid_length"],
        S1: p["nominal_length_s1_m"],
        S2: p["nominal_length_s2_bar"],
        BK0: bar * c0 * k0,
        BK1: bar * c1 * k1,
        BK2: bar * k2,
        K0: k0,
        K1: k1,
        K2: k2,
        D0: p["damping_ns_m"],
        D1: p["damping_per_bar_ns_m"],
        FACTOR_A: p["stiffness_factor_a"] * (whole * (1.0 + half)),
        FACTOR_B: p["stiffness_factor_b"] * (whole * (1.0 - half)),
    }


class Sensors(NamedTuple):
    """Rms noise, converters' steps (0: off), the limits of the model's range and the converters' reach, SI.

    Angles are centred, so that they reach from -`reach_rad`; pressures from 0. `limit1_rad` is theta1's, of two joints.
    """

    noise_rad: float
    noise_pa: float
    step_rad: float
    step_pa: float
    limit_rad: float
    lowest_pa: float
    highest_pa: float
    reach_rad: float
    reach_pa: float
    limit1_rad: float = np.inf


def sensor_constants(vector: Array) -> Sensors:
    """The sensors that a parameter vector of `ARM1_PARAMETERS` describes."""
    p = dict(zip(ARM1_PARAMETERS.names, vector.tolist(), strict=True))
    on, codes = p["converter_bits"] > 0, 2.0 ** p["converter_bits"]
    span_rad, span_pa = float(rad(p["angle_span_deg"])), 1e5 * p["pressure_span_bar"]
    return Sensors(
        noise_rad=float(rad(p["angle_noise_deg"])),
        noise_pa=1e5 * p["pressure_noise_bar"],
        step_rad=span_rad / codes if on else 0.0,
        step_pa=span_pa / codes if on else 0.0,
        limit_rad=float(rad(p["range_angle_deg"])),
        lowest_pa=1e5 * p["range_low_bar"],
        highest_pa=1e5 * p["range_high_bar"],
        reach_rad=0.5 * span_rad,
        reach_pa=span_pa,
    )
