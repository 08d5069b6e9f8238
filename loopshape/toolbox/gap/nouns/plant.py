"""A plant: what the core knows of a simulated machine, whichever it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array
from loopshape.data.control.controller import Controller
from loopshape.data.signal.channel import Channel
from loopshape.toolbox.gap.nouns.effect import Effect, EffectForm, Spread

if TYPE_CHECKING:
    from loopshape.data.signal.experiment import Experiment
    from loopshape.data.signal.recording import Recording
    from loopshape.data.signal.run import Run


@dataclass(frozen=True)
class Parameter:
    """One number of a plant: value, unit, bounds, the block it belongs to, and where it comes from."""

    name: str
    value: float
    unit: str
    low: float
    high: float
    block: str
    source: str


def rows(block: str, *entries: tuple[str, float, str, float, float, str]) -> tuple[Parameter, ...]:
    """Parameters of one block from name, value, unit, bounds and source each."""
    return tuple(Parameter(n, v, u, lo, hi, block, source) for n, v, u, lo, hi, source in entries)


@dataclass(frozen=True, eq=False)
class ParameterTable:
    """A plant's parameters in the order of its flat vector."""

    rows: tuple[Parameter, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(row.name for row in self.rows)

    def holding(self, values: Mapping[str, float]) -> ParameterTable:
        """The table with these nominal values; names that it does not have are left aside."""
        return ParameterTable(tuple(replace(r, value=values[r.name]) if r.name in values else r for r in self.rows))

    def index(self, name: str) -> int:
        """Place of a parameter in the vector; refuses an unknown name."""
        try:
            return self.names.index(name)
        except ValueError:
            raise WrongUseError(
                "the plant has no such parameter", f"{name!r}", f"known are {', '.join(self.names)}"
            ) from None

    def vector(self, changes: Mapping[str, float] | None = None, effects: Iterable[Effect] = ()) -> Array:
        """Flat vector (n,) of nominal values, with changes and effects applied; out of bounds is refused."""
        values = np.array([row.value for row in self.rows])
        moves = dict(changes or {})
        for effect in effects:
            moves |= dict(effect.moves)
        for name, value in moves.items():
            row = self.rows[self.index(name)]
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not row.low <= value <= row.high:
                raise WrongUseError(
                    f"parameter {name} is a number between {row.low:g} and {row.high:g} {row.unit}",
                    f"{value!r}",
                )
            values[self.index(name)] = value
        return values


class Plant(Protocol):
    """A simulated machine. Concrete plants live in `plants/` and are found by name in `registry`."""

    name: str
    loops: tuple[str, ...]
    solvers: tuple[str, ...]
    channels: tuple[Channel, ...]
    parameters: ParameterTable

    def default_controllers(self, rate_hz: float) -> tuple[Controller, ...]:
        """Controllers that hold the simulated machine over its working range."""

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse an operating point that the machine, with these changes, cannot stand in."""

    def check_settings(self, rate_hz: float, changes: Mapping[str, float]) -> None:
        """Refuse changes of parameters, and a rate, that the machine cannot have."""

    def simulate(
        self,
        experiments: Sequence[Experiment],
        *,
        solver: str = "edges",
        changes: Mapping[str, float] | None = None,
        threads: int | None = None,
        states: bool = False,
    ) -> list[Recording]:
        """One recording an experiment, in order, in parallel; `states` adds true states as columns."""


class SimulationModel(Plant, Protocol):
    """A plant whose recordings a gap diagnosis can follow: it has effects, a manufacturing tolerance, and submodels."""

    effects: tuple[EffectForm, ...]
    spread: tuple[Spread, ...]
    trace_channel: str
    needs: tuple[str, ...]
    #: equation -> channels of `residuals` that an arbitrary disturbance there would explain whole, since each submodel
    #: follows what was measured everywhere else
    places: Mapping[str, tuple[str, ...]]
    #: whether temperature and prices of a diagnosis were calibrated on machines like it
    calibrated: bool

    def readied(self, run: Run, names: Sequence[str]) -> tuple[SimulationModel, Run, list[str]]:
        """This plant with the run's own nominal numbers, and the run and recordings as it wants to follow them."""

    def stays_in_range(self, recording: Recording, run: Run) -> bool:
        """Whether what was measured lies where the model holds."""

    def prepare(self, recording: Recording, run: Run, longest_s: float | None) -> PreparedRecording:
        """A recording ready to be followed, cut to `longest_s` after its lead if that is given."""

    def residuals(self, prepared: Any, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus modelled by channel, equally spaced means, from parameters moved as given."""

    def residual_rate_hz(self, prepared: Any, channel: str) -> float:
        """How many values a second `residuals` gives of a channel."""

    def traces(self, prepared: Any, moves: Mapping[str, float]) -> tuple[float, Array, Array]:
        """Time step in s, measured and simulated `trace_channel`, in the unit that its name says, for the eye."""

    def floors(self, prepared: Any) -> dict[str, float]:
        """Rms that measurement noise alone leaves in each channel's residuals."""

    def paths(self, prepared: Any, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus simulated outputs relative to their noise floor, by path such as u -> p; inputs measured."""

    def shapes(self, prepared: Sequence[Any]) -> Shapes | None:
        """Shapes of nameless pushes over what these recordings show; None where nobody knows any."""


@runtime_checkable
class Statable(Protocol):
    """A simulation model of which a user may know what a good model leaves."""

    #: unit of each channel of `residuals`
    units: Mapping[str, str]
    #: channels whose floor is what a good model leaves, as the user says or as a machine known to be good shows
    stated: frozenset[str]

    def left(self, prepared: Sequence[Any], moves: Mapping[str, float]) -> dict[str, float]:
        """Rms within a window, by channel, that parameters moved as given leave of recordings of a good machine."""

    def leaving(self, rms: Mapping[str, float]) -> SimulationModel:
        """This plant, of which a good model leaves so much; what is stated already stays."""


class Axis(Protocol):
    """A shape over one quantity: hat functions at `knots` (k,), or in proportion to it where there are none."""

    @property
    def over(self) -> str:
        """Name of the quantity."""

    @property
    def knots(self) -> Array:
        """Where its hats stand, (k,)."""

    def values(self, x: Array) -> Array:
        """Hat functions (n, k) of x (n,)."""


class Shapes(Protocol):
    """What a nameless force or signal at each place of a plant is made of."""

    @property
    def axes(self) -> Mapping[str, Sequence[Axis]]:
        """Axes by place."""

    def least(self, prepared: Any) -> float:
        """Rms relative to the noise floor by which an effect has to move the outputs to matter."""

    def units(self, place: str, over: str) -> tuple[str, str]:
        """Unit of what acts at a place, and of what it is over."""

    def named(self, place: str, over: str, x: Array, moves: Mapping[str, float]) -> Array | None:
        """What named effects at a place, parameters moved as given, give over one quantity x (n,); None for nothing."""

    def merged(self, place: str) -> Sequence[Array]:
        """Ways to give the sizes of all shapes at a place (k, few) by few, the coarsest first."""

    def columns(self, prepared: Any, moves: Mapping[str, float]) -> Mapping[str, Array]:
        """What each shape at each place does to the residuals of a recording (n, k), channel by channel."""


class PreparedRecording(Protocol):
    """What a plant makes of a recording before it follows it."""

    @property
    def name(self) -> str:
        """The recording's."""
