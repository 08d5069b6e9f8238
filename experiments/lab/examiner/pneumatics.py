"""Gas: restrictions, splitter, lines, and what they do to the pressures."""

from __future__ import annotations

import math

from loopshape.core.kernels.compiled import compiled_in_line
from loopshape.core.units import Array

from .arm import ATMOSPHERE_PA, RT, SEGMENTS, Arm

VISCOSITY_PA_S = 1.82e-5  # air, 20 deg C
LEAK_COEFFICIENT = 0.65  # of a sharp hole
END_LOSS = 1.5  # of a hose's entry and exit, in velocity heads
AIR, AIR_CRITICAL = 1.4, (2.0 / 2.4) ** 3.5
REGULATOR_FLOW_KG_S = 1.5e-5
THROAT_S_PA = 5.0e-8  # m s: mass flow a pascal through the throat of a dead volume


@compiled_in_line
def throttle(beta: float, p1: float, p2: float) -> float:
    """Mass flow of the source's throttle (3.16) in kg/s from gauge pressures in Pa."""
    drop = p1 - p2
    flow = beta * math.sqrt((p1 + p2 + 2.0 * ATMOSPHERE_PA) * abs(drop) / (2.0 * RT))
    return flow if drop > 0.0 else -flow


@compiled_in_line
def iso_6358(beta: float, critical: float, p1: float, p2: float) -> float:
    """Mass flow by ISO 6358; its conductance equals the throttle's at small pressure drops.

    At a critical ratio of 0 it is the source's throttle exactly.
    """
    up, down = max(p1, p2) + ATMOSPHERE_PA, min(p1, p2) + ATMOSPHERE_PA
    share = max(down / up - critical, 0.0) / (1.0 - critical)
    flow = beta * up * math.sqrt(0.5 * (1.0 - critical) / RT) * math.sqrt(max(1.0 - share * share, 0.0))
    return flow if p1 > p2 else -flow


@compiled_in_line
def nozzle(beta: float, critical: float, p1: float, p2: float) -> float:
    """Mass flow of an isentropic nozzle (St Venant and Wantzel) whose pressure ratio is stretched so that it chokes
    at `critical`; equals the throttle's at small pressure drops.
    """
    up, down = max(p1, p2) + ATMOSPHERE_PA, min(p1, p2) + ATMOSPHERE_PA
    stretch = (1.0 - AIR_CRITICAL) / (1.0 - critical)
    ratio = 1.0 - stretch * (1.0 - max(down / up, critical))
    shape = AIR / (AIR - 1.0) * (ratio ** (2.0 / AIR) - ratio ** ((AIR + 1.0) / AIR))
    flow = beta * up * math.sqrt(max(shape, 0.0) / (stretch * RT))
    return flow if p1 > p2 else -flow


@compiled_in_line
def restriction(arm: Arm, beta: float, p1: float, p2: float) -> float:
    """Mass flow through a restriction of this arm in kg/s."""
    if arm.flow_form == 1:
        return iso_6358(beta, arm.critical_ratio, p1, p2)
    if arm.flow_form == 2:
        return nozzle(beta, arm.critical_ratio, p1, p2)
    return throttle(beta, p1, p2)


@compiled_in_line
def fill_flows(arm: Arm, p_c: float, p_a: float, p_b: float, in_a: float, in_b: float) -> tuple[float, float]:
    """Flows into A and B through the common throttle and the splitter (3.34), in kg/s.

    `in_a`, `in_b` are open shares, 0 to 1, of the step: as long as both are open they share one flow.
    """
    both = min(in_a, in_b)
    flow_a = (in_a - both) * restriction(arm, arm.beta_s_m2, p_c, p_a) if in_a > both else 0.0
    flow_b = (in_b - both) * restriction(arm, arm.beta_s_m2, p_c, p_b) if in_b > both else 0.0
    if both > 0.0:
        drop_a, drop_b = p_c - p_a, p_c - p_b
        behind = p_a if abs(drop_a) > abs(drop_b) else p_b
        flow = both * restriction(arm, arm.beta_s_m2, p_c, behind)
        total = drop_a + drop_b
        share = 0.5
        if abs(total) > 1.0:
            share = min(max(drop_a / total, 0.0), 1.0)
        flow_a += share * flow
        flow_b += (1.0 - share) * flow
    return flow_a, flow_b


@compiled_in_line
def leak_flow(form: int, area: float, p: float) -> float:
    """Leak to the surroundings in kg/s: a sharp hole, or a crack with the same flow at 0.5 bar."""
    if form == 1:
        return LEAK_COEFFICIENT * throttle(1.4142135623730951 * area, p, 0.0)
    reference = LEAK_COEFFICIENT * throttle(1.4142135623730951 * area, 0.5e5, 0.0)
    return reference * (p + 2.0 * ATMOSPHERE_PA) * p / (0.5e5 * (0.5e5 + 2.0 * ATMOSPHERE_PA))


@compiled_in_line
def hose_losses(bore_m: float, length_m: float, ends: float, density: float) -> tuple[float, float]:
    """Loss of a hose: Poiseuille's in Pa s/kg, and that of its ends in Pa s²/kg².

    Pulses of a few ms leave no time for turbulence although Reynolds' number passes 2300.
    """
    area = 0.25 * math.pi * bore_m * bore_m
    return (
        128.0 * VISCOSITY_PA_S * length_m / (math.pi * bore_m**4 * density),
        0.5 * ends / (density * area * area),
    )


@compiled_in_line
def hose_flow(arm: Arm, p1: float, p2: float) -> float:
    """Steady mass flow through the whole hose in kg/s."""
    density = (0.5 * (p1 + p2) + ATMOSPHERE_PA) / RT
    laminar, ends = hose_losses(arm.line_bore_m, arm.line_m, END_LOSS, density)
    drop = abs(p1 - p2)
    flow = 2.0 * drop / (laminar + math.sqrt(laminar * laminar + 4.0 * ends * drop))
    return flow if p1 > p2 else -flow


@compiled_in_line
def line_rates(arm: Arm, first: int, y: Array, dy: Array, flow: float, muscle_pa: float) -> float:
    """Rates of the line's states that begin at `first`; gives the flow into the muscle in kg/s.

    Form 1: half the hose's volume behind the valve, then its restriction. Form 2: segments, each with volume,
    inertia and restriction, so that a front travels.
    """
    area = 0.25 * math.pi * arm.line_bore_m**2
    if arm.line_form == 1:
        out = hose_flow(arm, y[first], muscle_pa)
        dy[first] = RT * (flow - out) / (0.5 * area * arm.line_m)
        return out
    length = arm.line_m / SEGMENTS
    for k in range(SEGMENTS):
        after = y[first + k + 1] if k + 1 < SEGMENTS else muscle_pa
        m = y[first + SEGMENTS + k]
        density = (0.5 * (y[first + k] + after) + ATMOSPHERE_PA) / RT
        laminar, ends = hose_losses(arm.line_bore_m, length, END_LOSS / SEGMENTS, density)
        loss = (laminar + ends * abs(m)) * m
        dy[first + SEGMENTS + k] = area / length * (y[first + k] - after - loss)
        dy[first + k] = RT * (flow - m) / (area * length)
        flow = m
    return flow


@compiled_in_line
def valve_pressure(arm: Arm, y: Array, muscle: int, line: int) -> float:
    """Pressure behind the valve in Pa: the line's, where there is one."""
    return y[line] if arm.line_form > 0 else y[muscle]


@compiled_in_line
def regulator_target(arm: Arm, supply_pa: float, flow: float) -> float:
    """Pressure to which a regulator settles at a flow: half its droop at once, the rest soon after."""
    return supply_pa - arm.droop_pa * (1.0 - 0.5 * math.exp(-max(flow, 0.0) / REGULATOR_FLOW_KG_S))
