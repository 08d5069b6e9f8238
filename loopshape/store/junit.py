"""Verdicts as JUnit XML, so that a build server shows a margin that is gone as a failed test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from loopshape.requirements import LIMITS, Line, Margins, Verdict
from loopshape.store.files import write_text_whole

_SENSE = {limit.name: limit.sense.replace("_", " ") for limit in LIMITS}


def write_junit(path: Path, verdicts: Sequence[Verdict]) -> None:
    """Write one suite a loop: a case for each requirement and for each operating point's stability.

    A case fails where its line does not pass, or where the loop is unstable or undecided.
    """
    suites = ET.Element("testsuites", name="loopshape check")
    for verdict in verdicts:
        _add_suite(suites, verdict)
    ET.indent(suites)
    text = ET.tostring(suites, encoding="unicode")
    write_text_whole(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')


def _add_suite(suites: ET.Element, verdict: Verdict) -> None:
    failures = sum(not line.passed for line in verdict.lines) + len(verdict.unstable)
    tests = len(verdict.lines) + len(verdict.margins)
    suite = ET.SubElement(
        suites, "testsuite", name=_clean(verdict.loop), tests=str(tests), failures=str(failures), errors="0"
    )
    for line in verdict.lines:
        _add_case(suite, verdict.loop, line.quantity, _line_text(line), line.passed)
    for recording, margins in verdict.margins.items():
        stable = margins.stable == "stable"
        _add_case(suite, verdict.loop, f"stability in {recording}", _stability_text(margins), stable)
    if verdict.warnings:
        ET.SubElement(suite, "system-out").text = _clean("\n".join(verdict.warnings))


def _add_case(suite: ET.Element, loop: str, name: str, text: str, passed: bool) -> None:
    case = ET.SubElement(suite, "testcase", classname=_clean(f"loopshape.{loop}"), name=_clean(name))
    if passed:
        ET.SubElement(case, "system-out").text = _clean(text)
    else:
        ET.SubElement(case, "failure", message=_clean(text)).text = _clean(text)


def _line_text(line: Line) -> str:
    unit = "" if line.unit == "1" else f" {line.unit}"
    at = "" if line.at_hz is None else f" at {line.at_hz:.4g} Hz"
    sense = _SENSE.get(line.quantity, "")
    wished = f"wished {sense + ' ' if sense else ''}{line.wished:g}{unit}"
    return f"{wished}, found {line.found:.4g}{unit}{at} in {line.recording} (spare {line.spare:.4g}{unit})"


def _stability_text(margins: Margins) -> str:
    return f"{margins.stable}: {margins.stability_reason}" if margins.stability_reason else margins.stable


def _clean(text: str) -> str:
    """The text without characters that XML cannot hold."""
    return "".join(
        c for c in text if c in "\t\n\r" or (c >= " " and c not in "\ufffe\uffff" and not "\ud800" <= c <= "\udfff")
    )
