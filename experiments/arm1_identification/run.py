"""The source's identification of its 1-DoF arm (4.12-4.15 and section 4.3), done on the simulated arm."""

from __future__ import annotations

import csv
import sys
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "lab")]  # the study's other files and the lab, however it is started

from arm1_identification_figures import draw_frfs, draw_maps, draw_sensitivity  # noqa: E402
from arm1_scores import write_scores  # noqa: E402
from arm1_statements import Statements, scores_of_fits, scores_of_statements  # noqa: E402
from arm1_sweeps import Arm, Found, by_formula_4_9, found, recorded  # noqa: E402

from loopshape.data.control.controller import Block  # noqa: E402
from loopshape.data.signal.recording import Recording  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.toolbox.rig.study import Study  # noqa: E402
from loopshape.view.style import png  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
COLUMNS = (
    "arm", "theta2_deg", "p_ab_bar", "supply_bar", "kappa", "kappa_low", "kappa_high", "f_hz", "f_low", "f_high",
    "zeta", "zeta_low", "zeta_high", "misfit_db", "coherent_from_hz", "coherent_to_hz", "valid_from_hz",
    "valid_to_hz", "kappa_linear", "f_linear_hz", "zeta_linear",
)  # fmt: skip
LOOPS = ("arm", "theta2_deg", "p_ab_bar", "pressure_gain", "kappa", "f_hz", "zeta", "zeta_low", "zeta_high",
         "zeta_linear")  # fmt: skip
PROCEDURE = ("sweep", "theta2_deg", "p_ab_bar", "rms_formula_over_estimator", "kappa", "f_hz", "zeta",
             "coherent_from_hz", "coherent_to_hz")  # fmt: skip


def main() -> None:
    """Measure all arms, fit, judge, draw."""
    settings = tomllib.loads((HERE / "settings.toml").read_text(encoding="utf-8"))
    study, rules = read_study(HERE / "study.toml"), settings["rules"]
    every: dict[str, list[Found]] = {}
    procedure: list[list[Any]] = []
    for name, table in settings["arms"].items():
        arm = Arm.from_table(name, table)
        run, recordings = recorded(study, arm)
        every[name] = found(run, recordings, arm)
        if not arm.effects and not arm.only:
            gain = run.loop("theta2").controller
            assert gain is not None
            value = gain.blocks[0].parameters["gain"]
            procedure = [by_hand(r, f, value, rules) for r, f in zip(recordings, every[name], strict=True)]
    full = {name: [f for f in fs if not f.name.startswith("linear")] for name, fs in every.items()}
    write("fits.csv", COLUMNS, [row(f, rules["coherent"]) for fs in full.values() for f in fs])
    named = set(settings["points"].values())
    write("procedure.csv", PROCEDURE, [p[1:] for p in procedure if p[0] in named or p[1] == "linear"])
    write("pressure_loop.csv", LOOPS, slow_pressure(study, settings))
    judge(settings, full, procedure)
    draw(settings, full)


def slow_pressure(study: Study, settings: Mapping[str, Any]) -> list[list[Any]]:
    """Fits at the wide point with the pressure loop as it is and slower: how much of zeta is that loop's."""
    given, rows = settings["pressure_loop"], []
    for gain in given["gains"]:
        blocks = (Block("gain", {"gain": gain}), Block("low_pass_1", {"f_hz": given["low_pass_hz"]}))
        own = replace(study, controllers={**study.controllers, "p_ab": blocks})
        for name in ("nominal", "gas_law"):
            arm = Arm.from_table(name, settings["arms"][name])
            (f,) = found(*recorded(own, arm, [settings["points"]["wide"]]), arm)
            zeta = [f"{x:.4f}" for x in (f.value("zeta"), *f.interval("zeta"), f.linear.third_order()[2])]
            rows.append([name, *f.point, gain, f"{f.value('kappa'):.0f}", f"{f.value('f_hz'):.3f}", *zeta])
    return rows


def by_hand(recording: Recording, f: Found, gain: float, rules: Mapping[str, float]) -> list[Any]:
    """The estimate by (4.9) written out, against the workbench's, on the lines that this trusts."""
    lines, H = by_formula_4_9(recording, gain, rules["segment_s"])
    mine = f.frf.valid_lines()
    at = np.interp(mine.frequency_hz, lines, H)
    rms = float(np.sqrt(np.mean(np.abs(at / mine.siso - 1.0) ** 2)))
    low, high = f.coherent_band_hz(rules["coherent"])
    kind = "linear" if f.name.startswith("linear") else "logarithmic"
    fitted = [f"{f.value('kappa'):.0f}", f"{f.value('f_hz'):.3f}", f"{f.value('zeta'):.4f}"]
    return [f.name, kind, *f.point, f"{rms:.4f}", *fitted, f"{low:.2f}", f"{high:.1f}"]


def row(f: Found, coherent: float) -> list[Any]:
    """One line of fits.csv."""
    cells: list[Any] = [f.arm.name, *f.point, f.frf.parameters.get("supply_bar", 1.0)]
    for name, form in (("kappa", ".0f"), ("f_hz", ".3f"), ("zeta", ".4f")):
        cells += [format(x, form) for x in (f.value(name), *f.interval(name))]
    cells += [f"{f.fit.misfit_db:.2f}", *(f"{x:.2f}" for x in f.coherent_band_hz(coherent))]
    cells += [f"{x:.2f}" for x in f.frf.valid_band_hz]
    kappa, f_hz, zeta = f.linear.third_order()
    return [*cells, f"{kappa:.0f}", f"{f_hz:.3f}", f"{zeta:.4f}"]


def judge(settings: Mapping[str, Any], full: Mapping[str, list[Found]], procedure: Sequence[list[Any]]) -> None:
    """The scoreboard's rows, and the statements' numbers in a table."""
    rules, points = settings["rules"], settings["points"]
    stated = {name: Statements(tuple(full[name]), rules) for name in ("nominal", "gas_law")}
    scores = scores_of_fits(full, points, rules) + scores_of_statements(stated)
    write_scores(HERE / "scores.csv", scores)
    write("statements.csv", ("arm", "quantity", "value"), [[n, *r] for n, s in stated.items() for r in s.table()])
    for score in scores:
        print(f"{score.item:12} {score.verdict:9} {score.quantity}: {score.ours}")
    for line in (PROCEDURE, *(p[1:] for p in procedure if p[1] == "linear")):
        print("  ".join(f"{cell!s:>14.14}" for cell in line))


def draw(settings: Mapping[str, Any], full: Mapping[str, list[Found]]) -> None:
    """All figures."""
    pair = [full["nominal"], full["gas_law"]]
    write_bytes_whole(FIGURES / "frfs.png", png(draw_frfs(pair)))
    write_bytes_whole(FIGURES / "maps.png", png(draw_maps(pair)))
    places = {
        "upright": {"measured": "figure_4_12", "simulated": "figure_4_14"},
        "wide": {"measured": "figure_4_15.measured", "simulated": "figure_4_15.simulated"},
    }
    for point, published in places.items():
        mine = [next(f for f in fs if f.name == settings["points"][point]) for fs in pair]
        write_bytes_whole(FIGURES / f"{point}.png", png(draw_sensitivity(mine, published)))


def write(name: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """A small table beside this file."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


if __name__ == "__main__":
    main()
