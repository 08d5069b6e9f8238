"""`loopshape check`: compare a controller with its requirements, on the measured FRFs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import AsJson, Details, Output, ProfileName, Quiet, RunFolder
from loopshape.cli.pictures import figures_of
from loopshape.cli.verdicts import (
    comparison_json,
    report_comparisons,
    report_headline,
    report_margins,
    report_verdicts,
    warn_of,
)
from loopshape.data.verdict_words import outcome_of

if TYPE_CHECKING:
    from loopshape.data.profile import Profile
    from loopshape.data.requirements import Verdict
    from loopshape.io.check_files import Baseline, LoopCheck


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
    figures: Annotated[bool, typer.Option(help="Draw Nichols, loop and sensitivity pictures.")] = True,
    details: Details = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Check margins, peaks and stability at every operating point; the verdict comes first.

    Exit code 1 where a requirement is missed or not decided by these data, or where something is worse than the
    baseline. Without requirements margins and stability are reported, without verdict.
    """
    reports = Reports(junit, markdown, save_verdict, baseline, allow_worse)
    output = Output(as_json, quiet)
    passed, _ = check_run(
        run, controller, require, output, reports=reports, figures=figures, details=details, profile=profile
    )
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
) -> tuple[bool, list[str]]:
    """Check each loop of a requirements file, draw and report; gives whether all is well and the figures' paths."""
    from loopshape.io.check_files import against, check_files
    from loopshape.io.profiles import profile_of

    reports = reports or Reports()
    chosen = None if profile is None else profile_of(profile)
    if require is None and chosen is None:
        return _margins(run, controller, output, reports, figures, details)
    if reports.allow_worse and reports.baseline is None:
        from loopshape.core.errors import WrongUseError

        raise WrongUseError("--allow-worse needs a baseline", "none", "name it: --baseline FILE")
    loops = check_files(run, controller, require, chosen)
    verdicts = [loop.verdict for loop in loops]
    outcome = outcome_of(verdicts)
    compared = None if reports.baseline is None else against(reports.baseline, loops)
    _write(reports, loops, compared)
    worse = compared is not None and compared.worse and not reports.allow_worse
    passed = outcome == "passed" and not worse
    report_headline(verdicts, output, ", and worse than the baseline" if worse else "")
    if details:
        report_verdicts(verdicts, output)
    else:
        warn_of(verdicts, output)
    _say_profile(chosen, verdicts, output)
    if compared is not None:
        report_comparisons(compared.parts, output, details=details)
    drawn = _draw(figures_of(run), loops) if figures else []
    _say_figures(drawn, output, details)
    output.json(
        {
            "passed": passed,
            "outcome": outcome,
            "loops": [v.to_dict() for v in verdicts],
            "profile": None if chosen is None else _profile_json(chosen, verdicts),
            "baseline": _compared_json(compared),
            "figures": drawn,
        }
    )
    return passed, drawn


def _say_profile(profile: Profile | None, verdicts: Sequence[Verdict], output: Output) -> None:
    """Zones of each loop, then standard, clause and who has to confirm."""
    from loopshape.data.profile import zone_sentence

    if profile is None:
        return
    zones = [zone_sentence(verdict, profile) for verdict in verdicts]
    for sentence in (*filter(None, zones), *profile.sentences()):
        output.paragraph(sentence)


def _profile_json(profile: Profile, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    from loopshape.core.json_ready import named
    from loopshape.data.profile import zone_shares

    words = named(profile, "name", "standard", "edition", "clause", "source", "confirm", "unread", "remarks")
    zones = {verdict.loop: zone_shares(verdict, profile) for verdict in verdicts}
    return words | {"limits": dict(profile.limits), "zones": zones}


def _say_figures(drawn: Sequence[str], output: Output, details: bool) -> None:
    if details and drawn:
        output.say("\n".join(["figures:", *drawn]))
    else:
        output.say(f"figures: {len(drawn)} in {Path(drawn[0]).parent}" if drawn else "no figures drawn")


def _margins(
    run: Path, controller: Path, output: Output, reports: Reports, figures: bool, details: bool
) -> tuple[bool, list[str]]:
    """Margins and stability of each loop with nothing required; refuses reports of a verdict."""
    from loopshape.core.errors import WrongUseError
    from loopshape.io.check_files import check_files

    if reports != Reports():
        raise WrongUseError("a verdict needs requirements", "a file for it, and no requirements", "add --require FILE")
    loops = check_files(run, controller, None)
    verdicts = [loop.verdict for loop in loops]
    output.say("no requirement given; reported without verdict\n")
    report_margins(verdicts, output, details=details)
    drawn = _draw(figures_of(run), loops) if figures else []
    _say_figures(drawn, output, details)
    made = [v.to_dict() | {"passed": None, "outcome": None} for v in verdicts]
    output.json({"passed": None, "outcome": None, "loops": made, "baseline": None, "figures": drawn})
    return True, drawn


def _write(reports: Reports, loops: Sequence[LoopCheck], compared: Baseline | None) -> None:
    from loopshape.io.junit import write_junit
    from loopshape.io.markdown import write_markdown
    from loopshape.io.verdicts import write_verdicts

    verdicts = [loop.verdict for loop in loops]
    if reports.junit is not None:
        whole = None if compared is None else compared.whole
        write_junit(reports.junit, verdicts, whole, allow_worse=reports.allow_worse)
    if reports.markdown is not None:
        write_markdown(reports.markdown, verdicts, None if compared is None else compared.parts)
    if reports.save_verdict is not None:
        write_verdicts(reports.save_verdict, [loop.checked for loop in loops])


def _draw(folder: Path, loops: Sequence[LoopCheck]) -> list[str]:
    from loopshape.cli.figures import draw_loops

    return [path for x in loops for path in draw_loops(folder, x.frfs, x.controller, x.requirements, x.fits, x.verdict)]


def _compared_json(compared: Baseline | None) -> dict[str, Any] | None:
    if compared is None:
        return None
    parts = {"by_controller": compared.by_controller, "by_plant": compared.by_plant}
    return {
        "worse": compared.worse,
        **comparison_json(compared.whole),
        **{name: None if one is None else comparison_json(one) for name, one in parts.items()},
    }
