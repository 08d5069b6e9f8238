"""Welch's segments, summed as they are transformed: memory by the block, not by the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, binary_opening

from loopshape.core.errors import BadSignalError
from loopshape.core.kernels.spectra import cross_spectra, independent_share, line_overlap
from loopshape.core.stretches import Signal
from loopshape.core.units import Array, ComplexArray
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers, blocks
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.averages import line_covariance, smoothed
from loopshape.identify.spectra.input_power import powered
from loopshape.identify.spectra.transforms import clear_of_edges, segments_of, window_of
from loopshape.identify.tolerances import TOL


def by_welch(
    recording: Recording, signals: Sequence[Signal], instruments: Sequence[Signal], settings: Settings
) -> Answers:
    """Answers of signals (n,) to instruments (n,) by windowed segments (Welch 1967).

    Where the estimate of noise bends by more than its deviation between lines, and no segment's length was given,
    the segments become longer while there are averages; lines that stay unresolved are marked (`_unresolved`).
    """
    found = _by_segments(recording, signals, instruments, settings)
    if found.unresolved is None or not found.unresolved.any():
        return found
    if settings.resolution_hz is not None or settings.segment_samples is not None:
        return replace(found, notes=_unresolved_note(found, "taken as they are"), unresolved=None)
    while length := _worth_longer(found, recording.rate_hz):
        del found  # the next is twice as large
        found = _by_segments(recording, signals, instruments, replace(settings, segment_samples=length))
    return replace(found, notes=_unresolved_note(found, "outside the valid band"))


def _worth_longer(found: Answers, rate_hz: float) -> int:
    """Samples of segments twice as long, where lines are not resolved and averages are left; else 0."""
    if found.averages < 2.0 * TOL.least_averages:
        return 0
    if not _unresolved(found.response, found.covariance, found.excited, TOL.bias_std).any():
        return 0
    return round(2.0 * rate_hz / float(found.frequency_hz[1]))


def _by_segments(
    recording: Recording, signals: Sequence[Signal], instruments: Sequence[Signal], settings: Settings
) -> Answers:
    """Answers by segments of one length.

    Noise excites every segment alike, so its scatter is pooled over all; where one sweep passes, each segment's
    residual counts with its own excitation. Refuses a record with fewer than three averages, or than instruments.
    """
    rate, m, nr = recording.rate_hz, len(signals), len(instruments)
    length, step, segments = segments_of(recording, instruments[0].size, settings)
    window = window_of(settings, length)
    share, wide = independent_share(segments, length, step, window), line_overlap(window)
    if segments * share < nr + 1.5:
        raise BadSignalError(
            f"recording {recording.info.file} has too few averages {nr} inputs apart",
            f"{segments * share:.1f} averages of {length / rate:g} s",
            "ask for a coarser resolution, or record longer",
        )
    passing = recording.info.kind == "sweep" and nr == 1
    plain = settings.window == "hann" and not settings.symmetric
    sums, weighted, squares = cross_spectra(
        [*signals, *instruments], length, step, m if passing else None, None if plain else window, settings.detrend
    )
    total = _hermitian(sums)
    del sums
    power = np.real(np.einsum("fii->fi", total))[:, m:].T / segments
    excited = powered(total[:, m:, m:])
    excited[:2] = excited[-1] = False  # the window smears the mean into the first line
    excited = np.asarray(binary_opening(excited, np.ones(3, dtype=bool)))  # fewer leak
    excited = np.logical_and.reduce([clear_of_edges(excited, p) for p in power])
    if passing:
        response, _ = _response(total, m)
        averages = share * power[0] ** 2 * segments**2 / squares
        scatter = smoothed(_residual(_hermitian(weighted), response), 2)
        covariance, freedom, pooled = line_covariance(
            scatter, averages, share * (segments * power[0]) ** 2, excited, wide
        )
    else:
        k = segments * share
        parts = [_with_covariance(total[rows], m, segments, k) for rows in blocks(len(total))]
        response, covariance = (np.concatenate(every) for every in zip(*parts, strict=True))
        del parts
        freedom, pooled = 2.0 * (k - nr), 1
    known = settings.window == "hann" and not passing
    unresolved = _unresolved(response, covariance, excited) if known else None
    total *= 2.0 / (rate * float(window @ window)) / segments
    text = f"Welch, {_words(settings)}, {length / rate:g} s segments, {100 * settings.overlap:.0f} % overlap"
    return Answers(
        frequency_hz=np.arange(length // 2 + 1, dtype=np.float64) * (rate / length),
        response=response,
        covariance=covariance,
        power=total,
        excited=excited,
        averages=segments * share,
        power_per="Hz",
        unresolved=unresolved,
        line_overlap=wide,
        freedom=freedom,
        pooled=pooled,
        method=f"{text}, {segments * share:.1f} averages, {rate / length:.3g} Hz resolution",
        method_numbers={"segment_s": length / rate, "averages": segments * share},
    )


def _unresolved(
    response: ComplexArray, covariance: ComplexArray, excited: np.ndarray, deviations: float = 1.0
) -> np.ndarray:
    """Lines (nf,) on which a response (nf, m, nr) bends so much that segments of this length round it off.

    A window brings the mean of H over its main lobe; for Hann that is (1, 4, 1)/6 over three lines, off by a sixth of
    the second difference to first order. It counts beyond as many standard deviations (by the median of 15 lines,
    which a resonance hardly moves) and 2 % of H; with one, noise alone does it once in a million lines.
    """
    nf, m, nr = response.shape
    variance = np.real(np.einsum("fii->fi", covariance)).reshape(nf, nr, m).transpose(0, 2, 1)
    inner = np.asarray(binary_erosion(excited, np.ones(3, dtype=bool)))
    with np.errstate(invalid="ignore"):
        off = np.nan_to_num(np.abs(bias_of(response)) ** 2)
        seen = off > (TOL.bias_seen * np.abs(response)) ** 2
    variance = np.nan_to_num(variance, nan=np.inf)
    rows = np.flatnonzero(inner & (seen & (off > 0.25 * deviations**2 * _by_blocks(variance))).any(axis=(1, 2)))
    around = np.clip(rows[:, None] + np.arange(-7, 8), 0, nf - 1)
    bent = np.zeros(nf, dtype=bool)
    bent[rows] = (seen[rows] & (off[rows] > deviations**2 * np.median(variance[around], axis=1))).any(axis=(1, 2))
    return np.asarray(binary_dilation(bent, np.ones(3, dtype=bool)) & excited)


def _by_blocks(variance: Array, block: int = 15) -> Array:
    """Medians of blocks of lines, on each of their lines (nf, ...): cheap, and too small on a slope."""
    nf = variance.shape[0]
    filled = np.pad(variance, ((0, -nf % block), *((0, 0),) * (variance.ndim - 1)), mode="edge")
    middle = np.median(filled.reshape(-1, block, *variance.shape[1:]), axis=1)
    return np.asarray(np.repeat(middle, block, axis=0)[:nf])


def bias_of(response: ComplexArray) -> ComplexArray:
    """What Hann segments add to H to first order in the lines' distance squared: a sixth of its second difference."""
    out = np.zeros_like(response)
    out[1:-1] = (response[2:] - 2.0 * response[1:-1] + response[:-2]) / 6.0
    return out


def _unresolved_note(found: Answers, fate: str) -> tuple[str, ...]:
    """Which lines are not resolved, by how much, and what helps."""
    if found.unresolved is None or not found.unresolved.any():
        return found.notes
    f, H = found.frequency_hz[found.unresolved], found.response
    with np.errstate(all="ignore"):
        share = np.nanmax(np.abs(bias_of(H))[found.unresolved] / np.abs(H[found.unresolved]))
    return (
        *found.notes,
        f"on {f.size} lines, {f[0]:.3g} to {f[-1]:.3g} Hz, a resonance is narrower than the lines,"
        f" {found.frequency_hz[1]:.3g} Hz apart, can show: it is off by {100.0 * min(share, 1.0):.0f} % or more"
        f" there, a bias that no standard deviation holds; these lines are {fate}; record longer, ask for a finer"
        " resolution, or take local fits",
    )


def _words(settings: Settings) -> str:
    """Window and detrending."""
    name = "Hann" if settings.window == "hann" else settings.window
    how = "" if settings.detrend == "mean" else f", {settings.detrend.replace('none', 'nothing')} taken off"
    return f"{'symmetric ' * settings.symmetric}{name} window{how}"


def _hermitian(sums: ComplexArray) -> ComplexArray:
    """(nf, s, s) from the upper triangle (s, s, nf), whose lower one is filled."""
    for row, column in zip(*np.tril_indices(len(sums), -1), strict=True):
        np.conj(sums[column, row], out=sums[row, column])
    return np.moveaxis(sums, -1, 0)


def _with_covariance(total: ComplexArray, m: int, segments: int, averages: float) -> tuple[ComplexArray, ComplexArray]:
    """Responses (nf, m, nr) of lines that all segments excite alike, and their covariance (nf, nr m, nr m)."""
    response, spread = _response(total, m)
    nr = spread.shape[1]
    noise = _residual(total, response) / segments * (averages / (averages - nr))
    covariance = np.einsum("fab,fij->faibj", spread.conj() * segments / averages, noise)
    return response, covariance.reshape(-1, nr * m, nr * m)


def _response(total: ComplexArray, m: int) -> tuple[ComplexArray, ComplexArray]:
    """Responses (nf, m, nr) = S_xr S_rr^-1, and S_rr^-1; nan where the instruments do not tell themselves apart."""
    S_rr = total[:, m:, m:]
    inverse = np.full_like(S_rr, np.nan)
    sizes = np.real(np.einsum("fii->fi", S_rr))
    with np.errstate(divide="ignore", invalid="ignore"):
        alike = S_rr / np.sqrt(sizes[:, :, None] * sizes[:, None, :])
        ok = np.isfinite(alike).all(axis=(1, 2))
        ok[ok] = np.abs(np.linalg.det(alike[ok])) > 1e-12
    inverse[ok] = np.linalg.inv(S_rr[ok])
    return total[:, :m, m:] @ inverse, inverse


def _residual(total: ComplexArray, response: ComplexArray) -> ComplexArray:
    """[I, -H] S [I, -H]^H, (nf, m, m), with what rounding made negative put to zero."""
    nf, m, _ = response.shape
    left = np.concatenate([np.broadcast_to(np.eye(m), (nf, m, m)), -response], axis=2)
    out = left @ total @ left.conj().transpose(0, 2, 1)
    rows = np.arange(m)
    out[:, rows, rows] = np.maximum(out[:, rows, rows].real, 0.0)
    return np.asarray(out)
