"""What each effect of the 1-DoF arm does, drawn and tabled, and whether its signature holds."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from loopshape.core.units import deg
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.effect.effect_study import effect_study, paths, signals
from loopshape.toolbox.gap.nouns.effect_sheet import EffectSheet
from loopshape.toolbox.rig.effect_sheets import sheets
from loopshape.toolbox.rig.effects import asked

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own second file, however it is started

from signatures import CLAIMS, P_T, U_P, U_T, static_mbar  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
SIZES = (
    "effect", "form", "magnitude", "unit", "path", "largest_db", "largest_deg", "static_shift_mbar", "static_span_mbar",
    "step_deg", "step_p_ab_mbar",
)  # fmt: skip
SIGNATURES = ("effect", "form", "column", "claim", "value", "unit", "holds")


def main() -> None:
    """Simulate, estimate, compare, draw; every form's signature, the first forms' sizes and pictures."""
    plant = Arm1()
    found = list(sheets(plant, effect_study(), asked(plant, every_form(plant)), signals, paths))
    first = [s for k, s in enumerate(found) if s.form.effect not in {t.form.effect for t in found[:k]}]
    write("results.csv", SIZES, [row for sheet in first for row in sizes(sheet)])
    answers = [row for sheet in found for row in claims(sheet)]
    write("signatures.csv", SIGNATURES, answers)
    for row in answers:
        print(f"{row[0]:>22}  {row[1]:<44.44} {row[2]:<10} {row[3]:<44} {row[4]:>8} {row[5]:<5} {row[6]}")
    names = {(s.form.effect, s.form.form) for s in first}
    for words, chosen in (("first forms", [r for r in answers if (r[0], r[1]) in names]), ("all forms", answers)):
        print(f"{words}: {sum(r[6] == 'yes' for r in chosen)} of {len(chosen)} claims hold")
    print("ended early:", [(s.form.effect, s.form.form, s.ended) for s in found if s.ended])


def every_form(plant: Arm1) -> list[str]:
    """NAME:FORM of the whole catalogue; an effect's first form first."""
    found: list[str] = []
    for form in plant.effects:
        found.append(f"{form.effect}:{1 + sum(k.startswith(form.effect + ':') for k in found)}")
    return found


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
            words = [claim.effect, sheet.form.form, claim.column, claim.words]
            rows.append([*words, f"{value:.3g}", claim.unit, "yes" if holds else "no"])
    return rows


if __name__ == "__main__":
    main()
