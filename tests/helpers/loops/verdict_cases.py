"""Verdicts made by hand, for the tests of baselines and reports."""

from dataclasses import replace

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
