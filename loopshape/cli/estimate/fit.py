"""`loopshape fit`: low-order models of a run's FRFs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.data.response.model import Fit


def fit(
    run: RunFolder,
    structure: Annotated[
        str, typer.Option(help="third_order, integrator (each with _delay too), rational, or auto.")
    ] = "auto",
    loop: Annotated[str | None, typer.Option(help="Only this loop; fits of other loops are kept.")] = None,
    numerator: Annotated[int, typer.Option(help="rational: order of the numerator.")] = 0,
    denominator: Annotated[int, typer.Option(help="rational: order of the denominator.")] = 1,
    integrators: Annotated[int, typer.Option(help="rational: poles at zero.")] = 0,
    delay: Annotated[bool, typer.Option("--delay", help="Fit a delay too.")] = False,
    stable: Annotated[
        bool | None,
        typer.Option(
            "--stable/--any-poles",
            help="rational: no pole in the right half plane; default by --require.",
        ),
    ] = None,
    require: Annotated[
        Path | None, typer.Option("--require", help="Requirements (TOML): their unstable_poles decide where known.")
    ] = None,
    weighting: Annotated[str, typer.Option(help="variance, or relative.")] = "variance",
    low_hz: Annotated[float | None, typer.Option(help="Lowest frequency; default: the valid band.")] = None,
    high_hz: Annotated[float | None, typer.Option(help="Highest frequency; default: the valid band.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Fit low-order models, with confidence intervals. A residual test says whether a model is adequate."""
    band = None if low_hz is None and high_hz is None else (low_hz or 0.0, high_hz or float("inf"))
    fit_run(
        run, Output(as_json, quiet), structure=structure, loop=loop, require=require, numerator=numerator,
        denominator=denominator, integrators=integrators, delay=delay, stable=stable, weighting=weighting, band_hz=band,
    )  # fmt: skip


def fit_run(run: Path, output: Output, **options: Any) -> None:
    """Fit the FRFs of a run (of one loop if named), store the fits beside those of other loops, report them."""
    from loopshape.verbs import runs

    made = runs.fit(run, watch=output, **options)
    runs.store_fits(run, made)
    report_fits(made, output, run)


def report_fits(fits: list[Fit], output: Output, folder: Path) -> None:
    """Table for each structure, and the JSON."""
    from loopshape.view.labels import parameter_text, root_rows

    for name in dict.fromkeys(f.structure for f in fits):
        mine = [f for f in fits if f.structure == name]
        shown = [p.name for p in mine[0].parameters if p.unit != "SI"]  # bare coefficients are in --json
        parameters = [f"{p.name} [{p.unit}]" for p in mine[0].parameters if p.name in shown]
        columns = ["recording", "loop", "operating point", *parameters, "misfit [dB]", "chi²/dof", "adequate?"]
        rows = [
            [f.recording, f.loop, point(f.operating_point, f.rig_parameters)]
            + [parameter_text(f, p) for p in f.parameters if p.name in shown]
            + [f.misfit_db, f.chi2_per_dof, f.sufficient, f.outcome]
            for f in mine
        ]
        output.table(f"Fits of structure {name} (± 95 %)", [*columns, "outcome"], rows)
        if name.startswith("rational"):
            columns = ["recording", "loop", "root", "f [Hz]", "damping", "time constant [s]"]
            output.table("Zeros and poles (± 95 %)", columns, [row for f in mine for row in root_rows(f)])
    output.warn(
        f"{f.recording}: the fitted model has {f.model.unstable_poles()} unstable poles"
        for f in fits
        if f.model.unstable_poles()
    )
    output.warn(
        f"{f.recording}: {f.starts - f.starts_agreeing} of {f.starts} starts of the fit ended at worse optima: a better"
        " one may exist; narrow the band, or try other orders"
        for f in fits
        if f.disputed
    )
    output.warn(
        f"{f.recording}: the model misses the FRF by {f.misfit_db:.1f} dB rms: try --weighting relative, other orders"
        for f in fits
        if f.misfit_db > 3.0
    )
    bad = [f for f in fits if not f.sufficient]
    if bad:
        output.say(
            f"not adequate: {len(bad)} of {len(fits)}, leaving more than the noise; intervals are widened, and checks"
            " use the FRF itself"
        )
    output.warn(f"{f.recording}: the fit ended as {f.outcome}" for f in fits if not f.converged)
    output.json({"run": str(folder), "fits": fits})
