"""FRF -> Fit: a low-order model on the valid lines, with intervals and a residual test."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtr

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.outcomes import Convergence
from loopshape.core.units import SUFFIXES, TWO_PI, Array, ComplexArray, angular, db
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Estimate, Fit
from loopshape.data.signal.channel import unit_of
from loopshape.identify.structures import Integrator, Rational, Structure, ThirdOrder
from loopshape.identify.tolerances import TOL

STRUCTURES = ("third_order", "third_order_delay", "integrator", "integrator_delay", "rational", "auto")
WEIGHTINGS = ("variance", "relative")
#: what a rational structure is asked for
ORDERS = ("numerator", "denominator", "integrators", "delay")


def structure_by_name(
    name: str, *, numerator: int = 0, denominator: int = 1, integrators: int = 0, delay: bool = False
) -> Structure:
    """A structure from its word; the orders are for `rational` only."""
    refuse_unknown("a structure is not known", name, [one for one in STRUCTURES if one != "auto"], "use one of")
    if name in ("third_order", "third_order_delay"):
        return ThirdOrder(delay or name.endswith("_delay"))
    if name in ("integrator", "integrator_delay"):
        return Integrator(delay or name.endswith("_delay"))
    return Rational(numerator, denominator, integrators, delay)


def fit(
    frf: FRF,
    structure: Structure,
    *,
    weighting: str = "variance",
    band_hz: tuple[float, float] | None = None,
    stable: bool | None = None,
    hopeless: float = np.inf,
    lenient: bool = False,
) -> Fit:
    """Fit a structure to the valid lines of a 1 x 1 FRF, or to those in `band_hz`.

    With `stable` the poles of a rational structure, those at zero apart, lie in the left half plane. None asks for it
    of an FRF that was recorded in open loop, where an unstable plant would not have stayed within its range, and,
    unless `lenient`, where stable poles do as well: those above the lines stand for a hold, a delay or modes, and a
    pole beside a zero for noise.

    `variance` weights each line by its own variance: parameters of least spread if the structure is right.
    `relative` weights by 1/|G|: a fair compromise over the band where no low-order model is right; then the
    residual test still compares with the variance. Sources: Pintelon and Schoukens (2012), chapters 8, 9.

    A start of a rational structure that `PATIENCE` evaluations leave above the sum of squares `hopeless` is given up;
    raises `TooFarError` where all of them are.

    Misleads where the structure is wrong: intervals say how well the numbers are pinned, not how true they
    are; `sufficient` and `misfit_db` tell.
    """
    refuse_unknown("a weighting is not known", weighting, WEIGHTINGS)
    lines = frf.between(*band_hz) if band_hz is not None else frf.valid_lines()
    f, G, variance = lines.frequency_hz, lines.siso, lines.variance[:, 0, 0]
    if not variance.min() > 0.0:
        raise WrongUseError(
            "a fit weighs frequencies by their variance, which must be positive",
            f"{float(variance.min()):g} at {f[np.argmin(variance)]:g} Hz",
            "estimate the FRF from noisy data, or give it a variance",
        )
    if 2 * f.size <= len(structure.names) + 2:
        raise WrongUseError(
            f"too few frequencies to fit {structure.name}", f"{f.size} lines for {len(structure.names)} parameters"
        )
    if isinstance(structure, Rational):
        wanted = (structure.stable or frf.open_loop) if stable is None else stable
        structure = replace(structure, w0=TWO_PI * float(np.exp(np.mean(np.log(f)))), stable=wanted)
    weight_variance = variance if weighting == "variance" else (0.01 * np.abs(G)) ** 2
    low, high = structure.bounds()
    weights = [1.0 / np.sqrt(x) for x in ((variance,) if weighting == "variance" else (weight_variance, variance))]
    starts = [np.clip(x, low + 1e-9, high - 1e-9) for x in _starts(structure, f, G, weights)]
    data = Data(G, variance, lines.line_overlap, lines.variance_freedom, lines.variance_pooled)
    if isinstance(structure, Rational):
        model, slopes = partial(structure.response, f=f), partial(structure.slopes, f=f)
        solution = solve(model, starts, (low, high), data, weight_variance, slopes, hopeless)
    else:
        solution = solve(lambda x: structure.model(x).response(f), starts, (low, high), data, weight_variance)
    made = _fit(structure, solution, lines, frf.digest)
    if stable is None and not lenient and made.model.unstable_poles():
        again = fit(frf, structure, weighting=weighting, band_hz=band_hz, stable=True)
        return again if _does_as_well(frf, again, made) else made
    return made


def _does_as_well(frf: FRF, stable: Fit, unstable: Fit) -> bool:
    """Whether lines need no unstable poles: stable ones leave but noise, or as much, and all lie outside the lines."""
    if stable.sufficient:
        return _criterion(frf, stable) <= _criterion(frf, unstable) + TOL.very_strong
    unstable_hz, (first_hz, last_hz) = unstable.model.unstable_hz(), unstable.band_hz
    return not unstable.sufficient and bool(np.all((unstable_hz < first_hz) | (unstable_hz > last_hz)))


def _starts(structure: Structure, f: Array, G: ComplexArray, weights: Sequence[Array]) -> list[Array]:
    """Starts of a fit, by each of `weights`, the fit's own first: rational ones also from smoothed lines, for their
    linear equations suffer from noise; with a delay, from data turned back by several delays, for the phase may wrap.
    """
    views = [(G, weight) for weight in (weights if isinstance(structure, Rational) else weights[:1])]
    if isinstance(structure, Rational):
        views += [(_smoothed(G, half), weights[0]) for half in (2, 6) if f.size > 8 * half]
    if "delay_s" not in structure.names:
        return [structure.start(f, view, weight) for view, weight in views]
    starts = []
    delays = (0.0, 0.01, 0.03, 0.1)  # delays in s that a fit with a delay starts from
    for (view, weight), delay in [(one, 0.0) for one in views] + [(one, d) for one in views[:1] for d in delays[1:]]:
        start = structure.start(f, view * np.exp(1j * angular(f) * delay), weight)
        start[-1] = delay + 1e-4
        starts.append(start)
    return starts


def _smoothed(G: ComplexArray, half: int) -> ComplexArray:
    """Moving mean of ln G over neighbouring lines."""
    ln_G = np.log(np.abs(G)) + 1j * np.unwrap(np.angle(G))
    padded = np.pad(ln_G, half, mode="edge")
    return np.asarray(np.exp(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1).mean(-1)))


def _fit(structure: Structure, s: Solution, lines: FRF, digest: str) -> Fit:
    model = structure.model(s.x)
    jacobian = _slopes(structure.meaning, s.x, 1e-3)
    covariance = jacobian @ s.covariance @ jacobian.T
    values, std = structure.meaning(s.x), np.sqrt(np.maximum(np.diag(covariance), 0.0))
    off = np.abs(lines.siso / model.response(lines.frequency_hz) - 1.0)
    known = lines.relative_std[:, 0, 0] <= TOL.misfit_std
    misfit = np.sqrt(np.mean((off[known] if known.any() else off) ** 2))
    return Fit(
        structure=structure.name,
        model=model,
        parameters=tuple(
            Estimate(n, float(v), _unit(u, lines), float(d))
            for n, v, u, d in zip(structure.names, values, structure.units, std, strict=True)
        ),
        covariance=covariance,
        outcome=s.outcome,
        chi2_per_dof=s.chi2_per_dof,
        p_value=s.p_value,
        runs_p_value=s.runs_p_value,
        misfit_db=float(db(1.0 + misfit)),
        band_hz=(float(lines.frequency_hz[0]), float(lines.frequency_hz[-1])),
        lines=lines.frequency_hz.size,
        recording=lines.recording,
        loop=lines.loop,
        operating_point=dict(lines.operating_point),
        rig_parameters=dict(lines.parameters),
        frf_digest=digest,
        delay_free="delay_s" in structure.names,
        starts=s.starts,
        starts_agreeing=s.agreeing,
    )


def _unit(unit: str, lines: FRF) -> str:
    """A parameter's unit with the plant's own in it: 1/s3 of a plant from V to rad is rad/(V s3)."""
    if not unit.startswith("1/s"):
        return unit
    output, given = (SUFFIXES[unit_of(c[0])] for c in (lines.outputs, lines.inputs))
    return f"{output}/({given} {unit[2:]})"


def _slopes(of: Callable[[Array], Array], x: Array, least: float) -> Array:
    """d of/d x by central differences, steps as for `least` at least; nan where the number of values changes there."""
    size, columns = of(x).size, []
    for k in range(x.size):
        step = np.zeros(x.size)
        step[k] = 1e-6 * max(abs(x[k]), least)
        ahead, behind = of(x + step), of(x - step)
        same = ahead.size == behind.size == size
        columns.append((ahead - behind) / (2.0 * step[k]) if same else np.full(size, np.nan))
    return np.array(columns).T


def _fitted(
    frf: FRF, structures: Sequence[Structure], known: Sequence[Fit] = (), *, weighting: str = "variance", **options: Any
) -> list[Fit]:
    """Fits of structures that come near the best of them and of those `known`, and these."""

    def hopeless() -> float:  # what the criterion counts
        of_each = (FAR * max(x.chi2_per_dof, 1.0) * (2 * x.lines - len(x.parameters)) for x in made)
        return min(of_each, default=np.inf) if weighting == "variance" else np.inf

    made = [*known]
    for structure in reversed(structures):  # the richest first: most others come nowhere near
        with suppress(TooFarError):
            made.insert(0, fit(frf, structure, weighting=weighting, hopeless=hopeless(), lenient=True, **options))
    return made


def _criterion(frf: FRF, found: Fit) -> float:
    """Schwarz's, of lines that share their errors."""
    count = len(found.parameters)
    total = found.chi2_per_dof * (2 * found.lines - count) / frf.line_overlap
    return total + count * float(np.log(2 * found.lines / frf.line_overlap))


def _simplest(frf: FRF, made: Sequence[Fit]) -> Fit:
    """The simplest within very strong evidence of the best (less is what chance finds); what did not converge last."""
    good = [found for found in made if found.converged] or made
    least = min(_criterion(frf, found) for found in good)
    near = [found for found in good if _criterion(frf, found) <= least + TOL.very_strong]
    return min(near, key=lambda found: (len(found.parameters), _criterion(frf, found)))


def fit_automatically(
    frf: FRF,
    *,
    weighting: str = "variance",
    band_hz: tuple[float, float] | None = None,
    stable: bool | None = None,
) -> Fit:
    """The best named structure; where it misses the lines by over 1 dB, the best with rational ones to order four."""
    named = _fitted(frf, [structure_by_name(name) for name in STRUCTURES[:4]], weighting=weighting, band_hz=band_hz)
    best = _simplest(frf, named)
    lines = (frf.between(*band_hz) if band_hz is not None else frf.valid_lines()).frequency_hz.size
    follows_db = 1.0  # a named structure that follows the lines this well, rms, is not exchanged for a rational one
    if (best.converged and best.misfit_db < follows_db) or 2 * lines < 16:
        return best
    orders = [(n, d, k) for d in (2, 3, 4) for n in range(min(d, 3)) for k in (0, 1, 2) if k < d]
    rational = [Rational(n, d, k, delay=True) for n, d, k in orders]
    made = _fitted(frf, rational, named, weighting=weighting, band_hz=band_hz, stable=stable)
    by_name = {structure.name: structure for structure in rational}
    best = _simplest(frf, made)
    while stable is None and best.structure in by_name and best.model.unstable_poles():
        again = fit(frf, by_name[best.structure], weighting=weighting, band_hz=band_hz, stable=True)
        if not _does_as_well(frf, again, best):
            break
        made = [again if one is best else one for one in made]
        best = _simplest(frf, made)
    return best


def modes(found: Fit) -> tuple[Estimate, ...]:
    """Eigenfrequencies (Hz) and damping ratios of a rational fit's zeros and poles, with their spread.

    A complex pair counts once, a real root has damping 1 or -1, roots at zero are left out; names are
    zero1_f_hz, zero1_damping, ... by rising frequency. Spreads follow from the coefficients' covariance by
    linearisation, mislead where two roots all but coincide, and are nan where they do. Refuses other fits.
    """
    if not found.structure.startswith("rational"):
        raise WrongUseError("zeros and poles are read off rational fits", repr(found.structure))
    size = found.covariance.shape[0] - found.delay_free
    x = np.array([p.value for p in found.parameters])[:size]
    zeros = found.model.num.size

    def features(values: Array) -> Array:
        den = np.concatenate([[1.0], values[zeros:], np.zeros(found.model.integrators())])
        return np.concatenate([_pairs(values[:zeros]), _pairs(den)])

    values, slopes = features(x), _slopes(features, x, 1e-12)  # a pair that meets on the real axis has no slope there
    std = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, found.covariance[:size, :size], slopes), 0.0))
    count = _pairs(found.model.num).size // 2
    names = [f"zero{k + 1}" for k in range(count)] + [f"pole{k + 1}" for k in range(values.size // 2 - count)]
    return tuple(
        Estimate(f"{name}_{what}", float(values[2 * k + j]), unit, float(std[2 * k + j]))
        for k, name in enumerate(names)
        for j, (what, unit) in enumerate((("f_hz", "Hz"), ("damping", "1")))
    )


def _pairs(polynomial: Array) -> Array:
    """Frequency in Hz and damping ratio of each root that is not at zero, complex pairs once, by frequency."""
    roots = np.roots(polynomial)
    keep = roots[(roots.imag >= 0.0) & (np.abs(roots) > 0.0)]
    keep = keep[np.argsort(np.abs(keep))]
    return np.stack([np.abs(keep) / TWO_PI, -keep.real / np.abs(keep)], axis=1).ravel()


#: evaluations after which a start is given up whose sum of squares is so many times that of another structure
PATIENCE, FAR = 50, 10.0


class TooFarError(Exception):
    """No start of a structure came near what another structure leaves."""


#: a search ends where a step takes less than this share off the sum of squares: off chi^2 of 300 lines 3e-6, so that
#: even a hundred more such steps would move no parameter by more than 0.03 of its standard deviation
END = 1e-8
#: sums of squares that differ by less are those of one minimum
SAME = 1.01


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters, their covariance, residual statistics and outcome of one fit."""

    x: Array
    covariance: Array
    chi2_per_dof: float
    p_value: float
    runs_p_value: float
    outcome: Convergence
    starts: int = 1
    agreeing: int = 1


@dataclass(frozen=True, eq=False)
class Data:
    """What is fitted: response (nf,), its variance E|d|² (nf,), and how sure and how independent that variance is.

    `overlap` lines carry one line's worth of independent error; `freedom` are the variance's degrees of freedom,
    and `pooled` neighbouring lines share one variance.
    """

    response: ComplexArray
    variance: Array
    overlap: float
    freedom: float
    pooled: int = 1


def solve(
    model: Callable[[Array], ComplexArray],
    starts: Sequence[Array],
    bounds: tuple[Array, Array],
    data: Data,
    weight_variance: Array,
    slopes: Callable[[Array], ComplexArray] | None = None,
    hopeless: float = np.inf,
) -> Solution:
    """Fit `model(x)` (nf,) to the data, weighted by 1/`weight_variance` (nf,), from the best of several starts.

    `slopes` are those of the model (nf, parameters), found by differences where they are not given. `agreeing` counts
    the starts that end within 1 % of the least sum of squares.
    The covariance is that of the linearised estimate under the data's own variance, whatever the weights
    (the sandwich A^-1 J' V J A^-1), widened where the residual exceeds the noise, and by the overlap where
    neighbouring lines share their error.
    """
    from scipy.optimize import least_squares

    scale = np.sqrt(0.5 * weight_variance)

    def residual(x: Array) -> Array:
        r = (model(x) - data.response) / scale
        flat = np.concatenate([r.real, r.imag])
        tried.append(float(flat @ flat))
        if slopes and len(tried) > PATIENCE and min(tried) > hopeless:
            raise TooFarError
        return flat

    def jacobian(x: Array) -> Array:
        J = slopes(x) / scale[:, None]  # type: ignore[misc]
        return np.concatenate([J.real, J.imag])

    def one(start: Array) -> Any:
        tried.clear()
        size = np.maximum(np.abs(start), 1e-3)
        return least_squares(
            residual, start, jacobian if slopes else "2-point", bounds=bounds, x_scale=size, xtol=1e-12, ftol=END,
            gtol=1e-12,
        )  # fmt: skip

    tried: list[float] = []
    ends = []
    for start in starts:
        with suppress(TooFarError):
            ends.append(one(start))
    if not ends:
        raise TooFarError
    found = min(ends, key=lambda result: result.cost)
    agreeing = sum(end.cost <= SAME * found.cost + data.response.size * TOL.no_noise for end in ends)
    left = (model(found.x) - data.response) / np.sqrt(0.5 * data.variance)
    J, share = np.asarray(found.jac), np.tile(data.variance / weight_variance, 2)
    inverse = _inverse(J)
    freedom, stretch = _freedom(J, inverse, share)
    chi2_per_dof = float(np.sum(np.abs(left) ** 2)) / freedom
    covariance = inverse @ (J.T @ (share[:, None] * J)) @ inverse * max(chi2_per_dof, 1.0) * data.overlap
    ended = Convergence.AT_BOUND if np.any(found.active_mask) else Convergence.CONVERGED
    outcome = Convergence.NOT_CONVERGED if found.status <= 0 else ended
    p_value, runs = residual_tests(left, freedom, data, stretch)
    if chi2_per_dof < TOL.no_noise:
        runs = 1.0
    return Solution(found.x, covariance, chi2_per_dof, p_value, runs, outcome, len(starts), agreeing)


def _freedom(J: Array, inverse: Array, share: Array) -> tuple[float, float]:
    """Mean of the sum of squares of what is left, if the model is right, and its variance over twice that mean.

    n - p and 1 where the weights are the data's own variances. Under other weights the fit takes less out
    of the well-known lines: with R = I - J A^-1 J' the residual in units of its noise is B = V^-1/2 R V^1/2
    times white noise, and the moments are the traces of B'B = I + Z M Z', Z as wide as the parameters twice.
    """
    n, p = J.shape
    if np.all(share == share[0]):
        return float(max(n - p, 1)), 1.0
    root = np.sqrt(share)[:, None]
    Z = np.hstack([root * J, J @ inverse / root])
    G = Z.T @ Z
    M = np.kron([[0.0, -1.0], [-1.0, 0.0]], np.eye(p))
    M[:p, :p] = G[p:, p:]
    MG = M @ G
    mean = n + float(np.trace(MG))
    return mean, (mean + float(np.trace(MG)) + float(np.sum(MG * MG.T))) / mean


def residual_tests(left: ComplexArray, freedom: float, data: Data, stretch: float = 1.0) -> tuple[float, float]:
    """p-values that what is left (nf,), of unit variance in each part, is noise: by its size and by its signs.

    Size: chi² with `freedom` over independent lines, allowing for variances that are estimates themselves
    (each square is then F-distributed, with mean nu/(nu-2) and a wider spread, and lines that share a variance
    vary together). Signs: a runs test over lines far enough apart not to share error.
    """
    nu = max(data.freedom, 6.0)
    mean, spread = 1.0, stretch
    if np.isfinite(nu):
        mean, spread = nu / (nu - 2.0), stretch * (nu / (nu - 4.0) + 2.0 * (data.pooled - 1) / nu)
    scale = data.overlap * spread
    total = float(np.sum(np.abs(left) ** 2)) / (mean * scale)
    apart = left[:: 1 if data.overlap == 1.0 else int(np.ceil(data.overlap)) + 1]
    return float(chdtrc(freedom / scale, total)), min(1.0, 2.0 * min(runs_test(apart.real), runs_test(apart.imag)))


def _inverse(jacobian: Array) -> Array:
    """(J^T J)^-1 with columns scaled first; directions that the data do not see come out very wide."""
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    u = jacobian / size
    return np.asarray(np.linalg.pinv(u.T @ u, rcond=1e-14) / np.outer(size, size))


def runs_test(residual: Array) -> float:
    """Two-sided p-value of Wald and Wolfowitz's test (1940) that signs along the lines are random."""
    positive = residual > 0.0
    n1, n2 = int(positive.sum()), int((~positive).sum())
    if min(n1, n2) < 2:
        return 1.0 if residual.size < 8 else 0.0
    runs = 1 + int(np.sum(positive[1:] != positive[:-1]))
    mean = 2.0 * n1 * n2 / (n1 + n2) + 1.0
    variance = (mean - 1.0) * (mean - 2.0) / (n1 + n2 - 1.0)
    return float(2.0 * ndtr(-abs(runs - mean) / np.sqrt(variance)))
