"""Two axes whose inputs each move both."""

import numpy as np

import loopshape as ls

RATE = 1000.0
F = np.geomspace(0.2, 200.0, 200)


def matrix(coupling, delays=(0.004, 0.006), name="one"):
    """Two axes that integrate, with delays and a lag each; `coupling` of each input reaches the other's output."""
    s = 2j * np.pi * F
    own = [np.exp(-d * s) / (s * (1.0 + s / (2.0 * np.pi * 20.0))) for d in delays]
    across = 1.0 / (1.0 + s / (2.0 * np.pi * 15.0))
    P = np.empty((F.size, 2, 2), dtype=complex)
    P[:, 0, 0], P[:, 1, 1] = own[0], 1.2 * own[1]
    P[:, 0, 1], P[:, 1, 0] = coupling * across * own[1], -0.8 * coupling * across * own[0]
    covariance = np.tile(1e-16 * np.eye(4, dtype=complex), (F.size, 1, 1))
    return ls.FRF(
        F, P, covariance, np.ones(F.size, dtype=bool), ("z_a", "z_b"), ("y_a", "y_b"), "known", name, "a+b", RATE
    )  # fmt: skip


def required(name, **limits):
    table = {
        "name": name,
        "integrators": 1,
        "sensitivity_peak_db": 6.0,
        "phase_margin_deg": 40.0,
        "gain_margin_db": 5.0,
        "control_peak_db": 60.0,
        "structure": [
            {"kind": "gain", "gain": {"min": 0.1, "max": 1000.0}},
            {"kind": "lead_lag", "f1_hz": {"min": 1.0, "max": 100.0}, "f2_hz": {"min": 5.0, "max": 400.0}},
        ],
    }
    return ls.Requirements.from_table(table | limits)


WISHES = (required("a"), required("b"))
WHOLE = ls.Requirements(unstable_poles=0)
