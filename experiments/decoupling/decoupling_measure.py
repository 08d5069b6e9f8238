"""The 2 x 2 plant at one equilibrium: measured, linearised with averaged valves, and with the gains that u saw."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "arm2_interaction"))  # its valves

from valves import Plant, best_gains, replayed, valves  # noqa: E402

from loopshape.core.units import ComplexArray, deg  # noqa: E402
from loopshape.data.response.frf import FRF  # noqa: E402
from loopshape.data.signal.recording import Recording  # noqa: E402
from loopshape.data.signal.run import Run  # noqa: E402
from loopshape.identify.matrix.matrix import estimate_matrix  # noqa: E402
from loopshape.toolbox.arm.arm1 import Arm1  # noqa: E402
from loopshape.toolbox.arm.dynamics.equilibrium import pressures  # noqa: E402
from loopshape.toolbox.arm.dynamics.linear import Linearisation, linearise  # noqa: E402
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants  # noqa: E402
from loopshape.toolbox.arm.source import value  # noqa: E402
from loopshape.toolbox.diagrams.coupling.interaction import interaction  # noqa: E402
from loopshape.toolbox.diagrams.coupling.nouns import Interaction  # noqa: E402
from loopshape.toolbox.rig.simulated import header, measure  # noqa: E402
from loopshape.toolbox.rig.study import Study  # noqa: E402

LOOPS = ("theta2", "p_ab")
LIMIT_DB = value("figure_h_7.interaction")
ENTRY, OUTPUTS = np.eye(4)[:, 2:], np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
DECOUPLING = np.array([[1.0, 1.0], [-1.0, 1.0]])
PWM_TICKS = 20


@dataclass(frozen=True, eq=False)
class Found:
    """One equilibrium; `gains` (2, 2) are from u to the muscles' rates in bar/s per V as the commands saw them."""

    theta2_deg: float
    p_ab_bar: float
    supply_bar: float
    frf: FRF
    met: Interaction
    bands_hz: dict[str, tuple[float, float]]
    lin: Linearisation
    bare: ComplexArray
    replay: ComplexArray
    gains: np.ndarray
    pressures_bar: tuple[float, float]

    @property
    def where(self) -> tuple[float, float]:
        """Angle in deg and p_AB in bar."""
        return self.theta2_deg, self.p_ab_bar

    @property
    def mode_hz(self) -> float:
        """The linearised mode."""
        return self.lin.third_order()[1]


def at_one_point(study: Study) -> list[Study]:
    """The study cut into one for each equilibrium."""
    cut = []
    for e in study.experiments:
        for point in study.operating_points if e.operating_points is None else e.operating_points:
            if point not in cut:
                cut.append(point)
    return [_only(study, point) for point in sorted(cut, key=lambda p: (p["p_ab_bar"], p["theta2_deg"]))]


def _only(study: Study, point: object) -> Study:
    mine = [
        replace(e, operating_points=None)
        for e in study.experiments
        if point in (study.operating_points if e.operating_points is None else e.operating_points)
    ]
    return replace(study, operating_points=(point,), experiments=tuple(mine))  # type: ignore[arg-type]


def bands(settings: Mapping[str, Any], mode_hz: float) -> dict[str, tuple[float, float]]:
    """The bands looked at, in Hz: the source's bandwidth, its range of H.7, the mode, and beside them."""
    low, high = value("table_5_1.bandwidth_low"), value("table_5_1.bandwidth_high")
    lowest, within = float(settings["lowest_hz"]), float(settings["mode_within"])
    return {
        "below": (lowest, low),
        "bandwidth": (low, high),
        "range of H.7": (lowest, value("figure_h_7.up_to")),
        "mode": ((1.0 - within) * mode_hz, (1.0 + within) * mode_hz),
        "above": (float(settings["high_hz"][0]), float(settings["high_hz"][1])),
    }


def found_at(study: Study, settings: Mapping[str, Any]) -> Found:
    """Measure and estimate the 2 x 2 plant of a study of one equilibrium."""
    arm = Arm1()
    run, recordings = header(study, arm), list(measure(study, arm))
    early = [r.info.name for r in recordings if r.info.ended_early]
    if early:
        raise SystemExit(f"{study.operating_points[0]}: {', '.join(early)} ended early")
    return analysed(run, recordings, settings, dict(study.changes))


def analysed(
    run: Run, recordings: Sequence[Recording], settings: Mapping[str, Any], changes: dict[str, float]
) -> Found:
    """The matrix and its interaction, and both linear plants on its lines."""
    point, changes = recordings[0].info.operating_point, changes | dict(recordings[0].info.parameters)
    frf = estimate_matrix(run, recordings)
    known = {loop.name: loop.controller for loop in run.loops if loop.controller}
    numbers, f = constants(ARM1_PARAMETERS.vector(changes)), frf.frequency_hz
    lin = linearise(numbers, **point)
    wanted = bands(settings, lin.third_order()[1])
    met = interaction(frf, LOOPS, known, bands=tuple(wanted.values()), limit_db=LIMIT_DB)
    supply = float(changes.get("supply_bar", 1.0))
    stood = linearise(numbers, *stood_at(recordings))
    law = valves(stood.fill, stood.exhaust, pressures(numbers, *stood_at(recordings)), supply)
    replay = replayed(run, recordings, LOOPS, Plant(stood.dynamics, ENTRY, OUTPUTS, DECOUPLING), law, f, "ab")
    u = np.concatenate([np.stack([r.column(c)[::PWM_TICKS] for c in ("u_a_v", "u_b_v")], axis=1) for r in recordings])
    where = point["theta2_deg"], point["p_ab_bar"]
    seen, pair = best_gains(law, u), pressures(numbers, *where)
    return Found(*where, supply, frf, met, wanted, lin, lin.response(f), replay, seen, pair)


def stood_at(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Mean angle in deg and p_AB in bar."""
    theta = float(deg(np.mean([r.column("theta2_rad").mean() for r in recordings])))
    return theta, float(np.mean([(r.column("p_a_bar") + r.column("p_b_bar")).mean() for r in recordings]))


def coefficient(P: ComplexArray) -> ComplexArray:
    """k_I (nf,) of a plant (nf, 2, 2)."""
    return np.asarray(P[:, 0, 1] * P[:, 1, 0] / (P[:, 0, 0] * P[:, 1, 1]))
