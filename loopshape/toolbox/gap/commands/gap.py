"""`loopshape gap`: where a simulation leaves the machine, which effect causes it, how far the gap shrinks with it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from loopshape.cli.output import AsJson, Details, Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.toolbox.gap.nouns.effect import Fix
    from loopshape.toolbox.gap.nouns.gap_report import BudgetStep, Floor, GapReport, Ranked

#: hypotheses printed with --details, and without
SHOWN, FIRST = 6, 3


def gap(
    run: RunFolder,
    sim: Annotated[
        Path | None, typer.Argument(help="A second run, simulated or real: then without a model, no cause.")
    ] = None,
    save_answer: Annotated[
        Path | None, typer.Option(help="Write the answer to this JSON file, the fix beside it.")
    ] = None,
    report: Annotated[Path | None, typer.Option(help="Write the figure to this file (.png).")] = None,
    next_study: Annotated[
        Path | None,
        typer.Option("--next", help="Write the experiment that best separates the two leading hypotheses."),
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="A machine of your own (model.toml); its Python file is run.")
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(help="With --model: a run of a good machine; what is left there is no gap."),
    ] = None,
    identifiable: Annotated[
        bool,
        typer.Option("--identifiable", help="Smallest visible size of each effect, and its twins; no diagnosis."),
    ] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Leave the closed-loop gap table out.")] = False,
    details: Details = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Diagnose the gap between a machine and its model.

    Between a run and the nominal model of its plant, or between two runs; the verdict first.
    """
    output = Output(as_json, quiet)
    from loopshape.toolbox.gap.commands.gap_two_runs import check_files

    files = GapFiles(save_answer, report, next_study)
    check_files(*files)
    if baseline is not None and (sim is not None or identifiable):
        refuse_baseline("a second run" if sim is not None else "--identifiable")
    if sim is not None:
        from loopshape.toolbox.gap.commands.gap_two_runs import two_runs

        two_runs(run, sim, save_answer, report, output, details=details)
        return
    if identifiable:
        show_identifiable(run, model, output)
        return
    diagnose_run(run, output, files, quick=quick, details=details, model=model, baseline=baseline)


class GapFiles(NamedTuple):
    """Files that a diagnosis writes: the answer, its picture, and a study to record next; None where not wanted."""

    save_answer: Path | None = None
    report: Path | None = None
    next_study: Path | None = None


def show_identifiable(folder: Path, model: Path | None, output: Output) -> None:
    """Print how small each effect may be to be seen in a run, and which others look like it."""
    from dataclasses import asdict

    from loopshape.toolbox.gap.verbs import identifiability

    with output.progress("identifiable", 9) as step:
        found = identifiability(folder, model=model, say=step)
    rows = [[x.effect, "not seen" if x.least is None else f"{x.least:.3g} {x.unit}", ", ".join(x.alike) or "-"]
            for x in sorted(found, key=lambda x: (x.least is None, x.effect))]  # fmt: skip
    output.table("What these recordings can tell", ["effect", "least that is seen", "looks like"], rows)
    output.json({"effects": [asdict(x) for x in found]})


def diagnose_run(
    folder: Path,
    output: Output,
    files: GapFiles,
    *,
    quick: bool = False,
    details: bool = False,
    model: Path | None = None,
    baseline: Path | None = None,
) -> GapReport:
    """Diagnose a run folder, print what was found, and write what was asked for.

    Nothing is computed where a file cannot be what was asked for, and nothing is written where a run is refused.
    """
    from loopshape.toolbox.gap.commands.gap_two_runs import check_files
    from loopshape.toolbox.gap.verbs import gap as run_gap

    save_answer, report, next_study = files
    check_files(*files)
    with output.progress("gap", 9) as step:
        found = run_gap(folder, model=model, baseline=baseline, table=not quick, name=folder.name, say=step)
    _headline(found, output)
    if details:
        show(found, output)
    output.warn(found.notes)
    if save_answer is not None:
        found = _saved(found, save_answer)
    if found.fix is not None:
        output.paragraph(_fix_line(found.fix, save_answer))
    if save_answer is not None:
        output.say(f"answer written to {save_answer}")
    if report is not None:
        from loopshape.toolbox.gap.pictures.report import gap_figure
        from loopshape.verbs.pictures import save

        output.say(f"figure written to {save(gap_figure(found), report)}")
    if next_study is not None:
        propose(found, next_study, output)
    output.json(found.to_dict())
    return found


def _saved(found: GapReport, answer: Path) -> GapReport:
    """Write the answer, and beside it the missing forces and the fix; the report names the files as written."""
    from loopshape.io.files import make_folder, write_json, write_text_whole
    from loopshape.toolbox.gap.nouns.gap_report import missing_csv

    make_folder(answer.parent)
    if found.fix is not None:
        names = {name: write_beside(answer.parent / name, text) for name, text in found.fix.texts.items()}
        found = replace(found, fix=found.fix.named(names))
    for curves in found.missing_by_place.values():
        write_text_whole(answer.parent / curves[0].file, missing_csv(curves))
    write_json(answer, found.to_dict())
    return found


def write_beside(path: Path, text: str) -> str:
    """Write a text under the first free name of name.x, name_2.x and so on, and give it; what stands there is kept.

    A file that holds this very text is the one.
    """
    from loopshape.core.errors import WrongUseError
    from loopshape.io.files import write_text_whole

    most = 1000
    for k in range(1, most):
        free = path.with_stem(path.stem + f"_{k}" * (k > 1))
        if not os.path.lexists(free):
            write_text_whole(free, text)
            return free.name
        if free.is_file() and free.stat().st_size == len(text.encode()) and free.read_text("utf-8") == text:
            return free.name
    raise WrongUseError("a file of this name can be written", f"{most} of {path}", "remove old ones")


def _fix_line(fix: Fix, answer: Path | None) -> str:
    """What the fix changes, from what to what, and where its files are."""
    whose = "fix" if fix.is_verdict else f"fix, if it is {fix.of}"
    files = [str(answer.parent / name) for name in (fix.file, fix.function) if name] if answer is not None else []
    return f"{whose}: {fix.sentence}" + (f" ({' and '.join(files)})" if files else "")


def refuse_baseline(beside: str) -> None:
    """Refuse a baseline where no diagnosis is made."""
    from loopshape.core.errors import WrongUseError

    raise WrongUseError(
        "a baseline is the floor of a diagnosis of one run", f"--baseline and {beside}", "leave one of them out"
    )


def _headline(found: GapReport, output: Output) -> None:
    """The diagnosis in one sentence, the leading hypotheses, the place, and what to record next: 80 columns."""
    output.paragraph(found.sentence)
    output.say("")
    rows = [row for r in found.ranking[:FIRST] for row in _short_rows(r)]
    output.table("Leading hypotheses", ["effect", "probability", "magnitude", "95 % interval"], rows)
    if found.twins:
        output.paragraph(f"not told apart by these recordings: {', '.join((found.verdict, *found.twins))}")
    agree, count = found.agreeing
    if found.verdict != "none" and count:
        output.paragraph(f"left out of the fit, {agree} of {count} recordings or pieces are predicted best with it")
    if found.budget:
        steps = [x for k, x in enumerate(found.budget) if not k or x.effects != found.budget[k - 1].effects]
        known = [_floor_words(floor) for floor in found.floors if floor.source in _SOURCES]
        unit = "floor" if known else "noise floor"
        cells = [[_WITH[x.step].format(" + ".join(x.effects) or unit), x.gap, *_shares(x)] for x in steps]
        output.table("Where the gap goes", ["with", f"left, {unit}s", "explains", "95 % interval"], cells)
        if known:
            output.paragraph(f"floor: {'; '.join(known)}")
    place, (low, high) = found.where, found.where.band_hz
    if place.block != "none":
        output.paragraph(f"where: {place.block}, most visible in {place.channel} from {low:.3g} to {high:.3g} Hz")
    if found.windows_s:
        tried = ", ".join(f"{w:g}" for w in found.windows_s)
        output.paragraph(f"windows: {found.window_s:g} s, where a force or signal explains most (tried: {tried} s)")
    for words in found.software:
        output.paragraph(words)
    if found.proposal is not None:
        output.paragraph(f"next: {found.proposal.sentence}")


_WITH = {
    "before": "nothing added",
    "best_name": "{}",
    "best_set": "{}",
    "ceiling": "any push at {}",
    "floor": "{}",
}


#: where a floor comes from, if it is not estimated
_SOURCES = {
    "leaves": "as stated (leaves)",
    "baseline": "what the model leaves of the baseline",
    "frf": "the FRF's error",
}


def _floor_words(floor: Floor) -> str:
    unit = "" if floor.unit in ("", "1") else f" {floor.unit}"
    return f"{floor.output} {floor.rms:.3g}{unit}, {_SOURCES[floor.source]}"


def _shares(step: BudgetStep) -> list[str]:
    """The share of a gap that a step takes away, and its interval."""
    share, interval = step.share, step.interval
    return [
        "-" if share is None else f"{share:.0%}",
        "-" if interval is None else f"{interval[0]:.0%} to {interval[1]:.0%}",
    ]


def _short_rows(r: Ranked) -> list[list[Any]]:
    """A hypothesis with its magnitude; a pair takes a row for each of its effects."""
    sizes = r.sizes or {r.effect: ("-", None)}
    return [
        [
            f"{'' if k == 0 else '+ '}{effect}",
            f"{r.probability:.1%}" if k == 0 else "",
            size,
            f"{interval[0]:.3g} to {interval[1]:.3g}" if interval else "-",
        ]
        for k, (effect, (size, interval)) in enumerate(sizes.items())
    ]


def show(found: GapReport, output: Output) -> None:
    """Every table of a report."""
    if found.table is not None:
        from loopshape.toolbox.gap.commands.gap_two_runs import COLUMNS, gap_cells

        rows = [row for row in found.table.rows if found.table.significant(row)]
        if rows:
            cells = [gap_cells(found.table, row) for row in rows]
            output.table("Closed loop, nominal model against recorded", COLUMNS, cells)
    control = found.control
    if control:
        nu = [[c["loop"], c["recording"], point(c["operating_point"]), *(c[k] for k in _NU_KEYS)] for c in control]
        heads = ["loop", "recording", "operating point", "nominal", "with the effect", "to the nearest real point"]
        output.table("For control: nu-gap of the loop-shaped plants to the recorded ones", heads, nu)
    columns = ["recording", "role", "path", "nominal", "with the effect", "with the rival"]
    rows_ = [[s.recording, s.role, s.path, s.before, s.after, s.rival] for s in found.submodels]
    output.table("Submodels, rms relative to the noise floor", columns, rows_)
    output.table("Hypotheses", ["effect", "probability", "magnitude", "95 %", "form"], ranking_rows(found.ranking))
    place = found.where
    output.table(
        "Where",
        ["block", "channel", "band [Hz]", "operating points"],
        [
            [
                place.block,
                place.channel,
                f"{place.band_hz[0]:.3g} to {place.band_hz[1]:.3g}",
                "; ".join(point(p) for p in place.operating_points),
            ]
        ],
    )
    if place.places:
        output.table(
            "Residual if this equation had an arbitrary disturbance, relative to the noise floor",
            ["equation", "residual"],
            place.places.items(),
        )
    for line in found.software or ["software: the logged commands agree with the stated controllers"]:
        output.say(line)


_NU_KEYS = ("nu_gap_before", "nu_gap_after", "nu_gap_to_nearest_point")


def ranking_rows(ranking: Sequence[Ranked]) -> list[list[Any]]:
    """The first hypotheses as cells."""
    rows: list[list[Any]] = []
    for r in ranking[:SHOWN]:
        sizes = r.sizes.values()
        rows.append(
            [
                r.effect,
                f"{r.probability:.1%}",
                ", ".join(size for size, _ in sizes) or None,
                ", ".join(f"{i[0]:.3g} to {i[1]:.3g}" for _, i in sizes if i) or None,
                r.form,
            ]
        )
    return rows


def propose(found: GapReport, path: Path, output: Output) -> None:
    """Write the study that best separates the two leading hypotheses; say so where there is none to write."""
    from loopshape.io.files import make_folder, write_toml

    if found.proposal is None or found.proposal.study is None:
        output.warn([f"no experiment of this rig separates the leading hypotheses: {path} is not written"])
        return
    make_folder(path.parent)
    write_toml(path, found.proposal.study.to_table())
    output.say(f"study written to {path}")
