"""The target in Python, asked request by request as the bench of the core in C is."""

import struct

from axis_study import target
from python_target_frames import body_of

from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.messages import Response


class Second:
    """Two axes; `board` is what its `Board` says otherwise."""

    def __init__(self, **board: object) -> None:
        self.target, self.tag = target(2, **board), 0

    def ok(self, what: int, payload: bytes = b"") -> bytes:
        """Ask what must be done."""
        kind, said = self._asked(what, payload)
        assert kind == Response.OK, (what, said)
        return said

    def no(self, what: int, payload: bytes = b"") -> int:
        """Ask what must be refused; the code."""
        kind, said = self._asked(what, payload)
        assert kind == Response.NO, what
        return int(struct.unpack("<H", said[:2])[0])

    def close(self) -> None:
        """Nothing to close."""

    def _asked(self, what: int, payload: bytes) -> tuple[int, bytes]:
        self.tag += 1
        self.target.take(Frame(what, self.tag, payload).encoded)
        return self.answers()[-1]

    def answers(self) -> list[tuple[int, bytes]]:
        """What waits for the line, as types and payloads."""
        bodies = [body_of(self.target.out.popleft()[:-1]) for _ in range(len(self.target.out))]
        return [(body[0], body[3:]) for body in bodies]
