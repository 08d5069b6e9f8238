"""A line to the target in Python: TCP at 127.0.0.1 or a pseudo-terminal, with faults on the way."""

import os
import random
import select
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass, field

from python_target import ENDED, RUNNING, SAMPLES, Target
from python_target_frames import Collector, body_of, frame


@dataclass(frozen=True)
class Faults:
    """What goes wrong on the line: shares of frames in both directions, and one event."""

    drop: float = 0.0
    corrupt: float = 0.0
    duplicate: float = 0.0
    delay: float = 0.0
    cut: float = 0.0
    garbage: float = 0.0
    oversize: float = 0.0
    lie: float = 0.0
    foreign: float = 0.0
    late: float = 0.0
    late_s: float = 0.3
    seed: int = 0
    to_host: bool = True
    to_target: bool = True
    event: str = ""
    """`pull` closes the connection, `silent` sends nothing more, `restart` makes a new target."""
    when: str = "run"
    """`upload`: rows taken, `run`: ticks made, `ended`: as ENDED is to be sent, `begun`: recordings announced."""
    at: int = 0
    recording: int = 1
    """The event happens in this recording, counted from 1."""


class Mangler:
    """One direction: frames in, (due time, bytes) out."""

    def __init__(self, faults: Faults, active: bool, seed: int) -> None:
        self.faults, self.active, self.random = faults, active, random.Random(seed)
        self.done: dict[str, int] = {}

    def __call__(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        if not self.active:
            return [(now, data)]
        f, pieces, due = self.faults, [data], now
        if self._happens("drop", f.drop):
            pieces = []
        elif self._happens("corrupt", f.corrupt):
            pieces = [self._flipped(data)]
        elif self._happens("duplicate", f.duplicate):
            pieces = [data, data]
        elif self._happens("cut", f.cut):
            pieces = [data[: self.random.randrange(len(data))]]
        elif self._happens("lie", f.lie):
            pieces = [lying(data)]
        elif self._happens("foreign", f.foreign):
            pieces = [foreign(data), data]
        if self._happens("garbage", f.garbage):
            pieces.append(self.random.randbytes(self.random.randrange(1, 60)))
        if self._happens("oversize", f.oversize):
            pieces.insert(0, bytes(b or 1 for b in self.random.randbytes(3000)) + b"\0")
        if self._happens("delay", f.delay):
            due += self.random.uniform(0.0, 0.05)
        if self._happens("late", f.late):
            due += f.late_s
        return [(due, piece) for piece in pieces]

    def _happens(self, name: str, share: float) -> bool:
        happens = share > 0.0 and self.random.random() < share
        if happens:
            self.done[name] = self.done.get(name, 0) + 1
        return happens

    def _flipped(self, data: bytes) -> bytes:
        changed = bytearray(data)
        changed[self.random.randrange(len(data))] ^= 1 << self.random.randrange(8)
        return bytes(changed)


def lying(data: bytes) -> bytes:
    """The frame with a right CRC and a wrong count (SAMPLES, ROWS), else one byte too many."""
    body = body_of(data[:-1])
    if body is None:
        return data
    kind, tag = struct.unpack("<BH", body[:3])
    payload = bytearray(body[3:])
    if kind in (SAMPLES, 0x09):
        payload[8] = (payload[8] + 1) % 256
    else:
        payload.append(0)
    return frame(kind, tag, bytes(payload))


def foreign(data: bytes) -> bytes:
    """The frame with the tag of another host."""
    body = body_of(data[:-1])
    if body is None:
        return data
    kind, tag = struct.unpack("<BH", body[:3])
    return frame(kind, (tag + 77) % 65535 + 1, body[3:])


@dataclass
class Waiting:
    """A host that waits for its place."""

    socket: socket.socket
    collector: Collector = field(default_factory=Collector)
    since: float = field(default_factory=time.monotonic)


class Tcp:
    """A listening socket; one host at a time, others wait and may vent."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.server.setblocking(False)
        self.host: socket.socket | None = None
        self.waiting: list[Waiting] = []
        self.came: Callable[[], None] = lambda: None
        self.idle: Callable[[], bool] = lambda: False
        self.overhear: Callable[[Collector, bytes, float], bytes] = lambda *_: b""

    @property
    def port(self) -> str:
        return f"tcp://127.0.0.1:{self.server.getsockname()[1]}"

    def receive(self, wait_s: float) -> bytes:
        places = [self.server, *(w.socket for w in self.waiting), *([self.host] if self.host else [])]
        ready = select.select(places, [], [], wait_s)[0]
        data = self._read() if self.host in ready else b""
        if self.server in ready:
            self._accept()
        self._give_place()
        for one in [w for w in self.waiting if w.socket in ready]:
            self._overhear(one)
        return data

    def _read(self) -> bytes:
        try:
            data = self.host.recv(65536)
        except OSError:
            data = b""
        if not data:
            self.pull()
        return data

    def _accept(self) -> None:
        host = self.server.accept()[0]
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.waiting.append(Waiting(host))
        if len(self.waiting) > 4:
            self.waiting.pop(0).socket.close()

    def _give_place(self) -> None:
        if self.waiting and self.host is not None and self.idle():
            self.pull()
        if self.waiting and self.host is None:
            self.host = self.waiting.pop(0).socket
            self.came()
        while self.waiting and time.monotonic() - self.waiting[0].since > 2.0:
            self.waiting.pop(0).socket.close()

    def _overhear(self, one: Waiting) -> None:
        try:
            data = one.socket.recv(4096)
            one.socket.sendall(self.overhear(one.collector, data, time.monotonic() - one.since))
        except OSError:
            data = b""
        if not data:
            one.socket.close()
            self.waiting.remove(one)

    def send(self, data: bytes) -> None:
        if self.host is None:
            return
        try:
            self.host.settimeout(0.2)
            self.host.sendall(data)
        except OSError:
            self.pull()

    def pull(self) -> None:
        if self.host is not None:
            self.host.close()
            self.host = None

    def close(self) -> None:
        self.pull()
        for one in self.waiting:
            one.socket.close()
        self.server.close()


class Pty:
    """A pseudo-terminal; the host opens `port`."""

    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)
        self.came: Callable[[], None] = lambda: None

    def receive(self, wait_s: float) -> bytes:
        return os.read(self.master, 65536) if select.select([self.master], [], [], wait_s)[0] else b""

    def send(self, data: bytes) -> None:
        while data and select.select([], [self.master], [], 0.2)[1]:
            data = data[os.write(self.master, data[:512]) :]

    def pull(self) -> None:
        """Nothing to be closed while the target lives."""

    def close(self) -> None:
        os.close(self.slave)
        os.close(self.master)


@dataclass
class Running:
    """A target with its line in a thread: `with Running(make) as target: ... target.port`."""

    make: Callable[[], Target]
    faults: Faults = field(default_factory=Faults)
    line: Tcp | Pty = field(default_factory=Tcp)

    def __post_init__(self) -> None:
        self.target, self.targets = self.make(), []
        self.targets.append(self.target)
        self.to_host = Mangler(self.faults, self.faults.to_host, 2 * self.faults.seed)
        self.to_target = Mangler(self.faults, self.faults.to_target, 2 * self.faults.seed + 1)
        self.happened, self.silent, self.stopping = False, False, False
        self.half = b""
        self.coming: list[tuple[float, bytes]] = []
        self.going: list[tuple[float, bytes]] = []
        self.error: BaseException | None = None
        self.thread = threading.Thread(target=self._run, daemon=True)

    @property
    def port(self) -> str:
        return self.line.port

    @property
    def log(self) -> list[tuple[int, bytes]]:
        """Every valid request since the start, restarts included."""
        return [entry for target in self.targets for entry in target.log]

    def __enter__(self) -> "Running":
        self.line.came = self._came
        self.line.idle = lambda: self.target.idle
        self.line.overhear = lambda *heard: self.target.overhear(*heard)
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping = True
        self.thread.join(5.0)
        self.line.close()
        if self.error is not None:
            raise self.error

    def _came(self) -> None:
        self.half = b""
        self.coming.clear()
        self.going.clear()
        self.target.connected()

    def _run(self) -> None:
        try:
            self._start = time.monotonic()
            self.paced = 0.0
            while not self.stopping:
                self._once()
        except BaseException as error:
            self.error = error

    def _once(self) -> None:
        now = time.monotonic() - self._start
        made = self._step(now)
        busy = made > 0 and self.target.board.fast and self.target.state == RUNNING
        data = self.line.receive(0.0 if busy or (self.going and self.going[0][0] <= now) else 0.001)
        self._take(data, now)
        self._event()
        self._give(now)

    def _step(self, now: float) -> int:
        """Ticks that are due; while a fast board runs, a good many."""
        rate = self.target.machine.rate_hz
        if self.target.board.fast and self.target.state == RUNNING:
            self.paced = now * rate
            return self.target.step(now, 300)
        ticks = min(int(now * rate - self.paced), 100)
        self.paced += ticks
        return self.target.step(now, ticks)

    def _take(self, data: bytes, now: float) -> None:
        *whole, self.half = (self.half + data).split(b"\0")
        for encoded in whole:
            self.coming += self.to_target(encoded + b"\0", now) if encoded else []
        ready = [piece for due, piece in self.coming if due <= now]
        self.coming = [(due, piece) for due, piece in self.coming if due > now]
        if not self.silent:
            for piece in ready:
                self.target.take(piece)

    def _give(self, now: float) -> None:
        while self.target.out:
            self.going += self.to_host(self.target.out.popleft(), now)
        ready = [piece for due, piece in self.going if due <= now]
        self.going = [(due, piece) for due, piece in self.going if due > now]
        if ready and not self.silent:
            self.line.send(b"".join(ready))

    def _event(self) -> None:
        if self.happened or not self.faults.event or not self._is_time():
            return
        self.happened = True
        if self.faults.event == "silent":
            self.silent = True
        elif self.faults.event == "restart":
            self.target = self.make()
            self.targets.append(self.target)
        else:
            self.going.clear()
            self.target.out.clear()
            self.line.pull()

    def _is_time(self) -> bool:
        f, r = self.faults, self.target.recording
        begun = sum(kind == 0x08 for kind, _ in self.target.log)
        if r is None or begun != f.recording:
            return False
        if f.when == "upload":
            return r.taken >= f.at
        if f.when == "run":
            return r.tick > 0 and r.tick >= f.at
        if f.when == "begun":
            return True
        return any((body_of(out[:-1]) or b"\0")[0] == ENDED for out in self.target.out)
