"""The firmware under qemu-system-arm, and what its memory says: read by the monitor, past the protocol."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from loopshape.toolbox.rig import cortex_m
from loopshape.toolbox.rig.target.link import open_link
from loopshape.toolbox.rig.target.messages import Configuration, Request, State
from loopshape.toolbox.rig.target.session import Session

LIMITS = np.array([[-1.0, 1.0, np.inf], [-10.0, 10.0, np.inf]])
#: time as the instructions take, with none between them: nothing of the host's own time is in it
BY_INSTRUCTIONS_ALONE = ("-icount", "sleep=off")


def needs_the_board():
    """Skip where a program of Debian's is missing."""
    for program in (cortex_m.COMPILER, cortex_m.EMULATOR, "make"):
        if shutil.which(program) is None:
            pytest.skip(f"the emulated board needs {program}, which is not here")


@dataclass(frozen=True)
class Watched:
    """The firmware's `watched`: ticks done, the tick that made it safe, cycles of the longest and the latest tick."""

    ticks: int
    safe_at: int
    longest: int
    latest: int


class Monitor:
    """QEMU's monitor over a socket."""

    def __init__(self, path: Path, image: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        for _ in range(100):
            if path.exists():
                break
            time.sleep(0.05)
        self._socket.connect(str(path))
        self._answer()
        names = subprocess.run(["arm-none-eabi-nm", str(image)], capture_output=True, text=True, check=True).stdout
        self._at = re.search(r"^([0-9a-f]+) \w watched$", names, re.M)[1]

    def close(self) -> None:
        """End the conversation."""
        self._socket.close()

    def _answer(self) -> str:
        text = b""
        while not text.endswith(b"(qemu) "):
            text += self._socket.recv(4096)
        return text.decode()

    def ask(self, command: str) -> str:
        """A command's answer."""
        self._socket.send(f"{command}\n".encode())
        return self._answer()

    def watched(self) -> Watched:
        """What the firmware's memory says now."""
        return Watched(*self._words(int(self._at, 16), 4))

    def word(self, address: int) -> int:
        """A register or a word of memory."""
        return self._words(address, 1)[0]

    def _words(self, address: int, count: int) -> list[int]:
        said = self.ask(f"xp /{count}xw {address:#x}").rpartition(": ")[2]
        return [int(word, 16) for word in re.findall(r"0x([0-9a-f]{8})\b", said)]


@contextmanager
def board(*extra: str, rate_hz: float = cortex_m.RATE_HZ) -> Iterator[tuple[str, Monitor]]:
    """The port of a running board and its monitor."""
    needs_the_board()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "monitor"
        words = ("-monitor", f"unix:{path},server=on,wait=off", *extra)
        with cortex_m.running(rate_hz=rate_hz, extra=words) as (_, port):
            monitor = Monitor(path, cortex_m.firmware(rate_hz))
            with closing(monitor):
                yield port, monitor


@contextmanager
def session(port: str) -> Iterator[Session]:
    """A conversation with it."""
    with open_link(port, 0) as link:
        yield Session(link)


def configuration(*sections, watchdog_ms=250, blocks=(), size=1e-3):
    """Each loop's controller on the axis' angle; the commands are `size` times the sum, so that it hardly moves."""
    one = np.ones((len(sections), 1))
    return Configuration(one, size * one.T, sections, LIMITS, False, watchdog_ms, 0.0, blocks=blocks)


def armed(one: Session, wanted: Configuration) -> None:
    """From any state."""
    if one.status().state is not State.IDLE:
        one.ask(Request.DISARM)
    if one.status().state is State.FAULT:
        one.ask(Request.CLEAR)
    one.ask(Request.ARM, one.configure(wanted))


def executed(tmp_path: Path, units: list[Path], options: list[str], words: list[str]) -> str:
    """What a program of the tests prints on an emulated Cortex-M4F; it must end well."""
    needs_the_board()
    here, image = Path(__file__).parent, tmp_path / "program.elf"
    processor = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-nostartfiles"]
    given = "-DWORDS=" + ",".join(f'"{word}"' for word in ["program", *words])
    sources = [str(path) for path in (here / "semihosted.c", *units)]
    subprocess.run(
        [cortex_m.COMPILER, *processor, "-std=c99", "-O2", "-ffp-contract=off", *options, given, *sources,
         "-specs=rdimon.specs", "-T", str(here / "semihosted.ld"), "-lm", "-o", str(image)], check=True,
    )  # fmt: skip
    quiet = ["-display", "none", "-monitor", "none", "-serial", "none"]
    said = ["-semihosting-config", "enable=on,target=native", "-kernel", str(image)]
    ran = subprocess.run(
        [cortex_m.EMULATOR, "-M", "mps2-an386", *quiet, *said], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr[-2000:]
    return ran.stdout
