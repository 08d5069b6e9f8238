"""Both joints' controllers scheduled over p_C behind the constant matrix, checked frozen and moved, against one."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import loopshape as ls
from loopshape.core.units import deg
from loopshape.data.control.block import BlockTemplate
from loopshape.data.control.controller import Controller
from loopshape.io.requirements import read_requirements
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import header, measure
from loopshape.toolbox.schedules.gain_scheduled import GainScheduled

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from run import ARM, MATRIX_HZ, STARTS, WHOLE, Weights, largest, rms, write  # noqa: E402

#: nodes, and what lies between them; the matrix is found at the middle node
NODES_BAR, BETWEEN_BAR = (0.4, 0.6, 0.8), (0.5, 0.7)
#: limits are closer by this for the tuner than for the check
ROOM = {"sensitivity_peak_db": -0.5, "phase_margin_deg": 3.0, "gain_margin_db": 0.5}
Set = Sequence[Controller | GainScheduled]


def main() -> None:
    """Measure behind the middle's matrix, tune the nodes and one for all, check each frozen point, move."""
    (middle,) = measured(NODES_BAR[1:2], {})
    W = ls.diagrams.decouple(middle, MATRIX_HZ).weights
    plants = measured((*NODES_BAR, *BETWEEN_BAR), W)
    at_nodes = plants[: len(NODES_BAR)]
    own = ARM.default_controllers(1000.0)
    nodes = [tuned([P], own) for P in at_nodes]
    scheduled = [over_p_c([node[k] for node in nodes]) for k in range(2)]
    sets: dict[str, Set] = {"scheduled": [*scheduled, *own[2:]], "one": tuned(at_nodes, own)}
    write("points.csv", point_rows(plants, sets, own))
    write("scheduled_moves.csv", move_rows(sets, W))


def measured(p_c_bar: Sequence[float], weights: Weights) -> tuple[ls.FRF, ...]:
    """The 4 x 4 plants at these p_C."""
    study = read_study(HERE / "identify.toml")
    points = tuple({**study.operating_points[0], "p_c_bar": p} for p in p_c_bar)
    study = replace(study, operating_points=points, decoupling=weights)
    run = replace(header(study, ARM), recordings=tuple(measure(study, ARM, threads=1)))
    return ls.frf_matrices(run)


def tuned(plants: Sequence[ls.FRF], own: Sequence[Controller]) -> tuple[Controller, ...]:
    """Both joints' controllers for these plants."""
    found = ls.tune(plants, asked_of_nodes(), start=own, together=WHOLE, recorded_under=own, starts=STARTS)
    print([f"{t.loop} {t.tuning.bandwidth_hz:.3g} Hz {t.tuning.outcome}" for t in found.turns[-2:]], flush=True)
    return found.controllers


def asked_of_nodes() -> list[ls.Requirements]:
    """The study's requirements with room for what lies between, and the lead-lag of `run.py`'s controllers for all."""
    found = {C.loop: C for C in ls.read_controllers(HERE / "tuned_behind_the_matrix.toml")}
    asked = []
    for one in read_requirements(HERE / "requirements.toml"):
        pairs = zip(found[one.loop].blocks, one.structure, strict=True)
        kept = tuple(BlockTemplate(b.kind, b.parameters) if b.kind == "lead_lag" else t for b, t in pairs)
        asked.append(replace(one.moved(ROOM), structure=kept))
    return asked


def over_p_c(nodes: Sequence[Controller]) -> GainScheduled:
    """A schedule that follows p_C's reference."""
    return ls.schedules.gain_scheduled(list(nodes), [{"p_c_bar": p} for p in NODES_BAR], {"p_c_bar": "p_c"})


def frozen(controllers: Set, P: ls.FRF) -> list[Controller]:
    """What runs at a plant's operating point."""
    return [C.at(P.operating_point) if isinstance(C, GainScheduled) else C for C in controllers]


def point_rows(
    plants: Sequence[ls.FRF], sets: Mapping[str, Set], own: Sequence[Controller]
) -> Iterable[Sequence[object]]:
    """Each frozen operating point: both joints, and all loops at once."""
    yield ("controllers", "p_c_bar", "loop", "outcome", "stable", "bandwidth_hz", "sensitivity_peak_db",
           "phase_margin_deg", "disk_margin", "reason")  # fmt: skip
    asked = read_requirements(HERE / "requirements.toml")
    for name, C in sets.items():
        for P in plants:
            v = ls.check([P], frozen(C, P), asked, together=WHOLE, recorded_under=own)
            p_c, (all_,) = P.operating_point["p_c_bar"], v.margins.values()
            for each in v.each[:2]:
                (m,) = each.margins.values()
                yield (name, p_c, each.loop, each.outcome, m.stable, m.bandwidth_hz, m.sensitivity_peak_db,
                       m.phase_margin_deg)  # fmt: skip
            yield (
                name,
                p_c,
                "all",
                v.parts[-1].outcome,
                all_.stable,
                "",
                "",
                "",
                all_.disk_margin,
                all_.stability_reason,
            )


def move_rows(sets: Mapping[str, Set], weights: Weights) -> Iterable[Sequence[object]]:
    """Errors in degrees while both joints move and p_C goes up and down through the nodes."""
    yield ("controllers", "theta1_rms_deg", "theta1_largest_deg", "theta2_rms_deg", "theta2_largest_deg",
           "theta1_rest_deg", "theta2_rest_deg", "ended_early")  # fmt: skip
    for name, C in sets.items():
        plain = {one.loop: one.blocks for one in C if isinstance(one, Controller)}
        schedules = {one.loop: one for one in C if isinstance(one, GainScheduled)}
        study = read_study(HERE / "move_scheduled.toml")
        study = replace(study, controllers=plain, schedules=schedules, decoupling=weights)
        (r,) = measure(study, ARM, threads=1)
        errors = [deg(r.column(f"r_{j}_rad") - r.column(f"{j}_rad")) for j in ("theta1", "theta2")]
        seen = [f(e[2000:]) for e in errors for f in (rms, largest)]
        yield name, *seen, *(rms(e[-2000:]) for e in errors), r.info.ended_early


if __name__ == "__main__":
    sys.exit(main())
