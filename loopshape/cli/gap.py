"""`loopshape gap`: where a simulation leaves the machine, which effect causes it, how far the gap shrinks with it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from loopshape.cli.output import Output, Quiet, RunFolder, point

if TYPE_CHECKING:
    from loopshape.gap_report import GapReport, Ranked

FORMAT = "loopshape-gap/1"
SHOWN = 6


def gap(
    run: RunFolder,
    sim: Annotated[
        Path | None, typer.Argument(help="A second run, simulated or real: then without a model, no cause.")
    ] = None,
    json: Annotated[Path | None, typer.Option(help="Write the answer to this JSON file.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write the figure to this file (.png, .pdf, .svg).")] = None,
    next_study: Annotated[
        Path | None, typer.Option("--next", help="Write the experiment that would part the leading two (TOML).")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Leave the closed-loop gap table out.")] = False,
    quiet: Quiet = False,
) -> None:
    """Diagnose the gap between a run and the nominal model of its plant, or between two runs."""
    output = Output(False, quiet)
    if sim is not None:
        from loopshape.cli.gap_two_runs import two_runs

        two_runs(run, sim, json, report, output)
        return
    diagnose_run(run, output, json=json, report=report, next_study=next_study, quick=quick)


def diagnose_run(
    folder: Path,
    output: Output,
    *,
    json: Path | None = None,
    report: Path | None = None,
    next_study: Path | None = None,
    quick: bool = False,
) -> GapReport:
    """Diagnose a run folder, print what was found, and write what was asked for."""
    from loopshape.errors import WrongUseError
    from loopshape.gap.diagnose import diagnose
    from loopshape.registry import diagnosable
    from loopshape.store.run_folder import read_run

    run = read_run(folder)
    if run.plant is None:
        raise WrongUseError(
            f"{folder / 'run.toml'} names no plant, so there is no model to compare with",
            "no key plant",
            "name one (plant = ...), or give a second run: loopshape gap RUN_REAL RUN_SIM",
        )
    with output.progress("gap", 9) as step:
        found = diagnose(diagnosable(run.plant), run, folder.name, table=not quick, say=step)
    show(found, output)
    if json is not None:
        from loopshape.store.files import write_json

        write_json(json, answer(found))
        output.say(f"answer written to {json}")
    if report is not None:
        from loopshape.cli.pictures import save
        from loopshape.draw.gap_report import gap_figure

        output.say(f"figure written to {save(gap_figure(found), report)}")
    if next_study is not None:
        propose(found, folder, next_study, output)
    output.say(found.sentence)
    return found


def show(found: GapReport, output: Output) -> None:
    """Tables of a report, most important last."""
    if found.table is not None:
        from loopshape.cli.gap_two_runs import COLUMNS, gap_cells

        rows = [row for row in found.table.rows if found.table.significant(row)]
        output.table("Closed loop, nominal model against recorded", COLUMNS, [gap_cells(found.table, r) for r in rows])
    columns = ["recording", "role", "path", "nominal", "with the effect", "with the rival"]
    rows_ = [[s.recording, s.role, s.path, s.before, s.after, s.rival] for s in found.submodels]
    output.table("Submodels, rms over the noise floor", columns, rows_)
    output.table("Which", ["effect", "probability", "magnitude", "95 %", "unit", "form"], ranking_rows(found.ranking))
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
    for line in found.software or ["software: z is what the controllers answer, in every recording that tells"]:
        output.say(line)
    output.warn(found.notes)


def ranking_rows(ranking: Sequence[Ranked]) -> list[list[Any]]:
    """The first hypotheses as cells."""
    rows: list[list[Any]] = []
    for r in ranking[:SHOWN]:
        parts: dict[str, Any] = dict(r.parts)
        if r.magnitude is not None:
            parts = {r.effect: (r.magnitude, r.interval, r.unit)}
        rows.append(
            [
                r.effect,
                f"{r.probability:.1%}",
                ", ".join(f"{m:.3g}" for m, _, _ in parts.values()) or None,
                ", ".join(f"{i[0]:.3g} to {i[1]:.3g}" for _, i, _ in parts.values() if i) or None,
                ", ".join(u or "" for _, _, u in parts.values()) or None,
                r.form,
            ]
        )
    return rows


def answer(found: GapReport) -> dict[str, Any]:
    """The JSON that other tools read; see the exchange format's page in docs."""
    gap = found.gap
    return {
        "format": FORMAT,
        "run": found.run,
        "plant": found.plant,
        "verdict": found.verdict,
        "ranking": [_rank_json(r) for r in found.ranking],
        "ambiguity_set": list(found.ambiguity),
        "where": {
            "block": found.where.block,
            "blocks": dict(found.where.blocks),
            "channel": found.where.channel,
            "band_hz": list(found.where.band_hz),
            "operating_points": [dict(p) for p in found.where.operating_points],
        },
        "gap": None
        if gap is None
        else {
            "metric": gap.metric,
            "noise_floor": 1.0,
            "before": gap.before,
            "after": gap.after,
            "shrink": gap.shrink,
            "interval": None if gap.interval is None else list(gap.interval),
            "recordings": [f"{name}.parquet" if "." not in name else name for name in gap.recordings],
            "rival": gap.rival,
            "rival_after": gap.rival_after,
        },
        "submodels": [
            {k: getattr(s, k) for k in ("recording", "role", "path", "before", "after", "rival")}
            for s in found.submodels
        ],
        "parameters": dict(found.moves),
        "software": list(found.software),
        "notes": list(found.notes),
        "sentence": found.sentence,
    }


def _rank_json(r: Ranked) -> dict[str, Any]:
    row: dict[str, Any] = {"effect": r.effect, "probability": r.probability}
    if r.magnitude is not None:
        row |= {"magnitude": r.magnitude, "interval": list(r.interval or ()), "unit": r.unit, "form": r.form}
    if r.parts:
        row["form"] = r.form
        row["parts"] = {
            effect: {"magnitude": m, "interval": list(i), "unit": u} for effect, (m, i, u) in r.parts.items()
        }
    return row


def propose(found: GapReport, folder: Path, path: Path, output: Output) -> None:
    """Write the study that would part the leading two hypotheses."""
    raise NotImplementedError
