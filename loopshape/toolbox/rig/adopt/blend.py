"""A share of one controller and the rest of another, side by side on one error, as a single controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial as poly

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.block import Block
from loopshape.data.control.controller import Controller

#: a zero whose imaginary part is below this share of its size is real
REAL = 1e-9
#: a coefficient below this share of the largest is rounding; a sum is exact to this
ROUNDED, EXACT = 1e-14, 1e-6


def blended(old: Controller, new: Controller, share: float) -> Controller:
    """(1 - share) old + share new as one controller: with shares of 0 and 1 these themselves.

    Tustin's rule is one substitution for s, so the sum of both as they run is the sum of their blocks. Poles stay those
    of both, integrators that both have are one. Refuses a share outside 0 to 1, controllers of two rates, and
    prewarped, rounded or delayed ones, which do not add up so.

    >>> import loopshape as ls
    >>> slow, fast = (ls.controller(ls.gain(k), ls.pi(f), rate_hz=1000.0) for k, f in ((1.0, 1.0), (3.0, 2.0)))
    >>> half = blended(slow, fast, 0.5).response([10.0])
    >>> bool(abs(half - 0.5 * (slow.response([10.0]) + fast.response([10.0])))[0] < 1e-12)
    True
    """
    if not 0.0 <= share <= 1.0:
        raise WrongUseError("a share of the new controller lies between 0 and 1", f"{share!r}")
    for one in (old, new):
        if one.rate_hz != old.rate_hz or one.prewarp_hz or one.computation_delay_s or one.added_hold:
            raise WrongUseError(
                "controllers side by side have one rate and plain Tustin sections, without prewarping, delay or hold",
                f"{one!r}", "write them so",
            )  # fmt: skip
        if one.precision != "double":
            raise WrongUseError("controllers side by side run in double precision", one.precision, "leave it out")
    if share in (0.0, 1.0):
        return new if share else old
    scale = _scale((*old.blocks, *new.blocks))
    first, second = (_Parts.of(one.blocks, scale) for one in (old, new))
    integrators = max(first.integrators, second.integrators)
    tops = [
        weight * mine.gain * _expanded([*mine.zeros, *other.poles, *[0.0] * (integrators - mine.integrators)])
        for weight, mine, other in ((1.0 - share, first, second), (share, second, first))
    ]
    total = np.asarray(poly.polyadd(*tops), dtype=float)
    if not total.any():
        raise WrongUseError(
            f"both controllers of loop {new.loop!r} cancel each other",
            f"at a share of {share:g}",
            "choose other shares",
        )
    kept = np.flatnonzero(np.abs(total) > ROUNDED * np.abs(total).max())
    zeros = _tidy(np.roots(total[: kept[-1] + 1][::-1]).astype(complex))
    poles = np.concatenate([np.zeros(integrators), first.poles, second.poles])
    gain = Block("gain", {"gain": float(total[kept[-1]])})
    made = Controller(new.loop, (gain, *_sections(zeros, poles, scale)), new.rate_hz)
    _refuse_inexact(made, old, new, share)
    return made


def track_share(new: Controller, rate_hz: float, within_s: float) -> float:
    """How fast, a tick, a shift follows the difference of both outputs; 0 where the new one does not integrate."""
    return 0.0 if new.integrators() < 1 else float(1.0 - np.exp(-1.0 / (within_s * rate_hz)))


@dataclass(frozen=True)
class _Parts:
    """A controller in s/scale: its gain over monic factors, zeros, poles, and how often it integrates beside them."""

    gain: float
    zeros: ComplexArray
    poles: ComplexArray
    integrators: int

    @classmethod
    def of(cls, blocks: Sequence[Block], scale: float) -> _Parts:
        gain, roots = 1.0, (list[ComplexArray](), list[ComplexArray]())
        for block in blocks:
            for sign, place, p in zip((1, -1), roots, block.section(), strict=True):
                raised = np.trim_zeros(np.array(p) * scale ** np.arange(3.0), "b")
                gain *= float(raised[-1]) ** sign
                place.append(np.roots(raised[::-1]).astype(complex))
        zeros, poles = (_tidy(np.concatenate(place)) for place in roots)
        return cls(gain, zeros, poles[poles != 0.0], int(np.count_nonzero(poles == 0.0)))


def _expanded(roots: Sequence[complex]) -> Array:
    """Coefficients, lowest first, of the polynomial with these zeros and a highest coefficient of 1."""
    return np.asarray(np.real(poly.polyfromroots(roots)) if len(roots) else np.ones(1))


def _scale(blocks: Sequence[Block]) -> float:
    """A frequency in rad/s in the middle of all poles and zeros: powers of it keep their digits."""
    sizes = [np.abs(np.roots(np.trim_zeros(p, "b")[::-1])) for block in blocks for p in block.section() if any(p)]
    found = np.concatenate([np.zeros(0), *sizes])
    found = found[found > 0.0]
    return float(np.exp(np.mean(np.log(found)))) if found.size else 1.0


def _tidy(roots: ComplexArray) -> ComplexArray:
    """Nearly real ones real."""
    return np.where(np.abs(roots.imag) < REAL * np.abs(roots), roots.real, roots).astype(complex)


def _refuse_inexact(made: Controller, old: Controller, new: Controller, share: float) -> None:
    f = np.geomspace(1e-5, 0.45, 200) * made.rate_hz
    wanted = (1.0 - share) * old.response(f) + share * new.response(f)
    scale = (1.0 - share) * np.abs(old.response(f)) + share * np.abs(new.response(f))
    off = float(np.max(np.abs(made.response(f) - wanted) / scale))
    if off > EXACT:
        raise WrongUseError(
            f"the sum of both controllers of loop {made.loop!r} is not exact in double precision", f"off by {off:.2g}",
            "take two controllers with fewer blocks, or without corners decades apart",
        )  # fmt: skip


def _quadratics(roots: ComplexArray) -> list[tuple[float, ...]]:
    """Monic factors of degree 2, each real, by rising size; one of degree 1 last where the number is odd."""
    pairs = [(abs(z) ** 2, -2.0 * z.real, 1.0) for z in roots if z.imag > 0.0]
    real = sorted((z.real for z in roots if z.imag == 0.0), key=abs)
    alone = [real.pop()] if len(real) % 2 else []
    pairs += [(a * b, -(a + b), 1.0) for a, b in zip(real[::2], real[1::2], strict=True)]
    return [*sorted(pairs, key=lambda p: p[0]), *((-a, 1.0, 0.0) for a in alone)]


def _sections(zeros: ComplexArray, poles: ComplexArray, scale: float) -> list[Block]:
    """Blocks of these zeros and poles in s/scale: each factor of the numerator over one of the denominator."""
    above, below = _quadratics(zeros), _quadratics(poles)
    alone = [above.pop()] if above and above[-1][2] == 0.0 else []
    above += [(1.0, 0.0, 0.0)] * (len(below) - len(above) - len(alone)) + alone
    out = []
    for top, bottom in zip(above, below, strict=True):
        n = [c / scale**k for k, c in enumerate(top)]
        d = [c / scale**k for k, c in enumerate(bottom)]
        out.append(Block("section", dict(zip(("n0", "n1", "n2", "d0", "d1", "d2"), (*n, *d), strict=True))))
    return out
