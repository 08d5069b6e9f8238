"""Several loops judged at once: what is wished of them, what is found, and whether it holds.

As in `loopshape.data.requirements`, wishes and findings share their field names, and a check is one loop over
`SEVERAL_LIMITS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, cast

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import json_ready
from loopshape.core.units import db, deg
from loopshape.data.requirements import Limit, Line, Margins, Verdict

SEVERAL_LIMITS: tuple[Limit, ...] = (
    Limit("disk_margin", "at_least", "1", "disk margin, all loops at once"),
    Limit("input_output_disk_margin", "at_least", "1", "disk margin, inputs and outputs at once"),
    Limit("modulus_margin", "at_least", "1", "modulus margin, all loops at once"),
    Limit("sensitivity_peak_db", "at_most", "dB", "peak singular value of S"),
    Limit("complementary_peak_db", "at_most", "dB", "peak singular value of T"),
)


@dataclass(frozen=True)
class Certificate:
    """`stable`, `unstable` or `undecided`, unstable closed-loop poles counted, why, and the band to measure if any."""

    outcome: str
    unstable_poles: int | None
    reason: str
    band_hz: tuple[float, float] | None = None


@dataclass(frozen=True)
class SeveralMargins:
    """Margins of all loops of one plant at one operating point, from its matrix.

    - `disk_margin`: the largest a such that every loop may be multiplied by its own (1 + d/2)/(1 - d/2), |d| < a
      complex, all at once (Seiler, Packard and Gahinet, IEEE Control Systems 40(5), 2020, balanced); 2 at most, and the
      same at the plant's inputs and outputs. `disk_margin_reached` is the size of changes known to destabilise: nothing
      is known between the two (they are one for three loops or fewer). `input_output_disk_margin`: both ends at once.
    - `modulus_margin`: the largest m such that every loop's L may move by less than m, all at once.
    - `sensitivity_peak_db`, `complementary_peak_db`: largest singular value of S_o and T_o; nan where the outputs have
      different units, on which they would depend.

    `worst_changes` are the factors (complex, one a loop) that bring the loops to their limit, at
    `at_hz["disk_margin"]`. `stable` is "stable", "unstable" or "undecided", with `stability_reason` and
    `stability_band_hz`; margins mean room only where it is "stable". `intervals` holds 95 % intervals by field name.
    """

    loops: tuple[str, ...]
    disk_margin: float
    disk_margin_reached: float
    input_output_disk_margin: float
    modulus_margin: float
    sensitivity_peak_db: float
    complementary_peak_db: float
    worst_changes: tuple[complex, ...]
    at_hz: Mapping[str, float]
    stable: str
    stability_reason: str
    stability_band_hz: tuple[float, float] | None = None
    unstable_poles: int | None = None
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def gain_margin_db(self) -> float:
        """Gain that every loop may vary by, up or down, all at once: (2 + a)/(2 - a)."""
        a = self.disk_margin
        return float(db((2.0 + a) / (2.0 - a))) if a < 2.0 else float("inf")

    @property
    def phase_margin_deg(self) -> float:
        """Phase that every loop may vary by, either way, all at once: 2 atan(a/2)."""
        return float(2.0 * deg(np.arctan(0.5 * self.disk_margin)))

    @property
    def changes(self) -> dict[str, dict[str, float]]:
        """`worst_changes` by loop, in gain and phase."""
        found = zip(self.loops, self.worst_changes, strict=True)
        return {name: {"gain_db": float(db(x)), "phase_deg": float(deg(np.angle(x)))} for name, x in found}

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is not defined is None."""
        made = {f.name: getattr(self, f.name) for f in fields(self)} | {"worst_changes": self.changes}
        made |= {"gain_margin_db": self.gain_margin_db, "phase_margin_deg": self.phase_margin_deg}
        return {name: json_ready(value, None) for name, value in made.items()}


@dataclass(frozen=True)
class SeveralRequirements:
    """What all loops of a plant must keep together; None requires nothing.

    `integrators` and `unstable_poles` declare those of the whole plant (`LoopMatrix`); None leaves them to its lowest
    lines, and to the loops that were recorded and stood. `band_hz` narrows the lines that are looked at. Refuses values
    that make no sense.
    """

    disk_margin: float | None = None
    input_output_disk_margin: float | None = None
    modulus_margin: float | None = None
    sensitivity_peak_db: float | None = None
    complementary_peak_db: float | None = None
    integrators: int | None = None
    unstable_poles: int | None = None
    band_hz: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name, highest in (("disk_margin", 2.0), ("input_output_disk_margin", 2.0), ("modulus_margin", 1.0)):
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= highest:
                raise WrongUseError(f"{name} of several loops lies above 0 and is {highest:g} at most", f"{value!r}")
        for name in ("sensitivity_peak_db", "complementary_peak_db"):
            value = getattr(self, name)
            if value is not None and not np.isfinite(value):
                raise WrongUseError(f"{name} of several loops must be finite", f"{value!r}")
        for name in ("integrators", "unstable_poles"):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
                raise WrongUseError(f"{name} of several loops is a whole number from 0", f"{value!r}")
        band = self.band_hz
        if band is not None and not (len(band) == 2 and 0.0 < band[0] < band[1] < np.inf):
            raise WrongUseError("band_hz is two rising frequencies", f"{band!r}")

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> SeveralRequirements:
        """Requirements of the table `[several]` of a requirements file; an unknown key is refused."""
        known = [f.name for f in fields(cls)]
        if unknown := [key for key in table if key not in known]:
            raise WrongUseError("unknown key", ", ".join(unknown), f"known are {', '.join(known)}")
        given = dict(table)
        if "band_hz" in given:
            given["band_hz"] = tuple(given["band_hz"])
        return cls(**given)


@dataclass(frozen=True, eq=False)
class SeveralVerdict:
    """A check's outcome for several loops: each loop at a time with the others closed, then all at once.

    `each` holds a verdict a loop, `lines` what is wished of all together at its worst operating point, `margins` those
    of all together by recording. `passed` needs all of them, and every operating point stable.
    """

    loops: tuple[str, ...]
    each: tuple[Verdict, ...]
    lines: tuple[Line, ...]
    margins: Mapping[str, SeveralMargins]
    warnings: tuple[str, ...] = ()

    @property
    def unstable(self) -> tuple[str, ...]:
        """Recordings whose loops are unstable together, or undecided."""
        return tuple(name for name, m in self.margins.items() if m.stable != "stable")

    @property
    def outcome(self) -> str:
        """What these data say of the controllers: "passed", "failed" or "undecided"."""
        found = {verdict.outcome for verdict in self.each} | {line.outcome for line in self.lines}
        found |= {"failed" if m.stable == "unstable" else m.stable for m in self.margins.values()}
        return "failed" if "failed" in found else "undecided" if "undecided" in found else "passed"

    @property
    def together(self) -> Verdict:
        """The verdict of all loops at once in the shape of a single loop's, for what only reads lines and stability."""
        return Verdict(" + ".join(self.loops), self.lines, cast("Mapping[str, Margins]", self.margins), self.warnings)

    @property
    def passed(self) -> bool:
        """Whether the controllers may be signed together on these data."""
        return self.outcome == "passed"
