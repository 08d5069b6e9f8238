"""`loopshape tune`: one controller for all operating points of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from loopshape.cli.output import AsJson, Output, Quiet, RunFolder
from loopshape.cli.verdicts import fits_of, report_verdicts, verdict_json

RequireFile = Annotated[Path, typer.Option("--require", help="Requirements (TOML).")]


def tune(
    run: RunFolder,
    require: RequireFile,
    out: Annotated[Path, typer.Option(help="The controller file to write.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts.")] = 0,
    starts: Annotated[int, typer.Option(min=1, help="How many of the random starts are followed.")] = 16,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Tune the structures of a requirements file against all FRFs of a run at once."""
    if not tune_run(run, require, out, Output(as_json, quiet), seed=seed, starts=starts):
        raise typer.Exit(1)


def tune_run(run: Path, require: Path, out: Path, output: Output, *, seed: int = 0, starts: int = 16) -> bool:
    """Tune each loop of a requirements file, report, and write the controllers if all requirements are met."""
    from loopshape.store.controllers import write_controllers
    from loopshape.store.frfs import read_frfs
    from loopshape.store.requirements import read_requirements
    from loopshape.tune.tune import tune as tune_loop

    requirements, frfs, fits = read_requirements(require), read_frfs(run), fits_of(run)
    found = []
    for wished in requirements:
        mine = [one for one in frfs if one.loop == wished.loop]
        found.append(tune_loop(mine, wished, fits, seed=seed, starts=starts))
        _report(found[-1], output, len(mine))
    feasible = all(t.feasible for t in found)
    if feasible:
        write_controllers(out, [t.controller for t in found], None)
        output.say(f"controller written to {out}")
    else:
        unstable = [t.controller.loop for t in found if t.verdict.unstable]
        reason = (
            f"no start was found stable in loop {', '.join(unstable)}" if unstable else "the nearest is shown above"
        )
        output.warn([f"no controller was found that meets all requirements: {reason}; nothing was written"])
    output.json({"controller": str(out) if feasible else None, "loops": [_json(t) for t in found]})
    return feasible


def _report(tuning: Any, output: Output, points: int) -> None:
    rows = [
        [block.kind, ", ".join(f"{name} {value:.4g}" for name, value in block.parameters.items())]
        for block in tuning.controller.blocks
    ]
    title = f"Loop {tuning.controller.loop}: lowest bandwidth {tuning.bandwidth_hz:.3g} Hz over {points} FRFs"
    output.table(title, ["block", "parameters"], rows)
    binding = [[b.quantity, b.recording, b.at_hz] for b in tuning.binding]
    output.table("What binds", ["requirement", "recording", "at [Hz]"], binding)
    if not tuning.converged:
        output.warn([f"the search of loop {tuning.controller.loop} ran out of steps: a little more may be had"])
    for line in tuning.bounds_reached:
        output.say(f"at a bound: {line}")
    report_verdicts([tuning.verdict], output, margins=False)


def _json(tuning: Any) -> dict[str, Any]:
    return {
        "loop": tuning.controller.loop,
        "feasible": tuning.feasible,
        "converged": tuning.converged,
        "bandwidth_hz": tuning.bandwidth_hz,
        "blocks": [block.to_table() for block in tuning.controller.blocks],
        "binding": [{"quantity": b.quantity, "recording": b.recording, "at_hz": b.at_hz} for b in tuning.binding],
        "bounds_reached": list(tuning.bounds_reached),
        "verdict": verdict_json(tuning.verdict),
    }
