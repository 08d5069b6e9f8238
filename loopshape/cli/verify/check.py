"""`loopshape check`: compare a controller with its requirements, on the measured FRFs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Details, DiagramFile, Output, ProfileName, Quiet, RunFolder
from loopshape.view.verdict import tables

if TYPE_CHECKING:
    from loopshape.data.result.baseline import Comparison
    from loopshape.data.result.verdict import Verdict
    from loopshape.verbs.runs import CheckedRun


def check(
    run: RunFolder,
    controller: Annotated[Path, typer.Argument(help="A controller file (TOML).", show_default=False)],
    require: Annotated[
        Path | None, typer.Option("--require", help="Requirements (TOML); without them margins, and no verdict.")
    ] = None,
    profile: ProfileName = None,
    junit: Annotated[Path | None, typer.Option(help="Write a JUnit XML report too.")] = None,
    markdown: Annotated[Path | None, typer.Option(help="Write a Markdown summary too.")] = None,
    save_verdict: Annotated[Path | None, typer.Option(help="Keep the verdict (JSON), a baseline for later.")] = None,
    baseline: Annotated[Path | None, typer.Option(help="A kept verdict: report what got better or worse.")] = None,
    allow_worse: Annotated[
        bool, typer.Option("--allow-worse", help="Report what got worse; the exit code follows the requirements alone.")
    ] = False,
    matrix: Annotated[
        bool, typer.Option("--matrix", help="All loops of the plant's matrix at once; needs frf RUN --matrix before.")
    ] = False,
    loops: Annotated[
        str | None, typer.Option(help="Of the matrix the loops that are closed, as a,b; default: all.")
    ] = None,
    disturbance: Annotated[
        Path | None, typer.Option(help="A recording of the loop without excitation: gives the rms of the error.")
    ] = None,
    diagram: DiagramFile = None,
    figures: Annotated[bool, typer.Option(help="Draw Nichols, loop and sensitivity pictures.")] = True,
    details: Details = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Check margins and stability at each operating point. Peaks and bandwidth too; the verdict comes first.

    Exit code 1 where a requirement is missed or not decided by these data, or where something is worse than the
    baseline. Without requirements margins and stability are reported, without verdict.

    With --matrix, or a table [several] in the requirements, several loops of one plant are checked together: each with
    all others closed, then all at once: stability by det(I + L), and what [several] asks.

    With --diagram (a cascade, two actuators, an observer) the plant is what the diagram's tuned block meets; loops that
    are closed within it are checked first and have to be stable.
    """
    from loopshape.verbs.runs import Reports

    reports = Reports(junit, markdown, save_verdict, baseline, allow_worse)
    output = Output(as_json, quiet)
    closed = None if loops is None else tuple(name.strip() for name in loops.split(","))
    passed, _ = check_run(
        run, controller, require, output, reports=reports, figures=figures, details=details, profile=profile,
        matrix=matrix or closed is not None, closed=closed, disturbance=disturbance,
        diagram=diagram,
    )  # fmt: skip
    if not passed:
        raise typer.Exit(1)


def check_run(
    run: Path,
    controller: Path,
    require: Path | None,
    output: Output,
    *,
    figures: bool = True,
    details: bool = False,
    **options: Any,
) -> tuple[bool, list[str]]:
    """Check each loop of a requirements file, draw and report; gives whether all is well and the figures' paths."""
    with output.progress("check", 1):
        from loopshape.verbs import runs
        from loopshape.verbs.pictures import draw_checks, figures_of

        found = runs.check(run, controller, require, **options)
    runs.write_reports(found, options.get("reports") or runs.Reports())
    verdicts = found.checks.verdicts
    if found.required:
        _report(found, run, output, details)
    else:
        output.say("no requirement given; reported without verdict\n")
        report_margins(verdicts, output, details=details)
    with output.progress("draw", 1):
        drawn = draw_checks(figures_of(run), found.checks) if figures else []
    _say_figures(drawn, output, details)
    words = {"passed": found.passed, "outcome": found.outcome}
    loops = verdicts if found.required else [v.to_dict() | words for v in verdicts]
    profile = {"profile": found.profile_words} if found.required else {}
    output.json({**words, "loops": loops, **profile, "baseline": found.compared, "figures": drawn})
    return found.passed is not False, drawn


def _report(found: CheckedRun, run: Path, output: Output, details: bool) -> None:
    """The verdict in one sentence, of each loop the requirements in 80 columns, and what stands beside them."""
    checks = found.checks
    output.say(f"{found.text(str(run))}\n")
    if details:
        report_verdicts(checks.verdicts, output)
        for one in checks.verdicts:
            for own in one.controllers:
                output.tables(tables.phase_budget_tables(one, own))
    else:
        warn_of(checks.verdicts, output)
    if found.profile is not None:
        zones = [tables.zone_sentence(one, found.profile) for one in checks.verdicts if not one.together]
        for sentence in (*filter(None, zones), *found.profile.sentences()):
            output.paragraph(sentence)
    if found.compared is not None:
        report_comparisons(found.compared.parts, output, details=details)


def report_verdicts(verdicts: Sequence[Verdict], output: Output, *, margins: bool = True) -> None:
    """Requirement lines, and the margins of each operating point."""
    for verdict in verdicts:
        output.tables(tables.verdict_tables(verdict, margins=margins))
    warn_of(verdicts, output)


def report_margins(verdicts: Sequence[Verdict], output: Output, *, details: bool = True) -> None:
    """The margins of each operating point where nothing was required; without `details` in 80 columns."""
    for verdict in verdicts:
        output.table(*tables.margins_table(verdict, details=details))
    warn_of(verdicts, output)


def warn_of(verdicts: Sequence[Verdict], output: Output) -> None:
    """Warnings of verdicts, and each operating point whose loop is not known to be stable."""
    for verdict in verdicts:
        output.warn(tables.notices(verdict))


def report_comparisons(comparisons: Mapping[str, Comparison], output: Output, *, details: bool = True) -> None:
    """What became of a baseline: outcomes that changed, then margins that did, then what lies underneath."""
    for title, comparison in comparisons.items():
        if not details:
            output.paragraph(comparison.text(title))
            continue
        output.tables(comparison.tables(title))
        for line in comparison.remarks:
            output.say(line)
        output.say(f"{title}: {comparison.counts}\n")


def _say_figures(drawn: Sequence[str], output: Output, details: bool) -> None:
    if details and drawn:
        output.say("\n".join(["figures:", *drawn]))
    else:
        output.say(f"figures: {len(drawn)} in {Path(drawn[0]).parent}" if drawn else "no figures drawn")
