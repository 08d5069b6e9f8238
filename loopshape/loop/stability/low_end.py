"""The low end of a measured loop: where the crossover lies below the first line, and how far a model may lead there.

Below the first line P is taken as B(s)/(A(s) s^k) with k declared, A(0) = 1 and low orders, fitted to the lowest lines:
over a few octaves a delay and whatever lies above them look like that. Several of these models fit; what they disagree
about is not known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.kernels.loops.margins import LARGE
from loopshape.core.remembered import remembered
from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.response.frf import FRF
from loopshape.identify.spectra.averages import pooled_variance
from loopshape.loop.loop import Loop
from loopshape.loop.tolerances import TOL

#: models may carry the loop this far below its first line, as a ratio of frequencies
EXTRAPOLATED_BELOW = 1.3
#: below this |L| is far from 1, whichever model says so
SMALL = 0.1
#: where L is read below its first line, as shares of its frequency: the first stands for 0 Hz
BELOW_RATIOS = np.concatenate([[1e-6], np.geomspace(0.01, 1.0, 24, endpoint=False)])


def poles_at_0(loop: Loop) -> int:
    """Poles of L at s = 0, less its zeros there."""
    return (loop.integrators or 0) + loop.controller.integrators()


def in_sight(loop: Loop) -> bool:
    """Whether the lines show where |L| falls through 1 for the first time, or tell that it does not do so below them.

    They do where |L| starts at 1 or above and does not fall towards 0 Hz. Else all small models of the lowest lines,
    one of them simple unless L falls to 0 Hz and stays `SMALL`, must have it reach 1 at most a third of an octave
    lower, or stay below 1 down to 0 Hz in a loop without integrators.
    """
    if abs(loop.L[0]) >= 1.0 and slope_of(loop) > -TOL.integrators_agree:
        return True
    below = [np.abs(L) for L in below_lines(loop, low_hz(loop))]
    largest = max((x.max() for x in below), default=np.inf)
    falls = poles_at_0(loop) < 0 and largest < SMALL
    if not falls and not any(is_simple(model) for model in low_models(loop)):
        return False
    if poles_at_0(loop) <= 0 and largest < 1.0:
        return True
    octave = low_hz(loop) >= float(loop.frequency_hz[0]) / EXTRAPOLATED_BELOW
    return all(x[octave].max() >= 1.0 for x in below)


def below_lines(loop: Loop, f: Array) -> list[ComplexArray]:
    """L (n,) at frequencies f (n,) in Hz below the first line, by each small model of the lowest lines."""
    C = loop.controller.response(f)
    return [C * model.response(f) for model in low_models(loop)]


def low_models(loop: Loop) -> tuple[LowModel, ...]:
    """Small models of the lowest lines, which say how the plant goes on below them."""
    if loop.integrators is None:
        return ()
    return low_frequency_models(loop.measured, loop.integrators)


def low_hz(loop: Loop) -> Array:
    """Three decades of frequencies below the first line."""
    first = float(loop.frequency_hz[0])
    return np.geomspace(1e-3 * first, first, 60, endpoint=False)


def is_large(loop: Loop) -> bool:
    """Whether L starts so large, and does not fall towards 0 Hz, that nothing below its first line comes near -1."""
    return abs(loop.L[0]) >= LARGE and poles_at_0(loop) >= 0 and slope_of(loop) > -TOL.integrators_agree


@remembered
def slope_of(loop: Loop) -> float:
    """-slope/20 dB a decade of L over the lowest lines of a loop."""
    lines = loop.measured
    return low_order(
        replace(lines, response=lines.response * loop.controller.response(lines.frequency_hz)[:, None, None])
    )[1]


def is_told(loop: Loop) -> bool:
    """Whether the lowest lines tell how L goes on below them.

    Models do, simple ones where the plant has unstable poles, and on a stable plant so does a large L; else slope and
    phase must agree with each other there, and L not fall towards 0 Hz.
    """
    models = low_models(loop)
    if loop.unstable_poles and loop.model is None:  # below the lines they may turn L once more about 0
        return any(is_simple(model) for model in models)
    if loop.model is not None or any(model.knows_sign for model in models):
        return True
    lines = loop.measured
    phase, slope = order_of(loop)
    if slope < (loop.integrators or 0) - room_of(lines):  # a zero below, on either side: the sign at 0 is open
        return False
    if is_large(loop) and abs(phase - slope) < 1.0:  # no pair of poles lies below that the phase does not show
        return True
    return (
        loop.unstable_poles == 0
        and poles_at_0(loop) >= 0
        and abs(phase - slope) < room_of(lines)
        and slope_of(loop) > -TOL.integrators_agree
    )


def holds_below(loop: Loop, poles: int) -> bool:
    """Whether a count of `poles` has the right outcome where `is_told` leaves open how L goes on below its lines.

    A large L that falls as its declared integrators do has as many zeros as other poles below them, and an even number
    of those are unstable, or its phase were turned over. Each leaves one unstable closed-loop pole less to the lines
    than was counted (Nyquist 1932), which changes the outcome where none is left, and is impossible below none.
    """
    as_declared = is_large(loop) and round(low_order(loop.measured)[1]) == (loop.integrators or 0)
    return as_declared and (poles == 0 or poles % 2 == 1 or poles > (loop.unstable_poles or 0))


def is_simple(model: LowModel) -> bool:
    """Whether a model has few enough parameters to tell where unstable poles lie."""
    # so many parameters at most has a model that tells where unstable poles lie, or a crossover below the lines
    simple = 4
    return model.num.size + model.den.size - 1 <= simple


def low_order(lines: FRF) -> tuple[float, float]:
    """-phase/90 deg and -slope/20 dB a decade over the lowest lines (a factor of 1.6 in frequency, four at least)."""
    f, lowest = lines.frequency_hz, lines.siso[: lowest_count(lines.frequency_hz)]
    phase = float(deg(np.angle(np.mean(lowest / np.abs(lowest)))))
    slope = np.polyfit(np.log(f[: lowest.size]), np.log(np.abs(lowest)), 1)[0] if lowest.size > 1 else 0.0
    return -phase / 90.0 + (4.0 if phase > 45.0 else 0.0), float(-slope)


def lowest_count(f: Array) -> int:
    """How many lines f (nf,) in Hz tell the slope at the low end: up to 1.6 times the first, four at least."""
    return min(max(4, int(np.searchsorted(f, 1.6 * f[0]))), f.size)


def feeds_back_positively(loop: Loop) -> bool:
    """Whether L goes to -k/s^n towards 0 Hz, n above 0: on a stable plant one closed-loop pole is real and positive.

    For s > 0 the real 1 + L(s) goes from below 0, near s = 0, to 1. The lines must show it with |L| above 1, so that
    a pair of a zero and a pole below them that turns the sign once more leaves the loop unstable too.
    """
    if loop.unstable_poles != 0 or loop.model is not None or poles_at_0(loop) < 1 or abs(loop.L[0]) < 1.0:
        return False
    return sign_at_0(loop) * (-1 if is_negative(loop) else 1) < 0


@remembered
def is_negative(loop: Loop) -> bool:
    """Whether the controller goes as -k/s^n towards 0 Hz."""
    lowest = loop.controller.response(low_hz(loop)[:1]) * 1j ** loop.controller.integrators()
    return bool(lowest[0].real < 0.0)


def order_of(loop: Loop) -> tuple[float, float]:
    """`low_order` of the plant, its sign turned where the controller's is: what counts is that of both together."""
    phase, slope = low_order(loop.measured)
    return (phase - 1.5) % 4.0 - 0.5 if is_negative(loop) else phase, slope


def sign_at_0(loop: Loop) -> int:
    """Sign of k, as P goes as k/s^n towards 0 Hz: by models of the lowest lines, or phase and slope; 0: not told."""
    if models := low_models(loop):
        signs = {int(np.sign(model.num[0])) if model.knows_sign else 0 for model in models}
        return signs.pop() if len(signs) == 1 else 0
    phase, slope = low_order(loop.measured)
    apart, agree = (phase - slope) % 4.0, TOL.integrators_agree
    if abs(slope - (loop.integrators or 0)) > agree:
        return 0
    return -1 if abs(apart - 2.0) < agree else int(min(apart, 4.0 - apart) < agree)


def room_of(lines: FRF) -> float:
    """How far slope and phase of the lowest lines may differ and still agree, by the scatter of the lines; below 1.

    One more pole below the lines, which the phase does not show, would separate them by 1.
    """
    count = lowest_count(lines.frequency_hz)
    x = np.log(lines.frequency_hz[:count])
    if x.size < 4:
        return TOL.integrators_agree
    relative = np.sqrt(lines.variance[:count, 0, 0]) / np.maximum(np.abs(lines.siso[:count]), 1e-300)
    std = np.median(relative) / (2.0 * x.std())  # neighbours are smoothed together: four of them are independent
    return float(min(TOL.integrators_agree + 2.0 * std, TOL.integrators_agree_most))


def crossover_below(loop: Loop) -> tuple[float, float]:
    """The band in Hz below the first line where L, continued along its integrators, reaches 1 and twice that."""
    first, slope = loop.frequency_hz[0], max((loop.integrators or 0) + loop.controller.integrators(), 1)
    return float(first * (0.5 * min(abs(loop.L[0]), 1.0)) ** (1.0 / slope)), float(first)


#: models follow the lines up to so many times the first, but this many at least and at most
_FARTHEST, _FEWEST, _MOST = 4.0, 8, 60
#: lines that are known worse than this say nothing of what lies below them, and so do models known worse at s = 0
_KNOWN = 0.3
#: B(0) is at most so many times what the first line shows, and no less than its inverse: else k is another number
_AWAY = 5.0
#: where B(0) is less than so many times that a zero lies below, and what so small a model rounds off tells its side
_ZERO_BELOW = 0.5


@dataclass(frozen=True, eq=False)
class LowModel:
    """B(s)/(A(s) s^k) in s = j f/f1; `influence` (parameters, 2 n) turns errors of n lines into those of B and A.

    Errors are real parts, then imaginary ones, of the first n lines as `lines` says.
    """

    first_hz: float
    integrators: int
    num: Array
    den: Array
    influence: Array
    lines: int

    @property
    def knows_sign(self) -> bool:
        """Whether no zero between 0 Hz and the first line makes the sign at 0 Hz a matter of its side."""
        return bool(abs(self.num[0]) > _ZERO_BELOW * abs(_rational(np.array([1j]), self.num, self.den)[0]))

    def response(self, f: Array) -> ComplexArray:
        """P (n,) at frequencies f (n,) in Hz above zero."""
        s = 1j * np.asarray(f, dtype=float) / self.first_hz
        return np.asarray(_rational(s, self.num, self.den) * s**-self.integrators)

    def deviations(self, f: Array, errors: ComplexArray) -> ComplexArray:
        """What errors (draws, nf) of the lines do to P at f (n,): (draws, n)."""
        own = errors[:, : self.lines]
        return np.asarray((np.concatenate([own.real, own.imag], axis=1) @ self.influence.T) @ self.slopes(f).T)

    def slopes(self, f: Array) -> ComplexArray:
        """d P at f (n,) in Hz by each coefficient, (n, parameters)."""
        s = 1j * np.asarray(f, dtype=float) / self.first_hz
        return np.asarray(_slopes(s, self.num, self.den) * (s**-self.integrators)[:, None])


@remembered
def low_frequency_models(frf: FRF, integrators: int) -> tuple[LowModel, ...]:
    """Models that follow the lowest lines of a 1 x 1 FRF, the likeliest first; none where none tells P at s = 0.

    `integrators` is the declared number of poles at s = 0, negative for zeros there. Give frequencies as measured. A
    plant with a resonance below its first line misleads, unless the lines show it.
    """
    f = frf.frequency_hz
    count = int(np.clip(np.searchsorted(f, _FARTHEST * f[0], side="right"), min(_FEWEST, f.size), _MOST))
    own, y = f[:count], frf.siso[:count]
    floor = 3e-4  # lines err by this share of |P| at least: what so small a model rounds off
    std = np.sqrt(pooled_variance(frf)[:count] + (floor * np.abs(y)) ** 2 + 1e-300)
    if own.size < _FEWEST or np.median(std / np.abs(y)) > _KNOWN:
        return ()
    s = 1j * own / own[0]
    tilt = s**integrators
    return _models(own[0], s, y * tilt, std * np.abs(tilt), tilt, integrators)


def _models(
    first_hz: float, s: ComplexArray, y: ComplexArray, std: Array, tilt: ComplexArray, integrators: int
) -> tuple[LowModel, ...]:
    found: list[tuple[float, LowModel]] = []
    least = np.inf
    more = 2  # parameters that models may have beyond the least and are still kept
    # orders of B and A, in the order of their number of parameters
    orders = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (2, 1), (1, 2), (2, 2), (3, 2))
    for nb, na in orders:
        parameters = nb + 1 + na
        if parameters > least + more or 2 * s.size < 2 * parameters + 4:
            continue
        if (fitted := _fitted(s, y, std, nb, na)) is None:
            continue
        num, den = fitted
        left = np.sum(np.abs((y - _rational(s, num, den)) / std) ** 2)
        freedom = 2 * s.size - parameters
        if 2.0 * left > freedom + 4.0 * np.sqrt(2.0 * freedom):
            continue
        least = min(least, parameters)
        jacobian = _slopes(s, num, den) / std[:, None]
        solved = np.linalg.pinv(np.concatenate([jacobian.real, jacobian.imag]), rcond=1e-10)
        scale = np.concatenate([1.0 / std, 1.0 / std])
        if _is_known(solved, num, den) and 1.0 / _AWAY < abs(num[0] / _rational(s[:1], num, den)[0]) < _AWAY:
            # errors come as those of P, in real and imaginary parts: turned by the tilt of s^k first
            turned = _turned(solved * scale, tilt)
            akaike = 2.0 * float(left) + 2.0 * parameters
            found.append((akaike, LowModel(float(first_hz), integrators, num, den, turned, s.size)))
    return tuple(model for _, model in sorted(found, key=lambda x: x[0]))


def _turned(influence: Array, tilt: ComplexArray) -> Array:
    n = tilt.size
    re, im = influence[:, :n], influence[:, n:]
    return np.concatenate([re * tilt.real + im * tilt.imag, im * tilt.real - re * tilt.imag], axis=1)


def _is_known(solved: Array, num: Array, den: Array) -> bool:
    """Whether B(0) is known, and A has no sharp resonance below the first line."""
    known = np.sqrt(0.5 * np.sum(solved[0] ** 2)) < _KNOWN * abs(num[0])
    size = np.abs(_polynomial(np.asarray(1j * np.linspace(0.0, 1.0, 65)), den))
    sharp = 0.3  # A may come this near 0 below the first line, as a share of its smaller end: no unseen resonance
    return bool(known and size.min() > sharp * min(size[0], size[-1]))


def _fitted(s: ComplexArray, y: ComplexArray, std: Array, nb: int, na: int) -> tuple[Array, Array] | None:
    """B and A, coefficients rising, by linear least squares weighted anew (Sanathanan and Koerner 1963).

    None where a pole comes to lie on a line, as of a plant without poles and noise.
    """
    den = np.eye(1, na + 1)[0]
    powers = s[:, None] ** np.arange(max(nb, na) + 1)
    rounds = 6  # rounds of Sanathanan and Koerner's weighting
    for _ in range(rounds if na else 1):
        with np.errstate(divide="ignore", over="ignore"):
            weight = 1.0 / (std * np.abs(_polynomial(s, den)))
        if not np.isfinite(weight).all():
            return None
        columns = np.concatenate([powers[:, : nb + 1], -y[:, None] * powers[:, 1 : na + 1]], axis=1) * weight[:, None]
        target = y * weight
        solved = np.linalg.lstsq(
            np.concatenate([columns.real, columns.imag]), np.concatenate([target.real, target.imag]), rcond=None
        )[0]
        num, den = solved[: nb + 1], np.concatenate([[1.0], solved[nb + 1 :]])
    return num, den


def _polynomial(s: ComplexArray, rising: Array) -> ComplexArray:
    return np.asarray(np.polyval(rising[::-1], s))


def _rational(s: ComplexArray, num: Array, den: Array) -> ComplexArray:
    return np.asarray(_polynomial(s, num) / _polynomial(s, den))


def _slopes(s: ComplexArray, num: Array, den: Array) -> ComplexArray:
    """d(B/A) by the coefficients of B and of A but its first, (n, parameters)."""
    A = _polynomial(s, den)
    powers = s[:, None] ** np.arange(max(num.size, den.size))
    by_num = powers[:, : num.size] / A[:, None]
    by_den = -powers[:, 1 : den.size] * (_polynomial(s, num) / A**2)[:, None]
    return np.concatenate([by_num, by_den], axis=1)
