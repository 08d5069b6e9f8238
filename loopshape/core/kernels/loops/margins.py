"""The margins of many open loops on the same lines: one pass over the lines for each.

Every number is in the unit in which its error is nearest to normal: dB, degrees, or a natural logarithm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from loopshape.core.kernels.compiled import Array, ComplexArray, compiled, compiled_reading

#: what a column of `read_margins` holds
GAIN_DB, REDUCTION_DB, PHASE_DEG, LN_DELAY_S, LN_MODULUS, COMPLEMENTARY_DB, CONTROL_DB, CONTROL_HIGH_DB = range(8)
LN_BANDWIDTH_HZ, LN_DISK, PROCESS_DB, LN_SENSITIVITY_HZ, LN_COMPLEMENTARY_HZ = range(8, 13)
#: by how much |S|, |T|, |CS|, |PS| and |L| exceed their masks, and a floor exceeds |L|, in the order of the masks' rows
MASK_S, MASK_T, MASK_CS, MASK_PS, MASK_L, FLOOR_L = range(13, 19)
#: the largest root of the sum of squared weighted |S|, |T|, |CS| and |PS|
LN_WEIGHTED = 19
COLUMNS = 20
#: columns that are the largest of squared magnitudes, and in the end in dB
LARGEST = (
    COMPLEMENTARY_DB, CONTROL_DB, CONTROL_HIGH_DB, PROCESS_DB, MASK_S, MASK_T, MASK_CS, MASK_PS, MASK_L, FLOOR_L,
    LN_WEIGHTED,
)  # fmt: skip
_DB = 10.0 / np.log(10.0)  # of a squared magnitude
_DEG = 180.0 / np.pi
#: a first frequency that is less than this share of the second stands for 0 Hz: nothing lies below it
AT_ZERO = 1e-4
#: |L| from which on, at its first line, margins and peaks below it say nothing that is looked for
LARGE = 10.0
_TINY = 1e-300


class Lines(NamedTuple):
    """Frequencies in Hz and C on them (nf,), and both above the last line, where no L was measured."""

    f: Array
    C: ComplexArray
    f_above: Array
    C_above: ComplexArray


class Asked(NamedTuple):
    """What is read of a loop besides its margins, and what counts where it was not measured.

    |CS| counts as high from `from_hz` on. `masks` (10, nf) and `masks_above` weigh squared magnitudes (`_over_masks`),
    with no rows where nothing is weighed. What |L| may do above the last line, below its last value, or `least` where
    that is more, counts where `bounded` is true; without it the answer is the best that may be. So does what it may do
    below the first line, above its value there, where `below` is true as well.
    """

    from_hz: float
    masks: Array
    masks_above: Array
    bounded: bool
    below: bool
    least: float


# Kernels make them so and not by their names: what is only read then has the form that Python's calls have.


@compiled_reading()
def lines_of(f: Array, C: ComplexArray, f_above: Array, C_above: ComplexArray) -> Lines:
    """Lines."""
    return Lines(f, C, f_above, C_above)


@compiled_reading()
def asked_of(from_hz: float, masks: Array, masks_above: Array, bounded: bool, below: bool) -> Asked:
    """What is read, where nothing larger is known above the last line."""
    return Asked(from_hz, masks, masks_above, bounded, below, 0.0)


class _Sizes(NamedTuple):
    """Lines with the squared magnitudes of C on them and above, and their inverse."""

    f: Array
    c2: Array
    over_c2: Array
    f_above: Array
    c2_above: Array


class _Squares(NamedTuple):
    """Squared |S|, |T|, |C| and |L| at one frequency, and the least that |L|² may be."""

    s: float
    t: float
    c: float
    l: float
    least: float


@compiled
def _note(found: Array, at: Array, column: int, value: float, where: float, largest: bool) -> None:
    if (value > found[column]) if largest else (value < found[column]):
        found[column], at[column] = value, where


@compiled
def _between(f0: float, f1: float, size0: float, size1: float, level: float) -> float:
    """ln of the frequency where ln of a squared magnitude, linear in ln f, passes a level."""
    a, b = np.log(max(size0, _TINY) / level), np.log(max(size1, _TINY) / level)
    return np.log(f0) + np.log(f1 / f0) * a / (a - b)


@compiled
def _unit_crossing(f0: float, f1: float, one: complex, two: complex, found: Array, at: Array) -> None:
    """Phase and delay margin where |L| passes 1, ln L being linear in ln f."""
    a, b = np.log(abs(one)), np.log(abs(two))
    share = a / (a - b)
    turn = two / one
    phase = np.arctan2(one.imag, one.real) + share * np.arctan2(turn.imag, turn.real)
    ahead = (phase * _DEG + 180.0) % 360.0
    where = f0 * (f1 / f0) ** share
    _note(found, at, PHASE_DEG, min(ahead, 360.0 - ahead), where, False)
    _note(found, at, LN_DELAY_S, np.log(max(ahead, _TINY) / 360.0 / where), where, False)


@compiled
def _axis_crossing(f0: float, f1: float, one: complex, two: complex, found: Array, at: Array) -> None:
    """Gain margin, or reduction margin, where the chord crosses the negative real axis."""
    share = one.imag / (one.imag - two.imag)
    value = one.real + share * (two.real - one.real)
    if value >= 0.0:
        return
    size, where = 2.0 * _DB * np.log(max(-value, _TINY)), f0 + share * (f1 - f0)
    if size <= 0.0:
        _note(found, at, GAIN_DB, -size, where, False)
    else:
        _note(found, at, REDUCTION_DB, size, where, False)


@compiled
def _chord(f0: float, f1: float, one: complex, two: complex, found: Array, at: Array) -> None:
    """Squared distance of the chord from -1 (kept squared until the end)."""
    start, step = 1.0 + one, two - one
    length = step.real**2 + step.imag**2
    share = 0.0
    if length > 0.0:
        share = min(max(-(start.real * step.real + start.imag * step.imag) / length, 0.0), 1.0)
    near = start + share * step
    _note(found, at, LN_MODULUS, near.real**2 + near.imag**2, f0 + share * (f1 - f0), False)


@compiled
def _line(
    f: float, L: complex, size2: float, c2: float, over_c2: float, high: bool, found: Array, at: Array
) -> tuple[float, float]:
    """What one line shows by itself, given |L|², |C|² and its inverse; squared |S| and |T|."""
    d2 = max((1.0 + L.real) ** 2 + L.imag**2, _TINY)
    s2 = 1.0 / d2
    t2 = size2 * s2
    _note(found, at, COMPLEMENTARY_DB, t2, f, True)
    _note(found, at, CONTROL_DB, c2 * s2, f, True)
    if high:
        _note(found, at, CONTROL_HIGH_DB, c2 * s2, f, True)
    _note(found, at, PROCESS_DB, t2 * over_c2, f, True)
    _note(found, at, LN_DISK, d2 / max((1.0 - L.real) ** 2 + L.imag**2, _TINY), f, False)
    return s2, t2


@compiled
def _over_masks(f: float, size2: _Squares, weights: Array, found: Array, at: Array) -> None:
    """Squared excess of |S|, |T|, |CS|, |PS| and |L| over their masks at one frequency, and of the floor over |L|.

    `weights` (10,) are 1 over squared limits, 0 where there is none, the squared floor, and the squared weights of |S|,
    |T|, |CS| and |PS|, which are summed.
    """
    s2, t2, c2 = size2.s, size2.t, size2.c
    _masked(MASK_S, s2, weights[0], f, found, at)
    _masked(MASK_T, t2, weights[1], f, found, at)
    _masked(MASK_CS, c2 * s2, weights[2], f, found, at)
    _masked(MASK_PS, t2 / max(c2, _TINY), weights[3], f, found, at)
    _masked(MASK_L, size2.l, weights[4], f, found, at)
    if weights[5] > 0.0:
        _note(found, at, FLOOR_L, weights[5] / max(size2.least, _TINY), f, True)
    total = weights[6] * s2 + weights[7] * t2 + weights[8] * c2 * s2 + weights[9] * t2 / max(c2, _TINY)
    if total > 0.0:
        _note(found, at, LN_WEIGHTED, total, f, True)


@compiled
def _masked(column: int, size2: float, weight: float, f: float, found: Array, at: Array) -> None:
    if weight > 0.0:
        _note(found, at, column, size2 * weight, f, True)


@compiled
def _masks_above(
    last: float, f_above: Array, c2_above: Array, masks_above: Array, bounded: bool, found: Array, at: Array
) -> None:
    """Above the last line, where |L| stays below `last`: the worst that may be, or the best where not `bounded`."""
    room = max(1.0 - last, 1e-9)
    for i in range(f_above.size):
        if bounded:
            s2, t2, l2, least2 = 1.0 / room**2, (last / room) ** 2, last**2, 0.0
        else:
            s2, t2, l2, least2 = 1.0 / (1.0 + last) ** 2, 0.0, 0.0, last**2
        _over_masks(f_above[i], _Squares(s2, t2, c2_above[i], l2, least2), masks_above[:, i], found, at)


@compiled
def _control_above(d2: float, f_above: Array, c2_above: Array, from_hz: float, found: Array, at: Array) -> None:
    """|CS| above the last line, where |1 + L|² is `d2`."""
    for i in range(f_above.size):
        size = c2_above[i] / d2
        _note(found, at, CONTROL_DB, size, f_above[i], True)
        if f_above[i] >= from_hz:
            _note(found, at, CONTROL_HIGH_DB, size, f_above[i], True)


@compiled
def _above(
    f_last: float, last: float, f_above: Array, c2_above: Array, from_hz: float, found: Array, at: Array
) -> None:
    """Above the last line |L| stays below `last`: how near -1 it may come there, and how large all may be."""
    room = max(1.0 - last, 1e-9)
    _note(found, at, GAIN_DB, max(-2.0 * _DB * np.log(max(last, _TINY)), 0.0), f_last, False)
    _note(found, at, LN_MODULUS, max(1.0 - last, 0.0) ** 2, f_last, False)
    _note(found, at, LN_DISK, (max(1.0 - last, 0.0) / (1.0 + last)) ** 2, f_last, False)
    _note(found, at, COMPLEMENTARY_DB, (last / room) ** 2, f_last, True)
    _control_above(room**2, f_above, c2_above, from_hz, found, at)


@compiled
def _below(f_first: float, first: float, found: Array, at: Array) -> None:
    """Below the first line |L| stays above `first`, its value there; where that is no more than 1 nothing is known."""
    _note(found, at, REDUCTION_DB, 2.0 * _DB * np.log(max(first, 1.0)), f_first, False)
    if first >= LARGE:  # |S| stays below 1/9 there, and |T| within 1 dB of 1
        return
    room = max(first - 1.0, 0.0)
    _note(found, at, LN_MODULUS, room**2, f_first, False)
    _note(found, at, LN_DISK, (room / (1.0 + first)) ** 2, f_first, False)
    _note(found, at, COMPLEMENTARY_DB, first**2 / max(room, 1e-9) ** 2, f_first, True)
    if room == 0.0:
        _note(found, at, PHASE_DEG, 0.0, f_first, False)
        _note(found, at, LN_DELAY_S, -np.inf, f_first, False)


@compiled
def _finish(found: Array) -> None:
    """From squared magnitudes to dB and logarithms."""
    for column in LARGEST:
        found[column] = _DB * np.log(found[column]) if found[column] > 0.0 else -np.inf
    found[LN_WEIGHTED] *= 0.5 / _DB
    found[LN_MODULUS] = 0.5 * np.log(found[LN_MODULUS]) if found[LN_MODULUS] > 0.0 else -np.inf
    found[LN_DISK] = np.log(2.0) + 0.5 * np.log(found[LN_DISK]) if found[LN_DISK] > 0.0 else -np.inf


@compiled_reading()
def read_margins(L: ComplexArray, lines: Lines, asked: Asked) -> tuple[Array, Array]:
    """Margins (loops, COLUMNS) of open loops L (loops, nf), and the frequencies in Hz where they lie.

    +-inf where the loop never comes to what a margin is about; ln of a bandwidth is -inf where it is out of sight.
    """
    found, at = np.empty((len(L), COLUMNS)), np.full((len(L), COLUMNS), np.nan)
    C, C_above = lines.C, lines.C_above
    c2, c2_above = C.real**2 + C.imag**2, C_above.real**2 + C_above.imag**2
    over_c2 = 1.0 / c2
    for b in range(len(L)):
        _read(L[b], _Sizes(lines.f, c2, over_c2, lines.f_above, c2_above), asked, found[b], at[b])
    return found, at


@compiled
def read_drawn(reference: ComplexArray, factor: ComplexArray, draws: ComplexArray, lines: Lines, asked: Asked) -> Array:
    """Margins (draws, COLUMNS) of `reference` (nf,) and `factor` (nf,) times each of `draws` (draws, nf)."""
    C, C_above = lines.C, lines.C_above
    found, at, L = np.empty((len(draws), COLUMNS)), np.empty(COLUMNS), np.empty(lines.f.size, dtype=np.complex128)
    c2, c2_above = C.real**2 + C.imag**2, C_above.real**2 + C_above.imag**2
    over_c2 = 1.0 / c2
    for b in range(len(draws)):
        mine = draws[b]
        for k in range(lines.f.size):
            L[k] = reference[k] + factor[k] * mine[k]
        _read(L, _Sizes(lines.f, c2, over_c2, lines.f_above, c2_above), asked, found[b], at)
    return found


@compiled_reading("found", "at")
def _read(L: ComplexArray, sizes: _Sizes, asked: Asked, found: Array, at: Array) -> None:
    """Margins of one loop into `found` (COLUMNS,), and where they lie into `at`."""
    f, c2, over_c2 = sizes.f, sizes.c2, sizes.over_c2
    found[:] = np.inf
    for column in LARGEST:
        found[column] = -np.inf
    found[LN_BANDWIDTH_HZ] = found[LN_SENSITIVITY_HZ] = found[LN_COMPLEMENTARY_HZ] = -np.inf
    before_s = before_t = before_size = 0.0
    crossed = sensed = False
    for k in range(f.size):
        now = L[k]
        size = now.real**2 + now.imag**2
        s2, t2 = _line(f[k], now, size, c2[k], over_c2[k], f[k] >= asked.from_hz, found, at)
        if asked.masks.shape[0]:
            _over_masks(f[k], _Squares(s2, t2, c2[k], size, size), asked.masks[:, k], found, at)
        if k > 0:
            _chord(f[k - 1], f[k], L[k - 1], now, found, at)
            if (before_size >= 1.0) != (size >= 1.0):
                _unit_crossing(f[k - 1], f[k], L[k - 1], now, found, at)
                if not crossed and before_size >= 1.0:
                    found[LN_BANDWIDTH_HZ] = _between(f[k - 1], f[k], before_size, size, 1.0)
                    at[LN_BANDWIDTH_HZ] = np.exp(found[LN_BANDWIDTH_HZ])
                    crossed = True
            if (L[k - 1].imag >= 0.0) != (now.imag >= 0.0):
                _axis_crossing(f[k - 1], f[k], L[k - 1], now, found, at)
            if not sensed and before_s < 0.5 <= s2:
                found[LN_SENSITIVITY_HZ] = _between(f[k - 1], f[k], before_s, s2, 0.5)
                sensed = True
            if before_t >= 0.5 > t2:
                found[LN_COMPLEMENTARY_HZ] = _between(f[k - 1], f[k], before_t, t2, 0.5)
        elif s2 >= 0.5:
            sensed = True
        before_s, before_t, before_size = s2, t2, size
    if f.size == 1:
        _note(found, at, LN_MODULUS, abs(1.0 + L[0]) ** 2, f[0], False)
    if not sensed:
        found[LN_SENSITIVITY_HZ] = np.log(f[f.size - 1])
    if before_t >= 0.5:
        found[LN_COMPLEMENTARY_HZ] = np.log(f[f.size - 1])
    if asked.below and asked.bounded and f.size > 1 and f[0] > AT_ZERO * f[1]:
        _below(f[0], abs(L[0]), found, at)
    _read_above(max(np.sqrt(before_size), asked.least), sizes, asked, found, at)
    _finish(found)


@compiled
def _read_above(size: float, sizes: _Sizes, asked: Asked, found: Array, at: Array) -> None:
    """What lies above the last line, where |L| is `size`."""
    f_last, f_above, c2_above, from_hz = sizes.f[sizes.f.size - 1], sizes.f_above, sizes.c2_above, asked.from_hz
    last = size if asked.bounded else min(size, 1.0)
    if asked.bounded and size >= 1.0:
        found[PHASE_DEG], found[LN_DELAY_S] = 0.0, -np.inf
    if asked.bounded:
        _above(f_last, last, f_above, c2_above, from_hz, found, at)
    else:
        _control_above((1.0 + last) ** 2, f_above, c2_above, from_hz, found, at)
    if asked.masks.shape[0] > 0:
        _masks_above(last, f_above, c2_above, asked.masks_above, asked.bounded, found, at)
