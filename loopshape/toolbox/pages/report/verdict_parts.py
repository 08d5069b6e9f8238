"""The report's upper half: verdict, requirements, margins with their intervals, stability certificate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from loopshape.core.outcomes import ClosedLoop, Outcome
from loopshape.data.requirement.requirements import LIMIT_OF, LIMITS, TOGETHER, Limit
from loopshape.data.result.detuning import WARNED_PERCENT
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import RequirementResult, Verdict
from loopshape.data.result.verdict_words import Row, band_text, known_limits, row_of
from loopshape.loop.loop import Loop
from loopshape.loop.verdict import LoopCheck
from loopshape.toolbox.pages.markup import Content, Markup, joined, tag
from loopshape.toolbox.pages.report.plots import picture
from loopshape.toolbox.pages.report.run_report import RunReport, asked_outcome
from loopshape.toolbox.pages.report.words import (
    DASH,
    TYPESET,
    WORDS,
    Cell,
    badge,
    count,
    figure,
    named,
    number,
    point,
    sign,
    table,
    together,
)
from loopshape.view.verdict.tables import DETUNING, detuning_rows, lost_text, lost_title

GAUGE_WIDTH, GAUGE_HEIGHT = 170, 26


def verdict(report: RunReport) -> Markup:
    """The word for the whole run, and a card for each loop."""
    heads = {
        Outcome.PASSED: "Every requirement holds on the measured data.",
        Outcome.FAILED: "At least one requirement is missed, or a loop is unstable.",
        Outcome.UNDECIDED: "Nothing is surely missed, and these data do not decide all of it.",
        None: "No requirement was checked against these data.",
    }
    cards = [_card(one.verdict.loop, asked_outcome(one.verdict), _sentences(one)) for one in report.checked]
    cards += [
        _card(name, Outcome.UNDECIDED, ["Asked for, and not checked: see what is missing."])
        for name in report.unchecked
    ]
    whole = tag("p", joined([badge(report.outcome), " ", heads[report.outcome]]), class_="whole")
    row = tag("div", *cards, class_="cards-row") if cards else None
    shown = first(report)
    return joined([whole, row, None if shown is None else picture(shown)])


def first(report: RunReport) -> LoopCheck | None:
    """The loop whose plot stands beside the verdict: the worst."""
    worst = [one for one in report.checked if asked_outcome(one.verdict) is report.outcome] or list(report.checked)
    return worst[0] if worst else None


def hanging(found: Verdict) -> Markup | None:
    """What the verdict hangs on: the least shift of the plant's frequencies that breaks it, where it is below 2 %."""
    shifts = {n: m.detuning.worst for n, m in found.margins.items() if m.detuning is not None}
    name = min(shifts, key=lambda n: shifts[n].percent, default="")
    if not name or shifts[name].beyond or shifts[name].percent >= WARNED_PERCENT:
        return None
    detuning, worst = found.margins[name].detuning, shifts[name]
    assert detuning is not None
    what = LIMIT_OF[worst.breaks].label if worst.breaks in LIMIT_OF else worst.breaks
    words = f"Hangs on the plant's frequencies: a shift of {number(worst.percent, 2)} % breaks {what}"
    lost = detuning.lost
    if lost is not None and np.isfinite(lost.left):
        label = LIMIT_OF[lost.quantity].label if lost.quantity in LIMIT_OF else lost.quantity
        words += f"; at {number(lost.shift_percent)} % {label} is {number(lost.left)} {lost.unit}"
        words += f", required {number(lost.required)}"
        words += "" if lost.resonance_hz is None else f", by the resonance at {number(lost.resonance_hz)} Hz"
    return tag("p", tag("strong", f"{words} ({name})."), class_="hangs")


def _card(loop: str, outcome: Outcome | None, sentences: Iterable[Content]) -> Markup:
    head = tag("h3", joined([sign(outcome), f" Loop {loop}: {WORDS[outcome]}"]))
    return tag(
        "div",
        head,
        joined(s if isinstance(s, Markup) else tag("p", s) for s in sentences),
        class_=f"card {outcome or 'none'}",
    )


def _sentences(one: LoopCheck) -> list[Content]:
    """What a loop's verdict comes from: first what fails, then what is open, else what holds."""
    found, points = one.verdict, count(len(one.loops), "operating point")
    them = "closed loop" if not found.together else "closed loop of all at once"
    said: list[Content] = [] if (hangs := hanging(found)) is None else [hangs]
    for word in (ClosedLoop.UNSTABLE, ClosedLoop.UNDECIDED):
        names = [name for name, m in found.margins.items() if m.stable is word]
        if names:
            verb = "is unstable" if word is ClosedLoop.UNSTABLE else "is neither proven stable nor unstable"
            said.append(f"The {them} {verb} at {_few(names)}.")
    for outcome, head in ((Outcome.FAILED, "Missed"), (Outcome.UNDECIDED, "Not decided by these data")):
        lines = [line for line in found.lines if line.outcome is outcome]
        if lines:
            said += [f"{head}:", tag("ul", *(tag("li", _in_words(line)) for line in lines))]
    if asked_outcome(found) is Outcome.PASSED:
        every = f"All {count(len(found.lines), 'requirement')}" if len(found.lines) > 1 else "The requirement"
        said.append(f"{every} hold{'' if len(found.lines) > 1 else 's'}, and the {them} is stable, at {_all(points)}.")
    if asked_outcome(found) is None:
        said.append(f"The {them} is stable at {_all(points)}; no requirements were given.")
    return said


def _all(points: str) -> str:
    return "the one operating point measured" if points.startswith("1 ") else f"all {points} measured"


def _few(names: Sequence[str], most: int = 6) -> str:
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def _in_words(line: RequirementResult) -> str:
    row = row_of(line, TYPESET)
    reach, more = f" ({row.interval})" if line.span else "", f"; {row.decides}" if row.decides else ""
    at = "" if line.at_hz is None else f", {number(line.at_hz)} Hz"
    worst = f"{row.worst} {row.unit}".rstrip()
    return f"{LIMIT_OF[line.quantity].label}: required {row.asked}, found {worst}{reach} at {line.recording}{at}{more}"


def requirements(one: LoopCheck) -> Markup:
    """Each requirement at its worst operating point: required, found, interval, slack, where, and the word."""
    if not one.verdict.lines:
        return tag("p", "No requirements were given for this loop: its margins below are reported without verdict.")
    columns = [
        "requirement", "verdict", "required", "worst case", "95 % interval", "slack", "required and found",
        "operating point", "frequency [Hz]",
    ]  # fmt: skip
    rows = [_requirement(line, row_of(line, TYPESET)) for line in one.verdict.lines]
    caption = (
        f"Requirements of loop {one.verdict.loop}, each at its worst operating point. Slack is the room from what is"
        " required to the bad end of the interval. In the small scale the tick is what is required, the dot what was"
        " found, the bar its interval; the tinted side is forbidden."
    )
    return table(caption, columns, rows, cards=True)


def _requirement(line: RequirementResult, row: Row) -> list[Cell | Content]:
    limit = LIMIT_OF[line.quantity]
    verdict = joined([badge(row.outcome), tag("span", row.decides, class_="more") if row.decides else None])
    cells = [row.asked, f"{row.worst} {row.unit}".rstrip(), row.interval, f"{row.slack} {row.unit}".rstrip()]
    shown = [Cell(cell, kind="whole-line") for cell in cells]
    return [limit.label, verdict, *shown, Cell(gauge(line, limit), kind="gauge-cell"), row.recording, number(row.at_hz)]


def gauge(line: RequirementResult, limit: Limit) -> Markup:
    """A requirement as a small scale: forbidden side, limit, interval and value; a dash where the value is infinite."""
    low, high = line.span or (line.value, line.value)
    if not np.isfinite([line.value, line.required, low, high]).all():
        return Markup(DASH)
    ends = np.array([line.required, line.value, low, high])
    room = 0.18 * max(float(np.ptp(ends)), 0.15 * max(abs(line.required), 1e-9))
    start, stop = float(ends.min()) - room, float(ends.max()) + room
    at = [
        round(6 + (GAUGE_WIDTH - 12) * (value - start) / (stop - start), 1)
        for value in (line.required, line.value, low, high)
    ]
    middle, tick = GAUGE_HEIGHT // 2, at[0]
    least = limit.sense == "at_least"
    bad = f"M{0 if least else tick} 3H{tick if least else GAUGE_WIDTH}V{GAUGE_HEIGHT - 3}H{0 if least else tick}Z"
    row = row_of(line, TYPESET)
    words = f"required {row.asked}, found {row.worst} {row.unit}".rstrip() + f", {line.outcome.word}"
    return tag(
        "svg",
        tag("title", words),
        tag("path", d=bad, class_="forbidden"),
        tag("path", d=f"M0 {middle}H{GAUGE_WIDTH}", class_="scale"),
        tag("path", d=f"M{tick} 2V{GAUGE_HEIGHT - 2}", class_="limit"),
        tag("path", d=f"M{at[2]} {middle}H{at[3]}", class_=f"interval95 {line.outcome}") if line.span else None,
        tag("circle", cx=at[1], cy=middle, r=4.5, class_=f"found {line.outcome}"),
        viewBox=f"0 0 {GAUGE_WIDTH} {GAUGE_HEIGHT}",
        class_="gauge",
        role="img",
    )


def margins(one: LoopCheck) -> Markup:
    """Margins, and peaks with bandwidths, of every operating point; each column's worst is marked."""
    points = {f.recording or f"frf {k + 1}": point(f.operating_point, f.parameters) for k, f in enumerate(one.frfs)}
    return joined([margins_of(one.verdict, points), _detunings(one.verdict)])


def margins_of(found: Verdict, points: Mapping[str, str]) -> Markup:
    """Both tables of a loop; `points` are words for its recordings."""
    parts = [("Margins", True), ("Peaks and bandwidths", False)]
    among = TOGETHER if found.together else LIMITS
    return joined(_margins_table(found, points, what, [x for x in among if x.margin == own]) for what, own in parts)


def _detunings(found: Verdict) -> Markup | None:
    """How far frequencies of the plant may move, as a whole and of single resonances; none where nobody looked."""
    rows = detuning_rows(found, TYPESET, lambda name: LIMIT_OF[name].short if name in LIMIT_OF else name)
    caption = (
        f"Detuning margins of loop {found.loop}: the largest relative shift of the plant's frequencies, up and down, at"
        " which every requirement holds and the loop is stable, and what breaks there."
    )
    return table(caption, DETUNING, rows, sortable=len(rows) > 1) if rows else None


def _margins_table(found: Verdict, points: Mapping[str, str], what: str, among: Sequence[Limit]) -> Markup:
    limits, asked = known_limits(found, among), {line.quantity: line for line in found.lines}
    worst = {limit.name: _worst(found, limit, asked.get(limit.name)) for limit in limits}
    crossed = what == "Margins"
    columns = ["recording", "closed loop", *map(_column, limits)] + ([lost_title(found)] if crossed else [])
    rows = []
    for name, m in found.margins.items():
        row: list[Cell | Content] = [named(name, points.get(name, "")), badge(m.stable.outcome, m.stable)]
        row += [_margin(m, limit, worst[limit.name] == name, asked.get(limit.name)) for limit in limits]
        rows.append([*row, lost_text(m)] if crossed else row)
    left_out = [limit for limit in among if limit not in limits]
    endless = [x.label for x in left_out if all(m[x.name].value == np.inf for m in found.margins.values())]
    return table(_caption(what, found, endless), columns, rows, sortable=len(rows) > 1)


def _caption(what: str, found: Verdict, endless: Sequence[str]) -> str:
    some = any(m.intervals for m in found.margins.values())
    told = "below each value its 95 % interval" if some else "the uncertainty of the FRF was not carried to these"
    many = "; each column's worst, by the bad end of its interval where something is required, is marked"
    ends = f" Infinite at every operating point, and left out: {', '.join(endless)}." if endless else ""
    return f"{what} of loop {found.loop}: {told}{many if len(found.margins) > 1 else ''}.{ends}"


def _column(limit: Limit) -> str:
    unit, _ = TYPESET.unit(limit.unit)
    return f"{limit.short} [{unit}]" if unit else limit.short


def _worst(found: Verdict, limit: Limit, named: RequirementResult | None) -> str:
    """The recording that the verdict names, else that of the least or greatest value; none of a single one."""
    if len(found.margins) < 2:
        return ""
    if named is not None:
        return named.recording
    values = {name: limit.sign * m[limit.name].value for name, m in found.margins.items()}
    values = {name: value for name, value in values.items() if not np.isnan(value)}
    return min(values, key=lambda name: values[name], default="") if len(set(values.values())) > 1 else ""


def _margin(m: Margins, limit: Limit, worst: bool, asked: RequirementResult | None) -> Cell:
    shown, ends = TYPESET.reading(m, limit)
    parts: list[Content] = [tag("span", "worst", class_="flag") if worst else None, " ", shown]
    parts += [tag("span", ends, class_="interval95")] if ends else []
    kind = None if not worst else f"worst {asked.outcome if asked is not None else ''}".strip()
    return figure(TYPESET.unit(limit.unit)[1] * m[limit.name].value, joined(parts), kind)


def certificate(one: LoopCheck) -> Markup:
    """Stability of each operating point with its reason; alike ones in one row. And what had to be assumed."""
    groups: dict[tuple[ClosedLoop, str, str], list[str]] = {}
    for name, m in one.verdict.margins.items():
        groups.setdefault(
            (m.stable, m.stability_reason, band_text(*m.stability_band_hz) if m.stability_band_hz else ""), []
        ).append(name)
    rows: list[list[Cell | Content]] = [
        [Cell(badge(stable.outcome, stable)), reason or DASH, measure or DASH, len(names), ", ".join(names)]
        for (stable, reason, measure), names in sorted(groups.items(), key=lambda group: -group[0][0].severity)
    ]
    counted = "encirclements of 0 by det(I + L)" if one.each or one.others_closed else "encirclements of −1"
    caption = f"Closed loop {one.verdict.loop}: {counted}, on the measured FRF, with the contour closed."
    made = table(caption, ["closed loop", "reason", "band to measure", "points", "recordings"], rows, cards=True)
    poles = None if one.others_closed else _poles(one)
    names = sorted(one.verdict.margins, key=len, reverse=True)
    said = [(next((name for name in names if name in note), ""), note) for note in one.verdict.warnings]
    notes, head = together(said, named=False), "Assumed, and to be noted:"
    return joined(
        [
            made,
            tag("p", poles) if poles else None,
            tag("p", head) if notes else None,
            tag("ul", *notes) if notes else None,
        ]
    )


def _poles(one: LoopCheck) -> str:
    """The open-loop poles that the count was made with, and what they rest on."""
    pairs: dict[tuple[int | None, int | None, str], list[str]] = {}
    for loop in one.loops:
        key = (loop.integrators, loop.unstable_poles, _rests_on(one, loop))
        pairs.setdefault(key, []).append(loop.plant.recording)
    parts = []
    for (integrators, unstable, basis), names in pairs.items():
        known = "an unknown number of integrators" if integrators is None else count(integrators, "integrator")
        growing = "an unknown number of unstable poles" if unstable is None else count(unstable, "unstable pole")
        where = f" at {_few(names)}" if len(pairs) > 1 else ""
        parts.append(f"plant with {known} ({basis}) and {growing}{where}")
    own, among = count(one.loops[0].controller_integrators(), "integrator"), "controllers" if one.each else "controller"
    return f"Counted for: {'; '.join(parts)}; {among} with {own}."


def _rests_on(one: LoopCheck, loop: Loop) -> str:
    """What the number of a plant's integrators rests on."""
    if loop.integrators is None:
        return "neither declared nor known from the lowest frequencies"
    if one.required is not None and one.required.integrators is not None:
        return "declared in the requirements"
    if loop.model is not None:
        return "by its fit"
    return f"by phase and slope at its lowest frequencies, from {loop.frequency_hz[0]:.3g} Hz"
