"""Measured FRFs of the simulated arm against its linearisation, bare and corrected."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from loopshape.core.units import db, deg
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.frequency_response import estimate_frf
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import header, measure
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, head, new_figure, png, styled

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "lab"))
from arm_sweep import command_amplitude, expected_angle_response  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
COLUMNS = (
    "recording", "theta2_deg", "p_ab_bar", "amplitude_v", "lines", "rms_bare", "rms_corrected", "median_std",
    "within_95_bare", "within_95_corrected",
)  # fmt: skip


def main() -> None:
    """Run the sweeps, compare, write table and figure."""
    rows, curves = [], []
    for file in ("study.toml", "slow_pressure.toml"):
        study, plant = read_study(HERE / file), Arm1()
        run = header(study, plant)
        for recording in measure(study, plant):
            row, curve = compare(run, recording)
            rows.append(row)
            curves.append(curve)
    with (HERE / "results.csv").open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    for row in (COLUMNS, *rows):
        print("  ".join(f"{cell!s:>19}" for cell in row))
    draw(curves)


def compare(run: Run, recording: Recording) -> tuple[list, tuple]:
    """One line of the table, and what the figure needs."""
    frf = estimate_frf(recording, run.loop("theta2"))
    frf = frf.select(frf.valid & (frf.frequency_hz >= 0.3) & (frf.frequency_hz <= 10.0))
    point = recording.info.operating_point
    bare = linearise(constants(ARM1_PARAMETERS.vector()), **point).response(frf.frequency_hz)[:, 0, 0]
    corrected = expected_angle_response(frf, recording, run.loop("p_ab"))
    std = np.sqrt(frf.variance[:, 0, 0]) / np.abs(frf.siso)
    errors = [np.abs(frf.siso / model - 1.0) for model in (bare, corrected)]
    within = [float(np.mean(e < np.sqrt(-np.log(0.05)) * std)) for e in errors]
    amplitude = float(np.median(command_amplitude(frf, recording)))
    row = [recording.info.name, point["theta2_deg"], point["p_ab_bar"], round(amplitude, 4), frf.frequency_hz.size]
    row += [round(float(np.sqrt(np.mean(e**2))), 4) for e in errors]
    row += [round(float(np.median(std)), 4), *(round(w, 3) for w in within)]
    return row, (recording.info.name, point, frf, corrected, std)


@styled()
def draw(curves: list) -> None:
    """Measured over expected, with the 95 % band, one column for each kind of sweep."""
    kinds = {"small": "z about 0.05 V", "large": "z about 0.12 V", "slow": "0.05 V, slow pressure loop"}
    points = list(dict.fromkeys((c[1]["theta2_deg"], c[1]["p_ab_bar"]) for c in curves))
    figure = new_figure(2, 3, (7.0, 4.6), sharex=True, sharey="row")
    for name, point, frf, expected, std in curves:
        column = list(kinds).index(name.split("-")[0])
        size, angle = figure.axes[column], figure.axes[3 + column]
        key = (point["theta2_deg"], point["p_ab_bar"])
        look = {"color": COLOURS[points.index(key)], "linewidth": 0.9}
        ratio = frf.siso / expected
        size.semilogx(frf.frequency_hz, db(ratio), label=f"{key[0]:g} deg, {key[1]:g} bar", **look)
        angle.semilogx(frf.frequency_hz, deg(np.angle(ratio)), **look)
        if key == (0.0, 1.0):
            reach = 1.96 * std / np.sqrt(2.0)
            size.fill_between(
                frf.frequency_hz, db(1 - reach), db(1 + reach), color="0.87", label="95 % at 0 deg, 1 bar"
            )
            angle.fill_between(frf.frequency_hz, -deg(reach), deg(reach), color="0.87")
    for ax, title in zip(figure.axes[:3], kinds.values(), strict=True):
        ax.set_title(title)
        ax.set_ylim(-2.0, 2.0)
        ax.set_xlim(0.28, 10.0)
    figure.axes[0].set_ylabel("measured / expected [dB]")
    figure.axes[3].set_ylabel("its phase [deg]")
    figure.axes[3].set_ylim(-12.0, 12.0)
    for ax in figure.axes[3:]:
        frequency_axis(ax, 0.3, 10.0)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    head(figure, "The simulated arm over its linearisation, corrected for valves, PWM and mean point")
    write_bytes_whole(FIGURES / "measured_over_expected.png", png(figure))


if __name__ == "__main__":
    main()
