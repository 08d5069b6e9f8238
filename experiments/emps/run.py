"""EMPS against a frictionless axis: which effect is missing, what error is left, and what its pulses excite."""

from __future__ import annotations

import csv
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from scipy.optimize import least_squares

from loopshape.core.units import Array
from loopshape.data.signal.run import Run
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.gap.diagnose import attribute
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.diagnose.fitting import Fitted
from loopshape.toolbox.gap.diagnose.hypothesis import Hypothesis, candidates
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.toolbox.servo import following, nominal
from loopshape.toolbox.servo.axis import ServoAxis
from loopshape.toolbox.servo.effects import quadratic_drag
from loopshape.toolbox.servo.following import Followed
from loopshape.view.plots.curves import frequency_axis
from loopshape.view.style import COLOURS, head, new_figure, png, styled

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
FIGURES = ROOT / "figures" / HERE.name
DATA = Path(os.environ.get("LOOPSHAPE_DATA", ROOT / ".." / "shared" / "data")) / "emps"
FIRST_PULSE, PULSE_EVERY, PULSES = 344, 500, 49  # rows at which the added steps turn
WIDE = {"observer_hz": 200.0, "pass_hz": 200.0}
FLEXIBLE_HZ = (8.0, 12.0, 18.0, 25.0, 35.0, 50.0, 70.0, 100.0, 140.0)
SHARE_SHOWN, HZ_SHOWN, DELAY_SHOWN_MS = 0.05, 35.0, 0.3
SOURCE = "EMPS: A. Janot, M. Gautier and M. Brunot 2019, nonlinear benchmark"


def main() -> None:
    """Write ranking, errors, bound on a flexibility, and figures; says where the recordings are not there."""
    if not DATA.is_dir():
        print("the EMPS recordings are absent: set LOOPSHAPE_DATA to the folder of recordings")
        return
    run = read()
    axis, cut, names = ServoAxis().readied(run, ["emps"])  # the one estimation recording becomes eight
    ready = {r.info.name: axis.prepare(r, run, None) for r in run.recordings}
    evidence = Evidence.of(axis, cut, names, periodic_s=np.inf, threads=1)
    none = attribute.healthy(evidence)
    rival = quadratic_drag(nominal.scales([ready["emps"]]))
    ranking = ranked(evidence, [*candidates(axis), Hypothesis(axis, (rival,))], none)
    write("ranking.csv", ranking_table(evidence, none, ranking))
    fits = hypotheses(axis, evidence, none, rival)
    errors = [error_row(evidence, name, fitted, ready) for name, fitted in fits.items()]
    write("errors.csv", [ERROR_COLUMNS, *errors])
    moves = axis_moves(fits["asymmetric"])
    wide = {name: replace(f, **WIDE) for name, f in ready.items()}
    write("pulses.csv", additions_table(axis, wide, moves))
    draw_residuals(axis, ready, fits)
    draw_pulses(axis, wide, moves)


def read() -> Run:
    """Both recordings as one run, the one with pulses held out."""
    maps = ROOT / "examples" / "emps"
    first = import_file(DATA / "DATA_EMPS.mat", maps / "map.toml")
    second = import_file(DATA / "DATA_EMPS_PULSES.mat", maps / "map_pulses.toml")
    return replace(first, recordings=(*first.recordings, *second.recordings))


def ranked(evidence: Evidence, hypotheses: list[Hypothesis], base: Fitted) -> list[Fitted]:
    """The best form of each effect, the lowest cost of a piece predicted from the others first."""
    coarse = attribute.screened(evidence, hypotheses, base, rounds=4)
    fitted = [attribute.again(evidence, f, rounds=8) for f in coarse]
    return sorted(attribute.best_forms(fitted), key=lambda f: attribute.left_out(evidence, f).cost)


def hypotheses(axis: ServoAxis, evidence: Evidence, none: Fitted, rival: EffectForm) -> dict[str, Fitted]:
    """The models of the table, fitted to the estimation recording one on top of the other."""
    form = {f"{f.effect}, {f.form}": f for f in axis.effects}
    coulomb, offset = form["coulomb_friction, tanh Coulomb"], form["force_offset, constant"]
    asymmetric = [f for f in axis.effects if f.effect == "asymmetric_friction"]

    def on(base: Fitted, *forms: EffectForm) -> Fitted:
        return ranked(evidence, [Hypothesis(axis, forms)], base)[0]

    def one_of(forms: list[EffectForm]) -> Fitted:
        return ranked(evidence, [Hypothesis(axis, (f,)) for f in forms], none)[0]

    with_coulomb, with_offset = on(none, coulomb), on(none, offset)
    return {
        "viscous only": none,
        "Coulomb": with_coulomb,
        "Coulomb + offset": on(with_coulomb, coulomb, offset),
        "asymmetric": one_of(asymmetric),
        "Stribeck + offset": on(with_offset, offset, form["stribeck_friction, Gaussian"]),
        "quadratic drag": on(none, rival),
    }


def axis_moves(fitted: Fitted) -> dict[str, float]:
    """Parameters of the plant in a fit."""
    return fitted.hypothesis.moves(fitted.phi)


def ranking_table(evidence: Evidence, none: Fitted, ranking: list[Fitted]) -> list[list]:
    """One line an effect."""
    rows: list[list] = [["effect", "form", "free", "cost", "left_out_cost", "gain_over_none", "magnitude", "unit"]]
    rows.append(["none", "", 0, *costs(evidence, none), 0.0, "", ""])
    for f in ranking:
        form = f.hypothesis.forms[0]
        gain = attribute.left_out(evidence, none).cost - attribute.left_out(evidence, f).cost
        start = [form.effect, form.form, f.hypothesis.n_free]
        rows.append([*start, *costs(evidence, f), round(gain, 2), f"{f.magnitudes[0]:.4g}", form.unit])
    return rows


def costs(evidence: Evidence, f: Fitted) -> list[float]:
    """Cost, and cost of pieces predicted from the others."""
    return [round(f.cost, 2), round(attribute.left_out(evidence, f).cost, 2)]


ERROR_COLUMNS = [
    "model", "free", "cost", "left_out_cost", "estimation_percent", "held_out_percent", "sampled_estimation_percent",
    "sampled_held_out_percent", "mass_kg", "viscous_ns_m", "coulomb_n", "offset_n",
]  # fmt: skip


def error_row(evidence: Evidence, name: str, fitted: Fitted, ready: dict[str, Followed]) -> list:
    """Relative force errors: of the followed axis, and of an inverse model of samples by central differences."""
    moves = axis_moves(fitted)
    axis = fitted.hypothesis.plant
    assert isinstance(axis, ServoAxis)
    ours = [percent(axis.relative_error(f, moves)) for f in ready.values()]
    numbers = [f"{moves.get(n, 0.0):.4g}" for n in ("mass_kg", "viscous_ns_m", "coulomb_n", "force_offset_n")]
    sampled = sampled_errors(name, moves, list(ready.values()))
    return [name, fitted.hypothesis.n_free, *costs(evidence, fitted), *ours, *sampled, *numbers]


def percent(share: float) -> float:
    """In per cent, two digits."""
    return round(100.0 * share, 2)


def sampled_errors(name: str, moves: dict[str, float], ready: list[Followed]) -> list[float]:
    """Linear least squares on the first recording, relative errors on all; forces of the position's own tick."""
    tables = [sampled_regressors(name, moves, f) for f in ready]
    numbers = np.linalg.lstsq(*tables[0], rcond=None)[0]
    return [percent(float(np.linalg.norm(y - a @ numbers) / np.linalg.norm(y))) for a, y in tables]


def sampled_regressors(name: str, moves: dict[str, float], f: Followed) -> tuple[Array, Array]:
    """What the force (n,) is made of in a model of the table (n, terms); shapes are those that `moves` fitted."""
    q = nominal.differentiated(f)
    v = q["viscous_ns_m"]
    sliding = np.tanh(v / moves.get("coulomb_m_s", 1e-3))
    peak = sliding * np.exp(-((v / moves.get("stribeck_m_s", 1.0)) ** 2))
    ones = np.ones_like(v)
    terms = {
        "viscous only": [v],
        "Coulomb": [v, sliding],
        "Coulomb + offset": [v, sliding, ones],
        "asymmetric": [np.maximum(v, 0.0), np.minimum(v, 0.0), np.maximum(sliding, 0.0), np.minimum(sliding, 0.0)],
        "Stribeck + offset": [v, sliding, ones, peak],
        "quadratic drag": [v, v * np.abs(v)],
    }[name]
    columns = [nominal.passed(f, c) for c in (q["mass_kg"], *terms)]
    return np.stack(columns, axis=1), nominal.passed(f, f.force_n)


def additions_table(axis: ServoAxis, wide: dict[str, Followed], moves: dict[str, float]) -> list[list]:
    """How much of a flexibility of each frequency, and of a delay, each recording wants, and what that gains."""
    rows: list[list] = [["recording", "added", "free_free_hz", "value", "unit", "residual_rms_n", "gain_percent"]]
    for name, f in wide.items():
        _, before = best(axis, f, moves, {}, "", 0.0)
        rows.append([name, "nothing", "", "", "", round(before, 4), 0.0])
        trials = [("share beyond", hz, "flexible_share", 0.9, "1") for hz in FLEXIBLE_HZ]
        for word, hz, parameter, high, unit in [*trials, ("delay", None, "loop_delay_ms", 5.0, "ms")]:
            fixed = {} if hz is None else {"flexible_hz": hz, "flexible_damping": 0.03}
            value, rms = best(axis, f, moves, fixed, parameter, high)
            gain = round(100.0 * (1.0 - rms / before), 2)
            rows.append([name, word, hz or "", round(value, 4), unit, round(rms, 4), gain])
    return rows


def best(
    axis: ServoAxis, f: Followed, moves: dict[str, float], fixed: dict[str, float], added: str, high: float
) -> tuple[float, float]:
    """The parameter added, and rms of the force residual in N, with mass, viscous and Coulomb friction fitted again."""
    names = ("mass_kg", "viscous_ns_m", "coulomb_n")

    def residual(x: Array) -> Array:
        own = moves | fixed | {n: moves[n] * float(value) for n, value in zip(names, x, strict=False)}
        return axis.residuals(f, own | ({added: high * float(x[3])} if added else {}))["force"]

    start = np.array([1.0, 1.0, 1.0] + ([0.1] if added else []))
    top = np.array([1.5, 3.0, 3.0] + ([1.0] if added else []))
    found = least_squares(residual, start, bounds=(np.zeros(start.size), top), diff_step=1e-3)
    return (high * float(found.x[3]) if added else 0.0), float(np.sqrt(np.mean(found.fun**2)))


def write(name: str, rows: list[list]) -> None:
    """A table, printed too."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    for row in rows:
        print("  ".join(f"{cell!s:>14}" for cell in row))


@styled()
def draw_residuals(axis: ServoAxis, ready: dict[str, Followed], fits: dict[str, Fitted]) -> None:
    """Force residual over the speed, held out, for three models."""
    f = ready["emps_pulses"]
    q = nominal.regressors(f)
    figure = new_figure(1, 3, (7.0, 2.9), sharey=True, sharex=True)
    for ax, name in zip(figure.axes, ("viscous only", "Coulomb + offset", "asymmetric"), strict=True):
        lacking = axis.residuals(f, axis_moves(fits[name]))["force"]
        n = min(lacking.size, q["viscous_ns_m"].size)
        ax.plot(q["viscous_ns_m"][:n], lacking[:n], ".", markersize=1.6, color=COLOURS[0])
        ax.set_title(f"{name}: {100.0 * axis.relative_error(f, axis_moves(fits[name])):.1f} %")
        ax.set_xlabel("speed [m/s]")
    figure.axes[0].set_ylabel("force the model lacks [N]")
    head(figure, "What force each model lacks on the record held out, and its share of the force", SOURCE)
    write_bytes_whole(FIGURES / "lacking_force.png", png(figure))


@styled()
def draw_pulses(axis: ServoAxis, wide: dict[str, Followed], moves: dict[str, float]) -> None:
    """The lacking force after the steps of 178 N, over time and over frequency, beside what two effects would leave."""
    f = wide["emps_pulses"]
    share = {"flexible_share": SHARE_SHOWN, "flexible_hz": HZ_SHOWN, "flexible_damping": 0.03}
    measured = axis.residuals(f, moves)["force"]
    found = {
        "measured": measured,
        f"if {100 * SHARE_SHOWN:.0f} % lay beyond {HZ_SHOWN:.0f} Hz": measured
        - axis.residuals(f, moves | share)["force"],
        f"if the force came {DELAY_SHOWN_MS:g} ms late": measured
        - axis.residuals(f, moves | {"loop_delay_ms": DELAY_SHOWN_MS})["force"],
    }
    acting = aligned(following.acting_n(f), f)
    figure = new_figure(1, 2, (7.0, 3.2))
    rate = f.rate_hz / f.keep
    for k, (label, lacking) in enumerate(found.items()):
        look = {"color": COLOURS[k], "linewidth": (1.6, 0.9, 0.9)[k], "linestyle": ("-", "-", "--")[k], "label": label}
        after_steps(figure.axes[0], aligned(lacking, f), rate, look)
        unexplained(figure.axes[1], aligned(lacking, f), acting, rate, look)
    frequency_axis(figure.axes[1], 4.0, 150.0)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    head(figure, "Force that the model lacks after a step of 178 N", f"mean of {len(acting)} steps; {SOURCE}")
    write_bytes_whole(FIGURES / "pulses.png", png(figure))


def aligned(values: Array, f: Followed) -> Array:
    """Pieces (steps, n) from 50 ms before each step to 400 ms after it, signs turned to upward steps, means removed."""
    lead = round(following.LEAD_S * f.rate_hz)
    starts = [(FIRST_PULSE + PULSE_EVERY * k - 50 - lead) // f.keep for k in range(PULSES)]
    n = 450 // f.keep
    rows = [(-1.0) ** k * values[s : s + n] for k, s in enumerate(starts) if s >= 0 and s + n <= values.size]
    few = 40 // f.keep
    return np.array([row - row[:few].mean() for row in rows])


def after_steps(ax: Axes, rows: Array, rate_hz: float, look: dict) -> None:
    """Mean over steps."""
    ax.plot(1e3 * np.arange(rows.shape[1]) / rate_hz - 50.0, rows.mean(axis=0), **look)
    ax.set_xlabel("time after the step [ms]")
    ax.set_ylabel("lacking force [N]")


def unexplained(ax: Axes, lacking: Array, acting: Array, rate_hz: float, look: dict) -> None:
    """Lacking over acting force by frequency: cross-spectra over steps, tapered at their end."""
    taper = np.ones(lacking.shape[1])
    end = taper.size // 3
    taper[-end:] = 0.5 + 0.5 * np.cos(np.pi * np.arange(end) / end)
    e, a = (np.fft.rfft(x * taper, axis=1) for x in (lacking, acting))
    gain = np.abs((e * a.conj()).sum(axis=0)) / (np.abs(a) ** 2).sum(axis=0)
    hz = np.fft.rfftfreq(taper.size, 1.0 / rate_hz)
    kept = (hz >= 4.0) & (hz <= 150.0)
    ax.loglog(hz[kept], 100.0 * gain[kept], **look)
    ax.set_ylabel("lacking / acting force [%]")


if __name__ == "__main__":
    main()
