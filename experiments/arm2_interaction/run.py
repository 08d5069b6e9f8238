"""How the loops of the 2-DoF arm meet: one at a time and at once, against the linearisation and the source."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the study's other files, however it is started

from ladder import exact, simulate  # noqa: E402
from pictures import draw_cause, draw_coefficient, draw_matrix  # noqa: E402
from valves import Plant, Valves, replayed, valves, with_closed  # noqa: E402

from loopshape.core.units import ComplexArray, db, deg  # noqa: E402
from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.data.signal.recording import Recording  # noqa: E402
from loopshape.data.signal.run import Run  # noqa: E402
from loopshape.identify.matrix.matrix import estimate_matrix  # noqa: E402
from loopshape.io.files import write_bytes_whole  # noqa: E402
from loopshape.toolbox.arm.arm2 import Arm2  # noqa: E402
from loopshape.toolbox.arm.dynamics.equilibrium2 import pressures2  # noqa: E402
from loopshape.toolbox.arm.dynamics.linear2 import DECOUPLING, OUTPUTS, Linearisation2, linearise2  # noqa: E402
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2  # noqa: E402
from loopshape.toolbox.diagrams.coupling.interaction import interaction  # noqa: E402
from loopshape.toolbox.diagrams.coupling.nouns import Interaction  # noqa: E402
from loopshape.toolbox.rig.files.study import read_study  # noqa: E402
from loopshape.toolbox.rig.simulated import experiment, header, measure, plan  # noqa: E402
from loopshape.toolbox.rig.study import Study  # noqa: E402
from loopshape.view.style import png  # noqa: E402

FIGURES = HERE.parent.parent / "figures" / HERE.name
ANGLES, ALL = ("theta1", "theta2"), ("theta1", "theta2", "p_a", "p_c")
#: name of a set: loops of the matrix, and the experiments that it takes
SETS = {
    "angles one at a time": (ANGLES, ANGLES),
    "angles at once": (ANGLES, ("angles",)),
    "four one at a time": (ALL, ALL),
    "four at once": (ALL, ("all",)),
}
BANDS = ((0.125, 0.5), (0.5, 1.0), (1.0, 1.6), (1.6, 2.8), (2.8, 4.0), (4.0, 8.0))
NUMBERS = constants2(ARM2_PARAMETERS.vector())


@dataclass(frozen=True, eq=False)
class Found:
    """One set of recordings at one point: its matrix, how its loops meet, and what two linear plants say of it."""

    name: str
    p_c_bar: float
    frf: FRF
    met: Interaction
    bare: ComplexArray
    replay: ComplexArray


def main() -> None:
    """Measure, estimate, compare, write tables and figures."""
    study = read_study(HERE / "study.toml")
    found = [one for point in study.operating_points for one in at_point(replace(study, operating_points=(point,)))]
    write("elements.csv", ELEMENTS, [row for one in found for row in elements(one)])
    write("interaction.csv", PAIRS, [row for one in found for row in pairs(one)])
    write("closing.csv", CLOSING, [row for one in found for row in closing(one)])
    steps = rungs(replace(study, operating_points=study.operating_points[:1]))
    write("ladder.csv", LADDER, [row for one in steps for row in rung_row(*one)])
    pages = {
        "coefficient": draw_coefficient([one for one in found if one.name.startswith("angles")]),
        "matrix": draw_matrix([one for one in found if one.name == "angles one at a time"]),
        "cause": draw_cause(steps, found[:2]),
    }
    for name, figure in pages.items():
        write_bytes_whole(FIGURES / f"{name}.png", png(figure))


def at_point(study: Study) -> list[Found]:
    """All four sets at the study's only operating point."""
    arm = Arm2()
    run = header(study, arm)
    recordings = [lean(run, r) for r in measure(study, arm)]
    return [analysed(run, recordings, name) for name in SETS]


def lean(run: Run, recording: Recording) -> Recording:
    """Without the columns that nothing here needs: there are 120 recordings of 144 s."""
    kept = {"t_s", *(f"u_{m}_v" for m in "abcd")}
    kept |= {c for loop in run.loops for c in (str(loop.injected), loop.control, loop.output)}
    if recording.info.ended_early is not None:
        raise SystemExit(f"{recording.info.name}: {recording.info.ended_early}")
    return replace(recording, columns={name: recording.column(name) for name in sorted(kept)})


def analysed(run: Run, recordings: Sequence[Recording], name: str) -> Found:
    """The matrix of a set, its interaction with the bounds of its covariance, and the linear plants."""
    loops, experiments = SETS[name]
    mine = [r for r in recordings if r.info.name.split("-r")[0] in experiments]
    frf = replace(estimate_matrix(run, mine), recording=name)
    controllers = {loop.name: loop.controller for loop in run.loops if loop.name in loops and loop.controller}
    point = tuple(frf.operating_point[key] for key in Arm2().strategy.point_keys)
    bare = with_closed(linearise2(NUMBERS, *point).response(frf.frequency_hz), run, loops, frf.frequency_hz)
    where = stood(mine)
    lin = linearise2(NUMBERS, *where)
    replay = replayed(run, mine, loops, plant(lin), law(lin, where), frf.frequency_hz, "abcd")
    most = max(float(np.abs(r.column(f"u_{m}_v")).max()) for r in mine for m in "abcd")
    print(f"p_C {point[3]:g} bar, {name}: stood at {np.round(where, 3).tolist()}, largest |u| {most:.2f} V, valid from")
    print(f"    {frf.valid_band_hz[0]:.3g} to {frf.valid_band_hz[1]:.3g} Hz; {frf.method}")
    return Found(name, point[3], frf, interaction(frf, loops, controllers, bands=BANDS), bare, replay)


def stood(recordings: Sequence[Recording]) -> tuple[float, float, float, float]:
    """Where the arm stood on average: deg, deg, bar, bar."""
    mean = [float(np.mean([r.column(c).mean() for r in recordings])) for c in ("theta1_rad", "theta2_rad")]
    p = [float(np.mean([r.column(c).mean() for r in recordings])) for c in ("p_a_bar", "p_c_bar")]
    return float(deg(mean[0])), float(deg(mean[1])), p[0], p[1]


def plant(lin: Linearisation2) -> Plant:
    """What is linear of the arm, from rates of the muscles' pressures on."""
    return Plant(lin.dynamics, np.vstack([np.zeros((4, 4)), np.eye(4)]), OUTPUTS, DECOUPLING)


def law(lin: Linearisation2, point: Sequence[float], *, dead_zone: float = 0.01, shared: bool = True) -> Valves:
    """Averaged valves at a point."""
    return valves(lin.fill, lin.exhaust, pressures2(NUMBERS, *point), dead_zone=dead_zone, shared=shared)


def rungs(study: Study) -> list[tuple[str, FRF, FRF, ComplexArray]]:
    """Name, matrix of the angles one at a time, at once, and the averaged valves' own, rung by rung."""
    point = tuple(study.operating_points[0][key] for key in Arm2().strategy.point_keys)
    lin = linearise2(NUMBERS, *point)
    mean = replace(lin, fill=np.diag(gains := mean_gains(lin)).copy(), exhaust=np.diag(gains).copy())
    cases = {
        "averaged valves": (law(mean, point, dead_zone=0.0, shared=False), 1.0),
        "dead zone": (law(mean, point, shared=False), 1.0),
        "filling unlike exhaust": (law(lin, point, dead_zone=0.0, shared=False), 1.0),
        "and one throttle for all": (law(lin, point, dead_zone=0.0), 1.0),
        "the same, a tenth of the amplitude": (law(lin, point, dead_zone=0.0), 0.1),
    }
    return [(name, *on_rung(study, plant(lin), gains, *case)) for name, case in cases.items()]


def mean_gains(lin: Linearisation2) -> np.ndarray:
    """The linearisation's own gains (4, 4): the means of filling and exhaust."""
    return np.diag(0.5 * (lin.fill + lin.exhaust))


def on_rung(study: Study, of: Plant, gains: np.ndarray, valves: Valves, scale: float) -> tuple[FRF, FRF, ComplexArray]:
    """What the study measures on one rung, and what it should if valves were averaged."""
    arm = Arm2()
    run, frfs = header(study, arm), []
    for experiments in (ANGLES, ("angles",)):
        todo = [p for p in plan(study, arm) if p.name.split("-r")[0] in experiments]
        recordings = [simulate(experiment(study, arm, p), of, valves, scale) for p in todo]
        frfs.append(estimate_matrix(run, recordings))
    f = frfs[0].frequency_hz
    return frfs[0], frfs[1], with_closed(exact(of, gains, f, run.rate_hz), run, ANGLES, f)


LADDER = (
    "rung",
    "element",
    "one_against_linear",
    "at_once_against_linear",
    "at_once_over_one",
    "the_same_at_2_to_2.5_hz",
)


def rung_row(name: str, one: FRF, both: FRF, linear: ComplexArray) -> list[list]:
    """A line an element: medians of relative differences, and the largest from 2 to 2.5 Hz."""
    near = (one.frequency_hz >= 2.0) & (one.frequency_hz <= 2.5)
    sizes = [
        np.abs(a / b - 1.0) for a, b in ((one.response, linear), (both.response, linear), (both.response, one.response))
    ]
    return [
        [
            name,
            f"P{i + 1}{j + 1}",
            *(f"{np.median(x[:, i, j]):.2g}" for x in sizes),
            f"{sizes[2][near, i, j].max():.2g}",
        ]
        for i in (0, 1)
        for j in (0, 1)
    ]


ELEMENTS = (
    "p_c_bar", "set", "element", "level_db_0.2_to_1_hz", "bare_db", "rms_bare", "rms_replay", "median_std",
    "within_95_bare", "within_95_replay",
)  # fmt: skip


def elements(one: Found) -> list[list]:
    """A line an element: its level, its median over the bare linearisation, rms differences from 0.5 to 8 Hz."""
    frf, rows = one.frf, []
    low, use = (frf.frequency_hz > 0.2) & (frf.frequency_hz < 1.0), frf.frequency_hz >= 0.5
    for i, j in np.ndindex(*frf.response.shape[1:]):
        H, std = frf.response[:, i, j], np.sqrt(frf.variance[:, i, j])
        errors = [np.abs(H / P[:, i, j] - 1.0)[use] for P in (one.bare, one.replay)]
        within = [
            np.mean(np.abs(H - P[:, i, j])[use] < np.sqrt(-np.log(0.05)) * std[use]) for P in (one.bare, one.replay)
        ]
        rows.append([one.p_c_bar, one.name, f"P{i + 1}{j + 1}", round(float(np.median(db(H[low]))), 1)])
        rows[-1] += [round(float(np.median(db(H / one.bare[:, i, j])[use])), 2)]
        rows[-1] += [round(float(np.sqrt(np.median(e**2))), 3) for e in errors]
        rows[-1] += [round(float(np.median(std[use] / np.abs(H[use]))), 3), *(round(float(w), 2) for w in within)]
    return rows


PAIRS = (
    "p_c_bar", "set", "pair", "from_hz", "to_hz", "lines", "verdict", "at_hz", "low_db", "k_i_db", "high_db",
    "linearised_db", "replay_db", "linearised_largest_db",
)  # fmt: skip


def pairs(one: Found) -> list[list]:
    """A line a pair and band: the verdict, and k_I of both linear plants at the line that decides."""
    rows = []
    f = one.frf.frequency_hz
    for v in one.met.verdicts:
        i, j = (one.met.loops.index(name) for name in v.loops)
        k = [db(P[:, i, j] * P[:, j, i] / (P[:, i, i] * P[:, j, j])) for P in (one.bare, one.replay)]
        there = int(np.argmin(np.abs(f - v.at_hz))) if np.isfinite(v.at_hz) else 0
        inside = (f >= v.band_hz[0]) & (f <= v.band_hz[1])
        values = [v.at_hz, v.low_db, v.estimate_db, v.high_db, k[0][there], k[1][there], k[0][inside].max()]
        told = [f"{x:.4g}" if np.isfinite(x) else "" for x in values]
        rows.append([one.p_c_bar, one.name, " ".join(v.loops), *v.band_hz, v.lines, v.verdict, *told])
    return rows


CLOSING = (
    "p_c_bar",
    "set",
    "loop",
    "from_hz",
    "to_hz",
    "closed_over_open_db",
    "closed_over_open_deg",
    "rga_own_least",
    "rga_own_most",
)


def closing(one: Found) -> list[list]:
    """A line a loop and band: the largest change that closing the others makes, and the span of its own RGA."""
    rows = []
    for k, e in enumerate(one.met.equivalents):
        f = e.open.frequency_hz
        for low, high in BANDS:
            use = (f >= low) & (f <= high)
            changes = [np.abs(db(e.ratio[use])).max(), np.abs(deg(np.angle(e.ratio[use]))).max()]
            own = np.abs(one.met.relative_gain.gain[use, k, k])
            rows.append(
                [one.p_c_bar, one.name, e.loop, low, high, *(f"{x:.3g}" for x in (*changes, own.min(), own.max()))]
            )
    return rows


def write(name: str, columns: Sequence[str], rows: Sequence[Sequence]) -> None:
    """A small table beside this file."""
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])


if __name__ == "__main__":
    main()
