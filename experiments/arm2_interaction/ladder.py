"""From a linear plant to the arm, one property of the valves after the other, under the same controllers.

Every rung is the linearised arm driven by averaged valves, tick by tick; the estimator, the controllers and what is
injected are those of the arm's own study. On the lowest rung the truth is known exactly.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from valves import Plant, Valves, rates

from loopshape.core.kernels import biquads
from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import Array, ComplexArray, angular
from loopshape.data.signal.experiment import Experiment
from loopshape.data.signal.recording import Recording, RecordingInfo
from loopshape.toolbox.arm.simulation import sections


def held(plant: Plant, tick_s: float) -> tuple[Array, Array]:
    """A and E (n, n), (n, m) of the plant from tick to tick, rates held between."""
    n, m = plant.entry.shape
    both = np.zeros((n + m, n + m))
    both[:n, :n], both[:n, n:] = plant.dynamics, plant.entry
    step = expm(both * tick_s)
    return step[:n, :n], step[:n, n:]


def exact(plant: Plant, gains: Array, f: Array, rate_hz: float) -> ComplexArray:
    """Response (nf, ny, nz) of the plant sampled and held at the controllers' rate."""
    A, E = held(plant, 1.0 / rate_hz)
    z = np.exp(1j * angular(f) / rate_hz)[:, None, None]
    return np.asarray(plant.outputs @ np.linalg.solve(z * np.eye(len(A)) - A, E @ gains @ plant.decoupling))


def simulate(e: Experiment, plant: Plant, law: Valves, scale: float = 1.0) -> Recording:
    """A recording of a plant-input experiment on the linearised arm; `scale` is of what is injected."""
    A, E = (np.ascontiguousarray(x) for x in held(plant, 1.0 / e.rate_hz))
    controllers = [sections(loop, e) for loop in e.loops]
    longest = max(len(c) for c in controllers)
    padded = np.zeros((len(controllers), longest, 5))
    padded[:, :, 0] = 1.0  # sections that change nothing
    for k, c in enumerate(controllers):
        padded[k, : len(c)] = c
    injected = np.ascontiguousarray(scale * e.injected)
    y, z, u = _run(
        A, E, plant.outputs, plant.decoupling, padded, injected, law.fill, law.exhaust, law.drop, law.flow,
        law.dead_zone, law.shared,
    )  # fmt: skip
    columns = {"t_s": np.arange(len(y)) / e.rate_hz}
    for k, loop in enumerate(e.loops):
        columns |= {loop.output: y[:, k], loop.control: z[:, k], str(loop.injected): injected[:, k]}
    columns |= {f"u_{m}_v": u[:, k] for k, m in enumerate("abcd")}
    return Recording(RecordingInfo.of(e, None), e.rate_hz, columns)


@compiled
def _run(
    A: Array, E: Array, C: Array, T: Array, controllers: Array, injected: Array, fill: Array, exhaust: Array,
    drop: Array, flow: Array, dead_zone: float, shared: bool,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Outputs, controls and commands (n, 4) each, from rest; measure, control, inject, integrate."""
    n, loops = injected.shape
    y, z, u = np.zeros((n, loops)), np.zeros((n, loops)), np.zeros((n, T.shape[0]))
    x, state = np.zeros(A.shape[0]), np.zeros((loops, controllers.shape[1], 2))
    p, total = np.zeros(T.shape[0]), np.zeros(loops)
    for k in range(n):
        y[k] = C @ x
        for i in range(loops):
            z[k, i] = biquads.step(controllers[i], state[i], -y[k, i])
            total[i] = z[k, i] + injected[k, i]
        u[k] = T @ total
        rates(u[k], fill, exhaust, drop, flow, dead_zone, shared, p)
        x = A @ x + E @ p
    return y, z, u
