"""The servo axis as a plant: experiments in, recordings out; and as what a gap diagnosis follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import Array
from loopshape.data.control.controller import Block, Controller
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import Experiment, LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.noise import start_state
from loopshape.toolbox.gap.nouns.effect import EffectForm, Spread
from loopshape.toolbox.gap.nouns.plant import ParameterTable
from loopshape.toolbox.servo import closed_loop as kernel
from loopshape.toolbox.servo import following, motion, nominal
from loopshape.toolbox.servo.effects import forms
from loopshape.toolbox.servo.parameters import AXIS_PARAMETERS, constants, with_nominal

_INJECTIONS = {
    "controller_input": kernel.CONTROLLER_INPUT,
    "plant_input": kernel.PLANT_INPUT,
    "reference": kernel.CONTROLLER_INPUT,
    "control": kernel.CONTROL,
}
_ENDED = {kernel.LEFT_RANGE: "the axis left its travel", kernel.NOT_FINITE: "the state is no longer a number"}
ENOUGH, PIECE_S = 4, 3.0  # recordings to leave one out of; length of a piece of fewer


class ServoAxis:
    """One mass with viscous friction and perhaps a spring (`Plant`, `SimulationModel`); one loop, position.

    `of_run` gives the axis that a run describes; without it the numbers are those of no axis in particular.
    """

    name = "servo-axis"
    loops: tuple[str, ...] = ("position",)
    solvers: tuple[str, ...] = ("edges",)  # a study's usual word; there is one way to integrate
    channels: tuple[Channel, ...] = (Channel("position", "m"), Channel("force", "n"))
    needs: tuple[str, ...] = ("force_n", "position_m")
    trace_channel = "force [N]"
    calibrated = True
    places: Mapping[str, tuple[str, ...]] = {}  # one equation, one channel: it is the place

    def __init__(
        self,
        parameters: ParameterTable = AXIS_PARAMETERS,
        effects: tuple[EffectForm, ...] | None = None,
        spread: tuple[Spread, ...] | None = None,
        pass_hz: float | None = None,
        zero_is_ordinary: bool = False,
    ) -> None:
        self.parameters = parameters
        self._zero_is_ordinary = zero_is_ordinary  # a diagnosis takes a small offset of the drive for no gap
        self.effects = forms() if effects is None else effects
        known = {row.name: row.value for row in parameters.rows if row.name in nominal.NOMINAL}
        self.spread = nominal.spread(known, known) if spread is None else spread
        self._pass_hz = pass_hz
        self._kept_hz = 100.0

    def of_run(self, run: Run) -> ServoAxis:
        """The axis with the nominal parameters and scales of a run.

        `[parameters]` of the run gives mass_kg, viscous_ns_m, stiffness_n_m; a missing spring is none, missing mass
        and viscous friction come from the estimation recordings by least squares and get a wide spread. Refuses
        a run without estimation recordings.
        """
        known = nominal.stated(dict(run.extra.get("parameters", {})))
        recordings = [r for r in run.recordings if r.info.role == "estimation"]
        if not recordings:
            raise WrongUseError("the run has no estimation recording", "validation alone", "add one to be fitted to")
        ready = [following.simulated_along(r, _loop(run)) for r in recordings]
        first = nominal.estimated(ready, known)
        quiet = [following.quieter(f, with_nominal(first).vector()) for f in ready]
        found = nominal.estimated(quiet, known)
        lowest = min(quiet, key=lambda f: f.pass_hz)
        scales = nominal.scales(quiet)
        spread = nominal.spread(known, found, scales.peak_n if self._zero_is_ordinary else 0.0)
        own = ServoAxis(with_nominal(found), forms(scales), spread, lowest.pass_hz)
        own._kept_hz = lowest.rate_hz / lowest.keep
        return own

    def readied(self, run: Run, names: Sequence[str]) -> tuple[ServoAxis, Run, list[str]]:
        """The run's own axis, the run, and the recordings named, cut into pieces where these are fewer than `ENOUGH`.

        A diagnosis leaves recordings out to see what predicts them; of one recording there is nothing to leave out.
        """
        fitted = [r for r in run.recordings if r.info.role != "estimation" or {r.info.name, r.info.file} & set(names)]
        own = self.of_run(replace(run, recordings=tuple(fitted)))
        if len(names) >= ENOUGH:
            return own, run, list(names)
        cut = [piece for name in names for piece in following.pieces(run.recording(name), PIECE_S)]
        kept = [r for r in run.recordings if r.info.name not in names and r.info.file not in names]
        return own, replace(run, recordings=(*cut, *kept)), [piece.info.name for piece in cut]

    def default_controllers(self, rate_hz: float) -> tuple[Controller, ...]:
        """A controller that holds the nominal axis with a crossover at about a fiftieth of the rate, 20 Hz at most."""
        cross = min(20.0, rate_hz / 50.0)
        mass = self.parameters.rows[self.parameters.index("mass_kg")].value
        gain = mass * (2.0 * np.pi * cross) ** 2 / 3.0
        blocks = (
            Block("gain", {"gain": float(gain)}),
            Block("lead_lag", {"f1_hz": cross / 3.0, "f2_hz": 3.0 * cross}),
        )
        return (Controller("position", blocks, rate_hz),)

    def loop_setups(self, controllers: Sequence[Controller], injection: str) -> tuple[LoopSetup, ...]:
        """Columns of the loop; what enters at the plant's input is in N."""
        known = {c.loop: c for c in controllers}
        if set(known) != set(self.loops):
            raise WrongUseError("the servo axis needs one controller, of its loop position", ", ".join(known) or "none")
        injected = "n_position_n" if injection == "plant_input" else "n_position_m"
        return (LoopSetup("position", "reference_m", injected, "force_n", "position_m", known["position"]),)

    def setpoint(self, operating_point: Mapping[str, float]) -> tuple[float, ...]:
        """The reference in m at an operating point."""
        return (float(operating_point["position_m"]),)

    def check_operating_point(
        self, operating_point: Mapping[str, float], changes: Mapping[str, float] | None = None
    ) -> None:
        """Refuse a point with other keys than position_m, or outside the travel."""
        if set(operating_point) != {"position_m"}:
            raise WrongUseError("an operating point of the servo axis names position_m", f"{dict(operating_point)!r}")
        range_m = self._value(self.parameters.vector(changes), "range_m")
        if not abs(operating_point["position_m"]) < range_m:
            raise WrongUseError(
                f"the servo axis travels {range_m:g} m to both sides", f"{operating_point['position_m']:g} m"
            )

    def check_settings(self, rate_hz: float, changes: Mapping[str, float]) -> None:
        """Refuse unknown or out-of-bounds parameters."""
        self.parameters.vector(changes)

    def _value(self, vector: Array, name: str) -> float:
        return float(vector[self.parameters.index(name)])

    def simulate(
        self,
        experiments: Sequence[Experiment],
        *,
        solver: str = "edges",
        changes: Mapping[str, float] | None = None,
        threads: int | None = None,
        states: bool = False,
    ) -> list[Recording]:
        """One recording an experiment, in order. An axis that leaves its travel stops there and says so.

        Same experiments and seeds, same recordings; `states` adds the true ones. A kernel takes so little time that
        `threads` changes nothing.
        """
        refuse_unknown("a solver is not known", solver, self.solvers)
        return [self._run(e, dict(changes or {}), states) for e in experiments]

    def _run(self, e: Experiment, changes: dict[str, float], states: bool) -> Recording:
        vector = self.parameters.vector(changes | dict(e.parameters))
        sensor = np.array([self._value(vector, n) for n in ("position_noise_m", "position_step_m", "range_m")])
        start = float(e.operating_point.get("position_m", e.references[0, 0]))
        controller = e.loops[0].controller
        if controller is None or controller.rate_hz != e.rate_hz:
            raise WrongUseError(f"loop position needs a controller at the rig's rate {e.rate_hz:g} Hz")
        sections = controller.biquads()
        reference, injected = (np.array(values[:, 0]) for values in (e.references, e.injected))
        out = np.empty((e.samples, len(kernel.LOGGED) if states else kernel.MEASURED))
        inputs = kernel.Inputs(reference, injected, _INJECTIONS[e.injection], start_state(e.seed))
        ended, n = kernel.run(
            kernel.under_way(constants(vector), start, 0.0, 0.0), sensor, sections,
            np.zeros((len(sections), 2)), inputs, 1.0 / e.rate_hz, motion.STEPS, out,
        )  # fmt: skip
        return Recording(_info(e, ended, n), e.rate_hz, _columns(e, out[:n], n))

    def prepare(self, recording: Recording, run: Run, longest_s: float | None) -> following.Followed:
        """The recording's force and position, and the run's low-pass (of a bare axis: one that the noise allows)."""
        f = following.simulated_along(recording, _loop(run), longest_s)
        return following.quieter(f, self.parameters.vector()) if self._pass_hz is None else f.behind(self._pass_hz)

    def stays_in_range(self, recording: Recording, run: Run) -> bool:
        """Always: the model holds wherever the axis can go; `range_m` only ends simulations."""
        return True

    def residual_rate_hz(self, prepared: following.Followed, channel: str) -> float:
        """How many values a second `residuals` gives."""
        return self._kept_hz

    def traces(self, prepared: following.Followed, moves: Mapping[str, float]) -> tuple[float, Array, Array]:
        """Time step in s, and the force in N, measured and of the inverse model, behind the same low-pass."""
        measured = following.acting_n(prepared)
        step_s = prepared.keep / prepared.rate_hz
        return step_s, measured, measured - self.residuals(prepared, moves)["force"]

    def residuals(self, prepared: following.Followed, moves: Mapping[str, float]) -> dict[str, Array]:
        """`force` in N: measured minus that of the inverse model, filtered and thinned as `following` says."""
        return {"force": following.lacking_n(prepared, self.parameters.vector(moves))}

    def floors(self, prepared: following.Followed) -> dict[str, float]:
        """Rms in N that sensor noise and ordinary ripple leave in `residuals`; a force sensor's own is not known."""
        return {"force": following.floor_n(prepared, self.parameters.vector())}

    def relative_error(self, prepared: following.Followed, moves: Mapping[str, float]) -> float:
        """Rms of the force residual over that of the measured force behind the same filters."""
        acting = following.acting_n(prepared)
        lacking = self.residuals(prepared, moves)["force"]
        return float(np.linalg.norm(lacking) / np.linalg.norm(acting))

    def shapes(self, prepared: Sequence[following.Followed]) -> None:
        """None: its submodels follow what was measured, and say themselves where a disturbance would act."""

    def paths(self, prepared: following.Followed, moves: Mapping[str, float]) -> dict[str, Array]:
        """Measured minus modelled relative to its noise floor: `position -> force` as `residuals`.

        `force -> position` is drawn slowly.

        The floor of the position is where the force's floor, were it a slow force, would drive the mass within the
        time that the model is left alone, or the sensor's noise if that is more.
        """
        vector = self.parameters.vector(moves)
        nominal_vector = self.parameters.vector()
        force_n = following.floor_n(prepared, nominal_vector)
        position_m = following.drift_floor_m(prepared, nominal_vector, force_n)
        return {
            "position -> force": following.lacking_n(prepared, vector) / force_n,
            "force -> position": following.drift_m(prepared, vector) / position_m,
        }


def _loop(run: Run) -> LoopSetup | None:
    """The loop whose control is the force, if the run has one."""
    return next((loop for loop in run.loops if loop.control == "force_n"), None)


def _info(e: Experiment, ended: int, n: int) -> RecordingInfo:
    early = None if ended == kernel.COMPLETE else f"{_ENDED[ended]} at {n / e.rate_hz:.3f} s"
    return RecordingInfo.of(e, early)


def _columns(e: Experiment, out: Array, n: int) -> dict[str, Array]:
    loop, free = e.loops[0], e.injection == "control"
    columns = {"t_s": np.arange(n) / e.rate_hz}
    if loop.reference is not None:
        columns[loop.reference] = e.references[:n, 0]
    if loop.injected is not None:
        columns[loop.injected] = np.zeros(n) if free else e.injected[:n, 0]
    columns |= {"position_m": out[:, 0], "force_n": out[:, 1]}
    if out.shape[1] > kernel.MEASURED:
        columns |= {"true_position_m": out[:, 2], "true_velocity_m_s": out[:, 3], "true_load_m": out[:, 4]}
    return columns


def ordinary_axis() -> ServoAxis:
    """The axis whose numbers a study gives, diagnosed as ordinary at its zeros."""
    return ServoAxis(zero_is_ordinary=True)
