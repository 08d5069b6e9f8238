"""The nominal axis of a run: what its run.toml says, and by least squares what it leaves out; and the run's scales.

Positions go through a Butterworth low-pass of order 4, forwards and backwards, and are differentiated centrally; both
sides of mass q'' + viscous q' + stiffness q = F then go through the same low-pass. A force that a controller holds over
its ticks acts, about the time of a position, as the mean of two ticks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array
from loopshape.toolbox.gap.nouns.effect import Spread
from loopshape.toolbox.servo.following import LEAD_S, TAIL_S, Followed
from loopshape.toolbox.servo.parameters import NOMINAL

_GIVEN = {"mass_kg": 0.05, "viscous_ns_m": 0.20, "stiffness_n_m": 0.05}
_ESTIMATED = {"mass_kg": 0.30, "viscous_ns_m": 1.0}


@dataclass(frozen=True)
class Scales:
    """How much force, speed and travel occurs: rms and largest force in N, top speed in m/s, travel in m, rate."""

    force_n: float
    peak_n: float
    speed_m_s: float
    low_m: float
    high_m: float
    rate_hz: float

    @property
    def travel_m(self) -> float:
        """Width of the travel."""
        return self.high_m - self.low_m


def stated(parameters: Mapping[str, object]) -> dict[str, float]:
    """The nominal parameters that a run states; others, such as a simulation's effects, are left aside.

    Refuses what is no positive number; viscous friction and the spring may be zero.
    """
    out = {}
    for name in NOMINAL:
        if name not in parameters:
            continue
        value = parameters[name]
        usable = isinstance(value, (int, float)) and not isinstance(value, bool) and np.isfinite(value)
        if not usable or float(value) < 0.0 or (name == "mass_kg" and float(value) == 0.0):  # type: ignore[arg-type]
            raise WrongUseError(f"{name} of the servo axis is a positive number", f"{value!r}", "correct [parameters]")
        out[name] = float(value)  # type: ignore[arg-type]
    return out


def estimated(recordings: Sequence[Followed], known: Mapping[str, float]) -> dict[str, float]:
    """`known` with mass and viscous friction put in by least squares where they are missing.

    No friction but the viscous is in that fit, so where there is more the viscous one comes out too large: the
    diagnosis fits it again. Refuses recordings that do not move.
    """
    missing = [name for name in ("mass_kg", "viscous_ns_m") if name not in known]
    if not missing:
        return dict(known)
    tables = [regressors(f) for f in recordings]
    columns = {name: np.concatenate([t[name] for t in tables]) for name in (*NOMINAL, "force_n")}
    rest = columns["force_n"] - sum((known[n] * columns[n] for n in known), np.zeros_like(columns["force_n"]))
    table = np.stack([columns[name] for name in missing], axis=1)
    if np.linalg.matrix_rank(table / np.maximum(np.linalg.norm(table, axis=0), 1e-300)) < len(missing):
        raise BadSignalError(
            "mass and viscous friction cannot be estimated from the estimation recordings",
            "an axis that does not move",
            "give mass_kg and viscous_ns_m under [parameters] of run.toml",
        )
    found = dict(zip(missing, np.linalg.lstsq(table, rest, rcond=None)[0].tolist(), strict=True))
    if "mass_kg" in found and found["mass_kg"] <= 0.0:
        raise BadSignalError(
            "the estimation recordings give no positive mass",
            f"{found['mass_kg']:.3g} kg",
            "check the sign of force_n, or give mass_kg under [parameters] of run.toml",
        )
    if "viscous_ns_m" in found:
        least_viscous = 0.05  # of force over speed: what is estimated below cannot be scaled to anything
        least = least_viscous * _rms(columns["force_n"]) / _rms(columns["viscous_ns_m"])
        found["viscous_ns_m"] = max(found["viscous_ns_m"], least)
    return {**known, **found}


def regressors(f: Followed) -> dict[str, Array]:
    """Force and what each nominal parameter is multiplied with, by the parameter's name, low-passed and thinned."""
    force = f.force_n.copy()
    force[1:] = 0.5 * (f.force_n[1:] + f.force_n[:-1])
    return {name: passed(f, values) for name, values in ({"force_n": force} | differentiated(f)).items()}


def differentiated(f: Followed) -> dict[str, Array]:
    """Position in m, speed and acceleration (n,), by the name of the parameter that they are multiplied with."""
    q = sosfiltfilt(butter(4, f.observer_hz, fs=f.rate_hz, output="sos"), f.position_m)
    v = np.gradient(q) * f.rate_hz
    return {"mass_kg": np.gradient(v) * f.rate_hz, "viscous_ns_m": v, "stiffness_n_m": q}


def passed(f: Followed, values: Array) -> Array:
    """Values (n,) behind the recording's low-pass, lead and tail cut, thinned as the residuals are."""
    rows = slice(round(LEAD_S * f.rate_hz), values.size - round(TAIL_S * f.rate_hz), f.keep)
    return np.asarray(sosfiltfilt(f.sections, values)[rows])


def scales(recordings: Sequence[Followed]) -> Scales:
    """Scales over recordings; top speed and largest force are those that one sample in a thousand passes."""
    tables = [regressors(f) for f in recordings]
    speed = np.concatenate([np.abs(t["viscous_ns_m"]) for t in tables])
    force = np.concatenate([f.force_n for f in recordings])
    position = np.concatenate([f.position_m for f in recordings])
    return Scales(
        max(_rms(force), 1e-9),
        max(float(np.quantile(np.abs(force), 0.999)), 1e-9),
        max(float(np.quantile(speed, 0.999)), 1e-9),
        float(position.min()),
        max(float(position.max()), float(position.min()) + 1e-9),
        recordings[0].rate_hz,
    )


def spread(known: Mapping[str, float], nominal: Mapping[str, float], peak_n: float = 0.0) -> tuple[Spread, ...]:
    """Narrow where the run states a value, wide where it was estimated; a spring only where there is one.

    A drive's zero off by up to ORDINARY_ZERO of the largest force is ordinary, too.
    """
    half = {name: _GIVEN[name] if name in known else _ESTIMATED.get(name, 0.0) for name in NOMINAL}
    words = {"mass_kg": "mass", "viscous_ns_m": "viscous", "stiffness_n_m": "stiffness"}
    scaled = [
        Spread(words[name], (name,), half[name])
        for name in NOMINAL
        if half[name] > 0.0 and nominal.get(name, 0.0) > 0.0
    ]
    zero = [Spread("zero", ("force_offset_n",), ORDINARY_ZERO * peak_n, adds=True)] if peak_n > 0.0 else []
    return (*scaled, *zero)


#: of the largest force, uniform: of two other real drives the largest zero, 0.8 %, times 3/2, since the largest of n
#: such draws lies on average at n/(n + 1) of the bound (`experiments/emps`, zeros.csv)
ORDINARY_ZERO = 0.012


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
