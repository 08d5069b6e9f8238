"""Both joints: the source's controllers on the measured plants, steps, and the damping that p_A's loop adds."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "lab")]  # the study's other files and the lab, however it is started

from arm2_closed import close2  # noqa: E402
from dual_damping import DAMPING, SIMULATED, linear_rows, read_settings, simulated_rows  # noqa: E402
from dual_pictures import draw_damping, draw_steps, entitled  # noqa: E402
from dual_scores import Found, scores  # noqa: E402
from dual_steps import INTERACTION, STEPS, interaction_rows, step_rows, stepped  # noqa: E402
from source_controllers import controller  # noqa: E402

from loopshape.core.units import db  # noqa: E402
from loopshape.data.algebra.propagation import pick  # noqa: E402
from loopshape.data.control.controller import Block, Controller  # noqa: E402
from loopshape.data.requirement.requirements import Requirements  # noqa: E402
from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.data.result.verdict import Verdict  # noqa: E402
from loopshape.identify.frequency_response import estimate_realisations  # noqa: E402
from loopshape.identify.matrix.matrix import estimate_matrix  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.io.requirements import read_requirements  # noqa: E402
from loopshape.loop.loops import loops_of  # noqa: E402
from loopshape.loop.verdict import check  # noqa: E402
from loopshape.toolbox.arm.arm2 import Arm2  # noqa: E402
from loopshape.toolbox.arm.dynamics.linear2 import linearise2  # noqa: E402
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2  # noqa: E402
from loopshape.toolbox.arm.source import value  # noqa: E402
from loopshape.toolbox.arm.strategies2 import DUAL  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.toolbox.rig.simulated import header, measure  # noqa: E402
from loopshape.view.plots.loops import loop_page  # noqa: E402
from loopshape.view.plots.nichols import nichols  # noqa: E402
from loopshape.view.style import png  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
ANGLES = ("theta1", "theta2")
P_C_BAR = tuple(value(f"figure_5_8.p_c_{k}") for k in ("04", "06", "08"))
DELAY, HIGHEST_HZ = 3, 15.0  # samples of the PWM's delay, and up to where oscillations are looked at
LEVEL_BAND_HZ = (0.2, 1.0)  # where figure 5.8's levels are read, as in experiments/arm2_interaction
SCORES = ("item", "quantity", "source", "ours", "verdict", "why")


@dataclass(frozen=True, eq=False)
class Measured:
    """All that was measured at one p_C: 2 x 2 of the angles, 4 x 4, and each pressure with the other loops closed."""

    angles: FRF
    four: FRF
    pressures: dict[str, FRF]


def main() -> None:
    """Measure, check, step, sweep; write tables, figures and scores."""
    required = {one.loop: one for one in read_requirements(HERE / "requirements.toml")}
    found = measured()
    printed, own = source_controllers(), {c.loop: c for c in Arm2().default_controllers(1000.0)}
    verdicts = judged(found, printed, own, required)
    write("margins.csv", MARGINS, [row for name, one in verdicts.items() for row in margin_rows(name, one)])
    causes = [row for k, loop in enumerate(ANGLES) for row in cause_rows(found, k, printed[loop], required[loop])]
    write("causes.csv", CAUSES, causes)
    sets = {"source's": list(printed.values()), "plant's own": list(own.values())}
    several = together(found, sets)
    at_once = [row for name, one in several.items() for row in several_rows(name, one, sets)]
    write("several.csv", SEVERAL, at_once)
    runs = {"plant's own": stepped(HERE / "steps.toml", {}), "source's": stepped(HERE / "steps.toml", printed)}
    steps = step_rows(runs["plant's own"])
    write("steps.csv", STEPS, steps)
    moved = interaction_rows(runs["plant's own"])
    write("interaction.csv", INTERACTION, moved)
    settings = read_settings(HERE / "damping.toml")
    linear, simulated = linear_rows(settings), simulated_rows(settings)
    write("damping.csv", DAMPING, linear)
    write("damping_simulated.csv", SIMULATED, simulated)
    pages(found, printed, verdicts, required)
    for name, page in draw_steps(runs).items():
        write_bytes_whole(FIGURES / f"{name}.png", png(page))
    write_bytes_whole(FIGURES / "damping.png", png(draw_damping(linear, simulated)))
    write("scores.csv", SCORES, scores(Found(verdicts, causes, at_once, steps, moved, runs, linear, simulated)))


def measured() -> list[Measured]:
    """One entry a p_C of figure 5.8."""
    study, plant, out = read_study(HERE / "study.toml"), Arm2(), []
    for point in study.operating_points:
        here = replace(study, operating_points=(point,))
        run, name = header(here, plant), f"p_C {point['p_c_bar']:g} bar"
        recordings = list(measure(here, plant, threads=1))
        angles = [r for r in recordings if r.info.excites in ANGLES]
        pressures = {
            loop: estimate_realisations([r for r in recordings if r.info.excites == loop], run.loop(loop))
            for loop in ("p_a", "p_c")
        }
        out.append(
            Measured(
                replace(estimate_matrix(run, angles), recording=name),
                replace(estimate_matrix(run, recordings), recording=name),
                {loop: replace(frf, recording=name) for loop, frf in pressures.items()},
            )
        )
    return out


def source_controllers() -> dict[str, Controller]:
    """Tables 5.4, 5.5 and 5.6 by loop."""
    tables = {"theta1": "table_5_4", "theta2": "table_5_5", "p_a": "table_5_6", "p_c": "table_5_6"}
    return {loop: controller(table, loop) for loop, table in tables.items()}


def element(frf: FRF, k: int) -> FRF:
    """P11 or P22 of the angles' matrix, as the source takes it."""
    return replace(pick(frf, [k], [k]), loop=ANGLES[k])


def plants(found: Sequence[Measured], loop: str) -> list[FRF]:
    """The plant that a controller of this loop is judged on, one a point."""
    return [element(m.angles, ANGLES.index(loop)) if loop in ANGLES else m.pressures[loop] for m in found]


def judged(
    found: Sequence[Measured],
    printed: dict[str, Controller],
    own: dict[str, Controller],
    required: dict[str, Requirements],
) -> dict[str, Verdict]:
    """Each controller alone on its own plant."""
    named = {f"source's {loop}": one for loop, one in printed.items()}
    named |= {f"plant's own {loop}": own[loop] for loop in ANGLES}
    return {name: check(plants(found, one.loop), one, required[one.loop]) for name, one in named.items()}


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


CAUSES = (
    "loop", "case", "least_bandwidth_hz", "least_phase_margin_deg", "largest_sensitivity_db", "linear_least_damping",
    "linear_f_hz",
)  # fmt: skip


def cause_rows(found: Sequence[Measured], k: int, printed: Controller, required: Requirements) -> list[list]:
    """The printed controller, with its notch at our mode, with its gain for the source's level, and with both."""
    frfs = [element(m.angles, k) for m in found]
    lin = constants2(ARM2_PARAMETERS.vector())
    modes = [linearise2(lin, *(f.operating_point[key] for key in DUAL.point_keys)).modes()[k][0] for f in frfs]
    factor = float(10.0 ** ((value(f"figure_5_8.p{k + 1}{k + 1}") - np.mean([level_db(f) for f in frfs])) / 20.0))
    cases = {
        "as printed": printed,
        "notch at our modes' mean": changed(printed, float(np.mean(modes)), 1.0),
        f"gain times {factor:.2g}, for figure 5.8's level": changed(printed, None, factor),
        "both": changed(printed, float(np.mean(modes)), factor),
    }
    return [cause_row(k, name, one, check(frfs, one, required)) for name, one in cases.items()]


def level_db(frf: FRF) -> float:
    """Median magnitude in `LEVEL_BAND_HZ`."""
    return float(np.median(db(frf.between(*LEVEL_BAND_HZ).siso)))


def changed(of: Controller, notch_hz: float | None, factor: float) -> Controller:
    """The controller with another notch frequency, or another gain."""
    blocks = []
    for b in of.blocks:
        values = dict(b.parameters)
        if b.kind == "notch" and notch_hz is not None:
            values |= {"f1_hz": notch_hz, "f2_hz": notch_hz}
        blocks.append(Block(b.kind, {"gain": factor * values["gain"]} if b.kind == "gain" else values))
    return replace(of, blocks=tuple(blocks))


def cause_row(k: int, name: str, of: Controller, verdict: Verdict) -> list:
    """The worst of all points; linear with the other three loops closed by the plant's own controllers."""
    m = list(verdict.margins.values())
    numbers = [
        min(x.bandwidth_hz for x in m),
        min(x.phase_margin_deg for x in m),
        max(x.sensitivity_peak_db for x in m),
    ]
    controllers = list(Arm2().default_controllers(of.rate_hz))
    controllers[k] = of
    zeta, f_hz = min(least_damped(controllers, p_c) for p_c in P_C_BAR)
    return [of.loop, name, *(f"{x:.3g}" for x in numbers), f"{zeta:.3f}", f"{f_hz:.3g}"]


def least_damped(controllers: Sequence[Controller], p_c_bar: float) -> tuple[float, float]:
    """Damping and frequency of the linear loop's least damped oscillation below `HIGHEST_HZ`."""
    lin = linearise2(constants2(ARM2_PARAMETERS.vector()), 0.0, 0.0, value("figure_5_8.p_a"), p_c_bar)
    return min((zeta, f_hz) for f_hz, zeta in close2(lin, controllers, DELAY).modes() if f_hz < HIGHEST_HZ)


def together(found: Sequence[Measured], sets: dict[str, list[Controller]]) -> dict[str, Verdict]:
    """All loops at once: the angles with the pressures closed as they were, and all four."""
    held, out = sets["plant's own"], {}
    for name, controllers in sets.items():
        out[f"{name}, angles"] = check([m.angles for m in found], controllers[:2], recorded_under=held[:2])
        out[f"{name}, all four"] = check([m.four for m in found], controllers, recorded_under=held)
    return out


SEVERAL = (
    "controllers", "point", "stable", "disk_margin", "gain_margin_db", "phase_margin_deg", "modulus_margin",
    "linear_least_damping", "linear_f_hz",
)  # fmt: skip


def several_rows(name: str, verdict: Verdict, sets: dict[str, list[Controller]]) -> list[list]:
    """A line a point; beside it the least damped oscillation below 15 Hz of the linearisation with all four closed."""
    rows = []
    for (point, m), p_c in zip(verdict.margins.items(), P_C_BAR, strict=True):
        zeta, f_hz = least_damped(sets[name.split(",")[0]], p_c)
        found = (m.disk_margin, m.gain_margin_db, m.phase_margin_deg, m.modulus_margin)
        rows.append([name, point, m.stable, *(f"{x:.3g}" for x in found), f"{zeta:.3f}", f"{f_hz:.3g}"])
    return rows


TABLES = {"theta1": "table 5.4", "theta2": "table 5.5"}


def pages(
    found: Sequence[Measured],
    printed: dict[str, Controller],
    verdicts: dict[str, Verdict],
    required: dict[str, Requirements],
) -> None:
    """Loop pages and Nichols charts of both angles under the source's controllers."""
    for loop, page, chart in (("theta1", "figure_5_9", "figure_h_8"), ("theta2", "figure_5_10", "figure_h_9")):
        loops, _ = loops_of(plants(found, loop), printed[loop], required[loop])
        verdict = verdicts[f"source's {loop}"]
        under = f"{loop} under the source's controller ({TABLES[loop]}), simulated arm"
        drawn = {
            page: entitled(loop_page(loops, required[loop], verdict=verdict), under),
            chart: entitled(nichols(loops, required[loop], verdict=verdict).figure, f"Open loop of {under}"),
        }
        for name, figure in drawn.items():
            write_bytes_whole(FIGURES / f"{name}.png", png(figure))


def write(name: str, columns: Sequence[str], rows: Sequence[Sequence]) -> None:
    """A small table beside this file, printed too."""
    print(f"-- {name}")
    for row in (columns, *rows):
        print("  ".join(str(cell) for cell in row))
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


if __name__ == "__main__":
    main()
