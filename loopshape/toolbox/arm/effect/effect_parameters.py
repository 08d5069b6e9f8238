"""What effects move: parameters that the nominal arm holds at a neutral value, and the kernel's constants of them.

At the tabled value each is the identity bit for bit, except where its source says that it only shapes another:
then it acts once that other has left its neutral value.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loopshape.core.units import rad
from loopshape.toolbox.gap.nouns.plant import rows

EFFECT_ROWS = (
    rows(
        "controller",
        ("loop_delay_ms", 0.0, "ms", 0.0, 100.0, "neutral 0: age of the command that a PWM period takes; loop_delay"),
    )
    + rows(
        "valve",
        ("pulse_delay_ms", 0.0, "ms", 0.0, 15.0, "neutral 0: whole pulses come late; loop_delay, hose_lag"),
        ("valve_opening_delay_ms", 0.0, "ms", 0.0, 15.0, "neutral 0; effect valve_delay"),
        ("valve_closing_ratio", 1.5, "1", 0.0, 4.0, "shapes valve_opening_delay_ms: closing delay over it"),
        ("valve_short_lost", 0.0, "1", 0.0, 3.0, "shapes valve_opening_delay_ms: pulses shorter than so many are lost"),
        ("valve_travel_share", 0.0, "1", 0.0, 1.9, "shapes valve_opening_delay_ms: armature's travel over it"),
        ("valve_current", 0.0, "1", 0.0, 20.0, "shapes valve_opening_delay_ms: a solenoid's current, 1 opens at half"),
        ("valve_ramp_ms", 0.0, "ms", 0.0, 15.0, "neutral 0: time from shut to open, about the delayed edge"),
    )
    + rows(
        "supply",
        ("supply_drop_bar", 0.0, "bar", 0.0, 0.9, "neutral 0: the supply stands lower; effect supply_droop"),
        ("supply_droop_bar", 0.0, "bar", 0.0, 0.9, "neutral 0: drop at one open in-valve; effect supply_droop"),
        ("splitter_droop_bar", 0.0, "bar", 0.0, 0.9, "neutral 0: drop behind the capacity at one open in-valve"),
        ("supply_droop_time_s", 0.05, "s", 0.001, 10.0, "shapes both droops: time constant"),
        ("critical_ratio", 0.0, "1", 0.0, 0.95, "neutral 0: (3.16); else ISO 6358-1's ellipse; effect choked_flow"),
        ("choked_conductance", 1.0, "1", 0.3, 3.0, "shapes critical_ratio: over the one equal at small drops"),
    )
    + rows(
        "line",
        ("hose_length_m", 0.0, "m", 0.0, 30.0, "neutral 0: volume and laminar restriction of a 2.5 mm bore; hose_lag"),
        ("hose_turbulence", 0.0, "1", 0.0, 10.0, "shapes hose_length_m: loss over the laminar one at 0.1 g/s"),
        ("hose_front", 0.0, "1", 0.0, 1.0, "shapes hose_length_m: share of the line's impedance c/A, for short pulses"),
        ("hose_lag_ms", 0.0, "ms", 0.0, 200.0, "neutral 0: first-order lag of the flow; effect hose_lag"),
        ("leak_a_mm", 0.0, "mm", 0.0, 3.0, "neutral 0: orifice's diameter at A; effect leak"),
        ("leak_b_mm", 0.0, "mm", 0.0, 3.0, "neutral 0: orifice's diameter at B; effect leak"),
        ("leak_laminar", 0.0, "1", 0.0, 1.0, "shapes the leaks: 1 is laminar, equal to the orifice at 0.5 bar"),
        ("dead_volume_a_ml", 0.0, "ml", 0.0, 1000.0, "neutral 0; effect dead_volume"),
        ("dead_volume_b_ml", 0.0, "ml", 0.0, 1000.0, "neutral 0; effect dead_volume"),
    )
    + rows(
        "muscle",
        ("stiffness_error", 0.0, "1", -0.9, 5.0, "neutral 0: share by which both are stiffer; effect stiffness_error"),
        ("stiffness_mismatch", 0.0, "1", -1.5, 1.5, "neutral 0: (k_A - k_B)/k; effect muscle_mismatch"),
        ("nominal_length_a_mm", 0.0, "mm", -30.0, 30.0, "neutral 0: A's h0 is longer; effect nominal_length_offset"),
        ("nominal_length_b_mm", 0.0, "mm", -30.0, 30.0, "neutral 0: B's h0 is longer; effect nominal_length_offset"),
        ("creep_share", 0.0, "1", 0.0, 0.9, "neutral 0: relaxing share of the stiffness; effect muscle_creep"),
        ("creep_time_s", 1.0, "s", 0.01, 1000.0, "shapes creep_share: time constant of its middle branch"),
        ("creep_decades", 0.0, "1", 0.0, 2.0, "shapes creep_share: between three branches, 0 is one"),
        ("creep_slow_nominal", 0.0, "1", 0.0, 1.0, "shapes creep_share: 1 where the nominal one is relaxed"),
        ("creep_of_length", 0.0, "1", 0.0, 1.0, "shapes creep_share: 1 relaxes to the length, nominal when relaxed"),
        ("braid_force_n", 0.0, "N", 0.0, 200.0, "neutral 0: of one muscle at 0.5 bar; effect braid_hysteresis"),
        ("braid_slip_mm", 0.5, "mm", 0.02, 20.0, "shapes braid_force_n: length of yielding"),
        ("braid_unloading", 1.0, "1", 0.0, 1.0, "shapes braid_force_n: 0 straight (Bouc-Wen), 1 Dahl's"),
        ("braid_elements", 0.0, "1", 0.0, 1.0, "shapes braid_force_n: 0 Bouc-Wen, 1 slip elements"),
        ("braid_pressure_share", 1.0, "1", 0.0, 1.0, "shapes braid_force_n: share that goes with pressure"),
    )
    + rows(
        "joint",
        ("coulomb_nm", 0.0, "N m", 0.0, 5.0, "neutral 0: tanh Coulomb friction; effect joint_friction"),
        ("coulomb_rad_s", 0.05, "rad/s", 0.01, 10.0, "shapes coulomb_nm: velocity of the transition"),
        ("stribeck_share", 0.0, "1", 0.0, 3.0, "shapes coulomb_nm: additional share at rest"),
        ("stribeck_rad_s", 0.2, "rad/s", 0.02, 10.0, "shapes coulomb_nm: Stribeck's velocity"),
        ("presliding_nm", 0.0, "N m", 0.0, 5.0, "neutral 0: Dahl (LuGre) friction; effect joint_friction"),
        ("presliding_deg", 0.2, "deg", 0.005, 20.0, "shapes presliding_nm: angle of yielding"),
        ("presliding_damping_s", 0.0, "s", 0.0, 0.2, "shapes presliding_nm: LuGre's sigma_1 over sigma_0"),
        ("presliding_elements", 0.0, "1", 0.0, 1.0, "shapes presliding_nm: 0 Dahl, 1 slip elements"),
        ("friction_load_share", 0.0, "1", 0.0, 1.0, "shapes both frictions: share that goes with the muscles' pull"),
        ("hose_stiffness_nm_rad", 0.0, "N m/rad", 0.0, 50.0, "neutral 0; effect hose_stiffness"),
        ("hose_angle_deg", 0.0, "deg", -90.0, 90.0, "shapes hose_stiffness_nm_rad: where it pulls no way"),
        ("hose_cubic_nm_rad3", 0.0, "N m/rad3", 0.0, 200.0, "neutral 0: its hardening; effect hose_stiffness"),
    )
    + rows(
        "body",
        ("payload_kg", 0.0, "kg", 0.0, 2.0, "neutral 0: point mass; effect payload"),
        ("payload_radius_m", 0.34, "m", 0.0, 1.0, "shapes payload_kg: distance from joint 2"),
        ("flexible_share", 0.0, "1", 0.0, 0.9, "neutral 0: share of the inertia beyond; effect coupling_flexibility"),
        ("flexible_hz", 15.0, "Hz", 2.0, 60.0, "shapes flexible_share: free-free frequency"),
        ("flexible_damping", 0.02, "1", 0.0, 0.5, "shapes flexible_share: relative damping, free-free"),
        ("flexible_gravity", 1.0, "1", 0.0, 1.0, "shapes flexible_share: of its part of gravity beyond"),
        ("base_tilt_deg", 0.0, "deg", -45.0, 45.0, "neutral 0: gravity acts as at theta2 + tilt; effect base_tilt"),
    )
    + rows(
        "sensor",
        ("angle_lag_ms", 0.0, "ms", 0.0, 300.0, "neutral 0: low-frequency delay; effect angle_sensor_lag"),
        ("pressure_lag_ms", 0.0, "ms", 0.0, 300.0, "neutral 0: low-frequency delay; effect pressure_sensor_lag"),
        ("lag_order", 1.0, "1", 1.0, 2.0, "shapes the lags: number of poles, 1 or 2"),
        ("lag_damping", 1.0, "1", 0.3, 1.5, "shapes the lags of two poles: 1 is two equal ones"),
        ("backlash_deg", 0.0, "deg", 0.0, 20.0, "neutral 0: whole play; effect backlash"),
        ("backlash_soft", 0.0, "1", 0.0, 1.0, "shapes backlash_deg: 0 play, 1 yields gradually"),
    )
)

(
    DEAD_A, DEAD_B, TWO_L_A, TWO_L_B, COMPRESSION, CRITICAL, CONDUCTANCE, LEAK_A, LEAK_B, LAMINAR,
    CREEP_GAIN, COULOMB, COULOMB_SPEED, STRIBECK, STRIBECK_SPEED, HOSE_K, HOSE_ANGLE, HOSE_CUBIC,
    TILT_SINE, TILT_COSINE, FLEX_K, FLEX_D, FLEX_INERTIA, FLEX_GRAVITY, LINE, MEMORY, CREEP, CREEP_1, CREEP_2, CREEP_3,
    BRAID, BRAID_SLIP, BRAID_ELEMENTS, BRAID_SHARE, DAHL, DAHL_ANGLE, LOAD_SHARE, LINE_R, LINE_V, LINE_LAG,
    DROP, DROP_TIME, LOOP_DELAY, OPENING, CLOSING, RAMP, ANGLE_LAG, PRESSURE_LAG, LAG_ORDER, PLAY, PLAY_SOFT,
    TORQUES, LATE, DAHL_ELEMENTS, LINE_TURBULENT, SPLIT, LINE_Z, SHORTEST, LAG_DAMPING, CURRENT, ALONE,
    TRAVEL, TRAVEL_BACK, DAHL_DAMPING, BRAID_STEEPER,
    WHOLE_LATE, CREEP_LENGTH,
) = range(34, 101)  # fmt: skip

_BORE_M = 2.5e-3
_SOUND_M_S = 343.0


def effect_constants(p: Mapping[str, float], inertia_kgm2: float, gravity_nm: float) -> dict[int, float]:
    """The kernel's constants of effects by place, SI, from parameters by name; places as named above.

    `inertia_kgm2` and `gravity_nm` are those of the whole body, the payload included.
    """
    by_place = _valve(p) | _supply(p) | _line(p) | _leaks(p) | _length(p) | _creep(p) | _braid(p) | _joint(p)
    return by_place | _body(p, inertia_kgm2, gravity_nm) | _sensor(p) | _switches(p)


def _valve(p: Mapping[str, float]) -> dict[int, float]:
    """Ages of the pulses' edges, and what a solenoid and its armature make of them."""
    delay_ms, ramp_ms, late_ms = p["valve_opening_delay_ms"], p["valve_ramp_ms"], p["pulse_delay_ms"]
    travel_ms = delay_ms * p["valve_travel_share"]
    opening_ms = delay_ms - 0.5 * travel_ms  # an armature sets out; half open after the delay
    closing_ms = opening_ms * p["valve_closing_ratio"]
    return {
        LOOP_DELAY: 1e-3 * p["loop_delay_ms"],
        OPENING: 1e-3 * max(opening_ms + late_ms, 0.5 * ramp_ms),
        CLOSING: 1e-3 * max(closing_ms + late_ms, 0.5 * ramp_ms),
        RAMP: 1e-3 * ramp_ms,
        LATE: late_ms + delay_ms + ramp_ms > 0.0,
        SHORTEST: 1e-3 * delay_ms * p["valve_short_lost"],
        CURRENT: 1e-3 * delay_ms * p["valve_current"] / np.log(2.0),
        ALONE: 1e-3 * delay_ms,
        TRAVEL: 1e-3 * travel_ms,
        TRAVEL_BACK: 1e-3 * travel_ms * p["valve_closing_ratio"],
        WHOLE_LATE: 1e-3 * late_ms,
    }


def _supply(p: Mapping[str, float]) -> dict[int, float]:
    """What stands before the valves, and how their flow depends on the ratio of pressures."""
    return {
        COMPRESSION: p["compression_exponent"],
        CRITICAL: p["critical_ratio"],
        CONDUCTANCE: p["choked_conductance"] * np.sqrt(1.0 - p["critical_ratio"]),
        DROP: 1e5 * p["supply_droop_bar"],
        DROP_TIME: p["supply_droop_time_s"],
        SPLIT: 1e5 * p["splitter_droop_bar"],
    }


def _gas(p: Mapping[str, float]) -> float:
    """R T in J/kg."""
    return p["gas_constant_j_kgk"] * p["temperature_k"]


def _line(p: Mapping[str, float]) -> dict[int, float]:
    """A hose between valves and muscle, and the dead volumes that it adds to."""
    length_m = p["hose_length_m"]
    volume_m3 = length_m * np.pi / 4.0 * _BORE_M**2
    front = p["hose_front"] if length_m > 0.0 else 0.0
    air_pa_s = 1.81e-5  # viscosity of air at 20 degrees C
    return {
        DEAD_A: 1e-6 * p["dead_volume_a_ml"] + volume_m3,
        DEAD_B: 1e-6 * p["dead_volume_b_ml"] + volume_m3,
        LINE: _has_line(p),
        LINE_R: 128.0 * air_pa_s * length_m / (np.pi * _BORE_M**4) * _gas(p),  # over the density: times p
        LINE_V: volume_m3 / _gas(p),
        LINE_LAG: 1e-3 * p["hose_lag_ms"] + front * length_m / _SOUND_M_S,
        LINE_TURBULENT: p["hose_turbulence"],
        LINE_Z: front * _SOUND_M_S / (np.pi / 4.0 * _BORE_M**2),
    }


def _leaks(p: Mapping[str, float]) -> dict[int, float]:
    """Conductances of the leaks at both muscles."""
    orifice = p["throttle_factor"] * np.sqrt(2.0) * np.pi * np.sqrt(0.5 / _gas(p)) * (0.5e-3) ** 2
    return {LEAK_A: orifice * p["leak_a_mm"] ** 2, LEAK_B: orifice * p["leak_b_mm"] ** 2, LAMINAR: p["leak_laminar"]}


def _length(p: Mapping[str, float]) -> dict[int, float]:
    """Nominal lengths of both muscles, twice."""
    two_l = 2e-3 * p["braid_length_mm"]
    return {
        TWO_L_A: two_l + 1e-3 * p["nominal_length_a_mm"],
        TWO_L_B: two_l + 1e-3 * p["nominal_length_b_mm"],
    }


def _creep(p: Mapping[str, float]) -> dict[int, float]:
    """One relaxing branch, or three that are so many decades apart."""
    share, time_s, step = p["creep_share"], p["creep_time_s"], 10.0 ** p["creep_decades"]
    one = p["creep_decades"] == 0.0
    return {
        CREEP_GAIN: 1.0 + share * p["creep_slow_nominal"] * (1.0 - p["creep_of_length"]),
        CREEP: share,
        CREEP_1: time_s,
        CREEP_2: 0.0 if one else time_s / step,
        CREEP_3: 0.0 if one else time_s * step,
        CREEP_LENGTH: share * p["creep_of_length"],
    }


def _braid(p: Mapping[str, float]) -> dict[int, float]:
    """Friction within the muscles' braids."""
    return {
        BRAID: p["braid_force_n"],
        BRAID_SLIP: 1e-3 * p["braid_slip_mm"],
        BRAID_ELEMENTS: p["braid_elements"],
        BRAID_SHARE: p["braid_pressure_share"],
        BRAID_STEEPER: p["braid_unloading"],
    }


def _joint(p: Mapping[str, float]) -> dict[int, float]:
    """Frictions of the joint, and the hoses that bend with it."""
    return {
        COULOMB: p["coulomb_nm"],
        COULOMB_SPEED: p["coulomb_rad_s"],
        STRIBECK: p["stribeck_share"],
        STRIBECK_SPEED: p["stribeck_rad_s"],
        HOSE_K: p["hose_stiffness_nm_rad"],
        HOSE_ANGLE: float(rad(p["hose_angle_deg"])),
        HOSE_CUBIC: p["hose_cubic_nm_rad3"],
        DAHL: p["presliding_nm"],
        DAHL_ANGLE: float(rad(p["presliding_deg"])),
        DAHL_ELEMENTS: p["presliding_elements"],
        DAHL_DAMPING: p["presliding_damping_s"],
        LOAD_SHARE: p["friction_load_share"],
    }


def _body(p: Mapping[str, float], inertia_kgm2: float, gravity_nm: float) -> dict[int, float]:
    """The part of the body beyond a flexible coupling, and which way gravity acts."""
    share = p["flexible_share"]
    reduced = share * (1.0 - share) * inertia_kgm2
    turn = 2.0 * np.pi * p["flexible_hz"]
    return {
        TILT_SINE: float(np.sin(rad(p["base_tilt_deg"]))),
        TILT_COSINE: float(np.cos(rad(p["base_tilt_deg"]))),
        FLEX_K: reduced * turn**2,
        FLEX_D: 2.0 * p["flexible_damping"] * reduced * turn,
        FLEX_INERTIA: share * inertia_kgm2,
        FLEX_GRAVITY: share * p["flexible_gravity"] * gravity_nm,
    }


def _sensor(p: Mapping[str, float]) -> dict[int, float]:
    """Lags and play of what is measured."""
    return {
        ANGLE_LAG: 1e-3 * p["angle_lag_ms"],
        PRESSURE_LAG: 1e-3 * p["pressure_lag_ms"],
        LAG_ORDER: p["lag_order"],
        LAG_DAMPING: p["lag_damping"],
        PLAY: float(rad(p["backlash_deg"])),
        PLAY_SOFT: p["backlash_soft"],
    }


def _switches(p: Mapping[str, float]) -> dict[int, float]:
    """1 where further states, or torques at the joint, have to be computed."""
    states = ("creep_share", "braid_force_n", "presliding_nm", "supply_droop_bar", "splitter_droop_bar")
    loaded = p["friction_load_share"] > 0.0 and p["coulomb_nm"] > 0.0
    torques = ("braid_force_n", "presliding_nm", "coulomb_nm", "hose_stiffness_nm_rad", "hose_cubic_nm_rad3")
    return {
        MEMORY: _has_line(p) or loaded or any(p[name] > 0.0 for name in states),
        TORQUES: any(p[name] > 0.0 for name in (*torques, "flexible_share")),
    }


def _has_line(p: Mapping[str, float]) -> bool:
    return p["hose_length_m"] > 0.0 or p["hose_lag_ms"] > 0.0
