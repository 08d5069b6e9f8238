"""Chains of volumes and hoses (appendix D): PTS1, PTS2 and PTS3 as one right-hand side, and ways to integrate it.

A chain has n volumes, each fed by one hose from the volume before it, the first from the supply: p_c, p_1, p_2, p_m
(n = 4, D.7-D.9) or p_c, p_m (n = 2, D.10). Hose n // 2 is the valve. Gauge pressures in Pa, SI throughout; the state's
last entry is the mass that the supply has given, in kg.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS

RT, P_ATM2, P_IN, HEAD = 0, 1, 2, 3
THROTTLE, POISEUILLE = 0.0, 1.0
IMPLICIT = ("Radau", "BDF")
EULER, BOGACKI_SHAMPINE, RK4 = 1, 3, 4
SETTINGS = tomllib.loads((Path(__file__).parent / "study.toml").read_text(encoding="utf-8"))


def arm_value(name: str) -> float:
    """A row of the arm's table of parameters."""
    return float(ARM1_PARAMETERS.rows[ARM1_PARAMETERS.index(name)].value)


def beta_m2(radius_mm: float) -> float:
    """Throttle parameter of a radius (D.6)."""
    return float(arm_value("throttle_factor") * np.sqrt(2.0) * np.pi * (1e-3 * radius_mm) ** 2)


@dataclass(frozen=True)
class Bench:
    """The test setup: what appendix D does not publish, and the capacity."""

    volume_l: float
    hose_radius_mm: float
    hose_length_m: float
    valve_volume_ml: float
    valve_length_mm: float
    viscosity_pa_s: float
    capacity_l: float = 1e3 * arm_value("capacity_m3")
    small_factor: float = 1.0

    @property
    def small_m3(self) -> float:
        """Each of the two small volumes: a hose and half of what the valve holds."""
        hose = np.pi * (1e-3 * self.hose_radius_mm) ** 2 * self.hose_length_m
        return float(self.small_factor * (hose + 1e-6 * self.valve_volume_ml))

    @property
    def throttles_m2(self) -> Array:
        """Throttle parameters (4,): reduction valve, hose, valve, hose."""
        hose = beta_m2(self.hose_radius_mm)
        return np.array([beta_m2(arm_value("throttle_in_mm")), hose, beta_m2(arm_value("throttle_supply_mm")), hose])

    @property
    def conductances(self) -> Array:
        """Hagen-Poiseuille's conductances (4,) in m3/(s Pa) by dimensions (D.3): hose, hose, short valve, hose."""

        def of(radius_mm: float, length_m: float) -> float:
            return np.pi * (1e-3 * radius_mm) ** 4 / (8.0 * length_m * self.viscosity_pa_s)

        hose = of(self.hose_radius_mm, self.hose_length_m)
        return np.array([hose, hose, of(arm_value("throttle_supply_mm"), 1e-3 * self.valve_length_mm), hose])

    def volumes_m3(self) -> Array:
        """Volumes (4,): capacity, small, small, test volume."""
        return np.array([1e-3 * self.capacity_l, self.small_m3, self.small_m3, 1e-3 * self.volume_l])


def bench(**changes: float) -> Bench:
    """The study's bench, with changes."""
    return replace(Bench(**SETTINGS["assumed"]), **changes)


def chain(volumes: Array, hoses: Array, laws: Sequence[float]) -> Array:
    """Constants of a chain (3 + 3 n,): gas, supply; volumes, hose parameters and flow laws."""
    gas = [arm_value("gas_constant_j_kgk") * arm_value("temperature_k"), 2e5 * arm_value("atmosphere_bar")]
    return np.array([*gas, 1e5 * arm_value("supply_bar"), *volumes, *hoses, *laws])


def pts1(b: Bench, conductances: Array | None = None) -> Array:
    """Poiseuille flow and small volumes (D.7, D.8)."""
    return chain(b.volumes_m3(), b.conductances if conductances is None else conductances, [POISEUILLE] * 4)


def pts2(b: Bench) -> Array:
    """Throttles and small volumes (D.7, D.9)."""
    return chain(b.volumes_m3(), b.throttles_m2, [THROTTLE] * 4)


def pts3(b: Bench, *, in_series: bool = True, lumped: bool = False) -> Array:
    """Throttles without small volumes (D.10).

    The one throttle is the valve's, or with `in_series` what hose, valve and hose come to: rho (p1 - p2) is a
    difference of squared absolute pressures, so 1/beta^2 adds up exactly. `lumped` gives the small volumes to their
    neighbours.
    """
    betas, volumes = b.throttles_m2, b.volumes_m3()
    beta = float(np.sum(betas[1:] ** -2.0) ** -0.5) if in_series else float(betas[2])
    own = volumes[[0, 3]] + (volumes[[1, 2]] if lumped else 0.0)
    return chain(own, np.array([betas[0], beta]), [THROTTLE] * 2)


@compiled
def flows(c: Array, x: Array, valve: float, q: Array) -> None:
    """Mass flows (n,) in kg/s through the hoses of a chain, from the supply on, into `q`."""
    n = q.size
    for k in range(n):
        before = c[P_IN] if k == 0 else x[k - 1]
        drop = before - x[k]
        rho = (before + x[k] + c[P_ATM2]) / (2 * c[RT])
        if c[HEAD + 2 * n + k] == 0:
            q[k] = c[HEAD + n + k] * np.sign(drop) * np.sqrt(rho * np.abs(drop))
        else:
            q[k] = c[HEAD + n + k] * rho * drop
    q[n // 2] *= valve


@compiled
def rates(c: Array, x: Array, valve: float, q: Array, dx: Array) -> None:
    """Rates (n + 1,) of the pressures (3.20, fixed volumes) and of the supplied mass, into `dx`; fills `q` too."""
    flows(c, x, valve, q)
    n = q.size
    for k in range(n):
        after = q[k + 1] if k + 1 < n else 0 * q[k]
        dx[k] = c[RT] * (q[k] - after) / c[HEAD + k]
    dx[n] = q[0]


@compiled
def slopes(c: Array, x: Array, valve: float, least: float, jac: Array) -> None:
    """Jacobian (n + 1, n + 1) of `rates` into `jac`; a throttle's slope is held finite by `least` in (kg/s/m2)^2.

    With absolute pressures rho (p1 - p2) is w = (P1^2 - P2^2)/(2 R T).
    """
    n = (c.size - HEAD) // 3
    jac[:] = 0.0
    for k in range(n):
        before = (c[P_IN] if k == 0 else x[k - 1]) + c[P_ATM2] / 2
        behind = x[k] + c[P_ATM2] / 2
        slope = c[HEAD + n + k] / c[RT]
        if c[HEAD + 2 * n + k] == 0:
            w = abs(before * before - behind * behind) / (2 * c[RT])
            slope /= 2 * np.sqrt(max(w, least))
        if k == n // 2:
            slope *= valve
        for column, p in ((k - 1, slope * before), (k, -slope * behind)):
            if column >= 0:
                jac[k, column] += c[RT] * p / c[HEAD + k]
                if k > 0:
                    jac[k - 1, column] -= c[RT] * p / c[HEAD + k - 1]
            if k == 0:
                jac[n, 0] = -slope * behind


@compiled
def march(c: Array, x0: Array, valve: float, step_s: float, keep: int, method: int, out: Array, flow: Array) -> None:
    """Fixed steps: `keep` of them between rows of `out` (rows, n + 1) and `flow` (rows, n); the first row is x0.

    Euler's, Bogacki and Shampine's third-order or the classical fourth-order method, whatever the pressures do.
    """
    n = flow.shape[1]
    x, y, q, h = x0.copy(), x0.copy(), flow[0].copy(), step_s
    k1, k2, k3, k4 = x0.copy(), x0.copy(), x0.copy(), x0.copy()
    for row in range(out.shape[0]):
        flows(c, x, valve, flow[row])
        out[row] = x
        if row + 1 == out.shape[0]:
            break
        for _ in range(keep):
            rates(c, x, valve, q, k1)
            if method == EULER:
                for i in range(n + 1):
                    x[i] += h * k1[i]
                continue
            for i in range(n + 1):
                y[i] = x[i] + h / 2 * k1[i]
            rates(c, y, valve, q, k2)
            if method == BOGACKI_SHAMPINE:
                for i in range(n + 1):
                    y[i] = x[i] + h * 3 / 4 * k2[i]
                rates(c, y, valve, q, k3)
                for i in range(n + 1):
                    x[i] += h / 9 * (2 * k1[i] + 3 * k2[i] + 4 * k3[i])
                continue
            for i in range(n + 1):
                y[i] = x[i] + h / 2 * k2[i]
            rates(c, y, valve, q, k3)
            for i in range(n + 1):
                y[i] = x[i] + h * k3[i]
            rates(c, y, valve, q, k4)
            for i in range(n + 1):
                x[i] += h / 6 * (k1[i] + 2 * (k2[i] + k3[i]) + k4[i])


@dataclass(frozen=True, eq=False)
class Filling:
    """Pressures (rows, n) in bar, flows (rows, n) in kg/s and supplied mass (rows,) over time (rows,) in s."""

    t_s: Array
    p_bar: Array
    q_kg_s: Array
    supplied_kg: Array
    evaluations: int = 0

    def reaches_s(self, bar: float, column: int = -1) -> float:
        """When a pressure first passes a level, linear between rows; nan where it does not."""
        p = self.p_bar[:, column]
        above = np.flatnonzero(p >= bar)
        if not above.size or above[0] == 0:
            return float("nan")
        k = int(above[0])
        return float(self.t_s[k - 1] + (self.t_s[k] - self.t_s[k - 1]) * (bar - p[k - 1]) / (p[k] - p[k - 1]))


def start(c: Array) -> Array:
    """At rest before the valve opens (n + 1,): everything before it at the supply's pressure, behind it at 0."""
    n = (c.size - HEAD) // 3
    return np.r_[np.where(np.arange(n) < n // 2, c[P_IN], 0.0), 0.0]


def rows_s(end_s: float) -> Array:
    """The times that tables and figures look at, (rows,)."""
    return np.linspace(0.0, end_s, round(end_s * SETTINGS["runs"]["rows_per_s"]) + 1)


def implicit(c: Array, end_s: float, *, method: str = "Radau", **how: Any) -> Filling:
    """The chain by scipy's solver from the opened valve on."""
    settings = SETTINGS["runs"]
    how = {"rtol": settings["rtol"], "atol": settings["atol_pa"]} | how
    n = (c.size - HEAD) // 3
    scale = np.r_[np.ones(n), 1e-8]  # the supplied mass is of another size than the pressures

    def right(_: float, y: Array) -> Array:
        q, dx = np.empty(n), np.empty(n + 1)
        rates(c, y * scale, 1.0, q, dx)
        return dx / scale

    def bent(_: float, y: Array) -> Array:
        jac = np.empty((n + 1, n + 1))
        slopes(c, y * scale, 1.0, settings["least_w"], jac)
        return jac * (scale / scale[:, None])

    t, also = rows_s(end_s), {"jac": bent} if method in IMPLICIT else {}
    found = solve_ivp(right, (0.0, end_s), start(c) / scale, method=method, t_eval=t, **also, **how)
    if not found.success:
        raise RuntimeError(f"{method} stopped before {end_s:g} s: {found.message}")
    return filling(c, t, found.y.T * scale, found.nfev)


def pulsed(c: Array, end_s: float, edges_s: Sequence[float], open_first: bool = True) -> Filling:
    """The chain under a valve that changes at each edge, by fine RK4 that hits the edges; these lie on the rows.

    Implicit solvers stall here: with the valve shut a throttle's flow dies out in finite time, at an infinite slope.
    """
    rows_per_s, step_s = SETTINGS["runs"]["rows_per_s"], SETTINGS["runs"]["pulsed_step_s"]
    bounds = np.round(np.r_[0.0, [e for e in edges_s if 0.0 < e < end_s], end_s] * rows_per_s).astype(int)
    keep, n = round(1.0 / (rows_per_s * step_s)), (c.size - HEAD) // 3
    out, flow, valve = np.zeros((bounds[-1] + 1, n + 1)), np.zeros((bounds[-1] + 1, n)), float(open_first)
    out[0] = start(c)
    for a, b in pairwise(bounds):
        march(c, out[a].copy(), valve, step_s, keep, RK4, out[a : b + 1], flow[a : b + 1])
        valve = 1.0 - valve
    return Filling(rows_s(end_s), 1e-5 * out[:, :-1], flow, out[:, -1])


def filling(c: Array, t: Array, x: Array, evaluations: int) -> Filling:
    """A run with the flows that belong to its states."""
    q = np.zeros((t.size, x.shape[1] - 1))
    for row in range(t.size):
        flows(c, x[row], 1.0, q[row])
    return Filling(t, 1e-5 * x[:, :-1], q, x[:, -1], evaluations)


def explicit(
    c: Array, end_s: float, step_s: float, method: int = RK4, kind: type = np.float64, keep: int | None = None
) -> Filling:
    """The chain by fixed steps from the opened valve on, in `kind`'s precision; a row every `keep` steps.

    Without `keep` an odd number of steps lies between rows: what changes sign at every step is seen with both signs.
    """
    keep = keep or 2 * (round(1.0 / (SETTINGS["runs"]["rows_per_s"] * step_s)) // 2) + 1
    rows = round(end_s / (keep * step_s)) + 1
    n = (c.size - HEAD) // 3
    out, flow = np.zeros((rows, n + 1), dtype=kind), np.zeros((rows, n), dtype=kind)
    run = march if kind is not np.longdouble else _plain
    with np.errstate(invalid="ignore", over="ignore"):
        run(c.astype(kind), start(c).astype(kind), kind(1.0), kind(step_s), keep, method, out, flow)
    t = step_s * keep * np.arange(rows)
    return Filling(t, 1e-5 * out[:, :-1].astype(float), flow.astype(float), out[:, -1].astype(float))


def _plain(c: Array, x: Array, valve: float, step_s: Any, keep: int, method: int, out: Array, flow: Array) -> None:
    """Bogacki and Shampine's steps without numba, for numbers that numba does not have."""
    own_flows, n = getattr(flows, "py_func", flows), flow.shape[1]

    def slope(y: Array) -> Array:
        q = np.zeros_like(flow[0])
        own_flows(c, y, valve, q)
        return np.r_[c[RT] * (q - np.r_[q[1:], 0 * q[:1]]) / c[HEAD : HEAD + n], q[:1]]

    assert method == BOGACKI_SHAMPINE
    for row in range(out.shape[0]):
        out[row] = x
        own_flows(c, x, valve, flow[row])
        for _ in range(keep):
            k1 = slope(x)
            k2 = slope(x + step_s / 2 * k1)
            k3 = slope(x + step_s * 3 / 4 * k2)
            x = x + step_s / 9 * (2 * k1 + 3 * k2 + 4 * k3)


def block_edges(frequency_hz: float, duty: float, end_s: float, longer_s: float = 0.0) -> list[float]:
    """Closing and opening times of a valve that is open from 0; `longer_s`: closing lags so much behind opening."""
    period = 1.0 / frequency_hz
    on = duty * period + longer_s
    return [begin + t for begin in period * np.arange(np.ceil(end_s * frequency_hz)) for t in (on, period)]


def filled_bar(c: Array, t_s: Array, p_c_bar: float) -> Array:
    """Pressure in bar behind one throttle from a constant p_c, in closed form: P = P_c sin(phi + kappa t), absolute.

    With squared absolute pressures the throttle's law is dP/dt = kappa sqrt(P_c^2 - P^2): the filling ends in finite
    time, with a knee. `c` is of PTS3.
    """
    kappa = c[HEAD + 3] / c[HEAD + 1] * np.sqrt(0.5 * c[RT])
    atmosphere = 0.5e-5 * c[P_ATM2]
    top = p_c_bar + atmosphere
    return top * np.sin(np.minimum(np.arcsin(atmosphere / top) + kappa * t_s, 0.5 * np.pi)) - atmosphere
