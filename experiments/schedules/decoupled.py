"""A constant matrix where joint and pressure are coupled, run on the arm, and k_I measured again."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import loopshape as ls
from loopshape.io.requirements import read_requirements
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.diagrams.coupling.interaction import interaction
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import header, measure

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE))
from tables import write  # noqa: E402

#: theta2 in deg and p_AB in bar where `experiments/decoupling` found the loops coupled
POINTS = ((15.0, 1.4), (30.0, 1.2))
#: larger than the 0.1 V of `experiments/decoupling`, with which a command stays in the dead zone behind the matrix
AMPLITUDE_V, DRAWS = 0.3, 4
BANDS_HZ = ((1.0, 3.0), (3.0, 6.0))
#: a matrix, and filters of these orders
ORDERS = (0, 1, 2, 3)


def main() -> None:
    """Measure, decouple, run behind the matrix, measure again; check the loops together before and after."""
    write(HERE / "decoupled.csv", rows())


def rows() -> Iterable[Sequence[object]]:
    """k_I with its 95 % in each band, and the loops together: without the matrix, as predicted, and as run."""
    yield ("theta2_deg", "p_ab_bar", "what", "w12", "w12_95", "w21", "w21_95", "band_hz", "k_i_db", "low_db", "high_db",
           "judged", "stable", "disk_margin", "theta2_hz", "p_ab_hz")  # fmt: skip
    for theta, p in POINTS:
        before = plant(theta, p, 9)
        W = ls.diagrams.decouple(before, BANDS_HZ[0])
        after = plant(theta, p, 10, W.weights)
        print(theta, p, W, flush=True)
        for what, P in (("without", before), ("predicted", W.applied(before)), ("run behind it", after)):
            told: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0) if what == "without" else matrix_words(W)
            yield from ((theta, p, what, *told, *x, *together(P)) for x in coupled(P))
        fresh = plant(theta, p, 11)
        for order in ORDERS:
            P = ls.diagrams.decouple(before, (BANDS_HZ[0][0], BANDS_HZ[-1][1]), order).applied(fresh)
            what = f"behind order {order} of both bands on another recording"
            yield from ((theta, p, what, 0.0, 0.0, 0.0, 0.0, *x, *together(P)) for x in coupled(P))


def matrix_words(W: object) -> tuple[float, ...]:
    """w12 and w21, each with half its 95 % interval."""
    m, s = W.matrix, 1.96 * W.std  # type: ignore[attr-defined]
    return float(m[0, 1]), float(s[0, 1]), float(m[1, 0]), float(s[1, 0])


def plant(theta: float, p: float, seed: int, decoupling: Mapping[str, Mapping[str, float]] | None = None) -> ls.FRF:
    """The plant of both loops at one operating point, from the recordings of `experiments/decoupling`, four draws."""
    study = read_study(ROOT / "experiments" / "decoupling" / "study.toml")
    given = [e for e in study.experiments if e.operating_points is None and int(e.name[-1]) <= DRAWS]
    mine = tuple(replace(e, excitation=replace(e.excitation, amplitude=AMPLITUDE_V)) for e in given)  # type: ignore[type-var]
    point = {"theta2_deg": theta, "p_ab_bar": p}
    study = replace(study, experiments=mine, operating_points=(point,), seed=seed, decoupling=decoupling or {})
    arm = Arm1()
    run = replace(header(study, arm), recordings=tuple(measure(study, arm, threads=1)))
    return ls.frf_matrices(run)[0]


def coupled(P: ls.FRF) -> Iterable[tuple[object, ...]]:
    """The largest |k_I| of each band with its interval, and the verdict."""
    for v in interaction(P, bands=BANDS_HZ).verdicts:
        yield f"{v.band_hz[0]:g}-{v.band_hz[1]:g}", v.estimate_db, v.low_db, v.high_db, v.verdict


def together(P: ls.FRF) -> tuple[object, ...]:
    """Both loops under the example's controllers, closed at once."""
    C = ls.read_controllers(ROOT / "examples/arm/controller.toml")
    asked = read_requirements(ROOT / "examples/arm/requirements.toml")
    R = [replace(one, structure=()) for one in asked]
    v = ls.check([P], C, R, together=ls.Requirements(integrators=2, unstable_poles=0))
    (m,) = v.margins.values()
    each = {one.loop: next(iter(one.margins.values())).bandwidth_hz for one in v.each}
    return m.stable, m.disk_margin, each["theta2"], each["p_ab"]


if __name__ == "__main__":
    np.seterr(all="ignore")
    sys.exit(main())
