"""The target in C does each request in the states that the protocol allows, once, and keeps what it recorded."""

import struct

import numpy as np
import pytest
from axis_study import target
from python_target_frames import body_of
from target_cases import GAIN, LIMITS, MIXING, OUTPUTS, Bench, built

from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.messages import (
    Configuration,
    Identity,
    Reason,
    Request,
    Response,
    State,
    rows,
    setpoint,
    start_payload,
)
from loopshape.toolbox.rig.target.trial import Trial, Watch

STATES = list(State)
#: requests that are in order but for the state, and where they are allowed
REQUESTS = {
    Request.IDENTIFY: (b"\1\0", STATES),
    Request.CONFIGURE: (
        Configuration(OUTPUTS, MIXING, (GAIN, GAIN), LIMITS, False, 100, 0.0).frames()[0][1],
        [State.IDLE],
    ),
    Request.SECTIONS: (None, [State.IDLE]),
    Request.LIMIT: (None, [State.IDLE]),
    Request.READY: (b"", [State.IDLE]),
    Request.ARM: (None, [State.IDLE]),
    Request.SETPOINT: (setpoint(0.0, [0.0, 1.0]), [State.ARMED]),
    Request.BEGIN: (start_payload(9, 5, 0, 2, 0, False), [State.ARMED]),
    Request.ROWS: (rows(1, 0, np.zeros((1, 1)), "<f8"), STATES),
    Request.GO: (b"\1\0\0\0", [State.ARMED]),
    Request.STOP: (b"", STATES),
    Request.VENT: (b"", STATES),
    Request.DISARM: (b"", STATES),
    Request.ALIVE: (bytes(8), STATES),
    Request.AGAIN: (struct.pack("<IIH", 1, 0, 1), STATES),
    Request.CLEAR: (b"", [State.FAULT]),
    Request.SCHEDULE: (struct.pack("<BBBdBdBd", 0, 1, 1, 0.5, 0, 1.0, 1, 0.0), [State.IDLE]),
    Request.BLOCK: (struct.pack("<BBHBBdB", 0, 1, 0, 1, 0, 1.0, 0), [State.IDLE]),
    Request.OUTPUT: (b"\0\0", [State.IDLE]),
    Request.NODES: (struct.pack("<BHB6d", 0, 0, 1, *np.ones(6)), [State.IDLE]),
    Request.TRIAL: (Trial(0, GAIN).payloads()[0], [State.IDLE]),
    Request.BLEND: (Watch(0.5, 1, 1, 1).payload(), [State.ARMED]),
    Request.PROGRESS: (b"", STATES),
}


@pytest.fixture
def bench():
    b = Bench()
    yield b
    b.close()


def brought_to(bench, state):
    """A target in a state, with a recording of 20 ticks that is announced or has begun."""
    if state is State.IDLE:
        bench.tick(1, (0.0, 0.5, 0.5))
        bench.configure(watchdog_ms=60000)
        return
    bench.arm(watchdog_ms=60000)
    bench.record(np.zeros((500, 1)), 2, go=state is not State.ARMED)
    bench.tick(40)
    if state is State.FAULT:
        bench.ok(Request.VENT)
    bench.taken()


@pytest.mark.parametrize("state", STATES, ids=lambda s: s.name)
@pytest.mark.parametrize("what", REQUESTS, ids=lambda w: w.name)
def test_a_request_is_done_where_it_is_allowed_and_nowhere_else(bench, what, state):
    brought_to(bench, state)
    payload, allowed = REQUESTS[what]
    if payload is None:
        frames = dict(bench.configuration.frames())
        payload = frames[what] if what in frames else struct.pack("<IQ", bench.configuration.digest, 1)
    answer = bench.request(what, payload)
    code = struct.unpack("<H", answer.payload[:2])[0] if answer.type == Response.NO else 0
    if state not in allowed:
        assert code == 1
        assert bench.status().state == state
    else:
        assert code != 1


def test_identity(bench):
    me = Identity.read(bench.ok(Request.IDENTIFY, b"\1\0"))
    assert (me.number, me.rate_hz, me.pwm_hz, me.emulated, me.fast) == ("<f8", 1000.0, 50.0, False, False)
    assert (me.buffer_rows, me.memory_ticks, me.most_loops, me.most_sections) == (64, 256, 4, 12)
    assert me.sensors + me.commands == ("theta2_rad", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v")
    assert me.ranges == ((-1e6, 1e6),) * 5


def test_a_request_that_comes_twice_is_done_once(bench):
    bench.arm()
    go = Frame(Request.BEGIN, 4000, start_payload(3, 5, 0, 2, 0, False)).encoded
    part = Frame(Request.ROWS, 4001, rows(3, 0, np.ones((2, 1)), "<f8")).encoded
    bench.send(go + part + part + part)
    first, *others = bench.taken()[1:]
    assert others == [first, first]
    assert struct.unpack("<II", first.payload) == (2, 62)


def test_another_request_under_the_last_tag_is_not_taken_for_its_repetition(bench):
    first = bench.request(Request.IDENTIFY, b"\1\0", tag=1)
    assert bench.request(Request.IDENTIFY, b"\1\0", tag=1) == first
    answer = bench.request(Request.VENT, tag=1)
    assert (answer.type, answer.payload) == (Response.OK, b"")
    assert bench.status().state == State.FAULT


def test_digest_is_what_both_sides_mean(bench):
    rng = np.random.default_rng(1)
    for sections in ((1, 1), (12, 3), (5, 12)):
        table = tuple(rng.uniform(-0.5, 0.5, (n, 5)) for n in sections)  # |a1| < 1 + a2: poles inside the circle
        assert bench.configure(sections=table) == bench.configuration.digest
    assert bench.no(Request.ARM, struct.pack("<I", bench.configuration.digest ^ 1) + bench.ready[4:]) == 5
    bench.ok(Request.ARM, bench.ready)


def test_nothing_moves_unlimited_or_without_controllers(bench):
    configuration = bench.configuration
    frames = configuration.frames()
    assert bench.no(Request.READY) == 4
    assert bench.no(Request.ARM, bytes(12)) == 4
    for left_out in range(1, len(frames)):
        for what, payload in frames[:left_out]:
            bench.ok(what, payload)
        assert bench.no(Request.READY) == 4
    bench.ok(*frames[-1])
    assert bench.no(Request.ARM, struct.pack("<IQ", configuration.digest, 1)) == 4  # READY has not been asked
    bench.ok(Request.ARM, bench.ok(Request.READY))


@pytest.mark.parametrize("empty", [0, 1])
def test_both_targets_refuse_a_loop_without_sections(bench, empty):
    """Nothing is closed by a controller that nobody gave."""
    told = [one for one in bench.configuration.frames() if not (one[0] is Request.SECTIONS and one[1][0] == empty)]
    answers = [bench.request(what, payload) for what, payload in (*told, (Request.READY, b""))]
    assert answers[-1].type == Response.NO
    second = target(2)
    one = np.eye(2)
    limits = np.array([[-1.0, 1.0, np.inf]] * 4)
    two = Configuration(one, one, (GAIN, GAIN), limits, False, 100, 0.0)
    asked = [one for one in two.frames() if not (one[0] is Request.SECTIONS and one[1][0] == empty)]
    for k, (what, payload) in enumerate((*asked, (Request.READY, b""))):
        second.take(Frame(what, k + 1, payload).encoded)
    assert [body_of(out[:-1])[0] for out in second.out] == [Response.OK] * len(asked) + [Response.NO]


def test_another_order_of_the_configuration_is_refused(bench):
    configure, first, second, *limits = bench.configuration.frames()
    assert bench.no(*first) == 4
    bench.ok(*configure)
    assert bench.no(*second) == 3
    bench.ok(*first)
    assert bench.no(*first) == 3  # twice
    bench.ok(*second)
    assert bench.no(*limits[1]) == 3
    bench.ok(*limits[0])
    assert bench.no(*limits[0]) == 3
    assert bench.no(Request.SECTIONS, struct.pack("<BBB5d", 1, 1, 1, *GAIN[0])) == 3  # after the limits began


@pytest.mark.parametrize(
    ("at", "value", "code"),
    [
        (0, b"\0", 3), (0, b"\5", 3), (1, b"\2", 3), (2, b"\0", 8), (3, b"\0\0", 3), (5, struct.pack("<d", -1.0), 3),
        (5, struct.pack("<d", np.nan), 3), (13, struct.pack("<d", 30.0), 3), (13, struct.pack("<d", -50.0), 3),
        (21, struct.pack("<d", 0.6), 3), (29, struct.pack("<d", np.inf), 3),
        (2, b"\2", 3),
    ],
)  # fmt: skip
def test_a_configuration_out_of_range_is_refused(bench, at, value, code):
    payload = bytearray(bench.configuration.frames()[0][1])
    payload[at : at + len(value)] = value
    found = bench.no(Request.CONFIGURE, bytes(payload))
    assert found == (2 if at == 0 and value != b"\0" and found == 2 else code)


@pytest.mark.parametrize(
    "limit",
    [
        (1.0, 1.0, 1.0), (2.0, 1.0, 1.0), (-np.inf, 1.0, 1.0), (0.0, np.inf, 1.0), (np.nan, 1.0, 1.0), (0.0, 1.0, 0.0),
        (-1e308, 1.0, 1.0), (0.0, 1e308, 1.0), (-1e6, 1.0000001e6, 1.0),  # beyond what the column can have
    ],
)  # fmt: skip
def test_a_limit_that_limits_nothing_is_refused(bench, limit):
    for what, payload in bench.configuration.frames()[:3]:
        bench.ok(what, payload)
    assert bench.no(Request.LIMIT, struct.pack("<Bddd", 0, *limit)) == 3


def test_a_sensor_outside_its_limits_keeps_the_machine_from_being_armed(bench):
    bench.tick(1, (1.5, 0.5, 0.5))
    bench.configure()
    assert bench.no(Request.ARM, bench.ready) == 3
    assert "enable" not in bench.said


def test_arming_is_bumpless_and_the_setpoint_is_reached_in_a_straight_line(bench):
    bench.arm((0.2, 0.5, 0.6), soft_start_s=0.05, watchdog_ms=60000)
    bench.tick(20)
    assert bench.said[-1] == "g 0 0"  # references are where the machine stands
    bench.ok(Request.SETPOINT, setpoint(0.02, [0.3, 1.0]))  # soft start is longer
    bench.record(np.zeros((1, 1)), 2)  # starts when the references stand, at a period
    bench.tick(50)
    assert bench.status().tick == 0
    bench.tick(30)
    np.testing.assert_array_equal(bench.samples()[:, :2], [[0.3, 1.0]])
    bench.ok(Request.SETPOINT, setpoint(0.04, [0.2, 1.1]))
    at = len(bench.said)
    bench.tick(60)
    u_a, u_b = np.array([[float(v) / 0.02 for v in line.split()[1:]] for line in bench.said[at:]]).T
    e = np.column_stack([u_a - u_b, u_a + u_b]) / 2.0  # what the references are away from (0.2, 1.1)
    share = 1.0 - np.array([1, 21, 41]) / 50.0
    np.testing.assert_allclose(e, np.outer(share, [0.1, -0.1]), atol=1e-9)


def test_rows_are_taken_in_order_and_as_many_as_there_is_room_for(bench):
    bench.arm(watchdog_ms=60000)
    assert struct.unpack("<I", bench.ok(Request.BEGIN, start_payload(1, 100, 0, 2, 0, False))) == (64,)

    def asked(first, count):
        return struct.unpack("<II", bench.ok(Request.ROWS, rows(1, first, np.full((count, 1), 0.1), "<f8")))

    assert asked(0, 10) == (10, 54)
    assert asked(5, 3) == (10, 54)  # known
    assert asked(12, 3) == (10, 54)  # a gap
    assert asked(8, 6) == (14, 50)  # the rest of it is new
    assert asked(14, 60) == (64, 0)
    assert asked(64, 5) == (64, 0)
    for payload, code in (
        (rows(1, 99, np.zeros((2, 1)), "<f8"), 3),
        (rows(2, 0, np.zeros((2, 1)), "<f8"), 7),
        (rows(1, 0, np.zeros((2, 2)), "<f8")[:-1], 2),
        (rows(1, 64, np.full((1, 1), np.nan), "<f8"), 3),
    ):
        assert bench.no(Request.ROWS, payload) == code


def test_rows_that_come_after_the_end_are_answered(bench):
    bench.arm(watchdog_ms=60000)
    bench.record(np.zeros((100, 1)), 2)
    bench.tick(30)
    bench.ok(Request.VENT)
    assert struct.unpack("<II", bench.ok(Request.ROWS, rows(1, 64, np.zeros((5, 1)), "<f8"))) == (64, 0)
    assert bench.no(Request.ROWS, rows(2, 64, np.zeros((5, 1)), "<f8")) == 7


@pytest.mark.parametrize(
    ("words", "code"),
    [((0, 5, 0, 2), 3), ((1, 0, 0, 2), 3), ((1, 5, 3, 2), 3), ((1, 5, 0, 16), 3), ((1, 5, 0, 2, 0, True), 8)],
)
def test_a_recording_out_of_range_is_not_announced(bench, words, code):
    bench.arm()
    assert bench.no(Request.BEGIN, start_payload(*words, *(0, False)[len(words) - 4 :])) == code
    assert bench.no(Request.GO, b"\1\0\0\0") == 7


def test_samples_are_sent_kept_and_sent_again(bench):
    bench.arm(watchdog_ms=60000)
    n = np.arange(1, 301)[:, None] * 1e-3
    bench.record(n, 2)
    taken = 64
    while taken < 300:
        bench.tick(10)
        taken, _ = struct.unpack("<II", bench.ok(Request.ROWS, rows(1, taken, n[taken : taken + 64], "<f8")))
    bench.tick(100)
    samples = bench.samples()
    np.testing.assert_array_equal(samples[:, 2], n[:, 0])
    ended = bench.ended()
    assert (ended.run, ended.ticks, ended.reason, ended.index) == (1, 300, Reason.COMPLETE, None)
    bench.ok(Request.AGAIN, struct.pack("<IIH", 1, 100, 60))
    bench.ok(Request.AGAIN, struct.pack("<IIH", 1, 290, 10))
    again = [Frame(f.type, f.tag, f.payload) for f in bench.taken() if f.type == Response.SAMPLES]
    bench.poll()
    again += [f for f in bench.taken() if f.type == Response.SAMPLES]
    counts = [struct.unpack("<IIB", f.payload[:9]) for f in again]
    assert [c[1] for c in counts] == [*range(100, 160, 11), 290]
    assert sum(c[2] for c in counts) == 70
    tags = [f.tag for f in again]
    assert tags == list(range(tags[0], tags[0] + len(tags)))
    assert bench.no(Request.AGAIN, struct.pack("<IIH", 1, 43, 5)) == 3  # overwritten: 256 ticks are kept
    assert bench.no(Request.AGAIN, struct.pack("<IIH", 1, 299, 2)) == 3
    assert bench.no(Request.AGAIN, struct.pack("<IIH", 1, 200, 0)) == 3
    assert bench.no(Request.AGAIN, struct.pack("<IIH", 2, 200, 1)) == 7


def test_the_end_is_told_again_until_the_host_has_it(bench):
    bench.arm(watchdog_ms=60000)
    bench.record(np.zeros((10, 1)), 2)
    bench.tick(40)
    assert bench.samples().shape == (10, 11)
    bench.ended()
    bench.poll(150)
    assert bench.taken() == []
    bench.poll(60)
    bench.ended()
    bench.status(1, 10)  # has all samples, does not say that it knows of the end
    bench.poll(250)
    bench.ended()
    bench.status(1, 11)
    bench.poll(250)
    assert bench.taken() == []


def test_stop_ends_the_recording_and_not_the_loops(bench):
    bench.arm(watchdog_ms=60000)
    bench.to_setpoint(0.1, 1.0)
    bench.record(np.zeros((50, 1)), 2)
    bench.tick(40)
    bench.ok(Request.STOP)
    bench.tick(20)
    ended = bench.ended()
    assert (ended.reason, ended.ticks) == (Reason.STOPPED, len(bench.samples()))
    assert bench.status().state == State.ARMED
    assert bench.said[-1] == "g 0.002 0.002" or bench.said[-1].startswith("g 0.00")


def test_four_byte_numbers_hold_what_four_bytes_hold():
    bench = Bench(built("-DTARGET_NUMBER_BYTES=4"), number="<f4")
    bench.arm(watchdog_ms=60000)
    n = np.float32(0.1) * np.arange(1, 31, dtype=np.float32)[:, None]
    bench.record(n, 2)
    bench.tick(60)
    np.testing.assert_array_equal(bench.samples()[:, 2], n[:, 0].astype(float))
    bench.close()
