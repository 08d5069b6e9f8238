"""The gap table: what separates two runs of one machine, by path, band and operating point.

Run "real" is the evidence, run "sim" (a simulation, or another recording) stands against it. Every difference is sim
less real, every ratio sim over real. Where it comes from, the table does not say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from loopshape.toolbox.gap.two_runs.level_dependence import LevelDependence


@dataclass(frozen=True, eq=False)
class DistortionLevels:
    """Odd and even distortion in a band, in dB re its linear response; None where the excitation shows none."""

    odd_db: float | None
    even_db: float | None


@dataclass(frozen=True, eq=False)
class GapRow:
    """One path in one band at one operating point.

    `size` is the rms of |dG| / |G| over the band's lines with the noise's share taken off, `noise` that share. `z2` is
    the mean of |dG|² over its variance (s_real² + s_sim², less what the errors of both share), about 1 where nothing
    but noise parts them, with the probability `p_value` of as much by noise alone. `gain_db` and `phase_deg` are the
    mean of the complex logarithm of sim over real.
    `amplitude` is the rms of the injected signal, in `amplitude_unit`. Distortion is that of the loop's output.
    """

    path: str
    recording: str
    simulated: str
    loop: str
    operating_point: Mapping[str, float]
    amplitude: float
    amplitude_unit: str
    band_hz: tuple[float, float]
    lines: int
    size: float
    noise: float
    z2: float
    p_value: float
    gain_db: float
    phase_deg: float
    distortion_real: DistortionLevels | None = None
    distortion_sim: DistortionLevels | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class NuGapRow:
    """The nu-gap of one loop's shaped plants, real against sim, at one operating point.

    `value` is None where `winding` is "undecided"; `interval` is 95 %. `scale` is the nu-gap between this and the
    nearest other real operating point, `scale_to`; None where there is none or it is undecided.
    """

    loop: str
    recording: str
    operating_point: Mapping[str, float]
    value: float | None
    interval: tuple[float, float]
    at_hz: float
    winding: str
    reason: str
    scale: float | None
    scale_to: Mapping[str, float] | None


@dataclass(frozen=True, eq=False)
class TimeRow:
    """One signal in one stretch of a recording that both runs did with the same inputs.

    `kind` is "window" (`difference` is rms, its mean included) or "rest" (`difference` is the difference of means over
    a settled stretch). `floor` is what the recordings' own unrest there gives. In the signal's stored `unit`.
    """

    kind: str
    recording: str
    operating_point: Mapping[str, float]
    signal: str
    unit: str
    from_s: float
    to_s: float
    difference: float
    floor: float

    @property
    def ratio(self) -> float:
        """Size of the difference relative to the noise floor; infinite without one."""
        if self.floor > 0.0:
            return abs(self.difference) / self.floor
        return float("inf") if self.difference else 0.0

    @property
    def loud(self) -> bool:
        """Whether the difference exceeds the noise floor."""
        return self.ratio > 3.0  # a time response differs where its difference is this many times its floor


@dataclass(frozen=True, eq=False)
class GapTable:
    """All rows of two runs, what could not be compared and why (`unmatched`), and what weakens it (`notes`).

    `levels` says how the response depends on the level of the excitation, where recordings were made at several: of the
    real run, or of both as of one machine.
    """

    real: str
    sim: str
    rows: tuple[GapRow, ...]
    nu_gaps: tuple[NuGapRow, ...] = ()
    times: tuple[TimeRow, ...] = ()
    unmatched: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    levels: tuple[LevelDependence, ...] = ()

    def significant(self, row: GapRow) -> bool:
        """Whether a row stands out of the noise among all rows (Bonferroni at 5 %), and by 1 % at least."""
        # a row counts as a difference where noise alone gives as much, anywhere in the table, in fewer of cases than
        # this
        chance = 0.05
        worth = 0.01  # ... and where it is at least this large, relative to the response
        return row.p_value * max(len(self.rows), 1) < chance and row.size >= worth

    @property
    def paths(self) -> tuple[str, ...]:
        """Paths in order."""
        return tuple(dict.fromkeys(row.path for row in self.rows))

    @property
    def largest(self) -> GapRow | None:
        """The largest significant row; None where there is none."""
        found = [row for row in self.rows if self.significant(row)]
        return max(found, key=lambda row: row.size) if found else None

    @property
    def conclusion(self) -> str:
        """Where the two runs differ and how much, in one sentence; no cause."""
        if not self.rows and not self.times:
            return "The two runs share no recording that can be compared."
        worst = self.largest
        found = (_quiet(self) if worst is None else _frf_sentence(self, worst)) + _nu_sentence(self.nu_gaps) + "."
        return " ".join([found, *(f"Over levels, {d.sentence}" for d in self.levels if d.decidable and not d.linear)])


def _frf_sentence(table: GapTable, worst: GapRow) -> str:
    seen = sum(table.significant(row) for row in table.rows)
    where = ", ".join(f"{k} {v:g}" for k, v in worst.operating_point.items())
    others = [p for p in table.paths if not any(table.significant(r) for r in table.rows if r.path == p)]
    band = f"{worst.band_hz[0]:.3g} to {worst.band_hz[1]:.3g} Hz{' at ' + where if where else ''}"
    text = (
        f"The runs differ beyond noise in {seen} of {len(table.rows)} cells, most in {worst.path} from {band}:"
        f" {100.0 * worst.size:.3g} % ({worst.gain_db:+.2g} dB, {worst.phase_deg:+.2g} deg, sim over real)"
    )
    return text + (f"; no difference in {', '.join(others)}" if others else "")


def _quiet(table: GapTable) -> str:
    loud = [row for row in table.times if row.loud]
    if loud:
        row = max(loud, key=lambda row: row.ratio)
        return (
            f"{'No FRF differs beyond noise, but ' if table.rows else 'T'}{'t' if table.rows else ''}he time responses"
            f" differ, most {row.signal} of {row.recording} from {row.from_s:.3g} to {row.to_s:.3g} s:"
            f" {row.difference:.3g} {row.unit}, {row.ratio:.2g} times its floor"
        )
    if not table.rows:
        return "No time response differs by more than the recordings' own noise"
    resolved = max((row.noise for row in table.rows), default=0.0)
    return (
        f"No difference beyond noise in any of {len(table.rows)} cells, whose noise is {100.0 * resolved:.2g} % at most"
    )


def _nu_sentence(rows: Sequence[NuGapRow]) -> str:
    known = [row for row in rows if row.value is not None]
    if not known:
        return ""
    row = max(known, key=lambda row: row.value or 0.0)
    scale = (
        f", against {row.scale:.2g} between it and the nearest real operating point" if row.scale is not None else ""
    )
    return (
        f"; the largest nu-gap of the shaped plants is {row.value:.2g} ({row.interval[0]:.2g} to {row.interval[1]:.2g})"
        f" in loop {row.loop}{scale}"
    )
