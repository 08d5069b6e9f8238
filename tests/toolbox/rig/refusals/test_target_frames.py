"""No sequence of bytes harms the target in C, and its decoder takes just the frames that Python's takes."""

import struct
import subprocess
import zlib

import numpy as np
import pytest
from target_cases import Bench, built

from loopshape.toolbox.rig.target.frames import LONGEST_ENCODED, LONGEST_PAYLOAD, Frame, Receiver, stuffed
from loopshape.toolbox.rig.target.messages import Request, Response, State

MUTATIONS = 100_000


def frames_of_c(data):
    said = subprocess.run([built(), "decode"], input=data, capture_output=True, check=True).stdout.decode().split("\n")
    assert said[-1] == ""
    return [tuple(int(word) for word in line.split()) for line in said[:-2]], int(said[-2].removeprefix("bad "))


def frames_of_python(data, chunk=4096):
    receiver = Receiver()
    found = []
    for k in range(0, len(data), chunk):
        for f in receiver.take(data[k : k + chunk]):
            body = bytes((f.type,)) + f.tag.to_bytes(2, "little") + f.payload
            found.append((f.type, f.tag, len(f.payload), zlib.crc32(body)))
    return found, receiver.bad


def some_frames(rng, count):
    """Frames of many lengths and contents, the longest and those with runs around 254 among them."""
    lengths = [0, 1, 245, 246, 247, 248, 249, 500, 505, LONGEST_PAYLOAD, *rng.integers(0, 60, count).tolist()]
    kinds = ("zeros", "ones", "random", "few zeros")
    return [Frame(int(rng.integers(256)), int(rng.integers(65536)), content(rng, n, kinds)).encoded for n in lengths]


def content(rng, n, kinds):
    kind = kinds[int(rng.integers(len(kinds)))]
    if kind == "random":
        return rng.bytes(n)
    if kind == "few zeros":
        return bytes(np.where(rng.random(n) < 0.1, 0, rng.integers(1, 256, n)).astype(np.uint8))
    return bytes(n) if kind == "zeros" else b"\x01" * n


def mutated(rng, encoded):
    """A frame as a bad line, a lying host or a mad program sends it."""
    data = bytearray(encoded)
    at = int(rng.integers(len(data)))
    match int(rng.integers(9)):
        case 0:
            data[at] ^= 1 << int(rng.integers(8))
        case 1:
            del data[at]
        case 2:
            data.insert(at, int(rng.integers(256)))
        case 3:
            del data[at:]  # no zero: it runs into the next one
        case 4:
            data[at] = 0
        case 5:
            data[0] = int(rng.integers(1, 256))  # a length that lies
        case 6:
            data = bytearray(rng.bytes(int(rng.integers(1, 40))))
        case 7:
            data = data * 2
        case 8 if at < 3:
            data = bytearray(b"\x02" * int(rng.integers(LONGEST_ENCODED - 3, LONGEST_ENCODED + 40))) + b"\0"
    return bytes(data)


@pytest.fixture(scope="module")
def mutations():
    rng = np.random.default_rng(1)
    known = some_frames(rng, 200)
    pick = rng.integers(len(known), size=MUTATIONS)
    long = np.array([len(f) > 300 for f in known])
    pick[long[pick] & (rng.random(MUTATIONS) < 0.9)] = 20  # mostly short ones, for time
    return b"".join(mutated(rng, known[k]) for k in pick)


@pytest.mark.long
def test_both_decoders_take_the_same_frames_of_mutations(mutations):
    in_c, bad_c = frames_of_c(mutations)
    in_python, bad_python = frames_of_python(mutations)
    assert in_c == in_python
    assert bad_c == bad_python
    assert len(in_c) > 10_000
    assert bad_c > 30_000


def test_frames_that_were_not_touched_arrive():
    rng = np.random.default_rng(2)
    data = b"".join(some_frames(rng, 500))
    in_c, bad = frames_of_c(data)
    assert len(in_c) == 510
    assert bad == 0
    assert in_c == frames_of_python(data, 7)[0]


def checked(body):
    return stuffed(body + zlib.crc32(body).to_bytes(4, "little"))


@pytest.mark.parametrize(
    ("encoded", "taken", "bad"),
    [
        (b"", 0, 0),
        (b"\0\0\0", 0, 0),
        (b"\x01" * LONGEST_ENCODED, 0, 1),
        (b"\x01" * (LONGEST_ENCODED + 1), 0, 1),
        (b"\xff" + b"a" * 300_000, 0, 1),
        (checked(b"ab"), 0, 1),  # a body without a whole head, its CRC right
        (checked(b"abc"), 1, 0),
        (checked(b"abc" + bytes(LONGEST_PAYLOAD)), 1, 0),
        (checked(b"abc" + bytes(LONGEST_PAYLOAD + 1)), 0, 1),
        (checked(b"abc" + b"x" * (LONGEST_PAYLOAD + 1)), 0, 1),
        (b"\x02", 0, 1),  # leads past the end
    ],
)
def test_edges_of_what_is_a_frame(encoded, taken, bad):
    data = encoded + b"\0" + Frame(1, 2, b"3").encoded
    in_c, bad_c = frames_of_c(data)
    assert (len(in_c) - 1, bad_c) == (taken, bad)
    assert (in_c, bad_c) == frames_of_python(data)
    assert in_c[-1][:3] == (1, 2, 1)  # the next zero starts anew


@pytest.fixture
def bench():
    b = Bench()
    yield b
    b.close()


def test_whole_frames_of_nonsense_move_nothing(bench):
    rng = np.random.default_rng(3)
    sizes = {
        Request.IDENTIFY: 2,
        Request.ARM: 12,
        Request.LIMIT: 25,
        Request.BEGIN: 20,
        Request.ROWS: 25,
        Request.ALIVE: 8,
        Request.AGAIN: 10,
    }
    for _ in range(30):
        data = b""
        for _ in range(100):
            kind = int(rng.integers(0, 0x14))
            size = sizes.get(kind, int(rng.integers(120))) if rng.random() < 0.7 else int(rng.integers(200))
            data += Frame(kind, int(rng.integers(65536)), rng.bytes(size)).encoded
        bench.send(data)
        bench.tick(5)
    assert "enable" not in bench.said
    assert not [line for line in bench.said if line.startswith("g ")]
    assert bench.taken()
    assert bench.request(Request.IDENTIFY, b"\1\0").type == Response.OK
    assert bench.status().state in (State.IDLE, State.FAULT)


def test_nonsense_while_armed_does_not_stop_the_loops(bench):
    rng = np.random.default_rng(4)
    bench.arm(watchdog_ms=60000)
    bench.to_setpoint(0.1, 1.0)
    for _ in range(30):
        bench.send(rng.bytes(1500))
        kinds = (
            Request.CONFIGURE,
            Request.SECTIONS,
            Request.SETPOINT,
            Request.BEGIN,
            Request.ROWS,
            Request.GO,
            Request.ALIVE,
            Request.AGAIN,
        )
        bench.send(b"".join(Frame(kind, 7, rng.bytes(int(rng.integers(90)))).encoded for kind in kinds))
        bench.tick(20)
    assert bench.status().state == State.ARMED
    assert bench.status().bad_frames > 100
    assert len([line for line in bench.said if line.startswith("g ")]) == 30


@pytest.mark.parametrize("kind", [0x00, 0x1F, 0x7F])
def test_unknown_requests_are_refused(bench, kind):
    assert bench.no(kind) == 8


@pytest.mark.parametrize("kind", [0x80, 0x81, 0x82, 0x90, 0xFF])
def test_answers_are_answered_by_nothing(bench, kind):
    bench.send(Frame(kind, 5, b"abc").encoded)
    assert bench.taken() == []


def test_an_emergency_stop_with_too_much_in_it_stops_all_the_same(bench):
    bench.ok(Request.VENT, b"now!")
    assert bench.status().state == State.FAULT


def test_a_request_without_a_tag_is_malformed(bench):
    answer = bench.request(Request.STOP, tag=0)
    assert answer.type == Response.NO
    assert struct.unpack("<H", answer.payload[:2]) == (2,)


EXACT = {
    Request.IDENTIFY: 2, Request.READY: 0, Request.ARM: 12, Request.LIMIT: 25, Request.STOP: 0,
    Request.DISARM: 0, Request.ALIVE: 8, Request.AGAIN: 10,
    Request.CONFIGURE: 29 + 16, Request.SECTIONS: 43,
}  # fmt: skip


@pytest.mark.parametrize("kind", EXACT)
@pytest.mark.parametrize("off", [-1, 1])
def test_another_length_is_malformed(bench, kind, off):
    size = EXACT[kind] + off
    if size >= 0:
        assert bench.no(kind, (b"\1" * 2 + b"\1" * size)[:size]) in (2, 3, 8)
