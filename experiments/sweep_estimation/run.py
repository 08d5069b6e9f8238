"""Sweeps in closed loop with the truth known: how much of the band is valid, the error beside the best peer's,
and how many errors 95 % intervals hold."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from loopshape.core.units import Array, ComplexArray
from loopshape.data.frf import FRF
from loopshape.identify.frequency_response import estimate_frf

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent.parent / "tests" / "truth"))
from swept_loop import HIGH, LOOP, LOW, measured, median_error, peer_errors, share_inside, sweep  # noqa: E402

COLUMNS = (
    "ways", "spacing", "seconds", "rate_hz", "place", "drift", "records", "valid_share", "valid_octaves",
    "median_error", "best_peer_error", "over_best", "peer", "coverage",
)  # fmt: skip
#: length in s, rate in Hz, records of each
LENGTHS = ((10.0, 1000.0, 16), (20.0, 1000.0, 12), (60.0, 1000.0, 6), (180.0, 1000.0, 3), (1200.0, 250.0, 2))


def main() -> None:
    """Write the table; four minutes of one core."""
    with (HERE / "sweeps.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for row in rows():
            writer.writerow(row)
            file.flush()


def rows() -> Iterator[list]:
    """A row for each way, spacing, length, place and drift."""
    for both in (False, True):
        for spacing in ("logarithmic", "linear"):
            for seconds, rate, records in LENGTHS:
                n = sweep(seconds, rate, spacing, both)
                for place in ("controller_input", "plant_input"):
                    for drift in (0.0, 1.0):
                        case = ["both" if both else "one", spacing, f"{seconds:g}", f"{rate:g}", place, f"{drift:g}"]
                        yield [*case, str(records), *measures(place, n, rate, drift, records)]


def measures(place: str, n: Array, rate_hz: float, drift: float, records: int) -> list[str]:
    """Valid share of the band in Hz and in octaves, errors, their ratio, the best peer, coverage."""
    shares, octaves, errors, peers, inside = [], [], [], [], []
    for seed in range(records):
        record = measured(place, n, rate_hz, seed, drift)
        frf = estimate_frf(record, LOOP)
        f = frf.frequency_hz[frf.trusted]
        shares.append(np.ptp(f) / (HIGH - LOW))
        octaves.append(np.log(f[-1] / f[0]) / np.log(HIGH / LOW))
        peers.append(peer_errors(record, place))
        errors.append(median_error(*between(frf), rate_hz))
        inside.append(share_inside(frf, rate_hz))
    known = {name: float(np.mean([p[name] for p in peers])) for name in peers[0]}
    best = min(known, key=lambda name: known[name])
    error = float(np.mean(errors))
    numbers = [np.mean(shares), np.mean(octaves), error, known[best], error / known[best]]
    return [*(f"{x:.3g}" for x in numbers), best, f"{np.mean(inside):.3f}"]


def between(frf: FRF) -> tuple[Array, ComplexArray]:
    """The estimate every 0.1 Hz, by straight lines between its valid lines."""
    f, H = frf.frequency_hz[frf.trusted], frf.siso[frf.trusted]
    at = np.arange(max(LOW, f[0]), min(HIGH, f[-1]), 0.1)
    return at, np.interp(at, f, H.real) + 1j * np.interp(at, f, H.imag)


if __name__ == "__main__":
    main()
