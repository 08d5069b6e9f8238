"""The examiner's arm: numbers of one arm, and where each of its states lies.

Everything inside is SI and gauge pressure (Pa, m, rad, N, kg/s). Values with their source in `ARM.md` (S.N. van den
Brink, DCT 2007.002); this folder shares that page with the library's plants, and no code.
"""

from __future__ import annotations

import math
from typing import NamedTuple

BAR = 1e5  # Pa
ATMOSPHERE_PA = 1.01325 * BAR
RT = 287.0 * 293.0  # J/kg
CAPACITY_M3 = 0.01
SUPPLY_PA = 1.0 * BAR
PERIOD_S = 0.02  # of the pulse width modulation
DEAD_ZONE = 0.01
STEP_S = 2.5e-4  # of the integrator
TICK_S = 1e-3  # of the controllers

BETA_PER_M2 = 0.59 * math.sqrt(2.0) * math.pi  # of a throttle's radius squared (3.16)
BETA_IN_M2, BETA_S_M2, BETA_OUT_M2 = BETA_PER_M2 * 0.40e-3**2, BETA_PER_M2 * 0.52e-3**2, BETA_PER_M2 * 0.72e-3**2

# geometry of joint 2 [m], ARM.md 5
X_M, YA_M, YB_M = 0.330, -0.0497, 0.0503
LEVER_M, FITTING_M = 0.034, 0.140
INERTIA_KGM2 = 0.533 * 0.176**2 + 0.00570
GRAVITY = 9.81
BODY_NM = 0.533 * GRAVITY * 0.176
PAYLOAD_ARM_M = 0.34

# muscle, ARM.md 4
BRAID_M, TURNS = 0.1274, 1.25
END_M = 0.025
SHORTENING_M, SHORTENING_BAR = 0.117, 0.232
STIFF_B, STIFF_C0, STIFF_C1 = -3.97, 0.82, 0.85
STIFF_K0, STIFF_K1, STIFF_K2 = -0.442, 5.06, -12.80
DAMP_0, DAMP_P = 40.0, 1.94

# states: position in the vector
P_C, P_A, P_B, THETA, OMEGA, THETA_L, OMEGA_L, P_REG, SIDE_A, SIDE_B = range(10)
FRICTION = 10  # three presliding elements
BRAID_A, BRAID_B = 13, 18  # five slip elements each
CREEP_A, CREEP_B = 23, 27  # four branches each
SENSE_T, SENSE_A, SENSE_B = 31, 33, 35  # two states each
LINE_A, LINE_B = 37, 45  # four pressures, then four mass flows, each
STATES = 53
SEGMENTS, SLIPS, BRANCHES = 4, 5, 4


class Arm(NamedTuple):
    """Numbers of one arm. The values given here are the healthy, nominal arm; `forms.py` moves them.

    A `..._form` of 0 is the nominal form.
    """

    # flow
    beta_in_m2: float = BETA_IN_M2
    beta_s_m2: float = BETA_S_M2
    beta_out_a_m2: float = BETA_OUT_M2
    beta_out_b_m2: float = BETA_OUT_M2
    flow_form: int = 0  # 1: ISO 6358, 2: nozzle
    critical_ratio: float = 0.5
    droop_form: int = 0  # 1: regulator, 2: line behind the capacity
    droop_pa: float = 0.0
    leak_form: int = 0  # 1: orifice, 2: crack
    leak_a_m2: float = 0.0
    leak_b_m2: float = 0.0
    # line
    line_form: int = 0  # 1: one volume and a restriction, 2: segments with inertia
    line_m: float = 0.0
    line_bore_m: float = 2.5e-3
    # gas
    atmosphere_share: float = 0.0
    exponent: float = 1.0
    flow_exponent: float = 1.0
    dead_a_m3: float = 0.0
    dead_b_m3: float = 0.0
    dead_form: int = 0  # 1: behind a throat
    # valve and what drives it
    valve_form: int = 0  # 1: dead time and a ramp, 2: solenoid
    valve_open_s: float = 0.0
    transport_s: float = 0.0
    stale_ticks: int = 0
    # muscle
    stiffness_a: float = 1.0
    stiffness_b: float = 1.0
    damping: float = 1.0
    offset_a_m: float = 0.0
    creep_gain: float = 0.0
    creep_share: float = 0.0
    braid_form: int = 0  # 1: slip elements, 2: Bouc and Wen
    braid_n: float = 0.0
    # joint
    friction_form: int = 0  # 1: LuGre with load, 2: slip elements
    friction_nm: float = 0.0
    load_n: float = 1.0
    spring_nm_rad: float = 0.0
    spring_centre_rad: float = 0.0
    spring_hardening: float = 0.0
    # body
    inertia_kgm2: float = INERTIA_KGM2
    body_nm: float = BODY_NM
    payload_kg: float = 0.0
    tilt_rad: float = 0.0
    coupling_form: int = 0  # 1: flexible
    coupling_nm_rad: float = 0.0
    coupling_nms_rad: float = 0.0
    share_beyond: float = 0.0
    # sensors
    angle_form: int = 0  # 1: first order, 2: second order
    angle_lag_s: float = 0.0
    pressure_form: int = 0
    pressure_lag_s: float = 0.0
    play_form: int = 0  # 1: rigid, 2: soft
    play_rad: float = 0.0
    converters: int = 1  # 0: what is read and logged has no bits
    # outside the library
    flow_drift: float = 0.0
    contact_n_m: float = 0.0
    contact_rad: float = 0.0
    stop_nm_rad: float = 0.0
    stop_rad: float = 1.0
    ripple_pa: float = 0.0
    ripple_hz: float = 0.5
    viscous_nms_rad: float = 0.0
    gauge_curve_bar: float = 0.0
    crosstalk: float = 0.0
    wave_rad: float = 0.0
    wave_per_rad: float = 0.0
    wave_phase_rad: float = 0.0
