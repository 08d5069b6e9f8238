"""A user's machine as what a gap diagnosis follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown_keys
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.effect import EffectForm, Spread
from loopshape.toolbox.gap.nouns.machine import Model, is_angle
from loopshape.toolbox.gap.nouns.plant import ParameterTable, SimulationModel
from loopshape.toolbox.gap.own import following, mapping
from loopshape.toolbox.gap.own.catalogue import PortScale, Scales, forms, spread
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.following import Followed
from loopshape.toolbox.gap.own.nameless import Shapes

ENOUGH = 12  # recordings times outputs, below which recordings are cut into pieces
RARE = (0.8, 0.95, 0.99, 0.997)  # shares of the commands
FEW_LEAVE = 3.0  # medians: a window of a good machine that leaves more has run away, or met something else
_FEWEST = 3  # windows a piece


class OwnMachine:
    """A `Model` with generic effects around it (`SimulationModel`), driven by measured inputs; it has no loops."""

    loops: tuple[str, ...] = ()
    solvers: tuple[str, ...] = ("edges",)
    channels: tuple[Channel, ...] = ()
    calibrated = False

    def __init__(self, model: Model, effects: tuple[EffectForm, ...] = (), composed: Composed | None = None) -> None:
        self.model, self.effects = model, effects
        self.composed = composed or Composed(model)
        self.name, self.needs = model.name, model.columns
        self.window_s, self.open_window = self.composed.window_s, model.window_s is None
        self.windows_s: tuple[float, ...] = ()
        self.units = {o.name: o.unit for o in model.outputs}
        self.stated = frozenset(o.name for o in model.outputs if o.leaves is not None)
        self.spread: tuple[Spread, ...] = spread(model)
        first = model.outputs[0]
        self.trace_channel = f"{first.name} [{first.unit}]"
        self.places: Mapping[str, tuple[str, ...]] = {}
        self.parameters: ParameterTable = self.composed.table
        self._started: WeakKeyDictionary[Followed, tuple[object, following.Started]] = WeakKeyDictionary()

    def readied(self, run: Run, names: Sequence[str]) -> tuple[SimulationModel, Run, list[str]]:
        """The machine with effects at the run's scales; few recordings are cut into pieces that may be left out.

        Refuses a run whose columns are mapped with a wrong sign, unit or zero, and constants that are no parameters.
        """
        for r in run.recordings:
            refuse_unknown_keys(f"parameters of {r.info.file} are the model's", r.info.parameters, self.model.values())
        chosen = [run.recording(name) for name in names]
        prepared = [self.prepare(r, run, None) for r in chosen]
        composed = self.composed.of(_with_schedules(self.model, prepared))
        mapping.check(composed, prepared)
        ready = OwnMachine(composed.model, forms(composed.model, self._scales(prepared)), composed)
        ready.windows_s = self.windows_s
        count = -(-ENOUGH // (len(names) * len(self.model.outputs)))
        if count == 1:
            return ready, run, list(names)
        cut = [piece for r in chosen for piece in self._pieces(r, count)]
        kept = [r for r in run.recordings if r not in chosen]
        return ready, replace(run, recordings=(*cut, *kept)), [piece.info.name for piece in cut]

    def windowed(self, window_s: float, tried_s: tuple[float, ...] = ()) -> OwnMachine:
        """The machine followed in windows of so many seconds, chosen among those tried."""
        model = replace(self.model, window_s=window_s)
        out = OwnMachine(model, self.effects, self.composed.of(model))
        out.windows_s = tried_s
        return out

    def left(self, prepared: Sequence[Followed], moves: Mapping[str, float]) -> dict[str, float]:
        """Rms within a window, by output, that parameters moved as given leave of recordings.

        The root of the mean square over windows, of which none counts for more than FEW_LEAVE medians.
        """
        off = [f.measured - following.explained(self.composed, f, moves, following.CONVERGED) for f in prepared]
        squares = np.concatenate([np.mean(x**2, axis=1) for x in off])
        usual = np.minimum(squares, FEW_LEAVE**2 * np.median(squares, axis=0)).mean(axis=0)
        return {o.name: float(np.sqrt(usual[k])) for k, o in enumerate(self.model.outputs)}

    def leaving(self, rms: Mapping[str, float]) -> OwnMachine:
        """The machine of which a good model leaves so much, by output; what is stated already stays."""
        outputs = [o if o.leaves is not None else replace(o, leaves=rms[o.name]) for o in self.model.outputs]
        model = replace(self.model, outputs=tuple(outputs), window_s=self.window_s)
        out = OwnMachine(model, self.effects, self.composed.of(model))
        out.windows_s = self.windows_s
        return out

    def _pieces(self, recording: Recording, count: int) -> list[Recording]:
        """The recording cut into `count`, fewer where it is short. Names are the recording's with -01, -02 behind."""
        rows = len(recording.column(self.needs[0]))
        shortest = round((_FEWEST + following.LEAD) * self.window_s * recording.rate_hz) + 1
        edges = np.linspace(0, rows, max(1, min(count, rows // shortest)) + 1).astype(int)
        return [
            replace(
                recording,
                info=replace(recording.info, file=f"{recording.info.name}-{k + 1:02d}.parquet", period_s=None),
                columns={name: recording.column(name)[a:b] for name in self.needs},
            )
            for k, (a, b) in enumerate(pairwise(edges.tolist()))
        ]

    def _scales(self, prepared: Sequence[Followed]) -> Scales:
        model = self.model
        u, y = np.concatenate([f.u for f in prepared]), np.concatenate([f.y for f in prepared])
        command = {i.name: (_peak(u[:, k]), float(np.median(np.abs(u[:, k])))) for k, i in enumerate(model.inputs)}
        output = {o.name: max(_peak(y[:, k]), 1e-12) for k, o in enumerate(model.outputs)}
        if model.law is not None:
            sizes = [self._by_law(j, prepared) for j in range(len(model.ports))]
            command |= {p.input: size for p, size in zip(model.ports, sizes, strict=True) if size[0] > 0.0}
        rare = {i.name: tuple(np.quantile(np.abs(u[:, k]), RARE).tolist()) for k, i in enumerate(model.inputs)}
        ports = {p.name: self._port(p.name, prepared, command[p.input][0]) for p in model.ports}
        return Scales(self.window_s, command, output, ports, rare)

    def _by_law(self, j: int, prepared: Sequence[Followed]) -> tuple[float, float]:
        """Largest and usual effort that a law gives at port j, where windows begin; 0 where there is none."""
        c, (_, q, v) = self.composed, self.composed.places[j]
        efforts = np.array([
            c.law(j, x[q], x[v], x, u, c.values({}, f.constants))
            for f in prepared for x, u in zip(f.start, f.u[f.first], strict=True)
        ])  # fmt: skip
        return _peak(efforts), float(np.median(np.abs(efforts)))

    def _port(self, name: str, prepared: Sequence[Followed], most: float) -> PortScale:
        """Force by the simulator: one that moves the machine within a window as far as it was seen moving.

        `most` is the largest command where it acts.
        """
        port = next(p for p in self.model.ports if p.name == name)
        place, speed = (self.model.states.index(s) for s in (port.position, port.speed))
        starts = np.concatenate([f.start for f in prepared])
        pushes = (1.0, 1e-3, 1e-6)  # of a port's force, smaller ones where all windows run away under a larger one
        force = next((x for push in pushes if (x := self._moving(name, prepared, push)) > 0.0), 0.0)
        low, high = float(starts[:, place].min()), float(starts[:, place].max())
        unit = next((o.unit for o in self.model.outputs if o.state == port.position and o.unit != "1"), "")
        return PortScale(force, max(float(np.std(starts[:, speed])), 1e-12), low, max(high, low + 1e-9), most, unit)

    def stays_in_range(self, recording: Recording, run: Run) -> bool:
        """Always: a user's model states no range."""
        return True

    def prepare(self, recording: Recording, run: Run, longest_s: float | None) -> Followed:
        """The recording in windows, each with an initial state that fits the nominal model."""
        return following.simulated_along(self.composed, recording, longest_s)

    def repeated(self, prepared: Followed, moves: Mapping[str, float], share: float) -> Followed:
        """What the recording would be under moved parameters, with commands and motion `share` times as large."""
        return following.repeated(self.composed, prepared, moves, share)

    def _moving(self, name: str, prepared: Sequence[Followed], push: float) -> float:
        """The force at a port that moves as far as was seen; windows that the push makes run away are left out."""
        c, seen, driven = self.composed, 0.0, 0.0
        for f in prepared:
            x0 = following.extended(c, f, f.start)
            with np.errstate(all="ignore"):
                pushed = following.simulated(c, f, {f"port.{name}.offset": push}, x0)
                moved = np.mean((pushed - following.simulated(c, f, {}, x0)).std(axis=1) / f.floor, axis=1)
            stands = moved < following.RUN_AWAY  # nan and inf are no less
            seen += float(np.sum(np.mean(f.measured.std(axis=1) / f.floor, axis=1)[stands])) / stands.size
            driven += float(np.sum(moved[stands])) / stands.size
        return push * seen / max(driven, 1e-300)

    def within(self, again: Followed, every: Sequence[Followed]) -> bool:
        """Whether commands and outputs of a repeated recording stay within those of every prepared one."""
        acts = [j for j, i in enumerate(self.model.inputs) if i.acts]
        return all(
            _inside(mine, np.concatenate(seen))
            for mine, seen in ((again.u[:, acts], [f.u[:, acts] for f in every]), (again.y, [f.y for f in every]))
        )

    def stays(self, recordings: Sequence[Recording]) -> dict[str, tuple[float, float]]:
        """Positions, by column, that were seen about one point alone, with their range in the model's unit.

        An angle that moves by a quarter turn, and any other position that goes farther than within a window, is seen at
        several.
        """
        out = {}
        for o in self.model.outputs:
            if self.model.states.index(o.state) in self.composed.speeds:
                parts = [p for r in recordings for p in self._stretches(o.factor * r.column(o.column) + o.offset, r)]
                low, high = min(p.min() for p in parts), max(p.max() for p in parts)
                # how much farther means of windows lie apart than a machine moves within one
                far = np.std([p.mean() for p in parts]) > 2.0 * np.mean([p.std() for p in parts])
                if not (high - low >= 0.5 * np.pi if is_angle(o) else far):
                    out[o.column] = (float(low), float(high))
        return out

    def _stretches(self, values: Array, r: Recording) -> list[Array]:
        """The values in stretches of a window."""
        return np.array_split(values, max(1, round(values.size / r.rate_hz / self.window_s)))

    def residuals(self, prepared: Followed, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus simulated by output (n,), means over blocks, windows in a row."""
        return self._off(prepared, following.explained(self.composed, prepared, moves))

    def nearby(self, prepared: Followed, near: Mapping[str, float], moves: Mapping[str, float]) -> dict[str, Array]:
        """As `residuals`, initial states answering by what they do under the moves `near`: cheaper by far.

        Where other states are free than there, whole.
        """
        if not np.array_equal(self.composed.free_states(near), self.composed.free_states(moves)):
            return self.residuals(prepared, moves)
        key = tuple(sorted(near.items()))
        known = self._started.get(prepared)
        if known is None or known[0] != key:
            known = self._started[prepared] = (key, following.started(self.composed, prepared, near, 1))
        return self._off(prepared, following.nearby(self.composed, prepared, known[1], moves))

    def _off(self, prepared: Followed, simulated: Array) -> dict[str, Array]:
        off = prepared.measured - simulated
        return {o.name: off[:, :, k].ravel() for k, o in enumerate(self.model.outputs)}

    def residual_rate_hz(self, prepared: Followed, channel: str) -> float:
        """Blocks a second."""
        return 1.0 / (prepared.block * prepared.tick_s)

    def traces(self, prepared: Followed, moves: Mapping[str, float]) -> tuple[float, Array, Array]:
        """Time step in s, the first output measured and simulated, windows in a row."""
        simulated = following.explained(self.composed, prepared, moves, following.CONVERGED)
        return prepared.block * prepared.tick_s, prepared.measured[:, :, 0].ravel(), simulated[:, :, 0].ravel()

    def floors(self, prepared: Followed) -> dict[str, float]:
        """Rms that noise, rounding and an ordinary model leave, by output."""
        return {o.name: float(prepared.floor[k]) for k, o in enumerate(self.model.outputs)}

    def paths(self, prepared: Followed, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus simulated relative to the noise floor, measured inputs in, by output."""
        floors = self.floors(prepared)
        simulated = following.explained(self.composed, prepared, moves, following.CONVERGED)
        return {f"inputs -> {k}": off / floors[k] for k, off in self._off(prepared, simulated).items()}

    def shapes(self, prepared: Sequence[Followed]) -> Shapes:
        """Shapes of what may act at ports, inputs and sensors, where these recordings have been."""
        return Shapes.of(self.composed, prepared)

    def default_controllers(self, rate_hz: float) -> tuple[Controller, ...]:
        """None: a user's model is followed, and not controlled."""
        return ()

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse every point: a user's model is not driven in closed loop."""
        raise WrongUseError(f"{self.name} is followed with measured inputs, not driven in closed loop")

    def check_settings(self, rate_hz: float, changes: Mapping[str, float]) -> None:
        """Nothing to refuse."""

    def simulate(
        self,
        experiments: Sequence[Experiment],
        *,
        solver: str = "edges",
        changes: Mapping[str, float] | None = None,
        threads: int | None = None,
        states: bool = False,
    ) -> list[Recording]:
        """Refused: a user's model is followed, and not driven in closed loop."""
        raise WrongUseError(f"{self.name} is followed with measured inputs, not driven in closed loop")


def _inside(values: Array, seen: Array) -> bool:
    """Whether columns (n, k) stay within what was seen of them (m, k)."""
    # of what was seen: a simulation's outputs may be further off than its commands
    room = 0.02 * np.ptp(seen, axis=0)
    return bool(np.all(values.min(axis=0) >= seen.min(axis=0) - room) and np.all(values <= seen.max(axis=0) + room))


def _with_schedules(model: Model, prepared: Sequence[Followed]) -> Model:
    """The model whose inputs that are constant in every recording, where no force acts, schedule."""
    forces = {p.input for p in model.ports}

    def constant(j: int) -> bool:
        return all(np.ptp(f.u[:, j]) == 0.0 for f in prepared)

    inputs = [
        replace(i, schedules=True) if i.acts and i.name not in forces and constant(j) else i
        for j, i in enumerate(model.inputs)
    ]
    return replace(model, inputs=tuple(inputs))


def _peak(values: Array) -> float:
    """Size that one sample in a thousand passes."""
    return float(np.quantile(np.abs(values), 0.999))
