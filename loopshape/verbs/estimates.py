"""A run -> its FRFs, with all that looks at them: what `loopshape frf`, `ls.estimate` and `ls.frf` do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from loopshape.core.errors import BadSignalError, LoopshapeError, WrongUseError
from loopshape.core.toolboxes import found, function_at
from loopshape.data.response.frf import FRF
from loopshape.data.result.estimates import Estimates, Remark
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.identify.settings import Settings, settings_of
from loopshape.verbs.files import read
from loopshape.verbs.watch import Unwatched, Watch


def estimate(
    run: Run | str | Path,
    loop: str | None = None,
    *,
    realisations: bool = False,
    matrix: bool | None = None,
    renew: str | Path | None = None,
    watch: Watch | None = None,
    **settings: Any,
) -> Estimates:
    """All FRFs of a run with what a user has to know of them: what `loopshape frf` prints and stores.

    FRFs of all recordings that excite one loop alone (or `loop`), in order. With `realisations` multisines that are
    alike but for their phases give one FRF, whose variance holds what a nonlinear plant answers differently to each
    draw; they are taken by periods. The plant's matrix at each operating point comes too with `matrix`, by default
    where recordings excite several loops at once, which give no FRF of one loop. `renew` is an earlier run of the
    same plant: its FRFs get this run's valid lines in their band (`FRF.renewed`). `settings` are estimator
    ("reference", "direct", in open loop "h1", "h2", "hv"), method, resolution_hz, window, overlap, detrend,
    segment_samples.

    `warnings` tell faults of the recordings, loops that recordings ended early left without an FRF, and tones that
    grow; `remarks` distortion and how the response depends on the excitation's level. Where nobody watches each
    warning is Python's too. Raises WrongUseError for a loop without recording, BadSignalError where no recording
    gives an FRF.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> u = np.random.default_rng(1).standard_normal(60_000)
    >>> found = ls.estimate(ls.Run.from_arrays(u=u, y=0.5 * u, rate_hz=1000.0))
    >>> len(found.frfs), found.warnings
    (1, ())
    """
    from loopshape.identify.frequency_response import excited_recordings
    from loopshape.io.run.run_folder import check_recordings

    alone_here, chosen = watch is None, settings_of(settings)
    watch = watch or Unwatched()
    whole = run if isinstance(run, Run) else read(run)
    name = None if loop is None else whole.loop(loop).name
    recordings = [r for r in excited_recordings(whole) if name is None or (r.info.alone and r.info.excites == name)]
    alone = [r for r in recordings if r.info.alone]
    if name is not None and not alone:
        raise WrongUseError("no recording excites this loop alone", f"loop {name!r}", "take all, or ls.frf_matrices")
    looked_at = whole if name is None else replace(whole, recordings=tuple(recordings))
    warnings = check_recordings(looked_at)
    frfs = _single(whole, alone, chosen, realisations, watch, warnings)
    frfs = frfs if renew is None else _renewed(Path(renew), frfs)
    several = matrix is not False and (matrix or len(alone) < len(recordings))
    matrices: list[FRF] = []
    if several:
        try:
            matrices = matrices_of(whole, recordings, chosen, watch)
        except BadSignalError as error:
            if matrix or not frfs:
                raise
            warnings.append(f"no matrix of the plant: {error}")
    if not frfs and not matrices and (alone if matrix is False else recordings):
        raise BadSignalError("no recording of the run gives an FRF", "; ".join(warnings), "excite less, or elsewhere")
    looked = list(_of_toolboxes(whole, recordings, frfs, watch))
    warnings += [one.sentence for one in looked if one.warning]
    if alone_here:
        watch.warn(warnings)
    return Estimates(tuple(frfs), tuple(matrices), tuple(warnings), tuple(x for x in looked if not x.warning))


def frf_matrices(run: Run | str | Path, **settings: Any) -> tuple[FRF, ...]:
    """The plant's matrix FRF (nf, ny, nu) at each operating point whose recordings excite two loops or more.

    `settings` as in `frfs`. Raises BadSignalError for a run without such an operating point.
    """
    from loopshape.identify.frequency_response import excited_recordings

    whole = run if isinstance(run, Run) else read(run)
    return tuple(matrices_of(whole, excited_recordings(whole), settings_of(settings), Unwatched()))


def matrices_of(run: Run, recordings: Sequence[Recording], settings: Settings, watch: Watch) -> list[FRF]:
    """The plant's matrix from these recordings of a run, at each operating point."""
    from loopshape.identify.frequency_response import matrices
    from loopshape.identify.matrix.matrix import estimate_matrix

    groups = matrices([r for r in recordings if r.info.ended_early is None])
    if not groups:
        raise BadSignalError(
            "no operating point of the run has recordings that excite two loops",
            ", ".join(f"{r.info.name}: {'+'.join(r.info.excited)}" for r in recordings),
            "excite each loop in a recording of its own, or several at once (excitations in a study)",
        )
    found = []
    with watch.progress("matrices", len(groups)) as step:
        for group in groups:
            found.append(estimate_matrix(run, group, settings))
            step(found[-1].loop)
    return found


def _single(
    run: Run, recordings: list[Recording], settings: Settings, realisations: bool, watch: Watch, warnings: list[str]
) -> list[FRF]:
    """FRFs of single loops; of a recording that ended early and gives none a sentence goes to `warnings`."""
    from loopshape.identify.frequency_response import alike, estimate_together

    grouped = alike(recordings) if realisations else [[r] for r in recordings]
    made = []
    with watch.progress("estimate", len(grouped)) as step:
        for group in grouped:
            info = group[0].info
            try:
                made.append(estimate_together(group, run.loop(str(info.excites)), settings))
            except BadSignalError as error:
                if info.ended_early is None:
                    raise
                warnings.append(f"{info.name}: {info.ended_early}; no FRF from it ({error.what})")
            step(info.name)
    return made


def _of_toolboxes(run: Run, recordings: Sequence[Recording], frfs: Sequence[FRF], watch: Watch) -> Iterable[Remark]:
    for kind, place in found().all("looks").items():
        try:
            with watch.progress(f"look for {kind}", 1):
                yield from function_at(place)(run, recordings, frfs)
        except LoopshapeError:
            raise
        except Exception as error:  # whatever a stranger's look does: the estimate does not hang on it
            yield Remark("looks", f"the look {kind} of a toolbox failed: {type(error).__name__}: {error}", warning=True)


def _renewed(earlier: Path, new: Sequence[FRF]) -> list[FRF]:
    """The earlier run's FRFs, each renewed by the one of its loop and point; an FRF of a new point stays as it is."""
    from loopshape.io.write.frfs import read_frfs

    made: list[FRF] = []
    old, matched = read_frfs(earlier), 0
    for frf in new:
        same = [one for one in old if _point(one) == _point(frf)]
        if len(same) > 1:
            what = f"several FRFs in {earlier} are of one loop and operating point"
            raise WrongUseError(what, ", ".join(one.recording for one in same), "renew one by FRF.renewed in Python")
        matched += len(same)
        renewed = same[0].renewed(frf) if same else frf
        made.append(replace(renewed, recording=frf.recording, recordings=frf.recordings))
    if not matched:
        points = "; ".join(f"{one.loop} {dict(one.operating_point) or ''}".strip() for one in new)
        what = f"no FRF in {earlier} is of a loop and operating point measured here"
        raise WrongUseError(what, points, "measure the point once more, or leave --renew out")
    return made


def _point(frf: FRF) -> tuple[object, ...]:
    return frf.loop, dict(frf.operating_point), dict(frf.parameters)


def store(folder: Path, run: Run, found: Estimates, *, matrices: bool = False, csv: bool = False) -> None:
    """Write estimates into the run's folder; with `matrices` also that there is none, with `csv` as tables too."""
    from loopshape.io.folder_lock import locked
    from loopshape.io.write.frfs import frf_csv, write_frfs, write_matrices

    with locked(folder):
        write_frfs(folder, found.frfs, run)
        if found.matrices or matrices:
            write_matrices(folder, found.matrices, run)
    for one in [*found.frfs, *found.matrices] if csv else ():
        frf_csv(folder / "frf" / f"{one.recording}.{one.loop}.csv", one)
