"""Where the arm stands still with the fitted and the analytical stiffness (figures 4.7-4.10, 5.1), and how firmly."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import equilibria_pictures as pictures  # noqa: E402
from equilibria_scores import POINTS, Row, scores  # noqa: E402
from standing import (  # noqa: E402
    ANALYTICAL,
    GASES,
    MODELS,
    arm,
    firmness,
    firmness_map,
    held_at_length,
    largest_gain,
    lowest_stable_bar,
    off_square_deg,
    shift_deg,
    supply_bar,
    within_digits,
)

from loopshape.core.units import Array  # noqa: E402
from loopshape.io.files import read_toml, write_bytes_whole  # noqa: E402
from loopshape.toolbox.arm.dynamics.equilibrium import angle_deg, pressure_map, pressures  # noqa: E402
from loopshape.toolbox.arm.source import EQUILIBRIA, value  # noqa: E402
from loopshape.view.style import png  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
DIFFERENCES = ("where", "other_model", "places", "without_rest", "median_deg", "largest_deg", "share_below_5_deg")
STABILITY = ("stiffness", "gas_law", "valves", "gravity", "lowest_stable_p_ab_bar", "each_muscle_bar")
SCORES = ("item", "quantity", "source", "ours", "verdict", "why")


def main() -> None:
    """Compute the maps, the tables and the figures."""
    s = read_toml(HERE / "study.toml")
    points = [point_row(*point) for point in EQUILIBRIA]
    plane = differences(s)
    stable = stability_rows()
    moves, cuts = sensitivities(s), cut_rows(s)
    write("points.csv", POINTS, points)
    write("difference.csv", DIFFERENCES, plane)
    write("stability.csv", STABILITY, stable)
    angles = [f"at_{t:g}_deg" for t in s["sensitivity"]["angles_deg"]]
    write("sensitivity.csv", ("moved", "p_ab_bar", *angles), moves)
    write("scores.csv", SCORES, scores(s, points, plane, moves))
    for name, figure in pictures.pages(maps(s), points, cuts, firm_maps(s), moves, s):
        write_bytes_whole(FIGURES / f"{name}.png", png(figure))


def write(name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """One table as a file and on the screen."""
    rows = list(rows)
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    print(f"-- {name}")
    for row in (columns, *rows):
        print("  ".join(str(cell) for cell in row))


def point_row(theta2_deg: float, p_ab_bar: float) -> Row:
    """One of the 24 points with both stiffnesses."""
    fitted, analytical = (arm(moves) for moves in MODELS.values())
    pair, other = pressures(fitted, theta2_deg, p_ab_bar), pressures(analytical, theta2_deg, p_ab_bar)
    there = angle_deg(analytical, *pair)
    row: Row = [theta2_deg, p_ab_bar, *(round(p, 4) for p in (*pair, *other)), max(pair) <= supply_bar()]
    row += [round(there, 2), round(there - theta2_deg, 2)]
    for moves in MODELS.values():
        gauge, absolute = (firmness(arm({**moves, **gas}), theta2_deg, p_ab_bar) for gas in GASES.values())
        row += [round(k, 2) for k in (gauge.pressure, gauge.closed, absolute.closed)]
    row += [round(off_square_deg(c, theta2_deg, p_ab_bar), 1) for c in (fitted, analytical)]
    return row + [round(largest_gain(c, theta2_deg, p_ab_bar), 2) for c in (fitted, analytical)]


def axes(s: dict, name: str) -> tuple[Array, Array]:
    """Angles in deg and p_AB in bar of a plane of the settings."""
    plane, widest = s[name], s["plane"]["widest_deg"]
    angles = np.linspace(-widest, widest, s["plane"]["angles"])
    return angles, np.linspace(plane["low_bar"], plane["high_bar"], plane["sums"])


def maps(s: dict) -> dict[str, tuple[Array, ...]]:
    """Both stiffnesses' maps: axis of the pressures and theta2 over them; angles, sums and both pressures over them."""
    p = s["pressures"]
    grid, (angles, sums) = np.linspace(p["low_bar"], p["high_bar"], p["count"]), axes(s, "plane")
    made = {}
    for name, moves in MODELS.items():
        c = arm(moves)
        made[name] = (grid, wide_map(c, grid, p["widest_deg"]), angles, sums, *pressure_map(c, angles, sums))
    return made


def wide_map(c: Array, grid: Array, widest_deg: float) -> Array:
    """Angle in deg over p_A and p_B, some way beyond the model's range, so that no contour inside is cut."""
    return np.array([[angle_deg(c, a, b, widest_deg) for a in grid] for b in grid])


def firm_maps(s: dict) -> dict[str, tuple[Array, ...]]:
    """Stiffness of the joint over angle and p_AB: at constant pressures, closed valves gauge and absolute."""
    angles, sums = axes(s, "stability")
    angles = angles[::2]
    made = {}
    for name, moves in MODELS.items():
        open_, shut = (firmness_map(arm(moves), angles, sums, closed) for closed in (False, True))
        absolute = firmness_map(arm({**moves, **GASES["absolute"]}), angles, sums, True)
        made[name] = (angles, sums, open_, shut, absolute)
    return made


def differences(s: dict) -> list[Row]:
    """How far other stiffnesses stand from the fitted one at its pressures, inside and outside the source's ranges."""
    fitted, (angles, sums) = arm(), axes(s, "plane")
    others = {"analytical": arm(ANALYTICAL), "fitted, held at one length": arm(held_at_length(s["cut"]["length_m"]))}
    sums = sums[sums <= 2.0 * supply_bar()]
    places = [(t, p, pressures(fitted, t, p)) for t in angles for p in sums]
    widest = max(t for t, _ in EQUILIBRIA)
    places = [one for one in places if abs(one[0]) <= widest and max(one[2]) <= supply_bar()]
    good, low, high = (value(f"equilibria.model_good_{k}") for k in ("angle", "from", "to"))
    box = [abs(t) <= good and low - 1e-9 <= p <= high + 1e-9 for t, p, _ in places]
    close = [abs(pair[0] - pair[1]) < value("model.good_difference") for *_, pair in places]
    rows = []
    for name, c in others.items():
        moved = np.array([shift_deg(fitted, c, t, p) for t, p, _ in places])
        for where, inside in (("the source's good range", box), ("p_A, p_B close", close)):
            rows += [spread(where, name, moved[inside]), spread(f"outside {where}", name, moved[~np.array(inside)])]
    return rows


def spread(where: str, other: str, moved: Array) -> Row:
    """Median and largest size of some shifts; places where the other model has no rest within 45 deg are counted."""
    size = np.abs(moved[np.isfinite(moved)])
    limit = 0.5 * value("equilibria.angular_shift")
    row: Row = [where, other, moved.size, int(moved.size - size.size)]
    share = float(np.count_nonzero(size < limit)) / moved.size
    return [*row, round(float(np.median(size)), 2), round(float(size.max()), 2), round(share, 2)]


def stability_rows() -> list[Row]:
    """Down to which p_AB the arm stands by itself at 0 deg, with and without gravity."""
    rows: list[Row] = []
    for name, moves in MODELS.items():
        for gas, share in GASES.items():
            for gravity in (True, False):
                c = arm({**moves, **share} | ({} if gravity else {"gravity_m_s2": 0.0}))
                for closed in (False, True):
                    low = lowest_stable_bar(c, closed)
                    rows.append([name, gas, "closed" if closed else "at constant pressure", gravity])
                    rows[-1] += [round(low, 3), round(0.5 * low, 3)]
    return rows


def sensitivities(s: dict) -> list[Row]:
    """What moves the fitted equilibria at the pressures that held them, in deg."""
    this, c = s["sensitivity"], arm()
    length, share = value("muscles.nominal_length_spread"), value("muscles.stiffness_spread") / 100.0
    moved = {
        "A longer by the spread of h0": {"nominal_length_a_mm": length},
        "A shorter by the spread of h0": {"nominal_length_a_mm": -length},
        "both longer by the spread of h0": {"nominal_length_a_mm": length, "nominal_length_b_mm": length},
        "both shorter by the spread of h0": {"nominal_length_a_mm": -length, "nominal_length_b_mm": -length},
        "A longer by the hysteresis of h0": {"nominal_length_a_mm": value("muscles.hysteresis")},
        "A stiffer by the spread of k": {"stiffness_factor_a": 1.0 + share},
        "both stiffer by the spread of k": {"stiffness_factor_a": 1.0 + share, "stiffness_factor_b": 1.0 + share},
        "k of one length": held_at_length(s["cut"]["length_m"]),
        "analytical k": ANALYTICAL,
    }
    angles, p_ab = this["angles_deg"], this["p_ab_bar"]
    rows: list[Row] = [[name, p_ab, *shifts(c, moves, angles, p_ab)] for name, moves in moved.items()]
    drawn = np.array([shifts(c, moves, angles, p_ab) for moves in within_digits(this["draws"], this["seed"])])
    for name, share_below in (("2.5 %", 0.025), ("97.5 %", 0.975)):
        quantile = np.nanquantile(drawn, share_below, axis=0)
        rows.append([f"digits of table 4.1 ({name})", p_ab, *(round(float(q), 2) + 0.0 for q in quantile)])
    return rows


def shifts(c: Array, moves: dict[str, float], angles_deg: Sequence[float], p_ab_bar: float) -> list[float]:
    """Shift in deg at some angles of one p_AB."""
    other = arm(moves)
    return [round(shift_deg(c, other, t, p_ab_bar), 2) + 0.0 for t in angles_deg]


def cut_rows(s: dict) -> dict[str, dict[float, Array]]:
    """Shifts over the angle at four p_AB: analytical, and fitted held at one length."""
    fitted, (angles, _) = arm(), axes(s, "plane")
    others = {"analytical": arm(ANALYTICAL), "held": arm(held_at_length(s["cut"]["length_m"]))}
    low, high = value("equilibria.model_good_from"), value("equilibria.model_good_to")
    return {
        name: {p: np.array([shift_deg(fitted, c, t, p) for t in angles]) for p in np.linspace(low, high, 4).round(3)}
        for name, c in others.items()
    } | {"angles": {0.0: angles}}


if __name__ == "__main__":
    main()
