"""How to estimate: what a user may ask for, and what the record decides."""

from __future__ import annotations

from dataclasses import dataclass

from loopshape.errors import WrongUseError

ESTIMATORS = ("reference", "direct")
METHODS = ("auto", "welch", "local")


@dataclass(frozen=True)
class Settings:
    """How to estimate; None lets the record decide. `resolution_hz` is the distance between lines.

    `method` is for records without a period: `welch`, `local` (local polynomials and rationals, which take the
    transient off), or `auto`: sweeps by local fits, noise with a resolution asked for by Welch, other noise by
    whichever predicts best what it has not seen. For local fits a resolution is the distance between lines alone.
    """

    estimator: str = "reference"
    method: str = "auto"
    resolution_hz: float | None = None
    overlap: float = 0.75

    def __post_init__(self) -> None:
        for what, word, known in (("an estimator", self.estimator, ESTIMATORS), ("a method", self.method, METHODS)):
            if word not in known:
                raise WrongUseError(f"{what} is not known", f"{word!r}", f"use {' or '.join(known)}")
        if not 0.0 <= self.overlap <= 0.9:
            raise WrongUseError("the overlap of segments lies between 0 and 0.9", f"{self.overlap!r}")
        if self.resolution_hz is not None and not self.resolution_hz > 0.0:
            raise WrongUseError("a resolution must be positive", f"{self.resolution_hz!r} Hz")
