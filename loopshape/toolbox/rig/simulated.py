"""The simulated rig: a study's experiments, done on a plant's model."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import SUFFIXES, Array
from loopshape.data.control.controller import Controller
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import Experiment, LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.plant import Plant
from loopshape.toolbox.rig.effects import moves
from loopshape.toolbox.rig.excitation.excitation import samples
from loopshape.toolbox.rig.excitation.setpoints import Sampled
from loopshape.toolbox.rig.steps.supervisor import within
from loopshape.toolbox.rig.study import ExperimentTemplate, Setpoint, Study


class Rig(Plant, Protocol):
    """A plant that a study can be done on: it also knows its loops' columns and its setpoints."""

    def loop_setups(self, controllers: Sequence[Controller], injection: str) -> tuple[LoopSetup, ...]:
        """Loops with their columns, for what is injected there."""

    def setpoint(self, operating_point: Mapping[str, float]) -> Sequence[float]:
        """References of all loops at an operating point, in stored units."""


@dataclass(frozen=True, eq=False)
class Planned:
    """One experiment to come: a template at an operating point, its name and its seed. It holds no signals."""

    name: str
    template: ExperimentTemplate
    operating_point: Mapping[str, float]
    loops: tuple[LoopSetup, ...]
    seed: int


def plan(study: Study, plant: Rig) -> list[Planned]:
    """All experiments of a study in order: each template at each of its operating points.

    Refuses what the plant cannot do before anything moves. Seeds of sensor noise follow from the study's
    seed and the place in this list, so a resumed or a partial campaign gives the same recordings.
    """
    refuse_unknown("a solver is not known", study.solver, plant.solvers)
    _check_solver(study, plant)
    out = listed(study, plant)
    for template in study.experiments:
        mine = [planned for planned in out if planned.template is template]
        _check_units(study, template, mine[0].loops)
        changes = {f"pwm_{k}": float(v) for k, v in study.pwm.items()} | dict(study.changes) | dict(template.parameters)
        changes |= moves(plant, study.effects, tuple(changes))
        plant.check_settings(study.rate_hz, changes)
        for planned in mine:
            plant.check_operating_point(planned.operating_point, changes)
        experiment(study, plant, mine[-1])  # refuses signals that cannot be made, before anything is written
    names = [planned.name for planned in out]
    if len(set(names)) != len(names):
        raise WrongUseError("two experiments of the study share a name", ", ".join(sorted(names)))
    return out


def listed(study: Study, plant: Rig) -> list[Planned]:
    """`plan` of a study that was checked before, or differs from one by its seed alone."""
    out: list[Planned] = []
    controllers = _controllers(study, plant)
    for template in study.experiments:
        points = study.operating_points if template.operating_points is None else template.operating_points
        if not points:
            raise WrongUseError(
                f"experiment {template.name!r} has no operating point", "", "give operating_points in the study"
            )
        if "." in template.name:
            raise WrongUseError("the name of an experiment holds no dot", repr(template.name), "use - or _")
        loops = _wired(plant.loop_setups(controllers, template.injection), study)
        for k, point in enumerate(points):
            name = f"{template.name}-{k + 1:02d}" if len(points) > 1 else template.name
            out.append(Planned(name, template, dict(point), loops, study.seed * 100_003 + len(out)))
    return out


def _wired(loops: Sequence[LoopSetup], study: Study) -> tuple[LoopSetup, ...]:
    """The loops with the study's schedules or its diagram in place of controllers, and with its decoupling."""
    known = [loop.name for loop in loops]
    for what, given in (("decoupling", study.decoupling), ("schedules", study.schedules)):
        if unknown := [name for name in given if name not in known]:
            raise WrongUseError(f"{what} of a loop that is not there", ", ".join(unknown), f"it has {', '.join(known)}")
    for loop, weights in study.decoupling.items():
        if unknown := [name for name in weights if name not in known]:
            raise WrongUseError(
                f"decoupling of loop {loop!r} names no loop", ", ".join(unknown), f"it has {', '.join(known)}"
            )
    return tuple(_one_wired(loop, study) for loop in loops)


def _one_wired(loop: LoopSetup, study: Study) -> LoopSetup:
    if study.diagram is not None and study.diagram.gives(loop) is not None:
        loop = replace(loop, controller=None)
    schedule, decoupling = study.schedules.get(loop.name), dict(study.decoupling.get(loop.name, {}))
    if schedule is None and not decoupling:
        return loop
    controller = loop.controller if schedule is None else None
    return replace(loop, controller=controller, schedule=schedule, decoupling=decoupling)


def _check_solver(study: Study, plant: Rig) -> None:
    if study.effects and study.solver != plant.solvers[0]:
        raise WrongUseError(
            f"the solver {study.solver!r} does not know every effect",
            ", ".join(study.effects),
            f'use solver = "{plant.solvers[0]}"',
        )


def _check_units(study: Study, template: ExperimentTemplate, loops: Sequence[LoopSetup]) -> None:
    """Refuse signals in a unit that the place they act at does not have, where the study says the units."""
    units = dict(study.extra.get("units", {})).get(template.name, {})
    for loop in loops:
        asked = [(units.get("references", {}).get(loop.name), loop.reference)]
        asked += [(units.get(key, {}).get(loop.name), loop.control) for key in ("control", "feedforward")]
        if loop.name in template.excited:
            place = {"control": loop.control, "reference": loop.reference}.get(template.injection, loop.injected)
            mine = units if loop.name == template.excites else units.get("excites_also", {})
            asked += [(mine.get("excitation" if mine is units else loop.name), place)]
        for unit, column in asked:
            if unit is not None and column is not None and unit != Channel.from_column(column).unit:
                raise WrongUseError(
                    f"experiment {template.name!r} moves {column} in another unit",
                    f"{SUFFIXES[unit]}",
                    f"give it in {SUFFIXES[Channel.from_column(column).unit]}",
                )


def _controllers(study: Study, plant: Rig) -> tuple[Controller, ...]:
    unknown = set(study.controllers) - set(plant.loops)
    if unknown:
        raise WrongUseError(
            f"the plant {plant.name} has no such loop", ", ".join(sorted(unknown)), f"it has {', '.join(plant.loops)}"
        )
    return tuple(
        Controller(c.loop, study.controllers.get(c.loop, c.blocks), study.rate_hz)
        for c in plant.default_controllers(study.rate_hz)
    )


def experiment(study: Study, plant: Rig, planned: Planned) -> Experiment:
    """A planned experiment with its signals."""
    template = planned.template
    setpoint = np.asarray(plant.setpoint(planned.operating_point), dtype=float)
    n = _samples(template, study.rate_hz)
    shape = (n, setpoint.size)
    moved = bool(template.references) or (template.excitation is not None and template.injection == "reference")
    references = np.tile(setpoint, (n, 1)) if moved else np.broadcast_to(setpoint, shape)
    for loop, signal in template.references.items():
        k = _place(plant, loop, template.name)
        references[:, k] = signal.sampled(n, study.rate_hz, float(setpoint[k]))
    given: dict[str, Setpoint | Sampled] = {**template.control, **template.feedforward}
    driven = bool(given) or template.excitation is not None
    injected = np.zeros(shape) if driven else np.broadcast_to(0.0, shape)
    for loop, added in given.items():
        injected[:, _place(plant, loop, template.name)] = added.sampled(n, study.rate_hz, 0.0)
    target = references if template.injection == "reference" else injected
    period_s, periodic_from_s = _excite(target, template, plant, study.rate_hz)
    return Experiment(
        name=planned.name,
        kind=template.kind,
        loops=planned.loops,
        rate_hz=study.rate_hz,
        references=references,
        injected=injected,
        injection=template.injection,
        operating_point=planned.operating_point,
        excites=template.excites,
        role=template.role,
        closed_loop=template.injection != "control",
        period_s=period_s,
        periodic_from_s=periodic_from_s,
        seed=planned.seed,
        **template.settings(),
        pwm=dict(study.pwm),
        excites_also=tuple(template.excites_also),
    )


def _samples(template: ExperimentTemplate, rate_hz: float) -> int:
    if template.excitation is not None:
        longest_s = max(e.duration_s for e in (template.excitation, *template.excites_also.values()))
        return samples(template.lead_s + longest_s + template.tail_s, rate_hz)
    if template.duration_s is None:
        raise WrongUseError(f"experiment {template.name!r} has neither an excitation nor a duration_s")
    return samples(template.duration_s, rate_hz)


def _place(plant: Rig, loop: str, experiment: str) -> int:
    if loop not in plant.loops:
        raise WrongUseError(
            f"experiment {experiment!r} names a loop that {plant.name} does not have",
            f"{loop!r}",
            f"it has {', '.join(plant.loops)}",
        )
    return plant.loops.index(loop)


def _excite(
    target: Array, template: ExperimentTemplate, plant: Rig, rate_hz: float
) -> tuple[float | None, float | None]:
    """Add the excitations of all loops in place; gives their period and from when on the response can repeat."""
    if template.excitation is not None and template.excites is None:
        raise WrongUseError(f"experiment {template.name!r} has an excitation and does not say which loop it excites")
    start = round(template.lead_s * rate_hz)
    for loop, excitation in template.excited.items():
        signal = excitation.signal(rate_hz)
        target[start : start + signal.size, _place(plant, loop, template.name)] += signal
    return _periodic(template)


def _periodic(template: ExperimentTemplate) -> tuple[float | None, float | None]:
    """Period in s and when it begins; None where the excitations have none, or not all the same."""
    shapes = {(e.period_s, e.duration_s, float(getattr(e, "ramp_s", 0.0))) for e in template.excited.values()}
    if len(shapes) != 1:
        return None, None
    period_s, _, ramp_s = shapes.pop()
    if period_s is None:
        return None, None
    if ramp_s + template.tail_s >= period_s:
        raise WrongUseError(
            f"what follows the whole periods of experiment {template.name!r} would be taken for a period",
            f"ramp_s + tail_s = {ramp_s + template.tail_s:g} s, period_s = {period_s:g} s",
            "shorten the ramp or the tail",
        )
    return period_s, template.lead_s + ramp_s


def header(study: Study, plant: Rig, extra: Mapping[str, object] | None = None) -> Run:
    """The run that the study's recordings belong to, without recordings; `extra` keys go along."""
    first = listed(study, plant)[0]
    pwm = {
        key: float(study.pwm.get(key, plant.parameters.rows[plant.parameters.index(f"pwm_{key}")].value))
        for key in ("frequency_hz", "dead_zone")
        if f"pwm_{key}" in plant.parameters.names
    }
    settings: dict[str, object] = {"parameters": dict(study.changes)} if study.changes else {}
    if study.effects:  # for people: no diagnosis may read it
        settings["effects"] = dict(study.effects)
    return Run(study.rate_hz, first.loops, (), plant.name, pwm, settings | dict(extra or {}))


def measure(
    study: Study,
    plant: Rig,
    *,
    done: frozenset[str] = frozenset(),
    threads: int | None = None,
    states: bool = False,
) -> Iterator[Recording]:
    """The study's recordings in order, leaving out those already `done`; a few at a time are in memory.

    `states` adds the plant's true states as columns.
    """
    todo = [planned for planned in plan(study, plant) if planned.name not in done]
    workers = threads or os.cpu_count() or 1
    changes = dict(study.changes) | moves(plant, study.effects)
    for k in range(0, len(todo), workers):
        few = [experiment(study, plant, planned) for planned in todo[k : k + workers]]
        made = plant.simulate(few, solver=study.solver, changes=changes, threads=workers, states=states)
        yield from (within(one, study.limits) for one in made) if study.limits else made
