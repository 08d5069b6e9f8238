"""The source's control of its 1-DoF arm (section 5.2, H.2, H.3) on its printed plants and on simulated arms."""

from __future__ import annotations

import csv
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
SWEEPS = HERE.parent / "arm1_identification"
sys.path[:0] = [str(HERE), str(SWEEPS), str(HERE.parent / "lab")]  # its own files, the identification's, and the lab

from arm1_control_figures import draw_loops, draw_pressure, draw_printed, draw_steps, draw_tracking  # noqa: E402
from arm1_control_scores import Results, all_scores  # noqa: E402
from arm1_loops import (  # noqa: E402
    Judged,
    Spread,
    causes,
    identified,
    judge,
    judge_identical,
    matched,
    of,
    on_printed_plants,
    pressure_loop,
)
from arm1_motion import Crossing, Followed, Moved, cells, moved, printed_step, read_off  # noqa: E402
from arm1_scores import write_scores  # noqa: E402
from arm1_sweeps import Found  # noqa: E402
from source_controllers import angle_controller, pressure_controller, third_order_plant  # noqa: E402

from loopshape.core.units import deg  # noqa: E402
from loopshape.data.control.controller import Controller  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.io.write.controllers import read_controllers  # noqa: E402
from loopshape.toolbox.arm.source import value  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.view.style import png  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
SHIPPED = HERE.parent.parent / "examples" / "arm" / "controller.toml"
MARGINS = ("stable", "as_required", "bandwidth_hz", "phase_margin_deg", "gain_margin_db", "sensitivity_peak_db")
POINTS = ("theta2_deg", "p_ab_bar", *MARGINS)
WORST = ("arm", "controller", "points", "stable", "as_required", "bandwidth_low_hz", "bandwidth_high_hz",
         "phase_margin_deg", "gain_margin_db", "sensitivity_peak_db", "verdict")  # fmt: skip
CAUSES = ("arm", "theta2_deg", "p_ab_bar", "ours", "kappa_ratio", "f_ratio", "zeta_ratio", *MARGINS)
STEPS = ("arm", "controllers", "loop", "at_s", "size", "rise_s", "settling_2_s", "settling_5_s", "overshoot",
         "static_error", "outcome")  # fmt: skip
TRACKING = ("arm", "controllers", "delay_s", "overshoot_at_30", "overshoot_at_minus_30", "overshoot_at_0",
            "largest_error_deg", "rms_error_deg", "p_ab_least_bar", "p_ab_most_bar")  # fmt: skip


def main() -> None:
    """Margins, then motion, then judge and draw."""
    settings = tomllib.loads((HERE / "settings.toml").read_text(encoding="utf-8"))
    rules, grid = settings["rules"], settings["lines"]
    printed = on_printed_plants(grid, rules["delay_s"])
    rows = [[place, words, f"{1e3 * delay:g}", *of(m)] for place, words, delay, _, m in printed]
    write("printed.csv", ("plant", "notch", "delay_ms", *MARGINS), rows)
    angle, every = angle_loops(settings)
    write("margins.csv", WORST, [j.row() for j in angle.values()])
    rows = [row for name in ("nominal", "gas_law") for row in causes(every[name], grid, rules["delay_s"])]
    write("causes.csv", CAUSES, rows)
    study = read_study(HERE / "study.toml")
    arms = {name: matched(table, name) for name, table in settings["arms"].items()}
    pressure = {n: pressure_loop(study, arms[n], pressure_controller()) for n in ("nominal", "closest")}
    write("pressure.csv", WORST, [j.row() for j in pressure.values()])
    moves = {n: moved(study, arms[n], *controllers(settings["arms"][n]["angle"])) for n in ("nominal", "closest")}
    if fallen := [m.arm.label for m in moves.values() if not m.whole]:
        raise SystemExit(f"left the model's range: {', '.join(fallen)}")
    spreads = {name: Spread.of(found) for name, found in every.items()}
    motion(printed, (angle, spreads, pressure), moves, rules)


def angle_loops(settings: Mapping[str, Any]) -> tuple[dict[tuple[str, str], Judged], dict[str, list[Found]]]:
    """Each arm's 24 FRFs under the source's controllers and the shipped one; a table of all points for two of them."""
    study = read_study(SWEEPS / "study.toml")
    notch = value("figure_5_7.notch")
    tried = {
        "source": angle_controller(),
        "source, lower notch": angle_controller(notch_hz=notch),
        "shipped": shipped()[0],
    }
    angle, every = {}, {}
    for name, table in settings["arms"].items():
        every[name] = identified(study, matched(table, name))
        for words, controller in tried.items():
            angle[name, words] = judge(words, every[name], controller)
        angle[name, "alike"] = judge_identical(every[name], tried["source"])
    for name, words in (("nominal", "source"), ("closest", "source"), ("closest", "alike")):
        write(f"points_{name}_{words}.csv", POINTS, at_points(angle[name, words]))
    return angle, every


def at_points(j: Judged) -> list[list[Any]]:
    """Margins at every equilibrium."""
    points = [loop.plant.operating_point for loop in j.loops]
    return [[p["theta2_deg"], p["p_ab_bar"], *of(m)] for p, m in zip(points, j.margins, strict=True)]


def shipped() -> tuple[Controller, Controller]:
    """The example's controllers of angle and pressure."""
    found = {c.loop: c for c in read_controllers(SHIPPED)}
    return found["theta2"], found["p_ab"]


def controllers(word: str) -> tuple[str, tuple[Controller, ...]]:
    """Words for, and controllers of both loops; the pressure's is table 5.2 in any case."""
    if word == "source":
        return "the source's controllers", (angle_controller(), pressure_controller())
    return "shipped angle controller, the source's for p_AB", (shipped()[0], pressure_controller())


def motion(
    printed: Sequence[Any],
    loops: tuple[Mapping[tuple[str, str], Judged], Mapping[str, Spread], Mapping[str, Judged]],
    moves: Mapping[str, Moved],
    rules: Mapping[str, float],
) -> None:
    """Tables of steps and tracking, scores and figures."""
    template = {e.name: e for e in read_study(HERE / "study.toml").experiments}["steps"]
    times = {loop: list(r.times_s) for loop, r in template.references.items()}
    size = value("step_5_3.theta2")
    plant = third_order_plant("figure_4_12")
    computed = {"linear": printed_step(plant, None, size, 3.0), "limited": printed_step(plant, 1.0, size, 3.0)}
    read = {name: read_off(*step, size) for name, step in computed.items()}
    alone = [[f"printed plant, {n}", "table 5.1", "theta2", "", size, *cells(x, size)] for n, x in read.items()]
    write("steps.csv", STEPS, [*step_rows(moves), *alone])
    followed = {n: Followed.of(m, 0.6) for n, m in moves.items()}
    write("tracking.csv", TRACKING, [tracking_row(m, followed[n]) for n, m in moves.items()])
    crossings = {n: Crossing.of(m, times) for n, m in moves.items()}
    asked = list(template.references["p_ab"].values)[-1]
    results = Results(printed, *loops, moves, crossings, followed, read, asked, rules)
    scores = all_scores(results)
    write_scores(HERE / "scores.csv", scores)
    for score in scores:
        print(f"{score.item:10} {score.verdict:9} {score.quantity}: {score.ours}")
    named = {
        "printed plant, source's controller": computed["linear"],
        "the same, |z| at most 1 V": computed["limited"],
    }
    pictures(results, named, times["theta2"][0])


def step_rows(moves: Mapping[str, Moved]) -> list[list[Any]]:
    """The first two steps of each loop; angles in deg, pressures in bar."""
    out: list[list[Any]] = []
    for m in moves.values():
        for loop, unit in (("theta2", float(deg(1.0))), ("p_ab", 1.0)):
            for k in (0, 1):
                step = m.step(loop, k)
                numbers = cells(step.measured, step.size, unit)
                out.append([m.arm.name, m.controllers, loop, step.at_s, f"{step.size * unit:.3g}", *numbers])
    return out


def tracking_row(m: Moved, f: Followed) -> list[Any]:
    """One line of tracking.csv."""
    over = [f"{x:.1f}" for x in f.overshoots_deg]
    errors = [f"{x:.1f}" for x in (f.largest_error_deg, f.rms_error_deg)]
    return [
        m.arm.name,
        m.controllers,
        f"{f.delay_s:.3f}",
        *over,
        *errors,
        f"{f.lowest_bar:.2f}",
        f"{f.highest_bar:.2f}",
    ]


def pictures(r: Results, computed: Mapping[str, Any], at_s: float) -> None:
    """All figures."""
    shown = [r.angle["nominal", "source"], r.angle["nominal", "shipped"], r.angle["closest", "source"]]
    words = ["source's, model as printed", "shipped, model as printed", "source's, closest arm"]
    write_bytes_whole(FIGURES / "printed_plants.png", png(draw_printed(r.printed)))
    write_bytes_whole(FIGURES / "angle_loops.png", png(draw_loops(shown, words)))
    write_bytes_whole(FIGURES / "pressure_loop.png", png(draw_pressure(list(r.pressure.values()))))
    write_bytes_whole(FIGURES / "steps.png", png(draw_steps(list(r.moves.values()), computed, at_s)))
    write_bytes_whole(FIGURES / "tracking.png", png(draw_tracking(list(r.moves.values()))))


def write(name: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """A small table beside this file, also printed."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    print(name)
    for row in (columns, *rows):
        print("  ".join(f"{cell!s:>14.14}" for cell in row))


if __name__ == "__main__":
    main()
