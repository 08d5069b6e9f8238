"""What the tests of several loops share: matrix FRFs, plants in state space, and their closed loops' poles."""

import numpy as np
from bench_nouns import Block, Loop
from conversions import TWO_PI
from scipy.linalg import block_diag

import loopshape as ls

RATE_HZ = 1e6  # far above all lines: Tustin's warping does not matter


def gain(name, value=1.0, *blocks):
    return ls.Controller(name, (Block("gain", {"gain": float(value)}), *blocks), RATE_HZ)


def pi(f_hz):
    return Block("pi", {"f_hz": f_hz})


def lead(f1_hz, f2_hz):
    return Block("lead_lag", {"f1_hz": f1_hz, "f2_hz": f2_hz})


def frf_of(f, response, relative=1e-8, *, units=None, loop="", recording="exact"):
    """A square FRF whose elements have independent errors of a relative standard deviation, without any of them."""
    n = response.shape[1]
    size = (relative * np.abs(response)).transpose(0, 2, 1).reshape(len(f), -1)
    covariance = np.zeros((len(f), n * n, n * n), dtype=complex)
    covariance[:, np.arange(n * n), np.arange(n * n)] = size**2
    outputs = tuple(f"{chr(97 + k)}_{(units or ['m'] * n)[k]}" for k in range(n))
    inputs = tuple(f"z_{chr(97 + k)}_v" for k in range(n))
    known = np.ones(len(f), dtype=bool)
    return ls.FRF(f, response, covariance, known, inputs, outputs, "exact", recording, loop, RATE_HZ)


def noisy(frf, rng):
    """The FRF with a draw of its own errors."""
    std = np.sqrt(0.5 * frf.variance)
    error = std * (rng.normal(size=std.shape) + 1j * rng.normal(size=std.shape))
    return ls.FRF(
        frf.frequency_hz, frf.response + error, frf.covariance, frf.valid, frf.inputs, frf.outputs, "drawn",
        frf.recording, frf.loop, frf.rate_hz,
    )  # fmt: skip


def loops(f, response, controllers, integrators=0, unstable=0, relative=1e-8):
    return Loop(frf_of(f, response, relative), controllers, integrators, unstable)


def response_of(f, A, B, C):
    s = 1j * TWO_PI * f
    return C @ np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B.astype(complex))


def poles(A, B, C, controllers):
    """Closed-loop poles in rad/s of a plant without feedthrough under one controller a loop."""
    parts = [_state_space(c) for c in controllers]
    Ak, Bk, Ck, Dk = (block_diag(*[part[k] for part in parts]) for k in range(4))
    return np.linalg.eigvals(np.block([[A - B @ Dk @ C, B @ Ck], [-Bk @ C, Ak]]))


def _state_space(controller):
    A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    for block in controller.blocks:
        (n0, n1, _), (d0, d1, _) = block.section()
        if d1 == 0.0:
            C, D = C * n0 / d0, D * n0 / d0
            continue
        d = n1 / d1
        a, c = -d0 / d1, (n0 - d * d0) / d1
        A = np.block([[A, np.zeros((len(A), 1))], [C, np.array([[a]])]])
        B, C, D = np.vstack([B, D]), np.hstack([d * C, [[c]]]), d * D
    return A, B, C, D


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def random_plant(rng, n):
    """A, B, C of a plant of coupled modes, its integrators and unstable poles, and its lowest corner in Hz."""
    modes, corners, integrators, unstable = [], [30.0], 0, 0

    def corner(low, high):
        corners.append(log_uniform(rng, low, high))
        return TWO_PI * corners[-1]

    mixed = np.eye(n) + 0.4 * rng.normal(size=(n, n))
    heavy = rng.random() < 0.6
    for k in range(n):
        u, v = mixed[:, [k]], np.eye(n)[[k]] + 0.3 * rng.normal(size=(1, n))
        w, lag, order = corner(0.3, 30.0), corner(1.0, 100.0), int(rng.integers(0, 3)) if heavy else 0
        A = [[[0, 1], [-w * w, -2 * log_uniform(rng, 0.02, 0.9) * w]], [[0, 1], [0, -lag]], [[0, 1], [0, 0]]][order]
        modes.append((A, np.array([[0], [w * lag if order == 1 else w * w]]) @ v, u @ [[1, 0]]))
        integrators += order
    for _ in range(rng.integers(0, 3)):
        w, u, v = corner(0.5, 30.0), rng.normal(size=(n, 1)), rng.normal(size=(1, n))
        A = [[0, 1], [-w * w, -2 * log_uniform(rng, 0.02, 0.9) * w]]
        modes.append((A, np.array([[0], [w * w * rng.normal()]]) @ v, u @ [[1, 0]]))
    if rng.random() < 0.3:
        a, u, v = corner(0.5, 30.0), rng.normal(size=(n, 1)), rng.normal(size=(1, n))
        modes.append(([[a]], a * rng.normal() * v, u))
        unstable = 1
    A, B, C = block_diag(*[m[0] for m in modes]), np.vstack([m[1] for m in modes]), np.hstack([m[2] for m in modes])
    return (A, B, C), integrators, unstable, min(corners)


def random_controllers(rng, n):
    """Controllers of gain 1, and their lowest corner in Hz."""
    made, corners = [], [30.0]
    for k in range(n):
        blocks = []
        if rng.random() < 0.5:
            corners.append(log_uniform(rng, 0.2, 5.0))
            blocks.append(pi(corners[-1]))
        if rng.random() < 0.7:
            corners.append(log_uniform(rng, 0.5, 20.0))
            blocks.append(lead(corners[-1], corners[-1] * log_uniform(rng, 3.0, 20.0)))
        made.append(gain("abcdefgh"[k], 1.0, *blocks))
    return made, min(corners)


def crossing_somewhere(rng, f, G, controllers, last):
    """The controllers with gains that bring each loop alone to 0 dB at some line below the `last`."""
    out = []
    for k, own in enumerate(controllers):
        at = [int(rng.integers(1, last))]
        size = abs(G[at[0], k, k] * own.response(f[at])[0])
        sign = -1.0 if rng.random() < 0.1 else 1.0
        out.append(gain(own.loop, sign * 1.0003 / size, *own.blocks[1:]))
    return out
