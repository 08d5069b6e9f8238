"""Sweeps in closed loop with the truth known: how much of the band is valid, the error beside the best peer's,
and how many errors 95 % intervals hold."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from loopshape import frf
from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.identify.frequency_response import estimate_frf

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent.parent / "tests" / "helpers" / name) for name in ("", "loops", "nouns")]
from swept_loop import (  # noqa: E402
    HIGH,
    LOOP,
    LOW,
    Truth,
    easy_plant,
    in_arrays,
    measured,
    median_error,
    peer_errors,
    plant,
    share_inside,
    sweep,
)  # fmt: skip

COLUMNS = (
    "ways", "spacing", "seconds", "rate_hz", "place", "drift", "records", "valid_share", "valid_octaves",
    "median_error", "best_peer_error", "over_best", "peer", "coverage",
)  # fmt: skip
#: length in s, rate in Hz, records of each
LENGTHS = ((10.0, 1000.0, 16), (20.0, 1000.0, 12), (60.0, 1000.0, 6), (180.0, 1000.0, 3), (1200.0, 250.0, 2))


def main() -> None:
    """Write the table; five minutes of one core."""
    with (HERE / "sweeps.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for row in chain(rows(), rows_in_arrays()):
            writer.writerow(row)
            file.flush()


def rows_in_arrays() -> Iterator[list]:
    """A row for each way, spacing and length of sweeps in open loop that come as arrays, without a kind."""
    for both in (False, True):
        for spacing in ("logarithmic", "linear"):
            for seconds, _, records in LENGTHS[1:4]:
                n = sweep(seconds, 500.0, spacing, both)
                case = ["both" if both else "one", spacing, f"{seconds:g}", "500", "arrays", "0"]
                found = [in_arrays(n, 500.0, seed) for seed in range(records)]
                yield [*case, str(records), *summary([(frf(r), p) for r, p in found], 500.0, easy_plant)]


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


def measures(place: str, n: Array, rate_hz: float, drift: float, count: int) -> list[str]:
    """Valid share of the band in Hz and in octaves, errors, their ratio, the best peer, coverage."""
    records = [measured(place, n, rate_hz, seed, drift) for seed in range(count)]
    return summary([(estimate_frf(r, LOOP), peer_errors(r, place)) for r in records], rate_hz, plant)


def summary(found: Sequence[tuple[FRF, dict[str, float]]], rate_hz: float, truth: Truth) -> list[str]:
    """The same of estimates and their peers' errors."""
    shares, octaves, errors, inside = [], [], [], []
    for one, _ in found:
        f = one.frequency_hz[one.valid]
        shares.append(np.ptp(f) / (HIGH - LOW))
        octaves.append(np.log(f[-1] / f[0]) / np.log(HIGH / LOW))
        errors.append(median_error(*between(one), rate_hz, truth))
        inside.append(share_inside(one, rate_hz, truth=truth))
    known = {name: float(np.mean([p[name] for _, p in found])) for name in found[0][1]}
    best = min(known, key=lambda name: known[name])
    error = float(np.mean(errors))
    numbers = [np.mean(shares), np.mean(octaves), error, known[best], error / known[best]]
    return [*(f"{x:.3g}" for x in numbers), best, f"{np.mean(inside):.3f}"]


def between(frf: FRF) -> tuple[Array, ComplexArray]:
    """The estimate every 0.1 Hz, by straight lines between its valid lines."""
    f, H = frf.frequency_hz[frf.valid], frf.siso[frf.valid]
    at = np.arange(max(LOW, f[0]), min(HIGH, f[-1]), 0.1)
    return at, np.interp(at, f, H.real) + 1j * np.interp(at, f, H.imag)


if __name__ == "__main__":
    main()
