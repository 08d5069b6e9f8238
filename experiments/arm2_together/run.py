"""Both joints of the 2-DoF arm tuned together, with and without a constant matrix, checked as one and moved."""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import loopshape as ls
from loopshape.core.units import deg
from loopshape.io.requirements import read_requirements
from loopshape.io.write.controllers import write_controllers
from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.diagrams.coupling.decouple import Decoupling
from loopshape.toolbox.diagrams.coupling.interaction import interaction
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import header, measure

HERE = Path(__file__).parent
ARM = Arm2()
BANDS_HZ = ((0.3, 1.0), (1.0, 1.6), (1.6, 2.8), (2.8, 4.0))
MATRIX_HZ = (0.4, 1.5)
STARTS = 2
#: of the whole plant: four muscles fill for ever, and nothing else grows (the linearisation's poles)
WHOLE = ls.Requirements(integrators=4, unstable_poles=0)
Weights = Mapping[str, Mapping[str, float]]


def main() -> None:
    """Measure, decouple, measure behind the matrix, tune both joints on either plant, check as one, move."""
    own = ARM.default_controllers(1000.0)
    P = plant({})
    W = ls.diagrams.decouple(P, MATRIX_HZ)
    behind = plant(W.weights)
    plants = {"without": P, "predicted": W.applied(P), "run behind it": behind}
    write("coupling.csv", coupling_rows(plants))
    write("matrix.csv", matrix_rows(W))
    sets = {
        "plant's own": (P, own, {}),
        "tuned": (P, tuned(P, own), {}),
        "plant's own behind the matrix": (behind, own, W.weights),
        "tuned behind the matrix": (behind, tuned(behind, own), W.weights),
    }
    write("loops.csv", loop_rows(sets, own))
    write("moves.csv", move_rows(sets))
    for name in ("tuned", "tuned behind the matrix"):
        write_controllers(HERE / f"{name.replace(' ', '_')}.toml", sets[name][1])


def plant(weights: Weights) -> ls.FRF:
    """The 4 x 4 plant from the recordings of `identify.toml`, behind a matrix where one is given."""
    study = replace(read_study(HERE / "identify.toml"), decoupling=weights)
    run = replace(header(study, ARM), recordings=tuple(measure(study, ARM, threads=1)))
    return ls.frf_matrices(run)[0]


def tuned(P: ls.FRF, own: Sequence[ls.Controller]) -> tuple[ls.Controller, ...]:
    """Both joints' controllers tuned in turn, each with all other loops closed; the pressures' stay."""
    asked = read_requirements(HERE / "requirements.toml")
    found = ls.tune([P], asked, start=own, together=WHOLE, recorded_under=own, starts=STARTS)
    for turn in found.turns:
        print(turn.round, turn.loop, f"{turn.tuning.bandwidth_hz:.3g} Hz, {turn.tuning.outcome}", flush=True)
    return found.controllers


def coupling_rows(plants: Mapping[str, ls.FRF]) -> Iterable[Sequence[object]]:
    """The largest |k_I| of each pair of loops in each band with its 95 %, and the verdict."""
    yield "plant", "loops", "band_hz", "verdict", "low_db", "k_i_db", "high_db", "lowest_valid_hz"
    for name, P in plants.items():
        lowest = float(P.frequency_hz[P.valid].min())
        for v in interaction(P, bands=BANDS_HZ).verdicts:
            yield (name, "+".join(v.loops), f"{v.band_hz[0]:g}-{v.band_hz[1]:g}", v.verdict, v.low_db, v.estimate_db,
                   v.high_db, lowest)  # fmt: skip


def matrix_rows(W: Decoupling) -> Iterable[Sequence[object]]:
    """What each loop's input gets of each controller, with half its 95 % interval."""
    yield "enters", "of", "weight", "reach_95"
    for i, j in np.ndindex(W.matrix.shape):
        yield W.loops[i], W.loops[j], float(W.matrix[i, j]), float(1.96 * W.std[i, j])


Sets = Mapping[str, tuple[ls.FRF, Sequence[ls.Controller], Weights]]


def loop_rows(sets: Sets, own: Sequence[ls.Controller]) -> Iterable[Sequence[object]]:
    """Each loop with the others closed, and all at once by the determinant and the structured singular value."""
    yield ("controllers", "loop", "outcome", "stable", "bandwidth_hz", "sensitivity_peak_db", "phase_margin_deg",
           "gain_margin_db", "disk_margin", "disk_low", "disk_high", "disk_reached", "reason")  # fmt: skip
    asked = read_requirements(HERE / "requirements.toml")
    for name, (P, C, _) in sets.items():
        v = ls.check([P], C, asked, together=WHOLE, recorded_under=own)
        for one in v.each:
            (m,) = one.margins.values()
            yield (name, one.loop, one.outcome, m.stable, m.bandwidth_hz, m.sensitivity_peak_db, m.phase_margin_deg,
                   m.gain_margin_db)  # fmt: skip
        (m,) = v.margins.values()
        ends = m.intervals["disk_margin"]
        yield (name, "all", v.parts[-1].outcome, m.stable, "", "", "", "", m.disk_margin, *ends,
               m.disk_margin_reached, m.stability_reason)  # fmt: skip


def move_rows(sets: Sets) -> Iterable[Sequence[object]]:
    """Errors of both angles in degrees while one joint moves, both do, and the pressures do."""
    yield ("controllers", "moves", "theta1_rms_deg", "theta1_largest_deg", "theta2_rms_deg", "theta2_largest_deg",
           "largest_u_v", "ended_early")  # fmt: skip
    for name, (_, C, weights) in sets.items():
        blocks = {one.loop: one.blocks for one in C}
        study = replace(read_study(HERE / "move.toml"), controllers=blocks, decoupling=weights)
        for r in measure(study, ARM, threads=1):
            errors = [deg(r.column(f"r_{j}_rad") - r.column(f"{j}_rad"))[2000:] for j in ("theta1", "theta2")]
            seen = [f(e) for e in errors for f in (rms, largest)]
            u = max(largest(r.column(f"u_{m}_v")) for m in "abcd")
            yield name, r.info.name, *seen, u, r.info.ended_early


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def largest(values: np.ndarray) -> float:
    """Largest size."""
    return float(np.abs(values).max())


def write(name: str, rows: Iterable[Sequence[object]]) -> None:
    """A table beside this file, numbers to four digits; printed too."""
    with (HERE / name).open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        for row in rows:
            cells = [f"{x:.4g}" if isinstance(x, float) else x for x in row]
            out.writerow(cells)
            print(*cells, flush=True)


if __name__ == "__main__":
    sys.exit(main())
