"""Known loops for tests of predictions: a resonant arm, two controllers, FRFs of known spread, periodic recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bench_nouns import Block, LoopSetup, RecordingInfo, TransferFunction
from conversions import TWO_PI, Array, ComplexArray

import loopshape as ls
from loopshape.data.algebra import feedback

RATE_HZ = 1000.0
OLD = ls.Controller("a", (Block("gain", {"gain": 0.5}),), RATE_HZ)
NEW = ls.Controller(
    "a",
    (
        Block("gain", {"gain": 12.2}),
        Block("lead_lag", {"f1_hz": 1.62, "f2_hz": 20.0}),
        Block("notch", {"f1_hz": 4.27, "f2_hz": 4.27, "damping1": 0.072, "damping2": 5.6}),
        Block("low_pass_2", {"f_hz": 9.1, "damping": 0.33}),
    ),
    RATE_HZ,
)


def arm(f_hz: float = 5.0, zeta: float = 0.064, kappa: float = 1350.0) -> TransferFunction:
    """kappa/(s³ + 2 zeta w s² + w² s)."""
    w = TWO_PI * f_hz
    return TransferFunction(np.array([kappa]), np.array([1.0, 2.0 * zeta * w, w * w, 0.0]))


def errors(rng: np.random.Generator, lines: int, overlap: float) -> ComplexArray:
    """Circular errors (lines,) of variance 1; with an overlap of 1.94 correlated as those of Hann segments are."""
    white = (rng.standard_normal(lines + 2) + 1j * rng.standard_normal(lines + 2)) / np.sqrt(2.0)
    if overlap == 1.0:
        return np.asarray(white[1:-1])
    return np.asarray((0.5 * white[1:-1] - 0.25 * white[:-2] - 0.25 * white[2:]) / np.sqrt(0.375))


def measured(
    rng: np.random.Generator, f: Array, P: ComplexArray, relative: float | Array, held: ls.Controller,
    *, overlap: float = 1.0, averages: int = 0, pooled: int = 1,
) -> ls.FRF:  # fmt: skip
    """A plant's FRF with relative errors: variance known (no averages), or from the scatter of so many, pooled."""
    e, variance, freedom = errors(rng, f.size, overlap), np.ones(f.size), np.inf
    if averages:
        every = np.array([errors(rng, f.size, overlap) for _ in range(averages)])
        e, variance = every.mean(0) * np.sqrt(averages), every.var(0, ddof=1)
        padded = np.pad(variance, pooled // 2, mode="reflect")
        variance = np.convolve(padded, np.ones(pooled) / pooled, mode="valid")
        freedom = 2.0 * (averages - 1) * pooled / (overlap if pooled > 1 else 1.0)
    std = relative * np.abs(P)
    covariance = (std**2 * variance)[:, None, None].astype(complex)
    return ls.FRF(
        f, (P + std * e)[:, None, None], covariance, np.ones(f.size, dtype=bool),
        ("z_a_v",), ("a_rad",), "made", recording="made", loop="a", rate_hz=RATE_HZ, line_overlap=overlap,
        variance_freedom=freedom, variance_pooled=pooled, recorded_under=held,
    )  # fmt: skip


def predicted(plant: ls.FRF, controller: ls.Controller = NEW) -> ls.Prediction:
    """What an FRF predicts of S under a controller, without a step."""
    S = replace(feedback(plant, controller).S_o, recorded_under=controller, loop="a")
    return ls.Prediction(S, "stable")


SETUP = LoopSetup("a", "r_a_rad", "n_a_rad", "z_a_v", "a_rad", NEW)


def recording(
    rng: np.random.Generator, plant: TransferFunction, controller: ls.Controller, noise: float, *,
    injection: str = "controller_input", periods: int = 8, period_s: float = 4.0, name: str = "m",
) -> ls.Recording:  # fmt: skip
    """A loop in steady state under a multisine of 0.25 to 20 Hz, with white noise of deviation `noise` on its output.

    Made by transforms, so that nothing leaks.
    """
    rate_hz = controller.rate_hz
    n = round(period_s * rate_hz)
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    lines = (f > 0.0) & (f <= 20.0)
    N = np.zeros(f.size, dtype=complex)
    N[lines] = np.exp(1j * TWO_PI * rng.random(int(lines.sum())))
    injected = np.tile(np.fft.irfft(N, n) / np.fft.irfft(N, n).std() * 0.05, periods)
    v = noise * rng.standard_normal(injected.size)
    every = np.fft.rfftfreq(injected.size, 1.0 / rate_hz)
    inside = (every > 0.0) & (every < 0.5 * rate_hz)
    C, P = np.zeros(every.size, dtype=complex), np.zeros(every.size, dtype=complex)
    C[inside], P[inside] = controller.response(every[inside]), plant.response(every[inside])
    S, n_of, v_of = 1.0 / (1.0 + C * P), np.fft.rfft(injected), np.fft.rfft(v)
    drive = n_of if injection == "plant_input" else C * n_of
    Y = S * (P * drive + v_of)
    y = np.fft.irfft(Y, injected.size)
    E = -Y if injection == "plant_input" else n_of - Y
    z = np.fft.irfft(C * E, injected.size)
    columns = {"n_a_rad": injected, "r_a_rad": np.zeros(injected.size), "z_a_v": z, "a_rad": y}
    if injection == "reference":
        columns |= {"r_a_rad": injected, "n_a_rad": np.zeros(injected.size)}
    if injection == "plant_input":
        columns = {("n_a_v" if k == "n_a_rad" else k): x for k, x in columns.items()}
    info = RecordingInfo(f"{name}.parquet", "multisine", injection, excites="a", period_s=period_s, periodic_from_s=0.0)
    return ls.Recording(info, rate_hz, columns)
