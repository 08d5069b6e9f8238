"""The simulated tensile bench: records of length and pull, their response, k_w and d_w with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from h1_h2 import TwoEstimates, h1_h2
from muscle_law import Muscle, pulls

from loopshape.core.units import Array, angular
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.identify.settings import Settings
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.rig.excitation.excitation import BandNoise

LOOP = LoopSetup("muscle", None, None, "h_m", "pull_n", None)


@dataclass(frozen=True)
class Bench:
    """How the bench measures."""

    rate_hz: float
    resolution_hz: float
    noise_from_hz: float
    position_rms_mm: float
    position_noise_um: float
    pull_noise_n: float
    seed: int

    @classmethod
    def of(cls, words: Mapping[str, float]) -> Bench:
        """From the settings' table."""
        return cls(**{**words, "seed": int(words["seed"])})  # type: ignore[arg-type]


@dataclass(frozen=True)
class SpringDamper:
    """k_w in N/m and d_w in N s/m of one working point, with standard deviations."""

    k: float
    d: float
    k_std: float
    d_std: float

    def response(self, frequency_hz: Array) -> Array:
        """k + j 2 pi f d (G.4)."""
        return np.asarray(self.k + 1j * angular(frequency_hz) * self.d)


def record(bench: Bench, law: str, p_bar: float, h_m: float, seed: int, one: Muscle | None = None) -> Recording:
    """One record: noise on the length, valves closed; the sensors' noise comes on top."""
    noise = BandNoise(
        bench.noise_from_hz, value("bench.noise_limit"), value("bench.duration"), 1e-3 * bench.position_rms_mm, seed
    )
    moved = noise.signal(bench.rate_hz)
    h, dh = h_m + moved, _derivative(moved, bench.rate_hz)
    rng = np.random.default_rng([seed, 1])
    columns = {
        "h_m": h + 1e-6 * bench.position_noise_um * rng.standard_normal(h.size),
        "pull_n": pulls(law, p_bar, h_m, h, dh, one) + bench.pull_noise_n * rng.standard_normal(h.size),
    }
    point = {"h_mm": 1e3 * h_m, "p_bar": p_bar}
    name = f"h{1e3 * h_m:.0f}_p{100.0 * p_bar:03.0f}_{seed}.csv"
    info = RecordingInfo(name, "noise", "control", excites="muscle", closed_loop=False, operating_point=point)
    return Recording(info, bench.rate_hz, columns)


def _derivative(x: Array, rate_hz: float) -> Array:
    """Of a signal that begins and ends at rest."""
    f = np.fft.rfftfreq(x.size, 1.0 / rate_hz)
    return np.asarray(np.fft.irfft(1j * angular(f) * np.fft.rfft(x), x.size))


def measure(bench: Bench, law: str, p_bar: float, h_m: float, seed: int, one: Muscle | None = None) -> TwoEstimates:
    """H1 and H2 of one working point from all its records."""
    records = [record(bench, law, p_bar, h_m, seed + n, one) for n in range(int(value("bench.records")))]
    return h1_h2(records, LOOP, Settings(method="welch", resolution_hz=bench.resolution_hz))


def spring_damper(frf: FRF) -> SpringDamper:
    """Weighted least squares of k + j 2 pi f d up to the source's 10 Hz; neighbouring Hann lines correlate."""
    frf = frf.select(frf.valid & (frf.frequency_hz <= value("bench.fit_to")))
    w, omega = 2.0 / frf.variance[:, 0, 0], angular(frf.frequency_hz)
    k_weight, d_weight = float(w.sum()), float((w * omega**2).sum())
    return SpringDamper(
        k=float((w * frf.siso.real).sum() / k_weight),
        d=float((w * omega * frf.siso.imag).sum() / d_weight),
        k_std=float(np.sqrt(frf.line_overlap / k_weight)),
        d_std=float(np.sqrt(frf.line_overlap / d_weight)),
    )


def reliable_to_hz(both: TwoEstimates, least: float) -> float:
    """First line above 1 Hz at which the coherence falls below `least`."""
    f = both.h1.frequency_hz
    return float(f[(f > 1.0) & (both.coherence < least)][0])
