"""The target's firmware for a Cortex-M4F, an axis simulated on the chip, under qemu-system-arm: its UART is a TCP port.

Time goes by instructions, 8 ns each (`-icount`): a machine that is busy makes the chip slow, and no tick is lost.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import socket
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.toolbox.rig.emulator import FIRMWARE_SOURCES, NoCompilerError, kept, own_sources, stop, version

FOLDER = "boards/cortex_m"
COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
INSTALL = "install Debian's qemu-system-arm, gcc-arm-none-eabi, libnewlib-arm-none-eabi and make, or their like"
RAM = 0x20000000
NS_OF_AN_INSTRUCTION = 8  # 1.34 cycles of 168 MHz: a power of two is all that -icount takes
RATE_HZ = 2000.0

#: ends the program that takes this shell's place, once whoever started it is gone
_WATCHED = 'exec 9<&0; (cat <&9; kill $$) >/dev/null 2>&1 & exec 9<&-; exec "$@"'


def chosen(
    board: str, tcp: int, rate_hz: float | None, arm: Mapping[str, object]
) -> AbstractContextManager[tuple[subprocess.Popen[str], str]]:
    """`running` for a board's name; refuses another name, and options of the simulated arm alone (`arm`, by name)."""
    refuse_unknown("a board is not known", board, ("cortex_m",))
    if given := [name for name, value in arm.items() if value]:
        raise WrongUseError("these options are the simulated arm's", ", ".join(given), "leave them out, or the board")
    return running(tcp, RATE_HZ if rate_hz is None else rate_hz)


def firmware(rate_hz: float = RATE_HZ, *options: str) -> Path:
    """The firmware (ELF) at a rate in Hz; built where this version has not been built by this compiler yet.

    `options` are the Makefile's, as `MACHINE=drive`. Refuses a missing compiler, and a rate outside 1 to 5 kHz.
    """
    if not (1000.0 <= rate_hz <= 5000.0 and 168_000_000 % rate_hz == 0):
        raise WrongUseError("the board's rate lies between 1000 and 5000 Hz and divides 168 MHz", f"{rate_hz:g} Hz")
    _needed(COMPILER, "make")
    words = [f"RATE_HZ={rate_hz:.0f}", *options]

    def build(folder: Path) -> Path:
        made = subprocess.run(
            ["make", "-C", str(folder / FOLDER), *words], capture_output=True, text=True, check=False
        )  # fmt: skip
        if made.returncode:
            raise NoCompilerError("the firmware does not compile", made.stderr[-800:].strip(), INSTALL)
        return folder / FOLDER / "build" / "target.elf"

    return kept("firmware", [*words, version(COMPILER)], own_sources(FIRMWARE_SOURCES), build)


def start(tcp: int = 0, rate_hz: float = RATE_HZ, extra: Sequence[str] = ()) -> tuple[subprocess.Popen[str], str]:
    """The emulated board as a process, and its port, tcp://127.0.0.1:N; it ends with its input.

    `extra` are words for QEMU.
    """
    image = firmware(rate_hz)
    _needed(EMULATOR)
    try:
        listener = socket.create_server(("127.0.0.1", tcp))
    except (OSError, OverflowError) as error:
        raise WrongUseError(
            "the TCP port cannot be opened", f"{tcp}: {error}", "choose another, or 0 for any"
        ) from None
    with listener:
        handle = fcntl.fcntl(listener, fcntl.F_DUPFD, 10)  # a shell numbers 0 to 9
        process = subprocess.Popen(
            ["sh", "-c", _WATCHED, "sh", EMULATOR, *_words(image, handle), *extra],
            pass_fds=[handle], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        os.close(handle)
        return process, f"tcp://127.0.0.1:{listener.getsockname()[1]}"


def _words(image: Path, handle: int) -> list[str]:
    """An STM32F405 whose USART2 is the socket, through a multiplexer's 32 bytes of buffer, whose escape is no byte."""
    noise = f"loader,addr={RAM:#x},data={secrets.randbits(64)},data-len=8"  # as power-up leaves memory
    line = f"socket,id=line,fd={handle},server=on,wait=off,nodelay=on,mux=on"
    return [
        "-M", "netduinoplus2", "-icount", f"shift={NS_OF_AN_INSTRUCTION.bit_length() - 1}", "-kernel", str(image),
        "-device", noise, "-chardev", line, "-serial", "null", "-serial", "chardev:line", "-echr", "0x100",
        "-display", "none", "-monitor", "none",
    ]  # fmt: skip


@contextmanager
def running(
    tcp: int = 0, rate_hz: float = RATE_HZ, extra: Sequence[str] = ()
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process of an emulated board and its port; it is stopped at the end."""
    process, port = start(tcp, rate_hz, extra)
    try:
        yield process, port
    finally:
        stop(process)


def _needed(*programs: str) -> None:
    for one in programs:
        if shutil.which(one) is None:
            raise NoCompilerError("the board is emulated from programs that are not here", repr(one), INSTALL)
