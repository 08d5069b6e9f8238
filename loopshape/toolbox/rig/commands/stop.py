"""`loopshape stop`: the emergency stop of a target, from another terminal."""

from __future__ import annotations

from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet


def stop(
    what: Annotated[str, typer.Argument(help="A run folder that is being measured, or a port.", show_default=False)],
    clear: Annotated[bool, typer.Option("--clear", help="Clear a fault: the target goes to idle, vented.")] = False,
    baud: Annotated[int, typer.Option(help="Speed of a serial port.")] = 921_600,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Stop and vent a target at once. Through the process that measures into a run folder, or through a port."""
    from loopshape.toolbox.rig.verbs.stop import stop as stop_target

    output = Output(as_json, quiet)
    how = stop_target(what, clear=clear, baud=baud)
    output.say(how)
    output.json({"done": how})
