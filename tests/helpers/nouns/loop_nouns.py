"""Loops of a known plant with noise, as a check makes them: smoothed, with scatter, and their verdict."""

from dataclasses import replace
from functools import cache

import numpy as np
import picture_nouns as nouns
from bench_nouns import Block, Loop, TransferFunction
from conversions import TWO_PI

import loopshape as ls
from loopshape.loop.loops import loops_of

RATE = 1000.0
#: the operating point whose gain is so large that the check fails there
STRONG = 3


def plant() -> TransferFunction:
    """An integrator, two lags and a delay: with unit gain |S| peaks at 8.4 dB."""
    lags = np.polymul([1.0 / (TWO_PI * 8.0), 1.0], [1.0 / (TWO_PI * 20.0), 1.0])
    return TransferFunction([51.8], np.polymul([1.0, 0.0], lags), 0.0027)


def noisy(
    truth: TransferFunction, noise: float = 0.1, floor: float = 0.0, seed: int = 1, f: np.ndarray | None = None
) -> ls.FRF:
    """Lines with circular noise: a share of each and a floor."""
    f = np.geomspace(0.1, 60.0, 400) if f is None else f
    rng = np.random.default_rng(seed)
    response = truth.response(f)
    variance = (noise * np.abs(response)) ** 2 + floor**2
    error = np.sqrt(0.5 * variance) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    return ls.FRF(
        f, (response + error)[:, None, None], variance[:, None, None] + 0j, np.ones(f.size, dtype=bool), ("z_v",),
        ("y_rad",), "made up", recording="noisy", loop="axis", rate_hz=RATE,
    )  # fmt: skip


def gain(value: float = 1.0) -> ls.Controller:
    return ls.Controller("axis", (Block("gain", {"gain": value}),), RATE)


def required(**changes: object) -> ls.Requirements:
    given: dict[str, object] = {
        "loop": "axis",
        "integrators": 1,
        "unstable_poles": 0,
        "sensitivity_peak_db": 6.0,
        "phase_margin_deg": 30.0,
    }
    return ls.Requirements(**(given | changes))  # type: ignore[arg-type]


def checked(frf: ls.FRF, controller: ls.Controller, requirements: ls.Requirements) -> tuple[Loop, ls.Verdict]:
    (loop,), _ = loops_of([frf], controller, requirements)
    return loop, ls.check([frf], controller, requirements)


@cache
def arm() -> tuple[list[Loop], ls.Requirements, ls.Verdict]:
    """24 operating points of picture_nouns with 10 % noise, and what a check says: some passed, failed, undecided."""
    frfs = [nouns.frf(*point, noise=0.1) for point in nouns.POINTS]
    frfs[STRONG] = replace(frfs[STRONG], response=3.0 * frfs[STRONG].response, covariance=9.0 * frfs[STRONG].covariance)
    requirements = replace(nouns.requirements(), integrators=1, unstable_poles=0)
    loops, _ = loops_of(frfs, nouns.controller(), requirements)
    return loops, requirements, ls.check(frfs, nouns.controller(), requirements)
