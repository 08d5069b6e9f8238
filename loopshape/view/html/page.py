"""The page: sections in their order around style and script, all in one text that loads nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import Any

from loopshape.core.toolboxes import found, function_at
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS
from loopshape.data.response.frf import FRF
from loopshape.data.result.run_report import CheckedLoop, RunReport
from loopshape.data.result.verdict import Verdict
from loopshape.view.html import model_parts, run_parts, source_parts, verdict_parts
from loopshape.view.html.markup import Content, Markup, head, joined, json_block, tag
from loopshape.view.html.plots import BANDS_AT_ONCE, loop_data, plots
from loopshape.view.html.traces import Trace, loop_traces, plant_traces
from loopshape.view.html.words import WORDS
from loopshape.view.page.page import resource
from loopshape.view.page.payload import limit_words

_READ = (
    "Point at a curve, or tap it: all plots of the loop mark the same frequency, and its values stand below. With the"
    " keyboard: left and right go from frequency to frequency, up and down from one operating point to the next, + and"
    " - zoom, 0 shows all; with the mouse drag to move, turn the wheel with Ctrl to zoom. The legend hides and shows"
    " operating points."
)


def page(report: RunReport) -> str:
    """The whole report as HTML; the same report gives the same text. The date is the report's own."""
    plotted = _plotted(report)
    sections = _sections(report, plotted)
    links = [tag("li", tag("a", title, href=f"#{key}")) for key, title, _ in sections]
    body = [
        _header(report),
        tag("nav", tag("ul", *links), aria_label="Sections"),
        tag("main", *(_section(*one) for one in sections)),
        tag("footer", tag("p", f"Made by loopshape {report.versions.get('loopshape', '')}, {report.date}.")),
        json_block("report-data", _data(plotted)),
        tag("script", Markup(resource("report.js"))),
    ]
    html = tag("html", _head(report), tag("body", *body), lang="en")
    return f"<!DOCTYPE html>\n{html}\n"


def _data(plotted: Sequence[tuple[CheckedLoop | None, list[Trace]]]) -> dict[str, Any]:
    """What the script draws."""
    loops = [loop_data(*one) for one in plotted]
    return {"limits": [*map(limit_words, LIMITS)], "bands_at_once": BANDS_AT_ONCE, "loops": loops}


def _head(report: RunReport) -> Markup:
    """The report's title and style, and a policy under which it shows its own pictures."""
    title = f"{WORDS[report.outcome]} · {report.name} · loopshape report"
    style = files("loopshape.view.html").joinpath("report.css").read_text(encoding="utf-8")
    return head(title, style, resource("report.js"), "img-src data:")


def _header(report: RunReport) -> Markup:
    counts = [
        (len(report.recordings), "recording"),
        (len(report.frfs), "frequency response"),
        (len(report.checked), "checked loop"),
    ]
    text = ", ".join(f"{n} {what}{'' if n == 1 else 's'}" for n, what in counts if n)
    return tag(
        "header", tag("h1", f"Run {report.name}"), tag("p", f"{text or 'no data'} · {report.date}", class_="quiet")
    )


Section = tuple[str, str, Content]


def _sections(report: RunReport, plotted: Sequence[tuple[CheckedLoop | None, list[Trace]]]) -> list[Section]:
    """Sections that have something to say: identity, title, inside."""
    r, checked = report, report.checked
    every: list[tuple[str, str, object, Callable[[], Content]]] = [
        ("verdict", "Verdict", True, lambda: verdict_parts.verdict(r)),
        *((title.lower().replace(" ", "-"), title, part, lambda part=part: part) for title, part in _of_toolboxes(r)),
        ("missing", "What is missing", r.missing, lambda: run_parts.missing(r.missing)),
        ("requirements", "Requirements", checked, lambda: _each(checked, verdict_parts.requirements)),
        ("margins", "Margins at every operating point", checked, lambda: _each(checked, verdict_parts.margins)),
        ("stability", "Stability certificate", checked, lambda: _each(checked, verdict_parts.certificate)),
        ("plots", "Plots", plotted, lambda: _plots(r, plotted)),
        ("pictures", "Pictures", r.figures or r.figures_left_out, lambda: source_parts.pictures(r)),
        ("controllers", "Controllers", r.controllers, lambda: joined(map(model_parts.controller, r.controllers))),
        ("fits", "Fits", r.fits, lambda: model_parts.fits(r.fits)),
        ("responses", "Frequency responses", r.frfs or r.matrices, lambda: run_parts.responses(r.frfs, r.matrices)),
        ("recordings", "Recordings and faults", r.recordings, lambda: run_parts.recordings(r.recordings, r.notes)),
        ("provenance", "Provenance", True, lambda: source_parts.provenance(r)),
    ]
    return [(key, title, inside()) for key, title, there, inside in every if there]


def _of_toolboxes(report: RunReport) -> list[tuple[str, Markup | None]]:
    """Sections that toolboxes add, by their titles."""
    return [(title, function_at(place)(report)) for title, place in found().all("parts").items()]


def _each(checked: Sequence[CheckedLoop], part: Callable[[CheckedLoop], Markup]) -> Markup:
    """A part of each loop, under the loop's name where there are several."""
    several = len(checked) > 1
    return joined(joined([tag("h3", f"Loop {one.verdict.loop}") if several else None, part(one)]) for one in checked)


def _section(key: str, title: str, inside: Content) -> Markup:
    return tag("section", tag("h2", title), inside, id=key)


def _plotted(report: RunReport) -> list[tuple[CheckedLoop | None, list[Trace]]]:
    """Curves of each checked loop, then of the plants of all other loops."""
    found: list[tuple[CheckedLoop | None, list[Trace]]] = [
        (one, loop_traces(one.loops, one.frfs)) for one in report.checked
    ]
    done = {one.verdict.loop for one in report.checked}
    return found + [(None, plant_traces(mine)) for mine in _unchecked(report, done)]


def _unchecked(report: RunReport, done: set[str]) -> list[list[FRF]]:
    single = [one for one in report.frfs if one.response.shape[1:] == (1, 1) and one.loop not in done]
    return [[one for one in single if one.loop == loop] for loop in dict.fromkeys(one.loop for one in single)]


def _plots(report: RunReport, plotted: Sequence[tuple[CheckedLoop | None, list[Trace]]]) -> Markup:
    """Legend and plots of each loop."""
    plants = [one.frfs[0] for one in report.checked]
    plants += [mine[0] for mine in _unchecked(report, {one.verdict.loop for one in report.checked})]
    parts: list[Content] = [tag("p", _READ, class_="scripted quiet")]
    for (one, traces), plant in zip(plotted, plants, strict=True):
        title = f"Loop {plant.loop}" if one is not None else f"Plant of loop {plant.loop}, without a controller"
        inside = [_legend(traces, None if one is None else one.verdict), plots(plant, one, len(traces))]
        below = tag("p", _thinned(traces, one is not None), class_="quiet")
        parts.append(tag("div", tag("h3", title), *inside, below, class_="plots"))
    return joined(parts)


def _legend(traces: Sequence[Trace], verdict: Verdict | None) -> Markup:
    """Operating points with their look, and of which requirements each is the worst."""
    worst: dict[str, list[str]] = {}
    for line in verdict.lines if verdict is not None and len(traces) > 1 else ():
        worst.setdefault(line.recording, []).append(LIMIT_OF[line.quantity].short)
    items = []
    for trace in traces:
        swatch = tag(
            "svg",
            tag("path", d="M1 6H33", stroke_dasharray=trace.dash or None),
            viewBox="0 0 34 12",
            class_="swatch",
            style=f"--look: {trace.colour}",
            aria_hidden="true",
        )
        flag = tag("span", f"worst {', '.join(worst[trace.name])}", class_="flag") if trace.name in worst else None
        name = tag("span", trace.name, class_="quiet" if trace.label else None)
        items.append(tag("li", swatch, tag("span", joined([trace.label, " ", name]), " ", flag)))
    return tag("ul", *items, class_="legend")


def _thinned(traces: Sequence[Trace], checked: bool) -> str:
    """What was drawn of what was measured, in words."""
    drawn, measured = sum(trace.frequency_hz.size for trace in traces), sum(trace.lines for trace in traces)
    text = (
        f"All {measured} frequencies are drawn."
        if drawn == measured
        else f"{drawn} of {measured} frequencies are drawn: every curve's extremes in each stretch of frequency, none"
        " averaged or moved; tables use all frequencies."
    )
    bands = "Bands are" if len(traces) <= BANDS_AT_ONCE else "The band that shows with a marked curve is"
    curves = (
        "Curves are what the check uses: its frequencies, smoothed over their neighbours; dots are P as measured. Rings"
        " mark where requirements are worst."
        if checked
        else "Faint dots lie outside the valid band."
    )
    return (
        f"{text} {curves} {bands} the 95 % band of each frequency by itself, to first order, for S and T by the error"
        " of P; the tables' intervals are those of the check."
    )
