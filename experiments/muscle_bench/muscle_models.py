"""Muscle models beside the source's own: Chou-Hannaford (E.7), Petrovic (E.12), threshold (E.11), barrel (E.17).

Each gives the pull in N at a gauge pressure in bar and a length in m; slopes over the length are at constant pressure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from muscle_law import nominal_length_m, printed, volume_slopes

from loopshape.core.units import Array
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS
from loopshape.toolbox.arm.source import value

STEP_M = 1e-6
V = {row.name: row.value for row in ARM1_PARAMETERS.rows}
FOUR_L2 = 4e-6 * V["braid_length_mm"] ** 2
TURNS = 4.0 * np.pi * V["braid_turns"] ** 2
ConstraintMultiplier = Callable[[Array, Array], Array]


def chou_hannaford(p_bar: Array, h_m: Array) -> Array:
    """E.7: a cylinder of constant thread length."""
    return np.asarray(1e5 * p_bar * (3.0 * h_m**2 - FOUR_L2) / TURNS)


def petrovic(p_bar: Array, h_m: Array) -> Array:
    """E.12, E.13: the same as a polynomial in h - h_r."""
    h_r = value("e_4.reference_length")
    s0, s1, s2 = (3.0 * h_r**2 - FOUR_L2) / TURNS, 6.0 * h_r / TURNS, 3.0 / TURNS
    q = h_m - h_r
    return np.asarray(1e5 * p_bar * (s0 + s1 * q + s2 * q**2))


def threshold(p_bar: Array, h_m: Array, p_th_bar: float) -> Array:
    """E.11: a spring from the shortest length, by pressure above a threshold, by the tube alone below it."""
    shortest = np.sqrt(FOUR_L2 / 3.0)
    per_bar = 1e5 * 6.0 * value("e_4.reference_length") / TURNS
    stiff = np.where(p_bar > p_th_bar, per_bar * (p_bar - p_th_bar), value("e_28.tube_stiffness"))
    return np.asarray(stiff * (h_m - shortest))


def barrel(p_bar: Array, h_m: Array) -> Array:
    """E.17: virtual work on the barrel's volume, a pull where the volume falls with the length."""
    slopes = np.vectorize(lambda h: volume_slopes(float(h))[1], otypes=[float])
    return np.asarray(-1e5 * p_bar * slopes(h_m))


def fitted(p_bar: Array, h_m: Array) -> Array:
    """The source's own: (3.47) at rest, with the printed fitted stiffness."""
    return np.asarray(printed().stiffness(p_bar, h_m) * (h_m - nominal_length_m(p_bar)))


def analytical(p_bar: Array, h_m: Array) -> Array:
    """The source's own with the printed analytical stiffness."""
    return np.asarray(printed("analytical").stiffness(p_bar, h_m) * (h_m - nominal_length_m(p_bar)))


def slope(model: ConstraintMultiplier, p_bar: Array, h_m: Array) -> Array:
    """dF/dh in N/m at constant pressure."""
    return np.asarray((model(p_bar, h_m + STEP_M) - model(p_bar, h_m - STEP_M)) / (2.0 * STEP_M))


def cylinder_volume(h_m: float) -> tuple[float, float, float]:
    """V, dV/dh and d2V/dh2 of Chou and Hannaford's cylinder, SI."""
    return h_m * (FOUR_L2 - h_m**2) / TURNS, (FOUR_L2 - 3.0 * h_m**2) / TURNS, -6.0 * h_m / TURNS


def barrel_volume(h_m: float) -> tuple[float, float, float]:
    """The same of the source's barrel."""
    volume, first, second = volume_slopes(h_m)[:3].tolist()
    return volume, first, second


def closed_slope(
    shape: Callable[[float], tuple[float, float, float]], p_bar: float, h_m: float, exponent: float = 1.0
) -> float:
    """dF/dh in N/m of a muscle that nothing was fitted to: virtual work on its volume, closed air, and the rubber tube.

    F = -p dV/dh with the absolute pressure falling as V^-exponent, and the tube alone (E.28) beside it: the bench's
    slope by first principles, without friction.
    """
    volume, first, second = shape(h_m)
    absolute_pa = 1e5 * (p_bar + V["atmosphere_bar"])
    gas = exponent * absolute_pa * first**2 / volume
    return float(-1e5 * p_bar * second + gas + value("e_28.tube_stiffness"))


def share_apart(a: Array, b: Array, limit: float) -> float:
    """Share of places where b differs from a by more than `limit` of a."""
    return float(np.mean(np.abs(b - a) > limit * np.abs(a)))


@dataclass(frozen=True)
class Comparison:
    """One model beside the source's: shares of the grid apart and median ratios, below and above 1.5 bar."""

    model: str
    quantity: str
    numbers: tuple[float, float, float, float]


def model_pulls(words: Mapping[str, Any]) -> dict[str, ConstraintMultiplier]:
    """The models beside the source's fitted one."""
    return {
        "Chou-Hannaford": chou_hannaford,
        "Petrovic": petrovic,
        "threshold": partial(threshold, p_th_bar=float(words["threshold_bar"])),
        "barrel": barrel,
        "analytical": analytical,
    }


def model_grid(words: Mapping[str, Any]) -> tuple[Array, Array]:
    """Pressures (n, 1) and lengths (1, n) over which models are compared."""
    p = np.linspace(*words["pressures_bar"], int(words["steps"]))
    h = 1e-3 * np.linspace(*words["lengths_mm"], int(words["steps"]))
    return p[:, None], h[None, :]


def compare_models(words: Mapping[str, Any]) -> list[Comparison]:
    """Shares of the grid where pull and slope differ from the source's fitted model, below and above 1.5 bar."""
    p, h = model_grid(words)
    below = np.broadcast_to(p < value("existing_models_above"), np.broadcast_shapes(p.shape, h.shape))
    out = []
    for name, pull in model_pulls(words).items():
        for quantity, take in (("pull", lambda m: m(p, h)), ("slope", lambda m: slope(m, p, h))):
            own, other = take(fitted), take(pull)
            parts = [(own[part], other[part]) for part in (below, ~below)]
            apart = [share_apart(a, b, float(words["apart_share"])) for a, b in parts]
            ratios = [float(np.median(b / a)) for a, b in parts]
            out.append(Comparison(name, quantity, (apart[0], apart[1], ratios[0], ratios[1])))
    return out


def closed_air(p_bar: Array, h_m: Array) -> dict[str, Array]:
    """Slopes (n,) in N/m with closed valves by first principles, by shape and by heat exchange."""
    shapes = {"cylinder": cylinder_volume, "barrel": barrel_volume}
    exchanges = {"isothermal": 1.0, "adiabatic": 1.4}
    return {
        f"{shape}, {exchange}": np.array(
            [closed_slope(volume, p, h, n) for p, h in zip(p_bar.tolist(), h_m.tolist(), strict=True)]
        )
        for shape, volume in shapes.items()
        for exchange, n in exchanges.items()
    }


def taylor() -> dict[str, float]:
    """E.24's and E.27's numbers computed exactly, with the pull's sign (minus the volume's derivatives); b of E.28."""
    h = value("e_4.reference_length")
    _, _, second, third, fourth = (-volume_slopes(h)).tolist()
    k0, k1, k2 = second, third, 0.5 * fourth
    flat = {"e_27.k0": k0 - k1 * h + k2 * h**2, "e_27.k1": k1 - 2.0 * k2 * h, "e_27.k2": k2}
    at = value("e_28.length")
    b = value("e_28.tube_stiffness") / (1e5 * (flat["e_27.k0"] + flat["e_27.k1"] * at + flat["e_27.k2"] * at**2))
    return {"e_24.k0": k0, "e_24.k1": k1, "e_24.k2": k2, **flat, "e_28.b": b}
