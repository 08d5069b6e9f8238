"""What disturbs a loop, as the spectrum of its error under the controller that closed it then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.gate import gated, pass_fields
from loopshape.core.units import Array
from loopshape.data.arrays import real_array
from loopshape.data.control.controller import Controller


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Power (nf,) of a loop's error on its lines, in the output's unit squared, while `recorded_under` closed the loop.

    The powers add up to the mean square; `scatter` (nf,) is the variance of each, 0 for a spectrum that is given. What
    disturbs may enter anywhere in the loop, the sensor's noise included: all of it goes through S. Without
    `recorded_under` it is the spectrum of the output in open loop. `rms` is that of the error under that controller.
    """

    frequency_hz: Array
    power: Array
    scatter: Array
    recorded_under: Controller | None = None
    loop: str = ""
    recording: str = ""
    operating_point: Mapping[str, float] = field(default_factory=dict)

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

    @classmethod
    @gated
    def from_spectrum(
        cls, frequency_hz: ArrayLike, density: ArrayLike, *, recorded_under: Controller | None = None, loop: str = ""
    ) -> Disturbance:
        """A disturbance at the plant's output from its one-sided density (nf,) in unit²/Hz, straight between lines.

        With `recorded_under` it is the density of the error under that controller. Refuses fewer than two
        frequencies, and frequencies that do not rise.

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
        return cls(fine, power, np.zeros(fine.size), recorded_under, loop)

    @property
    def rms(self) -> float:
        """Rms of the error under the controller that held the loop, in the output's unit."""
        return float(np.sqrt(self.power.sum()))
