"""`loopshape bound`: how far a controller is from the best that any controller could do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.design.tune import RequireFile
from loopshape.cli.output import AsJson, Output, Quiet, RunFolder

if TYPE_CHECKING:
    from loopshape.toolbox.limits.bound import Bound


def bound(
    run: RunFolder,
    controller: Annotated[Path, typer.Argument(help="A controller file (TOML).", show_default=False)],
    require: RequireFile,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Bandwidths that no controller of any order exceeds.

    Under the requirements, beside the bandwidth of a given controller.
    """
    bound_run(run, controller, require, Output(as_json, quiet))


def bound_run(run: Path, controller: Path, require: Path, output: Output) -> list[Bound]:
    """Bound each loop of a requirements file and report."""
    from loopshape.io.requirements import read_requirements
    from loopshape.io.write.check_files import controller_of
    from loopshape.io.write.controllers import read_controllers
    from loopshape.io.write.fits import fits_of
    from loopshape.io.write.frfs import read_frfs
    from loopshape.toolbox.limits.bound import bound as bound_loop

    controllers, frfs, fits = read_controllers(controller), read_frfs(run), fits_of(run)
    found = []
    for required in read_requirements(require):
        mine = [one for one in frfs if one.loop == required.loop]
        with output.progress(f"bound {required.loop}", 2 * len(mine)) as step:
            found.append(bound_loop(mine, controller_of(controllers, required.loop), required, fits, step=step))
        _report(found[-1], output)
    output.json({"loops": found})
    return found


def _report(one: Bound, output: Output) -> None:
    rows = []
    for alone in one.alone:
        found, some = one.bandwidths_hz[alone.recording], alone.bound_hz < float("inf")
        rows.append([alone.recording, found, *((alone.bound_hz, found / alone.bound_hz) if some else (None, None))])
    columns = ["recording", "bandwidth [Hz]", "no controller for it alone exceeds [Hz]", "ratio"]
    output.table(f"Loop {one.loop}: bandwidth and bound at each operating point", columns, rows)
    for line in sentences(one):
        output.say(line)
    output.warn(one.notes)
    if one.outcome == "failed":
        output.warn([f"the controller of loop {one.loop} does not meet its requirements: its ratio says little"])
    low = [alone.recording for alone in one.alone if alone.bound_hz <= alone.first_hz]
    if low:
        output.warn([f"the limits leave no bandwidth within the measured frequencies at {', '.join(low)}"])


def sentences(one: Bound) -> list[str]:
    """What a bound says, in words."""
    least, together = one.least_alone, one.together
    notes = []
    if one.impossible:
        return [f"loop {one.loop}: {one.answer}"]
    if together.bound_hz == float("inf"):
        return [f"loop {one.loop}: these limits exclude no bandwidth within the measured frequencies"]
    if len(one.alone) > 1:
        notes.append(
            f"no single controller for all {len(one.alone)} operating points exceeds {one.bound_hz:.3g} Hz;"
            f" this one has {one.found_hz:.3g} Hz, ratio {one.ratio:.2f}"
        )
    notes.append(
        f"at {least.recording} alone none exceeds {least.bound_hz:.3g} Hz; one of {one.reached.parameters}"
        f" parameters reaches {one.reached.bandwidth_hz:.3g} Hz there"
    )
    notes.append(f"kept by the bound: {', '.join(one.counted) or 'nothing'}")
    if one.left_out:
        notes.append(f"left out (they only lower what is possible): {', '.join(one.left_out)}")
    return notes
