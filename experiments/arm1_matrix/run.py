"""The 1-DoF arm as a plant of two loops: do theta2 and p_AB meet, where from, and what does linearising say."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "arm2_interaction"))  # its valves

from valves import Plant, best_gains, replayed, valves  # noqa: E402

from loopshape.core.units import ComplexArray, db, deg  # noqa: E402
from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.data.signal.recording import Recording  # noqa: E402
from loopshape.data.signal.run import Run  # noqa: E402
from loopshape.identify.matrix.matrix import estimate_matrix  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.toolbox.arm.arm1 import Arm1  # noqa: E402
from loopshape.toolbox.arm.dynamics.equilibrium import pressures  # noqa: E402
from loopshape.toolbox.arm.dynamics.linear import Linearisation, linearise  # noqa: E402
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants  # noqa: E402
from loopshape.toolbox.diagrams.coupling.interaction import interaction  # noqa: E402
from loopshape.toolbox.diagrams.coupling.nouns import Interaction  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.toolbox.rig.simulated import header, measure  # noqa: E402
from loopshape.view.plots.curves import draw_band, frequency_axis  # noqa: E402
from loopshape.view.style import COLOURS, LIMIT, QUIET, head, new_figure, png, styled  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
LOOPS = ("theta2", "p_ab")
SETS = {"one at a time": LOOPS, "both at once": ("both",)}
BANDS = ((0.25, 1.0), (1.0, 3.0), (3.0, 6.0), (6.0, 10.0))
NUMBERS = constants(ARM1_PARAMETERS.vector())
ENTRY, OUTPUTS = np.eye(4)[:, 2:], np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
DECOUPLING = np.array([[1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Found:
    """One set of recordings at one point, with the linearisation and what the recordings' own commands make of it."""

    name: str
    frf: FRF
    met: Interaction
    bare: ComplexArray
    replay: ComplexArray
    gains: np.ndarray

    @property
    def where(self) -> tuple[float, float]:
        """Angle in deg and p_AB in bar."""
        return self.frf.operating_point["theta2_deg"], self.frf.operating_point["p_ab_bar"]


def main() -> None:
    """Measure, estimate, compare, write tables and figures."""
    study, found = read_study(HERE / "study.toml"), []
    for point in study.operating_points:
        here, arm = replace(study, operating_points=(point,)), Arm1()
        run, recordings = header(here, arm), list(measure(here, arm))
        if early := [r.info.name for r in recordings if r.info.ended_early]:
            raise SystemExit(f"{point}: {', '.join(early)} ended early")
        found += [analysed(run, recordings, name) for name in SETS]
    write("interaction.csv", PAIRS, [row for one in found for row in bands(one)])
    write("elements.csv", ELEMENTS, [row for one in found for row in elements(one)])
    write("gains.csv", GAINS, [row for one in found for row in gains(one)])
    write_bytes_whole(FIGURES / "coefficient.png", png(draw_coefficient(found)))
    write_bytes_whole(FIGURES / "matrix.png", png(draw_matrix(found)))


def analysed(run: Run, recordings: Sequence[Recording], name: str) -> Found:
    """The matrix of a set and its interaction, and both linear plants on its lines."""
    mine = [r for r in recordings if r.info.name.split("-r")[0] in SETS[name]]
    frf = replace(estimate_matrix(run, mine), recording=name)
    known = {loop.name: loop.controller for loop in run.loops if loop.controller}
    f, point = frf.frequency_hz, frf.operating_point
    theta = float(deg(np.mean([r.column("theta2_rad").mean() for r in mine])))
    p_ab = float(np.mean([(r.column("p_a_bar") + r.column("p_b_bar")).mean() for r in mine]))
    lin = linearise(NUMBERS, theta, p_ab)
    law = valves(lin.fill, lin.exhaust, pressures(NUMBERS, theta, p_ab))
    u = np.concatenate([np.stack([r.column(c)[::20] for c in ("u_a_v", "u_b_v")], axis=1) for r in mine])
    replay = replayed(run, mine, LOOPS, plant(lin), law, f, "ab")
    low, high = frf.valid_band_hz
    print(f"{point}, {name}: stood at {theta:.2f} deg, {p_ab:.3f} bar, valid {low:.3g} to {high:.3g} Hz")
    bare = linearise(NUMBERS, **point).response(f)
    return Found(name, frf, interaction(frf, LOOPS, known, bands=BANDS), bare, replay, best_gains(law, u))


def plant(lin: Linearisation) -> Plant:
    """What is linear of the arm, from rates of the muscles' pressures on."""
    return Plant(lin.dynamics, ENTRY, OUTPUTS, DECOUPLING)


def coefficient(P: ComplexArray) -> ComplexArray:
    """k_I (nf,) of a plant (nf, 2, 2)."""
    return np.asarray(P[:, 0, 1] * P[:, 1, 0] / (P[:, 0, 0] * P[:, 1, 1]))


PAIRS = (
    "theta2_deg", "p_ab_bar", "set", "from_hz", "to_hz", "lines", "verdict", "at_hz", "low_db", "k_i_db", "high_db",
    "linearised_db", "replay_db", "rga_own_least", "rga_own_most", "theta2_closed_over_open_db",
)  # fmt: skip


def bands(one: Found) -> list[list]:
    """A line a band: verdict, k_I of the linear plants at its line, span of the RGA, what closing p_AB changes."""
    rows, f = [], one.frf.frequency_hz
    for v in one.met.verdicts:
        use = (f >= v.band_hz[0]) & (f <= v.band_hz[1]) & one.frf.valid
        there = int(np.argmin(np.abs(f - v.at_hz))) if np.isfinite(v.at_hz) else 0
        own = np.abs(one.met.relative_gain.gain[use, 0, 0])
        change = np.abs(db(one.met.equivalents[0].ratio[use]))
        values = [
            v.at_hz,
            v.low_db,
            v.estimate_db,
            v.high_db,
            *(db(coefficient(P)[there]) for P in (one.bare, one.replay)),
        ]
        values += (
            [x for part in (own, change) for x in ((part.min(), part.max()) if part is own else (part.max(),))]
            if use.any()
            else [np.nan] * 3
        )
        rows.append(
            [
                *one.where,
                one.name,
                *v.band_hz,
                v.lines,
                v.verdict,
                *(f"{x:.4g}" if np.isfinite(x) else "" for x in values),
            ]
        )
    return rows


ELEMENTS = (
    "theta2_deg", "p_ab_bar", "set", "element", "over_bare_db", "over_bare_deg", "difference_bare", "difference_replay",
    "median_std", "within_95_bare", "within_95_replay",
)  # fmt: skip


def elements(one: Found) -> list[list]:
    """A line an element, medians over 0.5 to 10 Hz of valid lines."""
    frf, rows = one.frf, []
    use = frf.valid & (frf.frequency_hz >= 0.5)
    for i, j in np.ndindex(2, 2):
        H, std = frf.response[use, i, j], np.sqrt(frf.variance[use, i, j])
        over, errors = H / one.bare[use, i, j], [np.abs(H / P[use, i, j] - 1.0) for P in (one.bare, one.replay)]
        within = [np.mean(np.abs(H - P[use, i, j]) < np.sqrt(-np.log(0.05)) * std) for P in (one.bare, one.replay)]
        values = [np.median(db(over)), np.median(deg(np.angle(over))), *(np.median(e) for e in errors)]
        values += [np.median(std / np.abs(H)), *within]
        rows.append([*one.where, one.name, f"P{i + 1}{j + 1}", *(f"{x:.3g}" for x in values)])
    return rows


GAINS = (
    "theta2_deg",
    "p_ab_bar",
    "set",
    "rate",
    "from_z_theta2",
    "from_z_p",
    "averaged_from_z_theta2",
    "averaged_from_z_p",
)


def gains(one: Found) -> list[list]:
    """dp_A/dt + dp_B/dt and their difference in bar/s per V: what the commands saw, and averaged valves."""
    theta, p_ab = one.where
    lin = linearise(NUMBERS, theta, p_ab)
    seen, averaged = one.gains @ DECOUPLING, np.diag(lin.mean_gains) @ DECOUPLING
    rows = []
    for word, row in (("sum", np.array([1.0, 1.0])), ("difference", np.array([1.0, -1.0]))):
        values = (*(row @ seen), *(row @ averaged))
        rows.append([theta, p_ab, one.name, word, *(f"{x:.3f}" for x in values)])
    return rows


@styled()
def draw_coefficient(found: Sequence[Found]) -> Figure:
    """|k_I| at each point, measured both ways, linearised, and with the gains that the commands saw."""
    points = list(dict.fromkeys(one.where for one in found))
    figure = new_figure(2, 2, (7.0, 5.2), sharex=True, sharey=True)
    for k, (point, ax) in enumerate(zip(points, figure.axes, strict=True)):
        for one, colour in zip((x for x in found if x.where == point), COLOURS, strict=False):
            f, c = one.frf.frequency_hz, one.met.coefficients[0]
            draw_band(
                ax,
                f,
                np.maximum(db(np.maximum(c.low, 1e-10)), -200.0),
                db(np.minimum(c.high, 1e9)),
                color=colour,
                alpha=0.15,
            )
            ax.semilogx(f, db(c.coefficient), color=colour)
            ax.semilogx(f, db(coefficient(one.replay)), color=colour, linestyle=(0, (1, 1)), linewidth=1.2)
        ax.semilogx(f, db(coefficient(one.bare)), color=QUIET, linestyle=(0, (4, 2)), linewidth=0.9)
        ax.axhline(-20.0, color=LIMIT, linewidth=1.0, linestyle="--")
        ax.set_title(f"{point[0]:g} deg, {point[1]:g} bar", loc="left")
        frequency_axis(ax, 0.25, 10.0, label=k > 1)
    figure.axes[0].set_ylim(-60.0, 10.0)
    for ax in figure.axes[::2]:
        ax.set_ylabel("|$k_I$| [dB]")
    keys = [Line2D([], [], color=c, label=name) for c, name in zip(COLOURS, SETS, strict=False)]
    keys.append(Line2D([], [], color=QUIET, linestyle=(0, (4, 2)), linewidth=0.9, label="linearised, averaged valves"))
    keys.append(Line2D([], [], color=QUIET, linestyle=(0, (1, 1)), linewidth=1.2, label="with the gains that u saw"))
    keys.append(Line2D([], [], color=LIMIT, linestyle="--", linewidth=1.0, label="-20 dB"))
    figure.legend(handles=keys, loc="outside lower center", ncols=3)
    head(
        figure,
        r"Interaction of $\theta_2$ and $p_{AB}$ of the 1-DoF arm",
        "shaded: 95 % of each line, twelve realisations",
    )
    return figure


@styled()
def draw_matrix(found: Sequence[Found]) -> Figure:
    """The four elements at 15 deg, measured one at a time, linearised, and with the gains that the commands saw."""
    one = next(x for x in found if x.where == (15.0, 1.2) and x.name == "one at a time")
    figure = new_figure(2, 2, (7.0, 5.0), sharex=True)
    names = ((r"$\theta_2$ / $z_\theta$", r"$\theta_2$ / $z_p$"), (r"$p_{AB}$ / $z_\theta$", r"$p_{AB}$ / $z_p$"))
    for (i, j), ax in zip(np.ndindex(2, 2), figure.axes, strict=True):
        element(ax, one, i, j)
        ax.set_title(names[i][j], loc="left")
        ax.set_ylabel(f"|P| [dB re 1 {('rad', 'bar')[i]}/V]")
        frequency_axis(ax, 0.25, 10.0, label=i == 1)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    title = r"The 1-DoF arm at 15 deg, 1.2 bar: $z_\theta$ moves $p_{AB}$ through unlike filling and exhaust"
    head(figure, title, "one loop at a time; shaded: 95 % of each line, twelve realisations")
    return figure


def element(ax: Axes, one: Found, i: int, j: int) -> None:
    """One element in dB."""
    f, H = one.frf.frequency_hz, one.frf.response[:, i, j]
    reach = 1.96 * np.sqrt(one.frf.variance[:, i, j] / 2.0)
    draw_band(ax, f, db(np.maximum(np.abs(H) - reach, 1e-6)), db(np.abs(H) + reach), color=COLOURS[0], alpha=0.18)
    ax.semilogx(f, db(H), color=COLOURS[0], label="measured")
    ax.semilogx(
        f, db(one.bare[:, i, j]), color=QUIET, linestyle=(0, (4, 2)), linewidth=0.9, label="linearised, averaged valves"
    )
    ax.semilogx(
        f,
        db(one.replay[:, i, j]),
        color=COLOURS[1],
        linestyle=(0, (1, 1)),
        linewidth=1.3,
        label="with the gains that u saw",
    )


def write(name: str, columns: Sequence[str], rows: Sequence[Sequence]) -> None:
    """A small table beside this file."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


if __name__ == "__main__":
    main()
