"""Several loops: the plant's matrix from sensitivities measured column by column, P = S_P S_I^-1 (H.6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from loopshape.errors import WrongUseError
from loopshape.estimate.averages import against_instrument, error_covariance, trusted_lines
from loopshape.estimate.signals import instrument, output_channel, plant_input
from loopshape.estimate.transforms import Settings, Transforms, transform
from loopshape.frf import FRF
from loopshape.recording import Recording
from loopshape.run import Run
from loopshape.units import ComplexArray


def estimate_matrix(run: Run, recordings: Sequence[Recording], settings: Settings | None = None) -> FRF:
    """FRF (loops x loops) from one recording for each excited loop, made alike, at one operating point.

    Column i of S_I and S_P comes from the recording that excites loop i; P = S_P S_I^-1 on the lines that
    all share. The covariance follows from each column's residuals, taken as independent between recordings.
    """
    order = [loop.name for loop in run.loops]
    by_loop = {str(r.info.excites): r for r in recordings}
    if set(by_loop) != set(order) or len(recordings) != len(order):
        raise WrongUseError(
            "a plant's matrix needs one recording for each loop",
            f"recordings that excite {', '.join(str(r.info.excites) for r in recordings)}",
            f"the loops are {', '.join(order)}",
        )
    columns = [_column(run, by_loop[name], name, settings or Settings()) for name in order]
    f = columns[0].frequency_hz
    if any(not np.array_equal(c.frequency_hz, f) for c in columns):
        raise WrongUseError("the recordings of a plant's matrix have different lines", "", "record them alike")
    rows = np.logical_and.reduce([c.excited for c in columns])
    P, covariance, freedom, pooled = _matrix(columns, rows)
    std = np.sqrt(np.real(np.einsum("fii->fi", covariance))).max(axis=1)
    names = [by_loop[name].info.name for name in order]
    return FRF(
        frequency_hz=f[rows],
        response=P,
        covariance=covariance,
        trusted=trusted_lines(f[rows], std / np.linalg.norm(P, 2, axis=(1, 2)), np.ones(rows.sum(), dtype=bool)),
        inputs=tuple(loop.control for loop in run.loops),
        outputs=tuple(output_channel(loop).column for loop in run.loops),
        method=f"P = S_P S_I^-1, {columns[0].method}",
        recording="+".join(names),
        loop="+".join(order),
        rate_hz=run.rate_hz,
        parameters=dict(recordings[0].info.parameters),
        line_overlap=columns[0].line_overlap,
        variance_freedom=freedom,
        variance_pooled=pooled,
        operating_point=dict(recordings[0].info.operating_point),
    )


def _column(run: Run, recording: Recording, excited: str, settings: Settings) -> Transforms:
    """Transforms of all outputs, then all plant inputs, against the excited loop's instrument."""
    outputs = [recording.output(loop.output) for loop in run.loops]
    inputs = [plant_input(recording, loop) for loop in run.loops]
    return transform(recording, [*outputs, *inputs], instrument(recording, run.loop(excited)), settings)


def _matrix(columns: Sequence[Transforms], rows: np.ndarray) -> tuple[ComplexArray, ComplexArray, float, int]:
    """Plant matrix (nf, m, m), covariance of its vec (nf, m², m²) on the chosen lines, its freedom and pooling."""
    m = len(columns)
    responses = np.stack([against_instrument(c)[rows] for c in columns], axis=-1)
    inverse = np.linalg.inv(responses[:, m:])
    P = responses[:, :m] @ inverse
    covariance = np.zeros((P.shape[0], m * m, m * m), dtype=complex)
    freedom, pooled = np.inf, 1
    for i, c in enumerate(columns):
        Y, U = c.signals[:m, :, rows], c.signals[m:, :, rows]
        residual = Y - np.einsum("fab,bkf->akf", P, U)
        error, freedom, pooled = error_covariance(_on(c, rows), residual)
        weight = np.einsum("fj,fk->fjk", inverse[:, i, :], inverse[:, i, :].conj())
        covariance += np.einsum("fjk,fab->fjakb", weight, error).reshape(covariance.shape)
    return P, covariance, freedom, pooled


def _on(t: Transforms, rows: np.ndarray) -> Transforms:
    return replace(
        t,
        frequency_hz=t.frequency_hz[rows],
        signals=t.signals[:, :, rows],
        instrument=t.instrument[:, rows],
        excited=t.excited[rows],
    )
