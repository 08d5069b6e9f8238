"""One controller for 24 measured equilibria: the source's, its gain lowered until it holds, against the tuned ones."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from loopshape.core.units import db
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit
from loopshape.data.result.verdict import Verdict
from loopshape.design.tune import tune
from loopshape.io.requirements import read_requirements
from loopshape.loop.verdict import check

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "how_far"), str(HERE.parent / "lab")]
from arm_frfs import EXAMPLES, measured, write  # noqa: E402
from source_controllers import angle_controller  # noqa: E402

COLUMNS = ("controller", "peak_cs_db", "lowest_bandwidth_hz", "ratio", "passes", "seconds", "blocks")


def main() -> None:
    """Measure, lower the source's gain, tune at one, two and four times its peak |CS|, write the table."""
    frfs, fits = measured()
    limits = replace(
        read_requirements(EXAMPLES / "requirements.toml")[0],
        control_peak_db=None,
        control_high_frequency_db=None,
        control_high_frequency_from_hz=None,
    )
    source, verdict = lowered(frfs, fits, limits)
    base, peak = bandwidth(verdict), max(m.control_peak_db for m in verdict.margins.values())
    rows = [row("source, gain lowered", source, verdict, base, 0.0)]
    for factor in (1.0, 2.0, 4.0):
        required = replace(limits, control_peak_db=peak + float(db(factor)))
        begun = time.perf_counter()
        found = tune(frfs, required, fits)
        name = f"tuned, {factor:g} times its peak |CS|"
        rows.append(row(name, found.controller, found.verdict, base, time.perf_counter() - begun))
    write(HERE / "results.csv", COLUMNS, rows)


def source_controller(gain: float) -> Controller:
    """The source's controller as it has it for the simulated arm."""
    return angle_controller(gain, notch_hz=4.5)


def lowered(frfs: list[FRF], fits: list[Fit], limits: Requirements) -> tuple[Controller, Verdict]:
    """The source's controller with the largest gain at which all limits hold at all 24, by bisection."""
    low, high = 0.1, 55.0
    for _ in range(40):
        gain = float(np.sqrt(low * high))
        low, high = (gain, high) if check(frfs, source_controller(gain), limits, fits).passed else (low, gain)
    return source_controller(low), check(frfs, source_controller(low), limits, fits)


def bandwidth(verdict: Verdict) -> float:
    """Lowest bandwidth over all operating points, in Hz."""
    return min(m.bandwidth_hz for m in verdict.margins.values())


def row(name: str, controller: Controller, verdict: Verdict, base: float, seconds: float) -> list:
    """One line of the table."""
    peak = max(m.control_peak_db for m in verdict.margins.values())
    blocks = "; ".join(
        f"{b.kind} " + " ".join(f"{k} {v:.4g}" for k, v in b.parameters.items()) for b in controller.blocks
    )
    found = bandwidth(verdict)
    return [name, round(peak, 2), round(found, 4), round(found / base, 3), verdict.passed, round(seconds, 1), blocks]


if __name__ == "__main__":
    main()
