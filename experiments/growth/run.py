"""What a structure that grows gains under the shipped requirements: arm, motor bench, 24 FRFs; and its peers."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import differential_evolution

from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.design.problem.problem import Problem
from loopshape.design.problem.shifts import copies_for
from loopshape.design.search import LARGEST, initial_point, search
from loopshape.design.stage import Task
from loopshape.design.tune import Search, Tuning, tune
from loopshape.io.files import write_bytes_whole
from loopshape.io.requirements import read_requirements
from loopshape.loop.loops import loops_of
from loopshape.loop.verdict import check
from loopshape.toolbox.limits.growth import library
from loopshape.view.style import new_figure, png, styled

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE), str(HERE.parent / "how_far"), str(HERE.parent / "detuning")]
from arm_frfs import EXAMPLES, measured  # noqa: E402
from bench_frf import motor_bench  # noqa: E402
from convex_concave import convex_concave  # noqa: E402

COLUMNS = (
    "case", "added", "bandwidth_hz", "control_peak_db", "detuning_percent", "order", "outcome", "seconds_in_all",
)  # fmt: skip
PEERS = ("case", "how", "bandwidth_hz", "passes", "seconds")
#: blocks that may be added
GROW = {"arm (0, 1.0)": 3, "arm (0, 1.8)": 3, "motor bench": 3, "motor bench, 2 % detuning": 4, "24 FRFs": 2}
#: convex-concave programmes are for so many plants at most: with 24 they came to rest where they began, in 10 min
MOST = 3
#: what convex-concave programmes keep back of each limit: they do not know the FRF's error
KEPT_BACK_DB = (0.1, 0.3, 0.5)
#: what the issue asks for and what a convex design reaches, in Hz
MUST = {"arm (0, 1.0)": 3.8, "arm (0, 1.8)": 2.05, "motor bench, 2 % detuning": 60.0, "24 FRFs": 0.65}

Case = tuple[Sequence[FRF], Sequence[Fit], Requirements]


def main() -> None:
    """Grow each case (or those that are named), compare with peers, draw; two tables and a figure."""
    chosen = argparse.ArgumentParser()
    chosen.add_argument("case", nargs="*", default=list(GROW))
    steps, peers = _known("steps.csv"), _known("peers.csv")
    for name in chosen.parse_args().case:
        case = cases(name)
        rows, grown = grow(name, case)
        steps = [row for row in steps if row[0] != name] + rows
        peers = [row for row in peers if row[0] != name] + list(peers_of(name, case, grown))
        _write("steps.csv", COLUMNS, steps)
        _write("peers.csv", PEERS, peers)
    write_bytes_whole(ROOT / "figures" / "growth" / "fronts.png", png(fronts(steps)))


def cases(name: str) -> Case:
    """FRFs, fits and requirements of a case."""
    if name.startswith("motor bench"):
        frfs, fits, asked = motor_bench()
        return frfs, fits, replace(asked, detuning_percent=2.0 if "2 %" in name else None)
    frfs, fits = measured()
    asked = read_requirements(EXAMPLES / "requirements.toml")[0]
    points = {"arm (0, 1.0)": "angle-08", "arm (0, 1.8)": "angle-20"}
    mine = [k for k, frf in enumerate(frfs) if name not in points or frf.recording == points[name]]
    return [frfs[k] for k in mine], [fits[k] for k in mine], asked


def grow(name: str, case: Case) -> tuple[list[list[str]], Tuning]:
    """The rows of a case's growth and what it ends at."""
    begun = time.process_time()
    found = tune(case[0], case[2], case[1], explain=False, search=Search(grow=GROW[name]))
    seconds = time.process_time() - begun
    rows = [
        [
            name,
            g.added,
            *(f"{x:.4g}" for x in (g.bandwidth_hz, g.control_peak_db, g.detuning_percent)),
            str(g.order),
            g.outcome,
            f"{seconds:.0f}",
        ]
        for g in found.growth
    ]
    for row in rows:
        print("  ".join(row), flush=True)
    return rows, found


def peers_of(name: str, case: Case, grown: Tuning) -> Iterator[list[str]]:
    """Convex-concave programmes of as many poles; on one plant the grown structure by differential evolution too.

    What differential evolution ends at is told alone, and finished by this tuner's search.
    """
    frfs, fits, asked = case
    loops, _ = loops_of(frfs, replace(grown.controller, blocks=grown.controller.blocks[:1]), asked, fits)
    kinds = {template.kind: template for template in library(loops)}
    structure = (*asked.structure, *(kinds[one.kind] for one in grown.controller.blocks[len(asked.structure) :]))
    asked = replace(asked, structure=structure)
    unit = replace(grown.controller, blocks=loops[0].controller.blocks)
    task = Task(tuple(frfs), tuple(fits), asked, tuple(loops), (), unit, "double")
    p, _ = task.problem(copies_for(asked, len(loops)), asked)
    if len(frfs) == 1 and asked.detuning_percent is None:
        yield from _evolved(name, case, p)
    if p.points <= MOST:
        yield _convex_concave(name, case, p, grown)


def _evolved(name: str, case: Case, p: Problem) -> Iterator[list[str]]:
    begun = time.process_time()
    bounds = list(zip(p.low, p.high, strict=True))

    def merit(x: np.ndarray) -> float:
        value = LARGEST.merit(initial_point(p, x).measures)
        return value if np.isfinite(value) else 1e3

    best = differential_evolution(merit, bounds, maxiter=60, popsize=12, seed=0, polish=False)
    yield _peer(name, "differential evolution", case, p, best.x, begun)
    finished = search(p, initial_point(p, best.x), LARGEST, 300)
    yield _peer(name, "differential evolution, then this search", case, p, finished.x, begun)


def _convex_concave(name: str, case: Case, p: Problem, grown: Tuning) -> list[str]:
    """Convex-concave programmes for as many poles, from the first structure tuned: the best that passes."""
    frfs, fits, asked = case
    begun = time.process_time()
    start = tune(frfs, asked, fits, explain=False).controller
    found = [convex_concave(p, asked, start, grown.controller.order(), back_db) for back_db in KEPT_BACK_DB]
    verdicts = [check(frfs, C, asked, fits) for C in found]
    best = max(verdicts, key=lambda one: (one.passed, _lowest(one)))
    return _row(name, "convex-concave", _lowest(best), best, begun)


def _peer(name: str, how: str, case: Case, p: Problem, x: np.ndarray, begun: float) -> list[str]:
    frfs, fits, asked = case
    verdict = check(frfs, p.controller(x), asked, fits)
    read = min(float(np.exp(initial_point(p, x).measures.ln_bandwidth.min())), _lowest(verdict))
    return _row(name, how, read, verdict, begun)


def _lowest(verdict: Verdict) -> float:
    return min(m.bandwidth_hz for m in verdict.margins.values())


def _row(name: str, how: str, bandwidth_hz: float, verdict: Verdict, begun: float) -> list[str]:
    row = [name, how, f"{bandwidth_hz:.4g}", verdict.outcome.value, f"{time.process_time() - begun:.0f}"]
    print("  ".join(row), flush=True)
    return row


@styled()
def fronts(rows: Sequence[Sequence[str]]) -> Figure:
    """Bandwidth over that of the first structure, against the controller's order, |CS| and the detuning margin."""
    figure = new_figure(1, 3, (7.0, 3.4), sharey=True)
    left, middle, right = figure.axes
    for name in dict.fromkeys(row[0] for row in rows):
        mine = [row for row in rows if row[0] == name]
        gain = np.array([float(row[2]) for row in mine]) / float(mine[0][2])
        left.plot([int(row[5]) for row in mine], gain, "o-", label=name)
        middle.plot([float(row[3]) for row in mine], gain, "o-")
        right.semilogx([float(row[4]) for row in mine], gain, "o-")
    left.set(xlabel="order of C", ylabel="bandwidth / that of the first structure", title="bandwidth over order")
    middle.set(xlabel="peak |CS| [dB]", title="over control effort")
    right.set(xlabel="detuning margin [%]", title="over detuning margin")
    right.set_xticks([0.05, 0.2, 1.0, 3.0], ["0.05", "0.2", "1", "3"])
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _known(name: str) -> list[list[str]]:
    path = HERE / name
    return list(csv.reader(path.read_text().splitlines()))[1:] if path.exists() else []


def _write(name: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])


if __name__ == "__main__":
    main()
