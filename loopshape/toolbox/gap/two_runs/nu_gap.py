"""The nu-gap between two measured plants: how far apart they are for a controller that holds one of them.

Vinnicombe (IEEE TAC 38, 1993; Uncertainty and Feedback, 2001): with kappa = |P1 - P2| / sqrt((1 + |P1|²)(1 + |P2|²))
the nu-gap is max kappa where wno(1 + P2* P1) + eta(P1) - eta(P2) - eta0(P2) = 0, else 1; eta counts poles in the
right half plane, eta0 those on the axis, and the contour passes these on the right. It weighs plants that
are loop-shaped, P times controller: there a gap below the loop's own stability margin b is tolerated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, deg
from loopshape.data.control.controller import Controller
from loopshape.data.response.frf import FRF


@dataclass(frozen=True, eq=False)
class NuGap:
    """A nu-gap from data: `value` with the errors' upward pull taken off, None where it is undecided.

    `interval` (95 %) reaches to 1 where the winding number is undecided. `winding` is "holds", "fails" (then the
    nu-gap is 1) or "undecided", and `reason` says why. `kappa` and `kappa_std` (nf,) stand on `frequency_hz`;
    `largest_kappa` at `at_hz` is their face value, which noise pulls up. Frequencies that were not measured are not
    in it.
    """

    value: float | None
    interval: tuple[float, float]
    winding: str
    reason: str
    largest_kappa: float
    at_hz: float
    frequency_hz: Array
    kappa: Array
    kappa_std: Array


def shaped(plant: FRF, controller: Controller) -> FRF:
    """The loop-shaped plant C P (1 x 1) with its covariance; the controller as it runs."""
    C = controller.response(plant.frequency_hz)
    return replace(
        plant,
        response=plant.response * C[:, None, None],
        covariance=plant.covariance * (np.abs(C) ** 2)[:, None, None],
    )


def kappa(first: ComplexArray, second: ComplexArray) -> Array:
    """Chordal distance (nf,) of two responses (nf,), between 0 and 1."""
    return np.asarray(np.abs(first - second) / np.sqrt((1.0 + np.abs(first) ** 2) * (1.0 + np.abs(second) ** 2)))


def nu_gap(
    first: FRF,
    second: FRF,
    *,
    integrators: tuple[int | None, int | None] = (None, None),
    unstable_poles: tuple[int, int] = (0, 0),
) -> NuGap:
    """Nu-gap of two FRFs (1 x 1) on the same lines, usually loop-shaped plants, with a 95 % interval.

    `integrators` are the poles at s = 0 of each (None: from the slope of the lowest lines), `unstable_poles` those in
    the right half plane; a wrong word gives a wrong answer. Below the first line the plants are carried on as
    1/s^k, above the last they must have fallen below 1. Refuses FRFs whose lines differ.
    """
    if not np.array_equal(first.frequency_hz, second.frequency_hz):
        raise WrongUseError(
            "a nu-gap needs frequencies that both plants share",
            f"{first.frequency_hz.size} and {second.frequency_hz.size} frequencies that differ",
            "estimate both alike, or select the common frequencies",
        )
    orders = [order_of(x) if k is None else k for x, k in zip((first, second), integrators, strict=True)]
    size, std = _kappa_and_std(first, second)
    value, low, high = _greatest(size, std, first, second)
    face = kappa(first.siso, second.siso)
    k = int(np.argmax(face))
    winding, reason = _condition(first, second, orders, unstable_poles)
    if winding == "fails":
        value, low, high = 1.0, 1.0, 1.0
    return NuGap(
        value=None if winding == "undecided" else value,
        interval=(low, 1.0 if winding == "undecided" else high),
        winding=winding,
        reason=reason,
        largest_kappa=float(face[k]),
        at_hz=float(first.frequency_hz[k]),
        frequency_hz=first.frequency_hz,
        kappa=face,
        kappa_std=std,
    )


def order_of(plant: FRF) -> int | None:
    """Number of integrators by the slope of the lowest lines (a factor of 1.6, four at least); None where unclear.

    A plant whose lowest corner lies above its lowest lines looks like one without integrators, one whose corner lies
    below them like one with: for the nu-gap of two plants on these lines that makes no difference.
    """
    f = plant.frequency_hz
    count = min(max(4, int(np.searchsorted(f, 1.6 * f[0]))), f.size)
    if count < 2:
        return None
    slope = -float(np.polyfit(np.log(f[:count]), np.log(np.abs(plant.siso[:count])), 1)[0])
    order = round(slope)
    slope_fit = 0.35  # the slope of the lowest lines must lie this close to a whole number of integrators
    return order if order >= 0 and abs(slope - order) < slope_fit else None


def _kappa_and_std(first: FRF, second: FRF) -> tuple[Array, Array]:
    """Kappa (nf,) without the part that noise alone gives, and its standard deviation by the delta method."""
    P1, P2 = first.siso, second.siso
    v1, v2 = first.variance[:, 0, 0], second.variance[:, 0, 0]
    A1, A2 = 1.0 + np.abs(P1) ** 2, 1.0 + np.abs(P2) ** 2
    d = P1 - P2
    toward = np.conj(d) / np.maximum(np.abs(d) ** 2, 1e-300)
    face = np.abs(d) / np.sqrt(A1 * A2)
    slope1, slope2 = face * np.abs(toward - P1.conj() / A1), face * np.abs(toward + P2.conj() / A2)
    std = np.sqrt(0.5 * (slope1**2 * v1 + slope2**2 * v2))
    return np.sqrt(np.maximum(face**2 - (v1 + v2) / (A1 * A2), 0.0)), np.asarray(std)


def _greatest(size: Array, std: Array, first: FRF, second: FRF) -> tuple[float, float, float]:
    """The maximum of a curve known with errors, and its 95 % interval.

    The largest of m noisy values lies too high by what the largest of m errors does; taking the m-th root's
    quantile of the error off every line before the maximum removes that (Chernozhukov, Lee, Rosen 2013).
    Only lines that may hold the maximum count, `line_overlap` of them as one.
    """
    overlap = max(first.line_overlap, second.line_overlap)
    freedom = min(first.variance_freedom, second.variance_freedom, 1e6)

    def quantile(p: float, lines: int) -> float:
        return float(stdtrit(freedom, p ** (1.0 / max(lines / overlap, 1.0))))

    wide = quantile(0.975, size.size)
    held = size >= (size - wide * std).max() - 2.0 * wide * std
    lines = int(np.count_nonzero(held))
    low = float((size - quantile(0.975, lines) * std)[held].max())
    near = held & (size + std >= (size - std).max())
    middle = float((size - quantile(0.5, int(np.count_nonzero(near))) * std)[near].max())
    high = float((size + quantile(0.975, 1) * std)[held].max())
    return max(middle, 0.0), max(low, 0.0) if _differ(first, second, overlap) else 0.0, min(high, 1.0)


def _differ(first: FRF, second: FRF, overlap: float) -> bool:
    """Whether any line differs by more than the largest of all errors does in 97.5 % of cases."""
    variance = first.variance[:, 0, 0] + second.variance[:, 0, 0]
    chance = -np.log(-np.expm1(np.log(0.975) / max(variance.size / overlap, 1.0)))
    return bool(np.any(np.abs(first.siso - second.siso) ** 2 > chance * variance))


def _condition(first: FRF, second: FRF, orders: list[int | None], unstable_poles: tuple[int, int]) -> tuple[str, str]:
    """Whether Vinnicombe's condition holds, fails, or cannot be decided, and why."""
    one, two = orders
    if one is None or two is None:
        return (
            "undecided",
            "the number of integrators does not follow from the slope at the lowest frequencies: declare it",
        )
    unclear = _uncountable(first, second)
    if unclear:
        return "undecided", unclear
    wno = winding_number(first.siso, second.siso, (one, two))
    f = first.frequency_hz[0]
    if wno is None:
        return "undecided", f"the phases at the lowest frequency ({f:.3g} Hz) do not fit {one} and {two} integrators"
    total = wno + unstable_poles[0] - unstable_poles[1] - two
    if total:
        return "fails", f"1 + P2* P1 winds {abs(total)} times too {'often' if total > 0 else 'seldom'}"
    return "holds", "the winding number of 1 + P2* P1 balances the poles"


def _uncountable(first: FRF, second: FRF) -> str:
    """Why the lines cannot carry a winding number, empty where they can."""
    P1, P2, f = first.siso, second.siso, first.frequency_hz
    product = np.conj(P2) * P1
    g = 1.0 + product
    if abs(product[-1]) >= 1.0:
        return f"|P1 P2| is still {abs(product[-1]):.2g} at the highest frequency, {f[-1]:.3g} Hz: measure higher"
    steps = np.abs(deg(np.angle(g[1:] * g[:-1].conj())))
    # between lines 1 + P2* P1 may turn by this much before the sampling is called too coarse to count, in deg
    coarse_deg = 135.0
    if steps.size and steps.max() > coarse_deg:
        k = int(np.argmax(steps))
        return f"1 + P2* P1 turns by {steps[k]:.0f} deg between {f[k]:.4g} and {f[k + 1]:.4g} Hz: measure finer there"
    variance = np.abs(P2) ** 2 * first.variance[:, 0, 0] + np.abs(P1) ** 2 * second.variance[:, 0, 0]
    near = np.flatnonzero(np.abs(g) <= 2.45 * np.sqrt(0.5 * variance))  # radius of 95 % of a circular error
    if near.size:
        return f"1 + P2* P1 is zero within its uncertainty at {f[near[0]]:.3g} Hz: measure longer or excite more"
    return ""


def winding_number(first: ComplexArray, second: ComplexArray, integrators: tuple[int, int]) -> int | None:
    """wno(1 + P2* P1), zeros less poles in the right half plane, from responses (nf,); None where the start fits badly.

    On the indentation s = eps e^(j phi), k poles at zero turn P2* P1 by -k 90 deg in the upper half; then it runs
    in along their phase, (k2 - k1) 90 deg or opposite where the gains differ in sign, to the first line. Above the
    last line it is taken to stay below 1. Half the contour is followed, the other half mirrors it.
    """
    product = np.conj(second) * first
    g = 1.0 + product
    total = integrators[0] + integrators[1]
    ahead = complex(product[0]) * (-1j) ** (integrators[1] - integrators[0])
    swing = float(np.angle(ahead if ahead.real >= 0.0 else -ahead))
    if abs(deg(swing)) > 60.0:  # at the first line P2* P1 must lie this close to where the integrators put it, in deg
        return None
    if total:
        start = -0.5 * np.pi * total + swing + float(np.angle(g[0] / product[0]))
    else:
        start = float(np.angle(g[0] if ahead.real >= 0.0 or abs(product[0]) < 1.0 else -g[0]))
    turn = start + float(np.sum(np.angle(g[1:] / g[:-1]))) - float(np.angle(g[-1]))
    return round(-turn / np.pi)
