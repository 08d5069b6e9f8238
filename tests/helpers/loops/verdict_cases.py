"""Verdicts made by hand, for the tests of baselines and reports."""

from dataclasses import replace

from bench_nouns import LIMITS, Block, Checked, RequirementResult

import loopshape as ls

CONTROLLER = ls.Controller("axis", (Block("gain", {"gain": 2.0}),), 1000.0)
OTHER = replace(CONTROLLER, blocks=(Block("gain", {"gain": 1 / 3}),))
VALUES = {limit.name: 10.0 + k for k, limit in enumerate(LIMITS)}


def margins(values=None, intervals=None, stable="stable", reason="", band_hz=None):
    """Margins with `values` in place of 10, 11, ... in the order of LIMITS."""
    return ls.Margins(
        **VALUES | (values or {}), crossings_hz=(3.0,), phase_crossings_hz=(), at_hz={"modulus_margin": 3.0},
        stable=stable, stability_reason=reason, intervals=intervals or {}, stability_band_hz=band_hz,
    )  # fmt: skip


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
    verdict = ls.Verdict(loop, tuple(lines), points, tuple(warnings))
    return Checked(verdict, replace(controller, loop=loop), {name: f"{data}-{name}" for name in points})
