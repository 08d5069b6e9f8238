"""Verdicts made by hand, for the tests of baselines and reports."""

import re
from dataclasses import replace
from math import inf, nan
from xml.etree import ElementTree as ET

from bench_nouns import LIMITS, Block, RequirementResult

import loopshape as ls
from loopshape.view.verdict import junit, markdown

summary = markdown.markdown


CONTROLLER = ls.Controller("axis", (Block("gain", {"gain": 2.0}),), 1000.0)
OTHER = replace(CONTROLLER, blocks=(Block("gain", {"gain": 1 / 3}),))
VALUES = {limit.name: 10.0 + k for k, limit in enumerate(LIMITS)}


def margins(values=None, intervals=None, stable="stable", reason="", band_hz=None):
    """Margins with `values` in place of 10, 11, ... in the order of LIMITS."""
    return ls.Margins.of(
        VALUES | (values or {}), stable, intervals=intervals or {}, at_hz={"modulus_margin": 3.0}, crossings_hz=(3.0,),
        stability_reason=reason, stability_band_hz=band_hz,
    )  # fmt: skip


def write_junit(path, *found, **words):
    """Verdicts as JUnit XML in a file."""
    path.write_text(junit.junit(*found, **words))


def around(values, half):
    """Symmetric intervals around values."""
    return {name: (value - half, value + half) for name, value in values.items()}


def line(quantity="phase_margin_deg", outcome="passed", required=30.0, value=40.0, **words):
    """A line of a verdict."""
    slack = {"passed": 5.0, "failed": -5.0, "undecided": -1.0}[outcome]
    made = RequirementResult(quantity, "deg", required, value, slack, outcome, "r1", 3.0)
    return replace(made, **words)


def checked(points, lines=(), loop="axis", controller=CONTROLLER, data="a", warnings=()):
    """A verdict on the margins of `points` by recording; equal `data` are the same FRFs."""
    made = {"controllers": (replace(controller, loop=loop),), "data": {name: f"{data}-{name}" for name in points}}
    return ls.Verdict(loop, tuple(lines), points, tuple(warnings), **made)


LINES = (
    line(interval=(38.0, 42.5)),
    line("gain_margin_db", "undecided", unit="dB", required=5.0, value=5.5, interval=(4.0, 7.0), longer=2.25),
    line("sensitivity_peak_db", "failed", unit="dB", required=6.0, value=8.4, interval=(8.1, 8.7), at_hz=None),
    line("gain_reduction_margin_db", value=inf, longer=None, interval=(20.0, inf)),
)
POINTS = {
    "r1": margins({"gain_margin_db": inf, "disk_margin": nan}, around(VALUES, 0.1)),
    "r2": margins(
        {"control_high_frequency_db": -inf}, {"phase_margin_deg": (-inf, 3.0)}, "undecided", "why", (0.1, 2.0)
    ),
    "r3": margins(stable="unstable", reason="2 poles"),
}  # fmt: skip
FOUND = checked(POINTS, LINES, warnings=("be careful",), controller=replace(OTHER, prewarp_hz=12.0, precision="single"))


def rows(text):
    """Tables of a Markdown text as lists of rows of cells; refuses ragged ones."""
    tables, current = [], []
    for text_line in [*text.splitlines(), ""]:
        if text_line.startswith("|"):
            current.append([cell.strip() for cell in re.split(r"(?<!\\)\|", text_line)[1:-1]])
        elif current:
            assert len({len(row) for row in current}) == 1, current
            tables.append(current)
            current = []
    return tables


def failures(path):
    """Failures by class and name: type and message."""
    return {
        (case.get("classname"), case.get("name")): (
            case.find("failure").get("type"),
            case.find("failure").get("message"),
        )
        for case in ET.parse(path).getroot().iter("testcase")
        if case.find("failure") is not None
    }
