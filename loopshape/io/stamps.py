"""Time stamps: do they keep a rate? Jitter and rounded stamps do, lost samples and a wrong rate do not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.core.stretches import LongSignal, Signal, stretches
from loopshape.core.units import Array

#: of a sample: what stamps on a grid may be off it
ON_GRID = 0.01
#: of a sample: a lasting shift of the stamps from which on samples are missing, seen over so many stamps
SHIFT, SEEN_OVER = 0.5, 15
#: relative error of a stated rate from which on the stamps are looked at with their own
FAR_OFF = 0.01


@dataclass(frozen=True)
class Stamps:
    """What stamps (n,) say of a rate: the rate of them all, their scatter about it (s), what they are rounded to (s).

    `gaps` counts lasting shifts, the first one with `gap_row` (counted from 0) and `gap_step_s`. `drift` is by how many
    samples the stated rate runs off over the record, `unsure` how many of these jitter and rounding may make up.
    """

    rate_hz: float
    jitter_s: float
    farthest_s: float
    rounded_s: float
    drift: float
    unsure: float
    gaps: int = 0
    gap_row: int = 0
    gap_step_s: float = 0.0

    @property
    def even(self) -> bool:
        """Whether samples at a constant rate explain the stamps."""
        slack = self.rounded_s * self.rate_hz
        scatter, far = self.jitter_s * self.rate_hz, self.farthest_s * self.rate_hz
        # of a sample: rms and largest deviation from the grid of all stamps up to which they jitter, and keep a rate
        jitter, farthest = 0.3, 1.0
        return not self.gaps and scatter <= jitter + slack and far <= farthest + slack

    @property
    def rounding_alone(self) -> bool:
        """Whether rounding explains the whole scatter, or there is next to none."""
        return self.farthest_s <= max(1.1 * self.rounded_s, 0.05 / self.rate_hz)


def read_stamps(t_s: Array, rate_hz: float) -> Stamps:
    """What stamps (n,) in s say of a rate near `rate_hz`; finite ones, two at the least."""
    k, n = np.arange(t_s.size), t_s.size
    off = (t_s - t_s[0]) * rate_hz - k
    rounded = _rounded_to(t_s, rate_hz)
    slack = rounded * rate_hz
    far = max(1, n // 20)
    slope = float(np.median(off[far:] - off[:-far])) / far  # gaps, few as they are, do not move a median
    if FAR_OFF < abs(slope) < np.inf and slope > FAR_OFF - 1.0:  # a wrong rate is no row of gaps
        found = read_stamps(t_s, rate_hz / (1.0 + slope))
        return replace(found, drift=abs(rate_hz / found.rate_hz - 1.0) * n)
    gaps, row = _gaps(off - slope * k, SHIFT + slack * (1.0 + SEEN_OVER / far))
    if not gaps:
        centred = k - 0.5 * (n - 1)
        slope = float(centred @ off / (centred @ centred))
    left = off - slope * k
    left -= np.median(left) if gaps else left.mean()
    rms = float(np.sqrt(np.mean(left**2)))
    own = rate_hz / (1.0 + slope) if slope > -1.0 else np.inf
    return Stamps(
        rate_hz=float(own),
        jitter_s=rms / rate_hz,
        farthest_s=float(np.abs(left).max()) / rate_hz,
        rounded_s=rounded,
        drift=abs(slope) * n,
        unsure=1.5 * slack + 4.0 * rms * float(np.sqrt(12.0 / n)),  # bounded errors tilt a line by 1.5 of their range
        gaps=gaps,
        gap_row=row,
        gap_step_s=float(t_s[row] - t_s[row - 1]) if gaps else 0.0,
    )


def _rounded_to(t_s: Array, rate_hz: float) -> float:
    """Decimal step (s) that stamps are rounded to; 0 where there is none, or samples fall on it and lose nothing."""
    for decimals in range(7):
        x = t_s * 10.0**decimals
        if np.all(np.abs(x - np.round(x)) <= 1e-4 + 8.0 * np.finfo(float).eps * np.abs(x)):
            steps = 10.0**decimals / rate_hz
            return 0.0 if abs(steps - round(steps)) < 1e-6 else 10.0**-decimals
    return 0.0


def _gaps(off: Array, limit: float) -> tuple[int, int]:
    """How many lasting shifts by more than `limit` samples, and the row of the first."""
    if off.size < 3:
        return 0, 0
    from scipy.ndimage import median_filter

    half = min(SEEN_OVER, max(3, off.size // 4)) // 2
    level = median_filter(off, 2 * half + 1, mode="nearest")
    shift = np.abs(level[half + 1 :] - level[: -half - 1]) > limit
    starts = np.flatnonzero(np.diff(np.concatenate([[0], shift.astype(int)])) == 1)
    if not starts.size:
        return 0, 0
    first = int(starts[0])
    near = slice(max(first - half, 0), first + 2 * half + 2)
    return int(starts.size), int(np.argmax(np.abs(np.diff(off[near])))) + near.start + 1


def _on_grid(t_s: LongSignal, rate_hz: float) -> bool:
    """Whether all stamps (n,) lie on the grid of a rate, within what rounding leaves."""
    first = row = 0.0
    for (part,) in stretches(t_s):
        first = float(part[0]) if not row else first
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.abs(part - first - (row + np.arange(part.size)) / rate_hz)
            if not np.all(off <= ON_GRID / rate_hz + 4.0 * np.finfo(float).eps * np.abs(part).max()):
                return False
        row += part.size
    return bool(row)


def check_rate(t_s: Signal, rate_hz: float, what: str = "the recording") -> str:
    """Refuse stamps (n,) in s that do not keep `rate_hz` (`BadSignalError`); gives a sentence where they only jitter.

    The rate is that of all stamps. Lost samples are named by their row (counted from 0) and step, a wrong rate by the
    rate that the stamps keep, a scatter of a sample or more by its size. Stamps rounded to more than a sample hide the
    loss of one.
    """
    if isinstance(t_s, LongSignal) and _on_grid(t_s, rate_hz):
        return ""
    t = np.asarray(t_s, dtype=float)
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size or not t.size:
        raise BadSignalError(f"{what} has no time stamp in row {bad[0] if bad.size else 0}", "no finite number")
    with np.errstate(over="ignore", invalid="ignore"):  # stamps of 1e308 are off the grid, and that is all
        off = t - t[0]
        off -= np.arange(t.size) / rate_hz
        largest = max(t.max(), -t.min())
        if max(off.max(), -off.min()) <= ON_GRID / rate_hz + 4.0 * np.finfo(float).eps * largest:
            return ""
        if not np.isfinite((t[-1] - t[0]) * rate_hz) or not np.isfinite(off).all():
            raise BadSignalError(f"the time stamps of {what} leave the rate of {rate_hz:g} Hz", f"up to {t.max():g} s")
    found = read_stamps(t, rate_hz)
    _refuse(found, t.size, rate_hz, what)
    rounded = f", rounded to {found.rounded_s:g} s" if found.rounded_s else ""
    return (
        f"the time stamps scatter by {found.jitter_s:.2g} s rms{rounded}; all {t.size} of them keep"
        f" {found.rate_hz:.6g} Hz, and the rows were taken at {rate_hz:g} Hz"
    )


def _unit_of(ratio: float) -> str:
    """The unit that stamps seem to have, as a part of a cure, where a power of a thousand lies between the rates."""
    for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if abs(ratio / factor - 1.0) < FAR_OFF:
            return f' or the unit of time ("{unit}")'
    return ""


def _refuse(found: Stamps, count: int, rate_hz: float, what: str) -> None:
    """Refuse gaps, a wrong rate, and stamps that scatter too far."""
    resample = "import the file with resample = true"
    if found.gaps:
        raise BadSignalError(
            f"the time stamps of {what} leave the rate of {rate_hz:g} Hz at row {found.gap_row}",
            f"a step of {found.gap_step_s:.6g} s where {1.0 / rate_hz:.6g} s is due,"
            f" {found.gaps} such step{'s' * (found.gaps > 1)} in all",
            f"cut the recording there, or {resample}",
        )
    if found.drift > ON_GRID + found.unsure:
        raise BadSignalError(
            f"the time stamps of {what} leave the rate of {rate_hz:g} Hz",
            f"all {count} of them keep {found.rate_hz:.6g} Hz",
            f"correct rate_hz{_unit_of(found.rate_hz / rate_hz)}, or {resample}",
        )
    if not found.even:
        raise BadSignalError(
            f"the time stamps of {what} leave the rate of {rate_hz:g} Hz now and then",
            f"they scatter by {found.jitter_s:.3g} s rms, up to {found.farthest_s:.3g} s, about {found.rate_hz:.6g} Hz",
            resample,
        )
