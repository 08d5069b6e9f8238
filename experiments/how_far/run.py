"""How far the arm's tuned controller is from the best possible, and what one controller for 24 equilibria costs."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from loopshape.core.units import TWO_PI, ComplexArray
from loopshape.data.control.block import BlockTemplate
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.design.tune import tune
from loopshape.io.files import write_bytes_whole
from loopshape.io.requirements import read_requirements
from loopshape.loop.loop import Loop
from loopshape.loop.loops import loops_of
from loopshape.loop.verdict import check
from loopshape.toolbox.limits import bound as bound_module
from loopshape.toolbox.limits import bound_regions
from loopshape.toolbox.limits.bound import bound, excluded
from loopshape.toolbox.limits.bound_reach import achieved
from loopshape.toolbox.schedules.picture import schedule_page
from loopshape.toolbox.schedules.schedule import schedule
from loopshape.view.style import png

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
sys.path.insert(0, str(HERE))
from arm_frfs import EXAMPLES, measured, write  # noqa: E402

FREE_NOTCH = {
    "kind": "notch",
    "f1_hz": {"min": 1.0, "max": 15.0},
    "f2_hz": {"min": 1.0, "max": 25.0},
    "damping1": {"min": 0.01, "max": 2.0},
    "damping2": {"min": 0.05, "max": 10.0},
}


def main() -> None:
    """Measure, tune, bound, schedule, and see how the bound settles; three tables and a figure."""
    frfs, fits = measured()
    asked = read_requirements(EXAMPLES / "requirements.toml")[0]
    robust = tune(frfs, asked, fits).controller
    found = schedule(frfs, asked, robust, fits, step=print)
    columns = ("recording", "theta2_deg", "p_ab_bar", "own_hz", "robust_hz", "cost_hz", "ratio", "bound_hz")
    write(HERE / "results.csv", (*columns, "own_to_bound"), (
        (p.recording, *p.operating_point.values(), p.own_hz, p.robust_hz, p.cost_hz, p.ratio, p.bound_hz,
         p.own_hz / p.bound_hz)
        for p in found.points
    ))  # fmt: skip
    write_bytes_whole(ROOT / "figures" / "how_far" / "schedule.png", png(schedule_page(found)))
    columns = ("case", "robust_hz", "bound_hz", "ratio", "bound_by", "least_alone_hz", "reached_hz", "at")
    write(HERE / "together.csv", columns, cases(frfs, fits, asked))
    loops, _ = loops_of(frfs, robust, asked, fits)
    weakest = min(found.points, key=lambda p: p.bound_hz).recording
    write(HERE / "settling.csv", ("what", "setting", "hz"), settling(loops, asked, weakest))


def cases(frfs: list[FRF], fits: list[Fit], asked: Requirements) -> Iterable[tuple]:
    """One controller for all: of the example's structure and of a larger one, with and without what no bound counts."""
    larger = tuple(
        BlockTemplate.from_table(table)
        for table in (
            {"kind": "gain", "gain": {"min": 0.05, "max": 200.0}},
            {"kind": "lead_lag", "f1_hz": {"min": 0.1, "max": 30.0}, "f2_hz": {"min": 0.1, "max": 100.0}},
            FREE_NOTCH, FREE_NOTCH, FREE_NOTCH,
            {"kind": "low_pass", "order": 2, "f_hz": {"min": 3.0, "max": 100.0}, "damping": {"min": 0.1, "max": 1.5}},
        )
    )  # fmt: skip
    convex = replace(asked, phase_margin_deg=None, gain_margin_db=None)
    one = None
    for name, limits in (
        ("example", asked),
        ("example, limits of the bound", convex),
        ("three free notches", replace(asked, structure=larger)),
        ("three free notches, limits of the bound", replace(convex, structure=larger)),
    ):
        controller = tune(frfs, limits, fits).controller
        robust_hz = min(m.bandwidth_hz for m in check(frfs, controller, limits, fits).margins.values())
        one = one or bound(frfs, controller, limits, fits, step=print)  # the counted limits are the same in all
        ends = (one.together.recording, one.least_alone.bound_hz, one.reached.bandwidth_hz, one.reached.recording)
        yield name, robust_hz, one.bound_hz, robust_hz / one.bound_hz, *ends


def settling(loops: Sequence[Loop], asked: Requirements, weakest: str) -> Iterable[tuple]:
    """The bound of the weakest plant with more nodes, sides and test functions, and what more parameters reach."""
    loop = next(one for one in loops if one.plant.recording == weakest)
    for density in (4, 8, 16):
        yield "reached with poles a decade", density, achieved(loop, asked, bound_hz=4.0, density=density).bandwidth_hz
    usual = bound_module.WITHIN, bound_module.PAIRS, bound_regions.SIDES
    for within, pairs, sides in ((75, 12, 32), usual, (300, 24, 96), (300, 48, 96)):
        bound_module.WITHIN, bound_module.PAIRS = within, pairs
        bound_regions.SIDES, bound_regions.DIRECTIONS = sides, directions(sides)
        yield "excluded with nodes, pairs, sides", f"{within} {pairs} {sides}", excluded(loop, [loop], asked).bound_hz
    bound_module.WITHIN, bound_module.PAIRS = usual[:2]
    bound_regions.SIDES, bound_regions.DIRECTIONS = usual[2], directions(usual[2])


def directions(sides: int) -> ComplexArray:
    """Unit vectors."""
    return np.exp(1j * TWO_PI * np.arange(sides) / sides)


if __name__ == "__main__":
    main()
