"""Gas, energy and statics of the 2-DoF arm, by positions and volumes that the kernel does not know."""

import math

import numpy as np
import pytest
from arm2_cases import MIDDLE, numbers, open_loop
from hypothesis import given, settings
from hypothesis import strategies as st

from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics.equilibrium2 import pressures2, rest2
from loopshape.toolbox.arm.dynamics.model import flow
from loopshape.toolbox.arm.dynamics.model2 import derivatives2, standing_torques, supply_flows2
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS

C = numbers()
NOMINAL = dict(zip(ARM2_PARAMETERS.names, ARM2_PARAMETERS.vector().tolist(), strict=True))
MM = {name[:-3]: 1e-3 * value for name, value in NOMINAL.items() if name.endswith("_mm")}
PRESSURES = st.floats(1.5e4, 1.2e5)
FIVE = st.tuples(*[PRESSURES] * 5)
EIGHT = st.tuples(*[st.booleans()] * 8)
LOOSE = dict.fromkeys(
    ("stiffness_k0", "stiffness_k1", "stiffness_k2", "damping_ns_m", "damping_per_bar_ns_m"), 0.0
)  # muscles that neither pull nor damp


def lengths(q):
    """Lengths of A, B, C, D with their fittings taken off, by the vectors of appendix F, in m."""
    out = []
    for arm, y in (("l2a", -MM["l1a"]), ("l2b", MM["l1b"])):
        r = MM["l12"] - MM[arm]
        x = MM["l11x"] - MM["lab"] - r * math.sin(q[1])
        out.append(math.hypot(x, MM["l11y"] + y + r * math.cos(q[1])) - MM["fitting"])
    for foot, arm in ((-MM["l0c"], "l1c"), (MM["l0d"], "l1d")):
        r = MM["l01x"] - MM[arm]
        out.append(math.hypot(foot + r * math.cos(q[0]), MM["l0"] + r * math.sin(q[0])) - MM["fitting_cd"])
    return out


def volume(h):
    """(3.37-3.39): V = pi h/60 (3 d1^2 + 4 d1 d2 + 8 d2^2)."""
    d2 = math.sqrt(4.0 * MM["braid_length"] ** 2 - h**2) / (NOMINAL["braid_turns"] * math.pi)
    return math.pi * h / 60.0 * (3.0 * MM["end_diameter"] ** 2 + 4.0 * MM["end_diameter"] * d2 + 8.0 * d2**2)


def centres(q):
    """Positions (3,) of the masses as x + i y: the valves' box, body 1, body 2."""
    first = np.array([complex(MM["lsvx"], MM["lsvy"]), complex(MM["l01x"], MM["l01y"]), complex(MM["l1x"], MM["l1y"])])
    return first * np.exp(1j * q[0]) + np.array([0.0, 0.0, 1j * MM["l12"]]) * np.exp(1j * (q[0] + q[1]))


MASSES = np.array([NOMINAL["msv_kg"], NOMINAL["m1_kg"], NOMINAL["m2_kg"]])


def potential(q):
    """Gravity and the spring, J."""
    e = MM["l01x"] - MM["l1s"]
    spring = math.hypot(MM["l0s"] + e * math.cos(q[0]), MM["l0"] + e * math.sin(q[0])) - MM["spring_length"]
    return NOMINAL["gravity_m_s2"] * MASSES @ centres(q).imag + 0.5 * NOMINAL["spring_n_m"] * spring**2


def kinetic(q, w):
    """Kinetic energy from the centres' velocities, J."""
    second = np.array([0.0, 0.0, 1j * MM["l12"]]) * np.exp(1j * (q[0] + q[1]))
    v = 1j * (w[0] * (centres(q) - second) + (w[0] + w[1]) * second)
    turning = NOMINAL["jzz1_kgm2"] * w[0] ** 2 + NOMINAL["jzz2_kgm2"] * (w[0] + w[1]) ** 2
    return 0.5 * (MASSES @ np.abs(v) ** 2 + turning)


@settings(max_examples=200)
@given(p=FIVE, q=st.tuples(st.floats(-0.43, 0.43), st.floats(-0.75, 0.75)), valves=EIGHT)
def test_gas_is_neither_made_nor_lost(p, q, valves):
    """At rest the five volumes' contents change by what enters from the supply and leaves to the room."""
    rates = derivatives2(C, np.array([*p, *q, 0.0, 0.0]), valves)
    volumes = [C[k.V_C], *(volume(h) for h in lengths(q))]
    q_in = flow(C, C[k.BETA_IN], C[k.P_IN], p[0])
    q_out = sum(o * flow(C, C[k.BETA_OUT], one, 0.0) for o, one in zip(valves[4:], p[1:], strict=True))
    stored = sum(v * d for v, d in zip(volumes, rates[:5], strict=True))
    assert stored == pytest.approx(C[k.RT] * (q_in - q_out), rel=1e-9, abs=1e-9 * C[k.RT] * 1e-3)


@settings(max_examples=200)
@given(p=FIVE, valves=st.tuples(*[st.booleans()] * 4))
def test_the_splitter_below_the_supply_is_d_11_to_d_23(p, valves):
    """Where all muscles lie below p_c: p_s = min over the open ones, shares by the differences."""
    p_c, muscles = max(p) + 1.0, p[1:]
    ours = supply_flows2(C, p_c, muscles, tuple(float(v) for v in valves))
    if not any(valves):
        assert ours == (0.0,) * 4
        return
    q_s = flow(C, C[k.BETA_S], p_c, min(m for m, v in zip(muscles, valves, strict=True) if v))
    drops = np.array([v * (p_c - m) for m, v in zip(muscles, valves, strict=True)])
    np.testing.assert_allclose(ours, drops / drops.sum() * q_s, rtol=1e-9)
    assert sum(ours) == pytest.approx(q_s, rel=1e-9)


@settings(max_examples=200)
@given(p=PRESSURES, gaps=st.tuples(*[st.one_of(st.just(0.0), st.floats(-1e4, 1e4))] * 4))
def test_the_splitter_s_zero_denominator_is_guarded(p, gaps):
    """Muscles at, above and below p_c, where the printed shares divide by nothing or by less than nothing."""
    ours = supply_flows2(C, p, tuple(p + g for g in gaps), (1.0,) * 4)
    bound = 1.000001 * flow(C, C[k.BETA_S], p + max(abs(g) for g in gaps) + 1e-9, p)
    for q, gap in zip(ours, gaps, strict=True):
        assert math.isfinite(q)
        assert abs(q) <= bound
        assert q * gap <= 0.0  # out of a muscle above p_c, into one below
    if not any(gaps):
        assert ours == (0.0,) * 4


@settings(max_examples=50)
@given(p=FIVE, q=st.tuples(st.floats(-0.43, 0.43), st.floats(-0.75, 0.75)))
def test_an_open_out_valve_overrules_the_in_valve(p, q):
    x = np.array([*p, *q, 1.0, -2.0])
    assert derivatives2(C, x, (True,) * 8) == derivatives2(C, x, (False,) * 4 + (True,) * 4)


@settings(max_examples=100)
@given(q=st.tuples(st.floats(-0.43, 0.43), st.floats(-0.75, 0.75)))
def test_torques_are_the_slopes_of_the_potential(q):
    """Muscles off: gravity and the spring alone, with its free length of 339.43492 mm."""
    x = np.array([0.0, 4e4, 4e4, 4e4, 4e4, *q, 0.0, 0.0])
    step = 1e-5 * np.eye(2)
    slopes = [(potential(np.array(q) + s) - potential(np.array(q) - s)) / 2e-5 for s in step]
    np.testing.assert_allclose(standing_torques(numbers(**LOOSE), x), np.negative(slopes), rtol=0.0, atol=1e-7)


def swing(steps):
    """Energy (rows,) of both joints thrown by hand, muscles and damping off, for 3 s at ticks of 4 ms / `steps`."""
    start = np.array([1e5, 4e4, 4e4, 4e4, 4e4, 0.2, 0.5, 1.0, -2.0])
    log, last = open_loop(numbers(**LOOSE), start, np.zeros((750, 4)), steps=steps, tick_s=4e-3, period_ticks=5)
    rows = np.vstack([log[::10, 14:], last])
    energy = np.array([potential(r[5:7]) + kinetic(r[5:7], r[7:9]) for r in rows])
    moving = np.array([kinetic(r[5:7], r[7:9]) for r in rows])
    return energy, moving, rows[:, 5:7]


def test_energy_of_two_loose_joints_is_constant_and_its_drift_falls_with_order_4():
    """Both joints swing with gravity and spring, the upper body right round, and exchange their energy."""
    drifts = []
    for steps in (2, 4, 8, 16):
        energy, moving, angles = swing(steps)
        assert np.ptp(angles[:, 0]) > 0.3
        assert np.ptp(angles[:, 1]) > 2.0
        drifts.append(np.abs(energy - energy[0]).max() / np.ptp(moving))
    assert drifts[-1] < 1e-11  # of the energy exchanged, at a quarter of a ms; measured 2e-12, and 1.3e-7 at 4 ms
    orders = np.log2(np.array(drifts[:-1]) / drifts[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.1)


@pytest.mark.parametrize(
    ("gas", "p_0", "n"),
    [({}, 0.0, 1.0), ({"gas_absolute_share": 1.0, "polytropic_exponent": 1.4}, 101325.0, 1.4)],
)
def test_shut_muscles_keep_their_gas(gas, p_0, n):
    """(p + p0) V^n stays what it was, in all four: gauge pressure as printed (p0 = 0), or Poisson's law."""
    c = numbers(**gas)
    start = rest2(c, *MIDDLE, 1e5)
    start[5:7] += np.radians([3.0, 5.0])
    log, _ = open_loop(c, start, np.zeros((1000, 4)), steps=4)
    assert np.ptp(np.degrees(log[:, 19:21]), axis=0).min() > 3.0
    for place in range(4):
        content = [(r[15 + place] + p_0) * volume(lengths(r[19:21])[place]) ** n for r in log[::25]]
        np.testing.assert_allclose(content, content[0], rtol=1e-9)


@pytest.mark.parametrize("point", [MIDDLE, (5.0, 10.0, 0.45, 0.4), (-8.0, -5.0, 0.4, 0.6)])
def test_an_equilibrium_balances_and_stays(point):
    c = numbers()
    x = rest2(c, *point, 1e5)
    np.testing.assert_allclose(standing_torques(c, x), 0.0, atol=1e-9)
    np.testing.assert_allclose(derivatives2(c, x, (False,) * 8), 0.0, atol=1e-7)
    _, last = open_loop(c, x, np.zeros((1000, 4)))
    np.testing.assert_allclose(last, x, rtol=1e-9, atol=1e-9)
    assert pressures2(c, *point)[::2] == point[2:]  # p_A and p_C are those asked for


def test_damping_takes_energy_away():
    start = rest2(C, *MIDDLE, 1e5)
    start[5:7] += np.radians([2.0, 5.0])
    log, _ = open_loop(C, start, np.zeros((8000, 4)))
    first, last = np.ptp(log[:2000, 19:21], axis=0), np.ptp(log[6000:, 19:21], axis=0)
    assert np.all(last < 0.5 * first)
