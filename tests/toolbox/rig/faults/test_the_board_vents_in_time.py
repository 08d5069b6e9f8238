"""Seeded faults of host and line on the emulated Cortex-M4F: it vents within the watchdog's time, in its own ticks.

When the machine was made safe is read from the chip's memory, past the protocol and its watchdog.
"""

import re
import socket
import struct
import time

import numpy as np
import pytest
from cortex_m_cases import armed, board, configuration, session

import loopshape as ls
from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Reason, Request, Response, State, rows, start_payload
from loopshape.toolbox.rig.target.session import Session

RATE_HZ = 2000.0
WATCHDOG_MS = 60
WATCHDOG_TICKS = 120
GAIN = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])
ALIVE = Frame(Request.ALIVE, 77, bytes(8)).encoded


def silence(rng, heard):
    """Nothing."""
    return []


def noise(rng, heard):
    """Bytes of no frame."""
    return [rng.bytes(int(rng.integers(1, 1500))) for _ in range(3)]


def zeros(rng, heard):
    """Ends of no frame."""
    return [bytes(int(rng.integers(1, 3000)))]


def endless(rng, heard):
    """A frame that never ends."""
    return [b"\7" * int(rng.integers(1000, 3000))]


def bad_frames(rng, heard):
    """Frames too short."""
    return [b"\1\2\3\0" * int(rng.integers(10, 500))]


def cut(rng, heard):
    """A frame that ends in the middle."""
    return [ALIVE[: int(rng.integers(1, len(ALIVE)))]]


def changed(rng, heard):
    """ALIVE with a bit changed, again and again."""
    out = []
    for _ in range(20):
        data = bytearray(ALIVE)
        data[int(rng.integers(len(data) - 1))] ^= 1 << int(rng.integers(8))
        out.append(bytes(data))
    return out


def echoes(rng, heard):
    """What a board sends, sent back to it."""
    return [Frame(int(rng.choice([Response.OK, Response.NO, Response.SAMPLES])), 3, rng.bytes(100)).encoded] * 10


def refused(rng, heard):
    """Requests that are whole, and refused: unknown, without a tag, with another length."""
    kinds = [(0x60, 500, b""), (Request.ALIVE, 0, bytes(8)), (Request.ALIVE, 501, bytes(5)), (Request.READY, 502, b"")]
    return [Frame(*kinds[int(rng.integers(4))]).encoded for _ in range(10)]


def replayed(rng, heard):
    """The last request that it answered, again and again."""
    return [heard] * int(rng.integers(1, 20))


def hung_up(rng, heard):
    """The line is cut."""
    return [None]


FAULTS = (hung_up, silence, noise, zeros, endless, bad_frames, cut, changed, echoes, refused, replayed)


class Campaign:
    """A board, armed anew for each fault, over a line of its own."""

    def __init__(self, port, monitor) -> None:
        self.port, self.monitor = port, monitor
        self.late, self.uncertain = [], []

    def fault(self, number: int) -> None:
        """Arm, and record in half of them; feed it for the last time; then what the seed draws."""
        rng = np.random.default_rng(number)
        kind = FAULTS[int(rng.integers(len(FAULTS)))]
        with open_link(self.port, 0) as link:
            one = Session(link)
            armed(one, configuration(GAIN, watchdog_ms=WATCHDOG_MS))
            if rng.random() < 0.5:
                self.record(one)
            before = self.monitor.watched()
            one.status()
            fed = self.monitor.watched()
            (tag,) = one._awaited
            for data in kind(rng, Frame(Request.ALIVE, tag, bytes(8)).encoded):
                link.close() if data is None else link.write(data)
            self.wait(fed.ticks + WATCHDOG_TICKS, lambda: kind is hung_up or one.listen(0.005))
        self.hold(f"fault {number}, {kind.__name__}", before, fed, self.monitor.watched())

    def record(self, one: Session) -> None:
        """A recording that outlasts the fault."""
        one.ask(Request.BEGIN, start_payload(1, 5000, 0, 2, 0, False))
        one.ask(Request.ROWS, rows(1, 0, np.zeros((240, 1)), "<f4"))
        one.ask(Request.GO, struct.pack("<I", 1))

    def wait(self, tick: int, listen) -> None:
        """Until the board has passed this tick; what it sends is read meanwhile."""
        over = time.monotonic() + 30.0
        while self.monitor.watched().ticks <= tick + 1:
            listen()
            assert time.monotonic() < over, "the board stands still"

    def hold(self, what, before, fed, found) -> None:
        """Safe no later than the watchdog's time after the last request's answer, and by the watchdog: no earlier."""
        note = f"{what}: {before}, {fed}, {found}"
        assert found.safe_at > before.safe_at, f"not vented: {note}"
        assert found.safe_at <= fed.ticks + WATCHDOG_TICKS, f"late: {note}"
        assert found.safe_at >= before.ticks + WATCHDOG_TICKS - 1, f"early: {note}"
        with session(self.port) as one:
            status = one.status()
        assert (status.state, status.fault) == (State.FAULT, Reason.WATCHDOG), note
        self.late.append(found.safe_at - fed.ticks)
        self.uncertain.append(fed.ticks - before.ticks)


def survived(first: int, count: int) -> None:
    """Faults of these numbers, one after the other on one board."""
    with board(rate_hz=RATE_HZ) as (port, monitor):
        campaign = Campaign(port, monitor)
        for number in range(first, first + count):
            campaign.fault(number)
        assert len(campaign.late) == count
        print(
            f"{count} faults: vented {min(campaign.late) / 2:.1f} to {max(campaign.late) / 2:.1f} ms after the last "
            f"request, which is known to {np.median(campaign.uncertain) / 2:.1f} ms"
        )


@pytest.mark.parametrize(("tag", "payload"), [(0, b""), (65535, b"now!"), (4002, bytes(900))])
@pytest.mark.parametrize("before", [b"", b"\7" * 3000, ALIVE[:9]])
def test_a_vent_vents_whatever_came_before(chip, before, tag, payload):
    port, monitor = chip
    with open_link(port, 0) as link:
        one = Session(link)
        armed(one, configuration(GAIN, watchdog_ms=10_000))
        asked = monitor.watched()
        link.write(before + b"\0" + Frame(Request.VENT, tag, payload).encoded)
        status = one.status()
        found = monitor.watched()
    assert (status.state, status.fault) == (State.FAULT, Reason.EMERGENCY_STOP)
    assert asked.ticks <= found.safe_at <= found.ticks


def told(debugger, words: bytes) -> bytes:
    """What QEMU's debugger answers to a packet."""
    debugger.sendall(b"$" + words + b"#%02x" % (sum(words) % 256))
    said = b""
    while not re.search(rb"\$.*#..$", said, re.S):
        said += debugger.recv(65536)
    debugger.sendall(b"+")
    return said


def test_a_fault_of_the_processor_leaves_it_idle(tmp_path):
    """Armed, it is sent to where there is no program: pins safe, a new start, and nothing that was configured stays."""
    line = f"socket,id=debugger,path={tmp_path / 'debugger'},server=on,wait=off"
    with board("-chardev", line, "-gdb", "chardev:debugger") as (port, _), open_link(port, 0) as link:
        one = Session(link)
        armed(one, configuration(GAIN, watchdog_ms=10_000))
        assert one.status().state is State.ARMED
        with socket.socket(socket.AF_UNIX) as debugger:
            debugger.connect(str(tmp_path / "debugger"))
            told(debugger, b"qXfer:features:read:target.xml:0,ffb")  # without it no register can be set
            assert b"$OK#" in told(debugger, b"Pf=000000f0")
            assert b"$OK#" in told(debugger, b"D")
        one = Session(link)
        assert one.status().state is State.IDLE
        with pytest.raises(ls.errors.RigError, match="nothing is configured"):
            one.ask(Request.READY)


@pytest.fixture(scope="module")
def chip():
    """One board for all vents."""
    with board() as found:
        yield found


@pytest.mark.long
def test_it_vents_in_forty_faults():
    survived(0, 40)


@pytest.mark.long
@pytest.mark.hour
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("part", range(4))
def test_it_vents_in_a_thousand_faults(part):
    survived(1000 + 250 * part, 250)
