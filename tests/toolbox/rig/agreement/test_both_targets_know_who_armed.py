"""Both targets arm by a number that they gave just before, and are kept alive by the host that armed alone."""

import struct
from itertools import cycle

import numpy as np
import pytest
from python_target import FAULT
from target_cases import GAIN, Bench
from two_targets import Second

from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.messages import Configuration, Request, Response, setpoint

WATCHDOG_MS = 100
ROOM = 1e-12  # of an integrator's rounding: docs/protocol.md


class C:
    """The target in C on the scripted board, and its state as the board knows it: no request is needed to see it."""

    def __init__(self):
        self.bench = Bench()
        self.bench.tick(1, (0.0, 0.5, 0.5))
        self.configuration = Configuration(**vars(self.bench.configuration))

    def take(self, data):
        """Bytes from the host; the answers that they got, as types and payloads."""
        self.bench.taken()
        self.bench.send(data)
        return [(f.type, f.payload) for f in self.bench.taken() if f.type in (Response.OK, Response.NO)]

    def passes(self, ms):
        self.bench.tick(ms)

    @property
    def moves(self):
        said = [line for line in self.bench.said if line in ("safe", "enable")]
        return said[-1] == "enable"

    def connected(self):
        self.bench.lines("n new")

    def close(self):
        self.bench.close()


class Python:
    """The target in Python, in real time."""

    def __init__(self, **board):
        self.second = Second(fast=False, emulated=False, **board)
        limits = np.array([[-1.0, 1.0, np.inf]] * 4)
        self.configuration = Configuration(np.eye(2), np.eye(2), (GAIN, GAIN), limits, False, WATCHDOG_MS, 0.0)

    def take(self, data):
        target = self.second.target
        target.out.clear()
        target.take(data)
        return self.second.answers()

    def passes(self, ms):
        target = self.second.target
        for _ in range(ms):
            target.step(target.now + 1e-3, 1)

    @property
    def moves(self):
        return self.second.target.state in (1, 2)

    def connected(self):
        self.second.target.connected()

    def close(self):
        """Nothing to close."""


@pytest.fixture(params=[C, Python], ids=["C", "Python"])
def one(request):
    made = request.param()
    yield made
    made.close()


class Host:
    """A host that counts its tags from a first one on, and remembers what it sent."""

    def __init__(self, one, tag=1):
        self.one, self.tag, self.sent = one, tag, b""

    def ask(self, what, payload=b"", tag=None):
        if tag is None:
            tag, self.tag = self.tag, self.tag % 65535 + 1
        data = Frame(what, tag, payload).encoded
        self.sent += data
        return self.one.take(data)[-1]

    def ok(self, what, payload=b""):
        kind, said = self.ask(what, payload)
        assert kind == Response.OK, (what, said)
        return said

    def no(self, what, payload=b""):
        kind, said = self.ask(what, payload)
        assert kind == Response.NO, what
        return int.from_bytes(said[:2], "little")

    def ready(self):
        for what, payload in self.one.configuration.frames():
            self.ok(what, payload)
        return self.ok(Request.READY)

    def arm(self):
        self.ok(Request.ARM, self.ready())
        assert self.one.moves


def alive(tag):
    return Frame(Request.ALIVE, tag, bytes(8)).encoded


#: what came in place of a host, from a tag on, again and again: the attack, and what a broken program sends
STRANGE = {
    "an unknown type": lambda tag: (Frame(0x3F, t).encoded for t in range(tag, tag + 1000)),
    "a refused GO": lambda tag: (Frame(Request.GO, t, bytes(4)).encoded for t in range(tag, tag + 1000)),
    "a malformed ALIVE": lambda tag: (Frame(Request.ALIVE, t, bytes(7)).encoded for t in range(tag, tag + 1000)),
    "an ALIVE with tag 0": lambda tag: cycle([alive(0)]),
    "one ALIVE": lambda tag: cycle([alive(tag)]),
    "two ALIVEs in turn": lambda tag: cycle([alive(tag), alive(tag + 1)]),
    "forty ALIVEs in a circle": lambda tag: cycle([alive(tag + k) for k in range(40)]),
    "an ALIVE of another count": lambda tag: (alive((tag + 30_000 + k) % 65535 + 1) for k in range(1000)),
    "answers": lambda tag: (Frame(Response.OK, t, bytes(8)).encoded for t in range(tag, tag + 1000)),
    "the request before": lambda tag: cycle([alive(tag - 1)]),
}


@pytest.mark.parametrize("kind", STRANGE)
def test_nothing_but_a_new_request_of_the_host_that_armed_feeds_the_watchdog(one, kind):
    """1.5 s at 10 ms each: it vents a watchdog's time after the last that was new and right, at most 40 of them."""
    host = Host(one)
    host.arm()
    frames = STRANGE[kind](host.tag)
    most = 10 * 41 + WATCHDOG_MS + 10 if kind == "forty ALIVEs in a circle" else 10 * 3 + WATCHDOG_MS
    passed_ms = 0
    while one.moves and passed_ms < 1500:
        one.take(next(frames))
        one.passes(10)
        passed_ms += 10
    assert passed_ms <= most


def test_a_host_that_goes_on_is_enough_whatever_is_lost_of_it(one):
    """Six seconds of ALIVE over the count's end, 250 tags lost at once in the middle."""
    host = Host(one, tag=65_300)
    host.arm()
    for k in range(200):
        one.passes(30)
        assert host.ask(Request.ALIVE, bytes(8))[0] == Response.OK
        host.tag = (host.tag + (250 if k == 100 else 0) - 1) % 65535 + 1
    assert one.moves
    one.passes(WATCHDOG_MS + 10)
    assert not one.moves


def test_another_connection_neither_feeds_nor_moves_what_it_did_not_arm(one):
    host = Host(one)
    host.arm()
    one.connected()
    one.passes(50)
    assert host.ask(Request.ALIVE, bytes(8))[0] == Response.OK  # answered, and no sign of the host that armed
    assert host.no(Request.SETPOINT, setpoint(0.0, [0.1, 0.1])) == 9
    assert host.no(Request.BEGIN, struct.pack("<IIBHQB", 1, 5, 0, 2, 0, 0)) == 9
    one.passes(WATCHDOG_MS - 40)
    assert not one.moves


def test_a_recorded_connection_arms_nothing(one):
    """The bytes of a whole session, ARM and SETPOINT among them, played once more: on a new connection and this one."""
    host = Host(one)
    host.ok(Request.IDENTIFY, b"\1\0")
    host.arm()
    host.ok(Request.SETPOINT, setpoint(0.0, [0.1, 0.1]))
    host.ok(Request.DISARM)
    for again in (one.connected, lambda: None):
        again()
        refused = [struct.unpack("<H", said[:2])[0] for kind, said in one.take(host.sent) if kind == Response.NO]
        assert refused[0] == 10
        assert not one.moves


def test_each_ready_gives_another_number_that_serves_one_arm(one):
    host = Host(one)
    first, second = host.ready(), host.ok(Request.READY)
    assert len({first[4:], second[4:], bytes(8)}) == 3
    assert host.no(Request.ARM, first) == 10
    assert host.no(Request.ARM, second[:4] + bytes(8)) == 10
    host.ok(Request.ARM, second)
    host.ok(Request.DISARM)
    assert host.no(Request.ARM, second) == 10
    third = host.ok(Request.READY)
    one.connected()
    assert host.no(Request.ARM, third) == 10  # of another connection
    assert not one.moves


def test_an_older_host_is_told_why_it_cannot_arm(one):
    host = Host(one)
    kind, said = host.ask(Request.ARM, host.ready()[:4])
    assert (kind, int.from_bytes(said[:2], "little")) == (Response.NO, 2)
    assert b"host" in said
    assert b"READY" in said


def sections(*poles):
    """A section with these two poles, its numerator 1."""
    a1, a2 = np.poly(poles)[1:].real
    return np.array([[1.0, 0.0, 0.0, a1, a2]])


INSIDE = [(0.0, 0.0), (1.0, 0.5), (1.0, 1.0), (-1.0, 0.3), (np.exp(0.3j), np.exp(-0.3j)), (1.0 + 0.1 * ROOM, 0.0)]
OUTSIDE = [(1.0 + 1e-9, 0.0), (-1.001, 0.2), (1.2, 0.9), (1.01 * np.exp(0.3j), 1.01 * np.exp(-0.3j)), (-2.0, -2.0)]


@pytest.mark.parametrize("poles", [*INSIDE, *OUTSIDE])
@pytest.mark.parametrize("place", [0, 1])
def test_a_pole_outside_the_unit_circle_is_refused_and_an_integrator_is_not(one, poles, place):
    host, changed = Host(one), vars(one.configuration)
    cascade = np.vstack([sections(0.5, 0.4), sections(*poles)][:: 1 if place else -1])
    asked = Configuration(**changed | {"sections": (cascade, GAIN)})
    answers = [host.ask(what, payload) for what, payload in asked.frames()]
    refused = [int.from_bytes(said[:2], "little") for kind, said in answers if kind == Response.NO]
    assert (refused[:1] == [3]) == (poles in OUTSIDE)


def test_the_reason_of_the_second_target_is_the_watchdog():
    one = Python()
    Host(one).arm()
    one.passes(2 * WATCHDOG_MS)
    assert (one.second.target.state, one.second.target.fault) == (FAULT, 4)
