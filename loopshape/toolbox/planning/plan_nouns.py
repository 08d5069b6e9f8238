"""A required accuracy, and the plan that answers it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.gate import pass_fields
from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import Array
from loopshape.toolbox.planning import plan_words
from loopshape.toolbox.planning.plan_lines import KINDS
from loopshape.toolbox.rig.excitation.multisine import Multisine


@dataclass(frozen=True)
class Required:
    """What is wanted, and what the rig allows; signals in stored units.

    `std` is the relative std of |G| at the crossover, which is that of the phase in rad (0.0116 is 0.1 dB or 0.66 deg);
    of the complex response it is sqrt(2) times as much. `at_hz` stands in for the crossover. `max_amplitude` bounds the
    injected peak (None: that of the first recording), `max_input` |u| with its resting value, `max_output` the
    excursion of y from rest. `kind` of lines: `odd` (one in four left out), `log`, or `all`. The band defaults to the
    valid one within a decade of the crossover.

    Without `std` the experiment is told: `seconds` of periods that resolve `resolution_hz`, in a band that may lie
    beside the one that is known, at the largest amplitude allowed; `longest_s` does not count then.
    """

    std: float | None = None
    at_hz: float | None = None
    max_amplitude: float | None = None
    max_input: float | None = None
    max_output: float | None = None
    longest_s: float = 600.0
    f_low_hz: float | None = None
    f_high_hz: float | None = None
    kind: str = "odd"
    per_octave: float = 12.0
    level_ratio: float = 10.0
    seed: int = 1
    resolution_hz: float | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        pass_fields(self)
        numbers = ("std", "at_hz", "max_amplitude", "max_input", "max_output", "longest_s", "f_low_hz", "f_high_hz")
        for name in (*numbers, "per_octave", "level_ratio", "resolution_hz", "seconds"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise WrongUseError(f"{name.replace('_', ' ')} of a plan must be positive", f"{value!r}")
        stated = {"resolution_hz": self.resolution_hz, "seconds": self.seconds}
        given = [name for name, value in stated.items() if value is not None]
        if len(given) != (2 if self.std is None else 0):
            raise WrongUseError(
                "a plan needs a wanted accuracy, or a resolution and a time instead",
                ", ".join([*["std"] * (self.std is not None), *given]) or "none",
                "give std, or resolution_hz and seconds; to the command --std-db, or --resolution-hz and --seconds",
            )
        if (self.std or 0.0) >= 0.5 or self.level_ratio < 1.0:
            raise WrongUseError(
                "a plan's std is below 50 % and its level ratio 1 at least", f"{self.std!r}, {self.level_ratio!r}"
            )
        refuse_unknown("a kind of frequency grid is not known", self.kind, KINDS)


@dataclass(frozen=True, eq=False)
class Plan(Plain):
    """An experiment and what it is predicted to reach; arrays (n,) over its lines, signals in stored units.

    `std` is the predicted relative std of |G|, `floor` the part of it that distortion leaves, `line_amplitude` the peak
    of each sine; `column` is what is injected, in `unit`. `before_std` (nf,) on `before_hz`, and `before` at the
    crossover, are those of the first record, distortion included. `at_crossover` is the planned std there, known
    itself to about `sure` (relative). `binds` is what keeps the experiment from being better or shorter: amplitude,
    input, output, distortion, shortest (nothing else: a plan has four periods), seconds (told). `short_by` is std over
    the required one, 1 where reached; `needed_s` and `needed_amplitude` would each reach it, the latter infinite where
    distortion forbids. Of several `realisations` each is recorded with phases of its own, and `std` and `floor` are
    those of their mean. Peaks hold the noise of the first record too. What a plan cannot know is in `notes`.
    """

    FORMAT: ClassVar[str] = "loopshape-plan/1"
    IN_JSON = {"format": "FORMAT"} | keys(
        "loop", "recording", "injection", "satisfied", "reached", "crossover_hz", "short_by", "needed_s",
        "needed_amplitude", "binds", "realisations", "duration_s", "peak_input", "peak_output", "lines_hz",
        "line_amplitude", "std", "notes", "sentence", period_s="excitation.period_s", periods="excitation.periods",
        ramp_s="excitation.ramp_s", amplitude="excitation.amplitude", required_std="required.std",
        std_at_crossover="at_crossover", std_before="before", std_known_to="sure", distortion_std="floor",
    )  # fmt: skip

    loop: str
    recording: str
    injection: str
    column: str
    unit: str
    required: Required
    excitation: Multisine
    realisations: int
    lines_hz: Array
    line_amplitude: Array
    std: Array
    floor: Array
    crossover_hz: float
    at_crossover: float
    before: float
    before_hz: Array
    before_std: Array
    sure: float
    measured_s: float
    peak_input: float
    peak_output: float
    binds: str
    reached: bool
    short_by: float
    needed_s: float
    needed_amplitude: float
    notes: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """Whole length of all realisations with their ramps."""
        return self.realisations * self.excitation.duration_s

    @property
    def satisfied(self) -> bool:
        """Whether the first record already has what is wanted, so that nothing is to be measured."""
        return self.required.std is not None and self.before <= self.required.std

    @property
    def sentence(self) -> str:
        """The plan for people."""
        return plan_words.sentence(self)
