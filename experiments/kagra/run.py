"""A suspension of KAGRA, measured twice: does the repeat lie within the intervals that five averages state?"""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from scipy.stats import f as f_distribution

import loopshape as ls
from loopshape.core.units import Array, ComplexArray, db
from loopshape.data.response.frf import FRF
from loopshape.io.files import write_bytes_whole
from loopshape.view.style import COLOURS, head, new_figure, png, styled

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
FIGURES = ROOT / "figures" / HERE.name
DATA = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data")) / "kagra"
FIRST = "BS_TML_exc_20200730a.xml"
SHARES = (0.5, 0.9, 0.95, 0.99)
SOURCE = "KAGRA, beam splitter's suspension, 2020-07-30 04:47 and 06:19 UTC (terrencetec/kontrol, MIT)"


class Pair(NamedTuple):
    """One response measured twice: frequencies (nf,), both responses, variances of their complex errors."""

    channel: str
    frequency_hz: Array
    first: ComplexArray
    again: ComplexArray
    first_variance: Array
    again_variance: Array
    freedom: float

    def within(self, share: float) -> float:
        """Share of the frequencies whose difference lies within the interval of both errors together."""
        limit = f_distribution.ppf(share, 2.0, 2.0 * self.freedom)
        distance = np.abs(self.again - self.first) ** 2 / (self.first_variance + self.again_variance)
        return float(np.mean(distance < limit))


def main() -> None:
    """Tables and a figure; says where the first measurement is not there."""
    if not (DATA / FIRST).exists():
        print("the KAGRA measurements are absent: set LOOPSHAPE_DATA to the folder of recordings")
        return
    first = ls.formats.read_frf(DATA / FIRST)
    pairs = measured_twice(first)
    write("responses.csv", responses(first))
    write("coverage.csv", coverage(pairs))
    draw(pairs)


def measured_twice(first: FRF) -> list[Pair]:
    """The channels of repeat.csv beside their first measurement, line by line."""
    with (HERE / "repeat.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [pair(first, name, rows) for name in dict.fromkeys(row["channel"] for row in rows)]


def pair(first: FRF, channel: str, rows: Sequence[dict[str, str]]) -> Pair:
    """One channel; the variance of the repeat follows from its coherence and averages as that of the first does."""
    mine = [row for row in rows if row["channel"] == channel]
    f, re, im, gamma2 = (np.array([float(row[k]) for row in mine]) for k in ("frequency_hz", "re", "im", "coherence"))
    at = np.searchsorted(first.frequency_hz, f - 1e-6)
    assert np.allclose(first.frequency_hz[at], f)
    stored = channel.replace(":", "_").replace("-", "_")
    j = next(j for j, name in enumerate(first.outputs) if name.startswith(stored))
    again = re + 1j * im
    variance = np.abs(again) ** 2 * (1.0 - gamma2) / (gamma2 * (first.averages - 1.0))
    return Pair(
        channel, f, first.response[at, j, 0], again, first.variance[at, j, 0], variance, first.variance_freedom
    )  # fmt: skip


def responses(first: FRF) -> list[Sequence]:
    """The twelve responses of the first measurement: how much of the band is known to 10 %, and where."""
    rows: list[Sequence] = [("response", "share_known_to_10_percent", "from_hz", "to_hz")]
    for j, name in enumerate(first.outputs):
        known = np.sqrt(first.variance[:, j, 0]) < 0.1 * np.abs(first.response[:, j, 0])
        f = first.frequency_hz[known]
        rows.append((name, round(float(known.mean()), 3), *(f[[0, -1]].round(2) if f.size else ("", ""))))
    return rows


def coverage(pairs: Sequence[Pair]) -> list[Sequence]:
    """Share of the frequencies at which the repeat lies within intervals of so many per cent, by channel and in all."""
    rows: list[Sequence] = [("channel", "frequencies", *(f"within_{100 * s:g}_percent" for s in SHARES), "gain_ratio")]
    for one in pairs:
        ratio = float(np.median(np.abs(one.again / one.first)))
        rows.append((one.channel, one.frequency_hz.size, *(round(one.within(s), 3) for s in SHARES), round(ratio, 4)))
    sizes = [one.frequency_hz.size for one in pairs]
    every = [round(float(np.average([one.within(s) for one in pairs], weights=sizes)), 3) for s in SHARES]
    return [*rows, ("all", sum(sizes), *every, "")]


def write(name: str, rows: Sequence[Sequence]) -> None:
    """A table, printed too."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
    for row in rows:
        print("  ".join(f"{cell!s:>12}" for cell in row))


@styled()
def draw(pairs: Sequence[Pair]) -> None:
    """Each response with its 95 % interval, and the repeat."""
    figure = new_figure(1, len(pairs), (7.4, 3.0))
    for ax, one in zip(figure.axes, pairs, strict=True):
        panel(ax, one)
    figure.axes[0].set_ylabel("lever over excitation [dB]")
    figure.axes[0].legend(loc="lower left")
    head(figure, "A repeat 92 min later lies within the intervals of five averages", SOURCE)
    write_bytes_whole(FIGURES / "repeat.png", png(figure))


def panel(ax: Axes, one: Pair) -> None:
    """First measurement, its interval and the repeat over frequency."""
    half = np.sqrt(f_distribution.ppf(0.95, 2.0, one.freedom) * one.first_variance)
    size = np.abs(one.first)
    low = db(np.maximum(size - half, 0.3 * size))
    ax.fill_between(one.frequency_hz, low, db(size + half), color=COLOURS[0], alpha=0.25, linewidth=0.0)
    ax.plot(one.frequency_hz, db(size), color=COLOURS[0], label="first, 95 %")
    ax.plot(one.frequency_hz, db(np.abs(one.again)), ".", color=COLOURS[1], markersize=2.5, label="repeat")
    ax.set_xlabel("frequency [Hz]")
    ax.set_title({"LEN": "length", "PIT": "pitch", "YAW": "yaw"}[one.channel.split("_")[-2]])


if __name__ == "__main__":
    main()
