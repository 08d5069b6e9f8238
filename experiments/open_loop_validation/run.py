"""Open loop (figures 4.16-4.18): the shut muscle's pressure, the falling arm, and what the solver's step costs."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "equilibria")]  # its analytical stiffness and table 4.1's digits

import open_loop_pictures as pictures  # noqa: E402
from open_loop_scores import SCORES, Found, scores  # noqa: E402
from open_loops import (  # noqa: E402
    Terms,
    Trace,
    falls_at_s,
    gas_laws,
    joint_terms,
    length_a_mm,
    rise_bar_mm,
    run,
    zero_bar,
)
from standing import ANALYTICAL, arm, within_digits  # noqa: E402

from loopshape.io.files import read_toml, write_bytes_whole  # noqa: E402
from loopshape.toolbox.arm.effect.effects import FORMS  # noqa: E402
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS  # noqa: E402
from loopshape.toolbox.arm.source import value  # noqa: E402
from loopshape.toolbox.gap.nouns.effect import EffectForm  # noqa: E402
from loopshape.view.style import png  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
RUNS = ("figure-4-16", "figure-4-17", "figure-4-18-wide")
RISE = ("gas_law", "exponent", "p_a_bar", "mbar_per_mm")
STRETCH = (
    "gas_law", "p_a_start_bar", "p_a_end_bar", "rise_bar", "stretch_mm", "mbar_per_mm", "p_b_end_bar", "theta2_end_deg"
)  # fmt: skip
FALLS = ("effect", "form", "magnitude", "unit", "falls_at_s", "later_by_s", "p_a_then_bar", "p_b_then_bar", "ended")
CAUSES = ("moved", "figure", "largest_angle_deg", "largest_pressure_bar")
SOLVER = ("figure", "solver", "steps_per_ms", "largest_angle_deg", "largest_pressure_bar")
Row = list[object]


def main() -> None:
    """Run everything, write tables and figures."""
    s = read_toml(HERE / "settings.toml")
    laws = gas_laws(s["gas"]["exponent"])
    shut = {name: run("figure-4-17", law) for name, law in laws.items()}
    replays = {name: run(name) for name in (*RUNS, "figure-4-18")}
    found = Found(
        replays=replays,
        shut=shut,
        fallen={name: run("figure-4-18-wide", law) for name, law in laws.items()},
        weightless=run("figure-4-16", {"gravity_m_s2": 0.0}),
        rise=rise_rows(s, laws),
        stretch=[stretch_row(name, trace) for name, trace in shut.items()],
        falls=fall_rows(s),
        causes=cause_rows(s),
        solver=solver_rows(s),
        terms=terms(s),
        limits=limit_spread(s),
    )
    for name, columns, rows in (
        ("rise.csv", RISE, found.rise), ("stretch.csv", STRETCH, found.stretch), ("falls.csv", FALLS, found.falls),
        ("causes.csv", CAUSES, found.causes), ("solver.csv", SOLVER, found.solver),
        ("terms.csv", TERMS, term_rows(found.terms)), ("scores.csv", SCORES, scores(s, found)),
    ):  # fmt: skip
        write(name, columns, rows)
    print(f"stability limit within the digits of table 4.1: {found.limits} bar")
    for name, figure in pictures.pages(found, s):
        write_bytes_whole(FIGURES / f"{name}.png", png(figure))


def write(name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """One table as a file and on the screen."""
    rows = list(rows)
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    print(f"-- {name}")
    for row in (columns, *rows):
        print("  ".join(str(cell) for cell in row))


def rise_rows(s: dict, laws: Mapping[str, Mapping[str, float]]) -> list[Row]:
    """Rise of a shut muscle's pressure per mm, by gas law and pressure, at one length."""
    length, rows = s["gas"]["at_length_m"], []
    for name, law in laws.items():
        rises = [1e3 * rise_bar_mm(arm(law), p, length) for p in s["gas"]["at_bar"]]
        exponent = law.get("polytropic_exponent", 1.0)
        rows += [[name, exponent, p, round(r, 2)] for p, r in zip(s["gas"]["at_bar"], rises, strict=True)]
    return rows


def stretch_row(name: str, trace: Trace) -> Row:
    """Figure 4.17's input under one gas law."""
    first, last = float(trace.p_a_bar[0]), float(trace.p_a_bar[-1])
    stretch = length_a_mm(trace.theta2_deg[-1]) - length_a_mm(trace.theta2_deg[0])
    row: Row = [name, round(first, 4), round(last, 4), round(last - first, 4), round(stretch, 2)]
    row += [round(1e3 * (last - first) / stretch, 2), round(float(trace.p_b_bar[-1]), 3)]
    return [*row, round(float(trace.theta2_deg[-1]), 2)]


def magnitudes(form: EffectForm) -> list[float]:
    """The upper end of what usually occurs, and its negative where the form has one."""
    top = form.usual[1]
    return [top, -top] if form.free[0].low * form.scale < 0.0 else [top]


def fall_rows(s: dict) -> list[Row]:
    """When figure 4.18's arm falls, for every form of the catalogue, and what is not in it."""
    nominal = falls_at_s(run("figure-4-18-wide"), s["fall"]["angle_deg"])
    cases = [("none", "", 0.0, "", {})]
    cases += [(f.effect, f.form, m, f.unit, f.at(m).moves) for f in FORMS for m in magnitudes(f)]
    cases += [("(no gravity)", "", 0.0, "", {"gravity_m_s2": 0.0})]
    cases += [("(analytical stiffness)", "", 0.0, "", dict(ANALYTICAL))]
    return [fall_row(case[:4], run("figure-4-18-wide", case[4]), nominal, s["fall"]["angle_deg"]) for case in cases]


def fall_row(names: Sequence[object], trace: Trace, nominal_s: float, angle_deg: float) -> Row:
    """One line: the moment, how much later than without, and the pressures then."""
    at = falls_at_s(trace, angle_deg)
    if np.isnan(at):
        return [*names, "", "", "", "", trace.ended_early or ""]
    k = int(np.searchsorted(trace.time_s, at))
    row: Row = [*names, round(at, 3), round(at - nominal_s, 3)]
    return [*row, round(float(trace.p_a_bar[k]), 3), round(float(trace.p_b_bar[k]), 3), trace.ended_early or ""]


def apart(one: Trace, other: Trace) -> tuple[float, float]:
    """Largest differences in deg and bar over what both have."""
    n = min(one.time_s.size, other.time_s.size)
    pressures = [np.abs(a[:n] - b[:n]).max() for a, b in ((one.p_a_bar, other.p_a_bar), (one.p_b_bar, other.p_b_bar))]
    return float(np.abs(one.theta2_deg[:n] - other.theta2_deg[:n]).max()), float(max(pressures))


def cause_rows(s: dict) -> list[Row]:
    """Section 4.6: small errors one at a time, on the inputs of figures 4.16 and 4.17."""
    up, stiff, length = (
        1.0 + s["causes"]["flow_share"],
        s["causes"]["stiffness_share"],
        value("muscles.nominal_length_spread"),
    )
    flow = {f"throttle_{k}_mm": value_of(f"throttle_{k}_mm") for k in ("supply", "out")}
    moved = {
        "supply's throttle": {"throttle_supply_mm": up * flow["throttle_supply_mm"]},
        "exhaust's throttle": {"throttle_out_mm": up * flow["throttle_out_mm"]},
        "both throttles": {name: up * one for name, one in flow.items()},
        "both muscles stiffer": {"stiffness_error": stiff},
        "A stiffer": {"stiffness_factor_a": 1.0 + stiff},
        "A's h0 longer": {"nominal_length_a_mm": length},
        "absolute gas law": gas_laws(1.0)["absolute"],
    }
    rows: list[Row] = []
    for figure in RUNS[:2]:
        nominal = run(figure)
        for name, moves in moved.items():
            angle, pressure = apart(run(figure, moves), nominal)
            rows.append([name, figure, round(angle, 2), round(pressure, 4)])
    return rows


def value_of(name: str) -> float:
    """A parameter's tabled value."""
    return ARM1_PARAMETERS.rows[ARM1_PARAMETERS.index(name)].value


def solver_rows(s: dict) -> list[Row]:
    """The source's third order on a grid of 1 ms, and finer, against exact edges; figure 4.18 until it falls."""
    rows: list[Row] = []
    for figure in RUNS:
        exact = run(figure, steps=s["solver"]["reference_steps"])
        if figure == RUNS[2]:
            exact = exact.until(falls_at_s(exact, s["fall"]["angle_deg"]))
        for solver, steps in [("edges", 1)] + [("grid", n) for n in s["solver"]["steps"]]:
            angle, pressure = apart(run(figure, solver=solver, steps=steps), exact)
            rows.append([figure, solver, steps, float(f"{angle:.2g}"), float(f"{pressure:.2g}")])
    return rows


TERMS = (
    "stiffness_model", "pressure_bar", "lever2_k", "lever2_slope_of_k", "geometry", "gravity", "closed_gauge",
    "closed_absolute", "at_constant_pressure",
)  # fmt: skip


def terms(s: dict) -> dict[str, Terms]:
    """What holds the joint at 0 deg, over the pressure of both muscles, with both stiffnesses."""
    p = np.linspace(s["fall"]["low_bar"], s["fall"]["high_bar"], s["fall"]["count"])
    return {name: joint_terms(moves, p) for name, moves in (("fitted", {}), ("analytical", ANALYTICAL))}


def term_rows(found: Mapping[str, Terms]) -> list[Row]:
    """Every fifth of them."""
    rows: list[Row] = []
    for name, t in found.items():
        for k in range(0, t.pressure_bar.size, 5):
            parts = (t.stiffness, t.slope, t.geometry, t.gravity, t.gauge, t.absolute, t.at_constant_pressure)
            rows.append([name, round(float(t.pressure_bar[k]), 3), *(round(float(one[k]), 2) for one in parts)])
    return rows


def limit_spread(s: dict) -> tuple[float, float, float]:
    """Pressure in bar of both muscles below which the joint does not stand at constant pressure.

    2.5, 50 and 97.5 % of the tables that round to table 4.1.
    """
    p = np.linspace(s["fall"]["low_bar"], s["fall"]["high_bar"], s["fall"]["count"])
    tables = within_digits(s["fall"]["draws"], s["fall"]["seed"])
    drawn = [zero_bar(p, joint_terms(m, p).at_constant_pressure) for m in tables]
    low, middle, high = np.nanquantile(drawn, (0.025, 0.5, 0.975)).round(3)
    return float(low), float(middle), float(high)


if __name__ == "__main__":
    main()
