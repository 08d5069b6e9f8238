"""The target in C on the scripted board, spoken to by lines, for tests of its every tick."""

from __future__ import annotations

import atexit
import os
import shlex
import shutil
import struct
import subprocess
import tempfile
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import loopshape
from loopshape.toolbox.rig.target.frames import Frame, Receiver
from loopshape.toolbox.rig.target.messages import (
    Configuration,
    Ended,
    Request,
    Response,
    Samples,
    Status,
    rows,
    setpoint,
    start_payload,
)

TARGET = Path(loopshape.__file__).parent / "toolbox" / "rig" / "c_target"
CORE = ("target.c", "configure.c", "loops.c", "run.c", "schedule.c", "blocks.c", "stream.c", "trial.c", "frames.c")
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
INFINITE = np.inf
OUTPUTS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
MIXING = np.array([[1.0, 1.0], [-1.0, 1.0]])
GAIN = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])
LIMITS = np.array([[-1.0, 1.0, INFINITE], [-0.1, 2.0, INFINITE], [-0.1, 2.0, INFINITE], *[[-5.0, 5.0, INFINITE]] * 2])


def compiler() -> list[str]:
    """The C compiler; without one the test is skipped."""
    command = shlex.split(os.environ.get("CC", "cc"))
    if shutil.which(command[0]) is None:
        pytest.skip(f"no C compiler: {command[0]} is not here (set CC)")
    return command


@cache
def built(*flags: str, rows: int = 64, ticks: int = 256) -> Path:
    """The scripted board compiled with every warning an error, and with sanitizers where the compiler has them."""
    units = [*(str(TARGET / name) for name in CORE), str(Path(__file__).with_name("scripted.c"))]
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    out = Path(folder.name) / "scripted"
    command = [*compiler(), *WARNINGS, f"-DTARGET_ROWS={rows}", f"-DTARGET_TICKS={ticks}", *flags, "-I", str(TARGET)]
    made = subprocess.run([*command, *SANITIZERS, *units, "-o", str(out), "-lm"], capture_output=True, check=False)
    if made.returncode:  # a compiler without sanitizers
        subprocess.run([*command, *units, "-o", str(out), "-lm"], check=True)
    return out


class Bench:
    """A running target; what it was asked is answered at once, what comes unasked is collected."""

    def __init__(
        self, program: Path | None = None, *, fast: bool = False, pwm_hz: float = 50.0, number: str = "<f8"
    ) -> None:
        words = [str(program or built()), "fast" if fast else "real", str(pwm_hz), "0.01"]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._receiver, self._tag = Receiver(), 0
        self.number, self.now_ms = number, 0
        self.frames: list[Frame] = []
        self.said: list[str] = []  # lines of the board: g, safe, enable, noise
        self.configuration = Configuration(OUTPUTS, MIXING, (GAIN, GAIN), LIMITS, False, 100, 0.0)

    def close(self) -> None:
        """End it; it must have ended well, the sanitizers' reports included."""
        self._process.stdin.close()
        assert self._process.wait(10) == 0
        self._process.stdout.close()

    def lines(self, *lines: str) -> None:
        """Say these lines and take in what they bring."""
        self._process.stdin.write("".join(f"{line}\n" for line in (*lines, ".")))
        self._process.stdin.flush()
        for line in self._process.stdout:
            if line == ".\n":
                return
            if line.startswith("f "):
                self.frames += self._receiver.take(bytes.fromhex(line[2:]))
            else:
                self.said.append(line.strip())
        raise AssertionError("the target ended")

    def send(self, data: bytes) -> None:
        """Raw bytes from the host."""
        self.lines(*(f"b {data[k : k + 2000].hex()}" for k in range(0, len(data), 2000)))

    def tick(self, count: int = 1, sensors: tuple[float, ...] | None = None) -> None:
        """Ticks, with these sensors from now on; polled each ten."""
        if sensors is not None:
            self.lines("s " + " ".join(map(repr, map(float, sensors))))
        for k in range(0, count, 10):
            done = min(10, count - k)
            self.now_ms += done
            self.lines(f"t {done}", f"p {self.now_ms}")

    def poll(self, ms: int = 0) -> None:
        """The main loop's turn, `ms` later."""
        self.now_ms += ms
        self.lines(f"p {self.now_ms}")

    def request(self, what: int, payload: bytes = b"", tag: int | None = None) -> Frame:
        """Ask and take the answer."""
        if tag is None:
            self._tag = self._tag % 65535 + 1
        before = len(self.frames)
        self.send(Frame(what, self._tag if tag is None else tag, payload).encoded)
        (at,) = (k for k in range(before, len(self.frames)) if self.frames[k].type in (Response.OK, Response.NO))
        return self.frames.pop(at)

    def ok(self, what: int, payload: bytes = b"") -> bytes:
        """Ask what must be done."""
        answer = self.request(what, payload)
        assert answer.type == Response.OK, (what, answer.payload)
        return answer.payload

    def no(self, what: int, payload: bytes = b"") -> int:
        """Ask what must be refused; the code."""
        answer = self.request(what, payload)
        assert answer.type == Response.NO, what
        assert answer.payload[2] == len(answer.payload) - 3 > 0
        return struct.unpack("<H", answer.payload[:2])[0]

    def configure(self, **changes: object) -> int:
        """Configure, with the bench's configuration changed so; the digest."""
        self.configuration = Configuration(**{**vars(self.configuration), **changes})
        for what, payload in self.configuration.frames():
            self.ok(what, payload)
        self.ready = self.ok(Request.READY)  # what ARM repeats
        return struct.unpack("<I", self.ready[:4])[0]

    def arm(self, sensors: tuple[float, ...] = (0.0, 0.5, 0.5), **changes: object) -> None:
        """Configured and armed at these sensors."""
        self.tick(1, sensors)
        self.configure(**changes)
        self.ok(Request.ARM, self.ready)

    def record(self, table: np.ndarray, columns: int, injection: int = 0, run: int = 1, go: bool = True) -> None:
        """Announce a recording with these rows, upload what there is room for, go."""
        self.ok(Request.BEGIN, start_payload(run, len(table), injection, columns, 0, False))
        for first in range(0, min(len(table), 64), 32):
            self.ok(Request.ROWS, rows(run, first, table[first : min(first + 32, 64)], self.number))
        if go:
            self.ok(Request.GO, struct.pack("<I", run))

    def watched(self, sensors: np.ndarray) -> np.ndarray:
        """Samples of a recording with these sensors (n, 3), the first as they are now, and nothing injected."""
        self.ok(Request.BEGIN, start_payload(1, len(sensors), 0, 0, 0, False))
        self.ok(Request.GO, struct.pack("<I", 1))
        while self.status().tick == 0:
            self.tick(1)
        for k in range(1, len(sensors), 100):
            lines = [f"s {a!r} {b!r} {c!r}\nt 1" for a, b, c in sensors[k : k + 100].tolist()]
            self.now_ms += 100
            self.lines(*lines, f"p {self.now_ms}", f"p {self.now_ms + 20}")
            self.status(1, k)
        return self.samples()

    def to_setpoint(self, *references: float) -> None:
        """References there in no time."""
        self.ok(Request.SETPOINT, setpoint(0.0, references))

    def status(self, run: int = 0, received: int = 0) -> Status:
        """The answer to ALIVE."""
        return Status.read(self.ok(Request.ALIVE, struct.pack("<II", run, received)), self.number)

    def taken(self) -> list[Frame]:
        """What came unasked, since last time."""
        out, self.frames = self.frames, []
        return out

    def samples(self, width: int = 11) -> np.ndarray:
        """All samples that came unasked, in order (ticks, width); ENDED stays."""
        mine = [Samples.read(f, width, self.number) for f in self.frames if f.type == Response.SAMPLES]
        self.frames = [f for f in self.frames if f.type != Response.SAMPLES]
        for before, after in pairwise(mine):
            assert after.first == before.first + len(before.table)
        return np.vstack([s.table for s in mine]) if mine else np.empty((0, width))

    def ended(self) -> Ended:
        """The one ENDED that came."""
        (one,) = (f for f in self.frames if f.type == Response.ENDED)
        self.frames.remove(one)
        return Ended.read(one.payload)
