"""The page: sections in their order around style and script, all in one text that loads nothing."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Sequence
from typing import Any

from loopshape.core.toolboxes import found, function_at
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS
from loopshape.data.response.frf import FRF
from loopshape.data.result.verdict import Verdict
from loopshape.loop.verdict import LoopCheck
from loopshape.toolbox.pages.markup import Content, Markup, head, joined, json_block, tag
from loopshape.toolbox.pages.report import model_parts, run_parts, verdict_parts
from loopshape.toolbox.pages.report.plots import BANDS_AT_ONCE, loop_data, picture, plots
from loopshape.toolbox.pages.report.run_report import RunReport, StoredFigure
from loopshape.toolbox.pages.report.traces import Trace, loop_traces, plant_traces
from loopshape.toolbox.pages.report.words import DASH, WORDS, Cell, count, definitions, details, figure, table
from loopshape.toolbox.pages.shape.payload import limit_words, resource

_READ = (
    "Point at a curve, or tap it: all plots of the loop mark the same frequency, and its values stand below. With the"
    " keyboard: left and right go from frequency to frequency, up and down from one operating point to the next, + and"
    " - zoom, 0 shows all; with the mouse drag to move, turn the wheel with Ctrl to zoom. The legend hides and shows"
    " operating points."
)
#: beginning of a picture's file name -> what it shows
_PICTURES = {
    "nichols": "Nichols plot of the open loop at all operating points",
    "loop": "Plant, controller and open loop with |S| and |T|",
    "sensitivities": "|S|, |T|, |CS| and |PS| with their limits",
    "margins": "Map of the margins over the operating points",
    "frf": "Frequency response with its uncertainty",
    "fit": "Fitted parameter over the operating points",
    "matrix": "Matrix of frequency responses",
    "interaction": "Interaction of the loops",
    "gap": "Gap between recordings and simulation",
    "step": "Step response",
    "atlas": "Sensitivity over the operating points",
}


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


def _data(plotted: Sequence[tuple[LoopCheck | None, list[Trace]]]) -> dict[str, Any]:
    """What the script draws."""
    loops = [loop_data(*one) for one in plotted]
    return {"limits": [*map(limit_words, LIMITS)], "bands_at_once": BANDS_AT_ONCE, "loops": loops}


def _head(report: RunReport) -> Markup:
    """The report's title and style, and a policy under which it shows its own pictures."""
    title = f"{WORDS[report.outcome]} · {report.name} · loopshape report"
    return head(title, resource("report.css"), resource("report.js"), "img-src data:")


def _header(report: RunReport) -> Markup:
    counts = [
        (len(report.recordings), "recording"),
        (len(report.frfs), "frequency response"),
        (len(_single(report)), "checked loop"),
    ]
    text = ", ".join(f"{n} {what}{'' if n == 1 else 's'}" for n, what in counts if n)
    plant = report.run.plant if report.run is not None else ""
    facts = [("Machine", plant or report.name), ("Date", report.date), ("Author", report.author or DASH)]
    named = tag("p", joined(joined([tag("strong", what), " ", word, "   "]) for what, word in facts), class_="facts")
    return tag("header", tag("h1", f"Run {report.name}"), named, tag("p", text or "no data", class_="quiet"))


Section = tuple[str, str, Content]


def _sections(report: RunReport, plotted: Sequence[tuple[LoopCheck | None, list[Trace]]]) -> list[Section]:
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
        ("pictures", "Pictures", r.figures or r.figures_left_out, lambda: pictures(r)),
        ("controllers", "Controllers", r.controllers, lambda: joined(map(model_parts.controller, r.controllers))),
        ("fits", "Fits", r.fits, lambda: model_parts.fits(r.fits)),
        ("responses", "Frequency responses", r.frfs or r.matrices, lambda: run_parts.responses(r.frfs, r.matrices)),
        ("recordings", "Recordings and faults", r.recordings, lambda: run_parts.recordings(r.recordings, r.notes)),
        ("provenance", "Provenance", True, lambda: provenance(r)),
    ]
    return [(key, title, inside()) for key, title, there, inside in every if there]


def _of_toolboxes(report: RunReport) -> list[tuple[str, Markup | None]]:
    """Sections that toolboxes add, by their titles."""
    return [(title, function_at(place)(report)) for title, place in found().all("parts").items()]


def _each(checked: Sequence[LoopCheck], part: Callable[[LoopCheck], Markup]) -> Markup:
    """A part of each loop, under the loop's name where there are several."""
    several = len(checked) > 1
    return joined(joined([tag("h3", f"Loop {one.verdict.loop}") if several else None, part(one)]) for one in checked)


def _section(key: str, title: str, inside: Content) -> Markup:
    return tag("section", tag("h2", title), inside, id=key)


def _plotted(report: RunReport) -> list[tuple[LoopCheck | None, list[Trace]]]:
    """Curves of each checked loop, then of the plants of all other loops."""
    found: list[tuple[LoopCheck | None, list[Trace]]] = [
        (one, loop_traces(one.loops, one.frfs)) for one in _single(report)
    ]
    done = {one.verdict.loop for one in report.checked}
    return found + [(None, plant_traces(mine)) for mine in _unchecked(report, done)]


def _single(report: RunReport) -> list[LoopCheck]:
    """The checks of one loop."""
    return [one for one in report.checked if not one.each]


def _unchecked(report: RunReport, done: set[str]) -> list[list[FRF]]:
    single = [one for one in report.frfs if one.response.shape[1:] == (1, 1) and one.loop not in done]
    return [[one for one in single if one.loop == loop] for loop in dict.fromkeys(one.loop for one in single)]


def _plots(report: RunReport, plotted: Sequence[tuple[LoopCheck | None, list[Trace]]]) -> Markup:
    """Legend and plots of each loop."""
    plants = [one.frfs[0] for one in _single(report)]
    plants += [mine[0] for mine in _unchecked(report, {one.verdict.loop for one in report.checked})]
    parts: list[Content] = [tag("p", _READ, class_="scripted quiet")]
    for (one, traces), plant in zip(plotted, plants, strict=True):
        title = f"Loop {plant.loop}" if one is not None else f"Plant of loop {plant.loop}, without a controller"
        first = one is not None and one is verdict_parts.first(report)
        inside = [_legend(traces, None if one is None else one.verdict), plots(plant, one, len(traces), first)]
        below = tag("p", _thinned(traces, one is not None), class_="quiet")
        parts.append(tag("div", tag("h3", title), *inside, below, class_="plots"))
    for one in report.checked:
        if one.each and one is not verdict_parts.first(report):
            parts.append(tag("div", tag("h3", f"Loops {one.verdict.loop} at once"), picture(one), class_="plots"))
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


def alt_text(name: str) -> str:
    """What a picture shows, from its file's name: `nichols_axis.png`."""
    stem = name.rsplit(".", 1)[0]
    kind, _, rest = stem.partition("_")
    return f"{_PICTURES.get(kind, f'Picture {stem}')}{f': {rest}' if rest and kind in _PICTURES else ''}"


def pictures(report: RunReport) -> Markup:
    """The pictures found in the run, those of single recordings folded away, and what was left out."""
    single = {f"frf_{one.loop}_{one.recording}" for one in report.frfs}
    shown = [one for one in report.figures if one.name.rsplit(".", 1)[0] not in single]
    pages = [one for one in report.figures if one.name.rsplit(".", 1)[0] in single]
    words = (
        "These lay in the run's folder figures as earlier commands left them, and may be older than the data. The plots"
        " and tables above are made from the data listed under provenance."
    )
    parts: list[Content] = [tag("p", words, class_="quiet"), tag("div", *map(_picture, shown), class_="pictures")]
    if pages:
        inside = tag("div", *map(_picture, pages), class_="pictures")
        parts.append(details(f"Pages of single recordings ({len(pages)})", inside, print_=len(pages) <= 4))
    if report.figures_left_out:
        left = [tag("li", f"{name}: {why}") for name, why in report.figures_left_out.items()]
        parts += [tag("p", "Left out:"), tag("ul", *left)]
    return joined(parts)


def _picture(one: StoredFigure) -> Markup:
    kind = {"png": "image/png", "svg": "image/svg+xml"}[one.kind]
    source = f"data:{kind};base64,{b64encode(one.data).decode('ascii')}"
    words = alt_text(one.name)
    image = tag("img", src=Markup(source), alt=words)
    return tag("figure", image, tag("figcaption", f"{words} ({one.name})"))


def provenance(report: RunReport) -> Markup:
    """Who computed when from what: versions, date, every input with its SHA-256, and the files of words verbatim."""
    facts: list[tuple[Content, Content]] = [("Made", report.date), ("Run", report.name)]
    if report.run is not None and report.run.plant:
        facts.append(("Plant", report.run.plant))
    facts += [(name, version) for name, version in report.versions.items()]
    rows: list[list[Cell | Content]] = [
        [
            one.name,
            figure(float(one.size_bytes), f"{one.size_bytes:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")),
            tag("code", one.sha256),
        ]
        for one in report.files
    ]
    parts: list[Content] = [definitions(facts)]
    inputs = table(f"Inputs ({count(len(rows), 'file')})", ["file", "bytes", "SHA-256"], rows)
    parts.append(
        details(
            f"Inputs and their SHA-256 ({count(len(rows), 'file')})", inputs, open_=(few := len(rows) <= 20), print_=few
        )
    )
    for one in report.texts:
        shown = tag("pre", tag("code", one.text), tabindex="0", aria_label=f"{one.what} {one.name}")
        parts.append(
            details(f"{one.what}: {one.name}, verbatim", shown, open_=(given := one.what != "run"), print_=given)
        )
    return joined(parts)
