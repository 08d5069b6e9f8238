"""Frames of the target's protocol for the target in Python: COBS with a CRC-32, written from docs/protocol.md alone."""

import struct
import zlib

MOST_ENCODED = 1024


def stuffed(data: bytes) -> bytes:
    """COBS of bytes, without the 0 at the end."""
    out, block = bytearray(), bytearray()
    for byte in data:
        if byte == 0:
            out += bytes([len(block) + 1]) + block
            block.clear()
            continue
        block.append(byte)
        if len(block) == 254:
            out += b"\xff" + block
            block.clear()
    return bytes(out + bytes([len(block) + 1]) + block)


def unstuffed(data: bytes) -> bytes | None:
    """What COBS packed; None where it does not decode."""
    out, at = bytearray(), 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            return None
        out += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)


def frame(kind: int, tag: int, payload: bytes = b"") -> bytes:
    """A whole frame with its 0."""
    body = struct.pack("<BH", kind, tag) + payload
    return stuffed(body + struct.pack("<I", zlib.crc32(body))) + b"\0"


def body_of(encoded: bytes) -> bytes | None:
    """The body of a frame without its 0; None where it is to be dropped."""
    if len(encoded) > MOST_ENCODED:
        return None
    decoded = unstuffed(encoded)
    if decoded is None or len(decoded) < 7:
        return None
    body, crc = decoded[:-4], struct.unpack("<I", decoded[-4:])[0]
    return body if zlib.crc32(body) == crc else None


class Collector:
    """Bytes in, bodies out; counts what it drops and never holds more than one frame's bytes."""

    def __init__(self) -> None:
        self.bad = 0
        self._bytes = bytearray()

    def take(self, data: bytes) -> list[bytes]:
        bodies = []
        for byte in data:
            if byte:
                if len(self._bytes) <= MOST_ENCODED:
                    self._bytes.append(byte)
                continue
            if self._bytes:
                body = body_of(bytes(self._bytes))
                self._bytes.clear()
                if body is None:
                    self.bad += 1
                else:
                    bodies.append(body)
        return bodies
