"""Undecided -> the measurement that would settle it: its band, the distance of its lines, and its length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.core.units import Array, from_db
from loopshape.data.requirement.requirements import LIMITS, Limit, Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Order, SettledBy, Verdict
from loopshape.loop.loop import Loop
from loopshape.loop.margin.between import path_of
from loopshape.loop.points import point_outcome
from loopshape.loop.stability.holes import median_of_five
from loopshape.loop.stability.low_end import crossover_below, in_sight
from loopshape.loop.stability.obstacles import Undecided
from loopshape.loop.stability.stability import LOWER, Stability, closed_loop_stability, obstacles_of
from loopshape.loop.tolerances import TOL

#: lines that do not show what lies between them are asked for so many times closer, those of a limit so many
FINER, FINER_LIMIT = 4.0, 2.0
#: periods that a measurement has at least
PERIODS = 4.0
#: more data than so many times those at hand are not asked for
MOST = 400.0
#: a band goes on by this factor beside a frequency at which a limit is read, and by the second above the last line
ABOUT, HIGHER = 2.0**0.5, 1.2
#: highest frequency of an order, as a share of the rate
OF_RATE = 0.45


@dataclass(frozen=True)
class _Wanted:
    """A band in Hz in which `data` times as much is wanted, or lines `finer` times as close."""

    low_hz: float
    high_hz: float
    data: float = 1.0
    finer: float = 1.0


def with_orders(found: Verdict, loops: Sequence[Loop], frfs: Sequence[FRF], requirements: Requirements) -> Verdict:
    """An undecided verdict on single loops with what would settle each undecided point; any other as it is.

    `loops` and the `frfs` that they were made of stand in the order of the verdict's margins.
    """
    if found.outcome is not Outcome.UNDECIDED:
        return found
    points = zip(found.margins.values(), loops, frfs, strict=True)
    return replace(found, orders=tuple(order for one in points for order in _orders(*one, requirements)))


def _orders(margins: Margins, loop: Loop, frf: FRF, requirements: Requirements) -> list[Order]:
    """What one operating point needs; nothing where it is decided."""
    stability = closed_loop_stability(loop) if margins.stable is ClosedLoop.UNDECIDED else None
    asked = requirements.of(loop.plant.operating_point)
    limits = [(x, v) for x in LIMITS if (v := getattr(asked, x.name)) is not None]
    limits = [(x, v) for x, v in limits if point_outcome(margins, x.name, v) is Outcome.UNDECIDED]
    if stability is None and not limits:
        return []
    name = frf.recordings[0] if frf.recordings else frf.recording
    if stability is not None and stability.band_hz is None:
        return [Order(name, SettledBy.DECLARATION)]
    wanted = [] if stability is None else list(_for_count(loop, stability))
    wanted += [one for x, v in limits for one in _for_limit(loop, margins, x, v)]
    rate_hz = loop.controller.rate_hz
    band = requirements.band_hz or (0.0, np.inf)
    bands = [(max(w.low_hz, band[0]), min(w.high_hz, band[1], OF_RATE * rate_hz), w) for w in wanted]
    measured = [_measured(name, frf, replace(w, low_hz=low, high_hz=high)) for low, high, w in bands if low < high]
    if measured:
        return _merged(measured)
    outside = any(w.low_hz < OF_RATE * rate_hz for w in wanted)  # and yet beside the band that is to be used
    return [Order(name, SettledBy.DECLARATION if outside else SettledBy.NOTHING)]


def _for_count(loop: Loop, stability: Stability) -> Iterator[_Wanted]:
    """What the count of encirclements wants: all that stands in its way, not only what is named first."""
    path = path_of(loop)
    first, last = float(path.f[0]), float(path.f[-1])
    for one in (Undecided(stability.reason, stability.band_hz), *obstacles_of(loop)):
        if one.band_hz is None:
            continue
        low, high = min(one.band_hz[0], last), max(one.band_hz[1], first)  # no stretch stays unknown on the way there
        here = (path.f >= low) & (path.f <= high) & (path.std > 0.0) & (path.line | (not one.finer))
        distance = float((np.abs(1.0 + path.L[here]) / path.std[here]).min(initial=np.inf))
        if low >= last * (1.0 - 1e-9):
            high *= HIGHER
        yield _Wanted(low, high, _times(1.0, TOL.ordered_clear_std / max(distance, 0.5)), FINER if one.finer else 1.0)


def _times(least: float, std_over: float) -> float:
    """A factor on the data for a factor on the deviation."""
    return min(max(least, std_over**2), MOST)


def _for_limit(loop: Loop, margins: Margins, limit: Limit, required: float) -> Iterator[_Wanted]:
    """What a limit wants that the margins do not decide."""
    read, f = margins[limit.name], loop.frequency_hz
    first, last = float(f[0]), float(f[-1])
    at_hz = float(f[np.argmin(np.abs(1.0 + loop.L))]) if read.at_hz is None else read.at_hz
    if limit.disturbed:
        return
    if read.value != read.value and not in_sight(loop):
        yield _Wanted(*crossover_below(loop))
        return
    if read.bound is not None and at_hz >= last * (1.0 - 1e-9):
        yield _Wanted(last, HIGHER * (decided_at_hz(limit.name, required, margins) or 2.0 * last))
        return
    gap = next((gap for gap in margins.missing_hz if gap[0] < at_hz < gap[1]), None)
    if gap is not None:
        yield _Wanted(*gap)
    elif at_hz <= first:
        yield _Wanted(LOWER * first, first)
    else:
        if not np.isfinite(read.ends).any():  # errors as large as L left nothing to read
            yield _drowned(loop)
            return
        bad, good = read.ends[:: int(limit.sign)]
        more = min(max(TOL.ordered_data * longer(read.value, bad, good, required, limit.sign), 1.0), MOST)
        yield _Wanted(at_hz / ABOUT, min(at_hz * ABOUT, max(last, at_hz)), more, FINER_LIMIT)


def _drowned(loop: Loop) -> _Wanted:
    """Where errors are as large as L itself, which is not small."""
    path = path_of(loop)
    here = path.f[(np.abs(path.L) > TOL.drowned_gain) & (path.std > TOL.drowned_std * np.abs(path.L))]
    here = here if here.size else path.f
    return _Wanted(float(here[0]), float(here[-1]), MOST, FINER)


def _measured(name: str, frf: FRF, wanted: _Wanted) -> Order:
    """A band with the distance of its lines and the seconds, at the FRF's deviation there.

    A line's variance falls with its seconds times the distance of lines. An FRF whose averages are not known counts as
    one period of the distance of its own lines. Where its error hides everything that is what comes first.
    """
    f, std = frf.frequency_hz, median_of_five(frf.relative_std[:, 0, 0])
    apart, own = _distances(f, wanted)
    here = (f >= wanted.low_hz) & (f <= wanted.high_hz)
    middle = np.sqrt(wanted.low_hz * wanted.high_hz)
    relative = float(std[here].max()) if here.any() else float(np.interp(np.log(middle), np.log(f), std))
    averages = max(frf.averages / frf.line_overlap, 1.0) if np.isfinite(frf.averages) else 1.0
    finer = wanted.finer if relative <= TOL.poor_std and np.count_nonzero(here) > 2 else 1.0
    resolution = apart / finer
    seconds = max(
        PERIODS / resolution,
        min(wanted.data, _times(1.0, relative / TOL.known_enough_std)) * averages / own,
        _times(0.0, relative / TOL.ordered_std) * averages / resolution,
    )
    aside = own if finer > 1.0 else 0.0
    low, high = max(wanted.low_hz - aside, 0.5 * wanted.low_hz), wanted.high_hz + aside
    return Order(name, SettledBy.MEASUREMENT, *(float(f"{x:.4g}") for x in (low, high, resolution, seconds)))


def _distances(f: Array, wanted: _Wanted) -> tuple[float, float]:
    """Distance of lines in Hz to ask for in a band before it is made finer, and that of the lines there or next to it.

    Below the first line it is half of the lowest frequency at most; in a hole what lies beside it has, and a quarter of
    the hole at most.
    """
    low, high = wanted.low_hz, wanted.high_hz
    inside = f[(f >= low * (1.0 - 1e-9)) & (f <= high * (1.0 + 1e-9))]
    if inside.size > 2:
        own = float(np.median(np.diff(inside)))
        return min(own, 0.5 * (high - low)), own
    k, gaps = int(np.searchsorted(f, np.sqrt(low * high))), np.diff(f)
    if not gaps.size:
        return 0.25 * (high - low), 0.25 * (high - low)
    beside = gaps[[max(min(k - 2, gaps.size - 1), 0), min(k, gaps.size - 1)]]
    own = float(beside.min())
    if high <= f[0] * (1.0 + 1e-9):
        return min(own, 0.5 * low), own
    return min(own, 0.25 * (high - low)), own


def _merged(orders: list[Order]) -> list[Order]:
    """Orders of one recording, those whose bands overlap as one."""
    found: list[Order] = []
    for one in sorted(orders, key=lambda x: x.low_hz or 0.0):
        last = found[-1] if found else None
        if last is None or not (one.low_hz or 0.0) < (last.high_hz or 0.0):
            found.append(one)
            continue
        found[-1] = replace(
            last,
            high_hz=max(last.high_hz or 0.0, one.high_hz or 0.0),
            resolution_hz=min(last.resolution_hz or np.inf, one.resolution_hz or np.inf),
            seconds=max(last.seconds or 0.0, one.seconds or 0.0),
        )
    return found


def decided_at_hz(quantity: str, required: float, margin: Margins) -> float | None:
    """Up to where to measure until |L|, falling on as over the highest lines, is below the limit."""
    size = from_db(required) if quantity.endswith("_db") else required
    small = {
        "gain_margin_db": 1.0 / size,
        "modulus_margin": 1.0 - size,
        "sensitivity_peak_db": 1.0 - 1.0 / size,
        "disk_margin": (2.0 - size) / (2.0 + size),
        "complementary_peak_db": size / (1.0 + size),
        "sensitivity_bandwidth_hz": None,
        "complementary_bandwidth_hz": None,
    }.get(quantity, 0.1)
    if small is None:  # a bandwidth: up to the limit itself
        return required
    if small <= 0.0 or not margin.last_slope > 0.0:
        return None
    return float(margin.last_hz * max((margin.last_gain / small) ** (1.0 / max(margin.last_slope, 0.5)), 1.05))


def longer(value: float, bad: float, good: float, required: float, sign: float) -> float:
    """Factor on the measuring time after which the interval, shrunk as 1/sqrt(time), would leave out the limit."""
    room = sign * (value - required)
    if not np.isfinite(value):
        return float("inf")
    distance = abs(value - (bad if room >= 0.0 else good))
    return float((distance / abs(room)) ** 2) if room else float("inf")
