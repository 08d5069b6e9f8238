"""`loopshape shape`: the page on which one shapes a loop by hand."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder

if TYPE_CHECKING:
    from loopshape.verbs.shaping import ShapedLoops
    from loopshape.view.page.payload import ShapingSession


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
        Path | None, typer.Option(help="A recording of the loop without excitation: rms of its error.")
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
        from loopshape.verbs.shaping import matrix_run, shape_run, write_page

        asked = (run, require, controller, disturbance)
        several, loops = matrix_run(*asked) if matrix else (None, shape_run(*asked))
    if serve:
        _serve(loops, run.resolve().name, save or run / "controller.toml", several)
        return
    size = write_page(path, loops, run.resolve().name)
    for one in loops:
        output.say(f"loop {one.controller.loop}: {len(one.frfs)} FRFs, starts {one.verdict.outcome.value}")
    output.say(f"page: {path} ({size / 1e6:.1f} MB)")
    output.json({"page": str(path), "bytes": size, "loops": [one.controller.loop for one in loops]})


def _serve(loops: list[ShapingSession], title: str, save: Path, several: ShapedLoops | None) -> None:
    """The page until Ctrl+C."""
    from loopshape.verbs.shape_server import ShapeServer

    server = ShapeServer(loops, title, save, several)
    print(f"open {server.url} in a browser; Ctrl+C ends it", flush=True)
    server.serve_until_interrupted()
