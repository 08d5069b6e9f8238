"""Rates of all states, and the integrator: Shu and Osher's third-order Runge-Kutta at 0.25 ms."""

from __future__ import annotations

from loopshape.core.kernels.compiled import compiled, compiled_in_line
from loopshape.core.units import Array

from .arm import (
    ATMOSPHERE_PA,
    BRAID_A,
    BRAID_B,
    CAPACITY_M3,
    CREEP_A,
    CREEP_B,
    FRICTION,
    LINE_A,
    LINE_B,
    OMEGA,
    OMEGA_L,
    P_A,
    P_B,
    P_C,
    P_REG,
    PAYLOAD_ARM_M,
    RT,
    SENSE_A,
    SENSE_B,
    SENSE_T,
    SIDE_A,
    SIDE_B,
    STEP_S,
    THETA,
    THETA_L,
    Arm,
)
from .mechanics import (
    body_torque,
    friction,
    geometry,
    joint_torque,
    muscle_force,
    volume,
)
from .pneumatics import (
    THROAT_S_PA,
    fill_flows,
    leak_flow,
    line_rates,
    regulator_target,
    restriction,
    valve_pressure,
)
from .sensors import lag_rates

REGULATOR_S = 0.15
MANIFOLD_M3 = 2e-5
DROOP_FLOW_KG_S = 2.3e-4  # fills one muscle at 0.5 bar


@compiled_in_line
def supply_rates(arm: Arm, y: Array, dy: Array, supply_pa: float, demand: float) -> None:
    """Rates of the capacity's pressure and of what lies before it (a regulator) or behind it (a line, a manifold)."""
    source = y[P_REG] if arm.droop_form == 1 else supply_pa
    flow = restriction(arm, arm.beta_in_m2, source, y[P_C])
    if arm.droop_form == 1:
        dy[P_REG] = (regulator_target(arm, supply_pa, flow) - y[P_REG]) / REGULATOR_S
    if arm.droop_form == 2:
        through = DROOP_FLOW_KG_S / arm.droop_pa * (y[P_C] - y[P_REG])
        dy[P_REG] = RT * (through - demand) / MANIFOLD_M3
        demand = through
    dy[P_C] = RT * (flow - demand) / CAPACITY_M3


@compiled_in_line
def muscle_gas(
    arm: Arm,
    y: Array,
    dy: Array,
    at: int,
    side: int,
    dead_m3: float,
    leak_m2: float,
    h: float,
    speed: float,
    flow: float,
) -> None:
    """Rate of a muscle's pressure from the flow into it (kg/s), its motion, its leak and its dead volume."""
    v, slope = volume(h)
    if arm.leak_form > 0:
        flow -= leak_flow(arm.leak_form, leak_m2, y[at])
    if arm.dead_form == 1:
        into = THROAT_S_PA * (y[at] - y[side])
        dy[side] = RT * into / dead_m3
        flow -= into
        dead_m3 = 0.0
    stroke = arm.exponent * (y[at] + arm.atmosphere_share * ATMOSPHERE_PA) * slope * speed
    dy[at] = (arm.flow_exponent * RT * flow - stroke) / (v + dead_m3)


@compiled_in_line
def gas_rates(
    arm: Arm, y: Array, dy: Array, v: Array, supply_pa: float, flow_gain: float,
    ha: float, hb: float, sa: float, sb: float,
) -> None:  # fmt: skip
    """Rates of all pressures; `v` is the open share of in A, out A, in B, out B; h and s lengths and their rates."""
    pa, pb = valve_pressure(arm, y, P_A, LINE_A), valve_pressure(arm, y, P_B, LINE_B)
    source = y[P_REG] if arm.droop_form == 2 else y[P_C]
    into_a, into_b = fill_flows(arm, source, pa, pb, v[0] * (1.0 - v[1]), v[2] * (1.0 - v[3]))
    into_a, into_b = flow_gain * into_a, flow_gain * into_b
    supply_rates(arm, y, dy, supply_pa, into_a + into_b)
    if v[1] > 0.0:
        into_a -= flow_gain * v[1] * restriction(arm, arm.beta_out_a_m2, pa, 0.0)
    if v[3] > 0.0:
        into_b -= flow_gain * v[3] * restriction(arm, arm.beta_out_b_m2, pb, 0.0)
    if arm.line_form > 0:
        into_a = line_rates(arm, LINE_A, y, dy, into_a, y[P_A])
        into_b = line_rates(arm, LINE_B, y, dy, into_b, y[P_B])
    muscle_gas(arm, y, dy, P_A, SIDE_A, arm.dead_a_m3, arm.leak_a_m2, ha, sa, into_a)
    muscle_gas(arm, y, dy, P_B, SIDE_B, arm.dead_b_m3, arm.leak_b_m2, hb, sb, into_b)


@compiled_in_line
def body_rates(arm: Arm, y: Array, dy: Array, torque: float) -> None:
    """Rates of angles and speeds under a torque at the joint (muscles, friction, springs)."""
    payload_kgm2 = arm.payload_kg * PAYLOAD_ARM_M * PAYLOAD_ARM_M
    dy[THETA] = y[OMEGA]
    if arm.coupling_form == 0:
        torque += body_torque(arm, y[THETA], 1.0, arm.payload_kg)
        dy[OMEGA] = torque / (arm.inertia_kgm2 + payload_kgm2)
        return
    twist = arm.coupling_nm_rad * (y[THETA] - y[THETA_L]) + arm.coupling_nms_rad * (y[OMEGA] - y[OMEGA_L])
    far, near = arm.share_beyond, 1.0 - arm.share_beyond
    dy[OMEGA] = (torque + body_torque(arm, y[THETA], near, 0.0) - twist) / (near * arm.inertia_kgm2)
    dy[THETA_L] = y[OMEGA_L]
    beyond = twist + body_torque(arm, y[THETA_L], far, arm.payload_kg)
    dy[OMEGA_L] = beyond / (far * arm.inertia_kgm2 + payload_kgm2)


@compiled_in_line
def rates(arm: Arm, y: Array, dy: Array, v: Array, supply_pa: float, flow_gain: float, pot_rad: float) -> None:
    """All rates at the state `y`; those of unused states stay as they are in `dy` (zero)."""
    theta, omega = y[THETA], y[OMEGA]
    ha, hb, slope_a, slope_b = geometry(theta)
    sa, sb = slope_a * omega, slope_b * omega
    gas_rates(arm, y, dy, v, supply_pa, flow_gain, ha, hb, sa, sb)
    pull_a = muscle_force(arm, arm.stiffness_a, arm.offset_a_m, y[P_A], ha, sa, BRAID_A, CREEP_A, y, dy)
    pull_b = muscle_force(arm, arm.stiffness_b, 0.0, y[P_B], hb, sb, BRAID_B, CREEP_B, y, dy)
    if arm.contact_n_m > 0.0 and theta < arm.contact_rad:
        pull_a += arm.contact_n_m * slope_a * (theta - arm.contact_rad)
    torque = -pull_a * slope_a - pull_b * slope_b + joint_torque(arm, theta, omega)
    if arm.friction_form > 0:
        torque -= friction(arm, y, dy, omega, pull_a + pull_b)
    body_rates(arm, y, dy, torque)
    if arm.angle_form > 0:
        lag_rates(arm.angle_form, arm.angle_lag_s, SENSE_T, y, dy, pot_rad if arm.play_form > 0 else theta)
    if arm.pressure_form > 0:
        lag_rates(arm.pressure_form, arm.pressure_lag_s, SENSE_A, y, dy, y[P_A])
        lag_rates(arm.pressure_form, arm.pressure_lag_s, SENSE_B, y, dy, y[P_B])


@compiled
def step(arm: Arm, y: Array, work: Array, v: Array, supply_pa: float, flow_gain: float, pot_rad: float) -> None:
    """Move `y` (states,) on by one step in place; `work` is (2, states), its second row zero where unused."""
    mid, dy = work[0], work[1]
    rates(arm, y, dy, v, supply_pa, flow_gain, pot_rad)
    for k in range(y.size):
        mid[k] = y[k] + STEP_S * dy[k]
    rates(arm, mid, dy, v, supply_pa, flow_gain, pot_rad)
    for k in range(y.size):
        mid[k] = 0.75 * y[k] + 0.25 * (mid[k] + STEP_S * dy[k])
    rates(arm, mid, dy, v, supply_pa, flow_gain, pot_rad)
    for k in range(y.size):
        y[k] = (y[k] + 2.0 * (mid[k] + STEP_S * dy[k])) / 3.0
    if arm.friction_form == 2:
        _bound(y, FRICTION, 3)
    if arm.braid_form > 0:
        _bound(y, BRAID_A, 10)


@compiled_in_line
def _bound(y: Array, first: int, count: int) -> None:
    for k in range(first, first + count):
        y[k] = min(max(y[k], -1.0), 1.0)
