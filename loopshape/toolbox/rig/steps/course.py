"""A study's experiments in the order in which they are made: steps of rising amplitude, then the recording itself."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import LoopshapeError, RigError, WrongUseError
from loopshape.core.units import TWO_PI
from loopshape.data.signal.channel import sum_terms
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.io.run.journal import note
from loopshape.io.run.run_folder import finished
from loopshape.toolbox.rig.effects import moves
from loopshape.toolbox.rig.excitation.excitation import ramp
from loopshape.toolbox.rig.settings import Limit
from loopshape.toolbox.rig.simulated import Planned, Rig, experiment
from loopshape.toolbox.rig.steps.enough import Look, Until, look
from loopshape.toolbox.rig.steps.escalation import (
    NOISE_PEAK,
    STILL_MOST,
    STILL_SHARE,
    STILL_STEPS,
    STILL_TICKS,
    STILL_TIMES,
    Climb,
    Escalation,
    Seen,
    Step,
    Trip,
    at_rest,
    exponent,
    tested,
)
from loopshape.toolbox.rig.steps.supervisor import Expected, Supervisor, cut
from loopshape.toolbox.rig.study import ExperimentTemplate, Study
from loopshape.verbs.watch import Watch


class StoppedAtLimitError(RigError):
    """A machine passed a limit, or a step says that nothing may move: what was recorded is kept, and a person looks."""


class Course:
    """What comes next in a study, from what came: `coming` gives experiments, `taken` is told each recording.

    Without an escalation and `until` they are the study's own. Steps are recordings NAME-a0 (at rest), NAME-a1, ...,
    held out of estimates (role "validation"), and lines of the run's journal.
    """

    def __init__(
        self, study: Study, plant: Rig, folder: Path, watch: Watch,
        escalation: Escalation | None = None, until: Until | None = None,
    ) -> None:  # fmt: skip
        self._study, self.plant, self.folder, self.watch = study, plant, folder, watch
        self._escalation, self._until = escalation, until
        self.limits: Mapping[str, Limit] = study.target.limits if study.target else study.limits
        if escalation is not None and not self.limits:
            raise WrongUseError("an escalation needs limits to keep away from", "none", "write [limits] in the study")
        if until is not None:
            for template in study.experiments:
                _refuse_endless(template, until)
        self._past: tuple[Seen, ...] = ()
        self._step, self._percent = False, 100.0
        self._supervisor: Supervisor | None = None
        self._last: Recording | None = None

    @property
    def plain(self) -> bool:
        """Whether nothing but the study's own recordings comes, whole or up to a limit."""
        return self._escalation is None and self._until is None

    @property
    def in_step(self) -> bool:
        """Whether the experiment under way is a step, and not a recording of the study."""
        return self._step

    def ready(self, todo: Sequence[Planned]) -> None:
        """Estimate from made-up numbers what the first experiment will be estimated from: kernels are compiled on their
        first call, which takes longer than a watchdog waits."""
        planned = next((one for one in todo if one.template.excites is not None), None)
        if planned is None or self.plain:
            return
        e = experiment(self._study, self.plant, planned)
        k = [one.name for one in e.loops].index(str(e.excites))
        loop, n = e.loops[k], e.injected[:, k] + e.references[:, k] - e.references[0, k]
        y = 0.1 * np.convolve(n, 0.9 ** np.arange(1, 100))[: n.size]
        y += 0.01 * float(np.std(y)) * np.random.default_rng(0).standard_normal(n.size)
        columns = {"t_s": np.arange(n.size) / e.rate_hz, loop.control: n - y}
        columns |= {column: y / len(sum_terms(loop.output)) for column in sum_terms(loop.output)}
        columns |= {
            name: x for name, x in ((loop.reference, e.references[:, k]), (loop.injected, e.injected[:, k])) if name
        }
        with suppress(LoopshapeError):
            info = replace(RecordingInfo.of(e), role="estimation")
            look(Recording(info, e.rate_hz, columns), loop, self._until or Until(0.5))

    def coming(self, todo: Sequence[Planned]) -> Iterator[Experiment]:
        """The experiments in order; each next one follows from what was `taken`. Raises `StoppedAtLimitError`."""
        for planned in todo:
            self._past, self._step = (), False
            if planned.template.excitation is None or self._escalation is None:
                yield experiment(self._study, self.plant, planned)
                continue
            percent = yield from self._climbed(planned, self._escalation)
            self._step = False
            yield self._made(planned, percent)

    def _climbed(self, planned: Planned, settings: Escalation) -> Generator[Experiment, None, float]:
        """Steps up to the largest amplitude at which the recording may be made, in percent."""
        commands = self._commands(planned)
        self._step = True
        first = self._free(planned.name)
        yield self._resting(planned, first)
        assert self._last is not None
        step, seen = at_rest(self._last, self.limits, commands)
        self._past = (seen,)
        self._report(planned, step)
        percent, best, number = settings.start_percent, 0.0, first
        loop = next(one for one in planned.loops if one.name == planned.template.excites)
        climb = Climb(loop, settings, self.limits, commands, self._until)
        while step.stop is None:
            number += 1
            e = self._made(planned, percent, number)
            yield e
            trip = self._supervisor.trip if self._supervisor else None
            share = self._share(planned, e)
            step, seen = tested(self._last, climb, percent, self._past, share, trip)
            self._report(planned, step)
            if step.valid and trip is None:
                self._past, best = (*self._past, seen), percent
            percent = step.next_percent or percent
        if not step.stop.records or best == 0.0:
            raise StoppedAtLimitError(
                f"no recording of {planned.name!r} is made", step.sentence,
                "look at the machine; the journal has every step",
            )  # fmt: skip
        return best

    def _commands(self, planned: Planned) -> frozenset[str]:
        target = self._study.target
        return frozenset(target.commands if target else (one.control for one in planned.loops)) & self.limits.keys()

    def _report(self, planned: Planned, step: Step) -> None:
        note(self.folder, "step", of=planned.name, **step.to_dict())
        (self.watch.say if step.valid else lambda line: self.watch.warn([line]))(step.sentence)

    def _looked(self, found: Look) -> None:
        note(self.folder, "look", **found.to_dict())
        self.watch.say(found.sentence)

    def _free(self, name: str) -> int:
        """The number of the first step: those of a climb that was interrupted are kept."""
        steps = [one.removeprefix(f"{name}-a") for one in finished(self.folder) if one.startswith(f"{name}-a")]
        return 1 + max((int(one) for one in steps if one.isdigit()), default=-1)

    def _resting(self, planned: Planned, number: int) -> Experiment:
        """The step without excitation, as long as a step."""
        t = planned.template
        signal: Any = t.excitation
        rest = replace(
            t, excitation=None, excites=None, excites_also={}, kind="none", role="validation", lead_s=0.0, tail_s=0.0,
            duration_s=max(1.0, float(signal.period_s or 1.0)),
        )  # fmt: skip
        return experiment(self._study, self.plant, replace(planned, template=rest, name=f"{planned.name}-a{number}"))

    def _made(self, planned: Planned, percent: float, number: int | None = None) -> Experiment:
        """The experiment at so many percent of its amplitude; a step where it has a number."""
        settings, t = self._escalation, planned.template
        assert settings is not None
        self._percent = percent

        def sized(signal: Any) -> Any:
            words = {"amplitude": signal.amplitude * percent / 100.0}
            if signal.period_s and signal.ramp_s <= 0.0:
                words["ramp_s"] = 0.1 * signal.period_s  # ramps of an excitation that has none, as a share of a period
            if number is not None and signal.period_s:
                words["periods"] = min(settings.periods, signal.periods)
            return replace(signal, **words)

        changed = replace(
            t, excitation=sized(t.excitation), excites_also={k: sized(x) for k, x in t.excites_also.items()}
        )
        if number is None:
            return self._moved(experiment(self._study, self.plant, replace(planned, template=changed)), planned)
        apart = 50_021  # between the seeds of steps
        one = replace(
            planned, template=replace(changed, role="validation"), name=f"{planned.name}-a{number}",
            seed=planned.seed + apart * number,
        )  # fmt: skip
        return self._moved(experiment(self._study, self.plant, one), planned)

    def _moved(self, e: Experiment, planned: Planned) -> Experiment:
        """With the base motion, a sine of the setpoint once a period; refuses one that the excitation holds."""
        settings = self._escalation
        signal: Any = planned.template.excitation
        if settings is None or not settings.base_percent or signal is None:
            return e
        if e.injection not in ("controller_input", "reference") or not e.period_s:
            raise WrongUseError(
                f"a base motion goes with a periodic excitation of setpoint or controller input ({e.name!r})",
                f"{e.kind} at {e.injection}", "leave base_percent out",
            )  # fmt: skip
        if signal.band_hz[0] < 1.5 / e.period_s:
            raise WrongUseError(
                f"the base motion of {e.name!r} would lie on a frequency that is excited", f"{1.0 / e.period_s:g} Hz",
                "begin the excitation at twice that or higher, or lengthen its period",
            )  # fmt: skip
        size = float(signal.amplitude) * settings.base_percent / 100.0
        k = [one.name for one in e.loops].index(str(e.excites))
        t = np.arange(e.samples) / e.rate_hz
        references = np.array(e.references)
        window = ramp(e.samples, round(0.25 * e.period_s * e.rate_hz))
        references[:, k] += size * np.sin(TWO_PI * t / e.period_s) * window
        return replace(e, references=references)

    def _share(self, planned: Planned, e: Experiment) -> float:
        """A step's measured length over the recording's own."""
        signal: Any = planned.template.excitation
        return min(self._escalation.periods, signal.periods) / signal.periods if e.period_s else 1.0  # type: ignore

    def supervisor(self, e: Experiment) -> Supervisor | None:
        """What watches this experiment while it runs; None where nothing is to be watched."""
        guards, still, expected = {}, {}, {}
        if self._escalation is not None and self._past:
            rest, part = self._past[0], 1.0 - self._escalation.reserve_percent / 200.0
            for column in self.limits.keys() & rest.mean.keys():
                limit, middle = self.limits[column], rest.mean[column]
                if limit.low < middle < limit.high:
                    low, high = (middle + part * (end - middle) for end in (limit.low, limit.high))
                    guards[column] = replace(limit, low=low, high=high)
            target = self._study.target
            for column in self.limits.keys() - (target.commands if target else {one.control for one in e.loops}):
                ticks = max((one.still_ticks.get(column, 0) for one in self._past), default=0)
                noise, grain = self._past[0].rms.get(column, 0.0), self._past[0].grain.get(column, np.inf)
                if ticks <= STILL_MOST and noise > grain:  # else it depends on where the sensor stands in its step
                    still[column] = max(STILL_TIMES * ticks, STILL_TICKS)
                if (motion := self._expected(e, column)) is not None:
                    expected[column] = motion
        limits = {} if self._study.target else self.limits
        until = self._until if e.excites is not None and not self._step else None
        watched = guards or limits or until
        self._supervisor = Supervisor(e, guards, limits, still, expected, until, self._looked) if watched else None
        return self._supervisor

    def _expected(self, e: Experiment, column: str) -> Expected | None:
        """The motion of a column in its periods as the step before had it, at this amplitude; None where none did."""
        rest, before, settings = self._past[0], self._past[-1], self._escalation
        record = before.record.get(column)
        if settings is None or record is None or not before.percent or not e.period_s:
            return None
        ratio, period = self._percent / before.percent, round(e.period_s * e.rate_hz)
        first = round((e.periodic_from_s or 0.0) * e.rate_hz)
        whole = (e.samples - first) // period
        known = first + (record.size - first) // period * period
        motion = np.full(e.samples, np.nan)  # not while the excitation goes out
        motion[:known] = record[:known]
        motion[known : first + whole * period] = np.tile(record[known - period : known], whole)[
            : max(first + whole * period - known, 0)
        ]
        middle, noise = rest.mean.get(column, 0.0), NOISE_PEAK * rest.rms.get(column, 0.0)
        grown = ratio ** exponent(before, self._past[:-1], column)  # friction that lets go more and more
        motion = middle + grown * (motion - middle)
        least = (1.0 + ratio) * (STILL_STEPS * before.grain[column] + 2.0 * noise)
        limit = self.limits[column]
        room = min(limit.high - middle, middle - limit.low)
        off = 0.005 * settings.reserve_percent * room + (1.0 + ratio) * noise
        least = max(least, STILL_SHARE * float(np.nanmax(motion) - np.nanmin(motion)))
        # share of a limit's room from which on a machine that goes farther than the step before predicted is stopped
        unexpected_from = 0.5
        return Expected(motion, middle, least, unexpected_from * room, off)

    def taken(self, recording: Recording) -> None:
        """A recording was made, whole or in part."""
        self._last = recording
        found = self._supervisor
        if found is not None and found.trip is Trip.ENOUGH and found.last is not None:
            note(self.folder, "enough", **found.last.to_dict())

    def simulated(self, e: Experiment, states: bool = False) -> Recording:
        """The experiment on the study's plant, under supervision: what comes after a trip is simulated as it would be.

        The same seed gives the same signals up to where the excitation stopped.
        """
        whole, found = self._simulated(e, states), self.supervisor(e)
        if found is None:
            return whole
        columns = dict(whole.columns)
        rows = len(columns["t_s"])
        place, trip = found.first_trip(columns), found.trip
        found.trip = None
        while (n := found.due(rows if place is None else place)) is not None and n < e.samples:
            found.looked({name: x[:n] for name, x in columns.items()})
            if found.trip is Trip.ENOUGH:
                return cut(whole, n, None)
        found.trip = trip
        if place is None or trip is None:
            return whole
        if trip.vents:
            return cut(whole, place + 1, found.why)
        injected, references = np.array(e.injected), np.array(e.references)
        injected[place + 1 :], references[place + 1 :] = 0.0, e.references[0]
        after = self._simulated(replace(e, injected=injected, references=references), states)
        after_s = 0.5  # how long a simulated machine is watched after its excitation stopped, in s
        n = min(place + 1 + round(after_s * e.rate_hz), len(after.columns["t_s"]))
        beyond = Supervisor(e, {}, found.limits)
        passed = beyond.first_trip({name: x[:n] for name, x in after.columns.items()})
        if passed is not None:
            found.trip, found.column = Trip.LIMIT, beyond.column
            return cut(after, passed + 1, found.why)
        return cut(after, n, found.why)

    def _simulated(self, e: Experiment, states: bool) -> Recording:
        study, plant = self._study, self.plant
        changes = dict(study.changes) | moves(plant, study.effects)
        return next(iter(plant.simulate([e], solver=study.solver, changes=changes, threads=1, states=states)))


def _refuse_endless(template: ExperimentTemplate, until: Until) -> None:
    """Refuse an excitation that comes to each frequency once, and a loop without requirements."""
    if template.excites is None:
        return
    if template.kind == "sweep":
        raise WrongUseError(
            f"{template.name!r} cannot end when it is enough", "a sweep comes to each frequency once",
            "excite with a multisine, a PRBS or noise",
        )  # fmt: skip
    if until.std is None and until.required(template.excites) is None:
        raise WrongUseError(
            f"{template.name!r} has no verdict that could end it", f"no requirements of loop {template.excites!r}",
            f"they are of {', '.join(one.loop for one in until.requirements)}",
        )  # fmt: skip
