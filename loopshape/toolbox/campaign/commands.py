"""`loopshape campaign`: one study on many simulated machines, a run folder each."""

from __future__ import annotations

from pathlib import Path
from time import monotonic
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet
from loopshape.core.interrupts import interrupts


def campaign(
    file: Annotated[Path, typer.Argument(help="A campaign (TOML).", show_default=False)],
    out: Annotated[Path, typer.Option(help="The folder of run folders to write; an interrupted campaign goes on.")],
    workers: Annotated[int, typer.Option(help="Worker processes (0: one per core).")] = 0,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler, in place of processes.")] = None,
    part: Annotated[
        str | None, typer.Option(metavar="K/N", help="Record one of N parts, in a folder of its own.")
    ] = None,
    merge: Annotated[bool, typer.Option("--merge", help="Join the parts, which are then all recorded.")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Monte Carlo over simulated machines.

    A study on draws of the manufacturing tolerance, amplitudes and effects.
    """
    from loopshape.toolbox.campaign.verbs import campaign as recorded

    output, started = Output(as_json, quiet), monotonic()
    try:
        with interrupts():
            made = recorded(
                file, out, workers=workers, cluster=cluster, part=_part(part, merge), merge=merge, watch=output
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt("interrupted; what the runs list is kept, the same command goes on") from None
    wall_s = monotonic() - started
    done = "merged" if merge else "made"
    output.say(f"{made.machines} machines, {made.recordings} recordings {done} in {wall_s:.1f} s, in {made.folder}")
    output.json({"machines": made.machines, "recordings": made.recordings, "wall_s": wall_s})


def _part(text: str | None, merge: bool) -> tuple[int, int] | None:
    """The part that is asked for, K/N."""
    from loopshape.core.errors import WrongUseError

    if text is None:
        return None
    number, _, of = text.partition("/")
    if merge or not (number.isdecimal() and of.isdecimal()):
        raise WrongUseError("a part is K/N, and merged without it", text, "write --part 1/8 to 8/8, then --merge alone")
    return int(number), int(of)
