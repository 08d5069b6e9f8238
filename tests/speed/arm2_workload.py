"""The 2-DoF arm's workload for benchmarks: tracking steps of both angles and both pressures, default controllers."""

from __future__ import annotations

import numpy as np

from loopshape.toolbox.arm.arm2 import Arm2
from loopshape.toolbox.arm.dynamics.equilibrium2 import rest2
from loopshape.toolbox.arm.parameters import P_IN
from loopshape.toolbox.arm.parameters2 import ARM2_PARAMETERS, constants2

SECONDS = 100.0


def references(seconds: float = SECONDS) -> np.ndarray:
    """Setpoints (n, 4) in rad and Pa: steps of the angles up to 6 and 20 deg, of the pressures 0.1 bar."""
    tick = np.arange(round(1000 * seconds))
    theta1 = np.radians([0.0, 3.0, -3.0, 2.0, -2.0])[(tick // 5000) % 5]
    theta2 = np.radians([0.0, 10.0, -10.0, 5.0, -5.0])[(tick // 2500) % 5]
    p_a = np.where((tick // 10000) % 2 == 0, 0.5e5, 0.6e5)
    p_c = np.where((tick // 7500) % 2 == 0, 0.5e5, 0.6e5)
    return np.ascontiguousarray(np.stack([theta1, theta2, p_a, p_c], axis=1))


def biquads() -> np.ndarray:
    """All loops' sections (4, 3, 5), the shorter ones padded with unity."""
    own = [controller.biquads() for controller in Arm2().default_controllers(1000.0)]
    out = np.zeros((4, max(len(sections) for sections in own), 5))
    out[:, :, 0] = 1.0
    for k, sections in enumerate(own):
        out[k, : len(sections)] = sections
    return out


def start() -> np.ndarray:
    """The arm at rest at (0, 0) with p_A = p_C = 0.5 bar, state in SI."""
    c = constants2(ARM2_PARAMETERS.vector())
    return rest2(c, 0.0, 0.0, 0.5, 0.5, float(c[P_IN]))
