"""`loopshape frf`: estimate the FRFs of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.data.response.frf import FRF
    from loopshape.data.result.estimates import Estimates
    from loopshape.data.signal.run import Run


def frf(
    run: RunFolder,
    estimator: Annotated[
        str,
        typer.Option(help="reference, joint, direct (biased by feedback); open loop: h1, h2, hv."),
    ] = "reference",
    method: Annotated[str, typer.Option(help="auto, welch, or local; for records without a period.")] = "auto",
    resolution_hz: Annotated[float | None, typer.Option(help="Frequency resolution; default by the record.")] = None,
    overlap: Annotated[float, typer.Option(min=0.0, max=0.9, help="Overlap of Welch's segments.")] = 0.75,
    window: Annotated[
        str, typer.Option(help="Welch: hann, hamming, blackman(harris), bartlett, flattop, boxcar.")
    ] = "hann",
    symmetric: Annotated[bool, typer.Option("--symmetric", help="The window's symmetric form, not periodic.")] = False,
    detrend: Annotated[
        str, typer.Option(help="Removed from each of Welch's segments: mean, linear, or none.")
    ] = "mean",
    segment_samples: Annotated[
        int | None, typer.Option(help="Length of Welch's segments; in place of --resolution-hz.")
    ] = None,
    realisations: Annotated[
        bool, typer.Option("--realisations", help="Average over random-phase realisations.")
    ] = False,
    matrix: Annotated[bool, typer.Option("--matrix", help="Estimate the plant's matrix of all loops too.")] = False,
    renew: Annotated[
        Path | None,
        typer.Option(help="An earlier run of the plant whose FRFs this run's valid band renews."),
    ] = None,
    csv: Annotated[bool, typer.Option("--csv", help="Write each FRF as a table too.")] = False,
    figures: Annotated[bool, typer.Option(help="Draw a page for each FRF, and an overview of each loop.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Estimate FRFs with variance, coherence and valid band. Draws a page of each, and an overview of each loop."""
    estimate_and_report(
        run, Output(as_json, quiet), figures=figures, csv=csv, matrix=matrix, realisations=realisations, renew=renew,
        estimator=estimator, method=method, resolution_hz=resolution_hz, overlap=overlap, window=window,
        symmetric=symmetric, detrend=detrend, segment_samples=segment_samples,
    )  # fmt: skip


def estimate_and_report(
    folder: Path,
    output: Output,
    *,
    figures: bool = True,
    csv: bool = False,
    matrix: bool = False,
    ended_early: Sequence[str] = (),
    made: Run | None = None,
    **settings: Any,
) -> None:
    """Estimate, store, draw and print the FRFs of a run; exit code 2 where a recording `ended_early`.

    `made` is the run in the folder where it was read already; `settings` as in `ls.estimate`.
    """
    from loopshape.verbs.estimates import estimate, store
    from loopshape.verbs.files import read
    from loopshape.verbs.pictures import draw_frfs, draw_matrices, figures_of

    run = made or read(folder)
    for note in run.extra.get("notes", ()):
        output.say(str(note))
    found = estimate(run, matrix=matrix or None, watch=output, **settings)
    store(folder, run, found, matrices=matrix, csv=csv)
    drawn: list[str] = []
    if figures:
        drawn = draw_frfs(figures_of(folder), found.frfs, watch=output)
        drawn += draw_matrices(figures_of(folder), found.matrices)
    report(found, output, folder, drawn, ended_early)
    if ended_early:
        raise typer.Exit(2)


def report(found: Estimates, output: Output, folder: Path, drawn: list[str], ended_early: Sequence[str]) -> None:
    """Table, warnings and JSON of estimated FRFs and matrices."""
    import numpy as np

    from loopshape.view.labels import methods_by_loop as by_loop

    columns = ["recording", "loop", "operating point", "valid from [Hz]", "to [Hz]", "lines", "median std [dB]"]
    distorted = any(one.noise_covariance is not None for one in found.frfs)
    columns += ["of it distortion [%]"] if distorted else []
    keys = ["recording", "loop", "operating_point", "valid_from_hz", "valid_to_hz", "lines", "median_std_db"]
    keys += ["distortion_percent"] if distorted else []
    rows = []
    for one in found.frfs:
        lines = _valid(one)
        spread = float(20.0 * np.log10(1.0 + np.median(lines.modulus_std[:, 0, 0])))
        rows.append([one.recording, one.loop, *_where(one), spread, *([distortion_share(lines)] if distorted else [])])
    if rows:
        output.table("Frequency responses", columns, rows)
    matrix_rows = matrix_table(found.matrices, output)
    for remark in found.remarks:
        output.say(remark.sentence)
    for line in by_loop([*found.frfs, *found.matrices]):
        output.say(f"method: {line}")
    warnings = [*found.warnings, *ended_early, *found.notes]
    output.warn(warnings)
    if drawn:
        output.say(f"{len(drawn)} figures in {folder / 'figures'}")
    frfs = zip(rows, found.frfs, strict=True)
    output.json(
        found.to_dict()
        | {
            "run": str(folder),
            "frfs": [dict(zip(keys, row, strict=True)) | {"method": one.method} for row, one in frfs],
            "matrices": matrix_rows,
            "figures": drawn,
            "warnings": warnings,
        }
    )


def _valid(frf: FRF) -> FRF:
    """The lines in the valid band; all where there is none."""
    return frf.select(frf.valid) if frf.valid.any() else frf


def _where(frf: FRF) -> tuple[Any, ...]:
    """Operating point, valid band in Hz, and how many lines lie in it."""
    return point(frf.operating_point, frf.parameters), *frf.valid_band_hz, int(frf.valid.sum())


_OF_MATRIX = (
    "recordings", "loops", "outputs", "operating_point", "valid_from_hz", "valid_to_hz", "lines", "std_percent",
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


def distortion_share(frf: FRF) -> float | None:
    """Median share in percent of the variance that noise does not explain; None where they cannot be told apart."""
    import numpy as np

    if frf.noise_covariance is None:
        return None
    total, noise = frf.covariance[:, 0, 0].real, frf.noise_covariance[:, 0, 0].real
    return float(100.0 * np.median(np.clip(1.0 - noise / np.maximum(total, 1e-300), 0.0, 1.0)))
