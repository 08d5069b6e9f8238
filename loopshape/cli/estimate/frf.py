"""`loopshape frf`: estimate the FRFs of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point
from loopshape.cli.pictures import figures_of

if TYPE_CHECKING:
    from loopshape.data.response.frf import FRF
    from loopshape.data.signal.recording import Recording
    from loopshape.data.signal.run import Run
    from loopshape.identify.settings import Settings


def frf(
    run: RunFolder,
    estimator: Annotated[
        str,
        typer.Option(help="reference (or joint), direct (biased under feedback); in open loop h1, h2 or hv too."),
    ] = "reference",
    method: Annotated[str, typer.Option(help="auto, welch, or local; for records without a period.")] = "auto",
    resolution_hz: Annotated[float | None, typer.Option(help="Frequency resolution; default by the record.")] = None,
    overlap: Annotated[float, typer.Option(min=0.0, max=0.9, help="Overlap of Welch's segments.")] = 0.75,
    window: Annotated[
        str, typer.Option(help="Welch: hann, hamming, blackman, blackmanharris, bartlett, flattop or boxcar.")
    ] = "hann",
    symmetric: Annotated[bool, typer.Option("--symmetric", help="The window's symmetric form, not periodic.")] = False,
    detrend: Annotated[str, typer.Option(help="Taken off each of Welch's segments: mean, linear, or none.")] = "mean",
    segment_samples: Annotated[
        int | None, typer.Option(help="Length of Welch's segments; in place of --resolution-hz.")
    ] = None,
    realisations: Annotated[
        bool, typer.Option("--realisations", help="Average over random-phase realisations.")
    ] = False,
    matrix: Annotated[bool, typer.Option("--matrix", help="Estimate the plant's matrix of all loops too.")] = False,
    renew: Annotated[
        Path | None,
        typer.Option(
            help="An earlier run of the same plant: its FRFs with this run's valid frequencies in their band."
        ),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write each FRF as a table too.")] = False,
    figures: Annotated[bool, typer.Option(help="Draw a page for each FRF, and an overview of each loop.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Estimate FRFs with variance, coherence and valid band. Draws a page of each, and an overview of each loop."""
    output = Output(as_json, quiet)
    settings = {
        "estimator": estimator,
        "method": method,
        "resolution_hz": resolution_hz,
        "overlap": overlap,
        "window": window,
        "symmetric": symmetric,
        "detrend": detrend,
        "segment_samples": segment_samples,
    }
    estimate_and_report(
        run, output, settings=settings, figures=figures, csv=csv, realisations=realisations, matrix=matrix, renew=renew
    )


def estimate_and_report(
    folder: Path,
    output: Output,
    *,
    settings: Mapping[str, Any] | None = None,
    figures: bool = True,
    csv: bool = False,
    realisations: bool = False,
    matrix: bool = False,
    renew: Path | None = None,
    extra: Mapping[str, Any] | None = None,
    made: Run | None = None,
) -> None:
    """Estimate, store, draw and print the FRFs of a run; exit code 2 where a recording ended early.

    The plant's matrix is estimated where it is asked for, and where recordings excite several loops at once, which
    give no FRF of one loop. `made` is the run in the folder where it was read already.
    """
    from loopshape.core.errors import BadSignalError
    from loopshape.identify.frequency_response import excited_recordings
    from loopshape.identify.settings import Settings
    from loopshape.io.held import held
    from loopshape.io.run.run_folder import check_recordings, read_run
    from loopshape.io.write.frfs import frf_csv, write_frfs, write_matrices
    from loopshape.toolbox.gap.two_runs.levels import level_dependences
    from loopshape.verbs.several import matrices_of

    run = made or read_run(folder)
    warnings = check_recordings(run)
    for note in run.extra.get("notes", ()):
        output.say(str(note))
    chosen = Settings(**(settings or {}))
    recordings = excited_recordings(run)
    alone = [r for r in recordings if r.info.alone]
    found = _estimate(run, alone, chosen, realisations, output, warnings)
    found = found if renew is None else _renewed(renew, found)
    wanted = matrix or len(alone) < len(recordings)
    matrices = matrices_of(run, recordings, chosen, output) if wanted else []
    if not found and not matrices:
        raise BadSignalError(f"no recording of {folder} gives a FRF", "; ".join(warnings), "excite less, or elsewhere")
    with held(folder):
        write_frfs(folder, found, run)
        if matrices or matrix:
            write_matrices(folder, matrices, run)
    if csv:
        for one in [*found, *matrices]:
            frf_csv(folder / "frf" / f"{one.recording}.{one.loop}.csv", one)
    warnings += _growing(run, recordings)
    drawn = draw_frfs(folder, found, output) + draw_matrices(folder, matrices) if figures else []
    told = {"distortion": distortion_words(run, alone), "levels": level_dependences(run, found)}
    report(found, output, folder, drawn, warnings, dict(extra or {}) | told, matrices)
    if (extra or {}).get("ended_early"):
        raise typer.Exit(2)


def _renewed(earlier: Path, found: Sequence[FRF]) -> list[FRF]:
    """The earlier run's FRFs, each renewed by the one of its loop and point; a FRF of a new point stays as it is."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.write.frfs import read_frfs

    made: list[FRF] = []
    old, met = read_frfs(earlier), 0
    for new in found:
        same = [one for one in old if _point(one) == _point(new)]
        if len(same) > 1:
            what = f"several FRFs in {earlier} are of one loop and operating point"
            raise WrongUseError(what, ", ".join(one.recording for one in same), "renew one by FRF.renewed in Python")
        met += len(same)
        renewed = same[0].renewed(new) if same else new
        made.append(replace(renewed, recording=new.recording, recordings=new.recordings))
    if not met:
        points = "; ".join(f"{one.loop} {point(one.operating_point, one.parameters)}" for one in found)
        what = f"no FRF in {earlier} is of a loop and operating point measured here"
        raise WrongUseError(what, points, "measure the point once more, or leave --renew out")
    return made


def _point(frf: FRF) -> tuple[object, ...]:
    return frf.loop, dict(frf.operating_point), dict(frf.parameters)


def _growing(run: Run, recordings: Sequence[Recording]) -> list[str]:
    """Warnings of tones in the excited loops' outputs that grow and that the excitation does not explain.

    Recordings that are not held whole are left to `loopshape tones`: the look would take longer than their estimate.
    """
    from loopshape.core.errors import BadSignalError
    from loopshape.core.stretches import LongSignal
    from loopshape.data.signal.channel import sum_terms
    from loopshape.toolbox.planning.tone.tones import SHORTEST
    from loopshape.toolbox.planning.tone.verbs import tones_in

    words: list[str] = []
    for recording in recordings:
        columns = dict.fromkeys(c for name in recording.info.excited for c in sum_terms(run.loop(name).output))
        with suppress(BadSignalError):  # a column that the FRF does without may hold what is no number
            stored = recording.stored(next(iter(columns)))
            if stored.size >= SHORTEST and not isinstance(stored, LongSignal):
                words += [w for found in tones_in(run, recording, list(columns)) for w in found.warnings]
    return words


def _estimate(
    run: Run, recordings: list[Recording], settings: Settings, realisations: bool, output: Output, warnings: list[str]
) -> list[FRF]:
    """FRFs of single loops; a recording that ended early and gives none is a warning."""
    from loopshape.core.errors import BadSignalError
    from loopshape.identify import groups
    from loopshape.identify.frequency_response import estimate_together

    grouped = groups.realisations(recordings) if realisations else [[r] for r in recordings]
    found = []
    with output.progress("estimate", len(grouped)) as step:
        for group in grouped:
            loop = run.loop(str(group[0].info.excites))
            try:
                found.append(estimate_together(group, loop, settings))
            except BadSignalError as error:
                info = group[0].info
                if info.ended_early is None:
                    raise
                warnings.append(f"{info.name}: {info.ended_early}; no FRF from it ({error.what})")
            step(group[0].info.name)
    return found


def distortion_words(run: Run, recordings: list[Recording]) -> list[str]:
    """What periodic recordings with lines left out say of distortion: a sentence for each loop and operating point."""
    from loopshape.identify.quality.distortion import distortion

    words: list[str] = []
    first: dict[Any, Recording] = {}
    for recording in (r for r in recordings if r.info.period_s is not None):
        first.setdefault((recording.info.excites, tuple(sorted(recording.info.operating_point.items()))), recording)
    for recording in first.values():
        found = distortion(recording, run.loop(str(recording.info.excites)))
        if found.told:
            words.append(f"{recording.info.name}: {found.verdict}")
    return words


def draw_frfs(folder: Path, frfs: list[FRF], output: Output) -> list[str]:
    """A page for each FRF, an overview of each loop."""
    from loopshape.cli.pictures import save
    from loopshape.view.plots.frequency import frf_overview, frf_page

    drawn = []
    loops = list(dict.fromkeys(one.loop for one in frfs))
    with output.progress("draw", len(frfs)) as step:
        for loop in loops:
            mine = [one for one in frfs if one.loop == loop]
            drawn.append(str(save(frf_overview(mine), figures_of(folder) / f"frf_{loop}.png")))
            for one in mine:
                name = f"frf_{one.loop}_{one.recording}.png"
                drawn.append(str(save(frf_page(one), figures_of(folder) / name)))
                step(one.recording)
    return drawn


def report(
    frfs: list[FRF],
    output: Output,
    folder: Path,
    drawn: list[str],
    warnings: list[str],
    extra: Mapping[str, Any],
    matrices: Sequence[FRF] = (),
) -> None:
    """Table, warnings and JSON of estimated FRFs and matrices."""
    import numpy as np

    from loopshape.view.labels import methods_by_loop as by_loop

    columns = ["recording", "loop", "operating point", "valid from [Hz]", "to [Hz]", "lines", "median std [dB]"]
    told = any(one.noise_covariance is not None for one in frfs)
    columns += ["of it distortion [%]"] if told else []
    rows = []
    for one in frfs:
        lines = _valid(one)
        spread = float(20.0 * np.log10(1.0 + np.median(lines.modulus_std[:, 0, 0])))
        share = [distortion_share(lines)] if told else []
        rows.append([one.recording, one.loop, *_where(one), spread, *share])
    if rows:
        output.table("Frequency responses", columns, rows)
    matrix_rows = matrix_table(matrices, output)
    for words in extra.get("distortion", ()):
        output.say(words)
    for found in extra.get("levels", ()):
        output.say(found.sentence)
    for line in by_loop([*frfs, *matrices]):
        output.say(f"method: {line}")
    early = list(extra.get("ended_early", ()))
    notes = [f"{one.recording}: {note}" for one in [*frfs, *matrices] for note in one.notes]
    output.warn([*warnings, *early, *notes])
    if drawn:
        output.say(f"{len(drawn)} figures in {folder / 'figures'}")
    keys = ["recording", "loop", "operating_point", "trusted_from_hz", "trusted_to_hz", "lines", "median_std_db"]
    keys += ["distortion_percent"] if told else []
    output.json(
        {
            "run": str(folder),
            "frfs": [
                dict(zip(keys, r, strict=True)) | {"method": one.method} for r, one in zip(rows, frfs, strict=True)
            ],
            "matrices": matrix_rows,
            "distortion": extra.get("distortion", ()),
            "levels": extra.get("levels", ()),
            "figures": drawn,
            "warnings": [*warnings, *early, *notes],
        }
    )


def _valid(frf: FRF) -> FRF:
    """The lines in the valid band; all where there is none."""
    return frf.select(frf.trusted) if frf.trusted.any() else frf


def _where(frf: FRF) -> tuple[Any, ...]:
    """Operating point, valid band in Hz, and how many lines lie in it."""
    return point(frf.operating_point, frf.parameters), *frf.trusted_band_hz, int(frf.trusted.sum())


_OF_MATRIX = (
    "recordings", "loops", "outputs", "operating_point", "trusted_from_hz", "trusted_to_hz", "lines", "std_percent",
)  # fmt: skip


def matrix_table(frfs: Sequence[FRF], output: Output) -> list[dict[str, Any]]:
    """Print the table of a plant's matrices, a row each; gives the rows for JSON."""
    import numpy as np

    if not frfs:
        return []
    stds = [100.0 * float(np.median(_valid(one).modulus_std)) for one in frfs]
    rows = [[one.recording, one.loop, len(one.outputs), *_where(one), std] for one, std in zip(frfs, stds, strict=True)]
    columns = ["recordings", "loops", "outputs", "operating point", "valid from [Hz]", "to [Hz]", "lines"]
    output.table("The plant's matrices", [*columns, "median std of elements [%]"], rows)
    return [dict(zip(_OF_MATRIX, row, strict=True)) | {"method": f.method} for row, f in zip(rows, frfs, strict=True)]


def draw_matrices(folder: Path, frfs: Sequence[FRF]) -> list[str]:
    """A page for each matrix."""
    from loopshape.cli.pictures import save
    from loopshape.view.plots.matrix import matrix_page

    tails = [f"_{k + 1:02d}" if len(frfs) > 1 else "" for k in range(len(frfs))]
    names = [f"matrix_{one.loop}{tail}.png" for one, tail in zip(frfs, tails, strict=True)]
    return [str(save(matrix_page(one), figures_of(folder) / name)) for one, name in zip(frfs, names, strict=True)]


def distortion_share(frf: FRF) -> float | None:
    """Median share in percent of the variance that noise does not explain; None where they cannot be told apart."""
    import numpy as np

    if frf.noise_covariance is None:
        return None
    total, noise = frf.covariance[:, 0, 0].real, frf.noise_covariance[:, 0, 0].real
    return float(100.0 * np.median(np.clip(1.0 - noise / np.maximum(total, 1e-300), 0.0, 1.0)))
