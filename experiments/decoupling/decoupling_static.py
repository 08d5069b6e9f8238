"""A static 2 x 2 matrix between the controllers and the plant: the best one, and what it does to k_I and to margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from decoupling_measure import LIMIT_DB, LOOPS, Found

from loopshape.core.units import Array, ComplexArray
from loopshape.data.control.controller import Controller
from loopshape.data.requirement.requirements import Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.margins import Margins
from loopshape.identify.fit import fit, structure_by_name
from loopshape.loop.loops import loops_of
from loopshape.loop.margin.margins import margins
from loopshape.toolbox.diagrams.coupling.interaction import interaction
from loopshape.toolbox.diagrams.coupling.nouns import BandVerdict


def mixed(frf: FRF, W: Array) -> FRF:
    """The FRF of P W with its covariance: vec(P W) = (W^T x I) vec(P)."""
    K = np.kron(W.T, np.eye(2))
    parts = {"covariance": frf.covariance, "noise_covariance": frf.noise_covariance}
    carried = {name: K @ C @ K.T for name, C in parts.items() if C is not None}
    return replace(frf, response=frf.response @ W, **carried)  # type: ignore[arg-type]


def best(plants: Sequence[ComplexArray], odd_in: Sequence[float] | None = None) -> Array:
    """The two numbers (w12, w21) of W = [[1, w12], [w21, 1]] that leave least in P W off its diagonal, least squares.

    `plants` are (nf, 2, 2) each. With `odd_in`, a number for each plant, W's elements are w12 and w21 times it.
    """
    scale = np.ones(len(plants)) if odd_in is None else np.asarray(odd_in, dtype=float)
    found = []
    for own, other in (((0, 0), (0, 1)), ((1, 1), (1, 0))):
        x = np.concatenate([s * P[:, own[0], own[1]] for P, s in zip(plants, scale, strict=True)])
        y = np.concatenate([P[:, other[0], other[1]] for P in plants])
        found.append(-float(np.real(np.vdot(x, y)) / np.real(np.vdot(x, x))))
    return np.array(found)


def matrix(w: Array) -> Array:
    """W with ones on its diagonal."""
    return np.array([[1.0, w[0]], [w[1], 1.0]])


def lines(one: Found, band_hz: tuple[float, float]) -> np.ndarray:
    """Trusted lines of a band."""
    f = one.frf.frequency_hz
    return np.asarray(one.frf.valid & (f >= band_hz[0]) & (f <= band_hz[1]))


def matrices(found: Sequence[Found]) -> dict[str, list[Array]]:
    """W of each equilibrium by the way it is found, from all valid lines that are looked at."""
    use = [lines(one, (one.bands_hz["below"][0], one.bands_hz["above"][1])) for one in found]
    measured = [one.frf.response[k] for one, k in zip(found, use, strict=True)]
    linear = [one.bare[k] for one, k in zip(found, use, strict=True)]
    angles = [one.theta2_deg for one in found]
    slope = best(measured, angles)
    return {
        "none": [np.eye(2) for _ in found],
        "one for all": [matrix(best(measured)) for _ in found],
        "proportional to theta2": [matrix(slope * theta) for theta in angles],
        "own, linearised": [matrix(best([P])) for P in linear],
        "own, measured": [matrix(best([P])) for P in measured],
    }


def behind(one: Found, W: Array) -> dict[str, BandVerdict]:
    """The verdicts behind W, with bounds, by the name of the band."""
    found = interaction(mixed(one.frf, W), LOOPS, bands=tuple(one.bands_hz.values()), limit_db=LIMIT_DB)
    return dict(zip(one.bands_hz, found.verdicts, strict=True))


def loop_margins(
    one: Found, W: Array, controllers: Mapping[str, Controller], asked: Mapping[str, Requirements]
) -> dict[tuple[str, str], Margins]:
    """Margins of each loop with the other open and closed, by (loop, "open" or "closed").

    A third-order fit tells how the angle's plant goes on below the lowest line, as for the FRFs that are tuned to.
    """
    whole = interaction(mixed(one.frf, W), LOOPS, controllers, bands=[one.bands_hz["bandwidth"]], limit_db=LIMIT_DB)
    out = {}
    for e in whole.equivalents:
        for word, frf in (("open", e.open), ("closed", e.closed)):
            fits = [fit(frf, structure_by_name("third_order"))] if e.loop == "theta2" else []
            loops, _ = loops_of([frf], controllers[e.loop], replace(asked[e.loop], integrators=1), fits)
            out[e.loop, word] = margins(loops[0])
    return out
