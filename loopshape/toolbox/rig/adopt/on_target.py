"""A trial on a real-time target: both controllers run there, the host steps, records and says that it is there."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

from loopshape.core.errors import RigError
from loopshape.data.control.controller import Controller
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.io.run.run_folder import add_recording, start_run
from loopshape.io.run.run_tables import recording_table
from loopshape.toolbox.rig.simulated import Planned, Rig, experiment, header, plan
from loopshape.toolbox.rig.study import Study
from loopshape.toolbox.rig.target.acquisition import Arrived
from loopshape.toolbox.rig.target.armed import Armed, beat_s, reason_words
from loopshape.toolbox.rig.target.messages import Request, State
from loopshape.toolbox.rig.target.session import RefusedError
from loopshape.toolbox.rig.target.stream_log import adopted, open_stream_log
from loopshape.toolbox.rig.target.target import Keeper, record
from loopshape.toolbox.rig.target.trial import Phase, Progress, Watch

#: time constant with which a shift follows the difference of both controllers, and how many of them it is given
TRACK_S, TRACKED = 0.1, 5.0
#: how much longer than its ticks a ramp may take
LATE = 3.0


@dataclass(eq=False)
class OnTarget:
    """A `Machine` of an armed target, and the runs that it leaves in `folder`: one a share, a000, a025, ..."""

    armed: Armed
    study: Study
    plant: Rig
    planned: Planned
    folder: Path
    extra: dict[str, object]
    _numbers: count = field(default_factory=lambda: count(1))

    def record(self, share: float, controller: Controller, watch: Watch | None, longer: float) -> Recording | None:
        """As `Machine.record`; the run of a share lies in a folder of its own, under the controller that closed it."""
        name = f"a{round(100.0 * share):03d}" + ("" if longer == 1.0 else "-longer")
        name += "-again" if (self.folder / name).exists() else ""
        study, planned = self._of(controller, name, longer)
        e = experiment(study, self.plant, planned)
        if watch is not None:
            self._rest(TRACKED * TRACK_S)
            self.armed.session.ask(Request.BLEND, watch.payload())
            if self._ramped(watch).phase is not Phase.ON_TRIAL:
                return None
        folder = self.folder / name
        start_run(folder, header(study, self.plant, self.extra))

        def keeper(info: RecordingInfo, rate_hz: float, names: Sequence[str]) -> AbstractContextManager[Arrived]:
            return open_stream_log(folder, info.name, recording_table(info), rate_hz, names)

        if (made := self._made(e, keeper)) is None:
            return None
        with self.thinking():
            add_recording(folder, made, again=True)
            adopted(folder, made.info.name)
        return made

    def _made(self, e: Experiment, keeper: Keeper) -> Recording | None:
        """The recording; once more where the line was too slow for it, None where the target went back before it."""
        for again in (True, False):
            try:
                return record(self.armed, e, next(self._numbers), keeper, None)[0]
            except RigError:
                if self.progress().phase is Phase.WENT_BACK:
                    return None
                if not again or self.armed.session.status().state is not State.ARMED:
                    raise
        return None

    def _of(self, controller: Controller, name: str, longer: float) -> tuple[Study, Planned]:
        """The study and its one experiment with this controller in its loop, so many times as long."""
        study = replace(self.study, controllers={**self.study.controllers, controller.loop: controller.blocks})
        template = self.planned.template
        signal: Any = template.excitation
        longest = replace(signal, periods=round(longer * signal.periods))
        template = replace(template, excitation=longest, operating_points=(self.planned.operating_point,))
        (planned,) = plan(replace(study, experiments=(template,)), self.plant)
        return study, replace(planned, name=name, seed=self.planned.seed + round(1e4 * longer))

    def experiment(self) -> Experiment:
        """What is recorded at each share."""
        return experiment(self.study, self.plant, self.planned)

    def progress(self) -> Progress:
        """Where the trial is."""
        return Progress.read(self.armed.session.ask(Request.PROGRESS))

    def keep(self, watch: Watch) -> Progress:
        """The new controller stays, and stays watched, while the target is armed."""
        with suppress(RefusedError):  # it went back meanwhile
            self.armed.session.ask(Request.BLEND, watch.payload())
        return self.progress()

    def back(self) -> None:
        """To the old controller; a target that is there already says that it is."""
        watch = Watch(0.0, 0, 1, 1)
        if self.progress().phase is Phase.ON_TRIAL:
            self.armed.session.ask(Request.BLEND, watch.payload())

    def fault(self) -> str:
        """Why the machine stands still, "" where it does not."""
        status = self.armed.session.status()
        return f"the machine stopped{reason_words(status.fault)}" if status.state is State.FAULT else ""

    def thinking(self) -> AbstractContextManager[None]:
        """A thread says that the host is there."""
        return self.armed.session.kept_alive(beat_s(self.armed))

    def _rest(self, seconds: float) -> None:
        """Nothing happens for so long."""
        session = self.armed.session
        for _ in range(int(seconds / beat_s(self.armed)) + 1):
            until = session.last_sent_s + beat_s(self.armed)
            session.status()
            session.listen_until(until)

    def _ramped(self, watch: Watch) -> Progress:
        """Once the share is reached, or the target went back."""
        most_s = 1.0 + LATE * watch.ramp / self.armed.session.identity.rate_hz
        for _ in range(int(most_s / beat_s(self.armed)) + 1):
            found = self.progress()
            if found.phase is not Phase.ON_TRIAL or found.ticks >= watch.ramp:
                return found
            self._rest(beat_s(self.armed))
        state = self.armed.session.status().state.name.lower()
        raise RigError(
            "the target gets no further with a trial", f"{found.ticks} of {watch.ramp} ticks, {state}",
            "look at the machine",
        )  # fmt: skip
