"""One recording on a target: upload, go, take in what streams back, ask again for what is missing, judge the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from loopshape.core.errors import RigError
from loopshape.core.kernels.noise import start_state
from loopshape.core.units import Array
from loopshape.data.signal.experiment import Experiment
from loopshape.toolbox.rig.target import messages
from loopshape.toolbox.rig.target.armed import Armed, beat_s, reason_words, vented
from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.intake import Intake
from loopshape.toolbox.rig.target.messages import Ended, Payload, Reason, Request, Response, State
from loopshape.toolbox.rig.target.session import RefusedError

INJECTION = {"controller_input": 0, "plant_input": 1, "control": 2, "reference": 0}
NOT_NOW, GONE, UNKNOWN = 1, 3, 7  # refusals: not in this state, no longer in memory, no such run
LISTEN_S = 0.02
HAND_ON_S = 0.1  # so often what came is handed on
PATIENCE_S = 0.1  # so long does what was asked again take to come
STILL_S = 6.0  # longer than a target repeats the end of a run
KEPT = (Reason.COMPLETE, Reason.LIMIT, Reason.RATE_LIMIT, Reason.MACHINE)


Arrived = Callable[[Mapping[str, Array]], None]


class Taking:
    """One recording while it runs."""

    def __init__(self, armed: Armed, e: Experiment, number: int, arrived: Arrived) -> None:
        self._armed, self._e, self._session = armed, e, armed.session
        self._intake = Intake(number, e.samples, self._session.identity.width(len(armed.loops)))
        self._ended: Ended | None = None
        self._mask, self._rows = moving(e)
        self._uploaded = 0
        self._acknowledged = 0
        self._ticks_said = 0
        self._closed = False  # the target takes no more rows
        self._asked_to, self._asked_s = 0, -PATIENCE_S
        self._mark, self._moved_s = (0, 0, 0, False), time.monotonic()
        self._arrived, self._handed, self._handed_s = arrived, 0, time.monotonic()
        self._alarm: tuple[int, int, float, float] | None = None

    def told(self, frame: Frame) -> None:
        """A frame that came unasked."""
        if frame.type == Response.SAMPLES:
            new = self._intake.take(self._session.samples(frame, len(self._armed.loops)))
            self._watch(len(new))
        elif frame.type == Response.ENDED:
            ended = self._session.ended(frame)
            if ended.run == self._intake.run:
                self._ended = self._ended or self._believed(ended)

    def _believed(self, ended: Ended) -> Ended:
        """Refuses an end that the recording contradicts."""
        short = ended.reason is Reason.COMPLETE and ended.ticks < self._e.samples
        if short or ended.ticks > self._e.samples:
            raise RigError(
                f"the target says that {self._e.name!r} ended with another length than it has",
                f"{ended.reason.name.lower()} after {ended.ticks} of {self._e.samples} ticks",
                "the recording is not kept",
            )
        return ended

    def _watch(self, new: int) -> None:
        """The host's own look at the limits."""
        places = slice(3 * len(self._armed.loops), None)
        limits = self._armed.configuration.limits
        grain = 2.0 ** (-52 if self._session.identity.number == "<f8" else -23)
        self._alarm = self._alarm or self._intake.passed(new, places, limits, self._e.rate_hz, grain)

    def run(self, place: bool) -> Ended:
        """Upload, go, take in until the end is told and all of it is here."""
        free = self._begin(place)
        self._session.unasked = self.told  # what came before belongs to an earlier recording
        self._upload(free)
        self._go()
        try:
            while not self._is_whole():
                self._session.listen(LISTEN_S if self._intake.lacking == 0 else LISTEN_S / 4)
                if self._alarm is not None and self._ended is None:
                    self._stop_the_blind()
                self._fill()
                self._keep_alive()
                self._refuse_standstill()
                if time.monotonic() - self._handed_s > HAND_ON_S:
                    self._hand_on()
        finally:
            self._hand_on()
        return self._judged()

    def _hand_on(self) -> None:
        """What came since the last time goes to whoever keeps it."""
        first, self._handed, self._handed_s = self._handed, self._intake.received, time.monotonic()
        if first < self._handed:
            self._arrived(self._named(self._intake.table[first : self._handed]))

    def _go(self) -> None:
        try:
            self._session.ask(Request.GO, self._id)
        except RefusedError as error:
            status = self._session.status()
            raise RigError(
                f"the target does not start {self._e.name!r}",
                f"{status.state.name.lower()}{reason_words(status.fault)}; {error.received}",
                "look at the machine",
            ) from None

    def _is_whole(self) -> bool:
        return self._ended is not None and self._intake.received >= self._ended.ticks

    def _judged(self) -> Ended:
        """The end as it was told; where the target passed a limit and did not act, the end that the host saw."""
        ended = self._ended
        assert ended is not None
        if self._alarm is None or ended.reason in KEPT[1:]:
            with suppress(RigError):  # everything is here; whoever asks next is told
                self._alive()
            return ended
        vented(self._session)
        index, tick, value, limit = self._alarm
        low, high, _ = self._armed.configuration.limits[index]
        inside = low <= self._intake.table[tick, 3 * len(self._armed.loops) + index] <= high
        reason = Reason.RATE_LIMIT if inside else Reason.LIMIT
        sentence = "the target did not act, the host vented it"
        return Ended(ended.run, tick + 1, reason, index, tick, value, limit, sentence)

    def _refuse_standstill(self) -> None:
        """A target that answers and gets no further is given up."""
        mark = (self._intake.received, self._intake.newest, self._uploaded, self._ended is not None)
        now = time.monotonic()
        if mark != self._mark:
            self._mark, self._moved_s = mark, now
        if now - self._moved_s > STILL_S + self._armed.settings.soft_start_s:
            raise RigError(
                f"the target gets no further with {self._e.name!r}",
                f"{self._intake.received} of {self._e.samples} ticks",
                "the recording is not kept; look at the target",
            )

    @property
    def _id(self) -> bytes:
        return self._intake.run.to_bytes(4, "little")

    def _begin(self, place: bool) -> int:
        payload = messages.begin(
            self._intake.run,
            self._e.samples,
            INJECTION[self._e.injection],
            self._mask,
            start_state(self._e.seed),
            place,
        )
        return Payload(self._session.ask(Request.BEGIN, payload)).one("I")

    def _upload(self, room: int) -> None:
        """Send as many rows as there is room for, once: what else is to be done must not wait for the last of them."""
        most = messages.rows_a_frame(self._rows.shape[1], self._session.identity.number)
        end = min(len(self._rows) if self._rows.shape[1] else 0, self._uploaded + room)
        while self._uploaded < end and self._ended is None and not self._closed and self._alarm is None:
            part = self._rows[self._uploaded : min(end, self._uploaded + most)]
            payload = messages.rows(self._intake.run, self._uploaded, part, self._session.identity.number)
            try:
                taken, _ = Payload(self._session.ask(Request.ROWS, payload)).take("II")
            except RefusedError as error:
                if error.code not in (NOT_NOW, UNKNOWN):
                    raise
                self._closed = True  # the run ended meanwhile, or the target forgot it: both are told soon
                return
            if not self._uploaded < taken <= len(self._rows):
                self._uploaded = min(taken, len(self._rows))
                return
            self._uploaded = taken

    def _fill(self) -> None:
        if not self._rows.shape[1]:
            return
        buffer = self._session.identity.buffer_rows
        free = buffer - (self._uploaded - self._intake.received)
        if free > buffer // 4:
            self._upload(free)

    def _keep_alive(self) -> None:
        """Say that the host is there and what it has; ask again for what is missing."""
        if self._ended is not None:
            self._intake.newest = max(self._intake.newest, self._ended.ticks)
        if self._intake.lacking:
            self._fetch()
        ahead = self._intake.received - self._acknowledged >= self._session.identity.memory_ticks // 4
        if ahead or self._session.silent_s() > beat_s(self._armed):
            self._alive()

    def _alive(self) -> None:
        received = self._intake.received
        status = self._session.status(self._intake.run, received + self._is_whole())
        self._acknowledged = received
        if status.run == self._intake.run:  # what it had at the time before should have come by now
            self._intake.newest = max(self._intake.newest, self._ticks_said)
            self._ticks_said = min(status.tick, self._e.samples)
        elif self._ended is None:
            raise RigError("the target forgot the recording", f"{self._e.name!r}", "it was restarted: begin anew")

    def _fetch(self) -> None:
        first, lacking = self._intake.received, min(self._intake.lacking, 512)
        now = time.monotonic()
        if first < self._asked_to and now - self._asked_s < PATIENCE_S:
            return
        self._asked_to, self._asked_s = first + lacking, now
        payload = self._id + first.to_bytes(4, "little") + lacking.to_bytes(2, "little")
        try:
            self._session.ask(Request.AGAIN, payload)
        except RefusedError as error:
            if error.code != GONE:
                raise
            raise RigError(
                f"samples of {self._e.name!r} are lost: the target no longer has them",
                f"ticks from {first} on",
                "the recording is not kept; use a faster connection, or fewer columns",
            ) from None

    def _stop_the_blind(self) -> None:
        """A limit is passed in what arrived and the target has not ended the run: stop it from here."""
        self._session.listen(LISTEN_S)
        if self._ended is None and self._session.status().state is State.RUNNING:
            self._session.ask(Request.VENT)

    def columns(self, ticks: int) -> dict[str, Array]:
        """The recording's columns, as a run folder has them."""
        return {"t_s": np.arange(ticks) / self._e.rate_hz} | self._named(self._intake.table[:ticks])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns that arrive."""
        return tuple(self._named(self._intake.table[:0]))

    def _named(self, table: Array) -> dict[str, Array]:
        """Columns of some ticks (k, width), without their time."""
        loops, free = self._e.loops, self._e.injection == "control"
        out: dict[str, Array] = {}
        for k, loop in enumerate(loops):
            if loop.reference is not None:
                out[loop.reference] = table[:, k]
            if loop.injected is not None:
                out[loop.injected] = np.zeros(len(table)) if free else table[:, len(loops) + k]
            out[loop.control] = table[:, 2 * len(loops) + k]
        return out | {name: table[:, 3 * len(loops) + k] for k, name in enumerate(self._armed.columns)}


def moving(e: Experiment) -> tuple[int, Array]:
    """Bits of the columns that move, and their rows (n, columns): of loop k r is bit 2k, what is injected 2k + 1."""
    both = [column for k in range(len(e.loops)) for column in (e.references[:, k], e.injected[:, k])]
    still = [float(c[0]) if k % 2 == 0 else 0.0 for k, c in enumerate(both)]
    bits = [k for k, column in enumerate(both) if np.any(column != still[k])]
    rows = np.column_stack([both[k] for k in bits]) if bits else np.empty((e.samples, 0))
    return sum(1 << k for k in bits), rows
