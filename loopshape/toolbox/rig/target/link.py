"""Bytes to and from a target: a serial port (pyserial, an extra), a pseudo-terminal, or TCP on this machine."""

from __future__ import annotations

import os
import re
import select
import socket
from abc import ABC, abstractmethod
from types import TracebackType

from loopshape.core.errors import RigError, WrongUseError

CHUNK = 65536
TCP = re.compile(r"tcp://(127(?:\.\d{1,3}){3}|localhost|\[?::1\]?):(\d{1,5})")
WRITE_S = 2.0  # a target that takes no bytes for so long is gone


class Link(ABC):
    """An open connection. What breaks it is a `RigError`; a read that finds nothing gives no bytes."""

    @abstractmethod
    def read(self, wait_s: float) -> bytes:
        """Bytes that have come, waiting at most `wait_s` for the first."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send all of it."""

    @abstractmethod
    def close(self) -> None:
        """End the connection; twice does no harm."""

    def __enter__(self) -> Link:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def open_link(port: str, baud: int) -> Link:
    """Open what a port's name means. Refuses TCP beyond this machine, a missing port, and serial without its extra."""
    if port.startswith("tcp:"):
        return _Socket(port)
    if not port.strip() or not os.path.exists(port):
        raise RigError("there is no such port", repr(port), "check the cable and the name, or name tcp://127.0.0.1:N")
    return _Terminal(port) if _pseudo(port) else _Serial(port, baud)


def _pseudo(port: str) -> bool:
    return os.path.realpath(port).startswith("/dev/pts/")


def _lost(port: str, error: object) -> RigError:
    return RigError(
        "the connection to the target is lost", f"{port}: {error}", "check the cable and the target's power"
    )


class _Descriptor(Link):
    """A connection that the system knows by number."""

    def __init__(self, port: str, handle: int) -> None:
        self._port, self._handle = port, handle
        os.set_blocking(handle, False)

    def read(self, wait_s: float) -> bytes:
        try:
            ready, _, _ = select.select([self._handle], [], [], max(0.0, wait_s))
            if not ready:
                return b""
            data = os.read(self._handle, CHUNK)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise _lost(self._port, error) from None
        if not data:
            raise _lost(self._port, "it was closed")
        return data

    def write(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            try:
                _, ready, _ = select.select([], [self._handle], [], WRITE_S)
                if not ready:
                    raise _lost(self._port, "it takes no bytes")
                left = left[os.write(self._handle, left) :]
            except BlockingIOError:
                continue
            except (OSError, ValueError) as error:
                raise _lost(self._port, error) from None


class _Terminal(_Descriptor):
    """A pseudo-terminal, raw."""

    def __init__(self, port: str) -> None:
        import termios
        import tty

        try:
            handle = os.open(port, os.O_RDWR | os.O_NOCTTY)
            tty.setraw(handle)
            termios.tcflush(handle, termios.TCIOFLUSH)
        except (OSError, termios.error) as error:
            raise RigError("the port cannot be opened", f"{port}: {error}", "is another program using it?") from None
        super().__init__(port, handle)

    def close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


class _Socket(_Descriptor):
    """TCP to this machine."""

    def __init__(self, port: str) -> None:
        found = TCP.fullmatch(port)
        if found is None or int(found.group(2)) > 65535:
            raise WrongUseError(
                "a TCP target is on this machine", repr(port), "write tcp://127.0.0.1:N, and tunnel to reach another"
            )
        host = found.group(1).strip("[]")
        try:
            self._socket = socket.create_connection((host, int(found.group(2))), timeout=WRITE_S)
        except OSError as error:
            raise RigError("no target answers there", f"{port}: {error}", "start it, or check the number") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super().__init__(port, self._socket.fileno())

    def close(self) -> None:
        self._socket.close()


class _Serial(Link):
    """A serial line, 8N1."""

    def __init__(self, port: str, baud: int) -> None:
        try:
            import serial
        except ImportError:
            raise WrongUseError(
                "a serial port needs pyserial", port, "install it: pip install 'loopshape[serial]'"
            ) from None
        self._port, self._failed = port, (serial.SerialException, OSError)
        try:
            self._line = serial.Serial(port, baud, timeout=0, write_timeout=WRITE_S, exclusive=True)
        except (*self._failed, ValueError) as error:
            raise RigError("the port cannot be opened", f"{port}: {error}", "is another program using it?") from None

    def read(self, wait_s: float) -> bytes:
        try:
            self._line.timeout = max(0.0, wait_s)
            first = self._line.read(1)
            self._line.timeout = 0
            return bytes(first + self._line.read(CHUNK)) if first else b""
        except self._failed as error:
            raise _lost(self._port, error) from None

    def write(self, data: bytes) -> None:
        try:
            self._line.write(data)
        except self._failed as error:
            raise _lost(self._port, error) from None

    def close(self) -> None:
        self._line.close()
