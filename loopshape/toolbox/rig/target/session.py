"""A conversation with a target: requests that are done once, samples without a silent gap, in one thread.

`docs/protocol.md` is the specification. While an answer is awaited samples are taken in; what cannot be understood is
counted and asked for again.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from itertools import count

from loopshape.core.errors import LoopshapeError, RigError
from loopshape.toolbox.rig.target import messages
from loopshape.toolbox.rig.target.frames import Frame, Receiver
from loopshape.toolbox.rig.target.link import Link
from loopshape.toolbox.rig.target.messages import (
    Configuration,
    Ended,
    Identity,
    Payload,
    Request,
    Response,
    Samples,
    Status,
)

ANSWER_S = 0.25
TRIES = 5
#: requests that may be done twice: each try has a tag of its own, as a repeated frame feeds no watchdog
_TWICE = (Request.ALIVE, Request.ROWS, Request.AGAIN)
NO_PLACE = 9  # refusal: another host is connected
BUSY_S = 60.0  # a host that is busy for longer than this is as good as gone


class Session:
    """An open link and what was said over it; `unasked` is called with each frame that no request waits for."""

    def __init__(self, link: Link, clock: Callable[[], float] = time.monotonic) -> None:
        self._link, self._clock = link, clock
        self._receiver, self._tags = Receiver(), count(time.monotonic_ns() // 1000)  # answers to another are no answer
        self._answer: Frame | None = None
        self.again_s = ANSWER_S
        self.vented = False  # the emergency stop was tried since the target was armed
        self._awaited: set[int] = set()
        self.unasked: Callable[[Frame], None] = lambda frame: None
        self.last_sent_s = clock()

    @cached_property
    def identity(self) -> Identity:
        """What the target says of itself, asked once."""
        return Identity.read(self.ask(Request.IDENTIFY, messages.PROTOCOL.to_bytes(2, "little")))

    @property
    def bad_frames(self) -> int:
        """How many frames arrived spoilt."""
        return self._receiver.bad

    def ask(self, what: Request, payload: bytes = b"") -> bytes:
        """Send a request until it is answered; its answer's payload. Refused or unanswered, it is a `RigError`."""
        self._awaited, self._answer = set(), None
        over = self._clock() + TRIES * ANSWER_S
        while self._clock() < over:
            if not self._awaited or what in _TWICE:
                tag = next(self._tags) % 65535 + 1
                self._awaited.add(tag)
            self._link.write(b"\0" + Frame(what, tag, payload).encoded)  # the zero ends what noise or a cut frame left
            self.last_sent_s = self._clock()
            until = min(over, self._clock() + self.again_s)
            while self._answer is None and self._clock() < until:
                self.listen(until - self._clock())
            if self._answer is not None:
                return self._accepted(what, self._answer)
        raise RigError(
            "the target does not answer", f"nothing to {what.name} in {TRIES * ANSWER_S:g} s", "check cable and power"
        )

    def _accepted(self, what: Request, answer: Frame) -> bytes:
        if answer.type == Response.OK:
            return answer.payload
        p = Payload(answer.payload)
        code = p.one("H")
        message = p.text()
        raise RefusedError(what, code, message)

    def listen(self, wait_s: float) -> None:
        """Take in what has come, waiting at most `wait_s`."""
        for frame in self._receiver.take(self._link.read(wait_s)):
            if frame.type in (Response.OK, Response.NO):
                if frame.tag in self._awaited:
                    self._answer = frame
            else:
                self._on_frame(frame)

    def _on_frame(self, frame: Frame) -> None:
        try:
            self.unasked(frame)
        except RigError:
            raise
        except LoopshapeError:  # whole by its CRC and still nonsense: as good as lost
            self._receiver.bad += 1

    def listen_until(self, time_s: float) -> None:
        """Take in what comes until then, by the session's clock."""
        while (left := time_s - self._clock()) > 0.0:
            self.listen(left)

    def watched(self, watchdog_ms: int) -> None:
        """From here on a lost request is sent again in time for the target's watchdog."""
        shortest_s = 0.02
        self.again_s = min(ANSWER_S, max(shortest_s, watchdog_ms / 3e3))

    @contextmanager
    def kept_alive(self, beat_s: float) -> Iterator[None]:
        """While the caller is busy with something else, a thread says that the host is there, for BUSY_S at most."""
        over, until = threading.Event(), self._clock() + BUSY_S

        def beat() -> None:
            try:
                while not over.wait(beat_s) and self._clock() < until:
                    self.status()
            except LoopshapeError:
                return  # whoever asks next is told

        thread = threading.Thread(target=beat, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def silent_s(self) -> float:
        """How long ago the last request was sent."""
        return self._clock() - self.last_sent_s

    def configure(self, configuration: Configuration) -> bytes:
        """Configure, and let the target confirm by its digest, which it must share; gives what ARM repeats."""
        for what, payload in configuration.frames():
            self.ask(what, payload)
        ready = self.ask(Request.READY)
        theirs, ours = Payload(ready).one("I"), configuration.digest
        if theirs != ours:
            raise RigError(
                "the target understood another configuration", f"digest {theirs:08x} for {ours:08x}", "do not arm it"
            )
        return ready

    def status(self, run: int = 0, received: int = 0) -> Status:
        """How the target is; tells it how many samples of a run are here without a gap."""
        payload = run.to_bytes(4, "little") + received.to_bytes(4, "little")
        return Status.read(self.ask(Request.ALIVE, payload), self.identity.number)

    def samples(self, frame: Frame, loops: int) -> Samples:
        """A frame of samples of this many loops."""
        return Samples.read(frame, self.identity.width(loops), self.identity.number)

    def ended(self, frame: Frame) -> Ended:
        """How a run ended."""
        return Ended.read(frame.payload)


class RefusedError(RigError):
    """The target said NO: `code` as in the protocol's page."""

    def __init__(self, what: Request, code: int, message: str) -> None:
        self.code = code
        word = messages.REFUSALS.get(code, f"code {code}")
        super().__init__(
            f"the target refuses {what.name}", f"{word}{': ' + message if message else ''}", "look at the target first"
        )
