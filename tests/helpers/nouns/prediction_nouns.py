"""Predictions made up, for their pictures: S of a gain around an integrator, and a step."""

from dataclasses import replace

import numpy as np
from bench_nouns import Block, Step

import loopshape as ls
from loopshape.loop.predict.indicators import indicators
from loopshape.toolbox.validation.predicted.file import read_predictions, write_predictions

__all__ = ["predictions", "read_predictions", "sensitivity", "step", "write_predictions"]

GAIN = ls.Controller("theta2", (Block("gain", {"gain": 5.0}),), 1000.0)
T = np.linspace(0.0, 2.0, 200)


def sensitivity(point: float, gain: float = 1.0) -> ls.FRF:
    f = np.geomspace(0.1, 20.0, 40)
    P = gain / (2j * np.pi * f)
    frf = ls.FRF(
        f, P[:, None, None], (1e-3 * np.abs(P) ** 2)[:, None, None].astype(complex), np.ones(40, dtype=bool), ("z_v",),
        ("theta2_rad",), "made", recording=f"r{point:g}", loop="theta2", rate_hz=1000.0, recorded_under=GAIN,
        operating_point={"theta2_deg": point},
    )  # fmt: skip
    return replace(frf, response=1.0 / (1.0 + 5.0 * frf.response))


def step() -> Step:
    y = 1.0 - np.exp(-5.0 * T)
    return Step(T, y, y - 0.05, y + 0.05, indicators(T, y), "fit")


def predictions() -> list[ls.Prediction]:
    return [ls.Prediction(sensitivity(p), "stable", step()) for p in (0.0, 15.0)]
