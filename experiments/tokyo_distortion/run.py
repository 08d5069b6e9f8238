"""Odd and even distortion of a motor bench, and what the logged current does to the answer."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from loopshape.core.units import db
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.rig.distortion import Distortion, Lines, distortion
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, QUIET, head, new_figure, png, styled

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
FIGURES = ROOT / "figures" / HERE.name
DATA = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data")) / "tokyo_bench" / "MultisineTypeB.mat"
SIDES = {"motor": "theta_m_rad", "load": "theta_l_rad"}
INPUTS = {"commanded": "r_current_a", "measured": "current_a"}
COLUMNS = (
    "side", "input", "from_hz", "to_hz", "linear_db", "odd_db", "even_db", "noise_db", "odd_median_db",
    "even_median_db", "noise_median_db", "odd_seen", "even_seen",
)  # fmt: skip


def main() -> None:
    """Analyse both sides with both inputs, write table and figure; says where the recording is not there."""
    if not DATA.is_file():
        print(f"the motor bench's recording is absent ({DATA.name}): set LOOPSHAPE_DATA to the folder of recordings")
        return
    run = import_file(DATA, HERE / "map.toml")
    found = {}
    for side, output in SIDES.items():
        for word, control in INPUTS.items():
            loop = replace(run.loops[0], name=side, control=control, output=output)
            info = replace(run.recordings[0].info, excites=side)
            found[side, word] = distortion(replace(run.recordings[0], info=info), loop)
            print(f"{side}, {word} current: {found[side, word].verdict}")
    rows = [row for (side, word), one in found.items() for row in table(side, word, one)]
    with (HERE / "results.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    draw({side: found[side, "commanded"] for side in SIDES})


def table(side: str, word: str, found: Distortion) -> list[list]:
    """One line a band: rms and median levels in dB re 1 rad."""
    rows = []
    for band in found.bands:
        kinds = [lines.between(*band.band_hz) for lines in (found.odd, found.even) if lines is not None]
        levels = [level(x) for x in (band.linear, band.odd, band.even, band.noise)]
        medians = [level(median(lines.amplitude)) for lines in kinds]
        medians.append(level(median(np.concatenate([lines.noise for lines in kinds]))))
        seen = [band.odd_seen, band.even_seen]
        rows.append([side, word, *(round(f, 1) for f in band.band_hz), *levels, *medians, *seen])
    return rows


def median(values: np.ndarray) -> float | None:
    """Median, None of nothing."""
    return float(np.median(values)) if values.size else None


def level(amplitude: float | None) -> float | str:
    """Amplitude in dB re 1 rad, empty where there is none."""
    return round(float(db(amplitude)), 1) if amplitude else ""


@styled()
def draw(found: dict[str, Distortion]) -> None:
    """Levels of all lines of both sides."""
    figure = new_figure(1, 2, (7.0, 3.3), sharey=True, sharex=True)
    for ax, (side, one) in zip(figure.axes, found.items(), strict=True):
        spectrum(ax, one)
        ax.set_title(f"{side} side")
        frequency_axis(ax, 12.0, 260.0)
    figure.axes[0].set_ylabel("amplitude of a line [dB re 1 rad]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    source = "MultisineTypeB of FdiTools_Python (University of Tokyo, MIT); 19 periods of 1 s, odd multisine, 60 lines"
    head(figure, "Distortion of a two-inertia motor bench: odd at low frequency", source)
    write_bytes_whole(FIGURES / "distortion.png", png(figure))


def spectrum(ax: Axes, found: Distortion) -> None:
    """Excited, odd, even lines as markers, their noise as a line."""
    assert found.excited is not None
    assert found.odd is not None
    assert found.even is not None
    looks = {"excited": ("o", "0.25"), "odd": ("s", COLOURS[1]), "even": ("^", COLOURS[0])}
    for lines, (word, (marker, colour)) in zip((found.excited, found.odd, found.even), looks.items(), strict=True):
        fill = "white" if word == "even" else colour
        mark = {"markersize": 3.2, "markerfacecolor": fill, "markeredgewidth": 0.8}
        ax.semilogx(lines.frequency_hz, db(lines.amplitude), marker, color=colour, label=word, **mark)
    noise = quiet(found.odd, found.even)
    ax.semilogx(noise.frequency_hz, db(noise.noise), color=QUIET, linewidth=0.9, label="noise (one standard deviation)")


def quiet(odd: Lines, even: Lines) -> Lines:
    """All unexcited lines in order."""
    order = np.argsort(np.concatenate([odd.frequency_hz, even.frequency_hz]))
    names = ("frequency_hz", "amplitude", "noise")
    return Lines(*(np.concatenate([getattr(odd, k), getattr(even, k)])[order] for k in names))


if __name__ == "__main__":
    main()
