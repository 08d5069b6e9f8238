"""`loopshape tune --matrix`: loop by loop with the others closed, on a run's matrices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.cli.output import Output
from loopshape.cli.tune import controllers_to_start, report_tuning
from loopshape.cli.verdicts import report_verdicts

if TYPE_CHECKING:
    from loopshape.design.several import SeveralTuning, Turn


def tune_several_run(
    run: Path,
    require: Path,
    out: Path,
    output: Output,
    *,
    start: Path | None = None,
    profile: str | None = None,
    seed: int = 0,
    starts: int = 16,
) -> bool:
    """Tune the loops of a requirements file in turn, report, and write the controllers if all requirements are met.

    A profile limits each loop with the others closed.
    """
    from loopshape.design.several import tune_several
    from loopshape.io.check_files import recorded_under
    from loopshape.io.controllers import write_controllers
    from loopshape.io.frfs import read_several_loops
    from loopshape.io.profiles import joined
    from loopshape.io.requirements import read_required

    given, several = read_required(require)
    wishes, chosen = joined(profile, given)
    began, frfs = controllers_to_start(start, [one.loop for one in wishes]), read_several_loops(run)
    with output.progress("tune", 2 * len(wishes)) as step:
        found = tune_several(
            frfs, wishes, list(began.values()), several, held=recorded_under(run), seed=seed, starts=starts, step=step
        )
    _report(found, output, len(frfs))
    for sentence in () if chosen is None else chosen.sentences():
        output.paragraph(sentence)
    if found.feasible:
        write_controllers(out, found.controllers, None)
        output.say(f"controllers written to {out}")
    else:
        output.warn(["the loops do not meet all requirements together; nothing was written"])
    output.json(_json(found, out))
    return found.feasible


def _report(found: SeveralTuning, output: Output, points: int) -> None:
    rows = [_row(turn) for turn in found.turns]
    columns = ["round", "loop", "others closed", "lowest bandwidth [Hz]", "its own verdict", "C changed by [%]"]
    output.table("Loops in turn", columns, rows)
    if not found.converged:
        output.warn(["the loops interact: controllers still changed in the last round"])
    for tuning in found.tunings.values():
        report_tuning(tuning, output, points)
    report_verdicts(found.verdict.parts, output, margins=False)
    output.warn(found.notes)


def _row(turn: Turn) -> list[Any]:
    moved = None if turn.moved != turn.moved else 100.0 * turn.moved
    others = ", ".join(turn.others) or "none"
    return [turn.round, turn.loop, others, turn.tuning.bandwidth_hz, turn.tuning.outcome, moved]


def _json(found: SeveralTuning, out: Path) -> dict[str, Any]:
    return {
        "controller": str(out) if found.feasible else None,
        "converged": found.converged,
        "rounds": found.turns,
        "loops": list(found.tunings.values()),
        "each": found.verdict.each,
        "together": {k: v for k, v in found.verdict.parts[-1].to_dict().items() if k != "margins"},
        "notes": found.notes,
    }
