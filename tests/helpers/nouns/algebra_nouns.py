"""FRFs of any size for the algebra's tests."""

import numpy as np

import loopshape as ls


def any_frf(rng, ny, nu, *, f=None, error=0.01, outputs=None, inputs=None, recording="", size=1.0, **words):
    """A random FRF with a full covariance of relative size `error`; 0 for one without error."""
    f = np.arange(1.0, 8.0) if f is None else f
    G = size * (rng.standard_normal((f.size, ny, nu)) + 1j * rng.standard_normal((f.size, ny, nu)))
    root = rng.standard_normal((f.size, ny * nu, ny * nu)) + 1j * rng.standard_normal((f.size, ny * nu, ny * nu))
    C = (error * size) ** 2 * root @ root.conj().transpose(0, 2, 1)
    return ls.FRF(
        f, G, C, np.arange(f.size) > 0,
        tuple(inputs or (f"u{k}" for k in range(nu))), tuple(outputs or (f"y{k}" for k in range(ny))),
        "made up", recording, **words,
    )  # fmt: skip


def drawn(rng, frf, count):
    """Responses (count, nf, ny, nu) around an FRF's, with circular errors of its covariance."""
    nf, ny, nu = frf.response.shape
    values, vectors = np.linalg.eigh(frf.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    white = rng.standard_normal((count, nf, ny * nu)) + 1j * rng.standard_normal((count, nf, ny * nu))
    d = np.einsum("fij,cfj->cfi", root, white) / np.sqrt(2.0)
    return frf.response + d.reshape(count, nf, nu, ny).transpose(0, 1, 3, 2)


def covariance_of(responses):
    """Sample covariance (nf, ny nu, ny nu) of vec of responses (count, nf, ny, nu) about their mean."""
    d = responses - responses.mean(0)
    d = d.transpose(0, 1, 3, 2).reshape(*d.shape[:2], -1)
    return np.einsum("cfi,cfj->fij", d, d.conj()) / (len(d) - 1)
