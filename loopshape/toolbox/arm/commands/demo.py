"""`loopshape demo`: the main job, from nothing to two checked controllers and a named gap."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet
from loopshape.verbs.pictures import figures_of


def demo(
    out: Annotated[Path, typer.Option(help="Folder for runs, controllers and figures.")] = Path("demo"),
    examples: Annotated[
        Path | None, typer.Option(help="Other examples than the package's own.", show_default=False)
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Run the main job on a simulated arm and a real bench.

    Identify, fit, tune and check the arm at 24 equilibria and the motor bench; diagnose a gap.
    """
    from loopshape.core.errors import UnreadableInputError
    from loopshape.io.files import examples_folder

    examples = examples or examples_folder()
    if not (examples / "arm").is_dir():
        raise UnreadableInputError(
            "the examples are not in this folder", str(examples), "leave --examples out to use the package's own"
        )
    output = Output(as_json, quiet)
    started = time.monotonic()
    output.say("\n== The simulated arm: 24 equilibria, angle loop and pressure loop ==\n")
    arm_passed, arm_figures = _arm(examples / "arm", out / "arm", output)
    output.say("\n== A real machine: the motor side of a two-inertia bench (University of Tokyo, MIT) ==\n")
    bench_passed, bench_figures = _bench(examples / "motor_bench", out / "motor_bench", output)
    output.say("\n== Why a simulation lies: an arm that holds what the nominal model leaves out ==\n")
    named, gap_figures = _gap(examples / "arm", out / "gap", output)
    passed = arm_passed and bench_passed and named
    word = "pass" if passed else "not passed, see above"
    output.say(f"\n== Verdict: {word} ({time.monotonic() - started:.0f} s) ==\n")
    output.say("\n".join(["figures:", *(f"  {path}" for path in (*arm_figures, *bench_figures, *gap_figures))]))
    output.json({"passed": passed, "figures": [*arm_figures, *bench_figures, *gap_figures]})
    if not passed:
        raise typer.Exit(1)


def _arm(examples: Path, run: Path, output: Output) -> tuple[bool, list[str]]:
    from loopshape.cli.estimate.fit import fit_run
    from loopshape.cli.estimate.frf import estimate_and_report
    from loopshape.toolbox.arm.commands.equilibria import draw_equilibria
    from loopshape.toolbox.rig.commands.measure import record
    from loopshape.toolbox.rig.verbs.machine import ended_early

    tables = Output(quiet=output.as_json or output.quiet)
    made = record(examples / "identify.toml", run, output)
    estimate_and_report(run, tables, figures=False, ended_early=ended_early(made), made=made)
    tables.say("")
    fit_run(run, tables, structure="third_order", loop="theta2")
    fit_run(run, tables, structure="integrator", loop="p_ab")
    passed, figures = _tune_and_check(run, examples / "requirements.toml", tables)
    drawn = draw_equilibria(figures_of(run))
    return passed, [*drawn, *_pages(run, {"angle-08", "pressure-08"}), *figures]


def _bench(examples: Path, run: Path, output: Output) -> tuple[bool, list[str]]:
    from loopshape.cli.estimate.fit import fit_run
    from loopshape.cli.estimate.frf import estimate_and_report
    from loopshape.toolbox.formats.commands.import_file import import_run

    tables = Output(quiet=output.as_json or output.quiet)
    import_run(examples / "multisine_type_a.parquet", examples / "map.toml", run, tables)
    estimate_and_report(run, tables, figures=False)
    tables.say("")
    fit_run(run, tables, structure="rational", numerator=2, denominator=4, delay=True, weighting="relative")
    passed, figures = _tune_and_check(run, examples / "requirements.toml", tables)
    return passed, [*_pages(run, {"type-a"}), *figures]


def _gap(examples: Path, run: Path, output: Output) -> tuple[bool, list[str]]:
    """Record an arm with an effect, diagnose it without being told, and compare."""
    from loopshape.toolbox.gap.commands.gap import GapFiles, diagnose_run
    from loopshape.toolbox.rig.commands.measure import record
    from loopshape.toolbox.rig.files.study import read_study

    study = examples / "gap.toml"
    figure = figures_of(run) / "gap.png"
    tables = Output(quiet=output.as_json or output.quiet)
    record(study, run, output)
    found = diagnose_run(run, tables, GapFiles(run / "gap.json", figure), quick=True)
    return found.verdict == "+".join(sorted(read_study(study).effects)), [str(figure)]


def _tune_and_check(run: Path, require: Path, output: Output) -> tuple[bool, list[str]]:
    from loopshape.cli.design.tune import tune_run
    from loopshape.cli.verify.check import check_run

    controller = run / "controller.toml"
    output.say("")
    if not tune_run(run, require, controller, output):
        controller = require.with_name("controller.toml")
        output.say(f"checked instead: the shipped controller, {controller}")
    output.say("")
    return check_run(run, controller, require, output)


def _pages(run: Path, recordings: set[str]) -> list[str]:
    """Overview and maps of each loop, and the pages of a few recordings."""
    from loopshape.io.write.fits import fits_of
    from loopshape.io.write.frfs import read_frfs
    from loopshape.verbs.pictures import draw_frfs

    return draw_frfs(figures_of(run), read_frfs(run), fits_of(run), pages=recordings)
