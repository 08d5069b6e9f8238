"""`loopshape frf`: estimate the FRFs of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.frf import FRF


def frf(
    run: RunFolder,
    estimator: Annotated[str, typer.Option(help="reference, or direct (biased under feedback).")] = "reference",
    resolution_hz: Annotated[float | None, typer.Option(help="Distance between lines; default by the record.")] = None,
    overlap: Annotated[float, typer.Option(min=0.0, max=0.9, help="Overlap of Welch's segments.")] = 0.75,
    csv: Annotated[bool, typer.Option("--csv", help="Write each FRF as a table too.")] = False,
    figures: Annotated[bool, typer.Option(help="Draw a page for each FRF, and an overview of each loop.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the FRFs of a run with variance, coherence and trusted band, and draw them."""
    output = Output(as_json, quiet)
    settings = {"estimator": estimator, "resolution_hz": resolution_hz, "overlap": overlap}
    estimate_and_report(run, output, settings=settings, figures=figures, csv=csv)


def estimate_and_report(
    folder: Path,
    output: Output,
    *,
    settings: Mapping[str, Any] | None = None,
    figures: bool = True,
    csv: bool = False,
    extra: Mapping[str, Any] | None = None,
) -> None:
    """Estimate, store, draw and print the FRFs of a run; exit code 2 where a recording ended early."""
    from loopshape.errors import BadSignalError
    from loopshape.estimate.frequency_response import estimate_frf, excited_recordings
    from loopshape.estimate.transforms import Settings
    from loopshape.store.frfs import frf_csv, write_frfs
    from loopshape.store.run_folder import check_recordings, read_run

    run = read_run(folder)
    warnings = check_recordings(run)
    for note in run.extra.get("notes", ()):
        output.say(str(note))
    chosen = Settings(**(settings or {}))
    recordings = excited_recordings(run)
    found = []
    with output.progress("estimate", len(recordings)) as step:
        for recording in recordings:
            try:
                found.append(estimate_frf(recording, run.loop(str(recording.info.excites)), chosen))
            except BadSignalError as error:
                if recording.info.ended_early is None:
                    raise
                warnings.append(f"{recording.info.name}: {recording.info.ended_early}; no FRF from it ({error.what})")
            step(recording.info.name)
    if not found:
        raise BadSignalError(f"no recording of {folder} gives a FRF", "; ".join(warnings), "excite less, or elsewhere")
    write_frfs(folder, found)
    if csv:
        for one in found:
            frf_csv(folder / "frf" / f"{one.recording}.{one.loop}.csv", one)
    drawn = draw_frfs(folder, found, output) if figures else []
    report(found, output, folder, drawn, warnings, extra or {})
    if (extra or {}).get("ended_early"):
        raise typer.Exit(2)


def draw_frfs(folder: Path, frfs: list[FRF], output: Output) -> list[str]:
    """A page for each FRF, an overview of each loop."""
    from loopshape.cli.pictures import save
    from loopshape.draw.frequency import frf_overview, frf_page

    drawn = []
    loops = list(dict.fromkeys(one.loop for one in frfs))
    with output.progress("draw", len(frfs)) as step:
        for loop in loops:
            mine = [one for one in frfs if one.loop == loop]
            drawn.append(str(save(frf_overview(mine), folder / "figures" / f"frf_{loop}.png")))
            for one in mine:
                name = f"frf_{one.loop}_{one.recording}.png"
                drawn.append(str(save(frf_page(one), folder / "figures" / name)))
                step(one.recording)
    return drawn


def report(
    frfs: list[FRF],
    output: Output,
    folder: Path,
    drawn: list[str],
    warnings: list[str],
    extra: Mapping[str, Any],
) -> None:
    """Table, warnings and JSON of estimated FRFs."""
    import numpy as np

    columns = ["recording", "loop", "operating point", "trusted from [Hz]", "to [Hz]", "lines", "median std [dB]"]
    rows = []
    for one in frfs:
        lines = one.select(one.trusted) if one.trusted.any() else one
        std = np.sqrt(0.5 * lines.variance[:, 0, 0]) / np.abs(lines.siso)
        low, high = one.trusted_band_hz
        count = int(one.trusted.sum())
        spread = float(20.0 * np.log10(1.0 + np.median(std)))
        rows.append([one.recording, one.loop, point(one.operating_point, one.parameters), low, high, count, spread])
    output.table("Frequency responses", columns, rows)
    for method in dict.fromkeys(one.method for one in frfs):
        output.say(f"estimated by the {method}")
    early = list(extra.get("ended_early", ()))
    notes = [f"{one.recording}: {note}" for one in frfs for note in one.notes]
    output.warn([*warnings, *early, *notes])
    if drawn:
        output.say(f"{len(drawn)} figures in {folder / 'figures'}")
    keys = ("recording", "loop", "operating_point", "trusted_from_hz", "trusted_to_hz", "lines", "median_std_db")
    output.json(
        {
            "run": str(folder),
            "frfs": [
                dict(zip(keys, r, strict=True)) | {"method": one.method} for r, one in zip(rows, frfs, strict=True)
            ],
            "figures": drawn,
            "warnings": [*warnings, *early, *notes],
        }
    )
