"""What the target in C does by itself when a limit is passed, the host is silent, or a row is missing."""

import numpy as np
import pytest
from target_cases import GAIN, INFINITE, LIMITS, Bench

from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.messages import Reason, Request, Response, State

STILL = (0.0, 0.5, 0.5)


@pytest.fixture
def bench():
    b = Bench()
    yield b
    b.close()


def limits(index, low, high, rate=INFINITE):
    out = LIMITS.copy()
    out[index] = low, high, rate
    return out


def running(bench, n=0.01, ticks=64, **changes):
    """A recording at (0 rad, 1 bar) with n of theta constant, that has begun; 10 ticks done of it."""
    bench.arm(STILL, **{"watchdog_ms": 60000, **changes})
    bench.to_setpoint(0.0, 1.0)
    bench.record(np.full((ticks, 1), n), 2)
    while bench.status().tick < 10:
        bench.tick(1)
    return 10


@pytest.mark.parametrize("value", [0.31, -0.31, float("nan"), float("inf")])
@pytest.mark.parametrize("hold", [False, True])
def test_a_sensor_beyond_its_limit_ends_the_recording_at_that_tick(bench, value, hold):
    done = running(bench, limits=limits(0, -0.3, 0.3), hold=hold)
    given = len(bench.said)
    bench.tick(1, (value, 0.5, 0.5))
    bench.tick(30)
    ended, samples = bench.ended(), bench.samples()
    assert (ended.reason, ended.index, ended.tick, ended.ticks) == (Reason.LIMIT, 0, done, done + 1)
    np.testing.assert_equal(ended.value, value)
    assert ended.limit == (-0.3 if value < 0.0 else 0.3)
    assert ended.sentence == "theta2_rad passed its limit"
    assert len(samples) == done + 1
    np.testing.assert_array_equal(samples[:, 2], [*[0.01] * done, 0.0])  # the excitation stops at this tick
    np.testing.assert_equal(samples[-1, 6], value)
    status = bench.status()
    assert (status.state, status.fault) == (State.FAULT, Reason.LIMIT)
    held = hold and abs(value) < 0.36  # a tenth of the span further it vents too
    assert ("safe" in bench.said[given:]) == (not held)
    assert any(line.startswith("g ") for line in bench.said[given:]) == held


def test_hold_keeps_the_loops_closed_where_the_machine_was(bench):
    running(bench, limits=limits(0, -0.3, 0.3), hold=True)
    bench.tick(20, (0.31, 0.5, 0.5))
    bench.tick(20)
    assert bench.said[-1] == "g 0 0"
    bench.tick(20, (0.2, 0.5, 0.5))  # e = 0.31 - 0.2: pulses of 0.11 of 20 ms
    pulses = [float(v) for v in bench.said[-1].split()[1:]]
    np.testing.assert_allclose(pulses, [0.11 * 0.02, -0.11 * 0.02], rtol=1e-12)
    bench.tick(1, (0.37, 0.5, 0.5))  # beyond 0.3 by more than a tenth of 0.6
    assert bench.said[-1] == "safe"
    bench.tick(40)
    assert bench.said[-1] == "safe"
    assert bench.status().state == State.FAULT


def test_what_is_far_outside_is_not_held_for_a_single_tick(bench):
    running(bench, limits=limits(0, -0.3, 0.3), hold=True)
    bench.tick(10)  # the next tick begins a PWM period
    given = len(bench.said)
    bench.tick(1, (float("inf"), 0.5, 0.5))
    assert bench.said[given:] == ["safe"]


def test_a_rate_counts_over_ten_ticks(bench):
    done = running(bench, limits=limits(1, -0.1, 2.0, 2.0))
    bench.tick(1, (0.0, 0.519, 0.5))  # a step of 19 mbar: 1.9 bar/s over 10 ms
    bench.tick(9)
    assert bench.status().state == State.RUNNING
    bench.tick(1, (0.0, 0.540, 0.5))  # 21 mbar
    bench.tick(20)
    ended = bench.ended()
    assert (ended.reason, ended.index, ended.tick) == (Reason.RATE_LIMIT, 1, done + 10)
    np.testing.assert_allclose([ended.value, ended.limit], [2.1, 2.0], rtol=1e-9)
    assert ended.sentence == "p_a_bar changed faster than its limit"
    assert len(bench.samples()) == ended.ticks == done + 11


def test_a_slow_ramp_passes_its_rate_only_when_it_is_too_fast(bench):
    running(bench, limits=limits(1, -0.1, 2.0, 2.0))
    value = 0.5
    for _ in range(20):
        value += 0.0019
        bench.tick(1, (0.0, value, 0.5))
    assert bench.status().state == State.RUNNING
    for k in range(10):
        value += 0.0022
        bench.tick(1, (0.0, value, 0.5))
        slope = ((k + 1) * 0.0022 + (9 - k) * 0.0019) * 100.0
        assert (bench.status().state == State.FAULT) == (slope > 2.0), k
        if slope > 2.0:
            break


@pytest.mark.parametrize("hold", [False, True])
def test_a_command_beyond_its_limit_is_found_and_not_given(bench, hold):
    bench.arm(STILL, watchdog_ms=60000, limits=limits(3, -0.5, 0.5), hold=hold)
    bench.to_setpoint(0.0, 1.0)
    n = np.zeros((50, 1))
    n[20] = 0.505  # at a period's start; the limits' span is 1
    bench.record(n, 2)
    bench.tick(60)
    ended, samples = bench.ended(), bench.samples()
    assert (ended.reason, ended.index, ended.tick, ended.ticks) == (Reason.LIMIT, 3, 20, 21)
    assert (ended.value, ended.limit) == (0.505, 0.5)
    assert samples[-1, 9] == 0.505
    largest = max(float(line.split()[1]) for line in bench.said if line.startswith("g "))
    assert largest == (0.5 * 0.02 if hold else 0.0)
    assert bench.status().state == State.FAULT


def test_a_commands_rate_is_limited_too(bench):
    bench.arm(STILL, watchdog_ms=60000, limits=limits(4, -5.0, 5.0, 10.0))
    bench.to_setpoint(0.0, 1.0)
    n = np.zeros((50, 1))
    n[30:] = 0.11
    bench.record(n, 2)
    bench.tick(70)
    ended = bench.ended()
    assert (ended.reason, ended.index, ended.tick) == (Reason.RATE_LIMIT, 4, 30)
    np.testing.assert_allclose(ended.value, 11.0)


def test_a_fault_outside_a_recording_is_told_as_run_0(bench):
    bench.arm(STILL, watchdog_ms=60000, limits=limits(2, 0.0, 1.0))
    bench.tick(5, (0.0, 0.5, 1.1))
    ended = bench.ended()
    assert (ended.run, ended.ticks, ended.reason, ended.index, ended.value) == (0, 0, Reason.LIMIT, 2, 1.1)
    assert bench.no(Request.BEGIN, bytes(20)) == 1
    bench.ok(Request.CLEAR)
    assert bench.status().state == State.IDLE


def test_silence_ends_in_the_safe_state_and_samples_are_kept(bench):
    done = running(bench, watchdog_ms=50, n=0.0)
    bench.tick(60)
    ended = bench.ended()
    assert (ended.reason, ended.index, ended.limit) == (Reason.WATCHDOG, None, 50.0)
    assert ended.ticks == done + 50
    assert bench.said[-1] == "safe"
    assert bench.status().fault == Reason.WATCHDOG
    assert len(bench.samples()) == ended.ticks


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("fast", [False, True])
def test_an_armed_target_watches_its_host_by_ticks_or_by_the_clock(hold, fast):
    bench = Bench(fast=fast)
    bench.arm(STILL, watchdog_ms=50, hold=hold)
    for _ in range(10):
        bench.tick(40)
        assert bench.status().state == State.ARMED
    bench.poll()
    bench.tick(49)
    bench.send(b"\x03garbage\0" + Frame(Response.SAMPLES, 1, bytes(97)).encoded)  # its own, by an echo
    answers = len(bench.taken())
    bench.tick(10)
    assert answers == 0
    status = bench.status()
    assert (status.state, status.fault) == (State.FAULT, Reason.WATCHDOG)
    assert "safe" in bench.said[1:]  # loops stay closed only while a host is there, whatever on_limit says
    bench.close()


@pytest.mark.parametrize("fast", [False, True])
def test_a_host_that_vanishes_while_a_fault_holds_leaves_no_closed_loops(fast):
    bench = Bench(fast=fast)
    bench.arm(STILL, watchdog_ms=50, hold=True, limits=limits(0, -0.3, 0.3))
    bench.poll()
    bench.tick(1, (0.31, 0.5, 0.5))
    for _ in range(10):  # the host is there: it holds
        bench.tick(40)
        assert bench.status().state == State.FAULT
    assert "safe" not in bench.said[1:]
    bench.poll()
    bench.tick(60)
    assert bench.said[-1] == "safe"
    given = len(bench.said)
    bench.tick(60, (0.2, 0.5, 0.5))
    assert bench.said[given:] == []
    assert (bench.status().state, bench.status().fault) == (State.FAULT, Reason.LIMIT)
    bench.close()


def test_the_clock_tells_a_silent_host_where_ticks_come_late(bench):
    bench.arm(STILL, watchdog_ms=50)
    bench.poll()
    bench.lines("t 5", f"p {bench.now_ms + 60}")
    assert bench.said[-1] == "safe"


def test_the_watchdog_acts_even_where_the_main_loop_hangs(bench):
    bench.arm(STILL, watchdog_ms=50)
    bench.lines("t 60")  # ticks without a poll
    assert bench.said[-1] == "safe"


def test_a_missing_row_ends_the_recording_and_nothing_else(bench):
    bench.arm(STILL, watchdog_ms=60000)
    bench.to_setpoint(0.0, 1.0)
    bench.record(np.full((100, 1), 0.1), 2)  # 64 of them come
    bench.tick(120)
    ended = bench.ended()
    assert (ended.reason, ended.ticks, ended.tick) == (Reason.UNDERRUN, 64, 64)
    assert bench.status().state == State.ARMED
    assert bench.said[-1] == "g 0 0"  # n is zero, r at the setpoint


def test_as_fast_as_it_can_it_waits_for_rows():
    bench = Bench(fast=True)
    bench.arm(STILL, watchdog_ms=60000)
    bench.record(np.full((10, 1), 0.0), 2)
    bench.tick(5)
    assert bench.status().state == State.RUNNING
    bench.close()


def test_references_of_rows_are_absolute_and_the_others_stay(bench):
    bench.arm(STILL, watchdog_ms=60000)
    bench.to_setpoint(0.05, 1.1)
    table = np.column_stack([np.linspace(0.05, 0.2, 30), np.linspace(0.0, 0.1, 30)])
    bench.record(table, 0b1001)  # the reference of loop 0, n of loop 1
    bench.tick(60)
    samples = bench.samples()
    np.testing.assert_array_equal(samples[:, 0], table[:, 0])
    np.testing.assert_array_equal(samples[:, 1], 1.1)
    np.testing.assert_array_equal(samples[:, 2], 0.0)
    np.testing.assert_array_equal(samples[:, 3], table[:, 1])
    bench.tick(20)
    pulses = [float(v) for v in bench.said[-1].split()[1:]]
    np.testing.assert_allclose(pulses, [(0.05 + 0.1) * 0.02, (0.1 - 0.05) * 0.02], rtol=1e-9)  # back at the setpoint


@pytest.mark.parametrize("injection", [0, 1, 2])
def test_what_is_injected_enters_where_it_is_drawn(bench, injection):
    two = 2.0 * GAIN
    bench.arm(STILL, watchdog_ms=60000, sections=(two, two))
    bench.to_setpoint(0.0, 1.0)
    n = np.random.default_rng(1).uniform(-0.1, 0.1, (40, 2))
    bench.record(n, 0b1010, injection)
    bench.tick(70)
    s = bench.samples()
    e = s[:, :2] - s[:, [6, 7]] - np.column_stack([np.zeros(40), s[:, 8]])
    z = {0: 2.0 * (e + n), 1: 2.0 * e, 2: n}[injection]
    v = z + (n if injection == 1 else 0.0)
    np.testing.assert_allclose(s[:, 4:6], z, atol=1e-15)
    np.testing.assert_allclose(s[:, 9], v[:, 0] + v[:, 1], atol=1e-15)
    np.testing.assert_allclose(s[:, 10], v[:, 1] - v[:, 0], atol=1e-15)


def test_open_loops_close_where_the_machine_is(bench):
    bench.arm(STILL, watchdog_ms=60000, soft_start_s=0.2)
    bench.to_setpoint(0.1, 1.0)
    bench.record(np.full((60, 1), 0.2), 0b10, 2)
    bench.tick(30)
    bench.tick(1, (0.4, 0.5, 0.5))
    while bench.status().state == State.RUNNING:
        bench.tick(1)
    at = len(bench.said)
    pulses = []
    for _ in range(12):
        bench.tick(20)
        pulses.append(float(bench.said[-1].split()[1]))
    assert len(bench.said) == at + 12
    # from 0.4, where it is, to 0.1 in 0.2 s: a tenth more of -0.3 each period, all of it in the end
    share = np.minimum((np.arange(12) * 20 + 1) / 200.0, 1.0)
    np.testing.assert_allclose(pulses, -0.3 * share * 0.02 * (0.3 * share > 0.01), rtol=1e-9)


def test_the_machines_own_trouble_ends_a_recording_without_that_tick(bench):
    done = running(bench)
    bench.lines("x the drive is too hot")
    bench.tick(10)
    ended = bench.ended()
    assert (ended.reason, ended.ticks, ended.sentence) == (Reason.MACHINE, done, "the drive is too hot")
    assert bench.status().state == State.FAULT


@pytest.mark.parametrize("what", [Request.VENT, Request.DISARM])
def test_venting_by_request_comes_before_the_answer(bench, what):
    running(bench)
    bench.ok(what)
    assert bench.said[-1] == "safe"
    bench.tick(40)
    assert bench.said[-1] == "safe"
    ended = bench.ended()
    assert ended.reason == (Reason.EMERGENCY_STOP if what is Request.VENT else Reason.STOPPED)
    assert bench.status().state == (State.FAULT if what is Request.VENT else State.IDLE)
    if what is Request.VENT:
        bench.ok(Request.DISARM)
        assert bench.status().state == State.FAULT  # until CLEAR
        bench.ok(Request.CLEAR)
    bench.ok(Request.ARM, bench.ok(Request.READY))
