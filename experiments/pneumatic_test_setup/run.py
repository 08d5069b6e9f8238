"""Appendix D simulated: Poiseuille or throttle, with or without small volumes, and what the instability is."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from loopshape.core.units import Array
from loopshape.toolbox.arm.source import value

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's other files, however it is started

import pneumatic_models as models  # noqa: E402
import pneumatic_pictures as pictures  # noqa: E402
from pneumatic_scores import SOURCE, scores  # noqa: E402
from pneumatic_tables import SCORES, write  # noqa: E402

RUNS, EXPLICIT = models.SETTINGS["runs"], models.SETTINGS["explicit"]
METHODS = {"Euler": models.EULER, "Bogacki-Shampine": models.BOGACKI_SHAMPINE, "RK4": models.RK4}
KINDS = {"float32": np.float32, "float64": np.float64, "longdouble": np.longdouble}


@dataclass(frozen=True, eq=False)
class Rattle:
    """How q_1 rattles: from when on, at which true flow, range and largest error at the end; q_in's error."""

    onset_s: float
    onset_flow: float
    low: float
    high: float
    off: float
    supply_off: float
    finite: bool


def main() -> None:
    """Simulate, compare, write tables and figures."""
    b = models.bench()
    runs = {
        "pts2": models.implicit(models.pts2(b), RUNS["long_s"]),
        "pts3": models.implicit(models.pts3(b), RUNS["long_s"]),
    }
    runs["pts1"] = models.implicit(models.pts1(b), RUNS["long_s"])
    runs["tuned"] = models.implicit(models.pts1(b, tuned(b, runs["pts2"])), RUNS["long_s"])
    runs |= block(b)
    routes = two_routes(b, runs["pts2"])
    shapes = write(HERE / "shapes.csv", SHAPES, shape_rows(b, runs))
    rattles = explicit_rows(b, runs["pts2"])
    write(HERE / "explicit.csv", RATTLES, [r[0] for r in rattles])
    small = write(HERE / "small_volumes.csv", SMALL, small_rows(b, runs["pts3"]))
    volumes = write(HERE / "sensitivity.csv", SENSITIVITY, sensitivity_rows())
    found = {"runs": runs, "shapes": shapes, "rattles": rattles, "small": small, "routes": routes, "volumes": volumes}
    write(HERE / "scores.csv", SCORES, scores(found))
    pictures.draw(found, b)


def block(b: models.Bench) -> dict[str, models.Filling]:
    """The block signal of figure D.10 through PTS2 and PTS3."""
    end_s = value("figure_d_9.duration")
    edges = models.block_edges(value("figure_d_10.frequency"), value("figure_d_10.duty"), end_s)
    return {
        f"{name}_pulsed": models.pulsed(c, end_s, edges)
        for name, c in (("pts2", models.pts2(b)), ("pts3", models.pts3(b)))
    }


def tuned(b: models.Bench, goal: models.Filling) -> Array:
    """PTS1's four conductances whose pressures come nearest to PTS2's, which stands for the experiment."""
    few = slice(None, None, 40)

    def misfit(logs: Array) -> Array:
        run = models.implicit(models.pts1(b, np.exp(logs)), RUNS["long_s"], rtol=1e-6, atol=1.0)
        return (run.p_bar - goal.p_bar)[few].ravel()

    beta = b.throttles_m2  # to begin with: as a throttle at half a bar
    return np.exp(least_squares(misfit, np.log(beta / np.sqrt(0.5e5 * 2.0)), diff_step=1e-3, xtol=1e-6).x)


def two_routes(b: models.Bench, radau: models.Filling) -> dict[str, float]:
    """Radau against fine RK4, both against the mass balance, and PTS3 against its closed form."""
    c, step_s = models.pts2(b), float(RUNS["fine_step_s"])
    fine = models.explicit(c, RUNS["step_s"], step_s, keep=round(1.0 / (RUNS["rows_per_s"] * step_s)))
    rows = fine.t_s.size
    one = models.pts3(models.bench(capacity_l=1e6))  # as good as constant
    before_s = 1.0  # before the pressures meet, where Radau stalls: nothing flows on there
    own = models.implicit(one, before_s)
    exact = models.filled_bar(one, own.t_s, models.arm_value("supply_bar"))
    peak = radau.q_kg_s[:, 1].max()
    found = {
        "pressure_bar": float(np.abs(radau.p_bar[:rows] - fine.p_bar).max()),
        "flow_share": float(np.abs(radau.q_kg_s[40:rows] - fine.q_kg_s[40:]).max() / peak),
        "mass_radau": mass_error(c, radau),
        "mass_rk4": mass_error(c, fine),
        "closed_form_bar": float(np.abs(own.p_bar[:, 1] - exact).max()),
    }
    write(HERE / "routes.csv", tuple(found), [list(found.values())])
    return found


def mass_error(c: Array, run: models.Filling) -> float:
    """Largest change of stored minus supplied mass over the stored mass."""
    n = run.q_kg_s.shape[1]
    stored = 1e5 * run.p_bar @ c[models.HEAD : models.HEAD + n] / c[models.RT]
    return float(np.ptp(stored - run.supplied_kg) / stored[0])


SHAPES = (
    "model", "t50_s", "t90_s", "t99_s", "t99_over_t50", "rms_p_m_bar", "max_p_m_bar", "least_p_c_bar", "peak_q_1_kg_s",
    "reynolds_hose_1",
)  # fmt: skip


def shape_rows(b: models.Bench, runs: dict[str, models.Filling]) -> list[list[Any]]:
    """When p_m reaches shares of its end, how far it is from PTS2, and what flows."""
    goal, out = runs["pts2"], []
    for name in ("pts2", "pts3", "pts1", "tuned"):
        run = runs[name]
        p = run.p_bar[:, -1]
        end = float(np.interp(RUNS["step_s"], run.t_s, run.p_bar[:, 0]))  # what p_m runs into
        t50, t90, t99 = (run.reaches_s(share * end) for share in (0.5, 0.9, 0.99))
        off = p - goal.p_bar[:, -1]
        q = float(run.q_kg_s[1:, 1].max())
        reynolds = 4.0 * q / (np.pi * 2e-3 * b.hose_radius_mm * b.viscosity_pa_s)
        out.append([name, t50, t90, t99, t99 / t50, float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())])
        out[-1] += [float(run.p_bar[:, 0].min()), q, reynolds]
    return out


RATTLES = (
    "model", "method", "precision", "step_s", "onset_s", "true_q_1_then_kg_s", "q_1_low_kg_s",
    "q_1_high_kg_s", "q_1_off_kg_s", "q_in_off_kg_s",
    "mass_error",
    "finite",
)  # fmt: skip


def rattle(run: models.Filling, true: models.Filling) -> Rattle:
    """Compare a run's q_1 with the true one; flows before `blind_s` fill the small volumes."""
    column = 1
    q = run.q_kg_s[:, column]
    off = np.abs(q - np.interp(run.t_s, true.t_s, true.q_kg_s[:, column]))
    peak = float(true.q_kg_s[:, column].max())
    late = run.t_s > EXPLICIT["blind_s"]
    seen = np.flatnonzero(late & ~(off < EXPLICIT["seen_share"] * peak))
    tail = run.t_s > run.t_s[-1] - EXPLICIT["tail_s"]
    supply = np.abs(run.q_kg_s[tail, 0] - np.interp(run.t_s[tail], true.t_s, true.q_kg_s[:, 0]))
    ends = (q[tail].min(), q[tail].max(), off[tail].max(), supply.max()) if np.isfinite(q).all() else (np.nan,) * 4
    onset_s = float(run.t_s[seen[0]]) if seen.size else float("nan")
    onset_flow = float(np.interp(onset_s, true.t_s, true.q_kg_s[:, column]))
    return Rattle(onset_s, onset_flow, *map(float, ends), bool(np.isfinite(q).all()))


def explicit_rows(b: models.Bench, true: models.Filling) -> list[tuple[list[Any], Rattle]]:
    """Explicit solvers on PTS2 by method, step and precision, adaptive ones; PTS3 and PTS1 beside them."""
    end_s, c2 = RUNS["step_s"], models.pts2(b)
    jobs = [("pts2", c2, m, "float64", h) for m in METHODS for h in EXPLICIT["steps_s"]]
    jobs += [("pts2", c2, SOURCE, k, EXPLICIT["precision_step_s"]) for k in ("float32", "longdouble")]
    jobs += [("pts3", models.pts3(b), SOURCE, "float64", h) for h in EXPLICIT["steps_s"][:4]]
    jobs += [("pts1", models.pts1(b), SOURCE, "float64", h) for h in EXPLICIT["steps_s"][:6]]
    truths = {
        "pts2": true,
        "pts3": models.implicit(models.pts3(b), end_s),
        "pts1": models.implicit(models.pts1(b), end_s),
    }
    out = []
    for model, c, method, kind, h in jobs:
        run = models.explicit(c, end_s, float(h), METHODS[method], KINDS[kind])
        out.append(explicit_row([model, method, kind, f"{h:g}"], c, run, truths[model]))
    for rtol in EXPLICIT["adaptive_rtol"]:
        run = models.implicit(c2, end_s, method="RK45", rtol=rtol, atol=1e-6)
        words = ["pts2", "RK45 adaptive", "float64", f"rtol {rtol:g}: {run.evaluations} evaluations"]
        out.append(explicit_row(words, c2, run, true))
    out.append(explicit_row(["pts2", "Radau", "float64", f"{true.evaluations} evaluations"], c2, true, true))
    return out


def explicit_row(words: list[Any], c: Array, run: models.Filling, true: models.Filling) -> tuple[list[Any], Rattle]:
    """One line of the table and the numbers behind it."""
    r = rattle(run, true)
    mass = mass_error(c, run) if r.finite else float("nan")
    return [*words, r.onset_s, r.onset_flow, r.low, r.high, r.off, r.supply_off, mass, r.finite], r


SMALL = (
    "factor", "small_ml", "step_max_bar", "step_lumped_max_bar", "valve_alone_max_bar", "pulsed_max_bar",
    "pulsed_lumped_max_bar",
)  # fmt: skip


def small_rows(b: models.Bench, without: models.Filling) -> list[list[Any]]:
    """PTS2's p_m against PTS3's over the small volumes: one throttle in series, volumes lumped, the valve's alone."""
    end_s = RUNS["step_s"]
    edges = models.block_edges(value("figure_d_10.frequency"), value("figure_d_10.duty"), end_s)
    alone = models.implicit(models.pts3(b, in_series=False), end_s)
    without_pulsed, out = models.pulsed(models.pts3(b), end_s, edges), []
    for factor in models.SETTINGS["small_volumes"]["factors"]:
        one = models.bench(small_factor=factor)
        step, pulsed_ = models.implicit(models.pts2(one), end_s), models.pulsed(models.pts2(one), end_s, edges)
        lumped = models.pts3(one, lumped=True)
        others = (without, models.implicit(lumped, end_s), alone)
        row = [apart(step, other) for other in others]
        row += [apart(pulsed_, without_pulsed), apart(pulsed_, models.pulsed(lumped, end_s, edges))]
        out.append([factor, 1e6 * one.small_m3, *row])
    return out


def apart(a: models.Filling, b: models.Filling) -> float:
    """Largest difference of p_m in bar over the rows that both have."""
    n = min(a.t_s.size, b.t_s.size)
    return float(np.abs(a.p_bar[:n, -1] - b.p_bar[:n, -1]).max())


SENSITIVITY = ("changed", "to", "t50_s", "t99_s", "t99_over_t50", "least_p_c_bar", "p_c_minus_p_1_bar",
               "p_2_minus_p_m_bar",
               "pts3_off_bar", "explicit_onset_s", "explicit_off_kg_s")  # fmt: skip


def sensitivity_rows() -> list[list[Any]]:
    """One assumption changed at a time: shape, pressure drops of the hoses, PTS3's error, and what RK4 does."""
    cases: list[tuple[str, float]] = [("nothing", 0.0)]
    cases += [(name, v) for name, values in models.SETTINGS["sensitivity"].items() for v in values]
    return [[name, v, *sensitivity(models.bench(**({} if name == "nothing" else {name: v})))] for name, v in cases]


def sensitivity(b: models.Bench) -> list[float]:
    """The numbers of one case."""
    end_s = 1.5 * RUNS["step_s"]
    run = models.implicit(models.pts2(b), end_s)
    settled = run.t_s > EXPLICIT["blind_s"]
    end = float(run.p_bar[-1, 0])
    t50, t99 = run.reaches_s(0.5 * end), run.reaches_s(0.99 * end)
    drops = [float((run.p_bar[settled, i] - run.p_bar[settled, i + 1]).max()) for i in (0, 2)]
    r = rattle(models.explicit(models.pts2(b), end_s, EXPLICIT["shown_s"], models.BOGACKI_SHAMPINE), run)
    off = apart(run, models.implicit(models.pts3(b), end_s))
    return [t50, t99, t99 / t50, float(run.p_bar[:, 0].min()), *drops, off, r.onset_s, r.off]


if __name__ == "__main__":
    main()
