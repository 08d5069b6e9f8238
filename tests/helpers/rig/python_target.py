"""A second target, in plain Python, written from docs/protocol.md alone: states, limits, watchdog, memory of samples.

It shows that the page suffices. `Target` has no line and no clock of its own: `take` gives it bytes, `step` the time.
"""

import math
import secrets
import struct
import zlib
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from python_target_blocks import Block, biquad, known, turn
from python_target_frames import Collector, frame
from python_target_machine import Axes
from python_target_schedule import RefusedError, Schedule, fields, inside
from python_target_trial import Trial

OK, NO, SAMPLES, ENDED = 0x81, 0x82, 0x90, 0x91
IDENTIFY, CONFIGURE, SECTIONS, LIMIT, READY, ARM, SETPOINT, BEGIN, ROWS, GO, STOP, VENT, DISARM, ALIVE, AGAIN, CLEAR = (
    range(1, 17)
)
SCHEDULE, NODES, BLOCK, OUTPUT, TRIAL, BLEND, PROGRESS = range(0x11, 0x18)
IDLE, ARMED, RUNNING, FAULT = range(4)
COMPLETE, STOPPED, BY_LIMIT, BY_RATE, BY_WATCHDOG, UNDERRUN, EMERGENCY, BY_MACHINE, BY_TRIAL = range(9)
CONTROLLER_INPUT, PLANT_INPUT, CONTROL = range(3)
NONE = 255
RATE_TICKS = 10
TAGS_AHEAD = 256


@dataclass(frozen=True)
class Board:
    """What IDENTIFY says."""

    number_bytes: int = 8
    most_loops: int = 4
    most_sections: int = 8
    buffer: int = 600
    memory: int = 4000
    frequency_hz: float = 0.0
    fast: bool = True
    emulated: bool = True
    board: str = "python"
    version: str = "1"
    schedule_rows: int = 100
    """Rows of NODES that a schedule may have; 0: no schedules."""
    most_blocks: int = 10
    """0: no blocks."""
    ignores_limits: bool = False
    """A broken board, for tests of the host."""
    guarded: bool = True
    """READY gives ARM's number, and poles outside the unit circle are refused."""
    trials: bool = True
    """It runs a second controller beside a loop's own."""


@dataclass
class Settings:
    """What CONFIGURE, BLOCK, SECTIONS, SCHEDULE, NODES, OUTPUT and LIMIT set."""

    loops: int
    hold: bool
    watchdog_ms: int
    soft_start_s: float
    y: list[list[float]]
    u: list[list[float]]
    digest: int
    sections: list[list[tuple[float, ...]]] = field(default_factory=list)
    schedules: dict[int, Schedule] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)
    given: dict[int, int] = field(default_factory=dict)
    """Loops and the blocks that give their z."""
    limits: list[tuple[float, float, float]] = field(default_factory=list)
    trial: Trial | None = None
    ready: bool = False

    def begun(self, loop: int) -> bool:
        """Whether something of a loop's controller, or of a later one, is here."""
        return any(self.sections[loop:]) or any(one >= loop for one in (*self.schedules, *self.given))

    def whole(self, loop: int) -> bool:
        """Whether a loop has its controller."""
        one = self.schedules.get(loop)
        return len(one.rows) == one.most if one else bool(self.sections[loop]) or loop in self.given

    def next_loop(self, loop: int, goes_on: bool = False) -> bool:
        """Whether a controller, or where it `goes_on` more sections, of this loop may come."""
        free = loop < self.loops and not self.limits and not self.begun(loop + 1)
        free = free and loop not in self.schedules and loop not in self.given
        before = self.schedules if goes_on else range(loop)
        return free and all(map(self.whole, before)) and (goes_on or not self.sections[loop])


@dataclass
class Announced:
    """A recording from BEGIN on."""

    run: int
    rows: int
    injection: int
    columns: list[int]
    noise: int
    place: bool
    taken: int = 0
    tick: int = 0
    buffer: deque[tuple[float, ...]] = field(default_factory=deque)
    waits: bool = False
    ended: bytes = b""


class Target:
    """States and ticks; `out` holds frames that wait for the line, `log` the requests that were valid."""

    def __init__(self, machine: Axes | None = None, board: Board | None = None) -> None:
        self.machine, self.board = machine or Axes(), board or Board()
        self.state, self.fault, self.settings = IDLE, 0, None
        self.recording: Announced | None = None
        self.out: deque[bytes] = deque()
        self.log: list[tuple[int, bytes]] = []
        self.made: list[bytes] = []
        """Every sample of the last recording, for tests that compare."""
        self.collector = Collector()
        self.sensors = self.machine.read()
        self.samples: deque[bytes] = deque(maxlen=self.board.memory)
        self.unsent, self.tag, self.received = 0, 0, 0
        self.again: deque[tuple[int, int]] = deque(maxlen=8)
        self.ended_until = self.ended_next = 0.0
        self.now = self.heard = self.fed = self.came = self.sent_at = 0.0
        self.fed_tag, self.fresh, self.armed_here = 0, 0, False
        self.ticks_unheard = 0
        self.blended_at = 0.0
        self.held = False
        self._last: tuple[bytes, bytes] | None = None
        self._rest()

    # --- bytes

    def connected(self) -> None:
        """A host came: what an earlier one left half is forgotten."""
        self.collector = Collector()
        self._last, self.came = None, self.now
        self.fresh, self.armed_here = 0, False

    @property
    def idle(self) -> bool:
        """Whether the host has given up its place: nothing for a second, and no watchdog waits for it."""
        watched = self.state in (ARMED, RUNNING) or self.held
        return not watched and self.now - max(self.heard, self.came) >= 1.0

    def overhear(self, collector: Collector, data: bytes, waited_s: float) -> bytes:
        """Bytes of a host that waits for its place: its VENT is done. Answers."""
        out = b""
        for body in collector.take(data):
            kind, tag = struct.unpack("<BH", body[:3])
            if kind == VENT:
                self.log.append((kind, body[3:]))
                out += frame(OK, tag, self._vent(b""))
            elif kind < 0x80 and waited_s >= 0.9:
                out += frame(NO, tag, struct.pack("<H", 9) + text("it is connected to another host"))
        return out

    def take(self, data: bytes) -> None:
        """Bytes from the host."""
        for body in self.collector.take(data):
            kind, tag = struct.unpack("<BH", body[:3])
            if kind < 0x80:
                self.heard = self.now
                self.out.append(self._once(body, kind, tag))

    def _feed(self, kind: int, tag: int) -> None:
        """A request was done: the watchdog is fed where it is new and of the host that armed."""
        new = kind == ARM or 1 <= (tag - self.fed_tag) % 65536 <= TAGS_AHEAD
        if self.armed_here and new:
            self.fed, self.fed_tag, self.ticks_unheard = self.now, tag, 0

    def _once(self, body: bytes, kind: int, tag: int) -> bytes:
        if self._last and self._last[0] == body and kind != VENT:
            return self._last[1]
        self.log.append((kind, body[3:]))
        try:
            if tag == 0 and kind != VENT:
                raise RefusedError(2, "a tag is 1 to 65535")
            answer = frame(OK, tag, self._request(kind, body[3:]))
            self._feed(kind, tag)
        except RefusedError as no:
            code, sentence = no.args
            answer = frame(NO, tag, struct.pack("<H", code) + text(sentence))
        self._last = body, answer
        return answer

    def _request(self, kind: int, payload: bytes) -> bytes:
        answers = {
            IDENTIFY: (self._identify, (IDLE, ARMED, RUNNING, FAULT)),
            CONFIGURE: (self._configure, (IDLE,)),
            SECTIONS: (self._sections, (IDLE,)),
            LIMIT: (self._limit, (IDLE,)),
            READY: (self._ready, (IDLE,)),
            ARM: (self._arm, (IDLE,)),
            SETPOINT: (self._setpoint, (ARMED,)),
            BEGIN: (self._begin, (ARMED,)),
            ROWS: (self._rows, (IDLE, ARMED, RUNNING, FAULT)),
            GO: (self._go, (ARMED,)),
            STOP: (self._stop, (IDLE, ARMED, RUNNING, FAULT)),
            VENT: (self._vent, (IDLE, ARMED, RUNNING, FAULT)),
            DISARM: (self._disarm, (IDLE, ARMED, RUNNING, FAULT)),
            ALIVE: (self._alive, (IDLE, ARMED, RUNNING, FAULT)),
            AGAIN: (self._again, (IDLE, ARMED, RUNNING, FAULT)),
            CLEAR: (self._clear, (FAULT,)),
        }
        if self.board.schedule_rows:
            answers |= {SCHEDULE: (self._schedule, (IDLE,)), NODES: (self._nodes, (IDLE,))}
        if self.board.most_blocks:
            answers |= {BLOCK: (self._block, (IDLE,)), OUTPUT: (self._output, (IDLE,))}
        if self.board.trials:
            answers |= {TRIAL: (self._trial, (IDLE,)), BLEND: (self._blend, (ARMED,))}
            answers |= {PROGRESS: (self._progress, (IDLE, ARMED, RUNNING, FAULT))}
        if kind not in answers:
            raise RefusedError(8, f"there is no request 0x{kind:02X}")
        answer, states = answers[kind]
        if self.state not in states:
            raise RefusedError(1, f"not in state {('idle', 'armed', 'running', 'fault')[self.state]}")
        if states == (ARMED,) and not self.armed_here:
            raise RefusedError(9, "armed by another connection")
        return answer(payload)

    # --- requests

    def _identify(self, payload: bytes) -> bytes:
        (protocol,) = fields("H", payload)
        if protocol != 1:
            raise RefusedError(8, f"protocol {protocol} is not spoken here, only 1")
        b, m = self.board, self.machine
        flags = (
            b.emulated
            + 2 * b.fast
            + 4 * (b.schedule_rows > 0)
            + 8 * (b.most_blocks > 0)
            + 16 * b.guarded
            + 32 * b.trials
        )
        head = struct.pack("<HBBBBB", 1, b.number_bytes, len(m.sensors), len(m.commands), b.most_loops, b.most_sections)
        head += struct.pack("<IIddB", b.buffer, b.memory, m.rate_hz, b.frequency_hz, flags)
        words = b"".join(text(word) for word in (b.board, b.version, *m.sensors, *m.commands))
        return head + words + b"".join(struct.pack("<dd", *one) for one in m.ranges)

    def _configure(self, payload: bytes) -> bytes:
        if len(payload) < 29:
            raise RefusedError(2, f"the payload has {len(payload)} bytes")
        loops, hold, closed, watchdog_ms, soft_s, frequency_hz, dead = struct.unpack("<BBBHddd", payload[:29])
        sensors, commands = len(self.machine.sensors), len(self.machine.commands)
        numbers = fields(f"{loops * (sensors + commands)}d", payload[29:])
        inside(1 <= loops <= self.board.most_loops, f"{loops} loops, at most {self.board.most_loops}")
        inside(hold in (0, 1) and closed == 1 and watchdog_ms > 0, "on_limit, closed or watchdog out of range")
        inside(math.isfinite(soft_s) and soft_s >= 0.0, f"soft start {soft_s} s")
        inside(all(map(math.isfinite, numbers)), "Y or U is not finite")
        if frequency_hz or dead:
            raise RefusedError(8, "there is no PWM here")
        y = [list(numbers[i * sensors : (i + 1) * sensors]) for i in range(loops)]
        rest = numbers[loops * sensors :]
        u = [list(rest[i * loops : (i + 1) * loops]) for i in range(commands)]
        digest = zlib.crc32(payload)
        self.settings = Settings(loops, bool(hold), watchdog_ms, soft_s, y, u, digest, [[] for _ in range(loops)])
        self.recording = None
        self.samples.clear()
        self.again.clear()
        self.unsent, self.ended_until = 0, 0.0
        self._rest()
        return struct.pack("<I", digest)

    def _configured(self) -> Settings:
        if self.settings is None:
            raise RefusedError(4, "nothing is configured")
        return self.settings

    def _stable(self, poles: Iterable[tuple[float, float]]) -> None:
        """Refuse (a1, a2) of a section with a pole outside the unit circle, beyond rounding."""
        for a1, a2 in poles if self.board.guarded else ():
            room = max(abs(a2) - 1.0, abs(a1) - 1.0 - a2)
            inside(room <= 1e-12, f"a pole of {a1}, {a2} lies outside the unit circle")

    def _sections(self, payload: bytes) -> bytes:
        s = self._configured()
        if len(payload) < 3:
            raise RefusedError(2, "too short")
        loop, first, count = payload[:3]
        numbers = fields(f"{5 * count}d", payload[3:])
        if not count:
            raise RefusedError(2, "no section")
        inside(s.next_loop(loop, goes_on=True), f"loop {loop} at this place")
        inside(first == len(s.sections[loop]), f"section {first} is out of order")
        inside(first + count <= self.board.most_sections, f"{first + count} sections")
        inside(all(map(math.isfinite, numbers)), "a coefficient is not finite")
        sections = [numbers[5 * i : 5 * i + 5] for i in range(count)]
        self._stable(one[3:] for one in sections)
        s.sections[loop] += sections
        s.digest, s.ready = zlib.crc32(payload, s.digest), False
        return b""

    def _schedule(self, payload: bytes) -> bytes:
        s = self._configured()
        one = Schedule.read(payload, s.loops)
        inside(s.next_loop(payload[0]), f"loop {payload[0]} at this place")
        if one.sections > self.board.most_sections or one.most > self.board.schedule_rows:
            raise RefusedError(6, f"{one.sections} sections, {one.most} rows")
        s.schedules[payload[0]] = one
        s.digest, s.ready = zlib.crc32(payload, s.digest), False
        return b""

    def _nodes(self, payload: bytes) -> bytes:
        s = self._configured()
        if len(payload) < 4:
            raise RefusedError(2, "too short")
        loop, first, count = struct.unpack("<BHB", payload[:4])
        numbers = fields(f"{6 * count}d", payload[4:])
        if not count:
            raise RefusedError(2, "no row")
        inside(loop in s.schedules and not s.limits and not s.begun(loop + 1), f"no rows of loop {loop} at this place")
        rows = [numbers[6 * i : 6 * i + 6] for i in range(count)]
        self._stable((row[4] / row[3], row[5] / row[3]) for row in rows if row[3])
        s.schedules[loop].take(first, rows)
        s.digest, s.ready = zlib.crc32(payload, s.digest), False
        return b""

    def _block(self, payload: bytes) -> bytes:
        s = self._configured()
        one = Block.read(payload, 2 * s.loops + self.board.most_blocks)
        inside(payload[0] == len(s.blocks) and not s.begun(0) and not s.limits, f"block {payload[0]} at this place")
        if len(s.blocks) == self.board.most_blocks or len(one.sections) > self.board.most_sections:
            raise RefusedError(6, f"{len(s.blocks) + 1} blocks, {len(one.sections)} sections")
        self._stable(section[3:] for section in one.sections)
        s.blocks.append(one)
        s.digest, s.ready = zlib.crc32(payload, s.digest), False
        return b""

    def _output(self, payload: bytes) -> bytes:
        s = self._configured()
        loop, block = fields("BB", payload)
        inside(s.next_loop(loop) and block < len(s.blocks), f"block {block} for loop {loop}")
        s.given[loop] = block
        s.digest, s.ready = zlib.crc32(payload, s.digest), False
        return b""

    def _trial(self, payload: bytes) -> bytes:
        s = self._configured()
        if len(payload) < 11:
            raise RefusedError(2, "too short")
        loop, first, count, track = struct.unpack("<BBBd", payload[:11])
        numbers = fields(f"{5 * count}d", payload[11:])
        if not count:
            raise RefusedError(2, "no section")
        places = len(self.machine.sensors) + len(self.machine.commands)
        inside(len(s.limits) == places and loop < s.loops, f"a trial of loop {loop} at this place")
        one = s.trial or Trial(loop, track)
        inside((one.loop, one.track) == (loop, track) and 0.0 <= track <= 1.0, f"loop {loop}, share {track}")
        inside(all(map(math.isfinite, numbers)), "a coefficient is not finite")
        inside(first + count <= self.board.most_sections, f"{first + count} sections")
        rows = [numbers[5 * i : 5 * i + 5] for i in range(count)]
        self._stable(row[3:] for row in rows)
        one.take(first, rows)
        one.arm()
        s.trial = one
        s.digest, s.ready = zlib.crc32(payload, s.digest), False
        return b""

    def _blend(self, payload: bytes) -> bytes:
        fields("dIII5d", payload)
        if self._configured().trial is None:
            raise RefusedError(4, "no trial is configured")
        self.settings.trial.blend(payload)
        self.blended_at = self.now
        return b""

    def _progress(self, payload: bytes) -> bytes:
        fields("", payload)
        one = self.settings.trial if self.settings else None
        return one.progress() if one else struct.pack("<BBIddd", 0, 0, 0, 0.0, 0.0, 0.0)

    def _limit(self, payload: bytes) -> bytes:
        s = self._configured()
        index, low, high, rate = fields("Bddd", payload)
        places = len(self.machine.sensors) + len(self.machine.commands)
        inside(index == len(s.limits) and index < places, f"limit {index} is out of order")
        inside(math.isfinite(low) and math.isfinite(high) and low < high and rate > 0.0, f"{low} .. {high}, {rate}/s")
        lowest, highest = self.machine.ranges[index]
        inside(lowest <= low and high <= highest, f"{low} .. {high} is beyond {lowest} .. {highest}")
        s.limits.append((low, high, rate))
        s.digest, s.ready = zlib.crc32(payload, s.digest), False
        return b""

    def _ready(self, payload: bytes) -> bytes:
        fields("", payload)
        s = self._configured()
        missing = len(self.machine.sensors) + len(self.machine.commands) - len(s.limits)
        if missing:
            raise RefusedError(4, f"{missing} sensors or commands have no limit")
        if not all(map(s.whole, range(s.loops))):
            raise RefusedError(4, "a loop has no section")
        if not known(s.blocks, 2 * s.loops):
            raise RefusedError(4, "a block reads what is not known by then")
        s.ready = True
        if not self.board.guarded:
            return struct.pack("<I", s.digest)
        self.fresh = secrets.randbelow(2**64 - 1) + 1
        return struct.pack("<IQ", s.digest, self.fresh)

    def _arm(self, payload: bytes) -> bytes:
        s = self._configured()
        if self.board.guarded and len(payload) == 4:
            raise RefusedError(2, "ARM lacks the number of READY: the host is older than this target")
        digest, *number = fields("IQ" if self.board.guarded else "I", payload)
        if not s.ready:
            raise RefusedError(4, "READY was not asked")
        if digest != s.digest:
            raise RefusedError(5, f"configured is {s.digest:08x}, received {digest:08x}")
        if number and (not self.fresh or number != [self.fresh]):
            raise RefusedError(10, "READY gave another number")
        self.sensors = self.machine.read()
        for name, value, (low, high, _) in zip(self.machine.sensors, self.sensors, s.limits, strict=False):
            inside(low <= value <= high, f"{name} is {value}, outside {low} .. {high}")
        self._rest()
        if s.trial:
            s.trial.arm()
        self._start_from(self._outputs(self.sensors))
        self.state, self.armed_here, self.fresh = ARMED, True, 0
        return b""

    def _setpoint(self, payload: bytes) -> bytes:
        s = self._configured()
        ramp_s, *to = fields(f"{1 + s.loops}d", payload)
        inside(math.isfinite(ramp_s) and ramp_s >= 0.0 and all(map(math.isfinite, to)), "the setpoint is not finite")
        self._ramp(to, ramp_s)
        return b""

    def _begin(self, payload: bytes) -> bytes:
        s = self._configured()
        run, rows, injection, columns, noise, place = fields("IIBHQB", payload)
        inside(run > 0 and rows > 0 and injection <= CONTROL, f"run {run}, {rows} rows, injection {injection}")
        if place and not self.board.emulated:
            raise RefusedError(8, "a real machine is not placed")
        inside(columns < 1 << 2 * s.loops and place <= 1, f"columns {columns:x}, place {place}")
        inside(injection != CONTROL or not s.trial or not s.trial.share, "loops stay closed during a trial")
        bits = [bit for bit in range(2 * s.loops) if columns >> bit & 1]
        self.made = []
        self.recording = Announced(run, rows, injection, bits, noise, bool(place))
        self.samples.clear()
        self.again.clear()
        self.unsent, self.received, self.ended_until = 0, 0, 0.0
        return struct.pack("<I", self.board.buffer)

    def _of_run(self, run: int) -> Announced:
        if self.recording is None or self.recording.run != run:
            raise RefusedError(7, f"run {run} is not known")
        return self.recording

    def _rows(self, payload: bytes) -> bytes:
        if len(payload) < 9:
            raise RefusedError(2, "too short")
        run, first, count = struct.unpack("<IIB", payload[:9])
        r = self._of_run(run)
        if r.ended:
            return struct.pack("<II", r.taken, 0)
        wide = len(r.columns)
        numbers = fields(f"{count * wide}{self._letter}", payload[9:])
        inside(wide > 0 and count > 0 and first + count <= r.rows, f"rows {first} .. {first + count}")
        inside(all(map(math.isfinite, numbers)), "a row is not finite")
        for k in range(max(0, r.taken - first), count if first <= r.taken else 0):
            if len(r.buffer) < self.board.buffer:
                r.buffer.append(numbers[k * wide : (k + 1) * wide])
                r.taken += 1
        return struct.pack("<II", r.taken, self.board.buffer - len(r.buffer))

    def _go(self, payload: bytes) -> bytes:
        r = self._of_run(fields("I", payload)[0])
        if r.ended:
            raise RefusedError(7, f"run {r.run} has ended")
        self.state, r.waits = RUNNING, True
        return b""

    def _stop(self, payload: bytes) -> bytes:
        fields("", payload)
        if self.state == RUNNING:
            self._end(STOPPED)
        return b""

    def _vent(self, payload: bytes) -> bytes:
        """Whatever else is wrong with the request."""
        self.held = False
        if self.state != FAULT:
            self._fail(EMERGENCY)
            self.held = False
        return b""

    def _disarm(self, payload: bytes) -> bytes:
        fields("", payload)
        self.held = False
        if self.state == RUNNING:
            self._end(STOPPED)
        if self.state in (ARMED, RUNNING):
            self._idle()
        return b""

    def _clear(self, payload: bytes) -> bytes:
        fields("", payload)
        self._idle()
        return b""

    def _idle(self) -> None:
        """Whoever brought it here looked after the machine: an emulated one stands at its start."""
        self.state, self.fault, self.held = IDLE, 0, False
        if self.board.emulated:
            self.machine.place([0.0] * self.machine.count)

    def _alive(self, payload: bytes) -> bytes:
        run, received = fields("II", payload)
        r = self.recording
        if r is not None and r.run == run:
            self.received = max(self.received, received)
        if (r is not None and r.ended and run == r.run and received > r.tick) or (r is None and received > 0):
            self.ended_until = 0.0
        run, tick, taken = (r.run, r.tick, r.taken) if r else (0, 0, 0)
        status = struct.pack("<BIIIIB", self.state, run, tick, taken, self.collector.bad, self.fault)
        return status + struct.pack(f"<{len(self.sensors)}{self._letter}", *self.sensors)

    def _again(self, payload: bytes) -> bytes:
        run, first, count = fields("IIH", payload)
        r = self._of_run(run)
        inside(r.tick - len(self.samples) <= first, f"sample {first} is no longer in memory")
        self.again.append((first, min(first + count, r.tick)))
        return b""

    # --- ticks

    @property
    def _letter(self) -> str:
        return "d" if self.board.number_bytes == 8 else "f"

    def _rest(self) -> None:
        """Controllers at rest; the next tick's values count as those before it."""
        self.history: deque[list[float]] = deque(maxlen=RATE_TICKS)
        self.command_history: deque[list[float]] = deque(maxlen=RATE_TICKS)
        self.closes = False
        if self.settings:
            self._controllers_rest()

    def _controllers_rest(self) -> None:
        s = self._configured()
        self.memory = [[[0.0, 0.0] for _ in loop] for loop in s.sections]
        for one in (*s.schedules.values(), *s.blocks, *([s.trial] if s.trial else [])):
            one.rest()

    def _start_from(self, outputs: list[float]) -> None:
        self.reference, self.setpoint, self.ramp_left = list(outputs), list(outputs), 0
        self.ramp_from, self.ramp_ticks = list(outputs), 0

    def _ramp(self, to: list[float], ramp_s: float) -> None:
        ticks = math.ceil(max(ramp_s, self._configured().soft_start_s) * self.machine.rate_hz)
        self.ramp_from, self.ramp_ticks, self.ramp_left = list(self.reference), ticks, ticks
        self.setpoint = list(to)
        if not ticks:
            self.reference = list(to)

    def _along_the_ramp(self) -> None:
        if self.ramp_left:
            self.ramp_left -= 1
            part = 1.0 - self.ramp_left / self.ramp_ticks
            pairs = zip(self.ramp_from, self.setpoint, strict=True)
            self.reference = [a + part * (b - a) for a, b in pairs] if self.ramp_left else list(self.setpoint)

    def _outputs(self, sensors: list[float]) -> list[float]:
        return [weighed(row, sensors) for row in self._configured().y]

    @property
    def may_tick(self) -> bool:
        """A board as fast as it can waits for rows and for what the host acknowledges."""
        r = self.recording
        if self.state != RUNNING or not self.board.fast or r is None:
            return True
        starts = not r.waits or r.place or not self.ramp_left
        if r.columns and not r.buffer and starts and r.tick < r.rows:
            return False
        return r.tick - self.received < self.board.memory

    def tick(self) -> None:
        """One tick of machine and loops."""
        self.ticks_unheard += 1
        if self.state in (IDLE, FAULT) and not self.held:
            self.sensors = self.machine.read()
            self.machine.move([0.0] * len(self.machine.commands))
            return
        self._start_what_waits()
        self.sensors = s = self.machine.read()
        y = self._outputs(s)
        if self.closes:
            self.closes = False
            self._controllers_rest()
            to, self.reference = self.setpoint, list(y)
            self._ramp(to, 0.0)
        self._loops(s, y)

    def _start_what_waits(self) -> None:
        """A recording that GO announced begins once the references stand at the setpoint, placed at once."""
        r = self.recording
        if self.state != RUNNING or r is None or not r.waits or (self.ramp_left and not r.place):
            return
        r.waits = False
        if r.noise:
            self.machine.noise.state = r.noise
        if r.place:
            self._rest()
            self._start_from(self.setpoint)
            self.machine.place(placed(self._configured().y, self.setpoint))

    def _runs(self) -> bool:
        r = self.recording
        return self.state == RUNNING and r is not None and not r.waits

    def _loops(self, s: list[float], y: list[float]) -> None:
        found = None if self.state == FAULT else self._passed(s, self.history, 0)
        if self._runs() and self.recording.columns and not self.recording.buffer:
            self._end(UNDERRUN)
            self.reference = list(self.setpoint)
        runs = self._runs()
        if not runs:
            self._along_the_ramp()
        r, n = self._row()
        if found:  # the excitation stops at this tick
            r, n = list(y if self._configured().hold else self.reference), [0.0] * len(n)
        opens = runs and self.recording.injection == CONTROL
        z, total = self._controllers(r, n, y, self.recording.injection if runs else CONTROLLER_INPUT)
        if opens:
            z = total = list(n)
        u = [weighed(row, total) for row in self._configured().u]
        first = len(s)
        found = found or (None if self.state == FAULT else self._passed(u, self.command_history, first))
        if runs:
            self._sample([*r, *n, *z, *s, *u])
        if self.state == FAULT:
            self._hold_or_vent(s, u)
        if found and not self.board.ignores_limits:
            self._fail(*found, y=y)
        elif (trial := self._configured().trial) and trial.ends:
            trial.ends = False
            if self.recording is not None and not self.recording.ended:
                self._end(BY_TRIAL, NONE, trial.value, trial.limit)
            else:
                self._ended(0, 0, BY_TRIAL, NONE, 0, trial.value, trial.limit)
        elif runs and self.recording.tick == self.recording.rows:
            self._end(COMPLETE)
        self._drive(u)

    def _row(self) -> tuple[list[float], list[float]]:
        r, n = list(self.reference), [0.0] * len(self.reference)
        if self._runs() and self.recording.columns:
            row = self.recording.buffer.popleft()
            for bit, value in zip(self.recording.columns, row, strict=True):
                (n if bit % 2 else r)[bit // 2] = value
        return r, n

    def _controllers(
        self, r: list[float], n: list[float], y: list[float], injection: int
    ) -> tuple[list[float], list[float]]:
        z, total = [], []
        configured = self._configured()
        schedules = configured.schedules if injection != CONTROL else {}
        if injection != CONTROL:
            seen = [a - b for a, b in zip(y, n, strict=True)] if injection == CONTROLLER_INPUT else y
            given = turn(configured.blocks, [*r, *seen])
        else:
            given = [0.0] * len(configured.blocks)
        for k, cascade in enumerate(self._configured().sections):
            error = r[k] - y[k]
            entered = e = error + n[k] if injection == CONTROLLER_INPUT else error
            if k in schedules:
                e = schedules[k].step([*r, *y], e)
            if k in configured.given:
                e = given[configured.given[k]]
            for section, state in zip(cascade, self.memory[k], strict=True):
                e = biquad(section, state, e)
            if configured.trial and configured.trial.loop == k and injection != CONTROL:
                if self.board.fast:
                    configured.trial.age = (self.now - self.blended_at) * self.machine.rate_hz
                e = configured.trial.step(error, entered, e)
            z.append(e)
            total.append(e + n[k] if injection == PLANT_INPUT else e)
        return z, total

    def _passed(self, values: list[float], history: deque[list[float]], first: int) -> tuple | None:
        """(reason, index, value, limit) of the first limit that is passed, or None."""
        while len(history) < RATE_TICKS:
            history.append(list(values))
        before = history[0]
        history.append(list(values))
        for k, value in enumerate(values):
            low, high, most = self._configured().limits[first + k]
            if not low <= value <= high:
                return BY_LIMIT, first + k, value, low if value < low else high
            rate = abs(value - before[k]) * self.machine.rate_hz / RATE_TICKS
            if not rate <= most:
                return BY_RATE, first + k, rate, most
        return None

    def _hold_or_vent(self, s: list[float], u: list[float]) -> None:
        """A held machine is vented where a limit is passed by more than a tenth of its span."""
        for value, (low, high, _) in zip([*s, *u], self._configured().limits, strict=True):
            more = 0.1 * (high - low)
            if not low - more <= value <= high + more:
                self.held = False

    def _drive(self, u: list[float]) -> None:
        """The commands to the machine, bound by their limits; nothing where it is vented."""
        closed = self.state in (ARMED, RUNNING) or self.held
        limits = self._configured().limits[len(self.sensors) :]
        if not self.board.ignores_limits:
            u = [min(max(value, low), high) for value, (low, high, _) in zip(u, limits, strict=True)]
        self.machine.move(u if closed else [0.0] * len(u))

    def _sample(self, numbers: list[float]) -> None:
        self.samples.append(struct.pack(f"<{len(numbers)}{self._letter}", *numbers))
        self.made.append(self.samples[-1])
        self.recording.tick += 1
        self.unsent += 1

    # --- ends

    def _end(self, reason: int, index: int = NONE, value: float = 0.0, limit: float = 0.0) -> None:
        r = self.recording
        if self._runs() and r.injection == CONTROL:
            self.closes = True
        elif self._runs():
            self.reference = list(self.setpoint)
        tick = max(r.tick - 1, 0) if reason in (BY_LIMIT, BY_RATE, BY_TRIAL) else r.tick
        r.ended = self._ended(r.run, r.tick, reason, index, tick, value, limit)
        r.waits = False
        self.state = ARMED

    def _ended(self, run: int, ticks: int, reason: int, index: int, tick: int, value: float, limit: float) -> bytes:
        words = (
            "complete",
            "stopped",
            "limit",
            "rate limit",
            "watchdog",
            "underrun",
            "emergency stop",
            "machine",
            "trial",
        )[reason]
        self.ended = struct.pack("<IIBBIdd", run, ticks, reason, index, tick, value, limit) + text(words)
        self.ended_until, self.ended_next = self.now + 5.0, self.now
        return self.ended

    def _fail(
        self, reason: int, index: int = NONE, value: float = 0.0, limit: float = 0.0, y: list[float] | None = None
    ) -> None:
        """What a limit, the watchdog and VENT have in common."""
        closed = self.state in (ARMED, RUNNING)
        if self.state == RUNNING:
            self._end(reason, index, value, limit)
        else:
            self._ended(0, 0, reason, index, 0, value, limit)
        if self.settings and self.settings.trial:
            self.settings.trial.fault()
        self.state, self.fault = FAULT, reason
        self.held = closed and self._configured().hold and reason != BY_WATCHDOG
        if self.held:
            self._start_from(y if y is not None else self._outputs(self.sensors))

    # --- time

    def watch(self) -> None:
        """The watchdog: by ticks in real time, by the clock where the board is as fast as it can."""
        if self.state not in (ARMED, RUNNING) and not self.held:
            return
        real_ms = self.ticks_unheard / self.machine.rate_hz * 1000.0
        unheard_ms = (self.now - self.fed) * 1000.0 if self.board.fast else real_ms
        if unheard_ms <= self._configured().watchdog_ms:
            return
        if self.held:  # its reason stays the limit's
            self.held = False
        else:
            self._fail(BY_WATCHDOG, NONE, unheard_ms, float(self._configured().watchdog_ms))

    def step(self, now: float, ticks: int) -> int:
        """So many ticks at most; then what is to be sent is in `out`. Returns how many ticks it made."""
        self.now, made = now, 0
        self.watch()
        while made < ticks and self.may_tick:
            self.tick()
            made += 1
            if not self.board.fast:
                self.watch()
        self._send()
        return made

    def _send(self) -> None:
        while self.again:
            self._frames(*self.again.popleft())
        r, wait = self.recording, self.now - self.sent_at
        if r is not None and self.unsent and (self.unsent >= self._a_frame or r.ended or wait > 0.02):
            self._frames(r.tick - self.unsent, r.tick)
            self.unsent, self.sent_at = 0, self.now
        if self.now < self.ended_until and self.now >= self.ended_next:
            self.ended_next = self.now + 0.2
            self.out.append(frame(ENDED, 0, self.ended))

    @property
    def _a_frame(self) -> int:
        return min(255, (1000 - 9) // len(self.samples[0])) if self.samples else 1

    def _frames(self, first: int, end: int) -> None:
        """Samples first .. end - 1 as frames."""
        start = self.recording.tick - len(self.samples)
        kept = list(self.samples)
        first = max(first, start)
        while first < end:
            some = kept[first - start : min(end, first + self._a_frame) - start]
            self.tag = (self.tag + 1) & 0xFFFF
            payload = struct.pack("<IIB", self.recording.run, first, len(some)) + b"".join(some)
            self.out.append(frame(SAMPLES, self.tag, payload))
            first += len(some)


def text(words: str) -> bytes:
    data = words.encode()[:255]
    return bytes([len(data)]) + data


def weighed(row: list[float], values: list[float]) -> float:
    total = 0.0
    for weight, value in zip(row, values, strict=True):
        total = total + weight * value
    return total


def placed(y: list[list[float]], setpoint: list[float]) -> list[float]:
    """Positions with these outputs; loops here take one sensor each."""
    position = [0.0] * len(y[0])
    for row, value in zip(y, setpoint, strict=True):
        taken = max(range(len(row)), key=lambda k: abs(row[k]))
        position[taken] = value / row[taken]
    return position
