"""How to estimate: what a user may ask for, and what the record decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from loopshape.core.errors import WrongUseError, refuse_unknown, refuse_unknown_keys
from loopshape.core.gate import pass_fields

#: from averaged spectra of a record in open loop
SPECTRAL = ("h1", "h2", "hv")
#: by what output and plant input answer to the external excitation; the joint input-output estimator is its other name
BY_INSTRUMENT = ("reference", "joint")
ESTIMATORS = ("reference", "direct", "joint", *SPECTRAL)
METHODS = ("auto", "welch", "local")
WINDOWS = ("hann", "hamming", "blackman", "blackmanharris", "bartlett", "flattop", "boxcar")
DETRENDS = ("mean", "linear", "none")


@dataclass(frozen=True)
class Settings:
    """How to estimate; None lets the record decide. `resolution_hz` is the distance between lines.

    `method` is for records without a period: `welch`, `local` (local polynomials and rationals, which take the
    transient off), or `auto`: sweeps by local fits, noise with a resolution asked for by Welch, other noise by
    whichever predicts best what it has not seen. For local fits a resolution is the distance between lines alone.

    `window` (periodic, or `symmetric` as for filters), `detrend` of each segment, `overlap` (share of a segment) and
    `segment_samples` are Welch's and reproduce somebody's recipe; each but the overlap makes `auto` choose Welch. With
    `segment_samples` n the overlap is the whole number of samples at or below its share, as in scipy and MATLAB. The
    covariance knows the window; which lines count as excited is judged as for Hann.
    """

    estimator: str = "reference"
    method: str = "auto"
    resolution_hz: float | None = None
    overlap: float = 0.75
    window: str = "hann"
    symmetric: bool = False
    detrend: str = "mean"
    segment_samples: int | None = None

    def __post_init__(self) -> None:
        pass_fields(self)
        words = (
            ("an estimator", self.estimator, ESTIMATORS),
            ("a method", self.method, METHODS),
            ("a window", self.window, WINDOWS),
            ("a detrending", self.detrend, DETRENDS),
        )
        for what, word, known in words:
            refuse_unknown(f"{what} is not known", word, known)
        if not 0.0 <= self.overlap <= 0.9:
            raise WrongUseError("the overlap of segments lies between 0 and 0.9", f"{self.overlap!r}")
        if self.resolution_hz is not None and not self.resolution_hz > 0.0:
            raise WrongUseError("a resolution must be positive", f"{self.resolution_hz!r} Hz")
        if self.segment_samples is not None and not self.segment_samples >= 4:
            raise WrongUseError("a segment has four samples at least", f"{self.segment_samples!r}")
        if self.segment_samples is not None and self.resolution_hz is not None:
            raise WrongUseError(
                "a segment's length and a resolution say the same thing twice",
                f"{self.segment_samples} samples and {self.resolution_hz:g} Hz",
                "give one of them",
            )
        if self.method == "local" and (self.recipe or self.estimator in SPECTRAL):
            raise WrongUseError(
                "local fits have no segments, windows or averaged spectra", "method = 'local'", "leave the method out"
            )

    @property
    def recipe(self) -> bool:
        """Whether something was asked for that Welch's segments alone have."""
        return self.window != "hann" or self.symmetric or self.detrend != "mean" or self.segment_samples is not None


def settings_of(given: Mapping[str, Any]) -> Settings:
    """Settings from keywords; refuses names that are none of them."""
    refuse_unknown_keys("an estimate has no such setting", given, [f.name for f in fields(Settings)])
    return Settings(**given)
