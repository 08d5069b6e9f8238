"""`loopshape compare`: hold a run under new controllers against what was predicted of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point
from loopshape.toolbox.validation.predicted.command import STEP_COLUMNS

if TYPE_CHECKING:
    from loopshape.toolbox.validation.nouns import Comparison, StepComparison
    from loopshape.toolbox.validation.remeasured import Remeasured


def compare(
    run: RunFolder,
    prediction: Annotated[
        Path, typer.Argument(help="What `loopshape predict` wrote (.npz), or another run.", show_default=False)
    ],
    tolerance_db: Annotated[
        float, typer.Option(min=0.0, help="Deviations of |S| of this rms size count as none, in dB.")
    ] = 0.0,
    resolution_hz: Annotated[float | None, typer.Option(help="As of `loopshape frf`; default: as it chooses.")] = None,
    figures: Annotated[bool, typer.Option(help="Draw predicted over measured.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Validate predictions against a measurement.

    Each confirmed, or where not and by how much; exit code 0 where all are. With another run, also one of import-frf,
    in the place of predictions the FRFs of both are compared.
    """
    from loopshape.toolbox.validation.pictures import draw_remeasured
    from loopshape.toolbox.validation.verbs import compare_run
    from loopshape.verbs.pictures import figures_of

    output = Output(as_json, quiet)
    found = compare_run(run, prediction, tolerance_db=tolerance_db, resolution_hz=resolution_hz)
    if found.predictions is None:
        _report_two_runs(found.comparisons, output)
        output.say(f"FRFs: {found.outcome}")
        output.json({"outcome": found.outcome, "comparisons": found.comparisons})
    else:
        drawn = draw_remeasured(figures_of(run), found.predictions) if figures else []
        report(found.predictions, output)
        output.say("\n".join([*(["figures:", *drawn] if drawn else []), f"predictions: {found.outcome}"]))
        output.json({"outcome": found.outcome, "predictions": found.predictions, "figures": drawn})
    if not found.confirmed:
        raise typer.Exit(1)


def _report_two_runs(found: Sequence[Comparison], output: Output) -> None:
    """FRFs of two runs: a row of each pair."""
    columns = ["loop", "first", "second", "outcome", "p-value", "lines", "worst band [Hz]", "P off [dB]"]
    rows = [
        [c.loop, c.predicted_from, c.measured_from, c.outcome, f"{c.p_value:.2g}", c.lines, *_off(c), c.noticed_db]
        for c in found
    ]
    output.table("FRFs of two runs", [*columns, "would notice [dB]"], rows)
    output.warn(f"{c.measured_from}: {note}" for c in found for note in c.notes)


def _off(c: Comparison) -> list[str]:
    worst = c.worst
    return (
        ["-", "-"] if worst is None else [f"{worst.low_hz:.3g} .. {worst.high_hz:.3g}", f"{worst.sensitivity_db:+.2f}"]
    )


def report(found: Sequence[Remeasured], output: Output) -> None:
    """Tables of sensitivities, steps and profiles."""
    comparisons = [c for one in found for c in one.comparisons]
    for loop in dict.fromkeys(c.loop for c in comparisons):
        rows = [_row(c) for c in comparisons if c.loop == loop]
        columns = ["recording", "operating point", "prediction", "p-value", "lines", "|S| pred. [dB]", "meas. [dB]"]
        columns += ["worst band [Hz]", "S off [dB]", "T off [dB]", "would notice [dB]"]
        output.table(f"Sensitivity of loop {loop}", columns, rows)
    if comparisons:
        output.say(
            "all comparisons together reject a true prediction 5 % of the time; would notice: the change of the"
            " plant's gain that is found four times in five"
        )
    steps = [s for one in found for s in one.steps]
    for loop in dict.fromkeys(s.loop for s in steps):
        rows = [_step_row(s) for s in steps if s.loop == loop]
        columns = ["recording", "operating point", "at [s]", "step", *STEP_COLUMNS, "largest miss [%]", "outside [%]"]
        output.table(f"Steps of loop {loop}, measured (predicted)", columns, rows)
    profiles = [[name, one.prediction.loop, *_tracked(t)] for one in found for name, t in one.profiles.items()]
    if profiles:
        columns = ["recording", "loop", "largest error", "predicted", "rms error", "predicted"]
        output.table("Profiles", columns, profiles)
    notes = [(c.measured_from, note) for c in comparisons for note in c.notes]
    notes += [(frf.recording, note) for one in found for frf in one.measured for note in frf.notes]
    notes += [(s.recording, note) for s in steps for note in s.notes]
    output.warn(f"{name}: {note}" for name, note in notes)
    unseen = [one for one in found if not one.comparisons]
    output.warn(
        f"nothing measured of loop {one.prediction.loop} predicted from {one.prediction.recording}" for one in unseen
    )


def _row(c: Comparison) -> list[Any]:
    worst = c.worst
    where = ["-", "-", "-"]
    if worst is not None:
        where = [
            f"{worst.low_hz:.3g} .. {worst.high_hz:.3g}",
            f"{worst.sensitivity_db:+.2f}",
            f"{worst.complementary_db:+.2f}",
        ]
    return [
        c.measured_from, point(c.operating_point), c.outcome, f"{c.p_value:.2g}", c.lines,
        c.predicted_peak_db, c.measured_peak_db, *where, c.noticed_db,
    ]  # fmt: skip


def _step_row(s: StepComparison) -> list[Any]:
    from loopshape.toolbox.validation.predicted.nouns import indicator_texts

    cells = indicator_texts(s.measured)
    if s.predicted is not None:
        pairs = zip(cells, indicator_texts(s.predicted.indicators), strict=True)
        cells = [f"{own} ({predicted.split(' ')[0]})" for own, predicted in pairs]
    return [
        s.recording, point(s.operating_point), s.at_s, s.size, *cells, 100.0 * s.largest_miss, 100.0 * s.outside,
    ]  # fmt: skip


def _tracked(t: Any) -> list[float]:
    return [t.largest_error, t.predicted_largest_error, t.rms_error, t.predicted_rms_error]
