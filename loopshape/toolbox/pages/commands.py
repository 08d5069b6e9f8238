"""The page on which one shapes a loop by hand (`loopshape shape`), and the one that holds all of a run (`report`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, DiagramFile, Output, Quiet, RunFolder

if TYPE_CHECKING:
    from loopshape.toolbox.pages.shape.payload import ShapingSession
    from loopshape.toolbox.pages.shape.shaping import ShapedLoops


def shape(
    run: RunFolder,
    require: Annotated[Path | None, typer.Option(help="Requirements (TOML) to shape for.")] = None,
    controller: Annotated[
        Path | None, typer.Option(help="A controller file (TOML) to start from; default: a gain of 1.")
    ] = None,
    matrix: Annotated[
        bool, typer.Option("--matrix", help="One loop at a time with the others closed, on the run's matrices.")
    ] = False,
    disturbance: Annotated[
        Path | None, typer.Option(help="A recording without excitation: judges rms, peak and rate.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The page to write; default: shape.html in the run.")] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Serve the page on this machine alone, with check, tune and save.")
    ] = False,
    save: Annotated[
        Path | None, typer.Option(help="With --serve: where Save writes; default: controller.toml.")
    ] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write a page on which loops are shaped by hand. Margins and intervals on it are those of check.

    One HTML file that works offline: drag blocks, type numbers, see every operating point. It gives controller.toml
    back, which check signs.
    """
    output, path = Output(as_json, quiet), out or run / "shape.html"
    with output.progress("shape", 1):
        from loopshape.toolbox.pages.shape.shaping import matrix_run, shape_run, write_page

        asked = (run, require, controller, disturbance)
        several, loops = matrix_run(*asked) if matrix else (None, shape_run(*asked))
    if serve:
        _serve(loops, run.resolve().name, save or run / "controller.toml", several)
        return
    size = write_page(path, loops, run.resolve().name)
    for one in loops:
        many = f"{(n := len(one.frfs))} FRF{'s' * (n != 1)}"
        output.say(f"loop {one.controller.loop}: {many}, verdict at the start: {one.verdict.outcome.value}")
    output.say(f"page: {path} ({size / 1e6:.1f} MB)")
    output.json({"page": str(path), "bytes": size, "loops": [one.controller.loop for one in loops]})


def _serve(loops: list[ShapingSession], title: str, save: Path, several: ShapedLoops | None) -> None:
    """The page until Ctrl+C."""
    from loopshape.toolbox.pages.shape.shape_server import ShapeServer

    server = ShapeServer(loops, title, save, several)
    print(f"open {server.url} in a browser; Ctrl+C ends it", flush=True)
    server.serve_until_interrupted()


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
        from loopshape.toolbox.pages.report.words import WORDS
        from loopshape.toolbox.pages.verbs import write_report

        made, size = write_report(path, run, (controller, require, diagram), date, figures_mb, author, matrix)
    output.warn(f"left out of the report: {name}: {why}" for name, why in made.figures_left_out.items())
    for one in made.missing:
        output.say(f"note: {one.what} {one.command}".rstrip())
    output.say(f"verdict: {'no requirement' if made.outcome is None else WORDS[made.outcome]}")
    output.say(f"report: {path} ({size / 1e6:.1f} MB)")
    answer = {"outcome": made.outcome or "none", "missing": made.missing, "figures_left_out": made.figures_left_out}
    output.json({"report": str(path), "bytes": size, **answer})
