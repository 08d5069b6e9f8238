"""What disturbs a loop, as the spectrum of its error under the controller that closed it then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.gate import gated, pass_fields
from loopshape.core.units import Array, ComplexArray
from loopshape.data.arrays import real_array
from loopshape.data.control.controller import Controller

#: share of a recording over which its ends are faded in and out, so that a steep spectrum does not leak
FADED = 0.2
LEAST_SAMPLES = 512


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Power (nf,) of a loop's error on its lines, in the output's unit squared, while `recorded_under` closed the loop.

    The powers add up to the mean square; `scatter` (nf,) is the variance of each, 0 for a spectrum that is given. What
    disturbs may enter anywhere in the loop, the sensor's noise included: all of it goes through S. Without
    `recorded_under` it is the spectrum of the output in open loop. `rms` is that of the error under that controller.
    `duration_s` is the length of the record, which a peak belongs to, nan where it is not known; `samples` (n,) are the
    recorded error itself, none of a spectrum; `control_mean` is the mean of the plant's input in its unit. What
    `repeats` is the same each time, as a setpoint's profile is, and not noise.
    """

    frequency_hz: Array
    power: Array
    scatter: Array
    recorded_under: Controller | None = None
    loop: str = ""
    recording: str = ""
    operating_point: Mapping[str, float] = field(default_factory=dict)
    duration_s: float = float("nan")
    control_mean: float = 0.0
    samples: Array = field(default_factory=lambda: np.zeros(0))
    repeats: bool = False

    def __post_init__(self) -> None:
        pass_fields(self)
        for name in ("frequency_hz", "power", "scatter"):
            values = real_array(getattr(self, name), f"{name} of a disturbance", ndim=1)
            if values.shape != np.shape(self.frequency_hz):
                raise WrongUseError(f"{name} of a disturbance is (nf,) and finite", f"{values.shape}")
            if values.min(initial=0.0) < 0.0:
                raise WrongUseError(f"{name} of a disturbance must not be negative", f"{values.min():g}")
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        samples = real_array(self.samples, "samples of a disturbance", ndim=1)
        samples.setflags(write=False)
        object.__setattr__(self, "samples", samples)
        held = self.recorded_under
        if held is not None and self.rate_hz is not None and abs(self.rate_hz - held.rate_hz) > 1e-6 * held.rate_hz:
            raise WrongUseError(
                "a disturbance was recorded at another rate than the controller's that closed the loop",
                f"{self.rate_hz:g} Hz and {held.rate_hz:g} Hz", "give the controller as it ran",
            )  # fmt: skip
        if self.duration_s <= 0.0 or not np.isfinite(self.control_mean):
            raise WrongUseError(
                "duration_s of a disturbance must be positive, control_mean finite",
                f"{self.duration_s!r}, {self.control_mean!r}",
            )

    def __repr__(self) -> str:
        """One line: what it is of, its length and its frequencies."""
        of, f = " ".join(word for word in (self.loop, self.recording) if word), self.frequency_hz
        return f"Disturbance{f' {of}' if of else ''}: {self.duration_s:.4g} s, {f.size} frequencies to {f[-1]:.4g} Hz"

    @classmethod
    @gated
    def from_spectrum(
        cls, frequency_hz: ArrayLike, density: ArrayLike, *, recorded_under: Controller | None = None, loop: str = "",
        duration_s: float = float("nan"), control_mean: float = 0.0,
    ) -> Disturbance:  # fmt: skip
        """A disturbance at the plant's output from its one-sided density (nf,) in unit²/Hz, straight between lines.

        With `recorded_under` it is the density of the error under that controller. Peaks are those of Gaussian noise
        over `duration_s`, and not read without it. Refuses fewer than two frequencies, and frequencies that do not
        rise.

        >>> import loopshape as ls
        >>> round(ls.Disturbance.from_spectrum([1.0, 11.0], [0.4, 0.4]).rms, 6)
        2.0
        """
        f = real_array(frequency_hz, "frequency_hz of a disturbance")
        values = real_array(density, "density of a disturbance")
        if f.ndim != 1 or f.size < 2 or values.shape != f.shape or f[0] < 0.0 or not (np.diff(f) > 0.0).all():
            raise WrongUseError(
                "a spectrum is a density (nf,) at two rising frequencies in Hz at least",
                f"shapes {f.shape}, {values.shape}",
            )
        fine = np.unique(np.concatenate([np.linspace(a, b, 21) for a, b in pairwise(f)]))
        width = np.diff(np.concatenate([fine[:1], 0.5 * (fine[1:] + fine[:-1]), fine[-1:]]))
        power = np.interp(fine, f, values) * width
        return cls(
            fine, power, np.zeros(fine.size), recorded_under, loop, duration_s=duration_s, control_mean=control_mean
        )

    @classmethod
    @gated
    def from_arrays(
        cls, error: ArrayLike, rate_hz: float, *, recorded_under: Controller | None = None,
        control: ArrayLike | None = None, loop: str = "", recording: str = "",
        operating_point: Mapping[str, float] | None = None,
    ) -> Disturbance:  # fmt: skip
        """The error (n,) of a loop without excitation, about its mean, at a rate in Hz.

        `control` (n,) is the plant's input: its mean is where an actuator works. Without `recorded_under` the error is
        the output of the open loop. Refuses fewer than 512 samples, and an error
        that never changes.

        >>> import numpy as np, loopshape as ls
        >>> error = np.random.default_rng(1).standard_normal(1000)
        >>> ls.Disturbance.from_arrays(error, 500.0).duration_s
        2.0
        """
        values = real_array(error, "the error of a loop", ndim=1)
        if values.size < LEAST_SAMPLES:
            raise WrongUseError(f"a disturbance needs {LEAST_SAMPLES} samples", f"{values.size}", "record for longer")
        if np.ptp(values) == 0.0:
            raise WrongUseError(
                "a recorded error that never changes tells nothing of what disturbs the loop",
                f"{values.size} times {values[0]:g}", "look for a dead sensor, or one whose step is too large",
            )  # fmt: skip
        if not 0.0 < rate_hz < np.inf:
            raise WrongUseError("rate_hz of a disturbance must be positive and finite", f"{rate_hz!r}")
        return cls(
            *powers(values, rate_hz), recorded_under, loop, recording, dict(operating_point or {}),
            duration_s=values.size / rate_hz, samples=values - values.mean(),
            control_mean=0.0 if control is None else float(np.mean(real_array(control, "the input of a plant"))),
        )  # fmt: skip

    @classmethod
    @gated
    def from_profile(
        cls, setpoint: ArrayLike, rate_hz: float, *, loop: str = "", control_mean: float = 0.0
    ) -> Disturbance:
        """A setpoint's profile (n,) at a rate in Hz: what a loop must follow, in the output's unit.

        A rest as long as the profile follows it. Refuses one that does not come back to where it begins.

        >>> import numpy as np, loopshape as ls
        >>> there = np.sin(np.linspace(0.0, np.pi, 501)) ** 2
        >>> ls.Disturbance.from_profile(there, 1000.0).duration_s
        0.501
        """
        values = real_array(setpoint, "a setpoint's profile", ndim=1)
        if values.size < 2 or abs(values[-1] - values[0]) > 1e-6 * np.ptp(values):
            raise WrongUseError(
                "a setpoint's profile comes back to where it begins", f"{values.size} values", "add the way back"
            )
        if not 0.0 < rate_hz < np.inf:
            raise WrongUseError("rate_hz of a profile must be positive and finite", f"{rate_hz!r}")
        n = 2 * values.size
        samples = np.append(values - values[0], np.zeros(values.size))
        power = 2.0 * np.abs(np.fft.rfft(samples)[1:-1]) ** 2 / (n * values.size)
        f = np.asarray(np.fft.rfftfreq(n, 1.0 / rate_hz)[1:-1], dtype=float)
        return cls(
            f, power, np.zeros(f.size), None, loop, duration_s=values.size / rate_hz, control_mean=control_mean,
            samples=samples, repeats=True,
        )  # fmt: skip

    @property
    def rate_hz(self) -> float | None:
        """Rate of its samples in Hz, None of a spectrum."""
        return self.samples.size / (self.duration_s * (1 + self.repeats)) if self.samples.size else None

    @property
    def step(self) -> float:
        """Least distance of two values of its samples, in the output's unit: a sensor's step; 0 of a spectrum.

        An error whose rms is smaller moves within the step, unseen, and rounding is no noise that adds to it.
        """
        gaps = np.diff(np.unique(self.samples))
        return float(gaps[gaps > 1e-9 * np.ptp(self.samples)].min()) if self.samples.size else 0.0

    @property
    def coarse(self) -> bool:
        """Whether the sensor's step is larger than the rms of what it recorded."""
        return not self.repeats and self.step > self.rms

    @property
    def rms(self) -> float:
        """Rms of the error under the controller that held the loop, in the output's unit."""
        return float(np.sqrt(self.power.sum()))


def powers(values: Array, rate_hz: float) -> tuple[Array, Array, Array]:
    """Frequencies in Hz of a signal's lines, the power on each, and the variance of that, for noise; (nf,) each."""
    found, correlated = amplitudes(values)
    power = np.abs(found) ** 2
    return np.asarray(np.fft.rfftfreq(values.size, 1.0 / rate_hz)[1:], dtype=float), power, 0.5 * correlated * power**2


def amplitudes(values: Array) -> tuple[ComplexArray, float]:
    """A signal's lines (nf,) without its mean, their squares its power, and how many of them share one's error."""
    from scipy.signal.windows import tukey

    n = values.size
    window = tukey(n, FADED, sym=False)
    found = np.fft.rfft((values - values.mean()) * window)[1:] * np.sqrt(2.0 / (n * float(window @ window)))
    if n % 2 == 0:
        found[-1] *= np.sqrt(0.5)
    return found, n * float(np.sum(window**4)) / float(window @ window) ** 2
