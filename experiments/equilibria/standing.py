"""The arm at rest with both stiffnesses of table 4.1: differences, stability, crossing angles, what moves it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import TWO_PI, Array, deg, rad
from loopshape.toolbox.arm.dynamics.equilibrium import acceleration, angle_deg, pressures
from loopshape.toolbox.arm.dynamics.linear import linearise
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, INERTIA, constants
from loopshape.toolbox.arm.source import EQUILIBRIA, number, value

Moves = Mapping[str, float]
STIFFNESS = ("b_bar", "k0", "k1", "k2", "c0", "c1")
ANALYTICAL: dict[str, float] = {
    "stiffness_b_bar": value("e_28.b"),
    "stiffness_k0": value("e_27.k0"),
    "stiffness_k1": value("e_27.k1"),
    "stiffness_k2": value("e_27.k2"),
    "stiffness_c0": value("table_4_1.analytical.c0"),
    "stiffness_c1": value("table_4_1.analytical.c1"),
}
MODELS: dict[str, dict[str, float]] = {"fitted": {}, "analytical": ANALYTICAL}
GASES: dict[str, dict[str, float]] = {"gauge": {"gas_absolute_share": 0.0}, "absolute": {"gas_absolute_share": 1.0}}


def arm(moves: Moves | None = None) -> Array:
    """Constants of the arm with some parameters moved."""
    return constants(ARM1_PARAMETERS.vector(moves))


def supply_bar() -> float:
    """What the supply can give."""
    return ARM1_PARAMETERS.rows[ARM1_PARAMETERS.index("supply_bar")].value


def within_supply() -> list[tuple[float, float]]:
    """Those of the 24 points at which the fitted stiffness asks for no more than the supply."""
    c = arm()
    return [point for point in EQUILIBRIA if max(pressures(c, *point)) <= supply_bar()]


def shift_deg(c: Array, other: Array, theta2_deg: float, p_ab_bar: float) -> float:
    """Where `other` stands, minus `c`, at the pressures that hold `c` at a point; nan where it finds no rest."""
    return angle_deg(other, *pressures(c, theta2_deg, p_ab_bar)) - theta2_deg


@dataclass(frozen=True)
class Firmness:
    """Stiffness of the joint in N m/rad (positive is stable): at constant pressures, and with closed valves."""

    pressure: float
    closed: float


def firmness(c: Array, theta2_deg: float, p_ab_bar: float) -> Firmness:
    """Minus dTorque/dtheta at an equilibrium; nan where there is none."""
    if not np.isfinite(pressures(c, theta2_deg, p_ab_bar)[0]):
        return Firmness(float("nan"), float("nan"))
    a, inertia = linearise(c, theta2_deg, p_ab_bar).dynamics, c[INERTIA]
    return Firmness(float(-inertia * a[1, 0]), float(-inertia * (a[1, 0] + a[1, 2] * a[2, 1] + a[1, 3] * a[3, 1])))


def firmness_map(c: Array, theta2_deg: Iterable[float], p_ab_bar: Iterable[float], closed: bool) -> Array:
    """Stiffness in N m/rad (n, m) over theta2 (m,) and p_AB (n,)."""
    theta = list(theta2_deg)
    rows = [[firmness(c, t, p) for t in theta] for p in p_ab_bar]
    return np.array([[one.closed if closed else one.pressure for one in row] for row in rows])


def lowest_stable_bar(c: Array, closed: bool, low: float = 0.1, high: float = 1.0, theta2_deg: float = 0.0) -> float:
    """Smallest p_AB in bar at which the arm stands by itself, by bisection; `low` where it still does there."""

    def firm(p_ab: float) -> float:
        one = firmness(c, theta2_deg, p_ab)
        return one.closed if closed else one.pressure

    if firm(low) > 0.0:
        return low
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if firm(middle) > 0.0 else (middle, high)
    return 0.5 * (low + high)


def rests(c: Array, p_a_bar: float, p_b_bar: float, angles_deg: Array) -> list[tuple[float, bool]]:
    """Angles in deg at which two pressures balance (to the grid), and whether the arm stays there."""
    torque = np.array([acceleration(c, float(q), p_a_bar, p_b_bar) for q in rad(angles_deg)])
    found = np.flatnonzero(torque[:-1] * torque[1:] <= 0.0)  # nan is no sign change
    return [(float(angles_deg[k]), bool(torque[k + 1] < torque[k])) for k in found]


def off_square_deg(c: Array, theta2_deg: float, p_ab_bar: float) -> float:
    """By how much the lines of theta2 and of p_AB in the plane of the pressures miss 90 deg.

    Positive where B counts more. Both axes in bar, as figure 5.1 has them.
    d theta/d p_i = (d torque/d p_i)/firmness: the size drops out.
    """
    a = linearise(c, theta2_deg, p_ab_bar).dynamics
    return float(45.0 - deg(np.arctan2(a[1, 2], -a[1, 3])))


def largest_gain(c: Array, theta2_deg: float, p_ab_bar: float) -> float:
    """Largest plain gain in V/rad that a loop of theta2 bears there, by kappa/(s3 + 2 zeta w s2 + w2 s)."""
    return gain_limit(*linearise(c, theta2_deg, p_ab_bar).third_order())


def gain_limit(kappa: float, f_hz: float, zeta: float) -> float:
    """Routh: gain kappa < 2 zeta w3."""
    return 2.0 * zeta * (TWO_PI * f_hz) ** 3 / kappa


def within_digits(draws: int, seed: int) -> list[dict[str, float]]:
    """Table 4.1's fitted row, drawn evenly within half a printed digit."""
    rng = np.random.default_rng(seed)
    made = []
    for spread in rng.uniform(-1.0, 1.0, (draws, len(STIFFNESS))):
        printed = [number(f"table_4_1.experiment.{name.removesuffix('_bar')}") for name in STIFFNESS]
        made.append(
            {
                f"stiffness_{name}": p.value + s * p.half_digit
                for name, p, s in zip(STIFFNESS, printed, spread, strict=True)
            }
        )
    return made


def held_at_length(length_m: float) -> dict[str, float]:
    """The fitted stiffness without its dependence on the length: k(p, h) = k(p, `length_m`)."""
    p = {name: ARM1_PARAMETERS.rows[ARM1_PARAMETERS.index(f"stiffness_{name}")].value for name in STIFFNESS}
    per_bar = p["k0"] + p["k1"] * length_m + p["k2"] * length_m**2
    offset = p["b_bar"] * (p["c0"] * p["k0"] + p["c1"] * p["k1"] * length_m + p["k2"] * length_m**2)
    names = [f"stiffness_{name}" for name in STIFFNESS]
    return dict(zip(names, (offset / per_bar, per_bar, 0.0, 0.0, 1.0, 1.0), strict=True))
