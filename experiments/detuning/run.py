"""What standing a shift of the plant's frequencies costs: bandwidth against `detuning_percent`, arm and motor bench."""

from __future__ import annotations

import csv
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from loopshape.check.verdict import check
from loopshape.estimate.frequency_response import estimate_frf
from loopshape.fit.fit import fit, structure_by_name
from loopshape.fit.structures import Rational
from loopshape.frf import FRF
from loopshape.model import Fit
from loopshape.plants.arm.arm1 import Arm1
from loopshape.requirements import BlockTemplate, Requirements, Verdict
from loopshape.rigs.simulated import header, measure
from loopshape.store.import_file import import_file
from loopshape.store.requirements import read_requirements
from loopshape.store.study import read_study
from loopshape.tune.tune import tune
from loopshape.units import TWO_PI

HERE = Path(__file__).parent
EXAMPLES = HERE.parent.parent / "examples"
COLUMNS = (
    "plant", "required_percent", "bandwidth_hz", "share", "found_percent", "low_percent", "high_percent", "notch_hz",
    "damping1", "damping2", "outcome", "seconds",
)  # fmt: skip
#: a structure and limits for the plant by formula
FORMULA = Requirements(
    "axis", sensitivity_peak_db=6.0, phase_margin_deg=40.0, gain_margin_db=5.0, unstable_poles=0,
    structure=tuple(
        BlockTemplate.from_table(table)
        for table in (
            {"kind": "gain", "gain": {"min": 0.001, "max": 10.0}},
            {"kind": "lead_lag", "f1_hz": {"min": 1.0, "max": 30.0}, "f2_hz": {"min": 10.0, "max": 200.0}},
            {"kind": "notch", "f1_hz": {"min": 30.0, "max": 90.0}, "f2_hz": "f1_hz",
             "damping1": {"min": 0.002, "max": 1.0}, "damping2": {"min": 0.05, "max": 5.0}},
            {"kind": "low_pass", "order": 2, "f_hz": {"min": 50.0, "max": 500.0}, "damping": {"min": 0.4, "max": 1.2}},
        )
    ),
)  # fmt: skip
#: what is required of each plant, 0: nothing
BENCH_PERCENT, ARM_PERCENT = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0), (0.0, 1.0, 2.0, 3.0, 5.0)


def main() -> None:
    """Tune both plants for rising shifts, and shift a plant under a notch that cancels its mode; two tables."""
    columns = ("tuned_for_percent", "shift_percent", "stable", "gain_margin_db", "phase_margin_deg")
    write("cancelled.csv", (*columns, "sensitivity_peak_db", "bandwidth_hz"), cancelled())
    bench, arm = motor_bench(), arms()
    write("cost.csv", COLUMNS, [*cost("motor bench", *bench, BENCH_PERCENT), *cost("arm", *arm, ARM_PERCENT)])


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
            verdict = check([by_formula(shift)], found.controller, replace(asked, detuning_percent=None), detuned=False)
            (m,) = verdict.margins.values()
            numbers = m.gain_margin_db, m.phase_margin_deg, m.sensitivity_peak_db, found.bandwidth_hz
            yield percent or 0.0, shift, m.stable, *numbers


def by_formula(percent: float = 0.0) -> FRF:
    """k/s² (1 + 3 w²/(s² + 2 zeta w s + w²)) with a mode at 58.84 Hz of damping 0.0039, on a stretched axis."""
    f = np.concatenate([np.arange(2.0, 45.0), np.arange(45.0, 75.0, 0.05), np.geomspace(75.0, 900.0, 70)])
    s, w = TWO_PI * 1j * f / (1.0 + 0.01 * percent), TWO_PI * 58.84
    P = 4000.0 / s**2 * (1.0 + 3.0 * w**2 / (s**2 + 2.0 * 0.0039 * w * s + w**2))
    return FRF(
        frequency_hz=f, response=P[:, None, None], covariance=(1e-6 * np.abs(P) ** 2 + 0j)[:, None, None],
        trusted=np.ones(f.size, dtype=bool), inputs=("u",), outputs=("y",), method="by formula", recording="formula",
        loop="axis", rate_hz=20000.0,
    )  # fmt: skip


def motor_bench() -> tuple[list[FRF], list[Fit], Requirements]:
    """The bench's FRF of real recordings, its fit and its requirements."""
    folder = EXAMPLES / "motor_bench"
    run = import_file(folder / "multisine_type_a.parquet", folder / "map.toml")
    frf = estimate_frf(run.recordings[0], run.loops[0])
    model = fit(frf, Rational(2, 4, delay=True), weighting="relative")
    return [frf], [model], read_requirements(folder / "requirements.toml")[0]


def arms() -> tuple[list[FRF], list[Fit], Requirements]:
    """The 24 FRFs of the arm's angle loop in the example study, their fits and requirements."""
    folder, plant = EXAMPLES / "arm", Arm1()
    study = read_study(folder / "identify.toml")
    study = replace(study, experiments=tuple(e for e in study.experiments if e.excites == "theta2"))
    loop = header(study, plant).loop("theta2")
    frfs = [estimate_frf(recording, loop) for recording in measure(study, plant)]
    fits = [fit(frf, structure_by_name("third_order")) for frf in frfs]
    return frfs, fits, read_requirements(folder / "requirements.toml")[0]


def write(name: str, columns: Sequence[str], rows: Sequence[tuple] | Iterator[tuple]) -> None:
    """A small table, also shown."""
    rows = [[f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row] for row in rows]
    with (HERE / name).open("w", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    for line in (columns, *rows):
        print("  ".join(str(cell) for cell in line))


if __name__ == "__main__":
    main()
