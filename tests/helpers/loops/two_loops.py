"""Two coupled loops with a known plant, one excited at a time: their responses, and runs of them."""

import numpy as np
from bench_nouns import Block, LoopSetup, RecordingInfo
from conversions import TWO_PI

import loopshape as ls

RATE, PLACES = 100.0, ("controller_input", "plant_input")
# x+ = A x + B u, y = C x: four states, each output feels both inputs; rings for 0.1 s
TURN = 0.85 * np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
A = np.block([[TURN, np.zeros((2, 2))], [np.zeros((2, 2)), np.diag([0.9, 0.6])]])
B = np.array([[0.2, 0.05], [0.0, 0.1], [0.1, 0.15], [0.05, 0.3]])
C = np.array([[0.5, 0.3, 0.6, 0.0], [-0.2, 0.1, 0.2, 0.5]])
GAINS = np.array([0.8, 0.6])


def plant(f_hz):
    """Response (nf, 2, 2)."""
    z = np.exp(1j * TWO_PI * np.asarray(f_hz) / RATE)
    return C @ np.linalg.solve(z[:, None, None] * np.eye(4) - A, B.astype(complex))


def equivalent_plant(f_hz, k):
    """What a loop sees with the other closed: P_kk - P_kj c_j P_jk/(1 + c_j P_jj)."""
    P, j = plant(f_hz), 1 - k
    return P[:, k, k] - P[:, k, j] * GAINS[j] * P[:, j, k] / (1.0 + GAINS[j] * P[:, j, j])


def simulated(n, excited, place, noise, seed, records=1):
    """z and y (records, n, 2) with n (n,) or (records, n) injected into one loop and white sensor noise in both."""
    n = np.broadcast_to(n, (records, np.shape(n)[-1]))
    v = noise * np.random.default_rng(seed).standard_normal((records, n.shape[1], 2))
    x, z, y = np.zeros((records, 4)), np.empty_like(v), np.empty_like(v)
    into = np.zeros((records, n.shape[1], 2))
    into[:, :, excited] = n
    for k in range(n.shape[1]):
        y[:, k] = x @ C.T + v[:, k]
        e = -y[:, k] + (into[:, k] if place == "controller_input" else 0.0)
        z[:, k] = GAINS * e
        u = z[:, k] + (into[:, k] if place == "plant_input" else 0.0)
        x = x @ A.T + u @ B.T
    return z, y


def setups(place):
    unit = "rad" if place == "controller_input" else "v"
    return tuple(
        LoopSetup(f"l{k}", None, f"n{k}_{unit}", f"z{k}_v", f"y{k}_rad",
                  ls.Controller(f"l{k}", (Block("gain", {"gain": float(GAINS[k])}),), RATE))
        for k in (0, 1)
    )  # fmt: skip


def recording(loops, excited, place, n, z, y, kind="noise", **period):
    info = RecordingInfo(f"r{excited}.parquet", kind, place, excites=f"l{excited}", **period)
    columns = {f"z{k}_v": z[:, k] for k in (0, 1)} | {f"y{k}_rad": y[:, k] for k in (0, 1)}
    columns |= {str(loops[k].injected): n if k == excited else np.zeros(n.size) for k in (0, 1)}
    return ls.Recording(info, RATE, columns)


def runs(place, signals, noise, records, kind="noise", **period):
    """Runs of two recordings each, one for each excited loop; signals[k] is (n,) or (records, n)."""
    loops = setups(place)
    made = []
    for k in (0, 1):
        z, y = simulated(signals[k], k, place, noise, 10 + k, records)
        n = np.broadcast_to(signals[k], z.shape[:2])
        made.append([recording(loops, k, place, *x, kind, **period) for x in zip(n, z, y, strict=True)])
    return [ls.Run(RATE, loops, pair) for pair in zip(*made, strict=True)]


def white(seed, records, size):
    return np.random.default_rng(seed).standard_normal((records, size))
