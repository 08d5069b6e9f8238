"""`loopshape compare`: hold a run under new controllers against what was predicted of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point
from loopshape.cli.pictures import figures_of
from loopshape.cli.verify.predict import STEP_COLUMNS, indicator_text

if TYPE_CHECKING:
    from loopshape.data.response.frf import FRF
    from loopshape.data.result.prediction import Comparison, StepComparison
    from loopshape.loop.predict.remeasured import Remeasured


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
    from loopshape.io.run.run_folder import read_run
    from loopshape.io.write.frfs import FOLDER, has_any, read_frfs
    from loopshape.io.write.predictions import read_predictions
    from loopshape.verbs.chain import compare as remeasure

    output = Output(as_json, quiet)
    if has_any(prediction, FOLDER):
        _two_runs(read_frfs(run), read_frfs(prediction), tolerance_db, output)
        return
    frfs = read_frfs(run) if has_any(run, FOLDER) else ()
    found = remeasure(
        read_run(run), read_predictions(prediction), frfs=frfs, resolution_hz=resolution_hz, tolerance_db=tolerance_db
    )
    drawn = _draw(found, figures_of(run)) if figures else []
    outcome = report(found, output)
    output.say("\n".join([*(["figures:", *drawn] if drawn else []), f"predictions: {outcome}"]))
    output.json({"outcome": outcome, "predictions": found, "figures": drawn})
    if outcome != "held":
        raise typer.Exit(1)


def _two_runs(first: Sequence[FRF], second: Sequence[FRF], tolerance_db: float, output: Output) -> None:
    """FRFs of two runs: a table of each pair, the worst outcome, exit code 1 where it is not that all agree."""
    from loopshape.verbs.chain import compare as compare_all

    found = compare_all(first, second, tolerance_db=tolerance_db)
    columns = ["loop", "first", "second", "outcome", "p-value", "lines", "worst band [Hz]", "P off [dB]"]
    rows = [
        [c.loop, c.predicted_from, c.measured_from, c.outcome, f"{c.p_value:.2g}", c.lines, *_off(c), c.noticed_db]
        for c in found
    ]
    output.table("FRFs of two runs", [*columns, "would notice [dB]"], rows)
    output.warn(f"{c.measured_from}: {note}" for c in found for note in c.notes)
    outcome = _worst(found)
    output.say(f"FRFs: {outcome}")
    output.json({"outcome": outcome, "comparisons": found})
    if outcome != "held":
        raise typer.Exit(1)


def _off(c: Comparison) -> list[str]:
    worst = c.worst
    return (
        ["-", "-"] if worst is None else [f"{worst.low_hz:.3g} .. {worst.high_hz:.3g}", f"{worst.sensitivity_db:+.2f}"]
    )


def _worst(found: Sequence[Comparison]) -> str:
    outcomes = {c.outcome for c in found}
    return next((word for word in ("did not hold", "cannot tell", "held") if word in outcomes), "cannot tell")


def report(found: Sequence[Remeasured], output: Output) -> str:
    """Tables of sensitivities, steps and profiles; gives the outcome of all: the worst of them."""
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
    return _worst(comparisons)


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
    from loopshape.data.result.prediction import INDICATORS

    cells = []
    for name in INDICATORS:
        text = indicator_text(s.measured, name)
        if s.predicted is not None:
            text += f" ({indicator_text(s.predicted.indicators, name).split(' ')[0]})"
        cells.append(text)
    return [
        s.recording, point(s.operating_point), s.at_s, s.size, *cells, 100.0 * s.largest_miss, 100.0 * s.outside,
    ]  # fmt: skip


def _tracked(t: Any) -> list[float]:
    return [t.largest_error, t.predicted_largest_error, t.rms_error, t.predicted_rms_error]


def _draw(found: Sequence[Remeasured], folder: Path) -> list[str]:
    from loopshape.cli.pictures import save
    from loopshape.view.verdict.prediction import comparison_grid, steps_grid

    drawn = []
    for loop in dict.fromkeys(one.prediction.loop for one in found):
        mine = [one for one in found if one.prediction.loop == loop]
        seen = [(one.prediction, frf, c) for one in mine for frf, c in zip(one.measured, one.comparisons, strict=True)]
        if seen:
            figure = comparison_grid([p for p, _, _ in seen], [m for _, m, _ in seen], [c for _, _, c in seen])
            drawn.append(str(save(figure, folder / f"compare_{loop}.png")))
        if steps := [s for one in mine for s in one.steps]:
            drawn.append(str(save(steps_grid(steps), folder / f"steps_{loop}.png")))
    return drawn
