"""Messages of the target's protocol: what stands in each frame's payload. `docs/protocol.md` is the specification."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.core.units import Array
from loopshape.toolbox.rig.target.blocks import Block
from loopshape.toolbox.rig.target.frames import LONGEST_PAYLOAD, Frame
from loopshape.toolbox.rig.target.scheduling import Scheduling
from loopshape.toolbox.rig.target.trial import Trial

PROTOCOL = 1


class Request(IntEnum):
    """Types of requests."""

    IDENTIFY = 0x01
    CONFIGURE = 0x02
    SECTIONS = 0x03
    LIMIT = 0x04
    READY = 0x05
    ARM = 0x06
    SETPOINT = 0x07
    BEGIN = 0x08
    ROWS = 0x09
    GO = 0x0A
    STOP = 0x0B
    VENT = 0x0C
    DISARM = 0x0D
    ALIVE = 0x0E
    AGAIN = 0x0F
    CLEAR = 0x10
    SCHEDULE = 0x11
    NODES = 0x12
    BLOCK = 0x13
    OUTPUT = 0x14
    TRIAL = 0x15
    BLEND = 0x16
    PROGRESS = 0x17


class Response(IntEnum):
    """Types of what a target says."""

    OK = 0x81
    NO = 0x82
    SAMPLES = 0x90
    ENDED = 0x91


class State(IntEnum):
    """States of a target."""

    IDLE = 0
    ARMED = 1
    RUNNING = 2
    FAULT = 3


class Reason(IntEnum):
    """Why a run ended."""

    COMPLETE = 0
    STOPPED = 1
    LIMIT = 2
    RATE_LIMIT = 3
    WATCHDOG = 4
    UNDERRUN = 5
    EMERGENCY_STOP = 6
    MACHINE = 7
    TRIAL = 8


REFUSALS = {
    1: "not in this state", 2: "malformed", 3: "out of range", 4: "not configured", 5: "another configuration",
    6: "no room", 7: "unknown run", 8: "not supported", 9: "another host is connected",
    10: "the number is not fresh",
}  # fmt: skip


class Payload:
    """Reads a payload piece by piece; what is too short is refused, not guessed."""

    def __init__(self, data: bytes) -> None:
        self._data, self._place = data, 0

    def take(self, layout: str) -> tuple:
        """Values by a `struct` layout, little-endian."""
        size = struct.calcsize("<" + layout)
        if self._place + size > len(self._data):
            raise UnreadableInputError(
                "a message of the target is too short", f"{len(self._data)} bytes", "its protocol may be another"
            )
        values = struct.unpack_from("<" + layout, self._data, self._place)
        self._place += size
        return values

    def one(self, layout: str) -> int:
        """A single whole number."""
        return int(self.take(layout)[0])

    def number(self) -> float:
        """A single f64."""
        return float(self.take("d")[0])

    def text(self) -> str:
        """Text with its length in front."""
        length = self.one("B")
        return bytes(self.take(f"{length}s")[0]).decode("utf-8", "replace")

    def rest(self, dtype: str) -> Array:
        """All that is left, as numbers (n,) of a type."""
        left = self._data[self._place :]
        if len(left) % np.dtype(dtype).itemsize:
            raise UnreadableInputError("a message of the target has no whole numbers", f"{len(left)} bytes left")
        return np.frombuffer(left, dtype).astype(float)


@dataclass(frozen=True)
class Identity:
    """What a target says of itself; `number` is numpy's type of its numbers, sensors and commands are columns.

    `ranges` are the lowest and highest value of each sensor, then of each command; an older target says none.
    `schedules`: whether it takes controllers that follow an operating point, `blocks`: such that are a diagram.
    `guarded`: whether it arms by a number that it gives fresh, and refuses poles outside the unit circle.
    `trials`: whether it runs a second controller beside a loop's own and goes back by itself.
    """

    protocol: int
    number: str
    most_loops: int
    most_sections: int
    buffer_rows: int
    memory_ticks: int
    rate_hz: float
    pwm_hz: float
    emulated: bool
    fast: bool
    board: str
    version: str
    sensors: tuple[str, ...]
    commands: tuple[str, ...]
    ranges: tuple[tuple[float, float], ...] = ()
    schedules: bool = False
    blocks: bool = False
    guarded: bool = False
    trials: bool = False

    @classmethod
    def read(cls, payload: bytes) -> Identity:
        """From the answer to IDENTIFY. Refuses another protocol and an unknown size of numbers."""
        p = Payload(payload)
        protocol, size, sensors, commands, loops, sections, buffer, memory = p.take("HBBBBBII")
        rate_hz, pwm_hz = p.take("dd")
        flags, board, version = p.one("B"), p.text(), p.text()
        if protocol != PROTOCOL or size not in (4, 8):
            raise UnreadableInputError(
                "the target uses another protocol",
                f"version {protocol}, numbers of {size} bytes",
                f"loopshape uses version {PROTOCOL} with 4 or 8",
            )
        names = [p.text() for _ in range(sensors + commands)]
        numbers = p.rest("<f8").tolist()
        if len(numbers) not in (0, 2 * len(names)):
            raise UnreadableInputError(
                "the target does not say the range of each column", f"{len(numbers)} numbers", "look at its board"
            )
        return cls(
            protocol, f"<f{size}", loops, sections, buffer, memory, rate_hz, pwm_hz, bool(flags & 1), bool(flags & 2),
            board, version, tuple(names[:sensors]), tuple(names[sensors:]),
            tuple(zip(numbers[::2], numbers[1::2], strict=True)), bool(flags & 4),
            bool(flags & 8), bool(flags & 16), bool(flags & 32),
        )  # fmt: skip

    def width(self, loops: int) -> int:
        """Numbers a tick in SAMPLES: r, n, z of each loop, sensors, commands."""
        return 3 * loops + len(self.sensors) + len(self.commands)


@dataclass(frozen=True, eq=False)
class Configuration:
    """What a target is to do: matrices, controllers and limits.

    `outputs` (loops, sensors) and `mixing` (commands, loops); of each loop its `sections` (k, 5), its schedule, or the
    place among `blocks` that gives its z; `trial` a second controller for one of them; `limits` (sensors + commands,
    3): low, high and rate per second in the columns' units.
    """

    outputs: Array
    mixing: Array
    sections: tuple[Array | Scheduling | int, ...]
    limits: Array
    hold: bool
    watchdog_ms: int
    soft_start_s: float
    pwm_hz: float = 0.0
    dead_zone: float = 0.0
    blocks: tuple[Block, ...] = ()
    trial: Trial | None = None

    def frames(self) -> list[tuple[Request, bytes]]:
        """The requests that configure, in the order of the digest."""
        requests = [(Request.CONFIGURE, self._configure())]
        requests += [(Request.BLOCK, block.payload(k)) for k, block in enumerate(self.blocks)]
        for loop, sections in enumerate(self.sections):
            if isinstance(sections, Scheduling):
                head, nodes = sections.payloads(loop)
                requests += [(Request.SCHEDULE, head), *((Request.NODES, part) for part in nodes)]
            elif isinstance(sections, int):
                requests += [(Request.OUTPUT, bytes((loop, sections)))]
            else:
                requests += _sections(loop, sections)
        requests += [
            (Request.LIMIT, struct.pack("<Bddd", k, *map(float, limit))) for k, limit in enumerate(self.limits.tolist())
        ]
        return requests + [(Request.TRIAL, part) for part in (self.trial.payloads() if self.trial else [])]

    def _configure(self) -> bytes:
        head = struct.pack(
            "<BBBHddd", len(self.sections), self.hold, 1, self.watchdog_ms, self.soft_start_s,
            self.pwm_hz, self.dead_zone,
        )  # fmt: skip
        return head + np.asarray(self.outputs, "<f8").tobytes() + np.asarray(self.mixing, "<f8").tobytes()

    @property
    def digest(self) -> int:
        """CRC-32 of the payloads, by which host and target know that they mean the same."""
        check = 0
        for _, payload in self.frames():
            check = zlib.crc32(payload, check)
        return check


def _sections(loop: int, table: Array) -> list[tuple[Request, bytes]]:
    most = LONGEST_PAYLOAD // 40 - 1
    pieces = [(k, table[k : k + most]) for k in range(0, len(table), most)]
    return [
        (Request.SECTIONS, struct.pack("<BBB", loop, k, len(part)) + np.asarray(part, "<f8").tobytes())
        for k, part in pieces
    ]


def setpoint(ramp_s: float, references: Sequence[float]) -> bytes:
    """Payload of SETPOINT."""
    return struct.pack(f"<{1 + len(references)}d", ramp_s, *references)


def start_payload(run: int, rows: int, injection: int, columns: int, noise: int, place: bool) -> bytes:
    """Payload of BEGIN."""
    return struct.pack("<IIBHQB", run, rows, injection, columns, noise, place)


def rows(run: int, first: int, table: Array, number: str) -> bytes:
    """Payload of ROWS from `table` (count, columns)."""
    return struct.pack("<IIB", run, first, len(table)) + np.ascontiguousarray(table, number).tobytes()


def rows_a_frame(columns: int, number: str) -> int:
    """How many rows of an excitation fit into a frame."""
    return min(255, (LONGEST_PAYLOAD - 9) // max(1, columns * np.dtype(number).itemsize))


@dataclass(frozen=True, eq=False)
class Status:
    """Answer to ALIVE; `sensors` as measured last."""

    state: State
    run: int
    tick: int
    rows_taken: int
    bad_frames: int
    fault: int
    sensors: Array

    @classmethod
    def read(cls, payload: bytes, number: str) -> Status:
        """From the payload. Refuses a state that there is not."""
        p = Payload(payload)
        state, run, tick, taken, bad, fault = p.take("BIIIIB")
        if state not in list(State):
            raise UnreadableInputError("the target is in a state that the protocol does not have", f"{state}")
        return cls(State(state), run, tick, taken, bad, fault, p.rest(number))


@dataclass(frozen=True, eq=False)
class Samples:
    """Consecutive samples of a run (count, width), the first at tick `first`."""

    run: int
    first: int
    table: Array

    @classmethod
    def read(cls, frame: Frame, width: int, number: str) -> Samples:
        """From a frame. Refuses a count that its numbers contradict."""
        p = Payload(frame.payload)
        run, first, count = p.take("IIB")
        numbers = p.rest(number)
        if numbers.size != count * width or count == 0:
            raise UnreadableInputError(
                "a frame of samples says another count than it holds",
                f"{count} ticks, {numbers.size} numbers of {width} a tick",
            )
        return cls(run, first, numbers.reshape(count, width))


@dataclass(frozen=True)
class Ended:
    """How a run ended: ticks recorded, reason, whose limit (None: nobody's), when, what was found and what was set."""

    run: int
    ticks: int
    reason: Reason
    index: int | None
    tick: int
    value: float
    limit: float
    sentence: str

    @classmethod
    def read(cls, payload: bytes) -> Ended:
        """From the payload. Refuses a reason that there is not."""
        p = Payload(payload)
        run, ticks, reason, index, tick = p.take("IIBBI")
        value, limit = p.take("dd")
        if reason not in list(Reason):
            raise UnreadableInputError("a run ended for a reason that the protocol does not have", f"{reason}")
        return cls(run, ticks, Reason(reason), None if index == 255 else index, tick, value, limit, p.text())
