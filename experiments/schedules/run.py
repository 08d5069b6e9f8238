"""Schedules the arm's angle controller over angle and pressure, checks it on a dense grid, and moves through it."""

from __future__ import annotations

import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np

import loopshape as ls
from loopshape.core.units import deg
from loopshape.io.files import write_bytes_whole
from loopshape.io.requirements import read_requirements
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import header, measure
from loopshape.toolbox.rig.study import expanded
from loopshape.view.style import png

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE))
from picture import gain_scheduled_page  # noqa: E402
from tables import write  # noqa: E402

SETTINGS = tomllib.loads((HERE / "settings.toml").read_text(encoding="utf-8"))
Place = tuple[float, float]


def main() -> None:
    """Measure and tune the nodes, check each frozen point of nodes and cells on draws of its own, move."""
    places = tuple(product(SETTINGS["theta2_deg"], SETTINGS["p_ab_bar"]))
    cells = tuple(product(middles(SETTINGS["theta2_deg"]), middles(SETTINGS["p_ab_bar"])))
    first = measured(places)
    (asked,) = read_requirements(HERE / "requirements.toml")
    wanted = asked.moved(SETTINGS["room"])
    nodes = {place: tuned(place, first, wanted) for place in places}
    points = [{"theta2_deg": t, "p_ab_bar": p} for t, p in nodes]
    follows = {"theta2_deg": "theta2", "p_ab_bar": "p_ab"}
    scheduled = ls.schedules.gain_scheduled(list(nodes.values()), points, follows, lag_s=SETTINGS["lag_s"])
    robust = ls.tune(list(first.values()), wanted, starts=SETTINGS["starts"]).controller
    ls.write(scheduled, HERE / "controller.toml")
    plants = measured((*places, *cells), **SETTINGS["checked"])
    verdicts = {
        name: ls.check(list(plants.values()), C, asked) for name, C in (("scheduled", scheduled), ("robust", robust))
    }
    write(HERE / "points.csv", point_rows(plants, nodes, verdicts))
    write(HERE / "summary.csv", summary_rows(plants, nodes, verdicts, {"scheduled": scheduled, "robust": robust}))
    known = {plant.recording: dict(plant.operating_point) for plant in plants.values()}
    figure = gain_scheduled_page(scheduled, verdicts["scheduled"], known)
    write_bytes_whole(ROOT / "figures" / "schedules" / "schedule.png", png(figure))


def middles(values: Sequence[float]) -> list[float]:
    """The middle of every two neighbours."""
    return [0.5 * (a + b) for a, b in pairwise(values)]


def measured(places: Sequence[Place], realisations: int = 1, seed: int | None = None) -> dict[Place, ls.FRF]:
    """The angle's FRF at each place, from a draw of the multisine's phases or several; `seed` of them and the noise."""
    points = tuple({"theta2_deg": t, "p_ab_bar": p} for t, p in places)
    study = read_study(HERE / "identify.toml")
    (one,) = study.experiments
    if seed is not None:
        one = replace(one, excitation=replace(one.excitation, seed=seed))  # type: ignore[type-var]
    study = replace(study, operating_points=points, seed=seed or study.seed, experiments=expanded(one, realisations))
    arm = Arm1()
    run = replace(header(study, arm), recordings=tuple(measure(study, arm, threads=1)))
    frfs = ls.frfs(run, "theta2", realisations=True)
    return {(f.operating_point["theta2_deg"], f.operating_point["p_ab_bar"]): f for f in frfs}


def tuned(place: Place, plants: dict[Place, ls.FRF], asked: ls.Requirements) -> ls.Controller:
    """The node's controller, tuned on its own plant; -theta2 has that of theta2."""
    at = (abs(place[0]), place[1])
    if at not in CACHE:
        found = ls.tune(plants[at], asked, starts=SETTINGS["starts"])
        CACHE[at] = found.controller
        print(at, f"{found.bandwidth_hz:.3g} Hz, {found.verdict.outcome}", flush=True)
    return CACHE[at]


CACHE: dict[Place, ls.Controller] = {}


def point_rows(
    plants: dict[Place, ls.FRF], nodes: Iterable[Place], verdicts: dict[str, ls.Verdict]
) -> Iterable[Sequence[object]]:
    """Each frozen operating point under both controllers."""
    yield ("theta2_deg", "p_ab_bar", "node", "controller", "bandwidth_hz", "phase_margin_deg", "sensitivity_peak_db",
           "gain_margin_db", "stable")  # fmt: skip
    known = set(nodes)
    for (place, plant), (name, verdict) in product(plants.items(), verdicts.items()):
        m = verdict.margins[plant.recording]
        yield (*place, place in known, name, m.bandwidth_hz, m.phase_margin_deg, m.sensitivity_peak_db,
               m.gain_margin_db, m.stable)  # fmt: skip


def summary_rows(
    plants: dict[Place, ls.FRF],
    nodes: Iterable[Place],
    verdicts: dict[str, ls.Verdict],
    controllers: dict[str, ls.Controller | ls.schedules.GainScheduled],
) -> Iterable[Sequence[object]]:
    """Lowest bandwidth and worst margins over the grid, and what the move showed."""
    yield ("controller", "outcome", "lowest_hz", "lowest_at_nodes_hz", "worst_peak_db", "worst_phase_deg",
           "moving_rms_deg", "moving_largest_deg", "resting_rms_deg", "largest_z_v", "ended_early")  # fmt: skip
    known = {plants[x].recording for x in nodes}
    for name, verdict in verdicts.items():
        every = verdict.margins
        yield (
            name, verdict.outcome, min(m.bandwidth_hz for m in every.values()),
            min(m.bandwidth_hz for k, m in every.items() if k in known),
            max(m.sensitivity_peak_db for m in every.values()), min(m.phase_margin_deg for m in every.values()),
            *moved(controllers[name]),
        )  # fmt: skip


def moved(controller: ls.Controller | ls.schedules.GainScheduled) -> tuple[object, ...]:
    """Error while moving and in the last three seconds at rest, degrees; largest z in V; why it ended early."""
    folder = Path(tempfile.mkdtemp())
    try:
        (pressure,) = [c for c in ls.read_controllers(ROOT / "examples/arm/controller.toml") if c.loop == "p_ab"]
        run = ls.rig.measure(HERE / "move.toml", folder / "run", controllers=[controller, pressure])
        r = run.recordings[0]
        error = deg(r.column("r_theta2_rad") - r.column("theta2_rad"))
        rest = error[-3000:]
        rms = [float(np.sqrt(np.mean(x**2))) for x in (error[2000:], rest - rest.mean())]
        return (
            rms[0],
            float(np.abs(error).max()),
            rms[1],
            float(np.abs(r.column("z_theta2_v")).max()),
            r.info.ended_early,
        )
    finally:
        shutil.rmtree(folder)


if __name__ == "__main__":
    sys.exit(main())
