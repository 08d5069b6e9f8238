"""The simulated arm at rest in closed loop over the PWM's dead zone: ripple, pulses, static error, kind of motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.units import Array, deg
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import measure
from loopshape.toolbox.rig.study import Study

REPEATS = 0.9999  # correlation with itself some PWM periods later: periodic
DECAYS = 0.8  # second half over first half: still on its way to rest
DEAD_DEG = 1e-4  # less than this peak to peak is rest


@dataclass(frozen=True, eq=False)
class Rest:
    """One run's last part. Angles in deg, pressures in mbar, rates per second over all four valves."""

    condition: str
    dead_zone: float
    experiment: str
    span_deg: float
    rms_deg: float
    span_mbar: float
    pulses_s: float
    answered_s: float
    error_deg: float
    error_mbar: float
    line_hz: float
    repeat_s: float
    repeat: float
    growth: float
    theta_deg: Array
    p_a_bar: Array
    u_a_v: Array

    @property
    def kind(self) -> str:
        """Rest, on its way to rest, a periodic limit cycle, or irregular motion."""
        if self.span_deg < DEAD_DEG:
            return "rest"
        if self.growth < DECAYS:
            return "decays"
        return "periodic" if self.repeat > REPEATS else "irregular"


def runs(folder: Path, settings: Mapping[str, Any]) -> Iterator[Rest]:
    """All of them: conditions, dead zones, experiments, and seeds where there is noise."""
    study = read_study(folder / "study.toml")
    for condition, words in settings["conditions"].items():
        noisy = words.get("angle_noise_deg", 1.0) > 0.0
        for dead_zone in settings["dead_zones"]:
            for seed in settings["noise_seeds"] if noisy else settings["noise_seeds"][:1]:
                changed = replace(study, pwm={"dead_zone": dead_zone}, changes=changes(words), seed=seed)
                yield from one_study(changed, condition, dead_zone, settings["from_s"])


def changes(words: Mapping[str, float]) -> dict[str, float]:
    """The plant's parameters that a condition means."""
    own = {k: v for k, v in words.items() if k != "late_valves"}
    if words.get("late_valves"):
        opens, closes = value("valve_response_open"), value("valve_response_close")
        own |= {"valve_opening_delay_ms": opens, "valve_closing_ratio": closes / opens}
    return own


def one_study(study: Study, condition: str, dead_zone: float, from_s: float) -> Iterator[Rest]:
    """The study's recordings, each as its last part."""
    for recording in measure(study, Arm1(), states=True, threads=1):
        if recording.info.ended_early:
            raise RuntimeError(f"{condition}, dead zone {dead_zone:g}: {recording.info.ended_early}")
        yield last_part(recording, condition, dead_zone, from_s)


def last_part(recording: Recording, condition: str, dead_zone: float, from_s: float) -> Rest:
    """What is measured of one recording."""
    late = slice(round(from_s * recording.rate_hz), None)
    theta = deg(recording.column("true_theta2_rad")[late])
    p_a, p_b = (1e3 * recording.column(f"true_p_{k}_bar")[late] for k in "ab")
    off = theta - deg(recording.column("r_theta2_rad")[late])
    off_p = p_a + p_b - 1e3 * recording.column("r_p_ab_bar")[late]
    line_hz = strongest_line(theta - theta.mean(), recording.rate_hz)
    repeat_s, repeat = repetition(theta, recording.rate_hz)
    half = theta.size // 2
    growth = float(theta[half:].std() / max(theta[:half].std(), 1e-15))
    lengths = pulse_lengths(recording, dead_zone)[:, round(from_s * value("pwm_frequency")) :]
    seconds = lengths.shape[1] / value("pwm_frequency")
    answered = float((lengths > 1e-3 * value("valve_response_open")).sum() / seconds)
    return Rest(
        condition, dead_zone, recording.info.name, float(np.ptp(theta)), float(theta.std()), float(np.ptp(p_a)),
        float((lengths > 0.0).sum() / seconds), answered, float(off.mean()), float(off_p.mean()),
        line_hz, repeat_s, repeat, growth, theta, 1e-3 * p_a, recording.column("u_a_v")[late],
    )  # fmt: skip


def pulse_lengths(recording: Recording, dead_zone: float) -> Array:
    """Lengths in s of the pulses of muscles A and B, (2, periods)."""
    ticks = round(recording.rate_hz / value("pwm_frequency"))
    period_s = 1.0 / value("pwm_frequency")
    return np.array(
        [[pwm.pulse_s(u, period_s, dead_zone) for u in recording.column(c)[::ticks]] for c in ("u_a_v", "u_b_v")]
    )


def repetition(x: Array, rate_hz: float) -> tuple[float, float]:
    """After how many s, a whole number of PWM periods and at most half of `x`, it repeats itself best, and how well.

    A motion that the periods of the PWM take part in can only repeat after a whole number of them.
    """
    n, period = x.size // 2, round(rate_hz / value("pwm_frequency"))
    lags = np.arange(5 * period, n, period)
    parts = np.array([x[:n], *(x[k : k + n] for k in lags)])
    parts = parts - parts.mean(axis=1, keepdims=True)
    parts = parts / np.maximum(np.linalg.norm(parts, axis=1, keepdims=True), 1e-300)
    alike = parts[1:] @ parts[0]
    best = int(np.flatnonzero(alike > alike.max() - 1e-6)[0])  # the first of equals: not a multiple of it
    return float(lags[best] / rate_hz), float(alike[best])


def strongest_line(x: Array, rate_hz: float) -> float:
    """Frequency in Hz of the strongest line, by a Hann window."""
    if not x.any():
        return 0.0
    power = np.abs(np.fft.rfft(x * np.hanning(x.size))) ** 2
    power[:2] = 0.0
    return float(np.argmax(power) * rate_hz / x.size)


def summary(found: list[Rest]) -> list[list[Any]]:
    """A line for each condition and dead zone: medians and largest over experiments and seeds."""
    keys = list(dict.fromkeys((r.condition, r.dead_zone) for r in found))
    return [line(key, [r for r in found if (r.condition, r.dead_zone) == key]) for key in keys]


def line(key: tuple[str, float], some: list[Rest]) -> list[Any]:
    """One line of the summary."""
    kinds = [r.kind for r in some]
    words = ", ".join(f"{kinds.count(k)} {k}" for k in dict.fromkeys(sorted(kinds)))

    def middle(name: str) -> float:
        return float(np.median([getattr(r, name) for r in some]))

    largest = [float(max(abs(getattr(r, name)) for r in some)) for name in ("span_deg", "error_deg", "error_mbar")]
    return [*key, middle("span_deg"), largest[0], middle("span_mbar"), middle("pulses_s"), middle("answered_s"),
            *largest[1:], middle("line_hz"), middle("repeat_s"), middle("repeat"), middle("growth"), words]  # fmt: skip
