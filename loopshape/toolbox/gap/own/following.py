"""A recording followed in short windows (multiple shooting): each starts from a state estimated with the fit.

In every window the simulator is driven by the measured inputs alone. Its initial state is what fits the measured
outputs best: two steps of Gauss-Newton, by slopes taken at the very parameters that are judged (Bock 1983). What no
initial state explains is the residual, averaged over short blocks. The first tenth of a window is not compared: there
delays look for what was before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.signal import lfilter

from loopshape.core.errors import BadSignalError
from loopshape.core.units import Array
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.gap.own import kernel
from loopshape.toolbox.gap.own.composed import Composed
from loopshape.toolbox.gap.own.signals import actuated, noise_rms, sensed

FASTEST_HZ, SLOWEST_HZ = 500.0, 500.0  # ticks of the simulation: faster recordings are thinned, slower ones divided
LEAD = 0.1  # share of a window
BLOCKS = 100  # compared values a window
RIPPLE = 0.002  # share of the motion within a window that a good model leaves
_STEP = 1e-4  # of a state's range, for slopes
CONVERGED = 6  # rounds for initial states of what is judged, not fitted
RUN_AWAY = 1e5  # floors: a simulation that is further off has run away


@dataclass(frozen=True, eq=False)
class Followed:
    """A recording ready to be followed.

    `u` (n, nu) inputs, `y` (n, ny) outputs in the model's units; windows begin at rows `first` (windows,), last
    `length` ticks, of which `lead` are not compared; `start` (windows, nx) are initial states, `ranges` (nx,) how far
    states move, `floor` (ny,) what noise leaves of a compared value; `constants` are the model's parameters that have a
    value of this recording's own.
    """

    name: str
    tick_s: float
    u: Array
    y: Array
    first: np.ndarray
    length: int
    lead: int
    block: int
    start: Array
    ranges: Array
    floor: Array
    constants: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def measured(self) -> Array:
        """Measured outputs (windows, blocks, ny)."""
        return self.blocks(self.y[self.first[:, None] + np.arange(self.length)])

    def blocks(self, values: Array) -> Array:
        """Means over blocks (windows, blocks, ny) of values (windows, length, ny)."""
        kept = values[:, self.lead :]
        if self.block == 1:
            return kept
        return np.asarray(kept.reshape(kept.shape[0], -1, self.block, kept.shape[2]).mean(axis=2))


@dataclass(frozen=True, eq=False)
class Push:
    """Signals from outside the model: `u` (n, nu) added to what the actuators give, `y` (windows, blocks, ny) to what
    the sensors read."""

    u: Array | None = None
    y: Array | None = None


def simulated_along(c: Composed, recording: Recording, longest_s: float | None) -> Followed:
    """A recording, or its first `longest_s`, with first guesses of initial states.

    What is measured, or a slope of it, starts from a parabola through the first samples: a wrong model must not move
    it. What is not seen starts from what fits the nominal model.
    """
    model, keep = c.model, max(1, int(recording.rate_hz // FASTEST_HZ))
    rows = len(recording.column(model.outputs[0].column)) // keep * keep
    if longest_s is not None:
        rows = min(rows, round(longest_s * recording.rate_hz) // keep * keep)
    tick_s = keep / recording.rate_hz
    u, y = _inputs(c, recording, rows, keep), _outputs(c, recording, rows)
    noise = np.array([noise_rms(y[:, k]) for k in range(y.shape[1])])
    y = np.ascontiguousarray(y[::keep])
    block = max(1, round(c.window_s / tick_s / BLOCKS))
    lead = max(2, round(LEAD * c.window_s / tick_s))
    window = max(4, round(c.window_s / tick_s / block)) * block
    # time constants, after which a state that follows the inputs has forgotten its start
    settled = round(max((3.0 / rate for rate in c.lags.values()), default=0.0) / tick_s)
    first = np.arange(settled, len(y) - lead - window + 1, window)
    if not first.size:
        raise BadSignalError(
            f"recording {recording.info.file} is shorter than a window of the model",
            f"{rows / recording.rate_hz:.3g} s", f"give window_s below {c.window_s:g}",
        )  # fmt: skip
    start, ranges = _guessed(c, y, first, lead, tick_s)
    own = dict(recording.info.parameters)
    for k, rate in c.lags.items():
        start[:, k] = _lagging(c, u, k, rate, tick_s)[first]
    f = Followed(recording.info.name, tick_s, u, y, first, lead + window, lead, block, start, ranges, noise, own)
    f = replace(f, floor=_floor(c, f, noise))
    for _ in range(4 * bool(c.hidden)):
        change = _step(c, f, {})[:, c.hidden]
        f.start[:, c.hidden] += change
    return f


def _lagging(c: Composed, u: Array, k: int, rate: float, tick_s: float) -> Array:
    """A state (n,) that follows the inputs (n, nu) alone, settled at the first row."""
    still, values = np.zeros(len(c.model.states)), c.values({})
    ends = np.array([float(c.motion(0.0, still, row, values)[k]) / rate for row in u])
    pole = np.exp(-rate * tick_s)
    later, _ = lfilter([0.0, 1.0 - pole], [1.0, -pole], ends, zi=ends[:1])
    return np.asarray(later)


def _inputs(c: Composed, recording: Recording, rows: int, keep: int) -> Array:
    """Inputs (n, nu) of the model: means over the ticks that are put together, since each is held."""
    out = np.zeros((rows // keep, len(c.model.inputs)))
    for k, i in enumerate(c.model.inputs):
        if i.column is not None:
            values = i.factor * recording.column(i.column)[:rows]
            values = values if i.limits is None else np.clip(values, *i.limits)
            out[:, k] = values.reshape(-1, keep).mean(axis=1)
    return out


def _outputs(c: Composed, recording: Recording, rows: int) -> Array:
    return np.stack([o.factor * recording.column(o.column)[:rows] + o.offset for o in c.model.outputs], axis=1)


def _floor(c: Composed, f: Followed, noise: Array) -> Array:
    """Rms (ny,) that noise, rounding and an ordinary model leave in the mean of a block.

    What the user says that a good model leaves stands for all that, but it cannot be less than noise and rounding.
    """
    motion = f.measured.std(axis=1).mean(axis=0)
    steps = np.array([_step_of(f.y[:, k]) for k in range(f.y.shape[1])])
    sensor = noise**2 / f.block + steps**2 / 12.0
    stated = np.array([o.leaves or 0.0 for o in c.model.outputs])
    squares = np.where(stated > 0.0, np.maximum(stated**2, sensor), sensor + (RIPPLE * motion) ** 2)
    return np.asarray(np.sqrt(squares))


def _step_of(values: Array) -> float:
    """The step to which a sensor rounds; 0 where values do not repeat."""
    levels = np.unique(values)
    return float(np.min(np.diff(levels))) if 1 < levels.size < 0.5 * values.size else 0.0


def _guessed(c: Composed, y: Array, first: np.ndarray, lead: int, tick_s: float) -> tuple[Array, Array]:
    """Initial states (windows, nx) and ranges (nx,): measured states, slopes of them, 0 for what is not seen."""
    model = c.model
    start, ranges = np.zeros((first.size, len(model.states))), np.ones(len(model.states))
    rows = first[:, None] + np.arange(lead)
    for k, o in enumerate(model.outputs):
        place = model.states.index(o.state)
        ticks = np.arange(lead) * tick_s  # of two ticks the smallest parabola: a first guess, `full` warns of no rank
        line, _ = np.polynomial.polynomial.polyfit(ticks, y[rows, k].T, 2, full=True)
        start[:, place], ranges[place] = line[0], max(float(np.ptp(y[:, k])), 1e-12)
        speed = c.speeds.get(place)
        if speed is not None:
            start[:, speed] = line[1]
            ranges[speed] = max(
                float(np.ptp(np.diff(y[:: max(lead // 4, 1), k]))) / (max(lead // 4, 1) * tick_s), 1e-12
            )
    return start, ranges


def simulated(c: Composed, f: Followed, m: Mapping[str, float], x0: Array, push: Push | None = None) -> Array:
    """Outputs (k, blocks, ny) from extended initial states x0 (k, extended), k a multiple of the windows."""
    u = np.column_stack([actuated(f.u[:, j], c.actuator(j, m), f.tick_s) for j in range(f.u.shape[1])])
    if push is not None and push.u is not None:
        u = u + push.u
    out = np.empty((len(x0), f.length, len(c.model.states)))
    first = np.tile(f.first, len(x0) // len(f.first))
    stable, finest_hz = 1.2, 2e4  # rate of a mode times the step, half of what the integration bears; no finer steps
    steps = max(1, int(np.ceil(f.tick_s * min(max(SLOWEST_HZ, c.fastest / stable), finest_hz))))
    driving = kernel.Driving(first, np.ascontiguousarray(u), f.tick_s, steps)
    c.run(m, c.values(m, f.constants), x0, driving, out)
    states = [out[:, :, c.model.states.index(o.state)] for o in c.model.outputs]
    read = f.blocks(np.stack([sensed(x, c.sensor(k, m), f.tick_s) for k, x in enumerate(states)], axis=2))
    return read if push is None or push.y is None else read + np.tile(push.y, (len(x0) // len(f.first), 1, 1))


def repeated(c: Composed, f: Followed, m: Mapping[str, float], share: float) -> Followed:
    """The windows in a row as the model gives them, without noise, inputs and initial states `share` times as large.

    What schedules stays as it is.
    """
    rows, first = f.first[:, None] + np.arange(f.length), np.arange(f.first.size) * f.length
    size = np.array([1.0 if i.schedules else share for i in c.model.inputs])
    u = np.ascontiguousarray(size * f.u[rows].reshape(-1, f.u.shape[1]))
    own = replace(f, u=u, first=first, start=share * f.start, ranges=share * f.ranges)
    whole = replace(own, block=1, lead=0)
    y = simulated(c, whole, m, extended(c, whole, own.start))
    return replace(own, y=y.reshape(-1, y.shape[2]))


def extended(c: Composed, f: Followed, start: Array) -> Array:
    """Initial states with those of the ports behind: motors stand where their loads do."""
    out = np.zeros((len(start), start.shape[1] + kernel.PER_PORT * len(c.model.ports)))
    out[:, : start.shape[1]] = start
    for j in range(len(c.model.ports)):
        at = start.shape[1] + kernel.PER_PORT * j
        out[:, at + kernel.MOTOR] = start[:, c.places[j, kernel.POSITION]]
        out[:, at + kernel.MOTOR_SPEED] = start[:, c.places[j, kernel.SPEED]]
    return out


def off(f: Followed, y: Array) -> Array:
    """Measured minus simulated outputs y (k, blocks, ny) per noise floor, (k, values); what runs away is cut off."""
    lacking = (f.measured - y.reshape(-1, *f.measured.shape)) / f.floor
    np.clip(lacking, -RUN_AWAY, RUN_AWAY, out=lacking)
    lacking[np.isnan(lacking)] = RUN_AWAY
    return lacking.reshape(len(y), -1)


def shot(
    c: Composed, f: Followed, m: Mapping[str, float], x0: Array | None = None
) -> tuple[Array, Array, Array, np.ndarray]:
    """Lacking (windows, values), slopes (windows, values, states) per noise floor, x0, and which states are free."""
    x0 = extended(c, f, f.start) if x0 is None else x0
    free = c.free_states(m)
    ranges = c.extended_ranges(f.ranges)
    moved = np.tile(x0, (1 + free.size, 1))
    n = len(x0)
    for k, place in enumerate(free):
        moved[(1 + k) * n : (2 + k) * n, place] += _STEP * ranges[place]
    lacking = off(f, simulated(c, f, m, moved)).reshape(1 + free.size, n, -1)
    return lacking[0], np.moveaxis((lacking[0] - lacking[1:]) / _STEP, 0, 2), x0, free


def _solved(slopes: Array, lacking: Array) -> Array:
    """Changes (windows, states) in ranges that explain what is lacking (windows, values) best."""
    h = np.einsum("wvi,wvj->wij", slopes, slopes)
    prior = 1.0 / 9.0  # an initial state lies within three ranges of the first guess
    rounding = 1e-12
    hold = prior + rounding * np.trace(h, axis1=1, axis2=2)  # slopes of what runs away are no numbers to rely on
    h += hold[:, None, None] * np.eye(slopes.shape[2])
    return np.asarray(np.linalg.solve(h, np.einsum("wvi,wv->wi", slopes, lacking)[:, :, None])[:, :, 0])


def _step(c: Composed, f: Followed, m: Mapping[str, float]) -> Array:
    """Change of the extended initial states that fits best, by straight lines."""
    lacking, slopes, x0, free = shot(c, f, m)
    change = np.zeros_like(x0)
    change[:, free] = _solved(slopes, lacking) * c.extended_ranges(f.ranges)[free]
    return change


def explained(c: Composed, f: Followed, m: Mapping[str, float], rounds: int = 1) -> Array:
    """Simulated outputs (windows, blocks, ny) from the initial states that fit best under moved parameters.

    A window whose step does not pay takes a shorter one, or none: where dry friction holds, slopes tell little. One
    round serves a fit; what is judged takes CONVERGED, since a window in which the nominal model has run away may need
    them all.
    """
    found = started(c, f, m, rounds)
    return _simulated(f, _projected(found.slopes, found.lacking))


@dataclass(frozen=True, eq=False)
class Started:
    """A recording under some moves: lacking (windows, values) and slopes (windows, values, states) at the initial
    states x0 that fit best, of which those at `free` may change."""

    lacking: Array
    slopes: Array
    x0: Array
    free: np.ndarray


def nearby(c: Composed, f: Followed, near: Started, m: Mapping[str, float]) -> Array:
    """Simulated outputs as of `explained`, initial states answering by the slopes of other moves: two simulations.

    The second goes on from where the first says that windows start (variable projection with slopes kept: Kaufman
    1975); a window that it does not serve keeps the first.
    """
    lacking = off(f, simulated(c, f, m, near.x0))
    x0 = near.x0.copy()
    x0[:, near.free] += _solved(near.slopes, lacking) * c.extended_ranges(f.ranges)[near.free]
    tried = [_projected(near.slopes, found) for found in (lacking, off(f, simulated(c, f, m, x0)))]
    sizes = [np.sum(values**2, axis=1) for values in tried]
    return _simulated(f, np.where((sizes[1] < sizes[0])[:, None], tried[1], tried[0]))


def _simulated(f: Followed, lacking: Array) -> Array:
    return f.measured - lacking.reshape(f.measured.shape) * f.floor


def started(c: Composed, f: Followed, m: Mapping[str, float], rounds: int) -> Started:
    """Where a recording starts under some moves."""
    x0 = extended(c, f, f.start)
    as_promised = 0.1  # of what straight lines promise of a step: one that lacks no more of it is not shortened
    for _ in range(rounds):
        lacking, slopes, x0, free = shot(c, f, m, x0)
        change = np.zeros_like(x0)
        step = _solved(slopes, lacking)
        change[:, free] = step * c.extended_ranges(f.ranges)[free]
        tried, moved = off(f, simulated(c, f, m, x0 + change)), x0 + change
        least = lacking - np.einsum("wvi,wi->wv", slopes, step)
        now, promised, then = (np.sum(v**2, axis=1) for v in (lacking, least, tried))
        if (rows := np.flatnonzero(then > promised + as_promised * (now - promised))).size:
            # of a step of the initial states, where the whole one does not pay
            some, shorter = replace(f, first=f.first[rows]), x0[rows] + 0.2 * change[rows]
            less = off(some, simulated(c, some, m, shorter))
            pays = np.sum(less**2, axis=1) < then[rows]
            tried[rows[pays]], moved[rows[pays]] = less[pays], shorter[pays]
            then = np.sum(tried**2, axis=1)
        pays = then < now
        lacking, x0 = np.where(pays[:, None], tried, lacking), np.where(pays[:, None], moved, x0)
    return Started(lacking, slopes, x0, free)


def _projected(slopes: Array, lacking: Array) -> Array:
    """What of (windows, values) initial states do not explain, by straight lines."""
    return np.asarray(lacking - np.einsum("wvi,wi->wv", slopes, _solved(slopes, lacking)))


def pushed(c: Composed, f: Followed, m: Mapping[str, float], pushes: Sequence[Push]) -> Array:
    """What each push does to the outputs per noise floor, (windows, values, pushes), initial states answering.

    By straight lines from the initial states that fit best without: a push is so small that it stays one. Only the
    windows that a push is felt in are simulated.
    """
    at = started(c, f, m, CONVERGED)
    still = simulated(c, f, m, at.x0)
    rows = f.first[:, None] + np.arange(f.length)
    out = []
    for push in pushes:
        moved = np.zeros_like(still) if push.y is None else push.y.copy()
        felt = np.flatnonzero(push.u[rows].any(axis=(1, 2))) if push.u is not None else ()
        if len(felt):
            moved[felt] += simulated(c, replace(f, first=f.first[felt]), m, at.x0[felt], push) - still[felt]
        moved = np.clip(np.nan_to_num(moved / f.floor, nan=0.0), -RUN_AWAY, RUN_AWAY)
        out.append(_projected(at.slopes, moved.reshape(len(at.x0), -1)))
    return np.stack(out, axis=2)
