"""The muscle on a tensile bench: pull under closed valves, and the slope that a bench really measures.

Lengths in m, pressures in bar (gauge), pulls in N. The muscle is the arm's own kernel (`toolbox.arm.dynamics.model`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics.model import muscle
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants
from loopshape.toolbox.arm.source import value

#: the closed muscle's gas law: pull by k(p_w, h_w) at constant pressure as the source reads its bench, or by the
#: whole model with the air's mass constant, gauge pressure as printed or absolute pressure
LAWS = ("as the source reads it", "gauge", "absolute")
STEP_M = 1e-6


@dataclass(frozen=True)
class Muscle:
    """One muscle: its stiffness over the model's, and what its nominal length is longer, in m."""

    name: str = "4"
    factor: float = 1.0
    longer_m: float = 0.0


@dataclass(frozen=True)
class Digits:
    """The six numbers of table 4.1 in its units: b in bar, k0, k1, k2 in 1e5 N/(m bar) and per m of length."""

    b: float
    k0: float
    k1: float
    k2: float
    c0: float = 1.0
    c1: float = 1.0

    def stiffness(self, p_bar: Array, h_m: Array) -> Array:
        """k (4.5) in N/m."""
        biased = self.b * (self.c0 * self.k0 + self.c1 * self.k1 * h_m + self.k2 * h_m**2)
        return np.asarray(1e5 * (biased + p_bar * (self.k0 + self.k1 * h_m + self.k2 * h_m**2)))


def printed(row: str = "experiment") -> Digits:
    """Table 4.1's row as printed."""
    return Digits(*(value(f"table_4_1.{row}.{name}") for name in ("b", "k0", "k1", "k2", "c0", "c1")))


def bench_constants(law: str) -> Array:
    """The kernel's constants with the bench's damping (table 4.1) and a gas law."""
    changes = {
        "damping_ns_m": value("table_4_1.damping0"),
        "damping_per_bar_ns_m": value("table_4_1.damping1"),
        "gas_absolute_share": 1.0 if law == "absolute" else 0.0,
    }
    return constants(ARM1_PARAMETERS.vector(changes))


@compiled
def _closed(c: Array, p_w: float, h_w: float, h: Array, dh: Array, factor: float, two_l: float) -> Array:
    """Pulls (n,) in N at constant mass of air; p_w in Pa. The gas law integrated: (p + p_0) V^n stays."""
    pulls = np.empty(h.size)
    volume_w = muscle(c, p_w, h_w, 0.0, factor, two_l, 0.0)[1]
    for i in range(h.size):
        volume = muscle(c, p_w, h[i], 0.0, factor, two_l, 0.0)[1]
        p = (p_w + c[k.ABSOLUTE]) * (volume_w / volume) ** c[k.EXPONENT] - c[k.ABSOLUTE]
        pulls[i] = muscle(c, p, h[i], dh[i], factor, two_l, 0.0)[0]
    return pulls


@compiled
def _open(c: Array, p: float, h: Array, factor: float, two_l: float) -> Array:
    """Pulls (n,) in N at rest and constant pressure in Pa."""
    pulls = np.empty(h.size)
    for i in range(h.size):
        pulls[i] = muscle(c, p, h[i], 0.0, factor, two_l, 0.0)[0]
    return pulls


def pulls(law: str, p_w_bar: float, h_w_m: float, h_m: Array, dh_m_s: Array, one: Muscle | None = None) -> Array:
    """Pulls (n,) in N of a muscle closed at (p_w, h_w) while its length moves."""
    c, one = bench_constants(law), one or Muscle()
    if law == LAWS[0]:
        stiff = one.factor * float(printed().stiffness(np.array(p_w_bar), np.array(h_w_m)))
        rest = _open(c, 1e5 * p_w_bar, np.array([h_w_m]), one.factor, c[k.TWO_L] + one.longer_m)[0]
        return np.asarray(rest + stiff * (h_m - h_w_m) + damping(p_w_bar) * dh_m_s)
    return np.asarray(_closed(c, 1e5 * p_w_bar, h_w_m, h_m, dh_m_s, one.factor, c[k.TWO_L] + one.longer_m))


def slope_closed(law: str, p_bar: float, h_m: float, one: Muscle | None = None) -> float:
    """dF/dh in N/m with the valves closed: what the bench's response tends to at low frequency."""
    h = h_m + STEP_M * np.array([-1.0, 1.0])
    low, high = pulls(law, p_bar, h_m, h, np.zeros(2), one)
    return float((high - low) / (2.0 * STEP_M))


def slope_open(p_bar: float, h_m: float) -> float:
    """dF/dh in N/m at constant pressure."""
    c = bench_constants("gauge")
    low, high = _open(c, 1e5 * p_bar, h_m + STEP_M * np.array([-1.0, 1.0]), 1.0, c[k.TWO_L])
    return float((high - low) / (2.0 * STEP_M))


def pull(p_bar: float, h_m: float) -> float:
    """Pull at rest in N."""
    c = bench_constants("gauge")
    return float(_open(c, 1e5 * p_bar, np.array([h_m]), 1.0, c[k.TWO_L])[0])


def damping(p_bar: float) -> float:
    """d (4.2) in N s/m with the bench's numbers."""
    return value("table_4_1.damping0") + value("table_4_1.damping1") * p_bar


def nominal_length_m(p_bar: Array) -> Array:
    """h0 (3.46)."""
    v = {row.name: row.value for row in ARM1_PARAMETERS.rows}
    return np.asarray(
        2e-3 * v["braid_length_mm"] - v["nominal_length_s1_m"] * p_bar / (v["nominal_length_s2_bar"] + p_bar)
    )


def diameter_m(h_m: Array) -> Array:
    """d2 in the middle of a muscle of length h (3.36)."""
    v = {row.name: row.value for row in ARM1_PARAMETERS.rows}
    return np.asarray(np.sqrt(4e-6 * v["braid_length_mm"] ** 2 - h_m**2) / (v["braid_turns"] * np.pi))


def volume_series(h_m: float, braid_mm: float | None = None, order: int = 4) -> Array:
    """Taylor coefficients (order + 1,) of the volume in m3 about h (3.39), exact: by a root's recurrence."""
    v = {row.name: row.value for row in ARM1_PARAMETERS.rows}
    braid = v["braid_length_mm"] if braid_mm is None else braid_mm
    turn, end = v["braid_turns"] * np.pi, 1e-3 * v["end_diameter_mm"]
    square = np.zeros(order + 1)
    square[:3] = (4e-6 * braid**2 - h_m**2, -2.0 * h_m, -1.0)
    root = np.zeros(order + 1)
    root[0] = np.sqrt(square[0])
    for n in range(1, order + 1):
        root[n] = (square[n] - root[1:n] @ root[1:n][::-1]) / (2.0 * root[0])
    area = 4.0 * end * root / turn + 8.0 * square / turn**2
    area[0] += 3.0 * end**2
    return np.asarray(np.pi / 60.0 * (h_m * area + np.concatenate([[0.0], area[:-1]])))


def volume_slopes(h_m: float, braid_mm: float | None = None) -> Array:
    """V, dV/dh, ... d4V/dh4 (5,), SI; `braid_mm` is another thread length L than the table's."""
    return volume_series(h_m, braid_mm) * np.array([1.0, 1.0, 2.0, 6.0, 24.0])
