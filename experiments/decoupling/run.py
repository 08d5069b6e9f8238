"""theta2 and p_AB at all 24 equilibria: where they are decoupled, where not and why, what a static matrix would do."""

from __future__ import annotations

import csv
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from decoupling_draw import draw_cause, draw_curves, draw_maps, linear_maps  # noqa: E402
from decoupling_measure import DECOUPLING, Found, at_one_point, coefficient, found_at  # noqa: E402
from decoupling_scores import scores  # noqa: E402
from decoupling_static import behind, lines, loop_margins, matrices  # noqa: E402

from loopshape.core.units import Array, db  # noqa: E402
from loopshape.data.result.margins import Margins  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.io.requirements import read_requirements  # noqa: E402
from loopshape.io.write.controllers import read_controllers  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.toolbox.rig.study import Study  # noqa: E402
from loopshape.view.style import png  # noqa: E402

ROOT = HERE.parent.parent
FIGURES = ROOT / "figures" / HERE.name
EXAMPLES = ROOT / "examples" / "arm"


def main() -> None:
    """Measure 24 equilibria and the worst again with other supplies; tables, figures, scores."""
    study = read_study(HERE / "study.toml")
    settings = tomllib.loads((HERE / "settings.toml").read_text(encoding="utf-8"))
    found = []
    for one in at_one_point(study):
        found.append(found_at(one, settings))
        print(f"{found[-1].where}: {found[-1].met.verdicts[1].sentence}")
    again = list(supplied(study, settings))
    W = matrices(found)
    tables = {
        "interaction": interaction_rows(found),
        "points": point_rows(found, W),
        "symmetry": symmetry_rows(found),
        "static": static_rows(found, W),
        "margins": margin_rows(found, W),
        "supply": supply_rows(again),
    }
    for name, rows in tables.items():
        write(name, rows)
    write("scores", scores(tables))
    maps = linear_maps(settings)
    write_bytes_whole(FIGURES / "maps.png", png(draw_maps(found, W, maps)))
    write_bytes_whole(FIGURES / "curves.png", png(draw_curves(found)))
    write_bytes_whole(FIGURES / "cause.png", png(draw_cause(found, again)))


def supplied(study: Study, settings: Mapping[str, Any]) -> Iterable[Found]:
    """The worst equilibria again, with other supplies and nothing else changed."""
    for theta, p_ab in settings["worst"]:
        point = {"theta2_deg": theta, "p_ab_bar": p_ab}
        for supply in (None, *settings["worst_supply_bar"]):
            one = next(s for s in at_one_point(study) if s.operating_points[0] == point)
            yield found_at(one if supply is None else replace(one, changes={"supply_bar": supply}), settings)


def interaction_rows(found: Sequence[Found]) -> list[dict]:
    """A line for each equilibrium and band: k_I with its bounds where it matters most, and what linear plants say."""
    rows = []
    for one in found:
        f = one.frf.frequency_hz
        for name, v in zip(one.bands_hz, one.met.verdicts, strict=True):
            there = int(np.argmin(np.abs(f - v.at_hz))) if np.isfinite(v.at_hz) else None
            other = [np.nan] * 2 if there is None else [db(coefficient(P)[there]) for P in (one.bare, one.replay)]
            rows.append({
                **place(one), "band": name, "from_hz": v.band_hz[0], "to_hz": v.band_hz[1], "lines": v.lines,
                "verdict": v.verdict, "at_hz": v.at_hz, "low_db": v.low_db, "k_i_db": v.estimate_db,
                "high_db": v.high_db, "linearised_db": other[0], "replay_db": other[1],
            })  # fmt: skip
    return rows


def place(one: Found) -> dict[str, float]:
    """The equilibrium."""
    return {"theta2_deg": one.theta2_deg, "p_ab_bar": one.p_ab_bar}


def median_db(one: Found, over: tuple[int, int], under: tuple[int, int]) -> float:
    """Median over the bandwidth of an element over another."""
    P = one.frf.response[lines(one, one.bands_hz["bandwidth"])]
    return float(np.median(db(P[:, over[0], over[1]] / P[:, under[0], under[1]])))


def point_rows(found: Sequence[Found], W: Mapping[str, Sequence[Array]]) -> list[dict]:
    """A line for each equilibrium: pressures, rates, what the commands saw, couplings, relative gain, best matrix."""
    rows = []
    for k, one in enumerate(found):
        seen = one.gains @ DECOUPLING
        use = lines(one, (one.bands_hz["below"][0], one.bands_hz["above"][1]))
        own = np.abs(one.met.relative_gain.gain[use, 0, 0])
        rows.append({
            **place(one), "supply_bar": one.supply_bar,
            "p_a_bar": one.pressures_bar[0], "p_b_bar": one.pressures_bar[1],
            "fill_a_bar_s": one.lin.fill[0], "exhaust_a_bar_s": one.lin.exhaust[0], "fill_b_bar_s": one.lin.fill[1],
            "exhaust_b_bar_s": one.lin.exhaust[1], "sum_from_z_theta2": seen.sum(axis=0)[0],
            "averaged_sum": one.lin.mean_gains @ DECOUPLING[:, 0], "sum_from_z_p": seen.sum(axis=0)[1],
            "p12_over_p11_db": median_db(one, (0, 1), (0, 0)), "p21_over_p22_db": median_db(one, (1, 0), (1, 1)),
            "rga_own_least": own.min(), "rga_own_most": own.max(), "w12": W["own, measured"][k][0, 1],
            "w21": W["own, measured"][k][1, 0], "w12_linearised": W["own, linearised"][k][0, 1],
            "w21_linearised": W["own, linearised"][k][1, 0],
        })  # fmt: skip
    return rows


def symmetry_rows(found: Sequence[Found]) -> list[dict]:
    """Each pair of +theta2 and -theta2: lines at which k_I agrees within 95 %, and by how much the sizes differ."""
    rows = []
    for one in found:
        other = next((x for x in found if x.where == (-one.theta2_deg, one.p_ab_bar)), one)
        if one.theta2_deg <= 0.0:
            continue
        a, b = one.met.coefficients[0], other.met.coefficients[0]
        use = lines(one, (one.bands_hz["below"][0], one.bands_hz["above"][1])) & other.frf.valid
        apart = np.abs(a.coefficient - b.coefficient)[use]
        std = np.hypot(*(np.abs(c.coefficient) * c.relative_std for c in (a, b)))[use]
        ratio = np.abs(db(a.coefficient / b.coefficient))[use]
        rows.append({
            **place(one), "lines": int(use.sum()), "within_95": float(np.mean(apart < np.sqrt(-np.log(0.05)) * std)),
            "median_difference_db": float(np.median(ratio)),
        })  # fmt: skip
    return rows


def static_rows(found: Sequence[Found], W: Mapping[str, Sequence[Array]]) -> list[dict]:
    """k_I behind each kind of static matrix, largest in the bandwidth and at the mode, with its upper bound."""
    rows = []
    for k, one in enumerate(found):
        for name, each in W.items():
            v = behind(one, each[k])
            row: dict[str, object] = {**place(one), "matrix": name}
            for band in ("bandwidth", "mode"):
                row |= {f"{band}_db": v[band].estimate_db, f"{band}_high_db": v[band].high_db}
                row[f"{band}_verdict"] = v[band].verdict
            rows.append(row)
    return rows


def margin_rows(found: Sequence[Found], W: Mapping[str, Sequence[Array]]) -> list[dict]:
    """Margins of both loops under the shipped controllers, the other loop open and closed, without and with W."""
    controllers = {c.loop: c for c in read_controllers(EXAMPLES / "controller.toml")}
    asked = {r.loop: r for r in read_requirements(EXAMPLES / "requirements.toml")}
    rows = []
    for k, one in enumerate(found):
        for name in ("none", "own, measured"):
            for (loop, word), m in loop_margins(one, W[name][k], controllers, asked).items():
                rows.append({**place(one), "matrix": name, "loop": loop, "other": word, **numbers(m)})
    return rows


def numbers(m: Margins) -> dict[str, object]:
    """The margins looked at, with the ends of the intervals that requirements ask for."""
    peak = -db(m.modulus_margin)
    low = -db(m.intervals["modulus_margin"][1]) if m.intervals else np.nan
    phase = m.intervals.get("phase_margin_deg", (np.nan, np.nan))
    return {
        "bandwidth_hz": m.bandwidth_hz, "peak_s_db": peak, "peak_s_low_db": low, "phase_margin_deg": m.phase_margin_deg,
        "phase_margin_high_deg": phase[1], "gain_margin_db": m.gain_margin_db, "stable": m.stable,
    }  # fmt: skip


def supply_rows(again: Sequence[Found]) -> list[dict]:
    """The worst equilibria by supply."""
    rows = []
    for one in again:
        v = dict(zip(one.bands_hz, one.met.verdicts, strict=True))["bandwidth"]
        rows.append({
            **place(one), "supply_bar": one.supply_bar, "fill_a_bar_s": one.lin.fill[0],
            "exhaust_a_bar_s": one.lin.exhaust[0], "low_db": v.low_db, "k_i_db": v.estimate_db, "high_db": v.high_db,
            "verdict": v.verdict,
        })  # fmt: skip
    return rows


def write(name: str, rows: Sequence[Mapping[str, object]]) -> None:
    """A small table beside this file."""
    with (HERE / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(rows[0])
        out.writerows([rounded(x) for x in row.values()] for row in rows)


def rounded(cell: object) -> object:
    """Four figures, and nothing where there is no number."""
    if isinstance(cell, float):
        return f"{cell:.4g}" if np.isfinite(cell) else ""
    return cell


if __name__ == "__main__":
    main()
