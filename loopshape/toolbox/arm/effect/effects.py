"""The 1-DoF arm's catalogue of effects: every form, its bounds, where it must be invisible, and its source.

Magnitudes are those of the exchange format: unit and meaning do not depend on the form. Bounds are wider than
what usually occurs (`usual`), which only serves as a prior.
"""

from __future__ import annotations

from collections.abc import Mapping

from loopshape.toolbox.gap.nouns.effect import EffectForm, Free, Spread

SPREAD = (
    Spread("throttle_in", ("throttle_in_mm",), 0.02),
    Spread("throttle_supply", ("throttle_supply_mm",), 0.02),
    Spread("throttle_out", ("throttle_out_mm",), 0.02),
    Spread("stiffness_a", ("stiffness_factor_a",), 0.03),
    Spread("stiffness_b", ("stiffness_factor_b",), 0.03),
    Spread("damping", ("damping_ns_m", "damping_per_bar_ns_m"), 0.20),
    Spread("mass", ("m2_kg", "jzz2_kgm2"), 0.01),
)

_BLOCKS = {
    "controller": ("loop_delay",),
    "valve": ("valve_delay",),
    "supply": ("supply_droop", "choked_flow"),
    "line": ("hose_lag", "leak", "dead_volume"),
    "gas": ("gas_law",),
    "muscle": ("braid_hysteresis", "muscle_creep", "muscle_mismatch", "nominal_length_offset", "stiffness_error"),
    "joint": ("joint_friction", "hose_stiffness"),
    "body": ("payload", "coupling_flexibility", "base_tilt"),
    "sensor": ("angle_sensor_lag", "pressure_sensor_lag", "backlash"),
}
BLOCKS: Mapping[str, str] = {effect: block for block, effects in _BLOCKS.items() for effect in effects}


def _free(parameter: str, low: float, high: float, *starts: float) -> Free:
    return Free(parameter, low, high, starts)


def _form(
    effect: str,
    form: str,
    unit: str,
    *free: Free,
    usual: tuple[float, float],
    scale: float = 1.0,
    others: Mapping[str, float | tuple[str, float]] | None = None,
    source: str = "",
) -> EffectForm:
    """A form; of the `others` a number is a fixed parameter, a pair one tied to a free parameter by a factor."""
    fixed = {name: x for name, x in (others or {}).items() if not isinstance(x, tuple)}
    tied = {name: x for name, x in (others or {}).items() if isinstance(x, tuple)}
    return EffectForm(effect, form, BLOCKS[effect], unit, free, fixed, tied, scale, usual, source)


_FRICTION = _free("coulomb_nm", 0.0, 1.0, 0.06, 0.18)
_SPEED = _free("coulomb_rad_s", 0.01, 0.15, 0.03)
_DAHL = _free("presliding_nm", 0.0, 1.0, 0.06, 0.18)
_BRAID = _free("braid_force_n", 0.0, 40.0, 2.5, 6.0)
_SLIP = _free("braid_slip_mm", 0.02, 5.0, 0.3)
_YIELD = _free("presliding_deg", 0.01, 4.0, 0.2)
_BRISTLE = _free("presliding_damping_s", 0.0, 0.05, 0.004)
_SHARE = _free("braid_pressure_share", 0.6, 1.0, 0.9)
_CREEP = _free("creep_share", 0.0, 0.7, 0.2)
_LOAD = _free("friction_load_share", 0.0, 0.6, 0.3)
_OPENING = _free("valve_opening_delay_ms", 0.0, 9.0, 2.5, 5.0)
_TURBULENCE = _free("hose_turbulence", 0.0, 10.0, 0.3)
_DAMPING = _free("lag_damping", 0.5, 1.2, 0.9)
_EXPONENT = _free("polytropic_exponent", 1.0, 1.6, 1.2)

FORMS: tuple[EffectForm, ...] = (
    _form("loop_delay", "age of the command that a period takes", "ms", _free("loop_delay_ms", 0.0, 40.0, 3.0, 8.0),
          usual=(2.0, 10.0), source="sampled-data control"),
    _form("loop_delay", "pulses late as a whole", "ms", _free("pulse_delay_ms", 0.0, 15.0, 3.0, 8.0),
          usual=(2.0, 10.0), source="transport delay behind the PWM"),
    _form("valve_delay", "dead times, closing 1.5 times the opening", "ms", _OPENING, usual=(2.0, 6.0),
          source="on/off solenoid valves"),
    _form("valve_delay", "two dead times", "ms", _OPENING, _free("valve_closing_ratio", 1.2, 2.2, 1.6),
          usual=(2.0, 6.0), source="on/off solenoid valves"),
    _form("valve_delay", "dead times and ramps", "ms", _OPENING, _free("valve_ramp_ms", 0.0, 8.0, 2.0),
          usual=(2.0, 6.0), source="on/off solenoid valves, armature's travel"),
    _form("valve_delay", "dead time and travel of an armature", "ms", _OPENING,
          _free("valve_travel_share", 0.1, 1.8, 0.5), _free("valve_closing_ratio", 0.8, 2.2, 1.5), usual=(2.0, 6.0),
          source="on/off solenoid valves, short pulses open in part"),
    _form("valve_delay", "solenoid's current, short pulses lost", "ms", _OPENING,
          _free("valve_closing_ratio", 0.6, 2.2, 1.4), _free("valve_current", 0.2, 1.6, 0.8), usual=(2.0, 6.0),
          source="current of first order, opening at half of it"),
    _form("valve_delay", "dead times, shorter pulses lost", "ms", _OPENING, _free("valve_closing_ratio", 0.6, 2.2, 1.4),
          others={"valve_short_lost": 1.0}, usual=(2.0, 6.0), source="solenoid's current has to build up"),
    _form("supply_droop", "supply stands lower", "bar", _free("supply_drop_bar", 0.0, 0.4, 0.05, 0.13),
          usual=(0.05, 0.16), source="regulator set or loaded by others"),
    _form("supply_droop", "regulator droops with flow", "bar", _free("supply_droop_bar", 0.0, 0.8, 0.08, 0.25),
          _free("supply_droop_time_s", 0.005, 5.0, 0.05), usual=(0.05, 0.16), source="regulator's flow characteristic"),
    _form("supply_droop", "line behind the capacity", "bar", _free("splitter_droop_bar", 0.0, 0.8, 0.06, 0.14),
          _free("supply_droop_time_s", 0.003, 2.0, 0.01), usual=(0.05, 0.16), source="line and manifold"),
    _form("choked_flow", "ellipse, equal at small drops", "1", _free("critical_ratio", 0.05, 0.9, 0.4, 0.55),
          usual=(0.35, 0.6), source="ISO 6358-1"),
    _form("choked_flow", "ellipse with a conductance of its own", "1", _free("critical_ratio", 0.05, 0.9, 0.4, 0.55),
          _free("choked_conductance", 0.5, 2.0, 1.0), usual=(0.35, 0.6), source="ISO 6358-1"),
    _form("hose_lag", "volume and restriction", "m", _free("hose_length_m", 0.0, 15.0, 1.5, 4.0), _TURBULENCE,
          usual=(1.0, 5.0), source="Hagen-Poiseuille and inlet loss, lumped"),
    _form("hose_lag", "first-order lag of the flow", "m", _free("hose_lag_ms", 0.0, 100.0, 4.0, 15.0),
          scale=0.2, usual=(1.0, 5.0), source="lumped line"),
    _form("hose_lag", "transport, volume and restriction", "m", _free("hose_length_m", 0.0, 5.1, 1.5, 4.0), _TURBULENCE,
          others={"pulse_delay_ms": ("hose_length_m", 2.9)}, usual=(1.0, 5.0),
          source="speed of sound, Hagen-Poiseuille"),
    _form("hose_lag", "travelling front and restriction", "m", _free("hose_length_m", 0.0, 15.0, 1.5, 4.0),
          others={"hose_front": 1.0}, usual=(1.0, 5.0), source="water hammer, Hagen-Poiseuille"),
    _form("leak", "orifice at A", "mm", _free("leak_a_mm", 0.0, 1.5, 0.15, 0.3), usual=(0.1, 0.3), source="(3.16)"),
    _form("leak", "orifices at both", "mm", _free("leak_a_mm", 0.0, 1.5, 0.15, 0.3), _free("leak_b_mm", 0.0, 1.5, 0.1),
          usual=(0.1, 0.3), source="(3.16)"),
    _form("leak", "laminar at both", "mm", _free("leak_a_mm", 0.0, 1.5, 0.15, 0.3), _free("leak_b_mm", 0.0, 1.5, 0.1),
          others={"leak_laminar": 1.0}, usual=(0.1, 0.3), source="Hagen-Poiseuille"),
    _form("dead_volume", "B has four fifths of A", "ml", _free("dead_volume_a_ml", 0.0, 400.0, 30.0, 60.0),
          others={"dead_volume_b_ml": ("dead_volume_a_ml", 0.8)}, usual=(20.0, 70.0), source="fittings and hoses"),
    _form("dead_volume", "two volumes", "ml", _free("dead_volume_a_ml", 0.0, 400.0, 30.0, 60.0),
          _free("dead_volume_b_ml", 0.0, 400.0, 30.0), usual=(20.0, 70.0), source="fittings and hoses"),
    _form("gas_law", "share of the atmosphere", "1", _free("gas_absolute_share", 0.0, 1.0, 0.5, 0.9),
          usual=(0.6, 1.0), source="Boyle and Gay-Lussac, absolute pressure"),
    _form("gas_law", "absolute, polytropic", "1", _EXPONENT, others={"gas_absolute_share": 1.0}, usual=(1.0, 1.4),
          source="polytropic change of state"),
    _form("gas_law", "absolute, polytropic when stretched", "1",
          _free("compression_exponent", 1.0, 1.6, 1.2), others={"gas_absolute_share": 1.0}, usual=(1.0, 1.4),
          source="polytropic change of state, isothermal filling"),
    _form("braid_hysteresis", "Bouc-Wen", "N", _BRAID, _SLIP, _SHARE, _free("braid_unloading", 0.0, 1.0, 0.3),
          usual=(1.5, 8.0), source="Bouc 1967, Wen 1976"),
    _form("braid_hysteresis", "slip elements", "N", _BRAID, _SLIP, _SHARE,
          others={"braid_elements": 1.0}, usual=(1.5, 8.0), source="Iwan 1966"),
    _form("muscle_creep", "one branch", "1", _CREEP, _free("creep_time_s", 0.03, 60.0, 1.0, 0.3),
          usual=(0.1, 0.35), source="standard linear solid, nominal when fast"),
    _form("muscle_creep", "three branches a decade apart", "1", _CREEP, _free("creep_time_s", 0.1, 20.0, 1.0),
          others={"creep_decades": 1.0}, usual=(0.1, 0.35), source="generalised Maxwell, nominal when fast"),
    _form("muscle_creep", "three branches, nominal when relaxed", "1", _CREEP, _free("creep_time_s", 0.1, 20.0, 1.0),
          others={"creep_decades": 0.7, "creep_slow_nominal": 1.0}, usual=(0.1, 0.35), source="generalised Maxwell"),
    _form("muscle_creep", "of the length, a stiffer braid", "1", _CREEP, _free("creep_time_s", 0.1, 20.0, 1.0),
          _free("stiffness_error", 0.0, 0.4, 0.08), others={"creep_decades": 0.85, "creep_of_length": 1.0},
          usual=(0.1, 0.35), source="generalised Maxwell beside a spring"),
    _form("muscle_mismatch", "A stiffer, B softer", "1", _free("stiffness_mismatch", -0.8, 0.8, -0.18, 0.18),
          usual=(0.12, 0.25), source="spread of five muscles, appendix G"),
    _form("nominal_length_offset", "A longer", "mm", _free("nominal_length_a_mm", -15.0, 15.0, -5.0, 5.0),
          usual=(2.0, 8.0), source="spread of five muscles, appendix G"),
    _form("stiffness_error", "both stiffer", "1", _free("stiffness_error", -0.6, 1.0, -0.17, 0.17),
          usual=(0.1, 0.25), source="table 4.1's digits"),
    _form("joint_friction", "LuGre under load", "N m", _DAHL, _YIELD, _LOAD, _BRISTLE, usual=(0.04, 0.25),
          source="Canudas de Wit 1995, bearing under load"),
    _form("joint_friction", "slip elements under load", "N m", _DAHL, _YIELD, _LOAD,
          others={"presliding_elements": 1.0}, usual=(0.04, 0.25), source="Iwan 1966, bearing under load"),
    _form("joint_friction", "LuGre with Stribeck", "N m", _DAHL, _YIELD, _BRISTLE,
          _free("stribeck_share", 0.0, 1.0, 0.1), usual=(0.04, 0.25), source="Canudas de Wit 1995, Stribeck 1902"),
    _form("joint_friction", "tanh Coulomb with Stribeck", "N m", _FRICTION, _SPEED,
          _free("stribeck_share", 0.0, 2.0, 0.3), usual=(0.04, 0.25), source="Stribeck 1902"),
    _form("hose_stiffness", "spring about an angle", "N m/rad", _free("hose_stiffness_nm_rad", 0.0, 15.0, 1.0, 3.0),
          _free("hose_angle_deg", -60.0, 60.0, 8.0, -8.0), usual=(0.6, 4.0), source="bent hose"),
    _form("hose_stiffness", "hardening spring about an angle", "N m/rad",
          _free("hose_stiffness_nm_rad", 0.0, 15.0, 1.0, 3.0), _free("hose_angle_deg", -60.0, 60.0, 8.0, -8.0),
          _free("hose_cubic_nm_rad3", 0.0, 100.0, 3.0), usual=(0.6, 4.0), source="bent hose"),
    _form("payload", "point mass 0.34 m from the joint", "g", _free("payload_kg", 0.0, 0.5, 0.03, 0.07),
          scale=1e3, usual=(20.0, 90.0), source="F.67"),
    _form("coupling_flexibility", "30 % of the inertia and its weight beyond", "Hz",
          _free("flexible_hz", 5.0, 40.0, 13.0, 17.0), _free("flexible_damping", 0.0, 0.3, 0.03),
          others={"flexible_share": 0.3}, usual=(12.0, 18.0), source="two masses and a spring"),
    _form("coupling_flexibility", "30 % of the inertia beyond, the weight before it", "Hz",
          _free("flexible_hz", 5.0, 40.0, 13.0, 17.0), _free("flexible_damping", 0.0, 0.3, 0.03),
          others={"flexible_share": 0.3, "flexible_gravity": 0.0}, usual=(12.0, 18.0),
          source="two masses and a spring"),
    _form("base_tilt", "gravity turned", "deg", _free("base_tilt_deg", -25.0, 25.0, -6.0, 6.0), usual=(4.0, 8.0),
          source="F.67"),
    _form("angle_sensor_lag", "one pole", "ms", _free("angle_lag_ms", 0.0, 80.0, 8.0, 16.0), usual=(5.0, 20.0),
          source="first-order filter"),
    _form("angle_sensor_lag", "two poles", "ms", _free("angle_lag_ms", 0.0, 80.0, 8.0, 16.0), _DAMPING,
          others={"lag_order": 2.0},
          usual=(5.0, 20.0), source="second-order filter"),
    _form("pressure_sensor_lag", "one pole", "ms", _free("pressure_lag_ms", 0.0, 200.0, 20.0, 50.0), usual=(10.0, 60.0),
          source="first-order filter"),
    _form("pressure_sensor_lag", "two poles", "ms", _free("pressure_lag_ms", 0.0, 200.0, 20.0, 50.0), _DAMPING,
          others={"lag_order": 2.0}, usual=(10.0, 60.0), source="second-order filter"),
    _form("backlash", "play before the sensor", "deg", _free("backlash_deg", 0.0, 5.0, 0.4, 0.8), usual=(0.25, 1.0),
          source="play operator"),
    _form("backlash", "soft play", "deg", _free("backlash_deg", 0.0, 5.0, 0.4, 0.8), others={"backlash_soft": 1.0},
          usual=(0.25, 1.0), source="Prandtl's operator, smooth"),
)  # fmt: skip
