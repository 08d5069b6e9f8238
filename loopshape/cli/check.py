"""`loopshape check`: hold a controller against its requirements, on the measured FRFs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.cli.tune import RequireFile
from loopshape.cli.verdicts import WORDS, fits_of, report_verdicts, verdict_json


def check(
    run: RunFolder,
    controller: Annotated[Path, typer.Argument(help="A controller file (TOML).", show_default=False)],
    require: RequireFile,
    junit: Annotated[Path | None, typer.Option(help="Write a JUnit XML report too.")] = None,
    figures: Annotated[bool, typer.Option(help="Draw Nichols, loop and sensitivity pictures.")] = True,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Check margins, peaks and stability at every operating point; exit code 1 where one is missed."""
    passed, _ = check_run(run, controller, require, Output(as_json, quiet), junit=junit, figures=figures)
    if not passed:
        raise typer.Exit(1)


def check_run(
    run: Path, controller: Path, require: Path, output: Output, *, junit: Path | None = None, figures: bool = True
) -> tuple[bool, list[str]]:
    """Check each loop of a requirements file, draw and report; gives the verdict and the figures' paths."""
    from loopshape.check.verdict import check as check_loop
    from loopshape.cli.figures import controller_of, draw_loops
    from loopshape.store.controllers import read_controllers
    from loopshape.store.frfs import read_frfs
    from loopshape.store.junit import write_junit
    from loopshape.store.requirements import read_requirements

    controllers, requirements = read_controllers(controller), read_requirements(require)
    frfs, fits = read_frfs(run), fits_of(run)
    pairs = [([one for one in frfs if one.loop == w.loop], controller_of(controllers, w.loop), w) for w in requirements]
    verdicts = [check_loop(mine, own, wished, fits) for mine, own, wished in pairs]
    if junit is not None:
        write_junit(junit, verdicts)
    report_verdicts(verdicts, output)
    outcomes = {v.outcome for v in verdicts}
    outcome = next(word for word in ("failed", "undecided", "passed") if word in outcomes)
    passed = outcome == "passed"
    drawn: list[str] = []
    for (mine, own, wished), verdict in zip(pairs, verdicts, strict=True):
        drawn += draw_loops(run / "figures", mine, own, wished, fits, verdict) if figures else []
    output.say("\n".join(["figures:", *drawn]) if drawn else "no figures drawn")
    output.say(f"verdict: {WORDS[outcome]}")
    output.json({"passed": passed, "outcome": outcome, "loops": [verdict_json(v) for v in verdicts], "figures": drawn})
    return passed, drawn
