"""Why table H.1's controller fails on the model: one thing changed at a time, on the fitted plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from source_controllers import controller

from loopshape.core.units import TWO_PI
from loopshape.data.control.controller import Block, Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.response.model import Fit, TransferFunction
from loopshape.data.result.verdict import Verdict
from loopshape.loop.verdict import check
from loopshape.toolbox.arm.source import value

#: lines of a model's FRF, and the relative standard deviation that stands for exactly known
GRID_HZ, EXACT = np.unique(np.concatenate([np.geomspace(0.05, 20.0, 500), np.linspace(1.2, 2.6, 600)])), 1e-6
CAUSES = (
    "case", "stable_points", "lowest_bandwidth_hz", "highest_bandwidth_hz", "least_phase_margin_deg",
    "largest_sensitivity_db",
)  # fmt: skip


def changed(fit: Fit, *, f_hz: float | None = None, zeta: float | None = None, crossing_hz: float | None = None) -> Fit:
    """The fit's plant with another mode at the same low-frequency gain, another damping, or another gain.

    `crossing_hz` sets the gain so that table H.1's open loop is 1 there.
    """
    w0 = TWO_PI * fit["f_hz"].value
    w, z = w0 if f_hz is None else TWO_PI * f_hz, fit["zeta"].value if zeta is None else zeta
    kappa = fit["kappa"].value * (w / w0) ** 2
    model = _plant(kappa, w, z)
    if crossing_hz is not None:
        at = np.array([crossing_hz])
        model = _plant(kappa / float(np.abs(model.response(at) * controller("table_h_1").response(at))[0]), w, z)
    return replace(fit, model=model)


def _plant(kappa: float, w: float, zeta: float) -> TransferFunction:
    return TransferFunction(np.array([kappa]), np.array([1.0, 2.0 * zeta * w, w * w, 0.0]), 0.0)


def as_frf(fit: Fit) -> FRF:
    """Lines of a fit's model."""
    P = fit.model.response(GRID_HZ)
    variance = (EXACT * np.abs(P)) ** 2
    known = np.ones(P.size, dtype=bool)
    return FRF(
        GRID_HZ, P[:, None, None], variance[:, None, None].astype(complex), known, ("z",), ("theta1",), "model",
        recording=fit.recording, loop="theta1", rate_hz=1000.0,
    )  # fmt: skip


def with_notch(of: Controller, f_hz: float) -> Controller:
    """The controller with its notch elsewhere."""
    blocks = tuple(
        Block("notch", {**b.parameters, "f1_hz": f_hz, "f2_hz": f_hz}) if b.kind == "notch" else b for b in of.blocks
    )
    return replace(of, blocks=blocks)


def causes(fits: Sequence[Fit], required: Requirements) -> list[list]:
    """A line a case: table H.1 on the fitted plants as they are, and with one thing changed."""
    printed, notch_hz = controller("table_h_1"), value("table_h_1.notch")
    middle_hz = float(np.mean([fit["f_hz"].value for fit in fits]))
    bandwidth_hz = float(np.sqrt(value("table_h_1.bandwidth_low") * value("table_h_1.bandwidth_high")))
    mode, damped, lower = {"f_hz": notch_hz}, {"zeta": value("dissipation")}, {"crossing_hz": bandwidth_hz}
    cases: dict[str, tuple[Controller, list[Fit]]] = {
        "the fitted plants": (printed, [changed(fit) for fit in fits]),
        "notch at the modes' mean": (with_notch(printed, middle_hz), [changed(fit) for fit in fits]),
    }
    for name, change in {
        "mode at the notch": mode,
        "damping of the source's chapter 6": damped,
        "gain for the source's bandwidth": lower,
        "mode and damping": mode | damped,
        "mode and gain": mode | lower,
        "damping and gain": damped | lower,
        "mode, damping and gain": mode | damped | lower,
    }.items():
        cases[name] = (printed, [changed(fit, **change) for fit in fits])
    return [summary(name, check([as_frf(f) for f in at], of, required, at)) for name, (of, at) in cases.items()]


def summary(name: str, verdict: Verdict) -> list:
    """The worst of all points."""
    found = list(verdict.margins.values())
    numbers = [f([m.bandwidth_hz for m in found]) for f in (min, max)]
    numbers += [min(m.phase_margin_deg for m in found), max(m.sensitivity_peak_db for m in found)]
    return [name, sum(m.stable == "stable" for m in found), *(f"{x:.3g}" for x in numbers)]
