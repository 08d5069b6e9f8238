"""`loopshape check-several`: compare the controllers of several loops with the requirements of each and of all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Details, Output, ProfileName, Quiet, RunFolder
from loopshape.cli.pictures import figures_of
from loopshape.cli.tune import RequireFile

if TYPE_CHECKING:
    from loopshape.data.controller import Controller
    from loopshape.data.frf import FRF
    from loopshape.data.several import SeveralMargins, SeveralVerdict

_COLUMNS = [
    "recordings",
    "closed loops",
    "disk margin",
    "95 % interval",
    "GM [dB]",
    "PM [deg]",
    "in and out",
    "modulus",
]
_COLUMNS += ["S [dB]", "T [dB]", "at [Hz]", "lost by"]


def check_several(
    run: RunFolder,
    controllers: Annotated[Path, typer.Argument(help="A controller file (TOML) with all loops.", show_default=False)],
    require: RequireFile,
    loops: Annotated[
        str | None, typer.Option(help="Loops that are closed, as a,b; default: all of the matrix.")
    ] = None,
    profile: ProfileName = None,
    junit: Annotated[Path | None, typer.Option(help="Write a JUnit XML report too.")] = None,
    figures: Annotated[bool, typer.Option(help="Draw loci, singular values and margins.")] = True,
    details: Details = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Check several loops of one plant at once, from its matrix FRFs; needs `frf RUN --matrix` before.

    Each loop is compared with its limits with all others closed (a profile's too), then all together: stability by
    det(I + L), and what the table [several] of the requirements asks. Exit code 1 where anything is missed or not
    decided by these data.
    """
    from loopshape.cli.verdicts import report_headline, report_verdicts, warn_of
    from loopshape.io.check_files import recorded_under
    from loopshape.io.controllers import read_controllers
    from loopshape.io.frfs import read_several_loops
    from loopshape.io.junit import write_junit
    from loopshape.io.profiles import joined
    from loopshape.io.requirements import read_requirements, read_several
    from loopshape.loop.several import check_several as check

    output = Output(as_json, quiet)
    (wished, standard), several = joined(profile, read_requirements(require)), read_several(require)
    chosen = tuple(name.strip() for name in loops.split(",")) if loops else None
    frfs, own = read_several_loops(run), read_controllers(controllers)
    verdict = check(frfs, own, wished, several, loops=chosen, held=recorded_under(run))
    if junit is not None:
        write_junit(junit, [*verdict.each, verdict.together])
    report_headline([*verdict.each, verdict.together], output)
    if details:
        report_verdicts(verdict.each, output)
        report_verdicts([verdict.together], output, margins=False)
        output.table("All loops at once", _COLUMNS, [_row(name, m) for name, m in verdict.margins.items()])
    else:
        warn_of([*verdict.each, verdict.together], output)
    for sentence in () if standard is None else standard.sentences():
        output.paragraph(sentence)
    drawn = _draw(run, verdict, frfs, own, several) if figures else []
    output.say("\n".join(["figures:", *drawn]) if drawn else "no figures drawn")
    output.json(
        {
            "passed": verdict.passed,
            "outcome": verdict.outcome,
            "loops": list(verdict.loops),
            "each": [one.to_dict() for one in verdict.each],
            "together": verdict.together.to_dict(),
            "figures": drawn,
        }
    )
    if not verdict.passed:
        raise typer.Exit(1)


def _row(recording: str, m: SeveralMargins) -> list[Any]:
    from loopshape.data.verdict_words import interval_text

    numbers: list[Any] = [m.gain_margin_db, m.phase_margin_deg, m.input_output_disk_margin, m.modulus_margin]
    numbers += [x if x == x else None for x in (m.sensitivity_peak_db, m.complementary_peak_db)]
    interval = interval_text(m.intervals.get("disk_margin"))
    return [recording, m.stable, m.disk_margin, interval, *numbers, m.at_hz["disk_margin"], _changes_text(m)]


def _changes_text(m: SeveralMargins) -> str:
    """The changes that bring all loops to their limit: "theta1 +1.2 dB -8 deg, theta2 -0.9 dB +3 deg"."""
    return ", ".join(f"{name} {x['gain_db']:+.2g} dB {x['phase_deg']:+.2g} deg" for name, x in m.changes.items())


def _draw(
    run: Path, verdict: SeveralVerdict, frfs: Sequence[FRF], controllers: Sequence[Controller], several: Any
) -> list[str]:
    """A page for each operating point."""
    from loopshape.cli.pictures import save
    from loopshape.loop.several import loop_matrices
    from loopshape.view.several import several_page

    drawn = []
    matrices = loop_matrices(frfs, controllers, several, loops=verdict.loops)[0]
    for k, (recording, matrix) in enumerate(matrices.items()):
        each = {one.loop: one.margins[recording] for one in verdict.each}
        page = several_page(matrix, verdict.margins[recording], each, several)
        tail = f"_{k + 1:02d}" if len(matrices) > 1 else ""
        drawn.append(str(save(page, figures_of(run) / f"several_{'+'.join(verdict.loops)}{tail}.png")))
    return drawn
