"""Verdicts as JUnit XML, so that a build server shows a margin that is gone as a failed test."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from loopshape.core.outcomes import Outcome
from loopshape.data.result.baseline import Comparison
from loopshape.data.result.verdict import Verdict
from loopshape.data.result.verdict_words import line_text, stability_text

#: a failure's type by outcome
_TYPES = {Outcome.FAILED: "missed", Outcome.UNDECIDED: "undecided"}


def junit(verdicts: Sequence[Verdict], comparison: Comparison | None = None, *, allow_worse: bool = False) -> str:
    """One suite a loop: a case for each requirement and for each operating point's stability.

    A case fails where its line does not pass, or where the loop is unstable or undecided; the failure's type is
    "missed" or "undecided". With a comparison there is one more suite, a case for each margin and operating point,
    whose failures are of type "worse"; with `allow_worse` they are reported and do not fail.
    """
    suites = ET.Element("testsuites", name="loopshape check")
    for verdict in verdicts:
        _add_verdict(suites, verdict)
    if comparison is not None:
        _add_comparison(suites, comparison, allow_worse)
    for suite in suites:
        _count(suite)
    ET.indent(suites)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(suites, encoding="unicode")}\n'


def _add_verdict(suites: ET.Element, verdict: Verdict) -> None:
    suite = ET.SubElement(suites, "testsuite", name=_clean(verdict.loop))
    name = f"loopshape.{verdict.loop}"
    for line in verdict.lines:
        _add_case(suite, name, line.quantity, line_text(line), _TYPES.get(line.outcome))
    for recording, margins in verdict.margins.items():
        _add_case(suite, name, f"stability in {recording}", stability_text(margins), _TYPES.get(margins.stable.outcome))
    if verdict.warnings:
        ET.SubElement(suite, "system-out").text = _clean("\n".join(verdict.warnings))


def _add_comparison(suites: ET.Element, comparison: Comparison, allow_worse: bool) -> None:
    suite = ET.SubElement(suites, "testsuite", name="baseline")
    for one in comparison.cases():
        _add_case(suite, one.where, one.name, one.text, "worse" if one.worse and not allow_worse else None)
    ET.SubElement(suite, "system-out").text = _clean("\n".join(comparison.beside))


def _add_case(suite: ET.Element, where: str, name: str, text: str, failure: str | None) -> None:
    case = ET.SubElement(suite, "testcase", classname=_clean(where), name=_clean(name))
    if failure is None:
        ET.SubElement(case, "system-out").text = _clean(text)
    else:
        ET.SubElement(case, "failure", message=_clean(text), type=failure).text = _clean(text)


def _count(suite: ET.Element) -> None:
    cases = suite.findall("testcase")
    failures = sum(case.find("failure") is not None for case in cases)
    suite.attrib |= {"tests": str(len(cases)), "failures": str(failures), "errors": "0"}


def _clean(text: str) -> str:
    """The text without characters that XML cannot hold."""
    return "".join(
        c for c in text if c in "\t\n\r" or (c >= " " and c not in "\ufffe\uffff" and not "\ud800" <= c <= "\udfff")
    )
