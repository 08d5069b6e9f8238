"""How often an FRF's interval holds what 64 other draws say, from one draw and from four, and what each decides."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import f as f_distribution

import loopshape as ls
from loopshape.identify.frequency_response import estimate_realisations, estimate_together
from loopshape.identify.settings import Settings
from loopshape.io.requirements import read_requirements
from loopshape.loop.loops import loops_of
from loopshape.loop.stability.stability import closed_loop_stability
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import header, measure
from loopshape.toolbox.rig.study import expanded

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
from tables import write  # noqa: E402

#: operating points (deg, bar) where one draw left stability undecided
POINTS = ((0.0, 0.8), (7.5, 1.1), (30.0, 0.9))
#: half of the draws are the truth
DRAWS, SEED = 128, 1001
#: times the controller's gain, in dB: its gain margin lies among them
GAINS_DB = (0.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0)
BAND_HZ = (1.0, 8.0)


def main() -> None:
    """Draws at each point, coverage and outcomes of one and of four, beside what the other half says together."""
    titles = ("theta2_deg", "p_ab_bar", "draws", "frfs", "lines_within_95", "gain_db", "truth", "stable", "unstable",
              "undecided")  # fmt: skip
    write(HERE / "draws.csv", [titles, *(row for point in POINTS for row in rows(*point))])


def recordings(theta2_deg: float, p_ab_bar: float) -> tuple[ls.Run, Sequence[object]]:
    """`DRAWS` recordings at a point, each with phases and noise of its own."""
    study = read_study(HERE / "identify.toml")
    (one,) = study.experiments
    one = replace(one, excitation=replace(one.excitation, seed=SEED))  # type: ignore[type-var]
    point = {"theta2_deg": theta2_deg, "p_ab_bar": p_ab_bar}
    study = replace(study, operating_points=(point,), seed=SEED, experiments=expanded(one, DRAWS))
    arm = Arm1()
    return header(study, arm), tuple(measure(study, arm, threads=1))


def rows(theta2_deg: float, p_ab_bar: float) -> Iterable[Sequence[object]]:
    """For one draw and for four: share of lines within their 95 %, and outcomes at each gain beside the truth."""
    run, made = recordings(theta2_deg, p_ab_bar)
    loop = run.loop("theta2")
    half = DRAWS // 2
    truth = estimate_realisations(made[half:], loop)  # type: ignore[arg-type]
    (schedule,) = ls.schedules.read_gain_scheduled(HERE / "controller.toml")
    C = schedule.at(truth.operating_point)
    (asked,) = read_requirements(HERE / "requirements.toml")
    for size in (1, 4):
        groups = [made[k : k + size] for k in range(0, half, size)]
        frfs = [estimate_together(g, loop, Settings()) for g in groups]  # type: ignore[arg-type]
        share = float(np.mean([within(f, truth) for f in frfs]))
        for gain_db in GAINS_DB:
            louder = scaled(C, gain_db)
            found = Counter(outcome(f, louder, asked) for f in frfs)
            words = (found[word] for word in ("stable", "unstable", "undecided"))
            yield theta2_deg, p_ab_bar, size, len(frfs), share, gain_db, outcome(truth, louder, asked), *words


def within(frf: ls.FRF, truth: ls.FRF) -> float:
    """Share of the valid lines in the band whose 95 % circle holds the truth, its own error included."""
    f = frf.frequency_hz
    used = frf.valid & (f >= BAND_HZ[0]) & (f <= BAND_HZ[1])
    off = np.abs(frf.siso - truth.siso[np.searchsorted(truth.frequency_hz, f)])[used] ** 2
    reach = f_distribution.isf(0.05, 2, min(frf.variance_freedom, 1e9))
    variance = frf.variance[used, 0, 0] + truth.variance[np.searchsorted(truth.frequency_hz, f), 0, 0][used]
    return float(np.mean(off < reach * variance))


def outcome(frf: ls.FRF, C: ls.Controller, asked: ls.Requirements) -> str:
    """What the count says of stability."""
    (loop,), _ = loops_of([frf], C, asked)
    return closed_loop_stability(loop).outcome


def scaled(C: ls.Controller, gain_db: float) -> ls.Controller:
    """The controller with another gain."""
    first, *rest = C.blocks
    louder = replace(first, parameters={"gain": first.parameters["gain"] * 10.0 ** (gain_db / 20.0)})
    return replace(C, blocks=(louder, *rest))


if __name__ == "__main__":
    sys.exit(main())
