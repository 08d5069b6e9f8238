"""The 2-DoF arm linearised about an equilibrium, with averaged valves and p_c = p_in (ARM.md, sections 9.1 and 10).

An averaged valve lets through the mean of its filling and its exhaust flow times the duty. Delays of the PWM and the
dead zone are not in it, nor is the drop of the capacity, through which open in-valves act on each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from loopshape.core.units import Array, ComplexArray, angular, hz
from loopshape.toolbox.arm.dynamics.equilibrium2 import pair_rest2, rest2
from loopshape.toolbox.arm.dynamics.model2 import derivatives2
from loopshape.toolbox.arm.parameters import P_IN

#: (5.11-5.15) with the signs of ARM.md, section 1: rows u_A to u_D, columns z_theta1, z_theta2, z_pA, z_pC
DECOUPLING = np.array([[0.0, 1.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
#: of the linear states theta1, theta2, their velocities, p_A to p_D: theta1, theta2, p_A, p_C
OUTPUTS = np.eye(8)[[0, 1, 4, 6]]
#: the strategy of one joint on both (5.3-5.7): columns z_theta1, z_theta2, z_pAB, z_pCD, and theta1, theta2, p_AB, p_CD
PAIR_DECOUPLING = np.array([[0.0, 1.0, 1.0, 0.0], [0.0, -1.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0]])
PAIR_OUTPUTS = np.vstack([np.eye(8)[[0, 1]], np.eye(8)[[4, 6]] + np.eye(8)[[5, 7]]])
_UNITS = np.array([1.0, 1.0, 1.0, 1.0, 1e5, 1e5, 1e5, 1e5])
_STEPS = np.array([1e-5, 1e-5, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-4])  # rad, rad/s, bar


@dataclass(frozen=True, eq=False)
class Linearisation2:
    """Linear arm: states theta1, theta2, their velocities, p_A to p_D (rad, rad/s, bar).

    `dynamics` (8, 8); `fill` and `exhaust` (4,) are d p/dt in bar/s per unit duty of muscles A to D. `decoupling` and
    `outputs` are of the strategy: z in V to u, and states to what is measured; the source's unless stated.
    """

    dynamics: Array
    fill: Array
    exhaust: Array
    decoupling: Array = field(default_factory=DECOUPLING.copy)
    outputs: Array = field(default_factory=OUTPUTS.copy)

    @property
    def inputs(self) -> Array:
        """Input matrix (8, 4) from the strategy's four z, (z_theta1, z_theta2, z_pA, z_pC), in V, valves averaged."""
        return np.vstack([np.zeros((4, 4)), 0.5 * (self.fill + self.exhaust)[:, None] * self.decoupling])

    def response(self, frequency_hz: Array) -> ComplexArray:
        """Response (nf, 4, 4) from the strategy's four z in V to its outputs, angles in rad and pressures in bar."""
        s = 1j * angular(frequency_hz)[:, None, None]
        return np.asarray(self.outputs @ np.linalg.solve(s * np.eye(8) - self.dynamics, self.inputs))

    def modes(self) -> tuple[tuple[float, float], ...]:
        """Eigenfrequency in Hz and damping ratio of each oscillation, lowest first."""
        roots = np.linalg.eigvals(self.dynamics)
        swinging = sorted(roots[roots.imag > 1e-6], key=abs)
        return tuple((hz(abs(root)), float(-root.real / abs(root))) for root in swinging)


def _rates(c: Array, x: Array, valves: tuple[bool, ...]) -> Array:
    """Rates (8,) of the linear states at a kernel's state (9,); `valves` are in A to D, out A to D."""
    d = np.array(derivatives2(c, x, valves))
    return np.concatenate([d[5:9], 1e-5 * d[1:5]])


def linearise2(c: Array, theta1_deg: float, theta2_deg: float, p_a_bar: float, p_c_bar: float) -> Linearisation2:
    """Linearisation about an equilibrium with p_c = p_in; refuses a point without equilibrium."""
    return _about(c, rest2(c, theta1_deg, theta2_deg, p_a_bar, p_c_bar, float(c[P_IN])))


def linearise_pairs2(
    c: Array, theta1_deg: float, theta2_deg: float, p_ab_bar: float, p_cd_bar: float
) -> Linearisation2:
    """As `linearise2` from the sums of both pairs, under the strategy that drives and measures them."""
    found = _about(c, pair_rest2(c, theta1_deg, theta2_deg, p_ab_bar, p_cd_bar, float(c[P_IN])))
    return replace(found, decoupling=PAIR_DECOUPLING, outputs=PAIR_OUTPUTS)


def _about(c: Array, x: Array) -> Linearisation2:
    shut = (False,) * 8
    columns = []
    states = (5, 6, 7, 8, 1, 2, 3, 4)  # places of the linear states in the kernel's
    for place, step, unit in zip(states, _STEPS, _UNITS, strict=True):
        small = np.zeros(x.size)
        small[place] = step * unit
        columns.append((_rates(c, x + small, shut) - _rates(c, x - small, shut)) / (2.0 * step))
    alone = [_rates(c, x, tuple(k == j for k in range(8))) for j in range(8)]
    return Linearisation2(
        dynamics=np.array(columns).T,
        fill=np.array([alone[m][4 + m] for m in range(4)]),
        exhaust=np.array([-alone[4 + m][4 + m] for m in range(4)]),
    )
