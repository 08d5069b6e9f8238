"""Run or recording -> FRF of a loop, with variance, coherence, spectra and valid band."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF, joined
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.answers import Answers, PlantEstimate, ordinary_coherence, plant_of
from loopshape.identify.quality.feedback import biased_lines, direct_signals
from loopshape.identify.quality.quality import inverse_note, open_loop_note, stayed_bounded, unfed_notes
from loopshape.identify.respond import respond
from loopshape.identify.settings import BY_INSTRUMENT, SPECTRAL, Settings
from loopshape.identify.signals import LoopSignals, held_note, loop_signals, read_signals, wiring_notes
from loopshape.identify.spectra.periods import by_periods
from loopshape.identify.spectra.welch import by_welch
from loopshape.identify.tolerances import TOL


def excited_recordings(run: Run) -> list[Recording]:
    """The estimation recordings that excite a loop, in order; refuses a run without any.

    Validation recordings are held out: nothing downstream of an FRF may have seen them.
    """
    found = [r for r in run.recordings if r.info.excites is not None and r.info.role == "estimation"]
    if not found:
        raise BadSignalError(
            "no estimation recording of the run excites a loop",
            f"{len(run.recordings)} recordings",
            'say what each excites, and give role = "estimation" to those that may be used',
        )
    return found


def estimate_frf(recording: Recording, loop: LoopSetup, settings: Settings | None = None) -> FRF:
    """FRF (1 x 1) from what enters the plant to the loop's output, with variance and valid band.

    The reference-based estimator H = Phi_yn/Phi_un is consistent in closed loop; with n in front of the
    controller it is the source's -(Phi_e1n)/(C Phi_e2n) (4.9, H.6). `direct` takes Phi_yu/Phi_uu, which
    under feedback tends to -1/C where noise outweighs the excitation: it warns. Other loops stay closed:
    with interaction the answer is the equivalent plant with those loops closed. A resonance sharper than
    the resolution is rounded off, which no variance shows.

    Raises BadSignalError for a record too short, without instrument, constant, or not a number.
    """
    settings = settings or Settings()
    if recording.info.excites_also and recording.info.period_s is not None:
        raise WrongUseError(
            f"recording {recording.info.file} excites several loops at once: no loop's FRF follows from it",
            ", ".join(recording.info.excited),
            "estimate the matrix of all its loops: loopshape frf RUN --matrix",
        )
    if settings.estimator == "direct":
        s, notes = direct_signals(recording, loop, settings)
    else:
        s, notes = read_signals(recording, loop), ()
    if settings.estimator in SPECTRAL:
        _refuse_spectral(recording, settings)
        answers = by_welch(recording, [s.y, s.u], [s.u], settings)
    else:
        answers = respond(recording, [s.y, s.u], [s.instrument], 1, settings)
    notes += open_loop_note(recording, loop) + unfed_notes(recording, [loop])
    return _loop_frf([recording], loop, s, answers, settings, notes)


def estimate_together(recordings: Sequence[Recording], loop: LoopSetup, settings: Settings) -> FRF:
    """FRF (1 x 1) of a loop from one recording, or from several realisations at once."""
    several = len(recordings) > 1
    return estimate_realisations(recordings, loop) if several else estimate_frf(recordings[0], loop, settings)


def estimate_realisations(recordings: Sequence[Recording], loop: LoopSetup) -> FRF:
    """FRF (1 x 1) of a loop from several multisines with phases drawn anew, made alike at one operating point.

    The covariance is that of the mean, from the scatter between recordings: noise and what a nonlinear plant answers
    differently to each draw. `noise_covariance` is noise's part, from the scatter between periods (Pintelon and
    Schoukens 2012, 4.3). Two recordings at least; with few, variances are pooled over neighbouring lines. What the
    plant's nonlinearity does alike to every draw - a gain that falls with the amplitude - is no scatter.
    """
    if len(recordings) < 2:
        raise WrongUseError("realisations are two recordings or more", f"{len(recordings)}", "record more draws")
    signals = [loop_signals(r, loop) for r in recordings]
    parts = [(r, [s.y, s.u], [s.instrument], 0) for r, s in zip(recordings, signals, strict=True)]
    return _loop_frf(recordings, loop, signals[0], by_periods(parts, Settings()), Settings(), ())


def _loop_frf(
    recordings: Sequence[Recording],
    loop: LoopSetup,
    s: LoopSignals[Any],
    answers: Answers,
    settings: Settings,
    notes: tuple[str, ...],
) -> FRF:
    """The noun of one loop's answers."""
    recording, info = recordings[0], recordings[0].info
    plant = _by_spectra(plant_of([answers], 1), answers, settings.estimator)
    finite = np.isfinite(plant.response).all(axis=(1, 2)) & np.isfinite(plant.covariance).all(axis=(1, 2))
    rows = _kept(answers.excited) & finite
    if not rows.any():
        raise BadSignalError(
            f"no frequency of recording {info.file} is excited in loop {loop.name}",
            answers.method,
            "excite more; of a sweep too few segments may excite each frequency: choose a coarser resolution",
        )
    a, f = answers.select(rows), answers.frequency_hz[rows]
    G, covariance = plant.response[rows], plant.covariance[rows]
    if settings.estimator in BY_INSTRUMENT:
        z = a.response[:, 1, 0] - (1.0 if info.injection == "plant_input" else 0.0)
        std = np.sqrt(np.maximum(a.covariance[:, 1, 1].real, 0.0))  # of a z that is exact rounding errors below 0
        notes += wiring_notes(recording, loop, f, z, a.response[:, 0, 0], std)
    valid, why = _valid(plant, rows, a, G[:, 0, 0], covariance[:, 0, 0].real, recording, loop, settings)
    notes += why
    notes += inverse_note(recording, loop, f[valid], G[valid, 0, 0])
    notes += a.notes + band_note(f, valid)
    notes += tuple(n for r in recordings for n in early_note(r) + held_note(r, loop))
    return FRF(
        frequency_hz=f,
        response=G,
        covariance=covariance,
        noise_covariance=None if plant.noise is None else plant.noise[rows],
        valid=valid,
        inputs=(s.input_channel.column,),
        outputs=(s.output_channel.column,),
        method=f"{settings.estimator} estimator, {a.method}",
        loop=loop.name,
        coherence=np.clip(ordinary_coherence(a.power, 0, 1), 0.0, 1.0),
        input_power=a.power[:, 1, 1].real,
        output_power=a.power[:, 0, 0].real,
        cross_power=a.power[:, 0, 1],
        recorded_under=loop.controller if info.closed_loop else None,
        open_loop=stayed_bounded(recordings, [loop], [loop.output]),
        notes=tuple(dict.fromkeys(notes)),
        **source(recordings, a),
    )


def source(recordings: Sequence[Recording], a: Answers) -> dict[str, Any]:
    """What an FRF says of the recordings that it was made of, and of how these answers were."""
    info = recordings[0].info
    return {
        "recording": joined([r.info.name for r in recordings]),
        "recordings": tuple(r.info.name for r in recordings),
        "rate_hz": recordings[0].rate_hz,
        "operating_point": dict(info.operating_point),
        "parameters": dict(info.parameters),
        "method_numbers": a.method_numbers,
        "power_per": a.power_per,
        "line_overlap": a.line_overlap,
        "variance_freedom": a.freedom,
        "variance_pooled": a.pooled,
        "averages": a.averages,
    }


def _refuse_spectral(recording: Recording, settings: Settings) -> None:
    """Refuse spectral estimators where feedback biases all of them, and where whole periods are at hand."""
    name, info = settings.estimator.capitalize(), recording.info
    if info.closed_loop:
        raise WrongUseError(
            f"{name} is for records in open loop: under feedback it is biased towards -1/C ({info.file})",
            "closed_loop = true",
            "use the reference estimator, or direct, which says where it is biased",
        )
    if info.period_s is not None:
        raise WrongUseError(
            f"{name} averages segments, and {info.file} repeats: whole periods separate noise from signal better",
            f"period_s = {info.period_s:g}",
            "use the reference estimator, or take period_s out of run.toml",
        )


def _by_spectra(plant: PlantEstimate, a: Answers, estimator: str) -> PlantEstimate:
    """H1 as it is; H2 = H1/coherence and Hv = H1/sqrt(coherence) = sqrt(H1 H2) (Rocklin, Crowley, Vold, IMAC 1985).

    To first order all three scatter alike, relative to themselves; Hv takes noise to signal as equal at both ends.
    """
    power = {"h2": 1.0, "hv": 0.5}.get(estimator)
    if power is None:
        return plant
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = (1.0 / ordinary_coherence(a.power, 0, 1) ** power)[:, None, None]
        return PlantEstimate(plant.response * factor, plant.covariance * factor**2, plant.noise, plant.drowned)


def _valid(
    plant: PlantEstimate,
    rows: np.ndarray,
    a: Answers,
    G: ComplexArray,
    variance: Array,
    recording: Recording,
    loop: LoopSetup,
    settings: Settings,
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Lines (nf,) of the valid band of an estimate G (nf,) of this variance, and why others are outside."""
    sound = plant.sound(rows)
    notes = drowned_note(a.frequency_hz, sound)
    if settings.estimator == "direct":
        biased, why = biased_lines(recording, loop, settings, a, G, variance)
        sound, notes = sound & ~biased, notes + why
    relative = np.where(sound, np.sqrt(variance) / np.abs(G), np.inf)
    valid = valid_lines(a.frequency_hz, relative, a.excited) & sound
    if a.unresolved is not None:
        valid = valid & ~a.unresolved
    return valid, notes


def drowned_note(frequency_hz: Array, sound: np.ndarray) -> tuple[str, ...]:
    """A warning where loop noise exceeds the excitation at the plant input."""
    if np.mean(~sound) < TOL.drowned_share:
        return ()
    f = frequency_hz[~sound]
    return (
        f"at {f.size} of {frequency_hz.size} frequencies, {f[0]:.3g} to {f[-1]:.3g} Hz, loop noise exceeds the"
        " excitation at the plant input: the quotient would be -1/C, and these frequencies are outside the valid band;"
        " excite more or measure longer",
    )


def _kept(excited: np.ndarray) -> np.ndarray:
    """Lines worth keeping: from the first to the last excited one for dense lines, else the excited ones."""
    k = np.flatnonzero(excited)
    keep = np.zeros(excited.size, dtype=bool)
    if k.size:
        dense = k.size > 0.9 * (k[-1] - k[0] + 1)
        keep[slice(k[0], k[-1] + 1) if dense else k] = True
    return keep


def band_note(f: Array, valid: np.ndarray) -> tuple[str, ...]:
    """A warning where few lines or none are known well."""
    if valid.any():
        known = f[valid]
        if known.size > 0.1 * f.size:
            return ()
        return (
            f"only {known.size} of {f.size} excited frequencies are known well, {known[0]:.3g} to {known[-1]:.3g} Hz:"
            " excite more, measure longer, or ask for a coarser resolution",
        )
    return (f"no frequency between {f[0]:.3g} and {f[-1]:.3g} Hz is known to 10 %: excite more or measure longer",)


def early_note(recording: Recording) -> tuple[str, ...]:
    """A warning where the recording ended before it should have."""
    ended = recording.info.ended_early
    return () if ended is None else (f"the recording ended early: {ended}",)


def alike(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Groups of periodic recordings that excite one loop, alike but for the draw of phases; others stand alone."""
    return _grouped(recordings, lambda r: (*_conditions(r), r.info.excited, r.info.period_s or r.info.name))


def matrices(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Groups at one operating point that together excite two loops or more.

    Where a point has recordings of several kinds, those that excite all loops at once are taken, else periodic ones,
    else the rest.
    """
    found = []
    for group in _grouped(recordings, _conditions):
        together = [r for r in group if r.info.excites_also]
        periodic = [r for r in group if r.info.period_s is not None and not r.info.excites_also]
        other = [r for r in group if r.info.period_s is None and not r.info.excites_also]
        spans = [g for g in (together, periodic, other) if len({n for r in g for n in r.info.excited}) > 1]
        found += spans[:1]
    return found


def _conditions(r: Recording) -> tuple[Hashable, ...]:
    """What recordings that are taken together must share."""
    point, settings = sorted(r.info.operating_point.items()), sorted(r.info.parameters.items())
    return (tuple(point), tuple(settings), r.info.injection, r.info.closed_loop)


def _grouped(recordings: Sequence[Recording], key: Callable[[Recording], Hashable]) -> list[list[Recording]]:
    groups: dict[Hashable, list[Recording]] = {}
    for r in recordings:
        groups.setdefault(key(r), []).append(r)
    return list(groups.values())
