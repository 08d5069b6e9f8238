"""The valves' pulses and the sawtooth rule of (3.13-3.15): one meaning, three ways to compute it."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.dynamics.equilibrium import rest

COMMANDS = st.one_of(
    st.floats(-2.5, 2.5), st.sampled_from([0.0, 0.01, -0.01, 0.99, -0.99, 1.0, -1.0, 0.010001, 0.990001, 6.0])
)
DEAD_ZONES = st.sampled_from([0.0, 0.003, 0.01, 0.1])
SAWTOOTH = np.arange(4000) / 4000


def definition(u, dead_zone, s=SAWTOOTH):
    """In and out valve over the sawtooth: v = clip(s, tau, 1 - tau); in = u > v, out = -u > v."""
    v = np.clip(s, dead_zone, 1.0 - dead_zone)
    return u > v, -u > v


@settings(max_examples=300)
@given(u=COMMANDS, dead_zone=DEAD_ZONES)
def test_pulse_length_is_the_time_above_the_sawtooth(u, dead_zone):
    opened, vented = definition(u, dead_zone)
    length = pwm.pulse_s(u, 0.02, dead_zone) / 0.02
    assert abs(length - np.mean(opened | vented)) <= 1.0 / SAWTOOTH.size
    assert opened.any() == (u > dead_zone)
    assert vented.any() == (-u > dead_zone)
    # one pulse, from the period's start
    on = opened | vented
    assert not on.any() or on[: np.count_nonzero(on)].all()


@settings(max_examples=300)
@given(u=COMMANDS, dead_zone=DEAD_ZONES)
def test_valve_looked_up_at_a_phase_is_the_definition(u, dead_zone):
    opened, vented = definition(u, dead_zone)
    found = np.array([pwm.is_open(u, s, dead_zone) for s in SAWTOOTH[::40]])
    np.testing.assert_array_equal(found, (opened | vented)[::40])


def test_dead_zone_and_saturation_are_where_they_say():
    period_s = 0.02
    assert pwm.pulse_s(0.01, period_s, 0.01) == 0.0
    assert pwm.pulse_s(np.nextafter(0.01, 1.0), period_s, 0.01) > 0.0
    assert pwm.pulse_s(-0.99, period_s, 0.01) < period_s
    assert pwm.pulse_s(-np.nextafter(0.99, 1.0), period_s, 0.01) == period_s
    assert pwm.pulse_s(5.0, period_s, 0.01) == period_s


def definition_run(arm_open_loop, c, start, z, dead_zone):
    """States at each ms by the definition evaluated on a grid of 1/100 ms: valves constant in between."""
    fine = 100
    periods = np.repeat(z[::20], 20 * fine, axis=0)  # u at each period's start, held
    k = np.arange(len(periods)) % (20 * fine)
    s = (k + 0.5) / (20 * fine)
    commands = np.column_stack([periods[:, 0] + periods[:, 1], periods[:, 1] - periods[:, 0]])
    valves = [definition(u, dead_zone, s) for u in commands.T]
    open_whole = [2.0 * (opened.astype(float) - vented) for opened, vented in valves]  # saturated: no edge inside
    as_z = np.column_stack([0.5 * (open_whole[0] - open_whole[1]), 0.5 * (open_whole[0] + open_whole[1])])
    log, _ = arm_open_loop(c, start, as_z, tick_s=1e-5, period_ticks=1, dead_zone=dead_zone)
    return log[::fine]


def test_simulated_arm_obeys_the_definition_on_a_fine_grid(arm_open_loop, arm_constants):
    c = arm_constants()
    start = rest(c, 5.0, 1.0, 1e5)
    rng = np.random.default_rng(5)
    z = np.repeat(np.round(rng.uniform(-0.7, 0.7, (15, 2)), 2), 20, axis=0)  # edges on the fine grid
    z[100:120] = [0.004, 0.004]  # within the dead zone (u_A = 0.008, u_B = 0)
    z[140:160] = [1.2, 0.0]  # saturated
    ours, _ = arm_open_loop(c, start, z)
    theirs = definition_run(arm_open_loop, c, start, z, 0.01)
    assert np.ptp(np.degrees(ours[:, 7])) > 2.0
    # a pulse missed by one fine step moves a muscle by 1e-5 s of 1 bar/s
    np.testing.assert_allclose(ours[:, 9:12], theirs[:, 9:12], atol=0.05)  # Pa
    np.testing.assert_allclose(ours[:, 7], theirs[:, 7], atol=1e-7)


def test_row_at_a_period_s_start_decides_its_pulse_and_no_other_row_does(arm, arm_experiment, quiet):
    rng = np.random.default_rng(2)
    z = rng.uniform(-0.3, 0.3, (200, 2))
    other = rng.uniform(-0.3, 0.3, (200, 2))
    other[::20] = z[::20]
    late = z.copy()
    late[120] += 0.05
    runs = [
        arm.simulate([arm_experiment((0.0, 1.0), 200, injection="control", injected=i)], changes=quiet, states=True)[
            0
        ].column("true_p_a_bar")
        for i in (z, other, late)
    ]
    np.testing.assert_array_equal(runs[0], runs[1])
    np.testing.assert_array_equal(runs[0][:121], runs[2][:121])
    assert np.all(runs[0][130:] != runs[2][130:])


def test_logged_command_explains_the_pressures_of_the_period_that_starts_there(arm, arm_experiment, quiet):
    """In closed loop: where u_A(k) > 0 muscle A fills from row k on for |u| periods, and is shut after that."""
    e = arm_experiment((0.0, 1.0), 2000, setpoint=(8.0, 1.2))
    (r,) = arm.simulate([e], changes=quiet, states=True)
    checked = 0
    for u, p in ((r.column("u_a_v"), r.column("true_p_a_bar")), (r.column("u_b_v"), r.column("true_p_b_bar"))):
        pull = np.gradient(r.column("true_theta2_rad"))
        for k in range(0, 1980, 20):
            size = abs(u[k])
            if 0.1 < size < 0.8 and np.abs(pull[k : k + 20]).max() < 5e-4:  # slow: the gas law moves little
                rate = np.diff(p[k : k + 21])  # bar/ms
                whole = int(20 * size)
                assert np.all(np.sign(u[k]) * rate[:whole] > 4e-4)  # 0.5 bar/s at least
                assert np.all(np.abs(rate[whole + 1 :]) < 2e-4)
                checked += 1
    assert checked >= 5


def test_pulses_follow_the_pwm_s_own_frequency(arm_open_loop, arm_constants):
    c = arm_constants()
    start = rest(c, 0.0, 1.0, 1e5)
    z = np.zeros((40, 2))
    z[10] = [0.25, 0.25]  # u_A = 0.5 at a period's start for 10 ticks, not for 20
    at_50_hz, at_100_hz = (arm_open_loop(c, start, z, period_ticks=n)[0][:, 9] for n in (20, 10))
    assert np.ptp(at_50_hz) < 1e-6
    rate = np.diff(at_100_hz)
    assert np.all(np.abs(rate[10:15] - 92.0) < 3.0)  # 5 ms at 0.92 bar/s, in Pa per ms
    assert np.all(np.abs(rate[16:]) < 5.0)
