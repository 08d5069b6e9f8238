"""`loopshape report`: one page of HTML that holds all of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, DiagramFile, Output, Quiet, RunFolder


def report(
    run: RunFolder,
    controller: Annotated[
        Path | None, typer.Option(help="A controller file (TOML): draws and checks its loops.")
    ] = None,
    require: Annotated[Path | None, typer.Option(help="Requirements (TOML) that it is compared with.")] = None,
    diagram: DiagramFile = None,
    out: Annotated[Path | None, typer.Option(help="The page to write; default: report.html in the run.")] = None,
    date: Annotated[str | None, typer.Option(help="Date on the report; default: now.")] = None,
    figures_mb: Annotated[float, typer.Option(min=0.0, help="Size of pictures beside the main ones.")] = 0.7,
    author: Annotated[str, typer.Option(help="Author on the report.")] = "",
    matrix: Annotated[
        bool, typer.Option("--matrix", help="All loops of the plant's matrix at once, as check does.")
    ] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write a run's report as one HTML file. It opens offline; exit code 0 whatever the verdict."""
    output, path = Output(as_json, quiet), out or run / "report.html"
    with output.progress("report", 1):
        from loopshape.verbs.files import write_report
        from loopshape.view.html.words import WORDS

        made, size = write_report(path, run, (controller, require, diagram), date, figures_mb, author, matrix)
    output.warn(f"left out of the report: {name}: {why}" for name, why in made.figures_left_out.items())
    for one in made.missing:
        output.say(f"missing: {one.what} {one.command}".rstrip())
    output.say(f"verdict: {'no requirement' if made.outcome is None else WORDS[made.outcome]}")
    output.say(f"report: {path} ({size / 1e6:.1f} MB)")
    answer = {"outcome": made.outcome or "none", "missing": made.missing, "figures_left_out": made.figures_left_out}
    output.json({"report": str(path), "bytes": size, **answer})
