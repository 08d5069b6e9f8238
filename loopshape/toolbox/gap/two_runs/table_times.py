"""Two recordings that had the same inputs: where their signals part in time, and where they come to rest."""

from __future__ import annotations

import numpy as np

from loopshape.core.units import Array
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.gap_table import TimeRow
from loopshape.toolbox.gap.two_runs.table_pairs import Pair

#: blocks of a settled stretch whose means tell how sure its mean is
BLOCKS = 8


def time_rows(real: Run, pair: Pair) -> tuple[list[TimeRow], str]:
    """Rows of one pair of recordings, or why there are none.

    Windows run from one move of the inputs to the next; the noise floor is the unrest of both recordings where they
    rest: a limit cycle or the ripple of valves counts as that.
    """
    n = min(_length(pair.real), _length(pair.sim))
    why, inputs = _inputs(real, pair, n)
    if why:
        return [], f"recording {pair.real.info.name}: {why}; its time responses are not compared"
    windows = _windows(inputs, real.rate_hz)
    rests = [r for r in (_rest(inputs, w, real.rate_hz) for w in windows) if r is not None]
    rows = []
    for signal in _signals(real, pair):
        one, two = pair.real.output(signal)[:n], pair.sim.output(signal)[:n]
        floor = _floor(one, two, rests)
        rows += [_window_row(pair, signal, two - one, w, floor, real.rate_hz) for w in windows]
        rows += [_rest_row(pair, signal, two - one, r, real.rate_hz) for r in rests]
    return rows, ""


def _length(recording: Recording) -> int:
    return len(recording.columns[next(iter(recording.columns))])


def _signals(real: Run, pair: Pair) -> list[str]:
    """Outputs, their terms, and under feedback the controls, as far as both recordings hold them."""
    wanted = []
    for loop in real.loops:
        terms = sum_terms(loop.output)
        wanted += [loop.output, *(terms if len(terms) > 1 else ())]
        wanted += [loop.control] if pair.real.info.closed_loop else []
    held = [set(r.columns) for r in (pair.real, pair.sim)]
    return [s for s in dict.fromkeys(wanted) if all(set(sum_terms(s)) <= columns for columns in held)]


def _inputs(real: Run, pair: Pair, n: int) -> tuple[str, Array]:
    """Why the inputs are not the same, empty where they are; and the inputs (inputs, n)."""
    opened = pair.real.info.injection == "control" or not pair.real.info.closed_loop
    names = [x for loop in real.loops for x in ((loop.control,) if opened else (loop.reference, loop.injected)) if x]
    names = [x for x in names if x in pair.real.columns and x in pair.sim.columns]
    if not names:
        return "it holds no external excitation", np.zeros((0, n))
    inputs = np.stack([pair.real.column(x)[:n] for x in names])
    same = 1e-3  # inputs are the same where they differ by less than this share of what they span
    for name, values in zip(names, inputs, strict=True):
        apart = float(np.abs(pair.sim.column(name)[:n] - values).max(initial=0.0))
        if apart > same * max(float(np.ptp(values)), 1e-3 * float(np.abs(values).max()), 1e-9):
            return f"{name} differs between the runs by up to {apart:.3g}", inputs
    return "", inputs


def _windows(inputs: Array, rate_hz: float) -> list[tuple[int, int]]:
    """First and last (excluded) sample of the stretches from one move to the next."""
    moves = np.flatnonzero(np.any(np.diff(inputs, axis=1) != 0.0, axis=0)) + 1
    starts = moves[np.diff(moves, prepend=-np.inf) > 0.5 * rate_hz]  # moves closer than this belong to one window
    edges = np.unique(np.concatenate([[0], starts, [inputs.shape[1]]])).astype(int)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _rest(inputs: Array, window: tuple[int, int], rate_hz: float) -> tuple[int, int] | None:
    """The second half of what follows the last move in a window; None where that is short."""
    start, end = window
    moving = np.flatnonzero(np.any(np.diff(inputs[:, start:end], axis=1) != 0.0, axis=0))
    still = start + (int(moving[-1]) + 1 if moving.size else 0)
    rest_s = 1.0  # a stretch at rest is the second half of one this long at least
    return ((still + end) // 2, end) if end - still >= rest_s * rate_hz else None


def _floor(one: Array, two: Array, rests: list[tuple[int, int]]) -> float:
    """Rms unrest of both recordings together, in the median over rests; from second differences where none is."""
    if rests:
        return float(np.median([np.hypot(_unrest(one[a:b]), _unrest(two[a:b])) for a, b in rests]))
    return float(np.hypot(*(np.std(np.diff(x, 2)) / np.sqrt(6.0) for x in (one, two))))


def _unrest(x: Array) -> float:
    """Standard deviation (n,) about a straight line."""
    t = np.arange(x.size)
    return float(np.std(x - np.polyval(np.polyfit(t, x, 1), t)))


def _window_row(pair: Pair, signal: str, d: Array, window: tuple[int, int], floor: float, rate_hz: float) -> TimeRow:
    size = float(np.sqrt(np.mean(d[slice(*window)] ** 2)))
    return _row("window", pair, signal, window, size, floor, rate_hz)


def _rest_row(pair: Pair, signal: str, d: Array, rest: tuple[int, int], rate_hz: float) -> TimeRow:
    means = [float(block.mean()) for block in np.array_split(d[slice(*rest)], BLOCKS)]
    slow, fast = float(np.std(means, ddof=1)), _unrest(d[slice(*rest)])
    floor = max(slow, fast) / float(np.sqrt(BLOCKS))  # a machine with a dead zone rests anywhere within it
    return _row("rest", pair, signal, rest, float(np.mean(means)), floor, rate_hz)


def _row(
    kind: str, pair: Pair, signal: str, part: tuple[int, int], difference: float, floor: float, rate_hz: float
) -> TimeRow:
    return TimeRow(
        kind=kind,
        recording=pair.real.info.name,
        operating_point=dict(pair.real.info.operating_point),
        signal=signal,
        unit=Channel.from_column(sum_terms(signal)[0]).unit,
        from_s=part[0] / rate_hz,
        to_s=part[1] / rate_hz,
        difference=difference,
        floor=floor,
    )
