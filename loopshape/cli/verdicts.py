"""Verdicts as commands print them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.cli.output import Output

if TYPE_CHECKING:
    from loopshape.model import Fit
    from loopshape.requirements import Line, Verdict


#: how an outcome is printed
WORDS = {"passed": "pass", "failed": "FAIL", "undecided": "undecided"}


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
                interval_text(line.interval),
                line.spare,
                line.recording,
                line.at_hz,
                WORDS[line.outcome] + longer_text(line),
            ]
            for line in verdict.lines
        ]
        columns = ["requirement", "unit", "wished", "worst found", "95 % interval", "spare", "at", "at [Hz]", "verdict"]
        output.table(f"Loop {verdict.loop}: {WORDS[verdict.outcome]}", columns, rows)
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


def interval_text(interval: tuple[float, float] | None) -> str:
    """A 95 % interval as people read it, a dash where there is none."""
    return "-" if interval is None else f"{interval[0]:.4g} .. {interval[1]:.4g}"


def longer_text(line: Line) -> str:
    """How much more measuring would decide an undecided line."""
    if line.longer is None:
        return ""
    return f": {line.longer:.2g} times the data would decide" if line.longer < 100.0 else ": on the limit"


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """A verdict as JSON."""
    return {
        "loop": verdict.loop,
        "passed": verdict.passed,
        "outcome": verdict.outcome,
        "lines": [asdict(line) | {"passed": line.passed} for line in verdict.lines],
        "margins": {name: asdict(m) for name, m in verdict.margins.items()},
        "unstable": list(verdict.unstable),
        "warnings": list(verdict.warnings),
    }
