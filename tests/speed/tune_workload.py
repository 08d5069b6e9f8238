"""The tuning workload: the 24 linearised equilibria of the arm with 2 ms of delay, and the source's limits."""

from __future__ import annotations

import numpy as np

import loopshape as ls
from loopshape.core.units import angular
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.arm.source import EQUILIBRIA


def frfs(lines: int) -> list[ls.FRF]:
    """24 FRFs from z_theta2 to theta2, 0.1-30 Hz."""
    c = constants(ARM1_PARAMETERS.vector())
    f = np.geomspace(0.1, 30.0, lines)
    delay = np.exp(-2e-3j * angular(f))
    return [
        ls.FRF(
            frequency_hz=f,
            response=(linearise(c, theta, p).response(f)[:, 0, 0] * delay)[:, None, None],
            covariance=np.full((lines, 1, 1), 1e-16 + 0j),
            valid=np.ones(lines, dtype=bool),
            inputs=("z_theta2_v",),
            outputs=("theta2_rad",),
            method="linearised",
            recording=f"{theta:g}-{p:g}",
            loop="theta2",
            rate_hz=1000.0,
            operating_point={"theta2_deg": theta, "p_ab_bar": p},
        )
        for theta, p in EQUILIBRIA
    ]


def requirements(control_peak_db: float = 26.0) -> ls.Requirements:
    """The source's limits and structure."""
    return ls.Requirements.from_table(
        {
            "name": "theta2",
            "sensitivity_peak_db": 6.0,
            "phase_margin_deg": 45.0,
            "gain_margin_db": 5.0,
            "control_peak_db": control_peak_db,
            "integrators": 1,
            "unstable_poles": 0,
            "structure": [
                {"kind": "gain", "gain": {"min": 0.05, "max": 200.0}},
                {"kind": "lead_lag", "f1_hz": {"min": 0.2, "max": 30.0}, "f2_hz": {"min": 1.0, "max": 100.0}},
                {
                    "kind": "notch",
                    "f1_hz": {"min": 2.0, "max": 12.0},
                    "f2_hz": "f1_hz",
                    "damping1": {"min": 0.02, "max": 1.5},
                    "damping2": {"min": 0.1, "max": 10.0},
                },
                {
                    "kind": "low_pass",
                    "order": 2,
                    "f_hz": {"min": 3.0, "max": 100.0},
                    "damping": {"min": 0.3, "max": 1.5},
                },
            ],
        }
    )
