"""How accurate: local fits and the automatic choice against Welch's best setting, with the truth known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from known import LOOP, RATE_HZ, Plant, closed, coloured, noise_records, one_resonance, two_resonances, white
from scipy.fft import next_fast_len

from loopshape.core.kernels.spectra import hann
from loopshape.core.units import Array, ComplexArray
from loopshape.data.signal.recording import Recording
from loopshape.identify.frequency_response import estimate_frf
from loopshape.identify.settings import Settings

DAMPINGS, SECONDS, SNRS_DB = (0.02, 0.05, 0.1, 0.2, 0.5), (20.0, 60.0, 120.0), (20.0, 40.0, 60.0)
#: errors are taken here, by straight lines between an estimate's own lines: a resonance between them is missed
GRID_HZ = np.arange(1.0, 15.0, 0.02)
#: Welch's segments are padded with zeros to this many times their length
PADDED = 4
#: longer records, which Welch's method needs for the accuracy of a local fit
LONGER_S = (240.0, 480.0)
PLANTS: dict[str, Callable[[float], Plant]] = {"one": one_resonance, "two": two_resonances}
NOISES = {"white": white, "coloured": coloured}
COLUMNS = (
    "plant", "loop", "noise", "damping", "seconds", "snr_db", "measure", "best_welch", "best_segment_s", "local",
    "auto", "local_over_best", "auto_over_best", "spread", "welch_seconds_for_local", "auto_took_local",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One point of the grid."""

    plant: str
    loop: str
    noise: str
    damping: float
    seconds: float
    snr_db: float
    records: int

    def truth(self) -> Plant:
        """The plant, with its controller where the loop is closed."""
        made = PLANTS[self.plant](self.damping)
        return closed(made) if self.loop == "closed" else made

    def recordings(self) -> list[Recording]:
        """The case's recordings; the seed follows from the case."""
        place = "controller_input" if self.loop == "closed" else "control"
        seed = [*self.plant.encode(), *self.loop.encode(), *self.noise.encode()]
        seed += [round(1000 * self.damping), round(self.seconds), round(self.snr_db)]
        return noise_records(self.truth(), place, self.seconds, self.snr_db, self.records, seed, NOISES[self.noise])  # type: ignore[arg-type]


def cases() -> Iterator[Case]:
    """The whole grid for one plant in open and the other in closed loop; its corners for the rest."""
    for plant, loop in (("one", "open"), ("two", "closed")):
        for at in product(DAMPINGS, SECONDS, SNRS_DB):
            yield Case(plant, loop, "white", *at, records=3)
    for kind in (("one", "closed", "white"), ("two", "open", "white"), ("one", "open", "coloured")):
        for at in product(DAMPINGS[::2], SECONDS[::2], SNRS_DB[::2]):
            yield Case(*kind, *at, records=2)


def errors(f_hz: Array, response: ComplexArray, truth: Plant) -> Array:
    """Mean squared relative error and mean squared error over mean squared gain, (2,)."""
    G = truth.response(GRID_HZ)
    d = np.interp(GRID_HZ, f_hz, response.real) + 1j * np.interp(GRID_HZ, f_hz, response.imag) - G
    return np.array([np.mean(np.abs(d / G) ** 2), np.mean(np.abs(d) ** 2) / np.mean(np.abs(G) ** 2)])


def segments(seconds: float) -> Array:
    """Segment lengths that the peer may choose from: half the record down to half a second, each a fifth shorter."""
    return np.exp(np.arange(np.log(seconds / 2.0), np.log(0.5), -0.2))


def welch_response(recording: Recording, segment_s: float) -> tuple[Array, ComplexArray]:
    """Lines and S_yn/S_un by Hann segments with 75 % overlap, padded so that no resonance falls between lines."""
    length = round(segment_s * RATE_HZ)
    step, padded = max(1, length // 4), next_fast_len(PADDED * length, real=True)
    used = slice(1, int(16.0 * padded / RATE_HZ) + 2)
    instrument = recording.columns.get("n_rad", recording.columns["z_v"])
    signals = (instrument, recording.columns["z_v"], recording.columns["y_rad"])
    N, Z, Y = (spectra(x, length, step, padded)[:, used] for x in signals)
    G = (Y * N.conj()).sum(0) / (Z * N.conj()).sum(0)
    return (np.arange(G.size) + 1) * (RATE_HZ / padded), G


def spectra(signal: Array, length: int, step: int, padded: int) -> ComplexArray:
    """Transforms (segments, nf) of Hann segments of a signal (n,), each without its mean, padded with zeros."""
    parts = np.lib.stride_tricks.sliding_window_view(signal, length)[::step]
    return np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * hann(length), padded, axis=1)


def best_welch(recordings: Sequence[Recording], truth: Plant, seconds: float) -> tuple[Array, Array, Array]:
    """Least root mean squared errors (2,) that any one segment length gives, that length, and each record's then."""
    lengths = segments(seconds)
    all_errors = np.array([[errors(*welch_response(r, s), truth) for r in recordings] for s in lengths])
    mean = np.sqrt(all_errors.mean(axis=1))
    best = mean.argmin(axis=0)
    return mean.min(axis=0), lengths[best], np.sqrt(all_errors[best, :, [0, 1]])


def local_and_auto(recording: Recording, truth: Plant) -> tuple[Array, Array, bool]:
    """Squared errors (2,) of local fits and of the automatic choice, and whether that took the local fits."""
    auto = estimate_frf(recording, LOOP, Settings(method="auto"))
    took = auto.method.split(", ")[1].startswith("local")
    local = auto if took else estimate_frf(recording, LOOP, Settings(method="local"))
    found = [errors(x.frequency_hz, x.siso, truth) for x in (local, auto)]
    return found[0], found[1], took


def rows_of(case: Case) -> list[list]:
    """Two lines of the table: relative error, and error over the rms gain."""
    truth, recordings = case.truth(), case.recordings()
    best, lengths, each = best_welch(recordings, truth, case.seconds)
    found = [local_and_auto(r, truth) for r in recordings]
    local, auto = (np.sqrt(np.mean([x[k] for x in found], axis=0)) for k in (0, 1))
    ratio = np.sqrt([x[1] for x in found]).T / each  # (2, records)
    spread = np.std(np.log(ratio), axis=1, ddof=1) / np.sqrt(len(found))
    needed = needed_seconds(case, best, local)
    took = float(np.mean([x[2] for x in found]))
    head = [case.plant, case.loop, case.noise, case.damping, case.seconds, case.snr_db]
    rows = []
    for k, what in enumerate(("relative", "absolute")):
        numbers = best[k], lengths[k], local[k], auto[k], local[k] / best[k], auto[k] / best[k], spread[k]
        rows.append([*head, what, *digits(*numbers), needed[k], round(took, 2)])
    return rows


def digits(*values: float) -> list[float]:
    """Numbers for the table, to four digits."""
    return [float(f"{x:.4g}") for x in values]


def needed_seconds(case: Case, best: Array, local: Array) -> list[str]:
    """How long Welch's best setting must record for the local fits' errors; from records up to 480 s."""
    if np.all(local >= best):
        return [f"{case.seconds:.0f}"] * 2
    longer = [s for s in LONGER_S if s > case.seconds]
    times = np.array([case.seconds, *longer])
    curve = [best]
    for s in longer:
        record = replace(case, seconds=s, records=1)
        curve.append(best_welch(record.recordings(), case.truth(), s)[0])
    return [_crossing(times, np.array(curve)[:, k], local[k]) for k in (0, 1)]


def _crossing(times: Array, error: Array, wanted: float) -> str:
    error = np.minimum.accumulate(error)
    if wanted >= error[0]:
        return f"{times[0]:.0f}"
    if wanted < error[-1]:
        return f">{times[-1]:.0f}"
    at = np.interp(-np.log(wanted), -np.log(error), np.log(times))
    return f"{np.exp(at):.0f}"
