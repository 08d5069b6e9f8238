"""The report's part on a block diagram: its picture, what the tuned block meets, and the loops within."""

from __future__ import annotations

from base64 import b64encode

from loopshape.data.result.equivalent import Diagram
from loopshape.toolbox.pages.markup import Markup, joined, tag
from loopshape.toolbox.pages.report.run_report import RunReport, asked_outcome
from loopshape.toolbox.pages.report.verdict_parts import margins_of
from loopshape.toolbox.pages.report.words import badge
from loopshape.view.style import png


def diagram(report: RunReport) -> Markup | None:
    """The picture of the diagram, then every loop that is closed within, with its margins; None without a diagram."""
    D = report.diagram
    if D is None:
        return None
    words = (
        f"The plant of loop {D.tuned} in this report is what block {D.tuned} meets with everything else closed, found"
        " from the run's frequency responses with their covariance."
    )
    inner = [tag("p", "No loop is closed within.")] if not report.inner else []
    for name, verdict in report.inner.items():
        head = tag("h3", joined([f"Inner loop {name} ", badge(asked_outcome(verdict))]))
        held = tag("p", "Certified stable with the tuned block open.")
        inner.append(joined([head, held, margins_of(verdict, {})]))
    return joined([_picture(D), tag("p", words), *inner])


def _picture(D: Diagram) -> Markup:
    source = Markup(f"data:image/png;base64,{b64encode(png(D.figure())).decode('ascii')}")
    alt = f"Block diagram{f' {D.name}' if D.name else ''}; tuned is block {D.tuned}"
    return tag("div", tag("figure", tag("img", src=source, alt=alt)), class_="pictures")
