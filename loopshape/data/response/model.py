"""Models of a plant from one input to one output, and what a fit says about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import Convergence
from loopshape.core.units import TWO_PI, Array, ComplexArray, angular


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """num(s)/den(s) exp(-s delay); coefficients in descending powers of s, s in rad/s."""

    num: Array
    den: Array
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("num", "den"):
            values = np.atleast_1d(np.array(getattr(self, name), dtype=float))
            if values.ndim != 1 or not values.size or not np.isfinite(values).all():
                raise WrongUseError(f"{name} of a transfer function is a list of numbers", repr(values))
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.den[0] == 0.0:
            raise WrongUseError("the leading coefficient of a denominator must not be zero")

    def response(self, frequency_hz: ArrayLike) -> ComplexArray:
        """Response (nf,) at `frequency_hz` (nf,)."""
        s = 1j * angular(frequency_hz)
        return np.asarray(np.polyval(self.num, s) / np.polyval(self.den, s) * np.exp(-s * self.delay_s))

    def stretched(self, shift: float) -> TransferFunction:
        """The same on a frequency axis stretched by 1 + shift: G(s/(1 + shift))."""
        num, den = (p * (1.0 + shift) ** -np.arange(p.size - 1.0, -1.0, -1.0) for p in (self.num, self.den))
        return TransferFunction(num, den, self.delay_s / (1.0 + shift))

    def poles(self) -> ComplexArray:
        """Poles in rad/s."""
        return np.asarray(np.roots(self.den), dtype=complex)

    def integrators(self) -> int:
        """Poles at s = 0 (trailing zeros of the denominator)."""
        return int(self.den.size - 1 - np.flatnonzero(self.den)[-1])

    def unstable_hz(self) -> Array:
        """Sizes in Hz of the poles in the open right half plane, each of a pair."""
        roots = self.poles()
        return np.asarray(np.abs(roots[roots.real > 1e-9 * (1.0 + np.abs(roots))]) / TWO_PI)

    def unstable_poles(self) -> int:
        """Poles in the open right half plane."""
        return self.unstable_hz().size


@dataclass(frozen=True)
class Estimate(Plain):
    """One fitted parameter: value, unit, standard deviation, and its 95 % interval."""

    IN_JSON = keys("value", "std", "interval", "unit")

    name: str
    value: float
    unit: str
    std: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval, normal approximation."""
        return self.value - 1.959964 * self.std, self.value + 1.959964 * self.std


@dataclass(frozen=True, eq=False)
class Fit(Plain):
    """A model fitted to one FRF.

    `outcome` is `converged`, `not_converged` or `at_bound`; `chi2_per_dof` compares the residual with the
    FRF's own variance, `misfit_db` is the rms of |measured/model - 1| over lines known to 30 % as 20 log10(1 + .);
    `sufficient` is the residual test's word: does what is left look like the noise? Intervals are widened by
    sqrt(chi2_per_dof) where the model misses more than the noise does. They then describe how well the
    numbers are pinned by these lines, not how true the structure is. `rig_parameters` are the FRF's
    `parameters`: settings of the rig that held for its recording alone; `frf_digest` marks that FRF. Of the
    `starts` that it was searched from `starts_agreeing` ended at this optimum; where `disputed`, the others
    stopped at worse ones.
    """

    IN_JSON = keys(
        "recording", "loop", "operating_point", "structure", parameters="by_name", outcome="outcome",
        chi2_per_dof="chi2_per_dof", sufficient="sufficient", misfit_db="misfit_db", band_hz="band_hz",
        starts="starts", starts_agreeing="starts_agreeing",
    )  # fmt: skip

    structure: str
    model: TransferFunction
    parameters: tuple[Estimate, ...]
    covariance: Array
    outcome: Convergence
    chi2_per_dof: float
    p_value: float
    runs_p_value: float
    misfit_db: float
    band_hz: tuple[float, float]
    lines: int
    recording: str = ""
    loop: str = ""
    operating_point: Mapping[str, float] = field(default_factory=dict)
    delay_free: bool = False
    rig_parameters: Mapping[str, float] = field(default_factory=dict)
    frf_digest: str = ""
    starts: int = 1
    starts_agreeing: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "outcome", Convergence(self.outcome))

    def __repr__(self) -> str:
        """One line: structure, parameters, misfit and whether it leaves nothing but noise."""
        numbers = ", ".join(f"{p.name} {p.value:.4g}" for p in self.parameters)
        left = "leaves nothing but noise" if self.sufficient else "leaves more than noise"
        return f"Fit {self.structure}: {numbers}; misfit {self.misfit_db:.2g} dB, {left}"

    @property
    def converged(self) -> bool:
        """Whether the search of the parameters ended within their bounds."""
        return self.outcome is Convergence.CONVERGED

    @property
    def sufficient(self) -> bool:
        """Whether the residual test accepts the model at 1 %."""
        return self.p_value > 0.01 and self.runs_p_value > 0.01

    @property
    def disputed(self) -> bool:
        """Whether the optimum was reached from one of several starts alone: a better one may lie elsewhere."""
        return self.starts > 1 and self.starts_agreeing < 2

    @property
    def by_name(self) -> dict[str, Estimate]:
        """Parameters by name."""
        return {p.name: p for p in self.parameters}

    def __getitem__(self, name: str) -> Estimate:
        if name not in self.by_name:
            raise WrongUseError("a fit has no such parameter", f"{name!r}", f"use one of {', '.join(self.by_name)}")
        return self.by_name[name]

    def values(self) -> dict[str, Any]:
        """Parameter values by name."""
        return {p.name: p.value for p in self.parameters}
