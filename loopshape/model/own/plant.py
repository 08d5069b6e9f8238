"""A user's machine as what a gap diagnosis follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.channel import Channel
from loopshape.data.controller import Controller
from loopshape.data.effect import EffectForm, Spread
from loopshape.data.experiment import Experiment
from loopshape.data.machine import Model
from loopshape.data.plant import Followable, ParameterTable
from loopshape.data.recording import Recording
from loopshape.data.run import Run
from loopshape.model.own import following, mapping
from loopshape.model.own.catalogue import PortScale, Scales, forms, spread
from loopshape.model.own.composed import Composed
from loopshape.model.own.following import Followed

ENOUGH = 12  # recordings times outputs, below which recordings are cut into pieces
RARE = (0.8, 0.95, 0.99, 0.997)  # shares of the commands
_FEWEST = 3  # windows a piece


class OwnMachine:
    """A `Model` with generic effects around it (`Followable`), driven by measured inputs; it has no loops."""

    loops: tuple[str, ...] = ()
    solvers: tuple[str, ...] = ("edges",)
    channels: tuple[Channel, ...] = ()
    calibrated = False

    def __init__(self, model: Model, effects: tuple[EffectForm, ...] = (), composed: Composed | None = None) -> None:
        self.model, self.effects = model, effects
        self.composed = composed or Composed(model)
        self.name, self.needs = model.name, model.columns
        self.spread: tuple[Spread, ...] = spread(model)
        first = model.outputs[0]
        self.trace_channel = f"{first.name} [{first.unit}]"
        self.places: Mapping[str, tuple[str, ...]] = {}
        self.parameters: ParameterTable = self.composed.table

    def readied(self, run: Run, names: Sequence[str]) -> tuple[Followable, Run, list[str]]:
        """The machine with effects at the run's scales; few recordings are cut into pieces that may be left out.

        Refuses a run whose channels are mapped with a wrong sign or unit.
        """
        chosen = [run.recording(name) for name in names]
        prepared = [self.prepare(r, run, None) for r in chosen]
        mapping.check(self.composed, prepared)
        ready = OwnMachine(self.model, forms(self.model, self._scales(prepared)), self.composed)
        count = -(-ENOUGH // (len(names) * len(self.model.outputs)))
        if count == 1:
            return ready, run, list(names)
        cut = [piece for r in chosen for piece in self._pieces(r, count)]
        kept = [r for r in run.recordings if r not in chosen]
        return ready, replace(run, recordings=(*cut, *kept)), [piece.info.name for piece in cut]

    def _pieces(self, recording: Recording, count: int) -> list[Recording]:
        """The recording cut into `count`, fewer where it is short. Names are the recording's with -01, -02 behind."""
        rows = len(recording.column(self.needs[0]))
        shortest = round((_FEWEST + following.LEAD) * self.model.window_s * recording.rate_hz) + 1
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
        rare = {i.name: tuple(np.quantile(np.abs(u[:, k]), RARE).tolist()) for k, i in enumerate(model.inputs)}
        ports = {p.name: self._port(p.name, prepared, command[p.input][0]) for p in model.ports}
        return Scales(model.window_s, command, output, ports, rare)

    def _port(self, name: str, prepared: Sequence[Followed], most: float) -> PortScale:
        """Force by the simulator: one that moves the machine within a window as far as it was seen moving.

        `most` is the largest command where it acts.
        """
        c = self.composed
        port = next(p for p in self.model.ports if p.name == name)
        place, speed = (self.model.states.index(s) for s in (port.position, port.speed))
        seen, driven = [], []
        for f in prepared:
            still = following.simulated(c, f, {}, following.extended(c, f, f.start))
            pushed = following.simulated(c, f, {f"port.{name}.offset": 1.0}, following.extended(c, f, f.start))
            seen.append(np.mean(f.measured.std(axis=1) / f.floor))
            driven.append(np.mean((pushed - still).std(axis=1) / f.floor))
        starts = np.concatenate([f.start for f in prepared])
        force = float(np.sum(seen) / max(float(np.nansum(driven)), 1e-300))
        low, high = float(starts[:, place].min()), float(starts[:, place].max())
        return PortScale(force, max(float(np.std(starts[:, speed])), 1e-12), low, max(high, low + 1e-9), most)

    def stays_in_range(self, recording: Recording, run: Run) -> bool:
        """Always: a user's model states no range."""
        return True

    def prepare(self, recording: Recording, run: Run, longest_s: float | None) -> Followed:
        """The recording in windows, each with an initial state that fits the nominal model."""
        return following.followed(self.composed, recording, longest_s)

    def repeated(self, prepared: Followed, moves: Mapping[str, float], share: float) -> Followed:
        """What the recording would be under moved parameters, with commands and motion `share` times as large."""
        return following.repeated(self.composed, prepared, moves, share)

    def residuals(self, prepared: Followed, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus simulated by output (n,), means over blocks, windows in a row."""
        return self._off(prepared, following.explained(self.composed, prepared, moves))

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
        """Measured minus simulated over the floor, measured inputs in, by output."""
        floors = self.floors(prepared)
        simulated = following.explained(self.composed, prepared, moves, following.CONVERGED)
        return {f"inputs -> {k}": off / floors[k] for k, off in self._off(prepared, simulated).items()}

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


def _peak(values: Array) -> float:
    """Size that one sample in a thousand passes."""
    return float(np.quantile(np.abs(values), 0.999))
