"""The report's plots: a canvas for each, which the page's script draws on, and a picture where no script runs."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

from loopshape.data.requirement.requirements import LIMIT_OF, Requirements
from loopshape.data.response.frf import FRF
from loopshape.data.result.verdict import RequirementResult
from loopshape.loop.verdict import LoopCheck
from loopshape.toolbox.pages.markup import Markup, joined, tag
from loopshape.toolbox.pages.report.traces import Trace, embedded
from loopshape.toolbox.pages.report.words import count, number
from loopshape.toolbox.pages.shape.payload import requirement_words
from loopshape.view.labels import decibel, ratio, units_of
from loopshape.view.plots.nichols import nichols
from loopshape.view.plots.nichols_guides import closest_db
from loopshape.view.style import figure_of, png
from loopshape.view.verdict.together import together_page

#: of more operating points than these the script shows one band at a time
BANDS_AT_ONCE = 4
_TITLES = {
    "P": "Plant P",
    "L": "Open loop L = C P",
    "S": "Sensitivity S",
    "T": "Complementary sensitivity T",
    "CS": "Control sensitivity CS",
    "PS": "Process sensitivity PS",
}


def loop_data(checked: LoopCheck | None, traces: Sequence[Trace]) -> dict[str, Any]:
    """What the script draws of a loop: its curves, what is required, and where each requirement is worst."""
    required = None if checked is None else checked.required
    return {
        "points": embedded(traces),
        "requirements": None if required is None else requirement_words(required),
        "rings": [] if checked is None else _rings(checked.verdict.lines, [trace.name for trace in traces]),
    }


def _rings(lines: Sequence[RequirementResult], names: Sequence[str]) -> list[dict[str, Any]]:
    """The curve of each requirement's worst operating point, at the frequency that the check names."""
    return [
        {"plot": _plot_of(line), "point": names.index(line.recording), "hz": line.at_hz, "outcome": line.outcome}
        for line in lines
        if line.at_hz and line.recording in names and LIMIT_OF[line.quantity].plot
    ]


def _plot_of(line: RequirementResult) -> str:
    name, _, phase = LIMIT_OF[line.quantity].plot.partition(" ")
    return f"{name}-{'deg' if phase else 'db'}"


def plots(plant: FRF, checked: LoopCheck | None, points: int, first: bool = False) -> Markup:
    """The plots of a loop, or of a plant without a controller; the picture of the `first` stands at the verdict."""
    names = ("P",) if checked is None else ("P", "L")
    drawn = [_magnitude(name, plant, points) for name in names]
    drawn += [_figure(f"{name}-deg", f"{_TITLES[name]}: phase", f"phase of {name} [deg]", points) for name in names]
    if checked is not None:
        words = nichols_words(checked.required)
        drawn.append(_figure("L-nichols", "Nichols: open loop L", None, points, words))
        drawn += [_magnitude(name, plant, points) for name in ("S", "T", "CS", "PS")]
    return joined([tag("div", *drawn, class_="plot-grid"), _without_script(checked, first)])


def _magnitude(name: str, plant: FRF, points: int) -> Markup:
    unit_in, unit_out = units_of(plant)
    units = {"P": ratio(unit_out, unit_in), "CS": ratio(unit_in, unit_out), "PS": ratio(unit_out, unit_in)}
    return _figure(f"{name}-db", f"{_TITLES[name]}: magnitude", decibel(f"|{name}|", units.get(name, "")), points)


def _figure(key: str, title: str, label: str | None, points: int, words: str = "") -> Markup:
    """A canvas with its caption; `label` is of its upright axis."""
    heard = f"{title}, {count(points, 'operating point')}; arrow keys move along it"
    canvas = tag("canvas", role="img", tabindex=0, aria_label=heard, data_plot=key, data_label=label)
    note = tag("p", words, class_="quiet") if words else None
    return tag("figure", tag("figcaption", title), canvas, note, class_="plot tall" if words else "plot")


def _without_script(checked: LoopCheck | None, first: bool) -> Markup:
    """What stands in place of the plots where a reader's program runs no script, as previews of mail do."""
    words = "These plots need JavaScript, which is off here. The tables are complete; loopshape figures draws pictures."
    shown = None if checked is None or first else picture(checked)
    return tag("noscript", tag("p", words), shown)


def picture(checked: LoopCheck) -> Markup:
    """The open loop in Nichols' chart, as a picture; of several at once det(I + L) and the disk margins, the worst."""
    found, alt = checked.verdict, f"Nichols plot of the open loop of {checked.verdict.loop} at all operating points"
    if checked.each:
        worst = min(checked.loops, key=lambda x: found.margins[x.plant.recording].disk_margin)
        name = worst.plant.recording
        each = {one.verdict.loop: one.verdict.margins[name] for one in checked.each}
        chart = together_page(worst, found.margins[name], each, checked.together)
        alt = f"Loops {found.loop} at once at {name}: eigenvalues of L, det(I + L), singular values, disk margins"
    else:
        chart = figure_of(nichols(checked.loops, checked.required, verdict=found))
    source = Markup(f"data:image/png;base64,{b64encode(png(chart)).decode('ascii')}")
    return tag("figure", tag("img", src=source, alt=alt), class_="chart")


def nichols_words(required: Requirements | None) -> str:
    """What the lines behind the Nichols curves mean."""
    notes = ["Grey: |S| constant, dashed |T|."]
    if required is not None:
        closest, peak = closest_db(required), required.complementary_peak_db or 0.0
        notes += [] if closest is None else [f"Red, filled: |S| above {number(closest)} dB."]
        notes += [f"Red, dashed: |T| at {number(peak)} dB."] if peak > 0.0 else []
        if required.phase_margin_deg or required.gain_margin_db or required.gain_reduction_margin_db:
            notes.append("Red cross: required margins, phase sideways, gain upwards and downwards.")
    return " ".join([*notes, "A stable loop keeps the black cross on its left as frequency rises."])
