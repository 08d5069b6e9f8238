"""Paths through a machine, their FRFs from two recordings of one experiment, and how these differ band by band.

A path that is no loop's own is measured indirectly, as the ratio of the responses of both its ends to the signal
that only we moved: under feedback that is consistent, and both runs go through the same estimator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.core.units import Array, ComplexArray, db, deg
from loopshape.data.response.frf import FRF
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings
from loopshape.identify.signals import loop_signals, moved_signal
from loopshape.identify.spectra.averages import against_instrument, line_covariance, smoothed
from loopshape.identify.spectra.transforms import Transforms, transform
from loopshape.identify.tolerances import TOL


@dataclass(frozen=True)
class Path:
    """From one column, or difference of two, to another; `loop` where it is that loop's own control to output."""

    start: str
    end: str
    loop: str | None = None

    @property
    def name(self) -> str:
        """Both ends without their units."""
        return f"{_bare(self.start)} -> {_bare(self.end)}"


def _bare(expression: str) -> str:
    for sign in (" + ", " - "):
        if sign in expression:
            return sign.strip().join(_bare(term) for term in expression.split(sign))
    return Channel.from_column(expression).name


def paths_of(run: Run, recording: Recording) -> list[Path]:
    """The paths of a recording that excites a loop: the loop's own, and what else its columns allow.

    By the names of the columns: flow command to pressure (`u_a_v` to `p_a_bar`) of each muscle, and where there are
    two of these, the difference of both pressures to the output. Where the joint moves, u to p carries what that motion
    does to the pressure too.
    """
    loop = run.loop(str(recording.info.excites))
    found = [Path(loop.control, loop.output, loop.name)]
    muscles = [
        c[2:-2]
        for c in recording.columns
        if c.startswith("u_") and c.endswith("_v") and f"p_{c[2:-2]}_bar" in recording.columns
    ]
    found += [Path(f"u_{m}_v", f"p_{m}_bar") for m in muscles]
    if len(muscles) == 2 and "+" not in loop.output and loop.output_unit != "bar":
        found.append(Path(f"p_{muscles[0]}_bar - p_{muscles[1]}_bar", loop.output))
    return found


def _along(run: Run, recording: Recording, path: Path) -> tuple[Recording, LoopSetup]:
    """The recording and loop whose control and output are the path's ends; what only we moved stays the instrument."""
    loop = run.loop(str(recording.info.excites))
    if path.loop is not None:
        return recording, run.loop(path.loop)
    start, end = _column_name(path.start), _column_name(path.end)
    columns = {
        "moved_1": np.asarray(moved_signal(recording, loop)),
        start: _signal(recording, path.start),
        end: _signal(recording, path.end),
    }
    info = replace(recording.info, injection="controller_input", closed_loop=True)
    return Recording(info, recording.rate_hz, columns), LoopSetup(path.name, None, "moved_1", start, end, None)


def _signal(recording: Recording, expression: str) -> Array:
    terms = expression.split(" - ")
    return np.asarray(recording.output(terms[0]) - sum(recording.output(term) for term in terms[1:]))


def _column_name(expression: str) -> str:
    """A column's name for a difference or sum of columns of one unit."""
    terms = [Channel.from_column(c.strip()) for c in expression.replace(" - ", " + ").split(" + ")]
    if len({t.unit for t in terms}) != 1:
        raise WrongUseError("the columns of a path's end share a unit", repr(expression))
    return "_".join(t.name for t in terms) + f"_{terms[0].unit}"


@dataclass(frozen=True, eq=False)
class PathFrfs:
    """Both FRFs of a path on common lines, and the variance (nf,) of their difference.

    `variance` is smoothed where the estimator does so; `own` is each line's, where there are periods, with
    `own_freedom` degrees of freedom.
    """

    real: FRF
    sim: FRF
    variance: Array
    own: Array
    own_freedom: float

    def select(self, lines: np.ndarray) -> PathFrfs:
        """The same on a mask of lines."""
        return PathFrfs(
            self.real.select(lines), self.sim.select(lines), self.variance[lines], self.own[lines], self.own_freedom
        )


def common_frfs(runs: tuple[Run, Run], recordings: tuple[Recording, Recording], path: Path) -> PathFrfs:
    """Both FRFs of a path on the lines that they share; Welch's resolution is the coarser of both.

    The variance of their difference is s_real² + s_sim², less what their errors share: where both runs had the same
    signal injected, what a window leaks and what a sweep leaves settling is the same in both and cancels, so that the
    variance follows from the segments' residuals, one run's less the other's. Raises what `estimate_frf` does.
    """
    settings = [Settings("reference", "auto" if r.info.period_s else "welch") for r in recordings]
    along = [_along(run, r, path) for run, r in zip(runs, recordings, strict=True)]
    one, two = (estimate_frf(*a, s) for a, s in zip(along, settings, strict=True))
    if recordings[0].info.period_s is None and recordings[1].info.period_s is None:
        steps = [float(np.diff(x.frequency_hz).min()) for x in (one, two)]
        if abs(steps[0] - steps[1]) > 1e-9 * steps[0]:
            settings = 2 * [Settings(resolution_hz=max(steps))]
            one, two = (estimate_frf(*a, s) for a, s in zip(along, settings, strict=True))
    one, two = on_common_lines(one, two)
    t = [_transforms(*a, s) for a, s in zip(along, settings, strict=True)]
    residuals = [(t[0], _residual(t[1]) - _residual(t[0]))] if _same_instrument(*t) else [(x, _residual(x)) for x in t]
    parts = [_variances(x, r, one.frequency_hz) for x, r in residuals]
    variance, own = np.sum(parts, axis=0)
    return PathFrfs(one, two, variance, own, 2.0 * (min(x.instrument.shape[0] for x in t) - 1.0))


def _transforms(recording: Recording, loop: LoopSetup, settings: Settings) -> Transforms:
    s = loop_signals(recording, loop)
    return transform(recording, [s.y, s.u], s.instrument, settings)


def _same_instrument(one: Transforms, two: Transforms) -> bool:
    a, b = one.instrument, two.instrument
    same = 1e-3  # injected signals are the same where they differ by less than this share of what they span
    return a.shape == b.shape and bool(np.abs(a - b).max() <= same * np.abs(a).max())


def _residual(t: Transforms) -> ComplexArray:
    """What each segment (k, nf) says of the FRF's error: (Y - G U) over the response of U to the instrument."""
    Y, U = t.signals
    response = against_instrument(t)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((Y - response[:, 0] / response[:, 1] * U) / response[:, 1])


def _variances(t: Transforms, residual: ComplexArray, frequency_hz: Array) -> tuple[Array, Array]:
    """Variance that segments' residuals give, on some lines: as the estimator has it, and each line's own."""
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = _covariance(t, residual[None])
    rows = np.searchsorted(t.frequency_hz, frequency_hz * (1.0 - 1e-9))
    smooth = np.real(covariance[rows, 0, 0])
    k = residual.shape[0]
    if t.power_per != "line" or k < 2:
        return smooth, smooth
    power = (np.abs(t.instrument[:, rows]) ** 2).sum(axis=0)
    return smooth, (np.abs(residual[:, rows]) ** 2).sum(axis=0) / (k - 1.0) / power


def on_common_lines(one: FRF, two: FRF) -> tuple[FRF, FRF]:
    """Both FRFs on the lines that both have; refuses where there is none."""
    keys = [np.round(x.frequency_hz * 1e7).astype(np.int64) for x in (one, two)]
    shared = np.intersect1d(keys[0], keys[1])
    if not shared.size:
        raise WrongUseError(
            f"the recordings {one.recording} and {two.recording} share no frequency",
            f"{one.frequency_hz[0]:.3g} to {one.frequency_hz[-1]:.3g} and {two.frequency_hz[0]:.3g} to"
            f" {two.frequency_hz[-1]:.3g} Hz",
            "record both with the same excitation",
        )
    one, two = one.select(np.isin(keys[0], shared)), two.select(np.isin(keys[1], shared))
    return one, replace(two, frequency_hz=one.frequency_hz)


def known_lines(one: FRF, two: FRF) -> np.ndarray:
    """Frequencies (nf,) in the valid band of either FRF and known to 30 % in both."""
    # lines whose relative standard deviation is above this in either run say nothing
    known = [np.sqrt(x.variance[:, 0, 0]) < 0.3 * np.abs(x.siso) for x in (one, two)]
    return np.asarray((one.valid | two.valid) & known[0] & known[1])


@dataclass(frozen=True)
class Difference:
    """How two FRFs differ on some lines; fields as in `GapRow`."""

    lines: int
    size: float
    noise: float
    z2: float
    p_value: float
    gain_db: float
    phase_deg: float


def difference(frfs: PathFrfs) -> Difference:
    """Difference of two FRFs (1 x 1) pooled over their lines; its error is taken as circular."""
    real, d = frfs.real.siso, frfs.sim.siso - frfs.real.siso
    relative = frfs.variance / np.abs(real) ** 2
    weight = 1.0 / (np.median(relative) + relative)  # lines noisier than most count less
    noise = float(np.average(relative, weights=weight))
    z2, p_value = _significance(frfs, np.abs(d) ** 2)
    ratio = _mean_log_ratio(real, frfs.sim.siso)
    return Difference(
        lines=int(real.size),
        size=float(np.sqrt(max(float(np.average(np.abs(d / real) ** 2, weights=weight)) - noise, 0.0))),
        noise=float(np.sqrt(noise)),
        z2=z2,
        p_value=p_value,
        gain_db=float(db(np.exp(ratio.real))),
        phase_deg=float(deg(ratio.imag)),
    )


def _significance(frfs: PathFrfs, power: Array) -> tuple[float, float]:
    """Mean of |dG|² over its variance, and the probability of as much by noise alone.

    An F-test that takes the variances as estimates: two freedoms a line over those of the variances, fewer where
    lines overlap or where a few lines carry most of the noise.
    """
    one, two = frfs.real, frfs.sim
    lines = max(power.size / max(one.line_overlap, two.line_overlap), 1.0)
    each = max(min(one.variance_freedom, two.variance_freedom, 1e6), 4.5)
    share = frfs.own / frfs.variance
    if np.array_equal(frfs.own, frfs.variance):
        z2 = float(np.mean(power / frfs.variance)) * (1.0 - 2.0 / each)
        freedom = each * max(1.0, power.size / max(one.variance_pooled, two.variance_pooled))
    else:
        z2 = float(np.sum(power / frfs.variance) / np.sum(share))
        spread = float(np.mean(share**2) / np.mean(share) ** 2) / (1.0 + 2.0 / frfs.own_freedom)
        lines = max(lines / max(spread, 1.0), 1.0)
        freedom = frfs.own_freedom * lines
    return z2, float(fdtrc(2.0 * lines, freedom, z2))


def _mean_log_ratio(real: ComplexArray, sim: ComplexArray) -> complex:
    """Mean complex logarithm of sim over real, its phase unwrapped about the mean direction."""
    ratio = sim / real
    mean = complex(np.mean(ratio / np.abs(ratio)))
    centre = mean / abs(mean) if abs(mean) > 0.0 else 1.0 + 0.0j
    return complex(np.mean(np.log(ratio / centre)) + np.log(centre))


def bands_hz(kind: str, f_low_hz: float, f_high_hz: float) -> list[tuple[float, float]]:
    """Octaves or thirds of a decade on a fixed grid about 1 Hz that cover a range; refuses another word."""
    steps = {"octave": 2.0, "third_decade": 10.0 ** (1.0 / 3.0)}
    refuse_unknown("a kind of band is not known", kind, steps)
    base = np.log(steps[kind])
    first, last = np.floor(np.log(f_low_hz) / base + 1e-9), np.floor(np.log(f_high_hz) / base + 1e-9)
    edges = np.exp(base * np.arange(first, last + 2.0))
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def in_band(frf: FRF, mask: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """Lines of a mask that lie in a band, its upper end left out."""
    f = frf.frequency_hz
    return np.asarray(mask & (f >= band[0] * (1.0 - 1e-9)) & (f < band[1] * (1.0 - 1e-9)))


def _covariance(t: Transforms, residual: ComplexArray) -> ComplexArray:
    """Covariance (nf, m, m) of sum(E N*)/sum(N N*) for residuals E (m, k, nf).

    Where every segment carries the same excitation (noise, periods) the noise is pooled over all, and with few periods
    over neighbouring excited lines too: noise that stands on one line alone is then underrated. Where a sweep passes,
    each segment's residual counts with its own excitation, which follows disturbances that come with the sweep.
    """
    nn = np.abs(t.instrument) ** 2
    k, squared = nn.shape[0], t.independent * nn.sum(0) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        if not t.stationary:
            averages = squared / (nn**2).sum(0)
            scatter = smoothed(np.einsum("akf,bkf,kf->fab", residual, residual.conj(), nn), 2)
            return line_covariance(scatter, averages, squared, t.excited, t.line_overlap)[0]
        averages = np.full(nn.shape[1], k * t.independent)
        noise = np.einsum("akf,bkf->fab", residual, residual.conj()) / k
        each = 2.0 * max(k * t.independent - 1.0, 0.5)
        width = int(np.ceil(TOL.variance_freedom / each)) if t.power_per == "line" else 1
        noise[t.excited] = smoothed(noise[t.excited], width // 2)
        unbiased = np.where(averages > 1.5, averages / (averages - 1.0), np.inf)
        return np.asarray(noise * nn.sum(0)[:, None, None] * (unbiased / squared)[:, None, None])
