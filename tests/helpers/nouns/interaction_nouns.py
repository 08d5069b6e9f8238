"""Matrix FRFs for the tests of interaction: two or more loops with known elements and a known covariance."""

import numpy as np
from conversions import from_db

import loopshape as ls

F = np.arange(1, 81) * 0.1  # 0.1 to 8 Hz


def matrix_frf(response, covariance=None, f=F, *, error=0.0, seed=None, loop="theta1+theta2", **words):
    """FRF of a response (nf, ny, nu) or (ny, nu); with a seed the errors of its covariance are added.

    `error` is the relative deviation of independent elements where no covariance is given.
    """
    G = np.array(np.broadcast_to(response, (f.size, *np.shape(response)[-2:])), dtype=complex)
    ny, nu = G.shape[1:]
    vec = G.transpose(0, 2, 1).reshape(f.size, -1)
    if covariance is None:
        covariance = np.stack([np.diag(np.abs(error * v) ** 2).astype(complex) for v in vec])
    C = np.broadcast_to(covariance, (f.size, ny * nu, ny * nu))
    if seed is not None:
        vec = vec + errors(np.random.default_rng(seed), C)
    G = vec.reshape(f.size, nu, ny).transpose(0, 2, 1)
    given = {
        "inputs": tuple(f"z_{name}_v" for name in loop.split("+"))[:nu],
        "outputs": tuple(f"{name}_rad" for name in loop.split("+"))[:ny],
        "valid": np.ones(f.size, dtype=bool),
        "method": "made up",
        "recording": "r1+r2",
        "loop": loop,
        "rate_hz": 1000.0,
    } | words
    return ls.FRF(frequency_hz=f, response=G, covariance=C, **given)


def errors(rng, covariance):
    """Circular errors (nf, m) of a covariance (nf, m, m)."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    white = rng.standard_normal(covariance.shape[:2]) + 1j * rng.standard_normal(covariance.shape[:2])
    return np.einsum("fij,fj->fi", root, white) / np.sqrt(2.0)


def coupled_by(k_db, *, phase=0.7):
    """A plant (nf, 2, 2) whose |k_I| is k_db (a number or one for each line), of unequal gains."""
    k = np.broadcast_to(from_db(k_db), F.shape) * np.exp(1j * phase)
    P = np.empty((F.size, 2, 2), dtype=complex)
    P[:, 0, 0], P[:, 1, 1] = 0.3 * np.exp(-0.2j), 0.1 * np.exp(-1.1j)
    P[:, 0, 1] = 0.05 * np.exp(0.4j)
    P[:, 1, 0] = k * P[:, 0, 0] * P[:, 1, 1] / P[:, 0, 1]
    return P
