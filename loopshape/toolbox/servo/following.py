"""The axis that follows a recording, and what force it lacks: measured force minus that of the inverse model.

The model is driven by the logged force and drawn to the measured position by an observer. What the observer has to
add is the force that the model lacks: for an axis without effects exactly (F - mass q'' - viscous q' - stiffness q),
both sides behind one low-pass (two poles, relative damping 0.7). So no position is differentiated, every effect
acts as in the simulation, play and delay too, and an inverse model is never written down. The lacking force then goes
through a Butterworth low-pass of order 4, forwards and backwards, and every `keep`-th sample is kept.

Frequencies at a rate of 1 kHz: observer 100 Hz, low-pass 40 Hz, kept 100 Hz; they fall with slower rates, and the
low-pass with noise, until noise is less than a tenth of the force. An observer of `SLOW_HZ` leaves the position to
the model: what is left of it is position seen from force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import butter, sosfiltfilt

from loopshape.core.errors import BadSignalError
from loopshape.core.units import TWO_PI, Array
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.gap.own.signals import noise_rms
from loopshape.toolbox.servo import closed_loop, motion
from loopshape.toolbox.servo.parameters import AXIS_PARAMETERS, MASS, SHARE, constants

LEAD_S, TAIL_S = 0.3, 0.1  # not compared: states settle, the low-pass meets the end
OBSERVER_HZ, PASS_HZ, SLOW_HZ = 100.0, 40.0, 0.3
RIPPLE = 0.01  # of the force: cogging and reluctance, a drive's gain; sensors of real axes are far finer than that
_DAMPING = 0.7
_SHORTEST_S = 1.0


@dataclass(frozen=True, eq=False)
class Followed:
    """A recording ready to be followed: forces (n,) in N and positions (n,) in m, its low-pass and sensor's noise."""

    name: str
    force_n: Array
    position_m: Array
    rate_hz: float
    observer_hz: float
    pass_hz: float
    noise_m: float

    def behind(self, pass_hz: float) -> Followed:
        """The same with another low-pass."""
        return replace(self, pass_hz=pass_hz)

    @property
    def keep(self) -> int:
        """One in how many samples is kept."""
        return max(1, int(0.4 * self.rate_hz / self.pass_hz))

    @property
    def sections(self) -> Array:
        """The low-pass."""
        return np.asarray(butter(4, self.pass_hz, fs=self.rate_hz, output="sos"))


def simulated_along(recording: Recording, loop: LoopSetup | None = None, longest_s: float | None = None) -> Followed:
    """A recording, or its first `longest_s` after the lead; refuses one without force, position or length.

    What was injected at the plant's input (`loop` names its column) belongs to the force.
    """
    if missing := [name for name in ("force_n", "position_m") if name not in recording.columns]:
        raise BadSignalError(
            f"recording {recording.info.file} has no column {missing[0]}, by which a servo axis is followed",
            f"columns {', '.join(recording.columns)}",
            'name the columns, of a rotary axis too, in a model: --model model.toml with axis = "rotary"',
        )
    force, position = np.array(recording.column("force_n")), recording.column("position_m")
    if recording.info.injection == "plant_input" and loop is not None and loop.injected in recording.columns:
        force += recording.column(str(loop.injected))
    n = force.size
    if longest_s is not None and np.isfinite(longest_s):
        n = min(n, round((LEAD_S + TAIL_S + longest_s) * recording.rate_hz))
    if n < (LEAD_S + TAIL_S + _SHORTEST_S) * recording.rate_hz:
        raise BadSignalError(
            f"recording {recording.info.file} is too short to be followed",
            f"{n / recording.rate_hz:.3g} s",
            f"give at least {LEAD_S + TAIL_S + _SHORTEST_S:g} s",
        )
    observer_hz = min(OBSERVER_HZ, 0.1 * recording.rate_hz)  # the observer's largest share of the rate
    arrays = (np.ascontiguousarray(force[:n]), np.array(position[:n]))
    return Followed(
        recording.info.name,
        *arrays,
        recording.rate_hz,
        observer_hz,
        PASS_HZ / OBSERVER_HZ * observer_hz,
        noise_rms(position[:n]),
    )


def quieter(f: Followed, vector: Array) -> Followed:
    """The same with its low-pass lowered until noise leaves less than a tenth of the force."""
    lowest = 0.05 * f.pass_hz  # of PASS_HZ
    while f.pass_hz > lowest and noise_n(f, vector) > 0.1 * np.sqrt(np.mean(f.force_n**2)):  # of the force's rms
        f = replace(f, pass_hz=0.5 * f.pass_hz)
    return f


def pieces(recording: Recording, length_s: float) -> list[Recording]:
    """A recording cut into recordings of about `length_s` that each bring their own lead and tail along.

    Names are the recording's with -01, -02, ... behind it.
    """
    rate = recording.rate_hz
    n = min(np.asarray(c).size for c in recording.columns.values())
    lead, tail = round(LEAD_S * rate), round(TAIL_S * rate)
    count = max(1, round((n - lead - tail) / rate / length_s))
    edges = np.linspace(lead, n - tail, count + 1).astype(int)
    out = []
    for k, (start, stop) in enumerate(pairwise(edges.tolist())):
        rows = slice(start - lead, stop + tail)
        info: RecordingInfo = replace(recording.info, file=f"{recording.info.name}-{k + 1:02d}.parquet", period_s=None)
        out.append(replace(recording, info=info, columns={name: v[rows] for name, v in recording.columns.items()}))
    return out


def observer_gains(f_hz: float, tick_s: float) -> tuple[float, float]:
    """Gains per tick of position and velocity (1/s) that give a double integrator two poles at f, damping 0.7."""
    turn = TWO_PI * f_hz * tick_s
    radius = np.exp(-_DAMPING * turn)
    position = 1.0 - radius**2
    twice = 2.0 * radius * np.cos(np.sqrt(1.0 - _DAMPING**2) * turn)
    return float(position), float((2.0 - position - twice) / tick_s)


def missed(f: Followed, c: Array, observer_hz: float) -> Array:
    """Measured minus modelled position (n,) in m before each pull of an observer."""
    few = max(2, round(0.02 * f.rate_hz))
    slope, position = np.polyfit(np.arange(few) / f.rate_hz, f.position_m[:few], 1)
    axis = closed_loop.under_way(c, float(position), float(slope), float(f.force_n[0]))
    gains = observer_gains(observer_hz, 1.0 / f.rate_hz)
    steps = motion.STEPS if c[SHARE] > 0.0 else 1  # one mass is exact enough in one step a tick
    return closed_loop.follow(axis, f.force_n, f.position_m, gains, 1.0 / f.rate_hz, steps)


def lacking_n(f: Followed, vector: Array) -> Array:
    """The force in N that the model lacks, measured minus inverse model, low-passed and thinned."""
    c = constants(vector)
    _, gain = observer_gains(f.observer_hz, 1.0 / f.rate_hz)
    return _passed(f, -c[MASS] * gain * f.rate_hz * missed(f, c, f.observer_hz))


def acting_n(f: Followed) -> Array:
    """The measured force in N behind the same low-passes, thinned: what relative errors are relative to."""
    still = replace(f, position_m=np.zeros_like(f.position_m))
    return lacking_n(still, AXIS_PARAMETERS.vector({"viscous_ns_m": 0.0}))


def _passed(f: Followed, values: Array) -> Array:
    """Low-passed without a shift, ends cut, every `keep`-th sample."""
    runs_away = not np.isfinite(values).all()  # a wrong hypothesis may; that is no crash
    values = np.full_like(values, np.nan) if runs_away else sosfiltfilt(f.sections, values)
    lead, tail = round(LEAD_S * f.rate_hz), round(TAIL_S * f.rate_hz)
    return np.asarray(values[lead : values.size - tail : f.keep])


def noise_n(f: Followed, vector: Array) -> float:
    """Rms in N that the position sensor's noise leaves of `lacking_n` where the model has no effect."""
    n = round((2.0 * LEAD_S + TAIL_S + 1.0) * f.rate_hz)
    row = LEAD_S + 0.5
    pulse = np.zeros(n)
    pulse[round(row * f.rate_hz)] = 1.0
    plain = replace(f, force_n=np.zeros(n), position_m=pulse)
    c = constants(vector)
    _, gain = observer_gains(f.observer_hz, 1.0 / f.rate_hz)
    answer = sosfiltfilt(f.sections, c[MASS] * gain * f.rate_hz * missed(plain, c, f.observer_hz))
    return f.noise_m * float(np.sqrt(np.sum(answer**2)))


def floor_n(f: Followed, vector: Array) -> float:
    """Rms in N that is no gap: the sensor's noise, and a drive's ordinary ripple of `RIPPLE` of the force."""
    return float(np.hypot(noise_n(f, vector), RIPPLE * np.sqrt(np.mean(acting_n(f) ** 2))))


def drift_m(f: Followed, vector: Array) -> Array:
    """Measured minus modelled position in m, the model drawn back by `SLOW_HZ` alone, thinned."""
    values = missed(f, constants(vector), SLOW_HZ)
    return np.asarray(values[round(LEAD_S * f.rate_hz) :: f.keep])


def drift_floor_m(f: Followed, vector: Array, force_n: float) -> float:
    """Rms in m that a slow force of rms `force_n` leaves of `drift_m`, or the sensor's noise if that is more."""
    c = constants(vector)
    _, gain = observer_gains(SLOW_HZ, 1.0 / f.rate_hz)
    return max(f.noise_m, force_n / (c[MASS] * gain * f.rate_hz))
