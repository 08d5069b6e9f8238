"""Coupling between the loops of one plant: coefficient, relative gains, equivalent plants, verdicts by band.

P is the plant of the picture in `loop.loop`, several loops wide: y = P z, loop i closing y_i onto z_i. All
bounds are of 95 % at one line, of the FRF's own covariance; `interaction` makes these from an FRF.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from loopshape.core.json_ready import Plain, keys
from loopshape.core.outcomes import Graded
from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.data.response.frf import FRF

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Coupling(Graded):
    """What data say of the coupling between two loops in a band."""

    DECOUPLED = "decoupled"
    UNDECIDED = "undecided"
    COUPLED = "coupled"


def _freeze(noun: object) -> None:
    """Arrays copied and made read-only."""
    for item in fields(noun):  # type: ignore[arg-type]
        value = getattr(noun, item.name)
        if isinstance(value, np.ndarray):
            copy = np.array(value)
            copy.setflags(write=False)
            object.__setattr__(noun, item.name, copy)


@dataclass(frozen=True, eq=False)
class Coefficient:
    """k_I = H12 H21/(H11 H22) of two loops on lines (nf,); source: H.7 of van den Brink, DCT 2007.002.

    `relative_std` is sqrt(E|dk|²)/|k| to first order. `low` and `high` bound |k_I| and hold where first order does not:
    `low` is 0 where H12 or H21 may be zero, `high` infinite where H11 or H22 may be. |k_I| itself is then mostly noise,
    and too large on average. Without unit, whatever the units of the channels, and the same for P and for its inverse.
    """

    loops: tuple[str, str]
    frequency_hz: Array
    coefficient: ComplexArray
    relative_std: Array
    low: Array
    high: Array
    valid: np.ndarray

    def __post_init__(self) -> None:
        _freeze(self)


@dataclass(frozen=True, eq=False)
class RelativeGain:
    """RGA = P .* inv(P)^T (nf, n, n) and its deviation sqrt(E|d|²) (nf, n, n) to first order.

    Element i, j is the gain from z_j to y_i with all other loops open, over that with all other outputs held still.
    `number` (nf,) is the sum of |RGA - I|: 0 for loops that do not meet (Skogestad and Postlethwaite, 3.4). The
    deviation misleads where P is nearly singular beside its error.
    """

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    frequency_hz: Array
    gain: ComplexArray
    std: Array
    valid: np.ndarray

    def __post_init__(self) -> None:
        _freeze(self)

    @property
    def number(self) -> Array:
        """Sum of |RGA - I| over the elements, (nf,); noise raises it."""
        return np.asarray(np.abs(self.gain - np.eye(self.gain.shape[1])).sum(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class EquivalentPlant:
    """What a loop's controller meets with the loops `others` closed, and with them open; each a 1 x 1 FRF.

    closed = P_ii - P_ij K (I + P_jj K)^-1 P_ji, covariance to first order. `ratio` (nf,) = closed/open with
    `relative_std` to first order from the one P that both are made of; `low`, `high` bound |ratio|, `reach_deg` is half
    the interval of its phase, 180 where that is not known.
    """

    loop: str
    others: tuple[str, ...]
    open: FRF
    closed: FRF
    ratio: ComplexArray
    relative_std: Array
    low: Array
    high: Array
    reach_deg: Array

    def __post_init__(self) -> None:
        _freeze(self)


def _round(factor: float) -> str:
    """Two figures, never as a power of ten."""
    return f"{factor:.1f}" if factor < 10.0 else f"{float(f'{factor:.1e}'):.0f}"


@dataclass(frozen=True)
class BandVerdict(Plain):
    """Whether two loops are decoupled in a band, by |k_I| against a limit.

    `decoupled`: the upper 95 % bound is below the limit at every valid line, and the lines leave no hole. `coupled`:
    the lower bound, widened for as many lines as are looked at, is above it at the lines `coupled_hz`. `at_hz` is the
    line that matters most; `low_db`, `estimate_db`, `high_db` are |k_I| there. `averages_factor` is by how much the
    averages must grow to decide, judged from these very data; infinite where that is no way. `hole_hz` is the widest
    stretch of the band without a valid line.
    """

    IN_JSON = keys(
        "loops", "verdict", "lines", "at_hz", "low_db", "estimate_db", "high_db", "coupled_hz", "averages_factor",
        "sentence", from_hz="band_hz.0", to_hz="band_hz.1",
    )  # fmt: skip

    loops: tuple[str, str]
    band_hz: tuple[float, float]
    verdict: Coupling
    limit_db: float
    lines: int
    at_hz: float = float("nan")
    low_db: float = float("nan")
    estimate_db: float = float("nan")
    high_db: float = float("nan")
    coupled_hz: tuple[float, ...] = ()
    hole_hz: tuple[float, float] | None = None
    averages_factor: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "verdict", Coupling(self.verdict))

    @property
    def sentence(self) -> str:
        """The verdict for people."""
        head = f"{self.loops[0]} and {self.loops[1]}, {self.band_hz[0]:.3g} to {self.band_hz[1]:.3g} Hz: {self.verdict}"
        return f"{head}, {self._why()}"

    def _why(self) -> str:
        if self.verdict is Coupling.DECOUPLED:
            return f"|k_I| is at most {self.high_db:.1f} dB (95 %, at {self.at_hz:.3g} Hz; limit {self.limit_db:g} dB)"
        if self.verdict is Coupling.COUPLED:
            return (
                f"|k_I| is above {self.limit_db:g} dB at {len(self.coupled_hz)} of {self.lines} lines,"
                f" most at {self.at_hz:.3g} Hz: {self.estimate_db:.1f} dB, {self.low_db:.1f} at least"
            )
        if not self.lines:
            return "no frequency of the band is valid: excite more there, or measure longer"
        size = f"may reach {self.high_db:.1f} dB" if np.isfinite(self.high_db) else "has no upper bound"
        return f"|k_I| {size} at {self.at_hz:.3g} Hz: {self.way_out}"

    @property
    def way_out(self) -> str:
        """What would decide an undecided band; "" for a decided one."""
        if self.verdict is not Coupling.UNDECIDED:
            return ""
        if self.hole_hz is not None:
            return f"no frequency is valid from {self.hole_hz[0]:.3g} to {self.hole_hz[1]:.3g} Hz: excite more there"
        if np.isfinite(self.averages_factor):
            return f"about {_round(self.averages_factor)} times the averages would decide it"
        if not np.isfinite(self.high_db):
            return "a loop's own element is lost in noise there: excite more"
        return f"averages would hardly help, |k_I| lies at the limit of {self.limit_db:g} dB"


@dataclass(frozen=True, eq=False)
class Interaction(Plain):
    """All that a square FRF says of how its loops meet; `loops` name its columns and rows, in order.

    `equivalents` are of the loops whose partners' controllers are all known.
    """

    IN_JSON = keys(
        recordings="frf.recording", loops="loops", operating_point="frf.operating_point", limit_db="limit_db",
        decoupled="decoupled", bands="verdicts", largest_rga_number="largest_rga_number",
        closing_the_others="closing_the_others",
    )  # fmt: skip

    frf: FRF
    loops: tuple[str, ...]
    limit_db: float
    coefficients: tuple[Coefficient, ...]
    relative_gain: RelativeGain
    equivalents: tuple[EquivalentPlant, ...]
    verdicts: tuple[BandVerdict, ...]

    def __repr__(self) -> str:
        """One line: its loops, and how many bands are what."""
        words = [str(v.verdict) for v in self.verdicts]
        bands = [f"{words.count(word)} of {len(words)} bands {word}" for word in dict.fromkeys(words)]
        return f"Interaction of {', '.join(self.loops)}: {', '.join(bands)}"

    @property
    def decoupled(self) -> bool:
        """Whether every pair is decoupled in every band; undecided is not."""
        return all(v.verdict is Coupling.DECOUPLED for v in self.verdicts)

    @property
    def largest_rga_number(self) -> float:
        """The largest sum of |RGA - I| in the valid band."""
        return float(self.relative_gain.number[self.frf.valid].max())

    @property
    def closing_the_others(self) -> list[dict[str, Any]]:
        """By how much each loop's plant changes at most in the valid band when the others are closed."""
        use = self.frf.valid
        return [
            {
                "loop": e.loop,
                "others": e.others,
                "largest_change_db": float(np.abs(db(e.ratio[use])).max()),
                "largest_change_deg": float(np.abs(deg(np.angle(e.ratio[use]))).max()),
            }
            for e in self.equivalents
        ]

    @property
    def sentences(self) -> tuple[str, ...]:
        """A sentence for each pair and band."""
        return tuple(v.sentence for v in self.verdicts)

    def figure(self) -> Figure:
        """Coefficients, relative gains and equivalent plants over frequency, with bounds and verdicts."""
        from loopshape.toolbox.diagrams.coupling.picture import interaction_page

        return interaction_page(self)
