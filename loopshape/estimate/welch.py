"""Welch's segments, summed as they are transformed: memory by the block, not by the record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import binary_opening

from loopshape.errors import BadSignalError
from loopshape.estimate.answers import Answers
from loopshape.estimate.averages import line_covariance, smoothed
from loopshape.estimate.input_power import powered
from loopshape.estimate.settings import Settings
from loopshape.estimate.transforms import clear_of_edges, segments_of, window_of
from loopshape.kernels.spectra import cross_spectra, independent_share, line_overlap
from loopshape.recording import Recording
from loopshape.units import Array, ComplexArray


def by_welch(
    recording: Recording, signals: Sequence[Array], instruments: Sequence[Array], settings: Settings
) -> Answers:
    """Answers of signals (n,) to instruments (n,) by windowed segments (Welch 1967).

    Noise excites every segment alike, so its scatter is pooled over all; where one sweep passes, each segment's
    residual counts with its own excitation. Refuses a record with fewer than three averages, or than instruments.
    """
    rate, m, nr = recording.rate_hz, len(signals), len(instruments)
    length, step, segments = segments_of(recording, instruments[0].size, settings)
    window = window_of(settings, length)
    share, wide = independent_share(segments, length, step, window), line_overlap(window)
    if segments * share < nr + 1.5:
        raise BadSignalError(
            f"recording {recording.info.file} has too few averages to tell {nr} inputs apart",
            f"{segments * share:.1f} averages of {length / rate:g} s",
            "ask for a coarser resolution, or record longer",
        )
    passing = recording.info.kind == "sweep" and nr == 1
    plain = settings.window == "hann" and not settings.symmetric
    sums, weighted, squares = cross_spectra(
        [*signals, *instruments], length, step, m if passing else None, None if plain else window, settings.detrend
    )
    total = _hermitian(sums)
    power = np.real(np.einsum("fii->fi", total))[:, m:].T / segments
    excited = powered(total[:, m:, m:])
    excited[:2] = excited[-1] = False  # the window smears the mean into the first line
    excited = np.asarray(binary_opening(excited, np.ones(3, dtype=bool)))  # fewer leak
    excited = np.logical_and.reduce([clear_of_edges(excited, p) for p in power])
    response, spread = _response(total, m)
    if passing:
        averages = share * power[0] ** 2 * segments**2 / squares
        scatter = smoothed(_residual(_hermitian(weighted), response), 2)
        covariance, freedom, pooled = line_covariance(
            scatter, averages, share * (segments * power[0]) ** 2, excited, wide
        )
    else:
        k = segments * share
        noise = _residual(total, response) / segments * (k / (k - nr))
        covariance = np.einsum("fab,fij->faibj", spread.conj() * segments / k, noise)
        covariance = covariance.reshape(-1, nr * m, nr * m)
        freedom, pooled = 2.0 * (k - nr), 1
    density = 2.0 / (rate * float(window @ window))
    text = f"Welch, {_words(settings)}, {length / rate:g} s segments, {100 * settings.overlap:.0f} % overlap"
    return Answers(
        frequency_hz=np.arange(length // 2 + 1, dtype=np.float64) * (rate / length),
        response=response,
        covariance=covariance,
        power=total * (density / segments),
        excited=excited,
        averages=segments * share,
        power_per="Hz",
        line_overlap=wide,
        freedom=freedom,
        pooled=pooled,
        method=f"{text}, {segments * share:.1f} averages, {rate / length:.3g} Hz resolution",
    )


def _words(settings: Settings) -> str:
    """Window and detrending."""
    name = "Hann" if settings.window == "hann" else settings.window
    how = "" if settings.detrend == "mean" else f", {settings.detrend.replace('none', 'nothing')} taken off"
    return f"{'symmetric ' * settings.symmetric}{name} window{how}"


def _hermitian(sums: ComplexArray) -> ComplexArray:
    """(nf, s, s) from the upper triangle (s, s, nf)."""
    upper = np.moveaxis(sums, -1, 0)
    rows, columns = np.tril_indices(upper.shape[1], -1)
    out = np.ascontiguousarray(upper)
    out[:, rows, columns] = out[:, columns, rows].conj()
    return out


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
