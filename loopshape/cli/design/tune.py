"""`loopshape tune`: one controller for all operating points of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, DiagramFile, Output, ProfileName, Quiet, RunFolder
from loopshape.cli.verify.verdicts import fits_of, report_verdicts

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.requirement.requirements import Requirements, SeveralRequirements
    from loopshape.design.growth import Grown
    from loopshape.design.relax import Shortfall
    from loopshape.design.several import Turn
    from loopshape.design.tune import Tuning

RequireFile = Annotated[Path, typer.Option("--require", help="Requirements (TOML).")]


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
    grow: Annotated[int, typer.Option(min=0, help="Add up to so many blocks, each the one that pays most.")] = 0,
    least_gain: Annotated[
        float, typer.Option(min=0.0, help="Minimum relative gain in bandwidth per added block.")
    ] = 0.01,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Tune a controller for all FRFs of a run at once. Its structures are those of the requirements file.

    Where requirements cannot be met it says what holds them apart, and what to relax by how much. Exit code 1 then,
    and nothing is written. With --grow blocks are added to the structures as long as they pay.
    """
    output = Output(as_json, quiet)
    if matrix:
        refuse_growth(grow)
    feasible = tune_run(
        run, require, out, output, start=start, profile=profile, matrix=matrix, diagram=diagram,
        disturbance=disturbance, seed=seed, starts=starts,
        **({} if matrix else {"grow": grow, "least_gain": least_gain}),
    )  # fmt: skip
    if not feasible:
        raise typer.Exit(1)


def tune_run(
    run: Path,
    require: Path,
    out: Path,
    output: Output,
    *,
    start: Path | None = None,
    profile: str | None = None,
    matrix: bool = False,
    diagram: Path | None = None,
    disturbance: Path | None = None,
    **search: Any,
) -> bool:
    """Tune the loops of a requirements file, report, and write the controllers if all requirements are met.

    Each by itself, or with `matrix` in turn with the others closed; a profile then limits each with the others closed.
    """
    from loopshape.core.errors import WrongUseError
    from loopshape.io.profiles import joined
    from loopshape.io.write.controllers import write_controllers
    from loopshape.io.write.requirements import read_required, read_requirements

    given, together = read_required(require) if matrix else (read_requirements(require), None)
    requirements, chosen = joined(profile, given)
    began = controllers_to_start(start, [one.loop for one in requirements])
    if matrix and diagram is not None:
        raise WrongUseError("a diagram is tuned at one block", "several loops at once", "leave --matrix out")
    if matrix and disturbance is not None:
        raise WrongUseError("the rms of an error is kept by one loop", "several loops at once", "leave --matrix out")
    if matrix:
        found, missed, more = _in_turn(run, requirements, began, together, output, **search)
    else:
        found, missed, more = _each(run, requirements, began, output, diagram, disturbance, **search)
    for sentence in () if chosen is None else chosen.sentences():
        output.paragraph(sentence)
    if missed:
        output.warn([f"{missed}; nothing was written"])
    else:
        write_controllers(out, [t.controller for t in found], None)
        output.say(f"{'controllers' if matrix else 'controller'} written to {out}")
    output.json({"controller": None if missed else out, "loops": found, **more})
    return not missed


_Found = tuple[list["Tuning"], str, dict[str, Any]]  # tunings, why they are not enough, and what JSON has besides


def _each(
    run: Path, requirements: Sequence[Requirements], began: Mapping[str, Controller], output: Output,
    diagram: Path | None, disturbance: Path | None, **search: Any,
) -> _Found:  # fmt: skip
    """Each loop by itself, or the tuned block of a diagram."""
    from loopshape.io.write.check_files import read_diagram
    from loopshape.io.write.frfs import read_frfs
    from loopshape.verbs.chain import disturbances_of
    from loopshape.verbs.chain import tune as tune_loop

    frfs, fits = read_frfs(run), fits_of(run)
    if diagram is not None:
        met = read_diagram(diagram, run).equivalent()
        frfs, fits, requirements = met.plants, (), tuple(map(met.asked, requirements))
    found = []
    for required in requirements:
        mine = [one for one in frfs if one.loop == required.loop]
        known = disturbances_of(disturbance, required.loop) or None
        found.append(tune_loop(mine, required, fits=fits, start=began.get(required.loop), disturbance=known, **search))
        report_tuning(found[-1], output, len(mine))
    missed = not all(t.feasible for t in found)
    return found, f"no controller was found that meets all requirements: {_reason(found)}" if missed else "", {}


def _in_turn(
    run: Path,
    requirements: Sequence[Requirements],
    began: Mapping[str, Controller],
    together: SeveralRequirements | None,
    output: Output,
    **search: Any,
) -> _Found:
    """The loops of a plant in turn, each with the others closed."""
    from loopshape.io.write.check_files import recorded_under
    from loopshape.io.write.frfs import read_several_loops
    from loopshape.verbs.chain import tune as tune_loops

    frfs = read_several_loops(run)
    found = tune_loops(
        frfs, requirements, start=list(began.values()), together=together, recorded_under=recorded_under(run),
        watch=output, **search,
    )  # fmt: skip
    columns = ["round", "loop", "others closed", "lowest bandwidth [Hz]", "its own verdict", "C changed by [%]"]
    output.table("Loops in turn", columns, [_row(turn) for turn in found.turns])
    if not found.converged:
        output.warn(["the loops interact: controllers still changed in the last round"])
    for tuning in found.tunings.values():
        report_tuning(tuning, output, len(frfs))
    report_verdicts(found.verdict.parts, output, margins=False)
    output.warn(found.notes)
    missed = "" if found.feasible else "the loops do not meet all requirements together"
    return list(found.tunings.values()), missed, found.to_dict()


def _row(turn: Turn) -> list[Any]:
    moved = None if turn.moved != turn.moved else 100.0 * turn.moved
    others = ", ".join(turn.others) or "none"
    return [turn.round, turn.loop, others, turn.tuning.bandwidth_hz, turn.tuning.outcome, moved]


def controllers_to_start(file: Path | None, loops: list[str]) -> dict[str, Controller]:
    """Controllers of a file by loop; refuses a file that has none of the loops to be tuned."""
    if file is None:
        return {}
    from loopshape.core.errors import WrongUseError
    from loopshape.io.write.controllers import read_controllers

    found = {one.loop: one for one in read_controllers(file)}
    if not set(found) & set(loops):
        raise WrongUseError(
            f"{file.name} has no controller to start from",
            f"loops {', '.join(found)}",
            f"give one of {', '.join(loops)}",
        )
    return found


def _reason(found: list[Tuning]) -> str:
    unstable = [t.controller.loop for t in found if "unstable" in {m.stable for m in t.verdict.margins.values()}]
    if unstable:
        return f"no start was found stable in loop {', '.join(unstable)}"
    if all(t.outcome != "failed" for t in found):
        return "the nearest, shown above, holds by the estimates and not by their 95 % intervals"
    return "the nearest is shown above"


def report_tuning(tuning: Tuning, output: Output, points: int) -> None:
    """Blocks, what binds, what keeps requirements apart, and the verdict."""
    rows = [
        [block.kind, ", ".join(f"{name} {value:.4g}" for name, value in block.parameters.items())]
        for block in tuning.controller.blocks
    ]
    rejection = (
        "" if tuning.rejection_db is None else f", low-frequency disturbances down by {tuning.rejection_db:.3g} dB"
    )
    lowest = f"lowest bandwidth {tuning.bandwidth_hz:.3g} Hz{rejection}{_norm(tuning)}"
    title = f"Loop {tuning.controller.loop}: {lowest} over {points} FRFs"
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


def refuse_growth(grow: int) -> None:
    """Refuse growth of several loops at once."""
    from loopshape.core.errors import WrongUseError

    if grow:
        raise WrongUseError(
            "structures grow for one loop at a time", f"--grow {grow} with --matrix", "grow each loop without --matrix"
        )


def _report_shortfall(found: Shortfall, output: Output) -> None:
    """What the least miss is held by, how sure that is, and what to relax."""
    rows = [[p.quantity, p.recording, p.at_hz, p.spare, p.unit, p.share] for p in found.pulls]
    columns = ["requirement", "recording", "at [Hz]", "slack at best", "unit", "share"]
    output.table("The requirements were not met together; the smallest worst violation is limited by", columns, rows)
    output.say(
        f"changing free parameters by up to 1 % takes at most {found.helps:.2g} off a worst miss of {found.miss:.2g}"
        f" (ln or rad){': no small change helps' if found.certified else ''}"
    )
    for line in found.bounds:
        output.say(f"at a bound there: {line}")
    possible = [r for r in found.relaxations if isfinite(r.reachable)]
    rows = [[r.quantity, r.wished, r.reachable, r.by, r.unit, _known(r.bandwidth_hz), r.verified] for r in possible]
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
