"""What an FRF interpolated between measured operating points misses: amid cells, and where a node is left out."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np

import loopshape as ls
from loopshape.core.units import Array, ComplexArray

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from run import SETTINGS, Place, measured, middles  # noqa: E402
from tables import write  # noqa: E402

BANDS_HZ = ((0.5, 2.0), (2.0, 4.0), (4.0, 5.0), (5.0, 6.0), (6.0, 8.0))
ANGLES, PRESSURES = SETTINGS["theta2_deg"], SETTINGS["p_ab_bar"]


def main() -> None:
    """Measure nodes and cells as the study checks them, and write the table."""
    cells = product(middles(ANGLES), middles(PRESSURES))
    write(HERE / "between.csv", rows(measured((*product(ANGLES, PRESSURES), *cells), **SETTINGS["checked"])))


def rows(plants: Mapping[Place, ls.FRF]) -> Iterable[Sequence[object]]:
    """For each way and band: points, rms of the error of ln P, and of the noise in it were each point's its own."""
    yield "what", "points", "band_hz", "error_rms", "noise_rms"
    for what, pairs in ways().items():
        found = [missed(plants, at, of) for at, of in pairs]
        error, variance = (np.array(part) for part in zip(*found, strict=True))
        f = next(iter(plants.values())).frequency_hz
        for low, high in BANDS_HZ:
            band = (f >= low) & (f < high)
            square, noise = float(np.mean(np.abs(error[:, band]) ** 2)), float(np.mean(variance[:, band]))
            yield what, len(pairs), f"{low:g}-{high:g}", float(np.sqrt(square)), float(np.sqrt(noise))


def ways() -> dict[str, list[tuple[Place, list[Place]]]]:
    """Places and those that they are interpolated from: middles from four nodes, nodes from two neighbours."""
    n, m = len(ANGLES), len(PRESSURES)
    corners = [
        ((0.5 * (ANGLES[i] + ANGLES[i + 1]), 0.5 * (PRESSURES[j] + PRESSURES[j + 1])),
         [*product(ANGLES[i : i + 2], PRESSURES[j : j + 2])])
        for i, j in product(range(n - 1), range(m - 1))
    ]  # fmt: skip
    return {
        "middle of a cell": corners,
        "node left out, angle": [
            ((ANGLES[i], p), [(ANGLES[i - 1], p), (ANGLES[i + 1], p)]) for i in range(1, n - 1) for p in PRESSURES
        ],
        "node left out, pressure": [
            ((t, PRESSURES[j]), [(t, PRESSURES[j - 1]), (t, PRESSURES[j + 1])]) for t in ANGLES for j in range(1, m - 1)
        ],
    }


def missed(plants: Mapping[Place, ls.FRF], at: Place, of: Sequence[Place]) -> tuple[ComplexArray, Array]:
    """Error (nf,) of the mean ln P of some places at another, and the variance that noise leaves in it."""
    error = -np.mean([turned(np.log(plants[at].siso) - np.log(plants[x].siso)) for x in of], axis=0)
    return error, relative(plants[at]) + sum(relative(plants[x]) for x in of) / len(of) ** 2


def turned(z: ComplexArray) -> ComplexArray:
    """Differences of logarithms with their phase between -pi and pi."""
    return z.real + 1j * np.angle(np.exp(1j * z.imag))


def relative(frf: ls.FRF) -> Array:
    """Relative variance (nf,) of an FRF."""
    return np.asarray(frf.variance[:, 0, 0] / np.abs(frf.siso) ** 2)


if __name__ == "__main__":
    sys.exit(main())
