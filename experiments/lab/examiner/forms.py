"""From labels to an arm: which form an effect takes, and the numbers that give it its magnitude.

Each effect has one or two forms; `variant` picks among them. The docstrings say what the magnitude means.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from loopshape.core.units import rad

from .arm import BAR, Arm
from .labels import effect
from .mechanics import geometry, nominal_length, stiffness

Form = Callable[[Arm, float, int, np.random.Generator], Arm]
SOUND_M_S = 343.0


def build(labels: Mapping[str, float], rng: np.random.Generator, variant: int, ordinary: bool = True) -> Arm:
    """The arm of these labels with manufacturing tolerance, both from `rng`; refuses an effect it does not have."""
    for name in labels:
        effect(name)
    spread_arm = spread(Arm(), rng)
    arm = spread_arm if ordinary else Arm()
    for name in sorted(labels):
        arm = FORMS[name](arm, float(labels[name]), variant, rng)
    return arm


def spread(arm: Arm, rng: np.random.Generator) -> Arm:
    """Ordinary spread of an arm (FORMAT.md): radii, stiffness, damping, masses."""
    r_in, r_s, r_out = 1.0 + rng.uniform(-0.02, 0.02, 3)
    k_a, k_b = 1.0 + rng.uniform(-0.03, 0.03, 2)
    d, m = 1.0 + rng.uniform(-0.2, 0.2), 1.0 + rng.uniform(-0.01, 0.01)
    return arm._replace(
        beta_in_m2=arm.beta_in_m2 * r_in**2,
        beta_s_m2=arm.beta_s_m2 * r_s**2,
        beta_out_a_m2=arm.beta_out_a_m2 * r_out**2,
        beta_out_b_m2=arm.beta_out_b_m2 * r_out**2,
        stiffness_a=arm.stiffness_a * k_a,
        stiffness_b=arm.stiffness_b * k_b,
        damping=arm.damping * d,
        inertia_kgm2=arm.inertia_kgm2 * m,
        body_nm=arm.body_nm * m,
    )


def typical_load_n() -> float:
    """Pull of both muscles together at 0 deg and 0.5 bar each, in N."""
    ha, hb, *_ = geometry(0.0)
    return sum(stiffness(0.5, h) * (h - nominal_length(0.5)) for h in (ha, hb))


def _form(variant: int, delay_ms: float) -> int:
    """Form 1 or 2 of a lag; none where it is shorter than the integrator can follow."""
    return 1 + variant % 2 if delay_ms >= 0.5 else 0


def _friction(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(friction_form=1 + variant % 2, friction_nm=m, load_n=typical_load_n())


def _hose_stiffness(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Spring about an off-centre angle, linear or hardening."""
    centre = rad(rng.uniform(4.0, 10.0) * rng.choice([-1.0, 1.0]))
    return arm._replace(spring_nm_rad=m, spring_centre_rad=float(centre), spring_hardening=0.4 * (variant % 2))


def _braid(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(braid_form=1 + variant % 2, braid_n=m)


def _creep(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """The nominal stiffness is the quick one (0) or the relaxed one (1)."""
    return arm._replace(creep_share=m, creep_gain=1.0 / (1.0 - m) if variant % 2 else 1.0)


def _mismatch(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(stiffness_a=arm.stiffness_a * (1.0 + 0.5 * m), stiffness_b=arm.stiffness_b * (1.0 - 0.5 * m))


def _length_offset(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(offset_a_m=arm.offset_a_m + 1e-3 * m)


def _stiffness(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(stiffness_a=arm.stiffness_a * (1.0 + m), stiffness_b=arm.stiffness_b * (1.0 + m))


def _gas_law(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Share of the atmosphere in p dV/dt; above 1 an exponent, of the stroke alone (0) or half of the flow too (1)."""
    exponent = max(m, 1.0)
    return arm._replace(
        atmosphere_share=min(m, 1.0),
        exponent=exponent,
        flow_exponent=1.0 + 0.5 * (exponent - 1.0) * (variant % 2),
    )


def _dead_volume(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Part of the muscle's gas (0), or a chamber behind a throat (1)."""
    return arm._replace(dead_a_m3=1e-6 * m, dead_b_m3=0.8e-6 * m, dead_form=variant % 2 if m > 5.0 else 0)


def _leak(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Hole of this diameter at A, of four fifths of it at B."""
    area = 0.25 * math.pi * (1e-3 * m) ** 2
    return arm._replace(leak_form=1 + variant % 2, leak_a_m2=area, leak_b_m2=0.64 * area)


def _hose(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """A volume, a restriction and the sound's running time (0), or segments in which the front travels (1)."""
    if m < 0.15:  # too short for the integrator's step
        return arm
    if variant % 2:
        return arm._replace(line_form=2, line_m=m)
    return arm._replace(line_form=1, line_m=m, transport_s=arm.transport_s + m / SOUND_M_S)


def _droop(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Drop of a regulator before the capacity under flow (0), or of a line behind it when one muscle fills (1)."""
    return arm._replace(droop_form=1 + variant % 2 if m > 0.02 else 0, droop_pa=m * BAR)


def _choked(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Critical ratio of all restrictions: ISO 6358's ellipse (0), or a nozzle (1)."""
    return arm._replace(flow_form=1 + variant % 2, critical_ratio=m)


def _valve(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(valve_form=_form(variant, m), valve_open_s=1e-3 * m)


def _payload(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(payload_kg=1e-3 * m)


def _coupling(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Free-free frequency of 70 and 30 % of the inertia; 2 or 5 % of critical damping."""
    share = 0.3
    w = 2.0 * math.pi * m
    reduced = share * (1.0 - share) * arm.inertia_kgm2
    return arm._replace(
        coupling_form=1,
        share_beyond=share,
        coupling_nm_rad=w * w * reduced,
        coupling_nms_rad=2.0 * (0.05 if variant % 2 else 0.02) * w * reduced,
    )


def _tilt(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(tilt_rad=float(rad(m)))


def _backlash(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(play_form=1 + variant % 2, play_rad=float(rad(m)))


def _angle_lag(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(angle_form=_form(variant, m), angle_lag_s=1e-3 * m)


def _pressure_lag(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(pressure_form=_form(variant, m), pressure_lag_s=1e-3 * m)


def _delay(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Pulses come late (0), or are made from old commands, to the millisecond (1)."""
    if variant % 2:
        return arm._replace(stale_ticks=round(m))
    return arm._replace(transport_s=arm.transport_s + 1e-3 * m)


def _contact(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Muscle A is stiffer by m N/m once it is stretched beyond an angle."""
    return arm._replace(contact_n_m=m, contact_rad=float(rad(rng.uniform(-6.0, 0.0))))


def _end_stop(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(stop_nm_rad=m, stop_rad=float(rad(rng.uniform(8.0, 12.0))))


def _clog(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(beta_out_a_m2=arm.beta_out_a_m2 * (1.0 - m))


def _flow_drift(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(flow_drift=m)


def _gauge(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(gauge_curve_bar=m)


def _waves(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    per_rad = float(rng.uniform(30.0, 45.0))
    return arm._replace(
        wave_rad=float(rad(m)), wave_per_rad=per_rad, wave_phase_rad=float(rng.uniform(0.0, 2.0 * math.pi))
    )


def _crosstalk(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(crosstalk=m)


def _ripple(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(ripple_pa=m * BAR, ripple_hz=float(rng.uniform(0.03, 0.08)))


def _viscous(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    return arm._replace(viscous_nms_rad=m)


def _lost(arm: Arm, m: float, variant: int, rng: np.random.Generator) -> Arm:
    """Nothing of the arm: the session draws which commands do not arrive."""
    return arm


FORMS: dict[str, Form] = {
    "angle_sensor_lag": _angle_lag,
    "backlash": _backlash,
    "base_tilt": _tilt,
    "braid_contact": _contact,
    "braid_hysteresis": _braid,
    "choked_flow": _choked,
    "coupling_flexibility": _coupling,
    "dead_volume": _dead_volume,
    "end_stop_rubber": _end_stop,
    "exhaust_clog": _clog,
    "flow_drift": _flow_drift,
    "gas_law": _gas_law,
    "gauge_curvature": _gauge,
    "hose_lag": _hose,
    "hose_stiffness": _hose_stiffness,
    "joint_friction": _friction,
    "leak": _leak,
    "loop_delay": _delay,
    "lost_commands": _lost,
    "muscle_creep": _creep,
    "muscle_mismatch": _mismatch,
    "nominal_length_offset": _length_offset,
    "payload": _payload,
    "potentiometer_waves": _waves,
    "pressure_sensor_lag": _pressure_lag,
    "sensor_crosstalk": _crosstalk,
    "stiffness_error": _stiffness,
    "supply_droop": _droop,
    "supply_ripple": _ripple,
    "valve_delay": _valve,
    "viscous_joint": _viscous,
}
