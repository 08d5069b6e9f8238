"""Pre-stress: the same arm with its muscles stretched by shorter fittings; equilibria and linearisation only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.toolbox.arm.dynamics.equilibrium import pressures
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.arm.source import value

ANGLES_DEG = np.arange(0.0, 45.1, 0.5)


def prestress_rows(settings: Mapping[str, Any]) -> list[dict]:
    """A line for each stretch and p_AB: where both muscles stand above the pressure at which braid and tube meet."""
    fitting = ARM1_PARAMETERS.rows[ARM1_PARAMETERS.index("fitting_mm")].value
    rows = []
    for stretch in settings["stretch_mm"]:
        c = constants(ARM1_PARAMETERS.vector({"fitting_mm": fitting - stretch}))
        for p_ab in settings["p_ab_bar"]:
            rows.append({"stretch_mm": stretch, "p_ab_bar": p_ab, **working(c, p_ab)})
    return rows


def working(c: np.ndarray, p_ab: float) -> dict[str, float]:
    """Widest angle, lower pressure at 15 deg, kappa, f, zeta in the middle; nan where there is no equilibrium."""
    touches, supply = value("muscles.braid_touches"), 1.0
    pairs = np.array([pressures(c, float(a), p_ab) for a in ANGLES_DEG])
    good = (pairs.min(axis=1) >= touches) & (pairs.max(axis=1) < supply)
    widest = float(ANGLES_DEG[int(good.sum()) - 1]) if good[0] else float("nan")
    try:
        kappa, f_hz, zeta = linearise(c, 0.0, p_ab).third_order()
    except WrongUseError:
        kappa, f_hz, zeta = np.nan, np.nan, np.nan
    at_15 = pairs[int(np.argmin(np.abs(ANGLES_DEG - 15.0)))]
    return {
        "widest_deg": widest, "lower_at_15_deg_bar": float(at_15.min()), "apart_at_15_deg_bar": float(np.ptp(at_15)),
        "kappa": kappa, "f_hz": f_hz, "zeta": zeta,
    }  # fmt: skip
