"""Is there feedback around the plant? A test of whether an input answers the noise of the output.

Without feedback, what the input does next is unrelated to what noise did to the output before. So the residual of a
direct estimate may correlate with past inputs, where the model lacks dynamics, but not with future ones: correlation
at negative lags shows feedback (Ljung, System Identification, 2nd ed. 1999, 16.6; Caines and Chan, IEEE TAC 20, 1975).
Tested as Geweke, Meese and Dent do (J. Econometrics 21, 1983): future inputs are added to a long ARX model,

    y(t) = sum a_i y(t-i) + sum b_i u(t-i) + sum c_k u(t+k) + e(t),

and c = 0 is an F test. It keeps its rate where either the ARX model is long enough for the plant and its noise, or
an autoregression of the same length for the input; far lags enter as means over ever longer stretches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array
from loopshape.data.signal.excitation_kind import is_sweep, zero_crossings
from loopshape.identify.tolerances import TOL

#: samples of the past that enter one by one, how far means over stretches go on, and how far into the future
NEAR, PAST, FUTURE = 32, 512, 64
#: share of an input's power that its past does not predict: below the first it is rounding, below the second the
#: input is a sweep, a multisine or the like, which a nonlinear plant answers as if it were fed back
ROUNDING, PREDICTABLE = 1e-14, 1e-2
#: difference between periods, of the input's rms, up to which it repeats; noise that is fed back moves it by more
REPEATED = 1e-6
#: zero crossings and rows over which a sweep is taken out at least, and the share of its power below which nothing is
#: left of it but what the fit rounds off
CYCLES, LEAST_ROWS, SWEPT = 8, 80, 1e-5


@dataclass(frozen=True)
class FeedbackCheck:
    """What future inputs explain of an output beyond its past: `probability` is that of as much without feedback.

    `detected` where that is below `false_alarms`. `explained` is a share of the residual's power, `lags` (samples) the
    stretch of the future input that explains most. `decidable` is False where the record cannot tell: an input that its
    past predicts completely shows nothing.
    """

    detected: bool
    probability: float
    explained: float
    lags: tuple[int, int]
    false_alarms: float
    decidable: bool
    samples: int
    sentence: str


def feedback_check(
    u: Array, y: Array, *, answers_after: int = 0, period: int | None = None, false_alarms: float = 0.01, name: str = ""
) -> FeedbackCheck:
    """Test an input u (n,) for noise of the output y (n,) that was fed back to it.

    `answers_after` are samples after which the plant answers at the soonest. 0 allows for an answer within the sample;
    where the controller's output of row k is computed from y of row k, as in a run folder, 1 makes the test see a
    controller that answers at once, and takes a plant that answers at once for feedback. An input that was measured
    through an anti-aliasing filter, not held between samples, is followed by an output that seems to come some samples
    early: -8 leaves these out (with 0 every such record of little noise is a false alarm). With `period` (samples, from
    the first row) only what differs between periods is tested.

    Sees only feedback that noise goes round: without noise there is nothing to see, and no bias. Under an excitation
    that is noise itself, far above the noise that is fed back, or where the controller is far slower than 64 samples,
    feedback is missed. An input that repeats exactly is never called feedback. Taken for feedback: what moves input and
    output both (hum on both wires), and a nonlinear plant under a sweep. Refuses a record of fewer than 160 rows.
    """
    if not 0.0 < false_alarms < 0.5:
        raise WrongUseError("a rate of false alarms lies between 0 and 0.5", f"{false_alarms!r}")
    if repeats(u, period) or _clocked(u):
        return nothing_new(false_alarms, u.size, name, True, True)
    x, z = (_scaled(s) for s in (u, y))
    swept = None if period else _without_sweep(x, z)
    least = 0.0
    if swept is not None:
        power = float(np.mean(swept[0] ** 2))
        least = TOL.feedback_share_noisy if power > TOL.feedback_noisy else TOL.feedback_share
        if power < SWEPT:
            return nothing_new(false_alarms, u.size, name, False, True)
        x, z = (_scaled(s) for s in swept)
    rows = _Rows.of(x.size + min(answers_after, 0), period or 0)
    past = np.stack([*_lagged(z, rows, -1, -1), *_lagged(x, rows, -answers_after, -1)], axis=1)
    future = np.stack(_lagged(_without_jumps(x), rows, 1 - answers_after, 1), axis=1)
    target, past, ahead = (rows.without_period(a) for a in (rows.take(z)[:, None], past, future))
    basis = _orthonormal(past)
    e, left = target[:, 0] - basis @ (basis.T @ target[:, 0]), ahead - basis @ (basis.T @ ahead)
    new = (left**2).sum(axis=0) / np.maximum((future**2).sum(axis=0), 1.0)  # share that the past does not predict
    if new.max() < ROUNDING or float(e @ e) < ROUNDING * e.size:
        return nothing_new(false_alarms, e.size, name, bool(period), bool(new.max() < ROUNDING))
    more = _orthonormal(left[:, new >= ROUNDING])
    explained = float(((more.T @ e) ** 2).sum() / (e @ e))
    added, slack = more.shape[1], e.size - rows.removed - basis.shape[1] - more.shape[1]
    ratio = (explained / added) / max((1.0 - explained) / slack, 1e-300)
    probability = float(fdtrc(added, slack, ratio))
    alone = np.abs(left.T @ e) / np.sqrt(np.where(new >= ROUNDING, (left**2).sum(axis=0), np.inf))
    lags = rows.stretch(int(np.argmax(alone)), answers_after)
    found = probability < false_alarms and explained >= least
    words = _sentence(found, probability, lags, name, predictable=bool(new[0] < PREDICTABLE) and not period)
    return FeedbackCheck(found, probability, explained, lags, false_alarms, True, e.size, words)


def enough_periods(rows: int, period: int) -> bool:
    """Whether a record of so many rows holds periods enough to test what differs between them."""
    return (rows - min(PAST, rows // 10) - min(FUTURE, rows // 20) - 1) // period >= 2


def repeats(u: Array, period: int | None = None) -> bool:
    """Whether an input u (n,) repeats over a whole period at least, to `REPEATED` of its rms: noise never does.

    Without a stated `period` (samples) one of half the record at most is looked for, and inputs of few values (a
    relay's limit cycle repeats too, and is feedback) are left to the test.
    """
    x = _scaled(u)
    if period is None:
        # an input of no more values than this, in its first rows, is switched: it may repeat under feedback too
        few_values, most_unique = 20, 20_000
        if x.size < 2 or np.unique(u[:most_unique]).size <= few_values:
            return False
        period = _best_lag(x)
    return 0 < period <= x.size // 2 and bool(np.abs(x[period:] - x[:-period]).max() <= REPEATED)


def _without_jumps(x: Array) -> Array:
    """An input x (n,) that moves at few times, as steps do, each stretch without its mean; any other as it is.

    Of so few moves none tells what the output did before it from chance.
    """
    steps = np.diff(x, prepend=x[0])
    # moves of an input below which it has few, and what is a jump, of the median step from row to row
    few_moves, jump = 100, 9.0
    many = float(np.sum(steps**2)) ** 2 >= few_moves * float(np.sum(steps**4))  # participation: how many count
    if many:
        return x
    stretch = np.cumsum(np.abs(steps) > jump * np.median(np.abs(steps)))
    return np.asarray(x - (np.bincount(stretch, x) / np.maximum(np.bincount(stretch), 1))[stretch])


def _clocked(u: Array) -> bool:
    """Whether an input (n,) switches between two levels as a clock does, to a sample all along: a relay's limit cycle
    that noise goes round loses the beat."""
    at, x = zero_crossings(u), u - 0.5 * (u.max() + u.min())
    ticks, two_levels = 8, 0.98  # ticks of a clock, and the share of a switched signal's power that two levels hold
    if at.size < 2 * ticks or np.mean(np.abs(x)) ** 2 < two_levels * np.mean(x**2):
        return False
    return all(_late(part) <= 1.0 for part in (at[::2], at[1::2]))


def _late(at: Array) -> float:
    """By how much times `at` (n,) leave a steady beat, at most."""
    k = np.arange(at.size)
    return float(np.abs(at - np.polyval(np.polyfit(k, at, 1), k)).max())


def _best_lag(x: Array) -> int:
    """The first lag of half a signal (n,) at most with which it differs least from itself; 0 where none stands out."""
    n, half = x.size, x.size // 2
    power = np.concatenate([[0.0], np.cumsum(x**2)])
    with_itself = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2, 2 * n)[1 : half + 1]
    lags = np.arange(1, half + 1)
    left = (power[n - lags] + power[n] - power[lags] - 2.0 * with_itself) / (n - lags)
    # mean square, of the input's, by which it must have changed before it can repeat
    moved = np.flatnonzero(left > 0.1)  # a slow signal is like itself a sample later, and does not repeat for it
    close = np.flatnonzero((left < 1e-9) & (lags > (moved[0] + 1 if moved.size else half)))
    return int(lags[close[np.argmin(left[close])]]) if close.size else 0


def _without_sweep(x: Array, z: Array) -> tuple[Array, Array] | None:
    """An input x (n,) that is a sweep, and its output z, without what follows its phase; None for another input.

    Some cycles at a time sine and cosine of a smooth phase are fitted with amplitudes of order two, and a parabola. A
    measured sweep's own past predicts it less well than the output's past does, which no noise went round for.
    """
    if not is_sweep(x):
        return None
    at = zero_crossings(x)
    left: list[Array] = []
    start = 0
    while start + CYCLES < at.size:
        stop = min(max(start + CYCLES, int(np.searchsorted(at, at[start] + LEAST_ROWS))), at.size - 1)
        rows = np.arange(int(np.ceil(at[start])), int(np.ceil(at[stop])))
        middle, half = 0.5 * (at[start] + at[stop]), 0.5 * (at[stop] - at[start])
        t = (rows - middle) / half
        near = slice(max(start - 2, 0), stop + 3)
        phase = np.polyval(np.polyfit((at[near] - middle) / half, np.pi * np.arange(at[near].size), 4), t)
        powers = np.stack([np.ones(t.size), t, t * t, t**3])
        basis = np.concatenate([powers, powers * np.cos(phase), powers * np.sin(phase)]).T
        both = np.stack([x[rows], z[rows]], axis=1)
        left.append(both - basis @ np.linalg.lstsq(basis, both, rcond=None)[0])
        start = stop
    columns = np.concatenate(left)
    return columns[:, 0], columns[:, 1]


@dataclass(frozen=True)
class _Rows:
    """Which rows t of a record are equations, and how its lags are grouped."""

    first: int
    last: int
    period: int
    near: int
    past: int
    future: int

    @classmethod
    def of(cls, n: int, period: int) -> _Rows:
        """As long a past and future as the record bears."""
        near = min(NEAR, n // 40)
        past, future = min(PAST, n // 10), min(FUTURE, n // 20)
        if near < 4:
            raise BadSignalError("the record is too short to look for feedback", f"{n} rows", "record 200 rows or more")
        first, last = past + 1, n - future
        if period:
            whole = (last - first) // period
            if whole < 2:
                raise BadSignalError(
                    "too few periods to look for feedback", f"{n} rows, {period} a period", "record three or more"
                )
            last = first + whole * period
        return cls(first, last, period, near, past, future)

    @property
    def removed(self) -> int:
        """Degrees of freedom that the mean, or the mean period, takes."""
        return self.period or 1

    def edges(self, side: int) -> list[tuple[int, int]]:
        """Stretches (from, to included) of lags counted from 0: one by one, then ever longer."""
        end, near = (self.past, self.near) if side < 0 else (self.future, 2)
        out = [(k, k) for k in range(near)]
        while out[-1][1] + 1 < end:
            start = out[-1][1] + 1
            out.append((start, min(start + max(1, start // 2), end - 1)))
        return out

    def stretch(self, k: int, answers_after: int) -> tuple[int, int]:
        """Samples into the future of the k-th future regressor."""
        low, high = self.edges(1)[k]
        return low + 1 - answers_after, high + 1 - answers_after

    def take(self, x: Array, shift: int = 0) -> Array:
        """x(t + shift) on the rows."""
        return x[self.first + shift : self.last + shift]

    def without_period(self, columns: Array) -> Array:
        """Columns without their mean, or without their mean period."""
        if not self.period:
            return columns - columns.mean(axis=0)
        folded = columns.reshape(-1, self.period, columns.shape[1])
        return np.asarray((folded - folded.mean(axis=0)).reshape(columns.shape))


def _lagged(x: Array, rows: _Rows, start: int, side: int) -> list[Array]:
    """Regressors: x(t + start), and on to that side, means over the stretches of `rows`."""
    sums = np.concatenate([[0.0], np.cumsum(x)])
    out = []
    for low, high in rows.edges(side):
        a, b = sorted((start + side * low, start + side * high))
        width = b - a + 1
        out.append((rows.take(sums[1:], b) - rows.take(sums, a)) / width if width > 1 else rows.take(x, a))
    return out


def _scaled(x: Array) -> Array:
    """Without mean, of unit power; a constant stays zero."""
    centred = x - x.mean()
    size = float(np.sqrt(np.mean(centred**2)))
    return np.asarray(centred / size if size > 0.0 else centred)


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis (n, rank) of the space of columns, each first brought to the same length."""
    length = np.sqrt((columns**2).sum(axis=0))
    kept = columns[:, length > 0.0] / length[length > 0.0]
    values, vectors = np.linalg.eigh(kept.T @ kept)
    strong = values > 1e-11 * max(float(values.max(initial=0.0)), 1.0)
    return np.asarray(kept @ (vectors[:, strong] / np.sqrt(values[strong])))


def nothing_new(false_alarms: float, samples: int, name: str, periodic: bool, predictable: bool) -> FeedbackCheck:
    """The answer where an input holds nothing that noise could have put there, or an output no noise."""
    who, decidable = name or "the input", periodic and predictable
    words = (
        f"{who} is predictable from its own past: the record does not show whether it responds to noise of its output"
    )
    if decidable:
        words = f"{who} repeats exactly from period to period: it does not answer noise of its output"
    elif not predictable:
        words = f"the output follows {who} without noise: the record does not show which of them responds to the other"
    return FeedbackCheck(False, 1.0, 0.0, (0, 0), false_alarms, decidable, samples, words)


def _sentence(found: bool, probability: float, lags: tuple[int, int], name: str, predictable: bool) -> str:
    who = name or "the input"
    if not found:
        return f"no sign that {who} answers noise of its output (p = {probability:.2g})"
    when = f"{lags[0]} to {lags[1]}" if lags[1] > lags[0] else f"{lags[0]}"
    other = ", which such an input cannot separate from feedback" if predictable else ""
    return (
        f"{who} seems to answer noise of its output (p = {probability:.1e}; it follows what the past of both leaves"
        f" unexplained, {when} samples later): feedback, or a plant that is not linear{other}, or an input that was"
        " measured through a filter (anti-aliasing) and not commanded; with feedback the direct estimate is biased"
        " towards -1/C: then set closed_loop = true and name the external excitation"
    )
