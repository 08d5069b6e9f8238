"""`loopshape next-trial`: the feedforward that a repeated move's next trial is given, learned from the last one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder


def next_trial(
    run: RunFolder,
    filters: Annotated[
        Path, typer.Argument(help="Filters that `loopshape learning` wrote (JSON).", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="The file of the feedforward to write (CSV).")],
    recording: Annotated[
        list[str] | None, typer.Option(help="Of these recordings alone, which repeat one move; again for more.")
    ] = None,
    loop: Annotated[str | None, typer.Option(help="The loop that learns; default: the filters'.")] = None,
    period_s: Annotated[float | None, typer.Option(help="The move repeats this often within each recording.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Learn a move's next feedforward from its last trial. Gives the error to expect too.

    A study plays the file by `feedforward = { LOOP = "next.csv" }` beside its references. Repetitions are averaged:
    what they do not share cannot be learned, and is told apart.
    """
    from loopshape.io.run.run_folder import read_run
    from loopshape.toolbox.learning.files import read_learning, write_feedforward
    from loopshape.toolbox.learning.next_trial import next_trial as learn

    output = Output(as_json, quiet)
    made = learn(read_learning(filters), read_run(run), loop=loop, recordings=recording or (), period_s=period_s)
    write_feedforward(out, made)
    columns = ["loop", "repetitions", "error rms", "of it repeated", "not repeated", "expected next"]
    row = [made.loop, made.repetitions, made.error_rms, made.repeated_rms, made.scatter_rms, made.expected_rms]
    output.table("Trial", columns, [row])
    output.say(f"feedforward written to {out}")
    output.json({"feedforward": str(out), **made.to_dict()})
