"""Which effect explains the eigenfrequencies that the source measured on its own arm, and how sure can one be."""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares, minimize

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, angular, rad
from loopshape.io.files import write_bytes_whole
from loopshape.toolbox.arm.effect.effects import FORMS
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, INERTIA, constants
from loopshape.toolbox.arm.source import EQUILIBRIA
from loopshape.toolbox.gap.nouns.effect import EffectForm
from loopshape.view.style import COLOURS, QUIET, head, new_figure, png, shades, styled

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's own files, however it is started

import gap_scores  # noqa: E402
from published import (  # noqa: E402
    HIGH_HZ,
    LOW_HZ,
    MEASURED,
    SIMULATED,
    UPRIGHT,
    WIDE,
    Numbers,
    digits,
    numbers,
    own_misfits,
)

FIGURES = HERE.parent.parent / "figures" / HERE.name
DRAWS, SEED = 700, 5
COLUMNS = (
    "digits", "effects", "form", "magnitude", "low_95", "high_95", "unit", "chi2_frequency", "chi2_gain",
    "chi2_damping", "f_0deg_hz", "f_30deg_hz", "f_min_hz", "f_max_hz", "rise_30deg_hz", "rise_hz_per_bar",
    "kappa_ratio", "gain_span_db", "kappa_span_db", "kappa_over_measured",
)  # fmt: skip
POSTERIORS = (
    "effect", "own_digits_usual", "own_digits_bounds", "own_digits_usual_twice_the_errors",
    "own_digits_bounds_twice_the_errors", "any_digits_usual", "any_digits_bounds", "any_digits_usual_twice_the_errors",
    "any_digits_bounds_twice_the_errors",
)  # fmt: skip
HEAT = (1.0, 4.0)  # what the squared misfits are divided by: the errors as they are, and twice as large
Moves = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Case:
    """One hypothesis at its best: digits of table 4.1, form, values of what it frees, and the numbers."""

    digits: str
    effects: str
    form: EffectForm | None
    values: tuple[float, ...]
    found: Numbers
    interval: tuple[float, float] = (float("nan"), float("nan"))


def main() -> None:
    """Fit, rank, table, draw."""
    printed, own = np.zeros(6), own_digits()
    moving = [form for form in FORMS if acts(form)]
    seen = {f.effect for f in moving}
    print("no trace in a linearised plant:", ", ".join(dict.fromkeys(f.effect for f in FORMS if f.effect not in seen)))
    cases = [Case(w, "none", None, (), numbers(digits(q))) for w, q in (("printed", printed), ("own", own))]
    cases += [best(w, f, digits(q)) for w, q in (("printed", printed), ("own", own)) for f in moving]
    gas = {"gas_absolute_share": 1.0}
    others = [f for f in moving if f.effect != "gas_law"]
    cases += [best("own", f, digits(own) | gas, "gas_law + ", gains=True) for f in others]
    write("results.csv", COLUMNS, [row(case) for case in cases])
    gassy = next(c for c in cases if c.effects == "gas_law" and c.digits == "own")
    print(f"friction for the damping at (30 deg, 0.8 bar), moving by 1 deg: {friction_nm(gassy.found):.3f} N m")
    rows = posteriors(moving)
    write("posterior.csv", POSTERIORS, rows)
    write("scores.csv", gap_scores.COLUMNS, gap_scores.rows(HERE))
    for line in [row(case) for case in cases] + rows:
        print("  ".join(f"{cell!s:>12.34}" for cell in line))
    write_bytes_whole(FIGURES / "eigenfrequency.png", png(draw(cases)))


def write(name: str, columns: tuple[str, ...], rows: Sequence[Sequence]) -> None:
    """A small table beside this file."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


def own_digits() -> Array:
    """Shares of half a digit (6,), small ones, with which the printed model gives the source's own 5.8 and 4.7 Hz."""
    return least_squares(lambda q: np.r_[own_misfits(q), 0.1 * q], np.zeros(6), bounds=(-1.0, 1.0), diff_step=1e-3).x


def acts(form: EffectForm) -> bool:
    """Whether a form moves the linearised arm's numbers. Coulomb's slope at rest is no motion's damping: left out."""
    if form.effect == "joint_friction":
        return False
    moved = numbers(form.moves([f.starts[0] for f in form.free])).table / numbers({}).table
    return bool(np.nanmax(np.abs(moved - 1.0)) > 1e-4)


def chi2(found: Numbers, *, gains: bool = False) -> float:
    """Sum of squared misfits; a model that cannot stand or falls over is out."""
    misfits = np.r_[found.frequency_misfits(), found.gain_misfits() if gains else []]
    total = float(misfits @ misfits)
    return total if np.isfinite(total) else 1e6


def tried(form: EffectForm, values: Array, rest: Moves) -> Numbers | None:
    """The numbers with a form at these values; None outside its bounds or where the arm cannot be."""
    if any(not f.low <= v <= f.high for f, v in zip(form.free, values, strict=True)):
        return None
    try:
        return numbers(dict(rest) | form.moves(values))
    except WrongUseError:
        return None


def best(word: str, form: EffectForm, rest: Moves, before: str = "", *, gains: bool = False) -> Case:
    """The form's best values from each of its starts, and the magnitudes within 3.84 of the best, others held."""

    def cost(values: Array) -> float:
        found = tried(form, values, rest)
        return 1e6 if found is None else chi2(found, gains=gains)

    starts = [[s, *(f.starts[0] for f in form.free[1:])] for s in form.free[0].starts]
    ends = [
        minimize(cost, s, method="Nelder-Mead", options={"maxfev": 160, "xatol": 1e-4, "fatol": 1e-3}) for s in starts
    ]
    end = min(ends, key=lambda e: e.fun)
    grid = np.linspace(form.free[0].low, form.free[0].high, 161)
    near = [v for v in grid if cost(np.r_[v, end.x[1:]]) < end.fun + 3.84] + [end.x[0]]
    interval = tuple(sorted((form.magnitude([min(near)]), form.magnitude([max(near)]))))
    found = tried(form, end.x, rest)
    assert found is not None
    return Case(word, before + form.effect, form, tuple(end.x.tolist()), found, interval)


def row(case: Case) -> list:
    """One line of the table."""
    n, form = case.found, case.form
    middle = "" if form is None else f"{form.magnitude(case.values):.3g}"
    ends = ["" if np.isnan(x) else f"{x:.3g}" for x in case.interval]
    ratio = n.at(UPRIGHT)[0] / MEASURED[UPRIGHT][0]
    values = [chi2(n), float(n.gain_misfits() @ n.gain_misfits()), float(n.damping_misfits() @ n.damping_misfits())]
    f = n.table[:, 1]
    values += [
        n.at(UPRIGHT)[1],
        n.at(WIDE)[1],
        f.min(),
        f.max(),
        n.away_hz,
        n.per_bar_hz,
        n.at(WIDE)[0] / n.at(UPRIGHT)[0],
    ]
    values += [n.gain_span_db, n.mass_span_db, ratio]
    words = [case.digits, case.effects, form.form if form else "", middle, *ends, form.unit if form else ""]
    return words + [f"{v:.4g}" for v in values]


def friction_nm(n: Numbers, amplitude_deg: float = 1.0) -> float:
    """Coulomb torque whose describing function makes up for the damping that a model lacks at (30 deg, 0.8 bar)."""
    c = constants(ARM1_PARAMETERS.vector())
    w = float(angular(n.at(WIDE)[1]))
    lacking = 2.0 * (MEASURED[WIDE][2] - n.at(WIDE)[2]) * w * float(c[INERTIA])
    return 0.25 * np.pi * lacking * w * float(rad(amplitude_deg))


def posteriors(moving: list[EffectForm]) -> list[list]:
    """Probability of each effect, equal before, from the frequencies alone, under four assumptions.

    Table 4.1's digits are uniform within their rounding, or those of these that reproduce the source's own simulation
    within half a unit of its digits; magnitudes are uniform in the catalogue's usual range (of either sign where it may
    be), or in its bounds. An effect is the mean of its forms that show; other free numbers are uniform in their bounds.
    """
    rng = np.random.default_rng(SEED)
    pool = rng.uniform(-1.0, 1.0, (6000, 6))
    own = pool[[bool(np.abs(own_misfits(q)).max() < 1.0) for q in pool]]
    columns = []
    for shares in (own, pool):
        found = {"none": [np.tile(likelihoods([chi2(numbers(digits(q))) for q in shares[:DRAWS]]), (2, 1))]}
        for form in moving:
            found.setdefault(form.effect, []).append(
                np.array([likelihoods(drawn(form, shares, rng, w)) for w in (0, 1)])
            )
        means = {name: np.mean(values, axis=0) for name, values in found.items()}
        total = sum(means.values())
        columns += [
            {name: v[wide, hot] / total[wide, hot] for name, v in means.items()} for hot in (0, 1) for wide in (0, 1)
        ]
    order = sorted(columns[0], key=lambda name: -columns[0][name])
    return [[name, *("<1e-9" if c[name] < 1e-9 else f"{c[name]:.2g}" for c in columns)] for name in order]


def likelihoods(chi2s: list[float]) -> Array:
    """Mean likelihood (2,) with the errors as they are and twice as large."""
    return np.array([float(np.mean(np.exp(-0.5 * np.array(chi2s) / heat))) for heat in HEAT])


def drawn(form: EffectForm, shares: Array, rng: np.random.Generator, wide: int) -> list[float]:
    """Chi-squared of draws of a form's numbers, the magnitude from its usual range or (`wide`) its bounds."""
    first, found = form.free[0], []
    for q in shares[rng.integers(len(shares), size=DRAWS)]:
        value = rng.uniform(first.low, first.high) if wide else rng.uniform(*form.usual) / form.scale
        if not wide and first.low < 0.0 and rng.random() < 0.5:
            value = -value
        values = np.array([value, *(rng.uniform(f.low, f.high) for f in form.free[1:])])
        model = tried(form, values, digits(q))
        found.append(1e6 if model is None else chi2(model))
    return found


PANELS = (
    ("printed", "none", "", "as printed"),
    ("own", "none", "", "digits of its own simulation"),
    ("own", "stiffness_error", "", "+ stiffness error"),
    ("own", "hose_stiffness", "hardening spring about an angle", "+ hardening hose"),
    ("own", "gas_law", "share of the atmosphere", "+ absolute gas law"),
    ("printed", "gas_law", "absolute, polytropic", "printed, polytropic gas"),
)


@styled()
def draw(cases: list[Case]):
    """Eigenfrequency over the angle by pressure: what was measured, what is printed, and the leading effects."""
    figure = new_figure(2, 3, (7.0, 5.0), sharex=True, sharey=True)
    pressures = sorted({p for _, p in EQUILIBRIA})
    colours = dict(zip(pressures, shades(len(pressures)), strict=True))
    for ax, (word, effects, form, title) in zip(figure.axes, PANELS, strict=True):
        fitting = [
            c for c in cases if (c.digits, c.effects) == (word, effects) and form in ("", c.form and c.form.form)
        ]
        case = min(fitting, key=lambda c: chi2(c.found))
        ax.axhspan(LOW_HZ, HIGH_HZ, color="0.9", label="measured, 24 points")
        for p in pressures:
            places = [k for k, q in enumerate(EQUILIBRIA) if q[1] == p]
            angles = [EQUILIBRIA[k][0] for k in places]
            ax.plot(
                angles, case.found.table[places, 1], color=colours[p], marker=".", linewidth=0.9, label=f"{p:.1f} bar"
            )
        for point, (_, f_hz, _) in MEASURED.items():
            ax.plot(
                point[0],
                f_hz,
                "D",
                color=colours[point[1]],
                markeredgecolor="black",
                markersize=6,
                label="measured fit",
            )
        for point, (_, f_hz, _) in SIMULATED.items():
            ax.plot(
                point[0], f_hz, "o", color="white", markeredgecolor=QUIET, markersize=5, label="the source's simulation"
            )
        note = (
            "" if case.form is None else f" {case.form.magnitude(case.values):.2g} {case.form.unit}".removesuffix(" 1")
        )
        ax.set_title(title + note, fontsize=8.5)
        ax.text(
            0.03, 0.91, rf"$\chi^2$ = {chi2(case.found):.0f}", transform=ax.transAxes, fontsize=8.0, color=COLOURS[6]
        )
    for ax in figure.axes[3:]:
        ax.set_xlabel(r"$\theta_2$ [deg]")
        ax.set_xticks([-30, -15, 0, 15, 30])
    for ax in figure.axes[::3]:
        ax.set_ylabel("eigenfrequency [Hz]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    kept = dict(zip(labels, handles, strict=True))
    figure.legend(kept.values(), kept.keys(), loc="outside lower center", ncols=5)
    head(figure, "Eigenfrequencies of the source's own arm and of the linearised model, pressures by colour")
    return figure


if __name__ == "__main__":
    main()
