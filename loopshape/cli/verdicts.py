"""Verdicts as commands print them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.cli.output import Output

if TYPE_CHECKING:
    from loopshape.model import Fit
    from loopshape.requirements import Verdict


def fits_of(run: Path) -> tuple[Fit, ...]:
    """The run's fits, none where nothing was fitted yet."""
    from loopshape.store.fits import read_fits

    return read_fits(run) if (run / "fits.json").exists() else ()


def report_verdicts(verdicts: Sequence[Verdict], output: Output, *, margins: bool = True) -> None:
    """Requirement lines, and the margins of each operating point."""
    for verdict in verdicts:
        rows = [
            [
                line.quantity,
                line.unit,
                line.wished,
                line.found,
                line.spare,
                line.recording,
                line.at_hz,
                _word(line.passed),
            ]
            for line in verdict.lines
        ]
        columns = ["requirement", "unit", "wished", "worst found", "spare", "at", "at [Hz]", "verdict"]
        output.table(f"Loop {verdict.loop}: {_word(verdict.passed)}", columns, rows)
        if margins:
            _margins(verdict, output)
        output.warn(verdict.warnings)
        output.warn(
            f"loop {verdict.loop} is {verdict.margins[name].stable} at {name}: {verdict.margins[name].stability_reason}"
            for name in verdict.unstable
        )


def _margins(verdict: Verdict, output: Output) -> None:
    rows = [
        [
            name,
            m.stable,
            m.bandwidth_hz,
            m.gain_margin_db,
            m.phase_margin_deg,
            m.modulus_margin,
            1e3 * m.delay_margin_s,
            m.sensitivity_peak_db,
            m.complementary_peak_db,
            m.control_peak_db,
            ", ".join(f"{f:.3g}" for f in m.crossings_hz) or "none",
        ]
        for name, m in verdict.margins.items()
    ]
    columns = ["recording", "closed loop", "bandwidth [Hz]", "GM [dB]", "PM [deg]", "modulus", "delay [ms]"]
    columns += ["|S| [dB]", "|T| [dB]", "|CS| [dB]", "0 dB crossings [Hz]"]
    output.table(f"Margins of loop {verdict.loop}", columns, rows)


def _word(passed: bool) -> str:
    return "pass" if passed else "FAIL"


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """A verdict as JSON."""
    return {
        "loop": verdict.loop,
        "passed": verdict.passed,
        "lines": [asdict(line) for line in verdict.lines],
        "margins": {name: asdict(m) for name, m in verdict.margins.items()},
        "unstable": list(verdict.unstable),
        "warnings": list(verdict.warnings),
    }
