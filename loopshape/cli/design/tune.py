"""`loopshape tune`: one controller for all operating points of a run."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, DiagramFile, Output, ProfileName, Quiet, RunFolder
from loopshape.cli.verify.check import report_verdicts

if TYPE_CHECKING:
    from loopshape.design.relax import Shortfall
    from loopshape.design.stage import Grown
    from loopshape.design.tune import Tuning
    from loopshape.design.turns import TunedLoops, Turn

RequireFile = Annotated[Path, typer.Option("--require", help="Requirements (TOML), keys in docs/requirements.md.")]


def tune(
    run: RunFolder,
    require: RequireFile,
    out: Annotated[Path, typer.Option(help="The controller file to write.")],
    start: Annotated[Path | None, typer.Option(help="Controllers (TOML) to start from.")] = None,
    profile: ProfileName = None,
    matrix: Annotated[
        bool, typer.Option("--matrix", help="Loop by loop with the others closed, on the run's matrices.")
    ] = False,
    diagram: DiagramFile = None,
    disturbance: Annotated[
        Path | None, typer.Option(help="A recording of the loop without excitation, for error_rms.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random starts.")] = 0,
    starts: Annotated[
        int, typer.Option(min=1, help="Number of random restarts; 1 with --start: that start alone.")
    ] = 16,
    grow: Annotated[int, typer.Option(min=0, help="Add up to this many blocks, each the one of the largest gain.")] = 0,
    least_gain: Annotated[
        float, typer.Option(min=0.0, help="Minimum relative gain in bandwidth per added block.")
    ] = 0.01,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Tune a controller for all FRFs of a run at once. Its structures are those of the requirements file.

    Where requirements cannot be met it names those in conflict, and what to relax by how much. Exit code 1 then,
    and nothing is written. With --grow blocks are added to the structures as long as they pay.
    """
    feasible = tune_run(
        run, require, out, Output(as_json, quiet), start=start, profile=profile, matrix=matrix, diagram=diagram,
        disturbance=disturbance, seed=seed, starts=starts, grow=grow, least_gain=least_gain,
    )  # fmt: skip
    if not feasible:
        raise typer.Exit(1)


def tune_run(run: Path, require: Path, out: Path, output: Output, **options: Any) -> bool:
    """Tune the loops of a requirements file, report, and write the controllers if all requirements are met."""
    from loopshape.verbs import runs
    from loopshape.verbs.files import write

    found = runs.tune(run, require, watch=output, each=lambda tuning: report_tuning(tuning, output), **options)
    if found.turns is not None:
        _report_turns(found.turns, output)
    for sentence in () if found.profile is None else found.profile.sentences():
        output.paragraph(sentence)
    if found.missed:
        output.warn([f"{found.missed}; nothing was written"])
    else:
        write(found.tunings, out)
        output.say(f"{'controller' if found.turns is None else 'controllers'} written to {out}")
    more = {} if found.turns is None else found.turns.to_dict()
    output.json({"controller": None if found.missed else out, "loops": found.tunings, **more})
    return not found.missed


def _report_turns(turns: TunedLoops, output: Output) -> None:
    """The loops of a plant in turn, each with the others closed."""
    columns = ["round", "loop", "others closed", "lowest bandwidth [Hz]", "its own verdict", "C changed by [%]"]
    output.table("Loops in turn", columns, [_row(turn) for turn in turns.turns])
    if not turns.converged:
        output.warn(["the loops interact: controllers still changed in the last round"])
    for tuning in turns.tunings.values():
        report_tuning(tuning, output)
    report_verdicts(turns.verdict.parts, output, margins=False)
    output.warn(turns.notes)


def _row(turn: Turn) -> list[Any]:
    moved = None if turn.moved != turn.moved else 100.0 * turn.moved
    others = ", ".join(turn.others) or "none"
    return [turn.round, turn.loop, others, turn.tuning.bandwidth_hz, turn.tuning.outcome, moved]


def report_tuning(tuning: Tuning, output: Output) -> None:
    """Blocks, active constraints, conflicting requirements, and the verdict."""
    rows = [
        [block.kind, ", ".join(f"{name} {value:.4g}" for name, value in block.parameters.items())]
        for block in tuning.controller.blocks
    ]
    rejection = (
        "" if tuning.rejection_db is None else f", low-frequency disturbances down by {tuning.rejection_db:.3g} dB"
    )
    lowest = f"lowest bandwidth {tuning.bandwidth_hz:.3g} Hz{rejection}{_norm(tuning)}"
    title = f"Loop {tuning.controller.loop}: {lowest} over {(n := len(tuning.verdict.margins))} FRF{'s' * (n != 1)}"
    output.table(title, ["block", "parameters"], rows)
    if tuning.growth:
        report_growth(tuning.growth, output)
    binding = [[b.quantity, b.recording, b.at_hz] for b in tuning.binding]
    output.table("Active constraints", ["requirement", "recording", "at [Hz]"], binding)
    if any(b.quantity == "dip" for b in tuning.binding):
        output.say("dip: |L| comes down to 1 there below the bandwidth, which would jump there")
    if any(b.quantity == "stability" for b in tuning.binding):
        output.say("stability: what the count of encirclements needs there to be sure; better data there would free it")
    for line in tuning.moved:
        output.say(f"start: {line}")
    if not tuning.converged:
        output.warn([f"the search of loop {tuning.controller.loop} ran out of steps: a little more may be had"])
    for line in tuning.bounds_reached:
        output.say(f"at a bound: {line}")
    if tuning.shortfall is not None and tuning.shortfall.stable:
        _report_shortfall(tuning.shortfall, output)
    elif tuning.shortfall is not None:
        ways = "more of them (--starts)" if tuning.starts > 1 else "others beside it (--starts 16)"
        output.say(f"no stable controller was found from {tuning.starts} start{'s' * (tuning.starts > 1)}: try {ways}")
    report_verdicts([tuning.verdict], output, margins=False)


def _norm(tuning: Tuning) -> str:
    """The norm of the weighted loop with its interval, nothing without weights."""
    if tuning.weighted_norm is None:
        return ""
    ends = tuning.weighted_norm_interval
    return f", weighted norm {tuning.weighted_norm:.4g}" + (f" (95 %: {ends[0]:.4g} to {ends[1]:.4g})" if ends else "")


def report_growth(steps: Sequence[Grown], output: Output) -> None:
    """What each block that was added brought."""
    rows = [
        [g.added or "-", g.bandwidth_hz, g.control_peak_db, _known(g.detuning_percent), g.order, g.outcome]
        for g in steps
    ]
    columns = ["added", "lowest bandwidth [Hz]", "peak |CS| [dB]", "detuning margin [%]", "order", "outcome"]
    output.table("Growth", columns, rows)


def _report_shortfall(found: Shortfall, output: Output) -> None:
    """What the least miss is held by, how sure that is, and what to relax."""
    rows = [[p.quantity, p.recording, p.at_hz, p.slack, p.unit, p.share] for p in found.pulls]
    columns = ["requirement", "recording", "at [Hz]", "slack at best", "unit", "share"]
    output.table("The requirements were not met together; the smallest worst violation is limited by", columns, rows)
    output.say(
        f"changing free parameters by up to 1 % takes at most {found.helps:.2g} off a worst miss of {found.miss:.2g}"
        f" (ln or rad){': no small change helps' if found.certified else ''}"
    )
    for line in found.bounds:
        output.say(f"at a bound there: {line}")
    possible = [r for r in found.relaxations if isfinite(r.reachable)]
    rows = [[r.quantity, r.required, r.reachable, r.by, r.unit, _known(r.bandwidth_hz), r.verified] for r in possible]
    columns = ["requirement", "required", "best reachable", "relax by", "unit", "lowest bandwidth then [Hz]", "checked"]
    output.table("One requirement relaxed, all others kept", columns, rows)
    for r in found.relaxations:
        if r not in possible:
            output.say(f"{r.quantity}: no value of it alone was found that makes the others possible")
    least = found.least
    if least is not None:
        output.say(f"relax {least.quantity} to {least.reachable:.4g} {least.unit}: the least of these")
    else:
        output.say("none was found to do by itself; what is found below can be had together")


def _known(value: float) -> float | str:
    return value if isfinite(value) else "-"
