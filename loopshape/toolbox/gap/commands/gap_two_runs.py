"""What `loopshape gap` says of two recorded runs, without a model: where they differ and how much."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopshape.cli.output import Output, point

if TYPE_CHECKING:
    from loopshape.toolbox.gap.nouns.gap_table import GapRow, GapTable, NuGapRow, TimeRow

FORMAT = "loopshape-gap-table/1"
#: rows printed without --details
FIRST = 6
COLUMNS = (
    "path", "operating point", "injected", "band [Hz]", "size [%]", "z2", "p", "gain [dB]", "phase [deg]",
    "odd/even real [dB]", "odd/even sim [dB]", "",
)  # fmt: skip
NU_COLUMNS = ("loop", "recording", "operating point", "nu-gap", "95 %", "at [Hz]", "to neighbour", "")
TIME_COLUMNS = ("recording", "signal", "what", "from [s]", "to [s]", "difference", "unit", "floor", "")


def two_runs(
    real: Path,
    sim: Path,
    save_answer: Path | None = None,
    report: Path | None = None,
    output: Output | None = None,
    bands: str = "third_decade",
    details: bool = False,
) -> GapTable:
    """Compare two run folders, print the conclusion and the table, write JSON and figure; gives the table.

    `save_answer` and `report` (.png) are files. Without `details` the FRF rows printed are the largest of those
    that stand out of the noise. Nothing is written where anything is refused.
    """
    from loopshape.io.files import make_folder, write_json
    from loopshape.io.run.run_folder import read_run
    from loopshape.toolbox.gap.two_runs.table import compare

    check_files(save_answer, report)
    output = output or Output()
    table = compare(read_run(real), read_run(sim), bands=bands, real_name=real.name, sim_name=sim.name)
    output.paragraph(table.conclusion)
    output.say("")
    (_tables if details else _first_table)(table, output)
    output.warn([*table.unmatched, *table.notes])
    content = payload(table)
    figure = _draw(table, report)
    if report is not None and figure is None:
        output.warn([f"{report} is not written: the runs share no response to draw"])
    if save_answer is not None:
        make_folder(save_answer.parent)
        write_json(save_answer, content)
    output.json(content | ({"figures": [str(figure)]} if figure else {}))
    return table


def _first_table(table: GapTable, output: Output) -> None:
    """What stands out of the noise, largest first, in 80 columns."""
    rows = sorted((row for row in table.rows if table.significant(row)), key=lambda row: -row.size)
    cells = [
        [row.path, point(row.operating_point), _span(row.band_hz, 3), f"{100.0 * row.size:.1f}", f"{row.gain_db:+.2f}"]
        for row in rows[:FIRST]
    ]
    if cells:
        title = f"{table.real} (real) against {table.sim} (sim): the largest {len(cells)} of {len(rows)} differences"
        output.table(title, ["path", "operating point", "band [Hz]", "size [%]", "gain [dB]"], cells)


def _tables(table: GapTable, output: Output) -> None:
    cells = [gap_cells(table, row) for row in table.rows]
    output.table(f"{table.real} (real) against {table.sim} (sim)", COLUMNS, cells)
    if table.nu_gaps:
        output.table("nu-gap of the loop-shaped plants", NU_COLUMNS, [nu_cells(row) for row in table.nu_gaps])
    times = [row for row in table.times if row.loud]
    if times:
        output.table("same inputs, in time", TIME_COLUMNS, [time_cells(row) for row in times])


def payload(table: GapTable) -> dict[str, Any]:
    """The table as one JSON object, each row with whether it stands out of the noise."""
    from dataclasses import asdict

    rows = [asdict(row) | {"significant": table.significant(row)} for row in table.rows]
    times = [asdict(row) | {"ratio": row.ratio} for row in table.times]
    return {"format": FORMAT, **asdict(table), "rows": rows, "times": times, "conclusion": table.conclusion}


def _draw(table: GapTable, report: Path | None) -> Path | None:
    """The picture in the report's file; None where there is nothing to draw or nowhere to."""
    if report is None or not table.rows:
        return None
    from loopshape.toolbox.gap.pictures.table import gap_map
    from loopshape.verbs.pictures import save
    from loopshape.view.style import figure_of

    return save(figure_of(gap_map(table)), report)


def gap_cells(table: GapTable, row: GapRow) -> Sequence[Any]:
    """One FRF row as cells; `*` marks what stands out of the noise."""
    from loopshape.core.units import SUFFIXES

    return (
        row.path,
        point(row.operating_point, row.parameters),
        f"{row.amplitude:.2g} {SUFFIXES.get(row.amplitude_unit, row.amplitude_unit)} in {row.loop}",
        _span(row.band_hz, 3),
        f"{100.0 * row.size:.1f} (noise {100.0 * row.noise:.1f})",
        f"{row.z2:.2f}",
        f"{row.p_value:.1g}",
        f"{row.gain_db:+.2f}",
        f"{row.phase_deg:+.1f}",
        _levels(row.distortion_real),
        _levels(row.distortion_sim),
        "*" if table.significant(row) else "",
    )


def _levels(levels: Any) -> str:
    """Odd and even distortion, `-` where the excitation shows none."""
    if levels is None:
        return "-"
    return "/".join("-" if x is None else f"{x:.0f}" for x in (levels.odd_db, levels.even_db))


def _span(pair: tuple[float, float], figures: int) -> str:
    return f"{pair[0]:.{figures}g} to {pair[1]:.{figures}g}"


def nu_cells(row: NuGapRow) -> Sequence[Any]:
    """One nu-gap as cells; where it is undecided the reason stands in its place."""
    return (
        row.loop,
        row.recording,
        point(row.operating_point),
        "undecided" if row.value is None else f"{row.value:.3f}",
        _span(row.interval, 2),
        f"{row.at_hz:.3g}",
        "-" if row.scale is None else f"{row.scale:.3f} ({point(_given(row.scale_to))})",
        "" if row.winding == "holds" else row.reason,
    )


def _given(values: Mapping[str, float] | None) -> Mapping[str, float]:
    return values or {}


def time_cells(row: TimeRow) -> Sequence[Any]:
    """One stretch of a signal as cells."""
    from loopshape.core.units import SUFFIXES

    return (
        row.recording,
        row.signal,
        "rms" if row.kind == "window" else "mean at rest",
        f"{row.from_s:.3g}",
        f"{row.to_s:.3g}",
        f"{row.difference:+.3g}",
        SUFFIXES[row.unit],
        f"{row.floor:.2g}",
        "*" if row.loud else "",
    )


def check_files(save_answer: Path | None, report: Path | None, study: Path | None = None) -> None:
    """Refuse, before anything is computed, a picture of another kind than PNG and a folder in a file's place."""
    from loopshape.core.errors import WrongUseError

    if report is not None and report.suffix.lower() != ".png":
        raise WrongUseError("a report is a picture as PNG", str(report), "name a file that ends in .png")
    for path in (save_answer, report, study):
        if path is not None and path.is_dir():
            raise WrongUseError("a folder stands where a file is to be written", str(path), "name a file")
