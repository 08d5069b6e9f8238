"""A simulated tensile bench for the source's muscle: what it measures, what its parameters are worth, other models."""

from __future__ import annotations

import csv
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "lab")]  # the study's other files and the lab, however it is started

import muscle_parameters as six  # noqa: E402
from muscle_drawings import draw_bench  # noqa: E402
from muscle_drawings_models import draw_models  # noqa: E402
from muscle_findings import Found, find  # noqa: E402
from muscle_law import damping, printed  # noqa: E402
from muscle_models import closed_air  # noqa: E402
from muscle_points import BAND  # noqa: E402
from muscle_scores_appendix import scores  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
POINTS = (
    "law", "muscle", "h_mm", "p_bar", "k_w_kn_m", "k_w_95", "slope_true_kn_m", "k_model_kn_m", "k_w_over_k",
    "d_w_ns_m", "d_w_95", "d_true_ns_m",
)  # fmt: skip


def main() -> None:
    """Measure, fit, compare, write."""
    words = tomllib.loads((HERE / "study.toml").read_text(encoding="utf-8"))
    found = find(words)
    write("points.csv", POINTS, [point_row(row) for row in found.every])
    write("parameters.csv", *parameter_table(found))
    write("digits.csv", ("significant_digits", "error_table_form", "error_centred"), found.digit_errors)
    write("models.csv", *model_table(found))
    write("arm.csv", *arm_table(found))
    write("closed_air.csv", *closed_table(found))
    write("summary.csv", ("quantity", "value", "unit"), found.summary())
    write("scores.csv", ("item", "quantity", "source", "ours", "verdict", "why"), scores(found), show=False)
    draw_bench(found, words, FIGURES)
    draw_models(found, words, FIGURES)


def write(name: str, head: Sequence[str], rows: Sequence[Sequence[Any]], show: bool = True) -> None:
    """A table on the screen (its first lines) and as a file."""
    with (HERE / name).open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *rows])
    print(f"\n{name}: {len(rows)} rows")
    for row in (head, *rows)[: 30 if show else 0]:
        print("  ".join(f"{cell!s:>12}" for cell in row))


def point_row(row: Any) -> list[Any]:
    """One line of points.csv."""
    f = row.found
    return [
        row.law, row.muscle.name, round(1e3 * row.h_m), row.p_bar,
        round(1e-3 * f.k, 4), round(1e-3 * BAND * f.k_std, 4),
        round(1e-3 * row.slope, 4), round(1e-3 * row.k, 4), round(f.k / row.k, 3), round(f.d, 2),
        round(BAND * f.d_std, 2), round(damping(row.p_bar), 2),
    ]  # fmt: skip


def parameter_table(found: Found) -> tuple[list[str], list[list[Any]]]:
    """Table 4.1's numbers: printed, found by each bench, with 95 % half widths; and under the source's residual."""
    head, rows = ["parameter", "printed"], []
    for law in found.fits:
        head += [law, "half_95"]
    head += ["half_95_at_source_residual", "digits_nearest_the_bench"]
    wide = BAND * np.sqrt(np.diag(found.scattered.normal_covariance))
    for i, name in enumerate(six.NAMES):
        row: list[Any] = [name, astuple(printed())[i]]
        for fit in found.fits.values():
            half = BAND * np.sqrt(fit.normal_covariance[i, i])
            row += [f"{astuple(fit.digits)[i]:.4g}", f"{half:.2g}"]
        rows.append([*row, f"{wide[i]:.2g}", f"{astuple(found.nearest)[i]:.5g}"])
    return head, rows


def model_table(found: Found) -> tuple[list[str], list[list[Any]]]:
    """Where models differ from the source's by more than the stated share."""
    head = ["model", "quantity", "share_apart_below", "share_apart_above", "median_ratio_below", "median_ratio_above"]
    return head, [[c.model, c.quantity, *(round(v, 3) for v in c.numbers)] for c in found.comparisons]


def arm_table(found: Found) -> tuple[list[str], list[list[Any]]]:
    """Eigenfrequency and k_AB of the arm by each reading."""
    head = ["what", "f_0deg_hz", "f_30deg_hz", "zeta_0deg", "kappa_0deg", "k_ab_joint_inertia_kn_m", "k_ab_jzz2_kn_m"]
    return head, [[r.what, *(f"{v:.4g}" for v in r.numbers)] for r in found.arm]


def closed_table(found: Found) -> tuple[list[str], list[list[Any]]]:
    """Figure G.3's stiffnesses and slopes with closed valves by first principles, kN/m."""
    p, h, k, _ = found.five
    slopes = closed_air(p, h)
    rows = [
        [round(1e3 * h[n]), round(1e-3 * k[n], 2), *(round(1e-3 * float(v[n]), 3) for v in slopes.values())]
        for n in range(k.size)
    ]
    return ["h_mm", "source_k_w_kn_m", *(f"{name} [kN/m]" for name in slopes)], rows


if __name__ == "__main__":
    main()
