"""Several loops: the plant's matrix from what all signals answer to each loop's instrument, P = S_P S_I^-1 (H.6)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import product, zip_longest

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.answers import Answers, PlantEstimate, plant_of
from loopshape.identify.frequency_response import band_note, drowned_note, early_note, source
from loopshape.identify.quality.quality import stayed_bounded, unfed_notes
from loopshape.identify.respond import respond
from loopshape.identify.settings import BY_INSTRUMENT, Settings
from loopshape.identify.signals import (
    held_note,
    input_signal,
    moved_signal,
    output_channel,
    refuse_alike,
    refuse_sum,
    wiring_notes,
)
from loopshape.identify.spectra.periods import by_periods


def estimate_matrix(run: Run, recordings: Sequence[Recording], settings: Settings | None = None) -> FRF:
    """FRF (outputs x loops) of the plant, from recordings at one operating point that together excite every loop.

    One loop at a time, all at once by noise of one's own in each, or all at once by orthogonal multisines in as many
    recordings as loops; several such sets of multisines are realisations, whose scatter tells distortion from noise.
    The covariance is that of vec(P), from each recording's own residuals, independent between recordings. `run.outputs`
    are the rows where these are not the loops' outputs. Loops that no recording excites have no column, and stay as
    they are in the recordings: with interaction P is then the plant with those loops closed.

    Refuses recordings at different operating points or settings, sets that leave a column open, and different lines.
    """
    settings = settings or Settings()
    if settings.estimator not in BY_INSTRUMENT:
        raise WrongUseError("a plant's matrix is estimated by the reference", f"{settings.estimator!r}")
    _check_alike(recordings)
    loops = _excited_loops(run, recordings)
    outputs = run.outputs or tuple(loop.output for loop in run.loops if loop in loops)
    parts = _parts(recordings, loops, outputs, settings)
    plant = plant_of(parts, len(outputs))
    finite = np.isfinite(plant.response).all(axis=(1, 2)) & np.isfinite(plant.covariance).all(axis=(1, 2))
    rows = np.logical_and.reduce([p.excited for p in parts]) & finite
    if not rows.any():
        raise BadSignalError("the recordings of a plant's matrix share no excited frequency", parts[0].method)
    notes = tuple(dict.fromkeys(n for r in recordings for n in _notes(r, loops))) + _left_closed(run, loops)
    notes += tuple(dict.fromkeys(n for p in parts for n in p.notes))
    return _frf(run, recordings, loops, outputs, [p.select(rows) for p in parts], _on(plant, rows), notes)


def _check_alike(recordings: Sequence[Recording]) -> None:
    for word in ("operating_point", "parameters"):
        found = {tuple(sorted(getattr(r.info, word).items())) for r in recordings}
        if len(found) > 1:
            raise WrongUseError(
                f"the recordings of a plant's matrix differ in their {word.replace('_', ' ')}",
                "; ".join(str(dict(x)) for x in sorted(found)),
                "take those of one",
            )


def _excited_loops(run: Run, recordings: Sequence[Recording]) -> list[LoopSetup]:
    """Loops that any recording excites, in the run's order."""
    names = {name for r in recordings for name in r.info.excited}
    loops = [loop for loop in run.loops if loop.name in names]
    if not loops:
        raise WrongUseError("a plant's matrix needs recordings that excite its loops", f"{len(recordings)} recordings")
    return loops


def _parts(
    recordings: Sequence[Recording], loops: Sequence[LoopSetup], outputs: Sequence[str], settings: Settings
) -> list[Answers]:
    """Answers whose columns are the loops, in their order."""
    names = [loop.name for loop in loops]
    for loop, recording in product(loops, recordings):
        refuse_alike(recording, loop)
    if all(r.info.period_s is not None for r in recordings):
        made = [
            (r, _signals(r, loops, outputs, alone=False), _instruments(r, loops), names.index(str(r.info.excites)))
            for r in _in_blocks(recordings, names)
        ]
        return [by_periods(made, settings)]
    ordered = _one_each(recordings, names)
    columns = [name for r in ordered for name in names if name in r.info.excited]
    found = _on_common_lines(ordered, loops, outputs, settings)
    return found if columns == names else [_reordered(found, [columns.index(n) for n in names])]


def _one_each(recordings: Sequence[Recording], names: Sequence[str]) -> list[Recording]:
    """Recordings of noise or sweeps in the order of the loops that they excite; refuses two of one loop."""
    by_loop: dict[str, Recording] = {}
    for r in recordings:
        for name in r.info.excited:
            if name in by_loop:
                raise WrongUseError(
                    "a plant's matrix takes one recording for each loop, of noise and sweeps",
                    f"{by_loop[name].info.name} and {r.info.name} both excite {name}",
                    "name the recordings to take; only multisines are averaged over realisations",
                )
            by_loop[name] = r
    return list(dict.fromkeys(by_loop[name] for name in names))


def _on_common_lines(
    ordered: Sequence[Recording], loops: Sequence[LoopSetup], outputs: Sequence[str], settings: Settings
) -> list[Answers]:
    """Each recording's answers; where each record chose lines of its own, again on lines that all can have."""

    def each(required: Settings) -> list[Answers]:
        return [_answers(r, loops, outputs, len(ordered) == 1, required) for r in ordered]

    found = each(settings)
    if _alike(found):
        return found
    step = min(float(np.diff(p.frequency_hz).min()) for p in found)
    lengths = {r.column(loops[0].control).size for r in ordered}
    if len(lengths) == 1 and settings.method != "welch" and settings.resolution_hz is None:
        with suppress(BadSignalError):
            return _shared(each(replace(settings, method="local", resolution_hz=step)), step)
    resolution = settings.resolution_hz or max(step, 10.0 * ordered[0].rate_hz / min(lengths))
    found = each(replace(settings, method="welch", resolution_hz=resolution))
    if not _alike(found):
        raise WrongUseError("the recordings of a plant's matrix have different frequencies", "", "record them alike")
    return found


def _answers(
    recording: Recording, loops: Sequence[LoopSetup], outputs: Sequence[str], alone: bool, settings: Settings
) -> Answers:
    """What all signals answer to the loops that one recording excites."""
    sources = [np.asarray(moved_signal(recording, loop)) for loop in loops if loop.name in recording.info.excited]
    return respond(recording, _signals(recording, loops, outputs, alone), sources, len(outputs), settings)


def _alike(parts: Sequence[Answers]) -> bool:
    return all(np.array_equal(p.frequency_hz, parts[0].frequency_hz) for p in parts)


def _shared(parts: Sequence[Answers], step_hz: float) -> list[Answers]:
    """Answers on the lines that all have, of grids whose lines are multiples of one step."""
    places = [np.round(p.frequency_hz / step_hz).astype(int) for p in parts]
    common = reduce(np.intersect1d, places)
    return [p.select(np.isin(k, common)) for p, k in zip(parts, places, strict=True)]


def _reordered(parts: Sequence[Answers], order: Sequence[int]) -> Answers:
    """One part with the columns of all in another order; errors of different parts are independent."""
    from scipy.linalg import block_diag

    m = parts[0].response.shape[1]
    H = np.concatenate([p.response for p in parts], axis=2)[:, :, order]
    covariance = np.stack([block_diag(*cs) for cs in zip(*(p.covariance for p in parts), strict=True)])
    place = np.concatenate([np.arange(m) + m * k for k in order])
    first = parts[0]
    return Answers(
        first.frequency_hz, H, covariance[:, place][:, :, place], first.power, first.excited,
        min(p.averages for p in parts), first.power_per, first.line_overlap, min(p.freedom for p in parts),
        first.pooled, first.method, method_numbers=first.method_numbers,
    )  # fmt: skip


def _in_blocks(recordings: Sequence[Recording], names: Sequence[str]) -> list[Recording]:
    """Periodic recordings in blocks of as many as loops: one for each loop, or sets that excite all at once."""
    alone = [[r for r in recordings if r.info.excited == (name,)] for name in names]
    together = [r for r in recordings if len(r.info.excited) > 1]
    if together and any(alone):
        raise WrongUseError(
            "recordings of one loop at a time and of several at once are not taken together",
            ", ".join(r.info.name for r in recordings),
            "name those of one kind",
        )
    if together:
        if len(together) % len(names) or any(set(r.info.excited) != set(names) for r in together):
            raise WrongUseError(
                f"orthogonal multisines excite all of {', '.join(names)} in as many recordings, or a multiple of it",
                f"{len(together)} recordings",
                "record the missing ones",
            )
        return together
    counts = {len(mine) for mine in alone}
    if len(counts) != 1:
        raise WrongUseError(
            "a plant's matrix needs as many recordings of each loop",
            ", ".join(f"{name}: {len(mine)}" for name, mine in zip(names, alone, strict=True)),
            "record the missing ones, or name those to take",
        )
    return [r for block in zip_longest(*alone) for r in block]


def _signals(recording: Recording, loops: Sequence[LoopSetup], outputs: Sequence[str], alone: bool) -> list[Array]:
    """Outputs, then plant inputs; these are left out where they are the instruments themselves."""
    for loop in loops:
        if loop.name in recording.info.excited:
            refuse_sum(recording, loop)
    y = [recording.output(expression) for expression in outputs]
    free = recording.info.injection == "control" or not recording.info.closed_loop
    return y if alone and free else y + [np.asarray(input_signal(recording, loop)) for loop in loops]


def _instruments(recording: Recording, loops: Sequence[LoopSetup]) -> list[Array]:
    """Each loop's instrument in a recording, zero where it does not excite that loop."""
    excited = recording.info.excited
    zero = np.zeros(recording.column(loops[0].control).size)
    return [np.asarray(moved_signal(recording, loop)) if loop.name in excited else zero for loop in loops]


def _notes(recording: Recording, loops: Sequence[LoopSetup]) -> tuple[str, ...]:
    notes = tuple(note for loop in loops for note in held_note(recording, loop)) + unfed_notes(recording, loops)
    return notes + early_note(recording)


def _left_closed(run: Run, loops: Sequence[LoopSetup]) -> tuple[str, ...]:
    names = [loop.name for loop in run.loops if loop not in loops and loop.controller is not None]
    if not names:
        return ()
    return (f"no recording excites {', '.join(names)}: the matrix is the plant's with closed there what was closed",)


def _on(plant: PlantEstimate, rows: np.ndarray) -> PlantEstimate:
    noise = None if plant.noise is None else plant.noise[rows]
    return PlantEstimate(plant.response[rows], plant.covariance[rows], noise, plant.drowned[rows])


def _frf(
    run: Run,
    recordings: Sequence[Recording],
    loops: Sequence[LoopSetup],
    outputs: Sequence[str],
    parts: Sequence[Answers],
    plant: PlantEstimate,
    notes: tuple[str, ...],
) -> FRF:
    f = parts[0].frequency_hz
    power = np.mean([p.power[:, : len(outputs) + len(loops), : len(outputs) + len(loops)] for p in parts], axis=0)
    whole = replace(parts[0], averages=float(sum(p.averages for p in parts)), freedom=min(p.freedom for p in parts))
    multiple, partial = coherences(power, len(outputs), whole.averages)
    relative = _relative_std(plant, np.real(np.einsum("fii->fi", power))[:, len(outputs) :])
    sound = plant.sound(np.arange(f.size))
    relative = np.where(sound, relative, np.inf)
    notes += drowned_note(f, sound)
    valid = valid_lines(f, relative, np.ones(f.size, dtype=bool)) & sound
    for part in parts:
        valid = valid if part.unresolved is None else valid & ~part.unresolved
    notes += band_note(f, valid) + _wiring(recordings, loops, outputs, parts)
    return FRF(
        frequency_hz=f,
        response=plant.response,
        covariance=plant.covariance,
        noise_covariance=plant.noise,
        valid=valid,
        inputs=tuple(loop.control for loop in loops),
        outputs=tuple(_row(run, expression) for expression in outputs),
        method=f"P = S_P S_I^-1, {parts[0].method}",
        loop="+".join(loop.name for loop in loops),
        multiple_coherence=multiple,
        partial_coherence=partial,
        notes=notes,
        open_loop=stayed_bounded(recordings, loops, outputs),
        **source(recordings, whole),
    )


def _relative_std(plant: PlantEstimate, input_power: Array) -> Array:
    """Relative standard deviation (nf,) of the median output that inputs of this power (nf, nu) have.

    Units of outputs and inputs cancel, and an output that none of the inputs moves does not spoil the rest.
    """
    nf, ny, nu = plant.response.shape
    variance = np.real(np.einsum("fii->fi", plant.covariance)).reshape(nf, nu, ny).transpose(0, 2, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        answer = (np.abs(plant.response) ** 2 * input_power[:, None, :]).sum(axis=2)
        relative = np.sqrt((variance * input_power[:, None, :]).sum(axis=2) / answer)
    return np.asarray(np.median(np.nan_to_num(relative, nan=np.inf), axis=1))


def _wiring(
    recordings: Sequence[Recording], loops: Sequence[LoopSetup], outputs: Sequence[str], parts: Sequence[Answers]
) -> tuple[str, ...]:
    """Warnings where a log contradicts its own controller, by what each loop answers to its own instrument."""
    notes: tuple[str, ...] = ()
    columns = [(part, k) for part in parts for k in range(part.response.shape[2])]
    for loop, (part, k) in zip(loops, columns, strict=True):
        own = next(r for r in recordings if loop.name in r.info.excited)
        row = len(outputs) + list(loops).index(loop)
        if loop.output in outputs and row < part.response.shape[1]:
            H = part.response[:, :, k]
            z = H[:, row] - (1.0 if own.info.injection == "plant_input" else 0.0)
            notes += wiring_notes(own, loop, part.frequency_hz, z, H[:, list(outputs).index(loop.output)])
    return notes


def _row(run: Run, expression: str) -> str:
    """Name of a row: the loop's channel where the output is a loop's, else the column's, or both of a sum."""
    for loop in run.loops:
        if loop.output == expression:
            return output_channel(loop).column
    terms = [Channel.from_column(term) for term in sum_terms(expression)]
    return Channel("_".join(term.name for term in terms), terms[0].unit).column


def coherences(power: ComplexArray, outputs: int, averages: float) -> tuple[Array | None, Array | None]:
    """Multiple (nf, ny) and partial (nf, ny, nu) coherence from cross-powers (nf, s, s) of outputs, then inputs.

    None where the inputs are not among the signals, or `averages` are no more than inputs: both are then 1, always.
    With few averages both are too high: where nothing is explained, the multiple coherence of q inputs is q/K in the
    mean over K averages, the partial one 1/(K - q + 1) (Bendat and Piersol, Random Data, 4th ed. 2010, 9.2).
    """
    inputs = power.shape[1] - outputs
    if inputs < 1 or averages <= inputs + 1e-9:
        return None, None
    multiple = np.empty((power.shape[0], outputs))
    partial = np.empty((power.shape[0], outputs, inputs))
    with np.errstate(all="ignore"):
        scale = np.sqrt(np.real(np.einsum("fii->fi", power)))
        alike = power / (scale[:, :, None] * scale[:, None, :])
        for i in range(outputs):
            rows = [i, *range(outputs, outputs + inputs)]
            inverse = _inverse(alike[:, rows][:, :, rows])
            diagonal = np.real(np.einsum("fii->fi", inverse))
            multiple[:, i] = 1.0 - 1.0 / diagonal[:, 0]
            partial[:, i] = np.abs(inverse[:, 0, 1:]) ** 2 / (diagonal[:, :1] * diagonal[:, 1:])
    return np.clip(np.nan_to_num(multiple), 0.0, 1.0), np.clip(np.nan_to_num(partial), 0.0, 1.0)


def _inverse(matrix: ComplexArray) -> ComplexArray:
    """Inverses (nf, n, n) of correlations; a rounding error's worth is added so that full coherence has one."""
    return np.asarray(np.linalg.inv(matrix + 1e-13 * np.eye(matrix.shape[1])))
