"""Periodic recordings: means over periods for the response, their scatter for the noise, and what scatters between
realisations for the distortion (the robust method of Pintelon and Schoukens, System Identification, 2012, 4.3.1).

A block is as many recordings as there are instruments, with which their responses can be solved: one loop excited at a
time, or all at once by orthogonal multisines (Dobrowiecki, Schoukens, Guillaume, IEEE TIM 55, 2006). Each further block
is another draw of the phases: what a nonlinear plant answers differently to it is distortion, what differs between
periods of one recording is noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers
from loopshape.identify.settings import Settings
from loopshape.identify.spectra.averages import smoothed
from loopshape.identify.spectra.transforms import Transforms, transform
from loopshape.identify.tolerances import TOL

#: one recording's part: itself, its signals (n,), all instruments (n,) in order, and the place of one that it moves
Part = tuple[Recording, Sequence[Array], Sequence[Array], int]
#: from responses (nf, m, nr) how large noise in the m signals is expected on each line (nf, m), but for a factor that
#: varies slowly over the lines
Shape = Callable[[ComplexArray], Array]


def by_periods(parts: Sequence[Part], settings: Settings) -> Answers:
    """Answers of m signals to nr instruments from blocks of nr periodic recordings each, in order.

    Of one closed loop noise is pooled over neighbouring lines as multiples of |S|: where a loop lets little noise
    through, the noise of neighbours that it lets more through says nothing of a line by itself.

    Refuses recordings whose number is no multiple of nr, whose lines differ, or that cannot tell instruments apart.
    """
    m, nr = len(parts[0][1]), len(parts[0][2])
    if len(parts) % nr:
        raise WrongUseError(
            "periodic recordings come in blocks of as many as instruments", f"{len(parts)} for {nr} instruments"
        )
    spectra = [transform(r, [*signals, *inst], inst[k], settings) for r, signals, inst, k in parts]
    f = spectra[0].frequency_hz
    if any(not np.array_equal(t.frequency_hz, f) for t in spectra):
        raise WrongUseError("the recordings to be taken together have different periods", "", "record them alike")
    excited = np.logical_and.reduce([t.excited for t in spectra])
    if not excited.any():
        raise BadSignalError(
            "the recordings to be taken together share no excited frequency",
            ", ".join(r.info.name for r, *_ in parts),
            "excite the same frequencies in each",
        )
    shape = _let_through(*parts[0][:3])
    blocks = [_block(spectra[k : k + nr], m, excited, shape) for k in range(0, len(spectra), nr)]
    response = np.mean([b[0] for b in blocks], axis=0)
    noise = np.sum([b[1] for b in blocks], axis=0) / len(blocks) ** 2
    each = 2.0 * (spectra[0].signals.shape[1] - 1)
    covariance, (freedom, pooled) = noise, (each * _lines_pooled(each), _lines_pooled(each))
    if len(blocks) > 1:
        size = np.sqrt(np.mean([(np.abs(t.signals[m:]) ** 2).mean(axis=1) for t in spectra], axis=0).T)
        covariance, freedom, pooled = _between([b[0] for b in blocks], response, size, excited)
    words = "; ".join(dict.fromkeys(t.method for t in spectra))
    numbers = {"periods": float(spectra[0].signals.shape[1]), "period_s": 1.0 / float(f[1])}
    if len(blocks) > 1:
        words, numbers = f"{words}, {len(blocks)} realisations", numbers | {"realisations": float(len(blocks))}
    return Answers(
        frequency_hz=f,
        response=response,
        covariance=covariance,
        power=np.mean([_power(t) for t in spectra], axis=0),
        excited=excited,
        averages=float(sum(t.signals.shape[1] for t in spectra)),
        power_per="line",
        line_overlap=1.0,
        freedom=freedom,
        pooled=pooled,
        method=words,
        method_numbers=numbers,
        noise=noise if len(blocks) > 1 else None,
        notes=tuple(dict.fromkeys(note for t in spectra for note in t.notes)),
    )


def _let_through(
    recording: Recording, signals: Sequence[Array], instruments: Sequence[Array]
) -> Callable[[ComplexArray], Array] | None:
    """What a closed loop lets through of its noise to output and plant input, |S|, from what they answer to the
    instrument; None for other recordings, where nothing tells."""
    if not recording.info.closed_loop or recording.info.injection == "control":
        return None
    if len(signals) != 2 or len(instruments) != 1:
        return None
    at_input = recording.info.injection == "plant_input"
    return lambda H: np.repeat(np.abs(H[:, 1:] if at_input else 1.0 - H[:, :1])[:, :, 0], 2, axis=1)


def _block(
    spectra: Sequence[Transforms], m: int, excited: np.ndarray, shape: Shape | None
) -> tuple[ComplexArray, ComplexArray]:
    """Response (nf, m, nr) of one block, and its noise's covariance; noise is pooled over neighbouring lines."""
    means = np.stack([t.signals.mean(axis=1).T for t in spectra], axis=-1)  # (nf, m + nr, recordings)
    X, R = means[:, :m], means[:, m:]
    inverse = np.full_like(R, np.nan)
    with np.errstate(all="ignore"):
        size = np.maximum(np.linalg.norm(R[excited], axis=2, keepdims=True), 1e-300)  # each instrument in its own unit
        if R.shape[1] > 1 and (condition := np.median(np.linalg.cond(R[excited] / size))) > 1e3:
            raise BadSignalError(
                "the instruments of a block's recordings cannot be separated",
                f"condition {condition:.2g}",
                "excite one loop at a time, or all by orthogonal multisines",
            )
        inverse[excited] = np.linalg.inv(R[excited])
        H = X @ inverse
        size = m * R.shape[1]
        level = np.ones((H.shape[0], m))
        if shape is not None:
            tiny = 1e-9  # the least level of noise, as a share of what enters the loop
            level[excited] = np.maximum(shape(H[excited]), tiny)
        both = level[:, :, None] * level[:, None, :]
        covariance = np.zeros((H.shape[0], size, size), dtype=complex)
        for row, t in enumerate(spectra):
            k = t.signals.shape[1]
            E = t.signals[:m] - np.einsum("fab,bkf->akf", H, t.signals[m:])
            E = E - E.mean(axis=1, keepdims=True)
            scatter = np.einsum("akf,bkf->fab", E, E.conj()) / (k - 1) / k
            scatter = _pooled(scatter / both, 2.0 * (k - 1), excited) * both
            weight = np.einsum("fj,fk->fjk", inverse[:, row], inverse[:, row].conj())
            covariance += np.einsum("fjk,fab->fjakb", weight, scatter).reshape(covariance.shape)
    return H, covariance


def _lines_pooled(each: float) -> int:
    """Over how many neighbouring lines a variance of `each` degrees of freedom is averaged, to have some forty."""
    return 2 * (int(np.ceil(TOL.variance_freedom / each)) // 2) + 1


def _pooled(power: ComplexArray, each: float, excited: np.ndarray) -> ComplexArray:
    """A power (nf, n, n) averaged over neighbouring excited lines until it has some forty degrees of freedom."""
    out = np.array(power)
    out[excited] = smoothed(out[excited], _lines_pooled(each) // 2)
    return out


def _between(
    responses: Sequence[ComplexArray], mean: ComplexArray, size: Array, excited: np.ndarray
) -> tuple[ComplexArray, float, int]:
    """Covariance of the mean from the scatter between realisations, noise and distortion together.

    It is pooled as the scatter of what the instruments' `size` (nf, nr) makes of it: the excitation may differ between
    neighbours, what a machine adds to its answer hardly does.
    """
    count = len(responses)
    weight = np.repeat(size, mean.shape[1], axis=1)  # of vec, columns stacked
    d = (np.stack(responses) - mean).transpose(1, 0, 3, 2).reshape(mean.shape[0], count, -1) * weight[:, None]
    each = 2.0 * (count - 1)
    scatter = _pooled(np.einsum("fka,fkb->fab", d, d.conj()) / (count - 1) / count, each, excited)
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = scatter / (weight[:, :, None] * weight[:, None, :])
    return covariance, each * _lines_pooled(each), _lines_pooled(each)


def _power(t: Transforms) -> ComplexArray:
    """Cross-powers (nf, s, s) of all signals, per line."""
    return np.asarray(np.einsum("akf,bkf->fab", t.signals, t.signals.conj()) * (t.density / t.signals.shape[1]))
