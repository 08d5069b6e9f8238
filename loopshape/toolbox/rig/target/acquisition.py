"""One recording on a target: upload, go, take in what streams back, ask again for what is missing, judge the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from loopshape.core.errors import RigError
from loopshape.core.units import Array
from loopshape.data.signal.experiment import Experiment
from loopshape.toolbox.gap.noise import start_state
from loopshape.toolbox.rig.steps.supervisor import Supervisor
from loopshape.toolbox.rig.target import messages
from loopshape.toolbox.rig.target.armed import Armed, beat_s, reason_words, vented
from loopshape.toolbox.rig.target.frames import Frame
from loopshape.toolbox.rig.target.messages import Ended, Payload, Reason, Request, Response, Samples, State
from loopshape.toolbox.rig.target.session import RefusedError

INJECTION = {"controller_input": 0, "plant_input": 1, "control": 2, "reference": 0}
NOT_NOW, GONE, UNKNOWN = 1, 3, 7  # refusals: not in this state, no longer in memory, no such run
LISTEN_S = 0.02
PATIENCE_S = 0.1  # so long does what was asked again take to come
STILL_S = 6.0  # longer than a target repeats the end of a run
RATE_TICKS = 10  # a rate is averaged over so many ticks: a converter's step is no alarm
KEPT_REASONS = (Reason.COMPLETE, Reason.LIMIT, Reason.RATE_LIMIT, Reason.MACHINE, Reason.TRIAL)


Arrived = Callable[[Mapping[str, Array]], None]


class Acquisition:
    """One recording while it runs."""

    def __init__(
        self, armed: Armed, e: Experiment, number: int, arrived: Arrived, supervisor: Supervisor | None = None
    ) -> None:
        self._supervisor, self._asked_to_end = supervisor, False
        self._armed, self._e, self._session = armed, e, armed.session
        self._samples = SampleTable(number, e.samples, self._session.identity.width(len(armed.loops)))
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

    def on_frame(self, frame: Frame) -> None:
        """A frame that came unasked."""
        if frame.type == Response.SAMPLES:
            new = self._samples.take(self._session.samples(frame, len(self._armed.loops)))
            self._watch(len(new))
        elif frame.type == Response.ENDED:
            ended = self._session.ended(frame)
            if ended.run == self._samples.run:
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
        self._alarm = self._alarm or self._samples.passed(new, places, limits, self._e.rate_hz, grain)
        if self._supervisor is not None and new:
            self._supervisor.first_trip(self._named(self._samples.table[self._samples.received - new :]))

    def run(self, place: bool) -> Ended:
        """Upload, go, take in until the end is told and all of it is here."""
        free = self._start(place)
        self._session.unasked = self.on_frame  # what came before belongs to an earlier recording
        self._upload(free)
        self._go()
        try:
            hand_on_s = 0.1  # so often what came is handed on
            while not self._is_whole():
                self._session.listen(LISTEN_S if self._samples.lacking == 0 else LISTEN_S / 4)
                if self._alarm is not None and self._ended is None:
                    self._stop_the_blind()
                self._supervised()
                self._fill()
                self._keep_alive()
                self._refuse_standstill()
                if time.monotonic() - self._handed_s > hand_on_s:
                    self._hand_on()
        finally:
            self._hand_on()
        return self._checked()

    def _supervised(self) -> None:
        """Look whether it is enough, and end what the supervisor ends, once."""
        one = self._supervisor
        if one is None or self._ended is not None:
            return
        one.look_beside(lambda n: {name: np.array(x) for name, x in self.columns(n).items()}, self._samples.received)
        if one.trip is not None and not self._asked_to_end:
            self._asked_to_end = self._closed = True
            with suppress(RefusedError):  # it ended by itself meanwhile
                self._session.ask(Request.VENT if one.trip.vents else Request.STOP)

    def _hand_on(self) -> None:
        """What came since the last time goes to whoever keeps it."""
        first, self._handed, self._handed_s = self._handed, self._samples.received, time.monotonic()
        if first < self._handed:
            self._arrived(self._named(self._samples.table[first : self._handed]))

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
        return self._ended is not None and self._samples.received >= self._ended.ticks

    def _checked(self) -> Ended:
        """The end as it was told; where the target passed a limit and did not act, the end that the host saw."""
        ended = self._ended
        assert ended is not None
        if self._alarm is None or ended.reason in KEPT_REASONS[1:]:
            with suppress(RigError):  # everything is here; whoever asks next is told
                self._alive()
            return ended
        vented(self._session)
        index, tick, value, limit = self._alarm
        low, high, _ = self._armed.configuration.limits[index]
        inside = low <= self._samples.table[tick, 3 * len(self._armed.loops) + index] <= high
        reason = Reason.RATE_LIMIT if inside else Reason.LIMIT
        sentence = "the target did not act, the host vented it"
        return Ended(ended.run, tick + 1, reason, index, tick, value, limit, sentence)

    def _refuse_standstill(self) -> None:
        """A target that answers and gets no further is given up."""
        mark = (self._samples.received, self._samples.newest, self._uploaded, self._ended is not None)
        now = time.monotonic()
        if mark != self._mark:
            self._mark, self._moved_s = mark, now
        if now - self._moved_s > STILL_S + self._armed.settings.soft_start_s:
            raise RigError(
                f"the target gets no further with {self._e.name!r}",
                f"{self._samples.received} of {self._e.samples} ticks",
                "the recording is not kept; look at the target",
            )

    @property
    def _id(self) -> bytes:
        return self._samples.run.to_bytes(4, "little")

    def _start(self, place: bool) -> int:
        payload = messages.start_payload(
            self._samples.run,
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
            payload = messages.rows(self._samples.run, self._uploaded, part, self._session.identity.number)
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
        free = buffer - (self._uploaded - self._samples.received)
        if free > buffer // 4:
            self._upload(free)

    def _keep_alive(self) -> None:
        """Say that the host is there and what it has; ask again for what is missing."""
        if self._ended is not None:
            self._samples.newest = max(self._samples.newest, self._ended.ticks)
        if self._samples.lacking:
            self._fetch()
        ahead = self._samples.received - self._acknowledged >= self._session.identity.memory_ticks // 4
        if ahead or self._session.silent_s() > beat_s(self._armed):
            self._alive()

    def _alive(self) -> None:
        received = self._samples.received
        status = self._session.status(self._samples.run, received + self._is_whole())
        self._acknowledged = received
        if status.run == self._samples.run:  # what it had at the time before should have come by now
            self._samples.newest = max(self._samples.newest, self._ticks_said)
            self._ticks_said = min(status.tick, self._e.samples)
        elif self._ended is None:
            raise RigError("the target forgot the recording", f"{self._e.name!r}", "it was restarted: begin anew")

    def _fetch(self) -> None:
        first, lacking = self._samples.received, min(self._samples.lacking, 512)
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
        return {"t_s": np.arange(ticks) / self._e.rate_hz} | self._named(self._samples.table[:ticks])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns that arrive."""
        return tuple(self._named(self._samples.table[:0]))

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


class SampleTable:
    """A table (ticks, width) that fills from the front; `received` ticks are there, `newest` was seen."""

    def __init__(self, run: int, ticks: int, width: int) -> None:
        self.run, self.received, self.newest = run, 0, 0
        self._table = np.empty((ticks, width))

    def take(self, samples: Samples) -> Array:
        """Add samples; gives those that are new and in place (k, width). What comes after a gap is sent again later."""
        end = samples.first + len(samples.table)
        if samples.run != self.run or end > len(self._table):
            return self._table[:0]
        self.newest = max(self.newest, end)
        if not samples.first <= self.received < end:
            return self._table[:0]
        start = self.received
        self._table[start:end] = samples.table[start - samples.first :]
        self.received = end
        return self._table[start:end]

    @property
    def lacking(self) -> int:
        """Ticks that were seen to be missing."""
        return self.newest - self.received

    @property
    def table(self) -> Array:
        """What is there (received, width)."""
        return self._table[: self.received]

    def passed(
        self, new: int, places: slice, limits: Array, rate_hz: float, grain: float = 2.0**-52
    ) -> tuple[int, int, float, float] | None:
        """The first limit that the last `new` ticks pass: column of `places`, tick, value, limit; None if none is.

        `limits` (columns, 3) low, high and rate a second; a rate counts from RATE_TICKS on. `grain` is the relative
        rounding of what arrived: what the target found within its limits is within them here too. NaN passes them.
        """
        first = max(0, self.received - new)
        values = self._table[max(0, first - RATE_TICKS) : self.received, places]
        mine = values[-(self.received - first) :] if new else values[:0]
        rates = np.abs(values[RATE_TICKS:] - values[:-RATE_TICKS]) * (rate_hz / RATE_TICKS)
        slack = grain * np.abs(limits[:, :2]).max(axis=1)
        blur = slack * 2.0 * rate_hz / RATE_TICKS
        for found, low, high, back in (
            (mine, limits[:, 0] - slack, limits[:, 1] + slack, len(mine)),
            (rates, -np.inf, limits[:, 2] * (1.0 + grain) + blur, len(rates)),
        ):
            over = ~((found >= low) & (found <= high))
            if over.any():
                tick, column = (int(k) for k in np.argwhere(over)[0])
                value = float(found[tick, column])
                bound = float(limits[column, 2 if found is rates else (0 if value < limits[column, 0] else 1)])
                return column, self.received - back + tick, value, bound
        return None
