"""Known plants, the loops around them, and recordings of both; signs and places as drawn in `loop.loop`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, cont2discrete, freqz, lfilter

from loopshape.core.units import TWO_PI, Array, ComplexArray
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.data.signal.run import Run

RATE_HZ = 100.0
#: samples run before a recording begins: a plant with a damping of 0.02 at 5 Hz then rings at 1e-5
BEFORE = 2000
LOOP = LoopSetup("axis", "r_rad", "n_rad", "z_v", "y_rad", None)
#: controller of the closed loops: a gain with a lead of 0.03 s
LEAD = 0.03 * RATE_HZ
PEAK = 2.0


@dataclass(frozen=True, eq=False)
class Plant:
    """A discrete plant B/A, and the controller D that closes its loop; without a controller the loop is open."""

    B: Array
    A: Array
    D: Array | None = None

    def response(self, f_hz: Array) -> ComplexArray:
        """Response (nf,)."""
        return np.asarray(freqz(self.B, self.A, worN=TWO_PI * np.asarray(f_hz) / RATE_HZ)[1])

    def run(self, place: str, n: Array, v: Array) -> tuple[Array, Array]:
        """z and y (..., samples) with n at `place` and v on the sensor; `control` drives the plant itself."""
        if place == "control" or self.D is None:
            return n, np.asarray(lfilter(self.B, self.A, n)) + v
        loop, between = np.convolve(self.B, self.D), added(self.A, np.convolve(self.B, self.D))
        into = (0.0 if place == "plant_input" else n) - v
        z, y = lfilter(np.convolve(self.D, self.A), between, into), lfilter(loop, between, into) + v
        if place == "plant_input":
            z, y = z - lfilter(loop, between, n), y + lfilter(self.B, between, n)
        return np.asarray(z), np.asarray(y)


def added(p: Array, q: Array) -> Array:
    """Sum of two polynomials in z^-1."""
    size = max(p.size, q.size)
    return np.pad(p, (0, size - p.size)) + np.pad(q, (0, size - q.size))


def mode(f_hz: float, damping: float) -> tuple[Array, Array]:
    """B and A of one resonance of static gain 1, behind a hold."""
    w = TWO_PI * f_hz
    B, A, _ = cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / RATE_HZ)
    return np.asarray(B).ravel(), np.asarray(A)


def one_resonance(damping: float) -> Plant:
    """A resonance at 5 Hz."""
    return Plant(*mode(5.0, damping))


def two_resonances(damping: float) -> Plant:
    """Resonances at 5 and 9 Hz with an antiresonance between them, and a delay of three samples."""
    (b1, a1), (b2, a2) = mode(5.0, damping), mode(9.0, damping)
    B = added(np.convolve(b1, a2), 0.5 * np.convolve(b2, a1))
    return Plant(np.concatenate([np.zeros(3), B]), np.convolve(a1, a2))


def closed(plant: Plant) -> Plant:
    """The same plant with the controller whose sensitivity peaks at 2: as much feedback as the plant bears."""
    f = np.geomspace(0.1, 0.499 * RATE_HZ, 4000)
    shape = np.array([1.0 + LEAD, -LEAD])
    L = plant.response(f) * freqz(shape, [1.0], worN=TWO_PI * f / RATE_HZ)[1]
    kept = 0.0
    for gain in np.geomspace(1e-4, 10.0, 400):
        poles = np.roots(added(plant.A, gain * np.convolve(plant.B, shape)))
        if np.abs(poles).max() > 0.9999 or np.abs(1.0 / (1.0 + gain * L)).max() > PEAK:
            break
        kept = gain
    return Plant(plant.B, plant.A, kept * shape)


def white(rng: np.random.Generator, *shape: int) -> Array:
    """White noise."""
    return rng.standard_normal(shape)


def coloured(rng: np.random.Generator, *shape: int) -> Array:
    """Noise of variance 1 between 3 and 8 Hz, over a floor 20 dB lower."""
    b, a = butter(2, [3.0, 8.0], "bandpass", fs=RATE_HZ)
    v = lfilter(b, a, white(rng, *shape)) + 0.03 * white(rng, *shape)
    return np.asarray(v / v.std())


def noise_records(
    plant: Plant,
    place: str,
    seconds: float,
    snr_db: float,
    records: int,
    seed: int,
    noise: Callable[..., Array] = white,
) -> list[Recording]:
    """Recordings of white-noise excitation, cut out of a longer run; `snr_db` is that of the output's rms."""
    rng = np.random.default_rng(seed)
    shape = (records, BEFORE + round(seconds * RATE_HZ))
    n = white(rng, *shape)
    level = plant.run(place, n, np.zeros(shape))[1].std() * 10.0 ** (-snr_db / 20.0)
    z, y = plant.run(place, n, level * noise(rng, *shape))
    return [recording(place, "noise", *(x[BEFORE:] for x in one)) for one in zip(n, z, y, strict=True)]


def recording(place: str, kind: str, n: Array, z: Array, y: Array, **said: object) -> Recording:
    """A recording of one loop."""
    info = RecordingInfo("r.parquet", kind, place, excites="axis", closed_loop=place != "control", **said)  # type: ignore[arg-type]
    columns = {"z_v": z, "y_rad": y}
    return Recording(info, RATE_HZ, columns if place == "control" else columns | {"n_rad": n})


# --- two inputs, two outputs -----------------------------------------------------------------------------------------

#: x+ = A2 x + B2 u, y = C2 x: a resonance at 5 Hz (damping 0.05) and two real poles, each output fed by both inputs
_TURN = np.exp(-0.05 * np.pi / 10) * np.array(
    [[np.cos(np.pi / 10), -np.sin(np.pi / 10)], [np.sin(np.pi / 10), np.cos(np.pi / 10)]]
)
A2 = np.block([[_TURN, np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([0.9, 0.6])]])
B2 = np.array([[0.05, 0.02], [0.0, 0.03], [0.1, 0.15], [0.05, 0.3]])
C2 = np.array([[0.5, 0.3, 0.6, 0.0], [-0.2, 0.1, 0.2, 0.5]])
GAINS = np.array([0.8, 0.6])


def matrix_response(f_hz: Array) -> ComplexArray:
    """Response (nf, 2, 2)."""
    z = np.exp(1j * TWO_PI * np.asarray(f_hz) / RATE_HZ)
    return np.asarray(C2 @ np.linalg.solve(z[:, None, None] * np.eye(4) - A2, B2.astype(complex)))


def matrix_signals(place: str, n: Array, v: Array) -> tuple[Array, Array]:
    """z and y (records, samples, 2) with n at `place` and v on the sensors; `control` leaves both loops open."""
    x, z, y = np.zeros((len(n), 4)), np.empty_like(v), np.empty_like(v)
    for k in range(n.shape[1]):
        y[:, k] = x @ C2.T + v[:, k]
        z[:, k] = n[:, k] if place == "control" else GAINS * ((place == "controller_input") * n[:, k] - y[:, k])
        u = z[:, k] + (place == "plant_input") * n[:, k]
        x = x @ A2.T + u @ B2.T
    return z, y


def matrix_loops() -> tuple[LoopSetup, ...]:
    """Both loops of the matrix."""
    return tuple(LoopSetup(f"l{k}", None, f"n{k}_rad", f"z{k}_v", f"y{k}_rad", None) for k in (0, 1))


def matrix_run(
    place: str, kind: str, parts: Sequence[tuple[tuple[int, ...], Array, Array, Array]], **said: object
) -> Run:
    """A run of recordings; each part is which loops it excites, and its n, z, y (samples, 2)."""
    made = []
    for number, (excited, n, z, y) in enumerate(parts):
        first, *others = (f"l{k}" for k in excited)
        info = RecordingInfo(
            f"r{number}.parquet", kind, place, excites=first, excites_also=tuple(others),
            closed_loop=place != "control", **said,  # type: ignore[arg-type]
        )  # fmt: skip
        columns = {f"z{k}_v": z[:, k] for k in (0, 1)} | {f"y{k}_rad": y[:, k] for k in (0, 1)}
        columns |= {f"n{k}_rad": n[:, k] for k in (0, 1)}
        made.append(Recording(info, RATE_HZ, columns))
    return Run(RATE_HZ, matrix_loops(), made)
