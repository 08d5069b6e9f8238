"""What each effect of the 1-DoF arm does, drawn and tabled, and whether its signature holds."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from loopshape.draw.effects import effects_page
from loopshape.draw.style import png
from loopshape.effect_sheet import EffectSheet
from loopshape.plants.arm.arm1 import Arm1
from loopshape.plants.arm.effect_study import effect_study, paths, signals
from loopshape.rigs.effect_sheets import sheets
from loopshape.rigs.effects import asked
from loopshape.store.files import write_bytes_whole
from loopshape.units import deg

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own second file, however it is started

from signatures import CLAIMS, P_T, U_P, U_T, static_mbar  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
SIZES = (
    "effect", "form", "magnitude", "unit", "path", "largest_db", "largest_deg", "static_shift_mbar", "static_span_mbar",
    "step_deg", "step_p_ab_mbar",
)  # fmt: skip
SIGNATURES = ("effect", "column", "claim", "value", "unit", "holds")


def main() -> None:
    """Simulate, estimate, compare, draw."""
    plant = Arm1()
    names = list(dict.fromkeys(form.effect for form in plant.effects))
    found = list(sheets(plant, effect_study(), asked(plant, names), signals, paths))
    write("results.csv", SIZES, [row for sheet in found for row in sizes(sheet)])
    answers = [row for sheet in found for row in claims(sheet)]
    write("signatures.csv", SIGNATURES, answers)
    for row in answers:
        print(f"{row[0]:>22}  {row[1]:<10} {row[2]:<44} {row[3]:>8} {row[4]:<5} {row[5]}")
    held = sum(row[5] == "yes" for row in answers)
    print(f"{held} of {len(answers)} claims hold")
    half = (len(found) + 1) // 2
    for k, part in enumerate((found[:half], found[half:])):
        title = f"What each effect does to the 1-DoF arm ({k + 1} of 2)"
        write_bytes_whole(FIGURES / f"effects_{k + 1}.png", png(effects_page(part, title=title)))


def write(name: str, columns: Sequence[str], rows: Sequence[Sequence]) -> None:
    """A small table beside this file."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


def sizes(sheet: EffectSheet) -> list[list]:
    """One line a path: largest change between 0.3 and 12 Hz at the middle excitation; statics and steps with each."""
    middle, span = static_mbar(sheet)
    steps = float(deg(sheet.times["steps", "theta2"].largest)), 1e3 * sheet.times["steps", "p_s"].largest
    rest = [round(middle, 1), round(span, 1), round(steps[0], 2), round(steps[1], 1)]
    rows = []
    for path in (U_T, U_P, P_T):
        change = sheet.frfs["middle", path].between(0.3, 12.5)
        worst = [float(v[np.argmax(np.abs(v))]) for v in (change.gain_db, change.phase_deg)]
        head = [sheet.form.effect, sheet.form.form, round(sheet.magnitude, 4), sheet.form.unit, path]
        rows.append([*head, round(worst[0], 2), round(worst[1], 1), *rest])
    return rows


def claims(sheet: EffectSheet) -> list[list]:
    """Whether the effect's claims hold."""
    rows = []
    for claim in CLAIMS:
        if claim.effect == sheet.form.effect:
            value, holds = claim.test(sheet)
            rows.append([claim.effect, claim.column, claim.words, f"{value:.3g}", claim.unit, "yes" if holds else "no"])
    return rows


if __name__ == "__main__":
    main()
