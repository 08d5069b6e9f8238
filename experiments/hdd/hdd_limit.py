"""The least 3 sigma that any linear controller reaches at one plant: a lower bound for one set at all nine.

Between two samples the plants take four numbers (two actuators, two halves of a sector), each any causal function of
the samples so far: more freedom than controllers at Ts before filters at Ts/2 have, and no margin asked. The least
variance over all fine steps is that of linear-quadratic control with a current estimate (Astrom, Introduction to
stochastic control theory, 1970, chapters 7 and 8), of the plant lifted from sector to sector. Fan and rotation count;
the run-out's lines do not, for notches as narrow as one likes keep them out of the loop. Both Riccati equations are
iterated from zero, from where they rise: to stop early leaves a lower bound one. The variance is that of a stationary
record; the score's window of 1 s leaves out what lies below 1 Hz.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from hdd_benchmark import FINE, HALF, Benchmark, Modes
from hdd_forecast import Forecast
from scipy.linalg import block_diag

from loopshape.core.units import Array, ComplexArray

#: variance of a random number between -1/2 and 1/2
UNIFORM = 1.0 / 12.0
#: an iteration ends where a step raises its trace by less than this share
SETTLED, MOST = 1e-9, 60_000


@dataclass(frozen=True, eq=False)
class Lifted:
    """One plant with its disturbances from sector to sector: x+ = A x + B u + w, u (4,); the head at 20 fine steps.

    The head is C x + D u + n; w has the covariance `noise`, and n alone the mean variance `between`. Row 0 of C is
    what is sampled. Units are % of the track for the head, 1 for u.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    noise: Array
    between: float


@dataclass(frozen=True, eq=False)
class Least:
    """3 sigma in % of the track that no controller goes below, and the gains K (4, n) and F (n,) that reach it."""

    three_sigma: float
    K: Array
    F: Array


def lifted(benchmark: Benchmark, case: Mapping[str, float]) -> Lifted:
    """The lifted plant of a case."""
    A, B, G, c = _fine(benchmark, case)
    n = len(A)
    state, drive, W, between = np.eye(n), np.zeros((n, 4)), np.zeros((n, n)), 0.0
    C, D = np.zeros((FINE, n)), np.zeros((FINE, 4))
    for k in range(FINE):
        C[k], D[k] = c @ state, c @ drive
        between += float(c @ W @ c) / FINE
        halves = np.zeros((2, 4))
        halves[[0, 1], [k // HALF, 2 + k // HALF]] = 1.0
        state, drive = A @ state, A @ drive + B @ halves
        W = A @ W @ A.T + UNIFORM * G @ G.T
    return Lifted(state, drive, C, D, W, between)


def filters(benchmark: Benchmark, plant: Lifted, found: Least, forecast: Forecast) -> ComplexArray:
    """The controllers that reach it, K (n, 2 parities, 2 actuators) at a forecast's nodes, from e in m.

    u = -K (state by the sample); both halves in one number a sector, less the hold that the forecast's plants have.
    """
    z, half = forecast.at
    keep = np.eye(found.F.size) - np.outer(found.F, plant.C[0])
    A, B = (plant.A - plant.B @ found.K) @ keep, (plant.A - plant.B @ found.K) @ found.F
    x = np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, B[:, None])[..., 0]
    u = (x @ keep.T + found.F) @ found.K.T * 100.0 / benchmark.numbers["track_pitch_m"]
    halves = u.reshape(-1, 1, 2, 2)
    return np.asarray((halves[..., 0] + halves[..., 1] / half[..., None]) / (1.0 + 1.0 / half)[..., None])


def closed(plant: Lifted, design: Lifted, found: Least) -> Array:
    """State matrix of a plant under the controller that is the best of `design`."""
    keep, B = np.eye(found.F.size) - np.outer(found.F, design.C[0]), design.A - design.B @ found.K
    taken, own = np.outer(found.F, plant.C[0]), plant.B @ found.K
    return np.block([[plant.A - own @ taken, -own @ keep], [B @ taken, B @ keep]])


def _fine(benchmark: Benchmark, case: Mapping[str, float]) -> tuple[Array, Array, Array, Array]:
    """State, input (n, 2), disturbance (n, 14) and head (n,) of a fine step, in % of the track."""
    vcm, pzt = (_scaled(modes, benchmark.step_s) for modes in benchmark.plants(case))
    fan = _scaled(benchmark.fan(), benchmark.step_s)
    slow, pair = (_companion(*part) for part in benchmark.rotation())
    turned = block_diag(slow[0], pair[0])
    A = block_diag(vcm[0], pzt[0], fan[0], turned)
    n, at = len(A), np.cumsum([0, *(len(part) for part in (vcm[0], pzt[0], fan[0], turned))])
    B, G, c = np.zeros((n, 2)), np.zeros((n, 1 + fan[0].shape[0] // 2)), np.zeros(n)
    B[: at[1], 0], B[at[1] : at[2], 1] = vcm[1], pzt[1]
    A[: at[1], at[3] :] = np.outer(vcm[1], np.concatenate([slow[2], pair[2]]))
    for j in range(fan[0].shape[0] // 2):
        G[at[2] + 2 * j : at[2] + 2 * j + 2, 1 + j] = fan[1][2 * j : 2 * j + 2]
    G[at[3] :, 0] = np.concatenate([slow[1], pair[1]])
    c[: at[3] : 2] = 100.0 / benchmark.numbers["track_pitch_m"]
    size = np.concatenate([np.full(at[3], c[0]), np.ones(n - at[3])])  # positions in % as well
    return size[:, None] * A / size, size[:, None] * B, size[:, None] * G, c / size


def _scaled(modes: Modes, step_s: float) -> tuple[Array, Array]:
    """Transition and input of all modes held over a step, speeds in fine steps."""
    F, G = modes.held(step_s)
    size = np.array([1.0, step_s])
    return block_diag(*(size[:, None] * F / size)), (size * G).ravel()


def _companion(num: Array, den: Array) -> tuple[Array, Array, Array]:
    """State, input and output of a strictly proper filter in z."""
    n = den.size - 1
    A = np.eye(n, k=-1)
    A[0] = -den[1:]
    return A, np.eye(n)[0], num[1:]


def least(plant: Lifted) -> Least:
    """The least mean variance over the fine steps, from below, and what reaches it."""
    K, value, weight = _control(plant)
    F, filtered = _estimate(plant)
    variance = np.sum(value * plant.noise) + np.sum((K.T @ weight @ K) * filtered) + plant.between
    return Least(3.0 * float(np.sqrt(variance)), K, F)


def _control(plant: Lifted) -> tuple[Array, Array, Array]:
    """Gains (4, n) of u = -K x, the cost's matrix and that of an error in u."""
    A, B, C, D = plant.A, plant.B, plant.C / np.sqrt(FINE), plant.D / np.sqrt(FINE)
    S = np.zeros_like(A)
    for _ in range(MOST):
        weight = D.T @ D + B.T @ S @ B
        K = np.linalg.solve(weight, D.T @ C + B.T @ S @ A)
        closed, left = A - B @ K, C - D @ K
        new = closed.T @ S @ closed + left.T @ left
        new = 0.5 * (new + new.T)
        rise, S = np.trace(new - S), new
        if rise < SETTLED * np.trace(S):
            break
    return K, S, weight


def _estimate(plant: Lifted) -> tuple[Array, Array]:
    """Gain (n,) on the sample's surprise, and the covariance of the state's error after the sample."""
    P, c = plant.noise.copy(), plant.C[0]
    for _ in range(MOST):
        F = P @ c / float(c @ P @ c)
        keep = np.eye(c.size) - np.outer(F, c)
        after = keep @ P @ keep.T
        new = plant.A @ after @ plant.A.T + plant.noise
        rise, P = np.trace(new - P), 0.5 * (new + new.T)
        if rise < SETTLED * np.trace(P):
            break
    return F, after
