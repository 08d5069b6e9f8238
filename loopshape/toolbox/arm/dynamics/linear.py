"""The arm linearised about an equilibrium, with averaged valves: the truth that estimates are compared with.

An averaged valve lets through its full flow times the duty. Filling and exhaust differ, so the nominal gain
is the mean of both; `ripple_gains` gives the gains that a moving command sees. It overstates p_AB/z_p, 2.4 bar/s per V
for the 1.4 that is measured at (0 deg, 1.0 bar): z_p opens both in-valves at once, and they share one throttle; and it
misses the coupling that a muscle near the supply's pressure brings (experiments/decoupling).

Effects that act on the flows, the gas, the muscles, the joint and the body are in it, with four limits: a flexible
coupling is stiff and a hose without its lag (below their frequencies), creep is fast (above its own), and what hangs on
the amplitude or on delays - sliding friction, hysteresis, play, valves, sensors - is not there. Coulomb friction enters
with its slope at rest, which is far more damping than a motion of any size sees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.units import TWO_PI, Array, ComplexArray, angular, hz
from loopshape.toolbox.arm.dynamics.equilibrium import rest
from loopshape.toolbox.arm.dynamics.model import derivatives
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import GRAVITY, INERTIA, P_IN


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Linear arm about an equilibrium: states theta2, its velocity, p_A, p_B (rad, rad/s, bar, bar).

    `dynamics` (4, 4); `fill` and `exhaust` (2,) are d p/dt in bar/s per unit duty of muscles A and B.
    """

    dynamics: Array
    fill: Array
    exhaust: Array

    @property
    def mean_gains(self) -> Array:
        """Mean of filling and exhaust, (2,), bar/s per V."""
        return 0.5 * (self.fill + self.exhaust)

    def inputs(self, gains: Array | None = None) -> Array:
        """Input matrix (nf or 1, 4, 2) from (z_theta2, z_p): u_A = z_theta + z_p, u_B = -z_theta + z_p."""
        g = np.atleast_2d(self.mean_gains if gains is None else gains)
        zero = np.zeros(g.shape[0])
        rows = [[zero, zero], [zero, zero], [g[:, 0], g[:, 0]], [-g[:, 1], g[:, 1]]]
        return np.moveaxis(np.array(rows), -1, 0)

    def response(self, frequency_hz: Array, gains: Array | None = None) -> ComplexArray:
        """Response (nf, 2, 2) from (z_theta2, z_p) to (theta2 in rad, p_AB in bar).

        `gains` are (2,), or (nf, 2) where they depend on the frequency.
        """
        outputs = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
        s = 1j * angular(frequency_hz)[:, None, None]
        return np.asarray(outputs @ np.linalg.solve(s * np.eye(4) - self.dynamics, self.inputs(gains)))

    def third_order(self, gains: Array | None = None) -> tuple[float, float, float]:
        """kappa in rad/(V s3), eigenfrequency in Hz and damping ratio of theta2/z_theta2 (4.10)."""
        a = self.dynamics
        g = self.mean_gains if gains is None else gains
        w2 = -a[1, 0] - a[1, 2] * a[2, 1] - a[1, 3] * a[3, 1]
        w = np.sqrt(w2)
        kappa = a[1, 2] * g[0] - a[1, 3] * g[1]
        return float(kappa), hz(w), float(-a[1, 1] / (2.0 * w))


def _quasi_static(c: Array) -> Array:
    """Constants of the arm with a stiff coupling and hoses that hold no air back; their volume stays."""
    c = c.copy()
    c[INERTIA] += c[e.FLEX_INERTIA]
    c[GRAVITY] += c[e.FLEX_GRAVITY]
    for place in (e.FLEX_K, e.FLEX_D, e.FLEX_INERTIA, e.FLEX_GRAVITY, e.LINE):
        c[place] = 0.0
    return c


def linearise(c: Array, theta2_deg: float, p_ab_bar: float) -> Linearisation:
    """Linearisation about an equilibrium with p_c = p_in; refuses a point without equilibrium."""
    c = _quasi_static(c)
    x = rest(c, theta2_deg, p_ab_bar, float(c[P_IN]))

    def shut(state: Array) -> Array:
        d = derivatives(c, tuple(state[:5]), (False, False, False, False))
        return np.array([state[4], d[3], 1e-5 * d[1], 1e-5 * d[2]])

    step = np.array([0.0, 10.0, 10.0, 1e-5, 1e-3, 0.0, 0.0])
    columns = []
    for k, unit in ((3, 1.0), (4, 1.0), (1, 1e5), (2, 1e5)):
        small = np.zeros(x.size)
        small[k] = step[k]
        columns.append((shut(x + small) - shut(x - small)) / (2.0 * step[k]) * unit)
    in_a, in_b, out_a, out_b = (derivatives(c, tuple(x[:5]), (k == 0, k == 1, k == 2, k == 3)) for k in range(4))
    fill, exhaust = np.array([in_a[1], in_b[2]]), np.array([out_a[1], out_b[2]])
    return Linearisation(np.array(columns).T, 1e-5 * fill, -1e-5 * exhaust)


def ripple_gains(lin: Linearisation, mean_v: Array, amplitude_v: Array, dead_zone: float) -> Array:
    """Gains (nf, 2) in bar/s per V of valves A and B for commands u = mean + amplitude sin: first harmonic.

    The flow is fill u above the dead zone, exhaust u below, nothing inside: its describing function. `mean_v`
    (2,) are the valves' mean commands, which the loops set so that no pressure drifts; `amplitude_v` (nf,)
    must be positive.
    """
    sine = np.sin((np.arange(720) + 0.5) * (TWO_PI / 720))
    gains = []
    for fill, exhaust, mean in zip(lin.fill, lin.exhaust, mean_v, strict=True):
        u = mean + amplitude_v[:, None] * sine
        flow = np.where(np.abs(u) > dead_zone, np.where(u > 0.0, fill, exhaust) * u, 0.0)
        gains.append(2.0 * (flow * sine).mean(axis=1) / amplitude_v)
    return np.stack(gains, axis=1)
