"""What standing a shift of the plant's frequencies costs: bandwidth against `detuning_percent`, arm and motor bench."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from loopshape.core.units import TWO_PI
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.design.tune import tune
from loopshape.io.requirements import read_requirements
from loopshape.loop.verdict import check

HERE = Path(__file__).parent
EXAMPLES = HERE.parent.parent / "examples"
HELPERS = HERE.parent.parent / "tests" / "helpers"
sys.path[:0] = [str(HERE.parent / "how_far"), *(str(HELPERS / name) for name in ("", "loops", "nouns"))]
from arm_frfs import measured, write  # noqa: E402
from bench_frf import motor_bench  # noqa: E402
from detuned_plants import ASKED, CANCELLED, polynomials  # noqa: E402

COLUMNS = (
    "plant", "required_percent", "bandwidth_hz", "share", "found_percent", "low_percent", "high_percent", "notch_hz",
    "damping1", "damping2", "outcome", "seconds",
)  # fmt: skip
#: limits for the plant by formula
FORMULA = replace(ASKED, gain_margin_db=5.0)
#: what is required of each plant, 0: nothing
BENCH_PERCENT, ARM_PERCENT = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0), (0.0, 1.0, 2.0, 3.0, 5.0)


def main() -> None:
    """Tune both plants for rising shifts, and shift a plant under a notch that cancels its mode; two tables."""
    columns = ("tuned_for_percent", "shift_percent", "stable", "gain_margin_db", "phase_margin_deg")
    write(HERE / "cancelled.csv", (*columns, "sensitivity_peak_db", "bandwidth_hz"), cancelled())
    bench = motor_bench()
    arm = (*measured(), read_requirements(EXAMPLES / "arm" / "requirements.toml")[0])
    write(HERE / "cost.csv", COLUMNS, [*cost("motor bench", *bench, BENCH_PERCENT), *cost("arm", *arm, ARM_PERCENT)])


def cost(
    plant: str, frfs: Sequence[FRF], fits: Sequence[Fit], asked: Requirements, percents: Sequence[float]
) -> Iterator[tuple]:
    """A tuning for each required shift: lowest bandwidth, what it stands, and where its notch went."""
    first = 0.0
    for percent in percents:
        begun = time.process_time()
        found = tune(frfs, replace(asked, detuning_percent=percent or None), fits, explain=False)
        seconds, verdict = time.process_time() - begun, found.verdict
        first = first or found.bandwidth_hz
        low, high = _least(verdict)
        stands = min(m.detuning_percent for m in verdict.margins.values())
        notch = next(block.parameters for block in found.controller.blocks if block.kind == "notch")
        yield (
            plant, percent, found.bandwidth_hz, found.bandwidth_hz / first, stands, low, high, notch["f1_hz"],
            notch["damping1"], notch["damping2"], verdict.outcome, round(seconds, 1),
        )  # fmt: skip


def _least(verdict: Verdict) -> tuple[float, float]:
    """The interval of the operating point that stands least, by its low end."""
    return min(m.intervals["detuning_percent"] for m in verdict.margins.values())


def cancelled() -> Iterator[tuple]:
    """Margins of the formula's plant, exactly shifted, under what tuning without and with 2 % comes to."""
    for percent in (None, 2.0):
        asked = replace(FORMULA, detuning_percent=percent)
        found = tune([by_formula()], asked, explain=False)
        for shift in (-2.0, -1.0, 0.0, 1.0, 2.0):
            verdict = check([by_formula(shift)], found.controller, replace(asked, detuning_percent=None))
            (m,) = verdict.margins.values()
            numbers = m.gain_margin_db, m.phase_margin_deg, m.sensitivity_peak_db, found.bandwidth_hz
            yield percent or 0.0, shift, m.stable, *numbers


def by_formula(percent: float = 0.0) -> FRF:
    """k/s² (1 + 3 w²/(s² + 2 zeta w s + w²)) with a mode at 58.84 Hz of damping 0.0039, on a stretched axis."""
    f = np.concatenate([np.arange(2.0, 45.0), np.arange(45.0, 75.0, 0.05), np.geomspace(75.0, 900.0, 70)])
    num, den = polynomials(CANCELLED, (0.0,), 0.01 * percent)
    P = np.polyval(num, TWO_PI * 1j * f) / np.polyval(den, TWO_PI * 1j * f)
    return FRF(
        frequency_hz=f, response=P[:, None, None], covariance=(1e-6 * np.abs(P) ** 2 + 0j)[:, None, None],
        valid=np.ones(f.size, dtype=bool), inputs=("u",), outputs=("y",), method="by formula", recording="formula",
        loop="axis", rate_hz=20000.0,
    )  # fmt: skip


if __name__ == "__main__":
    main()
