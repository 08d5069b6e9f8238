"""Loops on known plants, for the tests of bounds and schedules."""

import numpy as np
from bench_nouns import Block, Loop, TransferFunction
from conversions import db

import loopshape as ls
from loopshape.toolbox.limits.bound_nodes import nodes

RATE = 2000.0


def frf_of(model, name="one", low_hz=0.05, high_hz=100.0, lines=300):
    """An FRF without noise of anything with a `response`."""
    f = np.geomspace(low_hz, high_hz, lines)
    return ls.FRF(
        frequency_hz=f,
        response=np.asarray(model.response(f))[:, None, None],
        covariance=np.full((lines, 1, 1), 1e-20 + 0j),
        valid=np.ones(lines, dtype=bool),
        inputs=("z_v",),
        outputs=("y_rad",),
        method="known",
        recording=name,
        loop="one",
        rate_hz=RATE,
    )


def gain(value=1.0):
    return ls.Controller("one", (Block("gain", {"gain": value}),), RATE)


def loop_of(model, controller=None, integrators=0, unstable_poles=0, **lines):
    """A loop on an FRF of a model."""
    return Loop(frf_of(model, **lines), controller or gain(), integrators, unstable_poles)


def limits(**given):
    return ls.Requirements.from_table({"name": "one"} | given)


def own_limits(loops, slack_db=1e-3):
    """Requirements that a controller just keeps on several plants: its own peaks at all frequencies."""
    S, CS, disk = [], [], []
    for loop in loops:
        at = nodes(loop, limits())
        C = loop.controller.response(at.f)
        known = at.f <= at.f[at.inside][-1]
        sensitivity = 1.0 / (1.0 + C * at.P)
        S.append(np.abs(sensitivity[known]).max())
        CS.append(np.abs(C * sensitivity).max())
        disk.append(np.abs(sensitivity[known] - 0.5).max())
    return limits(
        sensitivity_peak_db=float(db(max(S))) + slack_db,
        control_peak_db=float(db(max(CS))) + slack_db,
        disk_margin=0.9999 / max(disk),
    )


def random_plant(rng, scale=1.0):
    """An integrator or a slow pole, a pole, a resonance and a delay; returns it with its number of integrators."""
    w, z = 2.0 * np.pi * rng.uniform(3.0, 12.0), rng.uniform(0.02, 0.3)
    pole = 2.0 * np.pi * rng.uniform(0.5, 5.0)
    integrators = int(rng.integers(0, 2))
    slow = [1.0, 0.0] if integrators else [1.0, 2.0 * np.pi * 0.1]
    den = np.polymul(np.polymul(slow, [1.0 / pole, 1.0]), [1.0 / w**2, 2.0 * z / w, 1.0])
    return TransferFunction([scale * rng.uniform(0.5, 3.0)], den, rng.uniform(0.0, 0.01)), integrators


def random_controller(rng):
    """A gain with a lead and a low-pass."""
    f = rng.uniform(0.5, 4.0)
    return [
        Block("lead_lag", {"f1_hz": f, "f2_hz": f * rng.uniform(2.0, 12.0)}),
        Block("low_pass_2", {"f_hz": rng.uniform(8.0, 30.0), "damping": rng.uniform(0.5, 1.0)}),
    ]
