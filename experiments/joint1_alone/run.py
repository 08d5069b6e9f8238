"""Joint 1 alone: its plant at six points, table H.1's controller on it, one tuned in its structure, and steps."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "lab")]  # the study's other files and the lab, however it is started

from arm2_closed import close2  # noqa: E402
from joint1_causes import CAUSES, causes  # noqa: E402
from joint1_pictures import draw_plant, draw_steps, entitled  # noqa: E402
from joint1_scores import scores  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from source_controllers import controller  # noqa: E402

from loopshape.core.units import TWO_PI  # noqa: E402
from loopshape.data.control.controller import Controller  # noqa: E402
from loopshape.data.requirement.requirements import Requirements  # noqa: E402
from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.data.response.model import Fit  # noqa: E402
from loopshape.data.result.verdict import Verdict  # noqa: E402
from loopshape.data.signal.recording import Recording  # noqa: E402
from loopshape.design.tune import tune  # noqa: E402
from loopshape.identify.fit import fit, structure_by_name  # noqa: E402
from loopshape.identify.frequency_response import estimate_realisations  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.io.requirements import read_requirements  # noqa: E402
from loopshape.loop.loop import Loop  # noqa: E402
from loopshape.loop.loops import loops_of  # noqa: E402
from loopshape.loop.verdict import check  # noqa: E402
from loopshape.toolbox.arm.arm2 import Arm2  # noqa: E402
from loopshape.toolbox.arm.dynamics.linear2 import Linearisation2, linearise_pairs2  # noqa: E402
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2  # noqa: E402
from loopshape.toolbox.arm.strategies2 import PAIRS  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.toolbox.rig.simulated import header, measure  # noqa: E402
from loopshape.toolbox.validation.remeasured import recorded_steps  # noqa: E402
from loopshape.view.plots.loops import loop_page  # noqa: E402
from loopshape.view.plots.nichols import nichols  # noqa: E402
from loopshape.view.style import png  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
NUMBERS = constants2(ARM2_PARAMETERS.vector())
LOW_HZ, FIT_TO_HZ = 0.05, 5.0  # where the linear gain is read; below joint 2's mode
DELAY_SAMPLES, NOISE_DEG = 3, 0.1  # of the PWM; below this swing there is no frequency to read


def main() -> None:
    """Measure, fit, check, tune, step; write tables, figures and scores."""
    required = {one.loop: one for one in read_requirements(HERE / "requirements.toml")}
    frfs = measured()
    fits = {loop: [fit(low(frf), structure_by_name(name)) for frf in frfs[loop]] for loop, name in
            (("theta1", "third_order"), ("p_cd", "integrator"))}  # fmt: skip
    write("fits.csv", FITS, fit_rows(fits["theta1"]))
    own = {one.loop: one for one in Arm2(PAIRS).default_controllers(1000.0)}
    tuned = tune(frfs["theta1"], required["theta1"], fits["theta1"]).controller
    controllers = {
        "table H.1": controller("table_h_1"),
        "tuned": tuned,
        "the plant's own": own["theta1"],
        "p_CD, the plant's own": own["p_cd"],
    }
    verdicts = {name: judged(frfs, fits, one, required) for name, one in controllers.items()}
    write("margins.csv", MARGINS, [row for name, one in verdicts.items() for row in margin_rows(name, one)])
    why = causes(fits["theta1"], required["theta1"])
    write("causes.csv", CAUSES, why)
    write("controllers.csv", ("controller", "blocks"), [[name, written(one)] for name, one in controllers.items()])
    runs = {name: stepped(controllers[name]) for name in ("table H.1", "tuned")}
    write("steps.csv", STEPS, [row for name, one in runs.items() for row in step_rows(name, one)])
    swings = {name: swing(one) for name, one in runs.items()}
    write("swings.csv", SWINGS, [swing_row(name, controllers[name], one) for name, one in swings.items()])
    pages(frfs, fits, controllers, verdicts, runs, required)
    write("scores.csv", SCORES, scores(verdicts, fits["theta1"], swings["table H.1"], why))


def measured() -> dict[str, list[FRF]]:
    """FRFs of theta1 and p_CD by loop, one an operating point."""
    study, plant = read_study(HERE / "study.toml"), Arm2(PAIRS)
    out: dict[str, list[FRF]] = {"theta1": [], "p_cd": []}
    for point in study.operating_points:
        here = replace(study, operating_points=(point,))
        run = header(here, plant)
        recordings = list(measure(here, plant, threads=1))
        for loop, found in out.items():
            mine = [r for r in recordings if r.info.excites == loop]
            name = f"theta1 {point['theta1_deg']:g} deg, p_CD {point['p_cd_bar']:g} bar"
            found.append(replace(estimate_realisations(mine, run.loop(loop)), recording=name))
    return out


def low(frf: FRF) -> FRF:
    """The valid lines below joint 2's mode."""
    return frf.select(frf.valid & (frf.frequency_hz <= FIT_TO_HZ))


def linear(point: dict[str, float]) -> Linearisation2:
    """The linearisation at an operating point."""
    return linearise_pairs2(NUMBERS, *(point[key] for key in PAIRS.point_keys))


FITS = (
    "point", "lines", "kappa", "kappa_std", "f_hz", "f_std_hz", "zeta", "zeta_std", "misfit_db", "sufficient",
    "linear_kappa", "linear_f_hz", "linear_zeta",
)  # fmt: skip


def fit_rows(fits: Sequence[Fit]) -> list[list]:
    """A line a point: the third-order fit beside the linearisation's integrator and first mode."""
    rows = []
    for one in fits:
        lin = linear(dict(one.operating_point))
        f_hz, zeta = lin.modes()[0]
        low = abs(lin.response(np.array([LOW_HZ]))[0, 0, 0])
        rows.append([one.recording, one.lines])
        for name, digits in (("kappa", 4), ("f_hz", 4), ("zeta", 3)):
            rows[-1] += [f"{one[name].value:.{digits}g}", f"{one[name].std:.2g}"]
        kappa = low * TWO_PI * LOW_HZ * (TWO_PI * f_hz) ** 2
        rows[-1] += [f"{one.misfit_db:.2g}", one.sufficient, f"{kappa:.4g}", f"{f_hz:.4g}", f"{zeta:.3g}"]
    return rows


def judged(
    frfs: dict[str, list[FRF]], fits: dict[str, list[Fit]], of: Controller, required: dict[str, Requirements]
) -> Verdict:
    """The source's requirements at every point."""
    return check(frfs[of.loop], of, required[of.loop], fits[of.loop])


MARGINS = (
    "controller", "point", "stable", "bandwidth_hz", "last_crossing_hz", "phase_margin_deg", "gain_margin_db",
    "sensitivity_peak_db", "peak_low_db", "peak_high_db", "peak_at_hz",
)  # fmt: skip


def margin_rows(name: str, verdict: Verdict) -> list[list]:
    """A line a point."""
    rows = []
    for point, m in verdict.margins.items():
        low, high = m.intervals.get("sensitivity_peak_db", (np.nan, np.nan))
        last = m.crossings_hz[-1] if m.crossings_hz else np.nan
        numbers = [m.bandwidth_hz, last, m.phase_margin_deg, m.gain_margin_db, m.sensitivity_peak_db, low, high]
        rows.append([name, point, m.stable, *(f"{x:.3g}" for x in [*numbers, m.at_hz["sensitivity_peak_db"]])])
    return rows


def written(of: Controller) -> str:
    """A controller's blocks in words."""
    return "; ".join(f"{b.kind} " + " ".join(f"{k} {v:.4g}" for k, v in b.parameters.items()) for b in of.blocks)


def stepped(of: Controller) -> Recording:
    """The steps under one controller of theta1, the plant's own elsewhere."""
    study = read_study(HERE / "steps.toml")
    (found,) = measure(replace(study, controllers={"theta1": of.blocks}), Arm2(PAIRS), threads=1)
    return found


STEPS = (
    "controller", "loop", "at_s", "size", "rise_time_s", "settling_time_s", "settling_time_5_s", "overshoot_percent",
    "steady_state_error", "unit", "outcome", "notes",
)  # fmt: skip


def step_rows(name: str, recording: Recording) -> list[list]:
    """A line a step of a setpoint; errors and sizes in deg and bar."""
    plant, rows = Arm2(PAIRS), []
    if recording.info.ended_early:
        raise SystemExit(f"{name}: {recording.info.ended_early}")
    setups = plant.loop_setups(plant.default_controllers(1000.0), "reference")
    for loop, scale, unit in ((setups[0], np.degrees(1.0), "deg"), (setups[3], 1.0, "bar")):
        for one in recorded_steps(recording, loop):
            m = one.measured
            times = [f"{t:.2f}" for t in (m.rise_time_s, m.settling_time_s, m.settling_time_5_s)]
            error = m.steady_state_error * one.size * scale
            rows.append([name, loop.name, one.at_s, f"{one.size * scale:.3g}", *times, f"{100.0 * m.overshoot:.0f}"])
            rows[-1] += [f"{error:.3f}", unit, m.outcome, "; ".join(one.notes)]
    return rows


SWINGS = ("controller", "amplitude_deg", "f_hz", "linear_least_damping", "linear_f_hz")
STOOD_S = (9.0, 15.0)  # on its setpoint, well after the first step and before the next


def swing(recording: Recording) -> tuple[float, float]:
    """Amplitude in deg and frequency in Hz of what theta1 still does on its setpoint."""
    rows = slice(*(round(t * recording.rate_hz) for t in STOOD_S))
    y = np.degrees(recording.column("theta1_rad")[rows])
    slow = np.polyval(np.polyfit(np.arange(y.size), y, 2), np.arange(y.size))
    size = np.abs(np.fft.rfft((y - slow) * np.hanning(y.size)))
    return float(np.std(y - slow) * np.sqrt(2.0)), float(np.argmax(size) * recording.rate_hz / y.size)


def swing_row(name: str, of: Controller, found: tuple[float, float]) -> list:
    """What the simulated arm does, and the least damped mode of the linear loop below 5 Hz."""
    point = read_study(HERE / "steps.toml").operating_points[0]
    others = Arm2(PAIRS).default_controllers(1000.0)[1:]
    loop = close2(linear(dict(point)), (of, *others), DELAY_SAMPLES)
    f_hz, zeta = min(((f, z) for f, z in loop.modes() if f < FIT_TO_HZ), key=lambda mode: mode[1])
    return [name, f"{found[0]:.3g}", f"{found[1]:.3g}" if found[0] > NOISE_DEG else "", f"{zeta:.3f}", f"{f_hz:.3g}"]


TITLES = {
    "figure_h_3": "Joint 1 alone under the source's controller (table H.1), simulated arm",
    "figure_h_4": "Open loop of joint 1 alone under the source's controller (table H.1), simulated arm",
    "tuned": "Joint 1 alone, the same structure tuned on the simulated arm",
    "tuned_nichols": "Open loop of joint 1 alone, the same structure tuned on the simulated arm",
}


def loop_pictures(
    loops: dict[str, list[Loop]], required: Requirements, verdicts: dict[str, Verdict]
) -> dict[str, Figure]:
    """Loop page and Nichols chart of theta1 under table H.1 and under the tuned controller."""
    out = {}
    for name, page, chart in (("table H.1", "figure_h_3", "figure_h_4"), ("tuned", "tuned", "tuned_nichols")):
        found = {"verdict": verdicts[name]}
        out[page] = entitled(loop_page(loops[name], required, **found), TITLES[page])
        out[chart] = entitled(nichols(loops[name], required, **found).figure, TITLES[chart])
    return out


def pages(
    frfs: dict[str, list[FRF]],
    fits: dict[str, list[Fit]],
    controllers: dict[str, Controller],
    verdicts: dict[str, Verdict],
    runs: dict[str, Recording],
    required: dict[str, Requirements],
) -> None:
    """All figures."""
    loops = {name: loops_of(frfs[c.loop], c, required[c.loop], fits[c.loop])[0] for name, c in controllers.items()}
    linears = [linear(dict(frf.operating_point)) for frf in frfs["theta1"]]
    figures = {
        **loop_pictures(loops, required["theta1"], verdicts),
        "plant": draw_plant(frfs["theta1"], fits["theta1"], linears),
        "steps": draw_steps(runs),
    }
    for name, figure in figures.items():
        write_bytes_whole(FIGURES / f"{name}.png", png(figure))


SCORES = ("item", "quantity", "source", "ours", "verdict", "why")


def write(name: str, columns: Sequence[str], rows: Sequence[Sequence]) -> None:
    """A small table beside this file, printed too."""
    print(f"-- {name}")
    for row in (columns, *rows):
        print("  ".join(str(cell) for cell in row))
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


if __name__ == "__main__":
    main()
