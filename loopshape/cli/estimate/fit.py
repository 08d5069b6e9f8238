"""`loopshape fit`: low-order models of a run's FRFs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.data.response.model import Estimate, Fit

#: phase in rad at the highest line that a delay must turn to be one
NO_DELAY_RAD = 1e-6
#: times the highest line from which on a real root is not told from one at infinity
FAR = 10.0


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
            help="rational: no pole in the right half plane. Default as declared by --require, else in open loop.",
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
        run,
        Output(as_json, quiet),
        structure=structure,
        loop=loop,
        numerator=numerator,
        denominator=denominator,
        integrators=integrators,
        delay=delay,
        stable=stable,
        require=require,
        weighting=weighting,
        band_hz=band,
    )


def fit_run(
    run: Path,
    output: Output,
    *,
    structure: str,
    loop: str | None = None,
    weighting: str = "variance",
    band_hz: tuple[float, float] | None = None,
    stable: bool | None = None,
    require: Path | None = None,
    **orders: Any,
) -> None:
    """Fit the FRFs of a run (of one loop if named), store the fits beside those of other loops, report them."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.held import held
    from loopshape.io.write.fits import read_fits, write_fits
    from loopshape.io.write.frfs import read_frfs
    from loopshape.io.write.requirements import read_requirements
    from loopshape.verbs.chain import fit as fit_one

    required = {} if require is None else {one.loop: one for one in read_requirements(require)}
    frfs = [one for one in read_frfs(run) if loop in (None, one.loop)]
    if not frfs:
        raise WrongUseError("the run has no FRF of such a loop", repr(loop))
    chosen: dict[str, Any] = {"weighting": weighting, "band_hz": band_hz, "stable": stable, **orders}
    made = []
    with output.progress("fit", len(frfs)) as step:
        for one in frfs:
            made.append(fit_one(one, structure, R=required.get(one.loop), **chosen))
            step(one.recording)
    known = {(f.recording, f.loop) for f in made}
    with held(run):
        stored = read_fits(run) if (run / "fits.json").exists() else ()
        write_fits(run, [*(f for f in stored if (f.recording, f.loop) not in known), *made])
    report_fits(made, output, run)


def report_fits(fits: list[Fit], output: Output, folder: Path) -> None:
    """Table for each structure, and the JSON."""
    for name in dict.fromkeys(f.structure for f in fits):
        mine = [f for f in fits if f.structure == name]
        shown = [p.name for p in mine[0].parameters if p.unit != "SI"]  # bare coefficients are in --json
        parameters = [f"{p.name} [{p.unit}]" for p in mine[0].parameters if p.name in shown]
        columns = [
            "recording",
            "loop",
            "operating point",
            *parameters,
            "misfit [dB]",
            "chi²/dof",
            "adequate?",
            "outcome",
        ]
        rows = [
            [f.recording, f.loop, point(f.operating_point, f.rig_parameters)]
            + [_parameter(f, p) for p in f.parameters if p.name in shown]
            + [f.misfit_db, f.chi2_per_dof, f.sufficient, f.outcome]
            for f in mine
        ]
        output.table(f"Fits of structure {name} (± 95 %)", columns, rows)
        if name.startswith("rational"):
            _report_modes(mine, output)
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
            f"{len(bad)} of {len(fits)} models leave more than the noise (adequate? no): their intervals are widened,"
            " and checks use the FRF itself"
        )
    output.warn(f"{f.recording}: the fit ended as {f.outcome}" for f in fits if f.outcome != "converged")
    output.json({"run": str(folder), "fits": fits})


def _report_modes(fits: list[Fit], output: Output) -> None:
    """Zeros and poles of rational fits: pairs by frequency and damping, real ones by time constant."""
    from loopshape.identify.fit import modes

    rows = []
    for f in fits:
        found = modes(f)
        for frequency, damping in zip(found[::2], found[1::2], strict=True):
            kind = frequency.name.removesuffix("_f_hz")
            rows.append([f.recording, f.loop, kind, *root_cells(frequency, damping, f.band_hz[1])])
    columns = ["recording", "loop", "root", "f [Hz]", "damping", "time constant [s]"]
    output.table("Zeros and poles (± 95 %)", columns, rows)


def _parameter(f: Fit, p: Estimate) -> str:
    """A parameter with its interval; a delay that turns no line's phase is none."""
    from loopshape.core.units import TWO_PI

    if p.name == "delay_s" and abs(p.value) * TWO_PI * f.band_hz[1] < NO_DELAY_RAD:
        return "none"
    return f"{p.value:.5g} ± {1.96 * p.std:.2g}"


def root_cells(frequency: Estimate, damping: Estimate, highest_hz: float) -> list[str | None]:
    """Frequency, damping and time constant of a root as cells; of a real one the time constant alone.

    A real root that the lines up to `highest_hz` do not tell from one at infinity has a bound in place of a value.
    """
    from loopshape.core.units import TWO_PI

    if abs(damping.value) < 1.0 - 1e-9:
        return [*(f"{e.value:.4g} ± {1.96 * e.std:.2g}" for e in (frequency, damping)), None]
    side = "" if damping.value > 0.0 else ", right half plane"
    constant = 1.0 / (TWO_PI * frequency.value)
    if frequency.value > FAR * highest_hz:
        return [None, None, f"below {1.0 / (TWO_PI * highest_hz):.2g}, above the measured frequencies{side}"]
    if not 1.96 * frequency.std < frequency.value:
        return [None, None, f"about {constant:.2g}, not known{side}"]
    return [None, None, f"{constant:.4g} ± {1.96 * constant * frequency.std / frequency.value:.2g}{side}"]
