"""Mass, gas and energy of the 1-DoF arm, and that nothing flows without a difference."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.dynamics.model import derivatives, flow, muscle, supply_flows
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants

C = constants(ARM1_PARAMETERS.vector())
PRESSURES = st.floats(1.5e4, 1.2e5)
ANGLES = st.floats(-0.75, 0.75)
VALVES = st.booleans()
NOMINAL = dict(zip(ARM1_PARAMETERS.names, ARM1_PARAMETERS.vector().tolist(), strict=True))


def lengths(angle):
    """Lengths of both muscles by the vectors of appendix F, in m."""
    mm = {name: 1e-3 * value for name, value in NOMINAL.items() if name.endswith("_mm")}
    out = []
    for arm_mm, y in (("l2a_mm", -mm["l1a_mm"]), ("l2b_mm", mm["l1b_mm"])):
        r = mm["l12_mm"] - mm[arm_mm]
        x = mm["l11x_mm"] - mm["lab_mm"] - r * math.sin(angle)
        out.append(math.hypot(x, mm["l11y_mm"] + y + r * math.cos(angle)) - mm["fitting_mm"])
    return out


def volume(h):
    """(3.37-3.39): V = pi h/60 (3 d1^2 + 4 d1 d2 + 8 d2^2)."""
    d1, braid = 1e-3 * NOMINAL["end_diameter_mm"], 1e-3 * NOMINAL["braid_length_mm"]
    d2 = math.sqrt(4.0 * braid**2 - h**2) / (NOMINAL["braid_turns"] * math.pi)
    return math.pi * h / 60.0 * (3.0 * d1**2 + 4.0 * d1 * d2 + 8.0 * d2**2)


@settings(max_examples=300)
@given(p_c=PRESSURES, p_a=PRESSURES, p_b=PRESSURES, angle=ANGLES, valves=st.tuples(VALVES, VALVES, VALVES, VALVES))
def test_gas_is_neither_made_nor_lost(p_c, p_a, p_b, angle, valves):
    """At rest the three volumes' contents change by what enters from the supply and leaves to the room."""
    d_p_c, d_p_a, d_p_b, _ = derivatives(C, (p_c, p_a, p_b, angle, 0.0), valves)
    v_a, v_b = (volume(h) for h in lengths(angle))
    q_in = flow(C, C[k.BETA_IN], C[k.P_IN], p_c)
    q_out = sum(o * flow(C, C[k.BETA_OUT], p, 0.0) for o, p in zip(valves[2:], (p_a, p_b), strict=True))
    stored = C[k.V_C] * d_p_c + v_a * d_p_a + v_b * d_p_b
    assert stored == pytest.approx(C[k.RT] * (q_in - q_out), rel=1e-9, abs=1e-9 * C[k.RT] * 1e-3)


@settings(max_examples=300)
@given(p_c=PRESSURES, p_a=PRESSURES, p_b=PRESSURES)
def test_the_splitter_passes_on_what_its_throttle_lets_through(p_c, p_a, p_b):
    q_a, q_b = supply_flows(C, p_c, p_a, p_b, 1.0, 1.0)
    farther = p_a if abs(p_c - p_a) > abs(p_c - p_b) else p_b
    whole = abs(flow(C, C[k.BETA_S], p_c, farther))
    assert abs(q_a) + abs(q_b) == pytest.approx(whole, rel=1e-12)
    for q, p in ((q_a, p_a), (q_b, p_b)):  # each flows down its own difference
        assert math.copysign(1.0, q) == math.copysign(1.0, p_c - p) or q == 0.0


@settings(max_examples=200)
@given(p_c=PRESSURES, p_a=PRESSURES, p_b=PRESSURES)
def test_both_valves_open_below_the_supply_is_3_33(p_c, p_a, p_b):
    """(3.28-3.33), where both muscles lie below p_c: p_s = min(p_A, p_B) and shares by the differences."""
    p_a, p_b, p_c = *sorted((p_a, p_b)), max(p_a, p_b, p_c) + 1.0
    q_s = flow(C, C[k.BETA_S], p_c, min(p_a, p_b))
    share = (p_c - p_a) / ((p_c - p_a) + (p_c - p_b))
    np.testing.assert_allclose(supply_flows(C, p_c, p_a, p_b, 1.0, 1.0), [share * q_s, (1.0 - share) * q_s], rtol=1e-9)


@settings(max_examples=100)
@given(p=PRESSURES, beta=st.sampled_from([k.BETA_IN, k.BETA_S, k.BETA_OUT]))
def test_nothing_flows_without_a_difference(p, beta):
    assert flow(C, C[beta], p, p) == 0.0


@settings(max_examples=100)
@given(p1=PRESSURES, p2=PRESSURES)
def test_flow_turns_with_the_difference(p1, p2):
    assert flow(C, C[k.BETA_S], p1, p2) == -flow(C, C[k.BETA_S], p2, p1)


@settings(max_examples=100)
@given(p=PRESSURES, gap=st.one_of(st.just(0.0), st.floats(1e-300, 1e4)))
def test_the_splitter_s_zero_denominators_are_guarded(p, gap):
    """Both muscles at p_c, or p_c exactly between them, where (3.33) divides by zero."""
    gap = (p + gap) - p  # exactly representable on both sides
    q_a, q_b = supply_flows(C, p, p - gap, p + gap, 1.0, 1.0)
    assert math.isfinite(q_a)
    assert math.isfinite(q_b)
    bound = flow(C, C[k.BETA_S], p + gap, p)
    assert 0.0 <= q_a <= 1.000001 * bound
    assert -1.000001 * bound <= q_b <= 0.0
    if gap == 0.0:
        assert (q_a, q_b) == (0.0, 0.0)


@settings(max_examples=100)
@given(p_c=PRESSURES, p_a=PRESSURES, p_b=PRESSURES, angle=ANGLES, velocity=st.floats(-5.0, 5.0))
def test_an_open_out_valve_overrules_the_in_valve(p_c, p_a, p_b, angle, velocity):
    state = (p_c, p_a, p_b, angle, velocity)
    assert derivatives(C, state, (True,) * 4) == derivatives(C, state, (False, False, True, True))


@settings(max_examples=100)
@given(p=PRESSURES, angle=ANGLES)
def test_a_muscle_s_volume_and_its_slope_belong_together(p, angle):
    h = lengths(angle)[0]
    _, v, slope = muscle(C, p, h, 0.0, 1.0, C[k.TWO_L], 0.0)
    assert v == pytest.approx(volume(h), rel=1e-12)
    assert slope == pytest.approx((volume(h + 1e-5) - volume(h - 1e-5)) / 2e-5, rel=1e-6, abs=1e-8)


GASES = {
    "gauge as printed": ({}, 0.0, 1.0),
    "absolute": ({"gas_absolute_share": 1.0}, 101325.0, 1.0),
    "absolute, adiabatic": ({"gas_absolute_share": 1.0, "polytropic_exponent": 1.4}, 101325.0, 1.4),
}


@pytest.fixture(params=GASES, scope="module")
def swinging(request, arm_open_loop):
    """An undamped arm with all valves shut, let go from 5 deg beside its equilibrium, for 2 s."""
    changes, p_0, n = GASES[request.param]
    changes = changes | {"damping_ns_m": 0.0, "damping_per_bar_ns_m": 0.0}
    c = constants(ARM1_PARAMETERS.vector(changes))
    start = rest(c, 10.0, 1.0, 1e5)
    start[3] += math.radians(5.0)
    log, _ = arm_open_loop(c, start, np.zeros((2000, 2)), steps=8)
    assert np.ptp(np.degrees(log[:, 7])) > 5.0  # it swings; least with the stiffer absolute gas
    return c, log[::25], p_0, n


def test_shut_muscles_keep_their_gas(swinging):
    """(p + p0) V^n stays what it was: gauge pressure as printed (p0 = 0), or Boyle's and Poisson's laws."""
    _, log, p_0, n = swinging
    for place, column in ((0, 9), (1, 10)):
        content = [(row[column] + p_0) * volume(lengths(row[7])[place]) ** n for row in log]
        np.testing.assert_allclose(content, content[0], rtol=1e-10)


def test_energy_of_the_undamped_shut_arm_is_constant(swinging):
    """Kinetic energy, gravity, and the work stored in each muscle whose pressure follows from its length."""
    c, log, p_0, n = swinging
    inertia = NOMINAL["m2_kg"] * (1e-3 * NOMINAL["l12_mm"]) ** 2 + NOMINAL["jzz2_kgm2"]
    weight = NOMINAL["m2_kg"] * NOMINAL["gravity_m_s2"] * 1e-3 * NOMINAL["l12_mm"]
    start = lengths(log[0, 7])
    content = [(log[0, 9 + i] + p_0) * volume(start[i]) ** n for i in (0, 1)]

    def stored(i, h):
        def pull(x):
            return muscle(c, content[i] / volume(x) ** n - p_0, x, 0.0, 1.0, c[k.TWO_L], 0.0)[0]

        return quad(pull, start[i], h, epsabs=1e-12, epsrel=1e-12)[0]

    energy, kinetic = [], []
    for row in log:
        h = lengths(row[7])
        kinetic.append(0.5 * inertia * row[8] ** 2)
        energy.append(kinetic[-1] + weight * math.cos(row[7]) + stored(0, h[0]) + stored(1, h[1]))
    assert max(kinetic) > 1e-3  # J; it moves
    np.testing.assert_allclose(energy, energy[0], rtol=0.0, atol=1e-8 * max(kinetic))


def test_damping_takes_energy_away(arm_open_loop):
    start = rest(C, 10.0, 1.0, 1e5)
    start[3] += math.radians(5.0)
    log, _ = arm_open_loop(C, start, np.zeros((2000, 2)))
    assert np.ptp(log[1500:, 7]) < 0.1 * np.ptp(log[:500, 7])
