"""An inverted pendulum in closed loop: what the direct and the reference-based estimator make of an unstable plant."""

from __future__ import annotations

import csv
import os
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy.signal import lfilter

from loopshape.core.kernels.spectra import cross_spectra, hann, independent_share
from loopshape.core.units import TWO_PI, Array, ComplexArray, db, deg
from loopshape.data.signal.recording import Recording
from loopshape.identify.quality.faults import saturated
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, QUIET, head, new_figure, png, styled

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
import simulated  # noqa: E402

ROOT = HERE.parent.parent
FIGURES = ROOT / "figures" / HERE.name
DATA = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data")) / "qube"
EXCITED, QUIET_ROWS = (2000, 8000), ((500, 2000), (8500, 10000))  # rows; the first second is the fall into balance
LENGTH, STEP = 1000, 250  # samples of a segment: lines 0.5 Hz apart
SHOWN_HZ = (0.5, 20.0)
LENGTHS_S, NOISES_RAD, RECORDS = (60, 240, 960), (0.003, 0.02, 0.1), 4
SOURCE = "Quanser QUBE, two recordings of 12 s of excitation (McGill DECAR, MIT)"


def main() -> None:
    """Tables and figures of the recordings and of the simulated loop; says where the recordings are not there."""
    errors = simulated_errors()
    write("simulated.csv", [("noise_rad", "length_s", "direct_error", "reference_error"), *errors])
    if not DATA.is_dir():
        print("the QUBE recordings are absent: set LOOPSHAPE_DATA to the folder of recordings")
        return
    found = measured()
    write("qube.csv", table(found))
    draw(found, errors)


def simulated_errors() -> list[list]:
    """Relative errors of both estimators by noise and length."""
    return [
        [noise, s, *(round(simulated.relative_error(e, s, noise, RECORDS), 4) for e in ("direct", "reference"))]
        for noise in NOISES_RAD
        for s in LENGTHS_S
    ]


@dataclass(frozen=True, eq=False)
class Found:
    """Voltage to arm angle (nf,) by estimator; `quiet` is the direct one where nobody excites."""

    frequency_hz: Array
    reference: ComplexArray
    relative_std: Array
    direct: ComplexArray
    quiet: ComplexArray
    minus_inverse_controller: ComplexArray
    coherence: Array


def measured() -> Found:
    """Both recordings together: sums of cross-spectra over their segments."""
    law = tomllib.loads((DATA / "controller.toml").read_text())
    signals = [loop_signals(path, law) for path in sorted(DATA.glob("*.csv"))]
    S, segments = summed([cut(x, EXCITED) for x in signals])
    Q, _ = summed([cut(x, rows) for x in signals for rows in QUIET_ROWS])
    f = np.arange(LENGTH // 2 + 1) * (signals[0].rate_hz / LENGTH)
    share = independent_share(segments // 2, LENGTH, STEP, hann(LENGTH))
    y, a, u, r = range(4)
    G = S[y, r] / S[u, r]
    residual = S[y, y] - 2.0 * (G.conj() * S[y, u]) + np.abs(G) ** 2 * S[u, u]
    std = np.sqrt(np.abs(residual) * S[r, r].real / (segments * share - 1.0)) / np.abs(S[u, r] * G)
    C_theta, C_alpha = controller(f, signals[0].rate_hz, law)
    limit = 1.0 / (C_theta + C_alpha * S[a, r] / S[y, r])
    coherence = np.abs(S[u, r]) ** 2 / (S[u, u] * S[r, r]).real
    rows = (f >= SHOWN_HZ[0]) & (f <= SHOWN_HZ[1])
    parts = (f, G, std, S[y, u] / S[u, u], Q[y, u] / Q[u, u], limit, coherence)
    return Found(*(part[rows] for part in parts))


def loop_signals(path: Path, law: dict[str, float]) -> Recording:
    """A recording with one more column: what was injected, as it reaches the drive (feedforward, C times targets)."""
    run = import_file(path, ROOT / "examples" / "qube" / "map.toml")
    one = run.recordings[0]
    clipped = saturated(one.column("u_v"), one.rate_hz, f"u_v of {path.name}")
    print(clipped.sentence if clipped else f"u_v of {path.name} is not saturated")
    fed = [feedback(one.column(f"{p}theta_rad"), one.column(f"{p}alpha_rad"), one.rate_hz, law) for p in ("", "r_")]
    injected = one.column("n_v") - fed[1]
    off = np.abs(np.clip(injected + fed[0], -10.0, 10.0) - one.column("u_v")).max()
    rows = slice(*EXCITED)
    sizes = [float(x[rows].std()) for x in (one.column("n_v"), fed[1])]
    print(f"{path.name}: controller repeated to {off:.1e} V; feedforward {sizes[0]:.2f}, targets {sizes[1]:.2f} V rms")
    return Recording(one.info, one.rate_hz, {**one.columns, "injected_v": injected})


def feedback(theta_rad: Array, alpha_rad: Array, rate_hz: float, law: dict[str, float]) -> Array:
    """The controller's volts (n,) for two angles: PD, slopes by backward differences low-passed at `tau` rad/s."""
    b, a = [law["tau"], -law["tau"]], [1.0 + law["tau"] / rate_hz, -1.0]
    slopes = [lfilter(np.array(b), np.array(a), x) for x in (theta_rad, alpha_rad)]
    volts = law["kp_theta"] * theta_rad + law["kd_theta"] * slopes[0]
    return np.asarray(volts + law["kp_alpha"] * alpha_rad + law["kd_alpha"] * slopes[1])


def controller(frequency_hz: Array, rate_hz: float, law: dict[str, float]) -> tuple[ComplexArray, ComplexArray]:
    """Responses (nf,) of `feedback` from each angle; positive, as the drive's sign wants."""
    back = np.exp(-1j * TWO_PI * frequency_hz / rate_hz)
    slope = law["tau"] * (1.0 - back) / (1.0 + law["tau"] / rate_hz - back)
    return law["kp_theta"] + law["kd_theta"] * slope, law["kp_alpha"] + law["kd_alpha"] * slope


def cut(recording: Recording, rows: tuple[int, int]) -> list[Array]:
    """Arm, pendulum, drive and injected signal in rows."""
    return [recording.column(x)[slice(*rows)] for x in ("theta_rad", "alpha_rad", "u_v", "injected_v")]


def summed(pieces: Sequence[list[Array]]) -> tuple[ComplexArray, int]:
    """Cross-spectra S[a, b] of x_a x_b* (s, s, nf) over the segments of all pieces, and how many these are."""
    total = np.sum([cross_spectra(piece, LENGTH, STEP)[0] for piece in pieces], axis=0)
    lower = np.tril_indices(total.shape[0], -1)
    total[lower] = total[lower[1], lower[0]].conj()
    return total, sum((piece[0].size - LENGTH) // STEP + 1 for piece in pieces)


def table(found: Found) -> list[Sequence]:
    """One row a line up to 20 Hz."""
    kinds = ("reference", "direct", "quiet", "minus_inverse_controller")
    rows: list[Sequence] = [
        (
            "frequency_hz",
            *(f"{k}_{w}" for k in kinds for w in ("db", "deg")),
            "relative_std",
            "coherence_injected_drive",
        )
    ]
    for k, f in enumerate(found.frequency_hz):
        values = [getattr(found, kind)[k] for kind in kinds]
        both = [round(float(x), 1) for v in values for x in (db(v), deg(np.angle(v)))]
        rows.append((f, *both, round(float(found.relative_std[k]), 3), round(float(found.coherence[k]), 3)))
    return rows


def write(name: str, rows: Sequence[Sequence]) -> None:
    """A table, printed in part."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    for row in rows[:12]:
        print("  ".join(f"{cell!s:>9}" for cell in row))


@styled()
def draw(found: Found, errors: list[list]) -> None:
    """The measured arm by estimator, and how errors go with the length where the plant is known."""
    figure = new_figure(1, 2, (7.4, 3.4))
    measured_panel(figure.axes[0], found)
    simulated_panel(figure.axes[1], errors)
    head(figure, "An unstable plant: the direct estimate is drawn to -1/C, the other is not", SOURCE)
    write_bytes_whole(FIGURES / "estimators.png", png(figure))


def measured_panel(ax: Axes, found: Found) -> None:
    """Magnitudes over frequency."""
    f, size = found.frequency_hz, np.abs(found.reference)
    low, high = (db(size * np.maximum(1.0 + k * found.relative_std, 1e-3)) for k in (-2.0, 2.0))
    ax.fill_between(f, low, high, color=COLOURS[0], alpha=0.2, linewidth=0.0)
    ax.plot(f, db(size), color=COLOURS[0], label="by what was injected (2 std)")
    ax.plot(f, db(found.direct), color=COLOURS[1], label="direct")
    ax.plot(f, db(found.quiet), ".", color=QUIET, markersize=4.0, label="direct, nobody excites")
    ax.plot(f, db(found.minus_inverse_controller), "--", color="0.3", linewidth=0.9, label="-1/C")
    frequency_axis(ax, 0.5, 8.0)
    ax.set_ylim(-45.0, 10.0)
    ax.set_ylabel("drive to arm angle [dB re 1 rad/V]")
    ax.set_title("QUBE")
    ax.legend(loc="lower left")


def simulated_panel(ax: Axes, errors: list[list]) -> None:
    """Errors over length for each noise."""
    for k, noise in enumerate(NOISES_RAD):
        mine = np.array([row for row in errors if row[0] == noise])
        for column, style in ((2, "-"), (3, "--")):
            ax.loglog(mine[:, 1], 100.0 * mine[:, column], "o" + style, color=COLOURS[k], markersize=3.0)
        at = 100.0 * float(np.sqrt(mine[-1, 2] * mine[-1, 3]))
        ax.text(1050.0, at, f"{noise:g} rad", color=COLOURS[k], va="center", fontsize="small")
    ax.plot([], [], "-", color="0.3", label="direct")
    ax.plot([], [], "--", color="0.3", label="by what was injected")
    ax.set_xticks(LENGTHS_S, [str(s) for s in LENGTHS_S])
    ax.set_yticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
    ax.minorticks_off()
    ax.set_xlim(50.0, 2200.0)
    ax.set_xlabel("length [s]")
    ax.set_ylabel("error, 0.5 to 6 Hz [%]")
    ax.set_title("40/(s² - 25), simulated, by sensor noise")
    ax.set_ylim(0.4, 100.0)
    ax.legend(loc="lower left")


if __name__ == "__main__":
    main()
