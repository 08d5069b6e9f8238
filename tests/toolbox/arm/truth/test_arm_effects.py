"""Each of the arm's effects on a small case whose answer is known from elsewhere."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics import memory, model, valves
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS

#: an arm that nothing moves: muscles without stiffness and damping, and no gravity
LIMP = {"stiffness_k0": 0.0, "stiffness_k1": 0.0, "stiffness_k2": 0.0, "damping_ns_m": 0.0, "damping_per_bar_ns_m": 0.0}
FREE = LIMP | {"gravity_m_s2": 0.0}
NOMINAL = dict(zip(ARM1_PARAMETERS.names, ARM1_PARAMETERS.vector().tolist(), strict=True))
INERTIA = NOMINAL["m2_kg"] * (1e-3 * NOMINAL["l12_mm"]) ** 2 + NOMINAL["jzz2_kgm2"]
WEIGHT = NOMINAL["m2_kg"] * NOMINAL["gravity_m_s2"] * 1e-3 * NOMINAL["l12_mm"]
TWO_L = 2e-3 * NOMINAL["braid_length_mm"]
RT = NOMINAL["gas_constant_j_kgk"] * NOMINAL["temperature_k"]
PATM = 101325.0
SHUT = (0.0, 0.0, 0.0, 0.0)


def state(angle=0.0, velocity=0.0, p_a=5e4, p_b=5e4, p_c=1e5):
    return np.array([p_c, p_a, p_b, angle, velocity, angle, velocity])


def at_rest(c, x):
    """Memory of an arm that has long rested in x."""
    m = np.empty(memory.SIZE)
    memory.start(c, x, m)
    return m


def lengths(c, angle):
    return np.array(model.geometry(c, math.sin(angle), math.cos(angle))[:2])


def volumes(c, angle):
    return [model.muscle(c, 5e4, h, 0.0, 1.0, TWO_L, 0.0)[1] for h in lengths(c, angle)]


def commands(u_a, u_b, rows):
    """z (rows, 2) of constant commands."""
    return np.tile([0.5 * (u_a - u_b), 0.5 * (u_a + u_b)], (rows, 1))


# ---- joint ----


def test_coulomb_friction_takes_torque_times_travel(arm_open_loop, arm_constants):
    c = arm_constants(**FREE, coulomb_nm=0.1, coulomb_rad_s=0.01)
    log, _ = arm_open_loop(c, state(velocity=1.5), np.zeros((150, 2)))
    angle, velocity = log[:, 7], log[:, 8]
    assert velocity[-1] > 0.5  # 50 times the transition
    np.testing.assert_allclose(0.5 * INERTIA * (1.5**2 - velocity**2), 0.1 * (angle - angle[0]), atol=1e-12)


def test_stribeck_adds_its_share_at_rest_and_none_at_speed(arm_constants):
    c = arm_constants(coulomb_nm=0.1, coulomb_rad_s=0.01, stribeck_share=0.4, stribeck_rad_s=0.2)
    held = np.zeros(model.HELD)
    held[model.COULOMB] = c[e.COULOMB]
    for velocity in (0.002, 0.1, 0.2, 3.0):
        level = 0.1 * (1.0 + 0.4 * math.exp(-((velocity / 0.2) ** 2))) * math.tanh(velocity / 0.01)
        for side in (1.0, -1.0):
            torque, _ = model.other_torques(c, held, 0.0, 0.0, 1.0, side * velocity, 0.0, 0.0)
            assert torque == pytest.approx(-side * level, rel=1e-12)


@pytest.mark.parametrize("steps", [7, 100, 3001])
def test_a_closed_loop_of_a_sliding_element_has_its_area_whatever_the_steps(steps):
    """Dahl's element: 4 (X - tanh X) at amplitude X in slip lengths; one that sticks until it slips: 4 (X - 1)."""
    for answer, area in ((memory.slipping, 4.0 * (3.0 - math.tanh(3.0))), (memory.sticking, 8.0)):
        z, work = 0.0, 0.0
        for way in (3.0, -6.0, 6.0, -6.0, 6.0):
            work = 0.0 if way < 0.0 else work  # the last turn there and back counts
            for _ in range(steps):
                was, z = z, answer(z, way / steps)
                work += way / steps * 0.5 * (was + z)
        assert z == pytest.approx(math.tanh(3.0) if answer is memory.slipping else 1.0, rel=1e-10)
        assert work == pytest.approx(area, abs=15.0 * (6.0 / steps) ** 2)  # the trapezoid's


def dahl_work(x):
    """Of an element that starts at rest, in slip lengths."""
    return x - 1.0 + math.exp(-x)


def four_elements_work(x):
    """The same of four elements of 1/4, 1/2, 1 and 2 slip lengths."""
    return np.mean([0.5 * x**2 / s if x < s else x - 0.5 * s for s in (0.25, 0.5, 1.0, 2.0)])


@pytest.mark.parametrize(("elements", "work"), [(0.0, dahl_work), (1.0, four_elements_work)])
def test_presliding_takes_the_work_of_its_elements(arm_open_loop, arm_constants, elements, work):
    c = arm_constants(**FREE, presliding_nm=0.1, presliding_deg=1.0, presliding_elements=elements)
    log, end = arm_open_loop(c, state(velocity=1.0), np.zeros((100, 2)), steps=4)
    slip = math.radians(1.0)
    assert end[3] > 3.0 * slip
    expected = [0.1 * slip * work(x) for x in log[1:, 7] / slip]
    np.testing.assert_allclose(0.5 * INERTIA * (1.0 - log[1:, 8] ** 2), expected, atol=2e-3 * expected[-1])


@pytest.mark.parametrize(("elements", "work"), [(0.0, dahl_work), (1.0, four_elements_work)])
def test_the_braids_take_the_work_of_their_elements(arm_open_loop, arm_constants, elements, work):
    moves = {"braid_force_n": 5.0, "braid_slip_mm": 0.5, "braid_elements": elements, "braid_pressure_share": 0.0}
    c = arm_constants(**FREE, **moves)
    log, _ = arm_open_loop(c, state(velocity=1.0), np.zeros((80, 2)), steps=4)
    start = lengths(c, 0.0)
    ways = [np.abs(lengths(c, angle) - start) for angle in log[1:, 7]]
    assert ways[-1].min() > 1.2e-3
    expected = [sum(5.0 * 0.5e-3 * work(way / 0.5e-3) for way in pair) for pair in ways]
    np.testing.assert_allclose(0.5 * INERTIA * (1.0 - log[1:, 8] ** 2), expected, atol=2e-3 * expected[-1])


def test_the_braid_s_level_goes_with_pressure_as_asked(arm_constants):
    c = arm_constants(braid_force_n=4.0, braid_pressure_share=0.75)
    assert memory.braid_level(c, 5e4) == pytest.approx(4.0)  # named at 0.5 bar
    assert memory.braid_level(c, 1e5) == pytest.approx(4.0 * 1.75)
    assert memory.braid_level(c, 0.0) == pytest.approx(4.0 * 0.25)


def test_friction_under_load_has_its_level_at_the_typical_pull(arm_constants):
    c, held = arm_constants(coulomb_nm=0.1, friction_load_share=1.0), np.zeros(model.HELD)
    for p_ab in (0.8, 1.6):
        x = rest(c, 0.0, p_ab, 1e5)
        memory.hold(c, x, at_rest(c, x), held, 1e-3, SHUT)
        pull = sum(model.muscle(c, p, h, 0.0, 1.0, TWO_L, 0.0)[0] for p, h in zip(x[1:3], lengths(c, 0.0), strict=True))
        assert held[model.COULOMB] == pytest.approx(0.1 * pull / memory.TYPICAL_PULL_N, rel=1e-9)


def test_a_hose_s_spring_swings_about_its_angle(arm_open_loop, arm_constants):
    c = arm_constants(**FREE, hose_stiffness_nm_rad=2.0, hose_angle_deg=8.0)
    log, _ = arm_open_loop(c, state(), np.zeros((1000, 2)), steps=4)
    turn = np.radians(8.0) * (1.0 - np.cos(math.sqrt(2.0 / INERTIA) * 1e-3 * np.arange(1000)))
    np.testing.assert_allclose(log[:, 7], turn, atol=1e-9)


def acceleration(c, angle):
    return model.derivatives(c, tuple(state(angle)[:5]), (False,) * 4)[3]


def test_a_hose_hardens_with_the_cube(arm_constants):
    c = arm_constants(**FREE, hose_stiffness_nm_rad=2.0, hose_angle_deg=5.0, hose_cubic_nm_rad3=30.0)
    turn = math.radians(20.0)
    expected = -(2.0 * turn + 30.0 * turn**3)
    assert acceleration(c, math.radians(25.0)) * INERTIA == pytest.approx(expected, rel=1e-12)


# ---- body ----


def test_payload_adds_inertia_and_weight(arm_constants):
    c = arm_constants(**LIMP, payload_kg=0.06)
    inertia, weight = INERTIA + 0.06 * 0.34**2, WEIGHT + 0.06 * 9.81 * 0.34
    for angle in (-0.5, 0.1, 0.7):
        assert acceleration(c, angle) == pytest.approx(weight * math.sin(angle) / inertia, rel=1e-12)


@pytest.mark.parametrize("flexible", [{}, {"flexible_share": 0.3}, {"flexible_share": 0.3, "flexible_gravity": 0.0}])
def test_tilt_turns_gravity_wherever_the_weight_is(arm_constants, flexible):
    c = arm_constants(**LIMP, base_tilt_deg=6.0, **flexible)
    for angle in (-0.5, 0.0, 0.7):
        expected = WEIGHT * math.sin(angle + math.radians(6.0)) / INERTIA
        assert acceleration(c, angle) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("turn", [-0.5, -0.0999, -1e-3, 0.0, 0.05, 0.0999, 0.1001])
def test_the_sine_beyond_a_coupling_is_the_sine(turn):
    for angle in (-0.7, 0.0, 0.4):
        assert model.turned(math.sin(angle), math.cos(angle), turn) == pytest.approx(math.sin(angle + turn), abs=4e-15)


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_a_flexible_coupling_swings_free_free_at_its_frequency(arm_open_loop, arm_constants, damping):
    share, f_hz, twist = 0.3, 15.0, 0.01
    c = arm_constants(**FREE, flexible_share=share, flexible_hz=f_hz, flexible_damping=damping)
    start = state()
    start[5] = twist
    log, end = arm_open_loop(c, start, np.zeros((500, 2)), steps=8)
    t, w = 1e-3 * np.arange(500), 2.0 * np.pi * f_hz
    pole = w * (-damping + 1j * math.sqrt(1.0 - damping**2))
    swing = (np.exp(pole * t) * (1.0 - 1j * (-pole.real / pole.imag))).real * twist  # from rest
    # the common centre stands still: the joint moves by the share of what the twist loses
    np.testing.assert_allclose(log[:, 7], share * (twist - swing), atol=1e-7 * twist)
    assert (1.0 - share) * end[3] + share * end[5] == pytest.approx(share * twist, rel=1e-9)


def test_a_stiffer_coupling_comes_nearer_to_the_rigid_arm(arm_open_loop, arm_constants):
    logs = []
    for moves in ({}, *({"flexible_share": 0.3, "flexible_hz": f, "flexible_damping": 0.3} for f in (15.0, 60.0))):
        c = arm_constants(**moves)
        start = rest(c, 10.0, 1.0, 1e5)
        start[[3, 5]] += 0.02
        logs.append(arm_open_loop(c, start, np.zeros((300, 2)), steps=4)[0][:, 7])
    soft, stiff = (np.abs(log - logs[0]).max() for log in logs[1:])
    assert stiff < 0.15 * soft
    assert soft > 1e-3


def test_the_flexible_arm_rests_where_the_rigid_one_does(arm_constants):
    rigid, flexible = (rest(arm_constants(flexible_share=s), 10.0, 1.0, 1e5) for s in (0.0, 0.3))
    np.testing.assert_allclose(flexible[:5], rigid[:5], rtol=1e-9)


# ---- muscle ----


def pulls(c, p, h, creep=0.0):
    """Pull in N of A and of B at the same pressure and length."""
    kinds = ((k.FACTOR_A, e.TWO_L_A), (k.FACTOR_B, e.TWO_L_B))
    return [model.muscle(c, p, h, 0.0, c[factor], c[two_l], creep)[0] for factor, two_l in kinds]


def test_stiffness_error_and_mismatch_are_shares_of_the_stiffness(arm_constants):
    p, h = 5e4, 0.19
    plain, _ = pulls(arm_constants(), p, h)
    np.testing.assert_allclose(pulls(arm_constants(stiffness_error=0.2), p, h), [1.2 * plain] * 2, rtol=1e-12)
    a, b = pulls(arm_constants(stiffness_mismatch=-0.2), p, h)
    assert (a - b) / plain == pytest.approx(-0.2, rel=1e-12)  # (k_A - k_B)/k
    assert a + b == pytest.approx(2.0 * plain, rel=1e-12)


def test_a_nominal_length_s_offset_is_the_way_to_the_same_pull(arm_constants):
    c = arm_constants(nominal_length_a_mm=5.0)
    for p in (3e4, 9e4):
        slack = model.nominal_length(c, TWO_L, p)
        assert pulls(c, p, slack + 5e-3)[0] == pytest.approx(0.0, abs=1e-9)
        assert pulls(c, p, slack)[1] == pytest.approx(0.0, abs=1e-9)


def kept(c, x, m, seconds, h=1e-3):
    """What is held after so long in x."""
    held = np.zeros(model.HELD)
    for _ in range(round(seconds / h)):
        memory.hold(c, x, m, held, h, SHUT)
        memory.move_on(c, x, m, held, h)
    memory.hold(c, x, m, held, h, SHUT)
    return held


@pytest.mark.parametrize("decades", [0.0, 1.0])
@pytest.mark.parametrize("slow", [0.0, 1.0])
def test_a_crept_muscle_keeps_one_minus_the_share_of_its_quick_stiffness(arm_constants, decades, slow):
    c = arm_constants(creep_share=0.3, creep_time_s=0.2, creep_decades=decades, creep_slow_nominal=slow)
    x, h_a = state(0.2), lengths(c, 0.2)[0]
    nominal = pulls(arm_constants(), x[1], h_a)[0]
    quick, relaxed = (pulls(c, x[1], h_a, kept(c, x, np.zeros(memory.SIZE), s)[model.CREEP_A])[0] for s in (0.0, 30.0))
    assert quick == pytest.approx((1.0 + 0.3 * slow) * nominal, rel=1e-12)
    assert relaxed == pytest.approx(quick - 0.3 * nominal, rel=1e-5)
    # one that has long rested has crept already
    assert pulls(c, x[1], h_a, kept(c, x, at_rest(c, x), 0.0)[model.CREEP_A])[0] == pytest.approx(relaxed, rel=1e-5)


def test_creep_goes_by_its_time_constants(arm_constants):
    x, seconds = state(0.2), 0.3
    stretch = lengths(arm_constants(), 0.2)[0] - model.nominal_length(arm_constants(), TWO_L, x[1])
    for decades, times in ((0.0, (0.2,)), (1.0, (0.02, 0.2, 2.0))):
        c = arm_constants(creep_share=0.3, creep_time_s=0.2, creep_decades=decades)
        crept = kept(c, x, np.zeros(memory.SIZE), seconds)[model.CREEP_A]
        expected = 0.3 * stretch * np.mean([1.0 - math.exp(-seconds / t) for t in times])
        assert crept == pytest.approx(expected, rel=1e-5)


# ---- lines ----


@pytest.mark.parametrize("laminar", [0.0, 1.0])
def test_a_leak_empties_a_shut_muscle(arm_open_loop, arm_constants, laminar):
    """dp/dt = -R T q/V with q = 0.59 pi/4 d^2 sqrt(2 rho p); laminar: through the same point at 0.5 bar."""
    c = arm_constants(**FREE, leak_a_mm=0.3, leak_laminar=laminar)
    log, _ = arm_open_loop(c, state(p_a=9e4), np.zeros((4000, 2)))

    def orifice(p):
        return 0.59 * math.pi / 4.0 * 0.3e-3**2 * math.sqrt(2.0 * (p + 2.0 * PATM) / (2.0 * RT) * p)

    def rate(_, p):
        named = 5e4 * (5e4 + 2.0 * PATM)
        q = orifice(5e4) * p[0] * (p[0] + 2.0 * PATM) / named if laminar else orifice(p[0])
        return [-RT * q / volumes(c, 0.0)[0]]

    t = 1e-3 * np.arange(4000)
    expected = solve_ivp(rate, (0.0, t[-1]), [9e4], t_eval=t, rtol=1e-10, atol=1e-6).y[0]
    assert expected[-1] < 6e4
    np.testing.assert_allclose(log[:, 9], expected, rtol=1e-7)
    assert np.ptp(log[:, 10]) == 0.0  # B is tight


def test_dead_volume_slows_filling_by_the_volumes(arm_constants):
    plain, dead = arm_constants(), arm_constants(dead_volume_a_ml=50.0, dead_volume_b_ml=40.0)
    for side, ml in ((0, 50.0), (1, 40.0)):
        valve = (side == 0, side == 1, False, False)
        quick, slow = (model.derivatives(c, tuple(state()[:5]), valve)[1 + side] for c in (plain, dead))
        v = volumes(plain, 0.0)[side]
        assert slow / quick == pytest.approx(v / (v + 1e-6 * ml), rel=1e-12)


def test_a_hose_s_lag_is_its_resistance_times_what_it_stores(arm_constants):
    """Hagen-Poiseuille: 128 mu l/(pi d^4) Pa s/m3 before pi/4 d^2 l of air at p: V/p m3/Pa."""
    c, d, length, p = arm_constants(hose_length_m=4.0), 2.5e-3, 4.0, 0.5e5
    bore = math.pi / 4.0 * d**2 * length
    lag, resistance = memory.line(c, p, 0.0)
    assert lag == pytest.approx(128.0 * 1.81e-5 * length / (math.pi * d**4) * bore / (p + PATM), rel=1e-9)
    assert c[e.DEAD_A] == pytest.approx(bore, rel=1e-12)
    assert memory.line(arm_constants(hose_lag_ms=12.0), p, 0.0)[0] == pytest.approx(0.012, rel=1e-12)
    # a loss with the flow comes on top: at 0.1 g/s its named share of the laminar one, at twice the flow twice that
    turbulent = arm_constants(hose_length_m=4.0, hose_turbulence=0.5)
    for flow, loss in ((1e-4, 1.5), (-2e-4, 2.0)):
        lag_there, resistance_there = memory.line(turbulent, p, flow * lag * loss)
        assert resistance_there == pytest.approx(loss * resistance, rel=1e-9)
        assert lag_there == pytest.approx(loss * lag, rel=1e-9)


LINES = [
    {"hose_length_m": 4.0},
    {"hose_length_m": 4.0, "hose_turbulence": 0.5},
    {"hose_length_m": 4.0, "hose_front": 1.0},
    {"hose_lag_ms": 12.0},
]


@pytest.mark.parametrize("moves", LINES)
@pytest.mark.parametrize("h", [1e-3, 2.7e-4])
def test_a_line_passes_on_all_air_late_by_its_lag(arm_constants, moves, h):
    """At a steady flow it holds back flow times lag, the mean delay of a first-order lag, and loses none."""
    c, x = arm_constants(**moves), state()
    m, held = at_rest(c, x), np.zeros(model.HELD)
    taken = given = 0.0
    for _ in range(1000):
        memory.hold(c, x, m, held, h, (1.0, 0.0, 0.0, 1.0))
        taken += h * held[model.DRAIN]
        given += h * held[model.LINE_A]
    assert taken - given == pytest.approx(m[memory.LINE_A], rel=1e-10)
    assert m[memory.LINE_A] / held[model.LINE_A] == pytest.approx(memory.line(c, x[1], m[memory.LINE_A])[0], rel=1e-3)
    assert held[model.LINE_A] == pytest.approx(held[model.DRAIN], rel=1e-5)
    assert m[memory.LINE_B] < 0.0  # drawn out of B


@pytest.mark.parametrize("moves", LINES)
def test_no_air_is_lost_on_the_way_through_lines(arm_open_loop, arm_constants, moves):
    c, start = arm_constants(**FREE, **moves), state()
    m = at_rest(c, start)
    log, end = arm_open_loop(c, start, commands(0.3, 0.2, 400), m=m)
    v_a, v_b = volumes(c, 0.0)
    sizes = c[k.V_C], v_a + c[e.DEAD_A], v_b + c[e.DEAD_B]
    stored = sum(v * (b - a) for v, a, b in zip(sizes, start, end, strict=False))
    stored += RT * (m[memory.LINE_A] + m[memory.LINE_B])
    p_c = np.append(log[:, 11], end[0])
    supplied = np.trapezoid([RT * model.flow(c, c[k.BETA_IN], c[k.P_IN], p) for p in p_c], dx=1e-3)
    assert supplied > 0.1  # J
    assert stored == pytest.approx(supplied, rel=2e-3)  # the trapezoid's error at pulse edges


# ---- supply ----


def test_choked_flow_is_the_nominal_one_at_small_drops(arm_constants):
    plain = arm_constants()
    for critical in (0.35, 0.6):
        c = arm_constants(critical_ratio=critical)
        for p in (2e4, 9e4):
            for drop in (10.0, -10.0):
                q = model.throttle(c, c[k.BETA_S], p, p - drop)
                assert q == pytest.approx(model.flow(plain, plain[k.BETA_S], p, p - drop), rel=2e-4)


def test_choked_flow_is_bounded_below_its_critical_ratio(arm_constants):
    """ISO 6358-1: C p1 once p2/p1 is below b, and the ellipse above it; conductance scales all of it."""
    c, double = (arm_constants(critical_ratio=0.6, choked_conductance=s) for s in (1.0, 2.0))
    high = 1e5 + PATM
    low = 0.6 * high - PATM
    bound = model.throttle(c, c[k.BETA_OUT], 1e5, low)
    assert bound == pytest.approx(c[k.BETA_OUT] * math.sqrt(1.0 - 0.6) * high, rel=1e-12)
    assert model.throttle(c, c[k.BETA_OUT], 1e5, low - 1e4) == bound
    for ratio in (0.65, 0.8, 0.95):
        p2 = ratio * high - PATM
        q = model.throttle(c, c[k.BETA_OUT], 1e5, p2)
        assert q / bound == pytest.approx(math.sqrt(1.0 - ((ratio - 0.6) / 0.4) ** 2), rel=1e-9)
        assert model.throttle(c, c[k.BETA_OUT], p2, 1e5) == -q
        assert model.throttle(double, c[k.BETA_OUT], 1e5, p2) == pytest.approx(2.0 * q, rel=1e-12)


def test_a_lower_supply_fills_the_capacity_that_far(arm_constants):
    c = arm_constants(supply_drop_bar=0.12)
    for p_c, sign in ((0.87e5, 1.0), (0.88e5, 0.0), (0.89e5, -1.0)):
        filling = model.derivatives(c, tuple(state(p_c=p_c)[:5]), (False,) * 4)[0]
        assert np.sign(round(filling, 6)) == sign


@pytest.mark.parametrize(("name", "place"), [("supply_droop_bar", model.DROP), ("splitter_droop_bar", model.SPLIT)])
def test_a_droop_is_its_drop_at_one_open_valve_s_flow(arm_constants, name, place):
    c, x, held = arm_constants(**{name: 0.2}, supply_droop_time_s=0.05), state(), np.zeros(model.HELD)
    m = at_rest(c, x)
    for seconds, share in ((0.05, 1.0 - math.exp(-1.0)), (0.95, 1.0)):
        for _ in range(round(seconds / 1e-4)):
            x[0] = 1e5 + held[model.SPLIT]  # the valve sees the supply's pressure, and A is at 0.5 bar
            memory.hold(c, x, m, held, 1e-4, (1.0, 0.0, 0.0, 0.0))
        assert held[place] == pytest.approx(0.2e5 * share, rel=1e-4)


# ---- valves ----

FINE = {"tick_s": 1e-4, "period_ticks": 200}
DELAYS = {"valve_opening_delay_ms": 3.0, "valve_closing_ratio": 1.5}


def folded(arm_open_loop, c, u):
    """|dp_A/dt| over the second of two periods, in Pa per 0.1 ms, over its largest."""
    log, _ = arm_open_loop(c, state(p_a=6e4), commands(u, 0.0, 401), **FINE)
    rate = np.abs(np.diff(log[200:, 9]))
    return rate / rate.max()


@pytest.mark.parametrize("u", [0.3, -0.3])
def test_a_pulse_opens_and_closes_late(arm_open_loop, arm_constants, u):
    rate = folded(arm_open_loop, arm_constants(**FREE, **DELAYS), u)
    assert np.flatnonzero(rate > 0.5).tolist() == list(range(30, 105))  # 3 ms, and 6 + 4.5 ms
    assert rate[:30].max() == rate[105:].max() == 0.0


def test_ramps_are_centred_on_the_edges_and_keep_the_pulse_s_area(arm_open_loop, arm_constants):
    sharp, slow = (arm_constants(**FREE, **DELAYS, valve_ramp_ms=ms) for ms in (0.0, 2.0))
    rate = folded(arm_open_loop, slow, 0.3)
    assert np.flatnonzero(rate).tolist() == list(range(20, 115))
    np.testing.assert_allclose(rate[20:40], (np.arange(20) + 0.5) / 20.0, rtol=0.02)
    np.testing.assert_allclose(rate[95:115], (19.5 - np.arange(20)) / 20.0, rtol=0.02, atol=5e-4)
    risen = [arm_open_loop(c, state(), commands(0.3, 0.0, 20))[1][1] - 5e4 for c in (sharp, slow)]
    assert risen[0] == pytest.approx(risen[1], rel=1e-4)


@pytest.mark.parametrize("u", [0.3, 0.97])
def test_late_pulses_are_the_same_pulses_shifted(arm_open_loop, arm_constants, u):
    """They reach into the next period where they must."""
    now, late = (
        arm_open_loop(arm_constants(**FREE, pulse_delay_ms=ms), state(), commands(u, -u, 2000), **FINE)[0]
        for ms in (0.0, 5.0)
    )
    assert np.ptp(now[:, 9]) > 5e3
    np.testing.assert_allclose(late[50:, 9:12], now[:-50, 9:12], rtol=1e-9)
    assert np.all(late[:50, 9] == 5e4)


def areas(c, sequence, period_s=0.02):
    """Open areas (periods, 40, 4) of a sequence of u_A, u_B."""
    schedule, edges, out = np.zeros(2 * valves.EACH), np.empty(16), []
    for u_a, u_b in sequence:
        n = valves.plan_period(c, schedule, edges, u_a, u_b, period_s, 0.01)
        assert np.all(np.diff(edges[:n]) >= 0.0)
        out.append([valves.areas(c, schedule, (j + 0.5) * period_s / 40) for j in range(40)])
    return np.array(out)


SLOW = ({}, DELAYS, {"pulse_delay_ms": 7.0}, {"valve_ramp_ms": 2.0}, DELAYS | {"valve_ramp_ms": 8.0})


@pytest.mark.parametrize("moves", SLOW)
def test_a_valve_that_stays_open_does_not_close_between_periods(arm_constants, moves):
    found = areas(arm_constants(**moves), [(1.0, -1.0)] * 3)
    np.testing.assert_array_equal(found[1:, :, 0], 1.0)  # fills A
    np.testing.assert_array_equal(found[1:, :, 3], 1.0)  # empties B
    np.testing.assert_array_equal(found[:, :, 1:3], 0.0)


def test_pulses_shorter_than_asked_are_lost(arm_constants):
    c = arm_constants(**DELAYS, valve_short_lost=1.0)  # 3 ms of 20
    found = areas(c, [(0.149, -0.149), (0.151, -0.151)])
    assert found[0].max() == 0.0
    assert found[1, :, 0].max() == found[1, :, 3].max() == 1.0


def test_a_front_in_a_line_holds_the_valve_s_flow_back_by_the_impedance(arm_constants):
    """c/A times what flows in more than out: into a line at rest, the valve sees that much more pressure."""
    c, x, held = arm_constants(hose_length_m=4.0, hose_front=1.0), state(), np.zeros(model.HELD)
    memory.hold(c, x, at_rest(c, x), held, 1e-9, (1.0, 0.0, 0.0, 0.0))
    q = held[model.DRAIN]
    back = 343.0 / (math.pi / 4.0 * 2.5e-3**2) * q
    assert back > 1e3
    assert q == pytest.approx(model.flow(c, c[k.BETA_S], 1e5, 5e4 + back), rel=1e-3)


def test_an_open_valve_closes_late_when_the_next_command_ends_it(arm_constants):
    found = areas(arm_constants(**DELAYS), [(1.0, 0.0), (0.0, 0.0), (0.0, 0.0)])[:, :, 0]
    assert found[1].tolist() == [1.0] * 9 + [0.0] * 31  # 4.5 ms
    assert found[2].max() == 0.0


# ---- controller and sensors ----


@pytest.mark.parametrize("delay_ms", [7.0, 26.0, 7.25])
def test_a_period_takes_the_command_of_so_long_ago(arm_open_loop, arm_constants, delay_ms):
    z = np.random.default_rng(3).uniform(-0.3, 0.3, (400, 2))
    at = np.maximum(np.arange(400) - delay_ms, 0.0)
    old = np.stack([np.interp(at, np.arange(400), z[:, j]) for j in (0, 1)], axis=1)
    start = rest(arm_constants(), 0.0, 1.0, 1e5)
    delayed, _ = arm_open_loop(arm_constants(loop_delay_ms=delay_ms), start, z)
    shifted, _ = arm_open_loop(arm_constants(), start, old)
    np.testing.assert_allclose(delayed[:, 7:], shifted[:, 7:], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(delayed[:, 3:5], z)  # logged is what the controller said


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_sensors_lag_by_their_milliseconds_at_low_frequency(arm_constants, order):
    c, last = arm_constants(angle_lag_ms=12.0, pressure_lag_ms=40.0, lag_order=order), 1999
    m = at_rest(c, state())
    for j in range(last + 1):  # ramps of 1e-4 rad, 1 Pa and -2 Pa a ms
        seen = memory.sensed(c, state(1e-4 * j, p_a=5e4 + j, p_b=5e4 - 2.0 * j), m, 1e-3)
    late = [last - seen[0] / 1e-4, last - (seen[1] - 5e4), last - (seen[2] - 5e4) / -2.0]
    np.testing.assert_allclose(late, [12.0, 40.0, 40.0], rtol=1e-9)


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_a_lag_s_corner_goes_by_its_poles(arm_constants, order):
    """A step's answer after the named time: 1 - 1/e of one pole, 1 - 3/e^2 of two of half the delay each."""
    c = arm_constants(angle_lag_ms=20.0, lag_order=order)
    m = at_rest(c, state())
    for _ in range(2000):
        angle, _, _ = memory.sensed(c, state(1.0), m, 1e-5)
    assert angle == pytest.approx(1.0 - (math.exp(-1.0) if order == 1.0 else 3.0 * math.exp(-2.0)), rel=2e-3)


UP, DOWN = np.linspace(0.1, 0.2, 301), np.linspace(0.2, 0.1, 301)
THERE_AND_BACK = np.concatenate([UP, DOWN[1:], UP[1:]])


def played(c, angles):
    m = at_rest(c, state(angles[0]))
    return np.array([memory.sensed(c, state(a), m, 1e-3)[0] for a in angles])


def test_play_loses_its_width_at_each_turn(arm_constants):
    c, play = arm_constants(backlash_deg=0.5), math.radians(0.5)
    seen = played(c, THERE_AND_BACK)
    assert seen[0] == THERE_AND_BACK[0]  # of a start nothing is known: it stands in the middle
    assert np.abs(seen - THERE_AND_BACK).max() == pytest.approx(0.5 * play, rel=1e-9)
    for turn in (300, 600):
        still = np.flatnonzero(np.abs(np.diff(seen[turn:])) > 1e-12)[0] * (0.1 / 300.0)
        assert still == pytest.approx(play, abs=0.1 / 300.0)
    assert np.ptp(seen[300:]) == pytest.approx(0.1 - play, rel=1e-9)


def test_soft_play_loses_the_same_at_large_turns_and_never_goes_the_other_way(arm_constants):
    c, play = arm_constants(backlash_deg=0.5, backlash_soft=1.0), math.radians(0.5)
    seen = played(c, THERE_AND_BACK)
    assert np.ptp(seen[300:]) == pytest.approx(0.1 - play, rel=1e-5)
    assert np.all(np.diff(seen[300:601]) < 0.0)
    assert np.all(np.diff(seen[600:]) > 0.0)


# ---- all together ----


def test_halving_the_step_leaves_an_arm_with_all_effects_nearly_as_it_is(arm, arm_experiment, quiet, all_effects):
    references = np.repeat(np.array([[5.0, 1.0], [10.0, 1.1], [0.0, 0.9]]), 1000, axis=0) * [math.pi / 180.0, 1.0]
    one = arm_experiment((5.0, 1.0), 3000, references=references)
    runs = [arm.simulate([one], changes=quiet | all_effects, states=True, steps_per_tick=n)[0] for n in (1, 2, 4, 8)]
    angles = np.degrees([r.column("true_theta2_rad") for r in runs])
    pressures = np.array([r.column("true_p_a_bar") for r in runs])
    assert np.ptp(angles[0]) > 5.0
    errors = [np.abs(a - angles[-1]).max() for a in angles[:-1]]
    # measured 9e-4, 4e-4 and 2e-4 deg, 1e-5 bar; the sensors' noise is 0.02 deg and 1e-3 bar
    assert errors[0] < 5e-3
    assert errors[2] < 0.5 * errors[1] < 0.5 * errors[0]
    assert np.abs(pressures[0] - pressures[-1]).max() < 1e-4
