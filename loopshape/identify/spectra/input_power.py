"""Lines on which the inputs say nothing: too little power, or one input that only repeats another.

A line counts for an input by the power that the other inputs do not explain there, 1/[S^-1]_ii (Bendat and Piersol,
Random Data, 4th ed. 2010, 9.2: the conditioned spectrum): small where the input is, and where the inputs' cross-power
matrix is nearly singular. It is compared with the strongest line of the same input.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray

#: power below the input's strongest line of which is nothing: the noise of a 12-bit converter that is driven fully
#: lies 74 dB below the signal's whole power
FLOOR = 10.0**-7.5
#: share of an input's power at a line that is its own, not the others'; at less, errors grow by a factor of thirty
OWN_SHARE = 1e-3


@dataclass(frozen=True)
class UnfedBand:
    """A band, its ends included, on which inputs (counted from 0) are too weak; `level_db` is the strongest line there.

    `level_db` is relative to the same input's strongest line, of power that other inputs do not explain.
    """

    low_hz: float
    high_hz: float
    inputs: tuple[int, ...]
    level_db: float
    sentence: str


def own_power(power: ComplexArray) -> tuple[Array, Array]:
    """Power (nf, nu) that other inputs do not explain, and its share, from cross-powers (nf, nu, nu) of inputs.

    Of K averages q - 1 others explain (q - 1)/K by chance; with K below q the share is rounding, and the matrix is of
    no use.
    """
    power = np.asarray(power)
    if power.ndim != 3 or power.shape[1] != power.shape[2]:
        raise WrongUseError("cross-powers of inputs are (frequencies, inputs, inputs)", f"{power.shape}")
    level = np.real(np.einsum("fii->fi", power))
    share = np.zeros_like(level)
    ok = (level > 0.0).all(axis=1)
    scale = np.sqrt(level[ok])
    alike = power[ok] / (scale[:, :, None] * scale[:, None, :]) + 1e-13 * np.eye(power.shape[1])
    share[ok] = 1.0 / np.maximum(np.real(np.einsum("fii->fi", np.linalg.inv(alike))), 1.0)
    return level * share, share


def powered(power: ComplexArray, leaks: bool = True) -> np.ndarray:
    """Lines (nf,) on which every input has power of its own, from cross-powers (nf, nu, nu) of the inputs.

    Every input's own power must exceed `FLOOR` of its strongest line's, and `OWN_SHARE` of its power there. `leaks`
    says that the powers are those of Hann segments, all lines from 0 Hz on: lines are then refused that live on what
    leaks from others. A line that passes is fed, not known: that is for its variance to say. Where one line (a strong
    sine) outshines an excitation 75 dB lower that would do, this refuses too much.
    """
    return np.asarray(_fed(power, leaks).all(axis=1))


def _fed(power: ComplexArray, leaks: bool) -> np.ndarray:
    """(nf, nu): which input feeds which line."""
    own, share = own_power(power)
    fed = (own > FLOOR * own.max(axis=0)) & (share > OWN_SHARE)
    if not leaks:
        return np.asarray(fed)
    level = np.real(np.einsum("fii->fi", np.asarray(power)))
    for k in range(fed.shape[1]):
        fed[:, k] = _without_smear(fed[:, k] & (level[:, k] > 2.0 * _leaked(level[:, k])), level[:, k])
    return np.asarray(fed)


def _leaked(level: Array) -> Array:
    """Power (nf,) that a Hann window brings to each line of a spectrum (nf,) of noise from two and more lines away.

    The window's transform at d lines falls as 1/(d (d² - 1)), squared, half of it in the mean over d's fraction.
    """
    d = np.arange(2, max(level.size, 3))
    side = 0.5 / (np.pi * d * (d**2 - 1.0)) ** 2 / 1.5
    kernel = np.concatenate([side[::-1], np.zeros(3), side])
    mirrored = np.concatenate([level[:0:-1], level, level[-2::-1]])  # a real signal's other half
    fast = next_fast_len(mirrored.size + kernel.size - 1, real=True)
    first = (kernel.size - 1) // 2 + level.size - 1
    out = irfft(rfft(mirrored, fast) * rfft(kernel, fast), fast)[first : first + level.size]
    return np.maximum(out, 0.0)


def _without_smear(fed: np.ndarray, power: Array) -> np.ndarray:
    """Fed lines (nf,) without those at the ends of a stretch that a window's main lobe put there: two each at most.

    Such a line lies 5 dB or more below its neighbour within the stretch.
    """
    out = fed.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fed.astype(int), [0]])))
    # a line at the end of a fed stretch that is weaker than this share of its inner neighbour is that one's
    # side
    smear = 0.3
    for start, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        for outer, inwards in ((start, 1), (end - 1, -1)):
            for k in (outer, outer + inwards):
                if not start <= k + inwards < end or power[k] > smear * power[k + inwards]:
                    break
                out[k] = False
    return np.asarray(out)


def unfed_bands(
    frequency_hz: Array, power: ComplexArray, names: tuple[str, ...] = (), least: int = 3, leaks: bool = True
) -> list[UnfedBand]:
    """Bands of `least` lines or more on which an input is too weak, from power (nf, nu) or cross-powers (nf, nu, nu).

    For spectra of noise and sweeps: of a multisine, hand in the lines that it excites. A band says its inputs and how
    weak they are.
    """
    power = np.asarray(power)
    if power.ndim == 2:
        power = np.einsum("fi,ij->fij", power, np.eye(power.shape[1]))
    fed = _fed(power, leaks)
    own, _ = own_power(power)
    names = names or tuple(f"input {k + 1}" for k in range(power.shape[1]))
    edges = np.flatnonzero(np.diff(np.concatenate([[1], fed.all(axis=1).astype(int), [1]])))
    out = []
    for start, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if end - start < least:
            continue
        weak = tuple(int(k) for k in np.flatnonzero(~fed[start:end].all(axis=0)))
        with np.errstate(divide="ignore", invalid="ignore"):
            level = float(10.0 * np.log10((own[start:end] / own.max(axis=0)).max(axis=0)[list(weak)].max()))
        low, high = float(frequency_hz[start]), float(frequency_hz[end - 1])
        words = (
            f"no power of its own in {' and '.join(names[k] for k in weak)} from {low:.4g} to {high:.4g} Hz"
            f" ({level:.0f} dB at best, of the strongest frequency): these frequencies are refused; excite there,"
            " or end the band below"
        )
        out.append(UnfedBand(low, high, weak, level, words))
    return out
