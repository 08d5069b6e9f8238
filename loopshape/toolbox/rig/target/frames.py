"""Frames of the target's protocol: COBS, CRC-32, and a receiver that no byte sequence can harm.

`docs/protocol.md` is the specification. COBS is Cheshire and Baker's consistent overhead byte stuffing
(IEEE/ACM Transactions on Networking 7, 1999): no zero inside a frame, one zero after it.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

from loopshape.core.errors import WrongUseError

LONGEST_PAYLOAD = 1000
LONGEST_ENCODED = 1024  # bytes between two zeros; more is dropped
HEAD = 3  # type, tag
CHECK = 4  # the CRC


@dataclass(frozen=True)
class Frame:
    """What a frame says: its type, its tag, and the payload."""

    type: int
    tag: int
    payload: bytes = b""

    @property
    def encoded(self) -> bytes:
        """The frame's bytes, its closing zero among them. Refuses a payload that is too long."""
        if len(self.payload) > LONGEST_PAYLOAD:
            raise WrongUseError(
                f"a payload of the protocol has at most {LONGEST_PAYLOAD} bytes", f"{len(self.payload)}", "send pieces"
            )
        body = bytes((self.type,)) + self.tag.to_bytes(2, "little") + self.payload
        return stuffed(body + zlib.crc32(body).to_bytes(CHECK, "little")) + b"\0"


def stuffed(data: bytes) -> bytes:
    """COBS: each run of up to 254 bytes other than zero, in front of it its length plus one."""
    out = bytearray()
    pieces = data.split(b"\0")
    for k, piece in enumerate(pieces):
        start = 0
        while len(piece) - start >= 254:
            out += b"\xff" + piece[start : start + 254]
            start += 254
        rest = piece[start:]
        if rest or start == 0 or k < len(pieces) - 1:  # a full run at the very end needs no more
            out += bytes((len(rest) + 1,)) + rest
    return bytes(out)


def unstuffed(data: bytes) -> bytes | None:
    """What was stuffed; None where a length leads past the end or a zero stands inside."""
    out, place = bytearray(), 0
    while place < len(data):
        length = data[place]
        end = place + length
        if length == 0 or end > len(data):
            return None
        piece = data[place + 1 : end]
        if 0 in piece:
            return None
        out += piece
        place = end
        if length < 0xFF and place < len(data):
            out.append(0)
    return bytes(out)


def opened(encoded: bytes) -> Frame | None:
    """The frame in the bytes between two zeros; None where they are none, whole and unchanged."""
    if len(encoded) > LONGEST_ENCODED:
        return None
    body = unstuffed(encoded)
    if body is None or not HEAD + CHECK <= len(body) <= HEAD + LONGEST_PAYLOAD + CHECK:
        return None
    content, check = body[:-CHECK], body[-CHECK:]
    if zlib.crc32(content) != int.from_bytes(check, "little"):
        return None
    return Frame(content[0], int.from_bytes(content[1:HEAD], "little"), content[HEAD:])


@dataclass
class Receiver:
    """Collects bytes and gives the frames in them; `bad` counts what was dropped. It holds at most one frame."""

    bad: int = 0
    _pending: bytearray = field(default_factory=bytearray)
    _spoilt: bool = False

    def take(self, data: bytes) -> Iterator[Frame]:
        """The frames that are whole after these bytes."""
        pieces = data.split(b"\0")
        for piece in pieces[:-1]:
            self._hold(piece)
            frame = self._close()
            if frame is not None:
                yield frame
        self._hold(pieces[-1])

    def _hold(self, piece: bytes) -> None:
        if len(self._pending) + len(piece) > LONGEST_ENCODED:
            self._spoilt = True
            self._pending.clear()
        elif not self._spoilt:
            self._pending += piece

    def _close(self) -> Frame | None:
        """The frame that a zero ends; counts one that is spoilt. Two zeros in a row are nothing."""
        encoded, spoilt = bytes(self._pending), self._spoilt
        self._pending.clear()
        self._spoilt = False
        if not encoded and not spoilt:
            return None
        frame = None if spoilt else opened(encoded)
        self.bad += frame is None
        return frame
