"""`loopshape check`: compare a controller with its requirements, on the measured FRFs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Details, DiagramFile, Output, ProfileName, Quiet, RunFolder
from loopshape.cli.pictures import figures_of
from loopshape.cli.verify.verdicts import (
    report_comparisons,
    report_headline,
    report_margins,
    report_phase_budget,
    report_verdicts,
    warn_of,
)
from loopshape.data.result.verdict_words import outcome_of

if TYPE_CHECKING:
    from loopshape.data.requirement.profile import Profile
    from loopshape.data.result.verdict import Verdict
    from loopshape.io.write.check_files import Baseline, Checks


@dataclass(frozen=True)
class Reports:
    """Files that a check writes or is compared with; None where they are not wanted."""

    junit: Path | None = None
    markdown: Path | None = None
    save_verdict: Path | None = None
    baseline: Path | None = None
    allow_worse: bool = False


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
    baseline: Annotated[Path | None, typer.Option(help="A kept verdict: say what got better or worse.")] = None,
    allow_worse: Annotated[
        bool, typer.Option("--allow-worse", help="Say what got worse, and exit by the requirements alone.")
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
    reports: Reports | None = None,
    figures: bool = True,
    details: bool = False,
    profile: str | None = None,
    matrix: bool = False,
    closed: Sequence[str] | None = None,
    disturbance: Path | None = None,
    diagram: Path | None = None,
) -> tuple[bool, list[str]]:
    """Check each loop of a requirements file, draw and report; gives whether all is well and the figures' paths."""
    from loopshape.io.profiles import profile_of
    from loopshape.io.write.check_files import against, check_all

    reports = reports or Reports()
    chosen = None if profile is None else profile_of(profile)
    _refuse_reports(reports, require is not None or chosen is not None)
    found = check_all(
        run, controller, require, chosen, matrix=matrix, closed=closed, disturbance=disturbance, diagram=diagram
    )
    if require is None and chosen is None:
        return True, _report_margins(run, found, output, figures, details)
    compared = None if reports.baseline is None else against(reports.baseline, found.single)
    _write(reports, found, compared)
    outcome = outcome_of(found.verdicts)
    worse = compared is not None and compared.worse and not reports.allow_worse
    passed = outcome == "passed" and not worse
    report_headline(found.verdicts, output, ", and worse than the baseline" if worse else "", run)
    if details:
        report_verdicts(found.verdicts, output)
        for one in found.loops:
            report_phase_budget(one.verdict, one.controller, output)
    else:
        warn_of(found.verdicts, output)
    _say_profile(chosen, found.verdicts, output)
    if compared is not None:
        report_comparisons(compared.parts, output, details=details)
    drawn = _draw(figures_of(run), found) if figures else []
    _say_figures(drawn, output, details)
    output.json(
        {
            "passed": passed,
            "outcome": outcome,
            "loops": found.verdicts,
            "profile": None if chosen is None else _profile_json(chosen, found.verdicts),
            "baseline": compared,
            "figures": drawn,
        }
    )
    return passed, drawn


def _refuse_reports(reports: Reports, required: bool) -> None:
    from loopshape.core.errors import WrongUseError

    if not required and reports != Reports():
        raise WrongUseError("a verdict needs requirements", "a file for it, and no requirements", "add --require FILE")
    if reports.allow_worse and reports.baseline is None:
        raise WrongUseError("--allow-worse needs a baseline", "none", "name it: --baseline FILE")


def _say_profile(profile: Profile | None, verdicts: Sequence[Verdict], output: Output) -> None:
    """Zones of each loop, then standard, clause and who has to confirm."""
    from loopshape.data.requirement.profile import zone_sentence

    if profile is None:
        return
    zones = [zone_sentence(verdict, profile) for verdict in verdicts if not verdict.together]
    for sentence in (*filter(None, zones), *profile.sentences()):
        output.paragraph(sentence)


_PROFILE = ("name", "standard", "edition", "clause", "source", "confirm", "unread", "remarks", "limits")


def _profile_json(profile: Profile, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    from loopshape.data.requirement.profile import zone_shares

    zones = {verdict.loop: zone_shares(verdict, profile) for verdict in verdicts if not verdict.together}
    return {name: getattr(profile, name) for name in _PROFILE} | {"zones": zones}


def _say_figures(drawn: Sequence[str], output: Output, details: bool) -> None:
    if details and drawn:
        output.say("\n".join(["figures:", *drawn]))
    else:
        output.say(f"figures: {len(drawn)} in {Path(drawn[0]).parent}" if drawn else "no figures drawn")


def _report_margins(run: Path, found: Checks, output: Output, figures: bool, details: bool) -> list[str]:
    """Margins and stability of each loop with nothing required; gives the figures' paths."""
    output.say("no requirement given; reported without verdict\n")
    report_margins(found.verdicts, output, details=details)
    drawn = _draw(figures_of(run), found) if figures else []
    _say_figures(drawn, output, details)
    made = [v.to_dict() | {"passed": None, "outcome": None} for v in found.verdicts]
    output.json({"passed": None, "outcome": None, "loops": made, "baseline": None, "figures": drawn})
    return drawn


def _write(reports: Reports, found: Checks, compared: Baseline | None) -> None:
    from loopshape.io.write.junit import write_junit
    from loopshape.io.write.markdown import write_markdown
    from loopshape.io.write.verdicts import write_verdicts

    if reports.save_verdict is not None:
        write_verdicts(reports.save_verdict, [loop.checked for loop in found.single])
    if reports.junit is not None:
        whole = None if compared is None else compared.whole
        write_junit(reports.junit, found.verdicts, whole, allow_worse=reports.allow_worse)
    if reports.markdown is not None:
        write_markdown(reports.markdown, found.verdicts, None if compared is None else compared.parts)


def _draw(folder: Path, found: Checks) -> list[str]:
    from loopshape.cli.estimate.figures import draw_loops, draw_several
    from loopshape.cli.pictures import save

    if found.matrix is not None:
        return draw_several(folder, found.matrix)
    first = [] if found.diagram is None else [str(save(found.diagram.figure(), folder / "diagram.png"))]
    return first + [
        path for x in found.loops for path in draw_loops(folder, x.controller.loop, x.loops, x.requirements, x.verdict)
    ]
