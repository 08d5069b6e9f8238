"""Whatever came before: a VENT vents. A request is told from the one before by its bytes, not by their CRC-32."""

import struct
import zlib

import pytest
from axis_study import target
from python_target_frames import body_of, frame
from target_cases import Bench

from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.messages import Reason, Request, State


def crc_of(kind, tag, payload=b""):
    return zlib.crc32(struct.pack("<BH", kind, tag) + payload)


def forged(kind, tag, head, wanted):
    """The u32 after `head` that gives a request this CRC-32: the CRC is linear in its bits (over GF(2))."""
    start = crc_of(kind, tag, head + bytes(4))
    rows = [(crc_of(kind, tag, head + struct.pack("<I", 1 << bit)) ^ start, 1 << bit) for bit in range(32)]
    left, value = wanted ^ start, 0
    for bit in reversed(range(32)):
        pivot = next(row for row in rows if row[0] >> bit & 1 and row[0] < 2 << bit)
        rows = [(a ^ pivot[0], b ^ pivot[1]) if a >> bit & 1 else (a, b) for a, b in rows if (a, b) != pivot]
        if left >> bit & 1:
            left, value = left ^ pivot[0], value ^ pivot[1]
    assert crc_of(kind, tag, head + struct.pack("<I", value)) == wanted
    return struct.pack("<I", value)


#: an ALIVE, and a VENT with the same CRC-32; the VENT is plain, or holds the four bytes that forge it
PLAIN = (
    (Request.ALIVE, 7, bytes(4) + forged(Request.ALIVE, 7, bytes(4), crc_of(Request.VENT, 9))),
    (Request.VENT, 9, b""),
)
ALIVE = (Request.ALIVE, 7, bytes(8))
WITH_PAYLOAD = (ALIVE, (Request.VENT, 9, forged(Request.VENT, 9, b"", crc_of(*ALIVE))))


@pytest.mark.parametrize(("before", "vent"), [PLAIN, WITH_PAYLOAD])
def test_a_vent_with_the_crc_of_the_request_before_vents(before, vent):
    assert crc_of(*before) == crc_of(*vent)
    bench = Bench()
    bench.arm(watchdog_ms=60000)
    bench.send(Frame(*before).encoded)
    bench.send(Frame(*vent).encoded)
    assert bench.said[-1] == "safe"
    assert bench.taken()[-1].tag == vent[1]
    status = bench.status()
    assert (status.state, status.fault) == (State.FAULT, Reason.EMERGENCY_STOP)
    bench.close()


@pytest.mark.parametrize(("before", "vent"), [PLAIN, WITH_PAYLOAD])
def test_the_second_target_hears_it_too(before, vent):
    one = target()
    one.take(frame(*before))
    one.take(frame(*vent))
    assert [kind for kind, _ in one.log] == [Request.ALIVE, Request.VENT]
    assert [body_of(answer[:-1])[1] for answer in one.out] == [7, 9]


def test_each_vent_is_done():
    bench = Bench()
    bench.arm(watchdog_ms=60000)
    vents = bench.said.count("safe")
    bench.send(Frame(Request.VENT, 4002).encoded * 3)
    assert bench.said.count("safe") == vents + 3
    bench.close()


@pytest.mark.parametrize(("tag", "payload"), [(0, b""), (65535, b"now!"), (0, bytes(900))])
def test_nothing_that_is_wrong_with_a_vent_keeps_it_from_venting(tag, payload):
    bench = Bench()
    bench.arm(watchdog_ms=60000)
    bench.send(Frame(Request.VENT, tag, payload).encoded)
    assert bench.said[-1] == "safe"
    assert bench.status().state == State.FAULT
    bench.close()


def test_a_vent_leaves_the_reason_of_a_fault_and_is_told_where_there_was_none():
    bench = Bench()
    bench.arm(watchdog_ms=60000)
    bench.tick(1, (3.0, 0.5, 0.5))
    bench.ok(Request.VENT)
    assert bench.status().fault == Reason.LIMIT
    bench.taken()
    bench.ok(Request.CLEAR)
    bench.tick(1, (0.0, 0.5, 0.5))
    bench.ok(Request.VENT)
    bench.poll()
    ended = [f for f in bench.taken() if f.type == 0x91]
    assert ended
    assert bench.status().fault == Reason.EMERGENCY_STOP
    bench.close()
