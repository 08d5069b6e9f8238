"""Sweeps in a known closed loop, the known estimators on the same records, and how many errors intervals hold.

The truth needs nothing of loopshape: the loop is run by its difference equation, the plant is that equation's response.
"""

from collections.abc import Callable

import numpy as np
from bench_nouns import LoopSetup, RecordingInfo
from conversions import TWO_PI, Array, ComplexArray
from scipy.signal import cont2discrete, csd, freqz, lfilter
from scipy.stats import f as f_distribution

import loopshape as ls

LOW, HIGH = 0.5, 80.0
Truth = Callable[[Array, float], ComplexArray]
LOOP = LoopSetup("axis", "r_rad", "n_rad", "z_v", "y_rad", None)


def loop(rate_hz: float) -> tuple[Array, Array, Array, Array]:
    """B, A of the plant: 3 Hz lag, zeros at 10 and poles at 14 Hz of damping 0.02, two samples; D, F of a PI."""
    a, b = TWO_PI * 10.0, TWO_PI * 14.0
    numerator = np.polymul([1.0 / a**2, 0.04 / a, 1.0], [2.0])
    denominator = np.polymul([1.0 / (TWO_PI * 3.0), 1.0], [1.0 / b**2, 0.04 / b, 1.0])
    B, A, _ = cont2discrete((numerator, denominator), 1.0 / rate_hz)
    D, F, _ = cont2discrete(([1.2 / (TWO_PI * 4.0), 1.2], [1.0 / (TWO_PI * 4.0), 0.0]), 1.0 / rate_hz, "bilinear")
    return np.pad(np.ravel(B), (2, 0)), A, np.ravel(D), F


def plant(f_hz: Array, rate_hz: float) -> ComplexArray:
    """The truth."""
    B, A, _, _ = loop(rate_hz)
    return np.asarray(freqz(B, A, worN=TWO_PI * f_hz / rate_hz)[1])


def sweep(seconds: float, rate_hz: float, spacing: str, both_ways: bool) -> Array:
    """A sine of amplitude 1 from 0.5 to 80 Hz, and back if asked, without ramps."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    end = 0.5 * seconds if both_ways else seconds

    def cycles(x: Array) -> Array:
        if spacing == "linear":
            return LOW * x + 0.5 * (HIGH - LOW) * x**2 / end
        growth = np.log(HIGH / LOW) / end
        return np.asarray(LOW * np.expm1(growth * x) / growth)

    there, back = cycles(np.minimum(t, end)), 2.0 * cycles(np.array(end)) - cycles(2.0 * end - t)
    return np.asarray(np.sin(TWO_PI * np.where(t > end, back, there)))


def run_loop(place: str, n: Array, v: Array, rate_hz: float) -> tuple[Array, Array]:
    """z and y with n at `place` and v on the sensor."""
    B, A, D, F = loop(rate_hz)
    into = -v if place == "plant_input" else n - v
    own, around = np.convolve(A, F), np.convolve(B, D)
    closed = np.pad(own, (0, around.size - own.size)) + around
    z, y = lfilter(np.convolve(D, A), closed, into), lfilter(around, closed, into) + v
    if place == "plant_input":
        z, y = z - lfilter(around, closed, n), y + lfilter(np.convolve(B, F), closed, n)
    return z, y


def measured(place: str, n: Array, rate_hz: float, seed: int, drift: float) -> ls.Recording:
    """A recording with noise 40 dB below the output's rms, and a drift of that rms times `drift`."""
    clean = float(run_loop(place, n, np.zeros(n.size), rate_hz)[1].std())
    t = np.linspace(-0.5, 0.5, n.size)
    v = 0.01 * clean * np.random.default_rng(seed).standard_normal(n.size)
    z, y = run_loop(place, n, v + drift * clean * (t + 0.3 * np.sin(7.0 * t)), rate_hz)
    columns = {"z_v": z, "y_rad": y, "r_rad": np.zeros(n.size), "n_rad": n}
    return ls.Recording(RecordingInfo("r1.parquet", "sweep", place, excites="axis"), rate_hz, columns)


#: numerator and denominator of a plant in open loop, by powers of 1/z (case V6)
IN_ARRAYS = np.array([0.02, 0.02]), np.array([1.0, -1.9, 0.94])


def easy_plant(f_hz: Array, rate_hz: float) -> ComplexArray:
    """The truth of `in_arrays`."""
    return np.asarray(freqz(*IN_ARRAYS, worN=TWO_PI * f_hz / rate_hz)[1])


def in_arrays(n: Array, rate_hz: float, seed: int) -> tuple[ls.Run, dict[str, float]]:
    """A sweep n as arrays alone, which say nothing of its kind, with noise of 1 %, and the errors of the peers."""
    y = lfilter(*IN_ARRAYS, n)
    y = y + 0.01 * y.std() * np.random.default_rng(seed).standard_normal(n.size)
    run = ls.Run.from_arrays(u=n, y=y, rate_hz=rate_hz)
    return run, _peer_errors(n, n, y, rate_hz, easy_plant)


def peer_errors(record: ls.Recording, place: str) -> dict[str, float]:
    """Median error of each known estimator: whole-record ratios and Welch's against the injection, and Welch's H1."""
    n, z, y = (record.column(k) for k in ("n_rad", "z_v", "y_rad"))
    return _peer_errors(n, z + n if place == "plant_input" else z, y, record.rate_hz, plant)


def _peer_errors(n: Array, u: Array, y: Array, rate: float, truth: Truth) -> dict[str, float]:
    N, U, Y = (np.fft.rfft(x - x.mean()) for x in (n, u, y))
    f, found = np.fft.rfftfreq(n.size, 1.0 / rate), {}
    for lines in (1, 5, 15, 45, 161, 501):
        ones = np.ones(lines)
        P = np.convolve(Y * N.conj(), ones, "same") / np.convolve(U * N.conj(), ones, "same")
        found[f"whole record, {lines} lines"] = median_error(f, P, rate, truth)
    for seconds in (1.0, 2.0, 4.0):
        length = round(seconds * rate)
        g, (ny, nu, uy, uu) = spectra(((n, y), (n, u), (u, y), (u, u)), rate, length)
        found[f"Welch, injection, {seconds:g} s"] = median_error(g, ny / nu, rate, truth)
        found[f"Welch, H1, {seconds:g} s"] = median_error(g, uy / uu, rate, truth)
    return found


def spectra(pairs: tuple[tuple[Array, Array], ...], rate_hz: float, length: int) -> tuple[Array, list[ComplexArray]]:
    """Cross-spectra of pairs, Hann, 75 % overlap."""
    all_of_them = [csd(a, b, rate_hz, "hann", length, 3 * length // 4) for a, b in pairs]
    return all_of_them[0][0], [x[1] for x in all_of_them]


def median_error(f_hz: Array, P: ComplexArray, rate_hz: float, truth: Truth = plant) -> float:
    """Median relative error within the band."""
    inside = (f_hz > LOW) & (f_hz < HIGH)
    return float(np.median(np.abs(P[inside] / truth(f_hz[inside], rate_hz) - 1.0)))


def share_inside(frf: ls.FRF, rate_hz: float, gain: float = 1.0, truth: Truth = plant) -> float:
    """Share of errors, from the plant times `gain`, within 95 % of an F distribution with the stated freedom."""
    error = np.abs(frf.siso - gain * truth(frf.frequency_hz, rate_hz)) ** 2
    reach = f_distribution.ppf(0.95, 2, frf.variance_freedom)
    return float(np.mean(error < reach * frf.variance[:, 0, 0]))
