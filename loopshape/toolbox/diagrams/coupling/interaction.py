"""From a matrix FRF to how its loops meet: rows and columns, k_I of each pair, verdicts by band, and all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
from scipy.special import ndtri

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, db, deg, from_db
from loopshape.data.algebra.propagation import invert, pick
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF
from loopshape.identify.matrix.equivalent_plant import spread, square_part, with_slopes
from loopshape.toolbox.diagrams.coupling.bounds import TAIL, Reach, magnitude_bounds, product_bounds
from loopshape.toolbox.diagrams.coupling.nouns import (
    BandVerdict,
    Coefficient,
    Coupling,
    EquivalentPlant,
    Interaction,
    RelativeGain,
)


def interaction(
    P: FRF,
    loops: Sequence[str] | None = None,
    controllers: Mapping[str, Controller] | None = None,
    *,
    outputs: Sequence[str] | None = None,
    limit_db: float = -20.0,
    bands: Sequence[tuple[float, float]] | None = None,
) -> Interaction:
    """Coupling between the loops of a matrix FRF, frequency by frequency, with 95 % bounds.

    Interaction coefficients, relative gains (Bristol, IEEE Trans. Automatic Control 11(1), 1966) and the plant that a
    loop meets with the others closed, by `controllers` where those are known, by loop. `outputs` are the loops' rows
    where names do not tell. Each of the `bands` in Hz (octaves by default) is judged against `limit_db` (-20 dB: H.7 of
    van den Brink, DCT 2007.002), each pair and band by itself: of twenty that lie on the limit, one may be judged
    wrong. Raises WrongUseError for an FRF of a single loop.
    """
    if not np.isfinite(limit_db):
        raise WrongUseError("a limit of the interaction is a number of dB", f"{limit_db!r}", "use -20, the source's")
    square, names = square_part(P, loops, outputs)
    known = controllers or {}
    stray = sorted(set(known) - set(P.loop.split("+")) - set(names))
    if stray:
        raise WrongUseError(
            "a controller is of no loop of this FRF", ", ".join(stray), f"name them by loop: {', '.join(names)}"
        )
    square.valid_lines()  # refuses an FRF without any
    pairs = list(combinations(range(len(names)), 2))
    chosen = tuple(bands) if bands is not None else octaves(square)
    return Interaction(
        frf=square,
        loops=names,
        limit_db=float(limit_db),
        coefficients=tuple(interaction_coefficient(square, i, j, (names[i], names[j])) for i, j in pairs),
        relative_gain=relative_gain(square),
        equivalents=tuple(
            closing_the_others(square, names, name, known) for name in names if set(names) - {name} <= set(known)
        ),
        verdicts=tuple(
            verdict
            for i, j in pairs
            for verdict in _band_verdicts(_LoopPair(square, i, j), (names[i], names[j]), float(limit_db), chosen)
        ),
    )


def interaction_coefficient(frf: FRF, i: int, j: int, loops: tuple[str, str]) -> Coefficient:
    """k_I of loops i and j of a square FRF, with bounds of |k_I| that hold at any ratio of signal to noise.

    k_I is as fragile as its four factors together: with independent errors of 4 % (sqrt(E|d|²)) in each, k_I has 8 %,
    its magnitude 5.7 %, and the 95 % interval of that is 11 % to each side; 16 % if all four err the worst way.
    """
    pair = _LoopPair(frf, i, j)
    low, high = pair.bounds(np.arange(frf.frequency_hz.size))
    return Coefficient(loops, frf.frequency_hz, pair.coefficient, pair.relative_std, low, high, frf.valid)


def relative_gain(frf: FRF) -> RelativeGain:
    """RGA = H .* inv(H)^T of a square FRF; refuses others, and one that is singular at a line.

    With G = inv(H), dG = -G dH G, so d RGA_ij = G_ji dH_ij - H_ij sum over k, l of G_jk dH_kl G_li.
    Source: Bristol, IEEE Trans. Automatic Control 11, 1966; dynamic as in Skogestad and Postlethwaite, 3.4.
    """
    if len(frf.inputs) != len(frf.outputs):
        raise WrongUseError(
            "relative gains are those of a square FRF", f"{len(frf.outputs)} x {len(frf.inputs)}", "pick channels"
        )
    H = frf.response
    G = invert(H, frf.frequency_hz, "an FRF")
    gain = H * G.transpose(0, 2, 1)
    std = np.stack([_deviation(h, g, c) for h, g, c in zip(H, G, frf.covariance, strict=True)])
    return RelativeGain(frf.outputs, frf.inputs, frf.frequency_hz, gain, std, frf.valid)


def _deviation(H: ComplexArray, G: ComplexArray, C: ComplexArray) -> Array:
    """sqrt(E|d RGA|²) (n, n) at one line, from the covariance C of vec(H), columns stacked."""
    n = H.shape[0]
    slope = -np.einsum("ij,jk,li->ijlk", H, G, G)  # by element i, j and by dH_kl, l slowest as in vec
    i, j = np.indices((n, n))
    slope[i, j, j, i] += G.T
    J = slope.reshape(n * n, n * n)
    variance = np.real(np.einsum("ab,bc,ac->a", J, C, J.conj(), optimize=True))
    return np.sqrt(np.maximum(variance, 0.0)).reshape(n, n)


def closing_the_others(
    frf: FRF, names: Sequence[str], loop: str, controllers: Mapping[str, Controller]
) -> EquivalentPlant:
    """What a loop's controller meets with all others closed, over the plant with them open.

    Both err by the same dP, so their relative errors are taken off each other first.
    """
    closed, slope = with_slopes(frf, names, loop, controllers)
    i = list(names).index(loop)
    own = replace(pick(frf, [i], [i]), loop=loop)
    by_own = np.zeros_like(slope)
    by_own[:, i * len(frf.outputs) + i] = 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = closed.siso / own.siso
        # d(closed/open) = (d closed - ratio d open)/open: finite where the closed plant is zero
        deviation = np.sqrt(spread((slope - ratio[:, None] * by_own) / own.siso[:, None], frf.covariance))
        relative = deviation / np.abs(ratio)
    low, high = magnitude_bounds(np.abs(ratio), deviation, frf.variance_freedom)
    half_width = np.minimum(high / np.abs(ratio) - 1.0, 1.0)
    half_width_deg = np.where((low > 0.0) & (half_width < 1.0), deg(np.arcsin(half_width)), 180.0)
    others = tuple(name for name in names if name != loop)
    return EquivalentPlant(loop, others, own, closed, ratio, relative, low, high, half_width_deg)


_Bands = Sequence[tuple[float, float]]

#: ratio of frequencies over which no valid frequency leaves a hole in a band
_HOLE = 1.1
_MORE = np.geomspace(1.1, 1000.0, 40)  # times the averages that are tried


def octaves(frf: FRF) -> tuple[tuple[float, float], ...]:
    """Octaves between whole powers of two Hz, cut to the valid band; refuses an FRF without one."""
    low, high = frf.valid_lines().valid_band_hz
    whole = 2.0 ** np.arange(np.floor(np.log2(low)) + 1.0, np.ceil(np.log2(high)))
    edges = [low, *whole[(whole > low) & (whole < high)].tolist(), high]
    return tuple(pairwise(edges))


def _band_verdicts(pair: _LoopPair, loops: tuple[str, str], limit_db: float, bands: _Bands) -> tuple[BandVerdict, ...]:
    """A verdict on each closed band in Hz; refuses bands that do not rise.

    decoupled: every valid frequency's upper 95 % bound is below the limit. That all must pass makes the test stricter,
    not looser, so no correction is needed. coupled: some line's lower bound is above it, with the probability 2.5 %
    beyond it shared by all n lines, 1 - 0.975^(1/n) each (Sidak): chance alone then finds one in 2.5 % of bands.
    n is not divided by `line_overlap`: the largest of n errors that overlap by two lines is hardly smaller than of n
    that do not, and dividing would find couplings that are none.
    """
    for low, high in bands:
        if not 0.0 <= low < high:
            raise WrongUseError("a band has two rising frequencies in Hz", f"{low:g} to {high:g}", "write 0.5-4")
    return tuple(_verdict(pair, loops, limit_db, (float(low), float(high))) for low, high in bands)


def _verdict(pair: _LoopPair, loops: tuple[str, str], limit_db: float, band: tuple[float, float]) -> BandVerdict:
    f = pair.frequency_hz
    lines = np.flatnonzero(pair.valid & (f >= band[0]) & (f <= band[1]))
    if not lines.size:
        return BandVerdict(loops, band, Coupling.UNDECIDED, limit_db, 0, averages_factor=float("inf"), hole_hz=band)
    limit = float(from_db(limit_db))
    hole = _hole(pair, lines, band)
    word, coupled = _word(pair, lines, limit, 1.0)
    if word is Coupling.DECOUPLED and hole is not None:
        word = Coupling.UNDECIDED
    low, high = pair.bounds(lines)
    if word is Coupling.COUPLED:
        low = pair.bounds(lines, _shared_tail(lines.size)).low
    k = int(np.argmax(low if word is Coupling.COUPLED else high))
    factor = _more_averages(pair, lines, limit) if word is Coupling.UNDECIDED and hole is None else 1.0
    return BandVerdict(
        loops, band, word, limit_db, int(lines.size), float(f[lines[k]]), float(db(low[k])),
        float(db(pair.coefficient[lines[k]])), float(db(high[k])), tuple(f[lines[coupled]].tolist()), hole, factor,
    )  # fmt: skip


def _shared_tail(lines: int) -> float:
    return float(-np.expm1(np.log1p(-TAIL) / lines))


def _word(pair: _LoopPair, lines: np.ndarray, limit: float, more: float) -> tuple[Coupling, np.ndarray]:
    """Verdict on some lines, and which of them are coupled, of so many times the averages."""
    if np.all(_expected(pair, lines, TAIL, more).high < limit):
        return Coupling.DECOUPLED, np.zeros(lines.size, dtype=bool)
    coupled = _expected(pair, lines, _shared_tail(lines.size), more).low > limit
    return (Coupling.COUPLED if coupled.any() else Coupling.UNDECIDED), coupled


def _expected(pair: _LoopPair, lines: np.ndarray, tail: float, more: float) -> Reach:
    """Ends of |k_I|; of more averages those to be expected if the plant is as estimated, less luck.

    The largest of n estimates is too high by what the largest of n errors is in the median; averages take that away.
    """
    bounds = pair.bounds(lines, tail, more)
    luck = ndtri(0.5 ** (1.0 / max(lines.size / pair.line_overlap, 1.0)))
    spread = np.minimum(pair.relative_std[lines] / np.sqrt(2.0), 1.0)
    factor = np.exp(-luck * spread * (1.0 - 1.0 / np.sqrt(more)))
    return Reach(bounds.low * factor, bounds.high * factor)


def _more_averages(pair: _LoopPair, lines: np.ndarray, limit: float) -> float:
    """By how much the averages must grow to decide, roughly; infinite beyond a thousand."""
    for more in _MORE:
        if _word(pair, lines, limit, float(more))[0] != "undecided":
            return float(more)
    return float("inf")


def _hole(pair: _LoopPair, lines: np.ndarray, band: tuple[float, float]) -> tuple[float, float] | None:
    """Widest stretch (by ratio) of a band that valid frequencies leave out; None where neighbours follow each other."""
    f, last = pair.frequency_hz, pair.frequency_hz.size - 1
    gaps = [(float(f[a]), float(f[b])) for a, b in pairwise(lines) if b > a + 1]
    first, end = int(lines[0]), int(lines[-1])
    if first == 0 or f[first - 1] >= band[0]:
        gaps.append((band[0], float(f[first])))
    if end == last or f[end + 1] <= band[1]:
        gaps.append((float(f[end]), band[1]))
    wide = [gap for gap in gaps if gap[1] > _HOLE * gap[0]]
    return max(wide, key=lambda gap: gap[1] / max(gap[0], 1e-12)) if wide else None


#: exponents of H12, H21, H11, H22 in k_I
_EXPONENTS = np.array([1.0, 1.0, -1.0, -1.0])


class _LoopPair:
    """The four elements of two loops: H12, H21, H11, H22 (nf, 4) and their covariance (nf, 4, 4)."""

    def __init__(self, frf: FRF, i: int, j: int) -> None:
        n = len(frf.outputs)
        places = np.array([j * n + i, i * n + j, i * n + i, j * n + j])
        vec = frf.response.transpose(0, 2, 1).reshape(len(frf.frequency_hz), -1)
        self.elements: ComplexArray = vec[:, places]
        self.covariance: ComplexArray = frf.covariance[:, places][:, :, places]
        self.freedom = frf.variance_freedom
        self.frequency_hz: Array = frf.frequency_hz
        self.line_overlap = frf.line_overlap
        self.valid: np.ndarray = frf.valid

    @property
    def coefficient(self) -> ComplexArray:
        """k_I (nf,); infinite where H11 or H22 is zero, nan where 0/0."""
        H = self.elements
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(H[:, 0] * H[:, 1] / (H[:, 2] * H[:, 3]))

    @property
    def relative_std(self) -> Array:
        """sqrt(E|dk/k|²) (nf,) of dk/k = d12/H12 + d21/H21 - d11/H11 - d22/H22, with all cross-covariances."""
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = _EXPONENTS / self.elements
            variance = np.real(np.einsum("fi,fij,fj->f", slope, self.covariance, slope.conj()))
        return np.sqrt(np.maximum(np.where(np.isnan(variance), np.inf, variance), 0.0))

    def bounds(self, lines: np.ndarray, tail: float = TAIL, more: float = 1.0) -> Reach:
        """Ends of |k_I| on some lines; with `more` than 1 those to be expected of that many times the averages."""
        H, C = self.elements[lines], self.covariance[lines]
        if more == 1.0:
            return product_bounds(H, C, _EXPONENTS, self.freedom, tail)
        power, noise = np.abs(H) ** 2, np.real(np.einsum("fii->fi", C))
        size = np.sqrt(np.maximum(power - noise, 0.0) + noise / more)
        with np.errstate(invalid="ignore", divide="ignore"):
            shrunk = H * np.where(power > 0.0, size / np.sqrt(power), 0.0)
        shrunk = np.where(power > 0.0, shrunk, size)
        return product_bounds(shrunk, C / more, _EXPONENTS, self.freedom * more, tail)
