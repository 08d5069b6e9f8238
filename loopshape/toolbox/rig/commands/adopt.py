"""`loopshape adopt`: from an old controller to a new one on a running target, or from logs whether that may be done."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder

if TYPE_CHECKING:
    from loopshape.toolbox.rig.adopt.advice import Advised
    from loopshape.toolbox.rig.adopt.course import Adoption


def adopt(
    run: RunFolder,
    controller: Annotated[Path, typer.Argument(help="A controller file with the new one.", show_default=False)],
    study: Annotated[
        Path | None, typer.Option(help="The study (TOML) of the target: its limits, loops and a multisine.")
    ] = None,
    port: Annotated[str | None, typer.Option(help="Where the target is; without it logs alone are asked.")] = None,
    out: Annotated[Path | None, typer.Option(help="The folder to write: a run a share, and a journal.")] = None,
    require: Annotated[
        Path | None, typer.Option("--require", help="Requirements (TOML); default: stable, |S| at most 6 dB.")
    ] = None,
    after: Annotated[Path | None, typer.Option(help="A run under the new controller, where logs alone decide.")] = None,
    controllers: Annotated[
        Path | None, typer.Option("--controllers", help="The old controllers, in place of the study's.")
    ] = None,
    arm: Annotated[bool, typer.Option("--arm", help="Allow the target to move; run with --show first.")] = False,
    show: Annotated[bool, typer.Option("--show", help="Show what a target would do, and stop.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Let a new controller take over share by share, or go back.

    Without a port logs alone are asked: go, no go, or not decidable with what to record.

    Exit code 0 where it is adopted (or go), 1 where not, 2 wrong use.
    """
    from loopshape.core.errors import WrongUseError
    from loopshape.io.requirements import read_requirements
    from loopshape.io.write.controllers import read_controllers
    from loopshape.toolbox.rig.commands.measure import confirmed
    from loopshape.toolbox.rig.verbs import adopt as verbs

    output = Output(as_json, quiet)
    required = () if require is None else read_requirements(require)
    if port is None and study is None:
        _advise(verbs.advise(run, controller, after=after, requirements=required), output)
        return
    if study is None or out is None:
        raise WrongUseError(
            "a trial on a target has a study and a folder to write", f"--study {study}, --out {out}",
            "give both, or neither a port nor a study to ask logs alone",
        )  # fmt: skip
    found = verbs.adopt(
        run, controller, study, out, port=port, requirements=required,
        controllers=() if controllers is None else read_controllers(controllers),
        confirm=lambda motion: confirmed(motion, arm, show, output), watch=output,
    )  # fmt: skip
    _report(found, output)


def _report(found: Adoption, output: Output) -> None:
    rows = []
    for one in found.steps:
        predicted = "-" if one.expected is None else "{:.3g} to {:.3g}".format(*one.expected.error_rms)
        rms = "-" if one.error_rms is None else f"{one.error_rms:.3g}"
        agreement = "-" if one.comparison is None else one.comparison.outcome
        rows.append((f"{100.0 * one.share:g} %", agreement, rms, predicted, one.outcome or "on"))
    output.table("Shares of the new controller:", ("share", "S", "error rms", "predicted", "then"), rows)
    output.say(f"{found.outcome}: {found.reason}")
    output.json(found.to_dict())
    if found.outcome != "adopted":
        raise typer.Exit(1)


def _advise(found: Advised, output: Output) -> None:
    output.say(f"{found.advice}: {found.reason}")
    for line in found.recipe:
        output.paragraph(f"to decide it: {line}")
    output.json(found.to_dict())
    if found.advice != "go":
        raise typer.Exit(1)
