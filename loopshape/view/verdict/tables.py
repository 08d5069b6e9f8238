"""Verdicts and their comparisons as tables of text: each a title, its columns and rows of cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from loopshape.data.result.verdict_words import (
    PRINTED,
    Notation,
    crossings_text,
    known_limits,
    unstable_text,
    verdict_rows,
)

if TYPE_CHECKING:
    from loopshape.data.control.controller import Controller
    from loopshape.data.control.scheduled import Scheduled
    from loopshape.data.requirement.profile import Profile
    from loopshape.data.result.detuning import Reach
    from loopshape.data.result.margins import Margins
    from loopshape.data.result.verdict import Verdict

Table = tuple[str, Sequence[str], list[list[Any]]]


def verdict_tables(verdict: Verdict, *, margins: bool = True) -> Iterator[Table]:
    """Requirement lines, and the margins of each operating point."""
    rows: list[list[Any]] = [
        [x.quantity, x.unit, x.required, x.worst, x.interval, x.slack, x.recording, x.at_hz, x.verdict]
        for x in verdict_rows(verdict)
    ]
    columns = ["requirement", "unit", "required", "worst case", "95 % interval", "slack", "at", "at [Hz]", "verdict"]
    yield f"Loop {verdict.loop}: {verdict.outcome.word}", columns, rows
    if margins:
        yield margins_table(verdict)
        if any(line.quantity == "detuning_percent" for line in verdict.lines):
            yield f"Detuning margins of loop {verdict.loop}", DETUNING, detuning_rows(verdict)


def notices(verdict: Verdict) -> list[str]:
    """The warnings, and a sentence for each operating point whose loop is not known to be stable."""
    return [*verdict.warnings, *(unstable_text(verdict, name) for name in verdict.unstable)]


def zone_sentence(verdict: Verdict, profile: Profile) -> str:
    """The likeliest zone of a loop with its probability, and what it means; "" where there is none."""
    from loopshape.data.requirement.profile import zone_shares  # numpy with it: `--help` does without

    shares = zone_shares(verdict, profile)
    if not shares:
        return ""
    best = max(profile.zones, key=lambda zone: shares[zone.name])
    worst = max(m.sensitivity_peak_db for m in verdict.margins.values())
    rest = ", ".join(f"{name} {100.0 * p:.1f} %" for name, p in shares.items() if p >= 5e-4)
    return f"Loop {verdict.loop}: zone {best.name}, peak |S| {worst:.1f} dB ({rest}): {best.means}."


#: what is shown of a single loop in 80 columns
_FIRST = {"bandwidth_hz": "bandwidth", "gain_margin_db": "GM", "phase_margin_deg": "PM", "sensitivity_peak_db": "|S|"}


def margins_table(verdict: Verdict, *, details: bool = True) -> Table:
    """The margins of each operating point; without `details` those of a single loop in 80 columns."""
    from loopshape.data.requirement.requirements import LIMIT_OF  # numpy with it: `--help` does without

    limits = known_limits(verdict, list(LIMIT_OF.values())) if details else [LIMIT_OF[x] for x in _FIRST]
    rows: list[list[Any]] = [
        [name, m.stable, *(PRINTED.reading(m, x)[0] for x in limits)] for name, m in verdict.margins.items()
    ]
    columns = ["recording", "closed loop", *(f"{x.short if details else _FIRST[x.name]} [{x.unit}]" for x in limits)]
    if not details:
        return f"Margins of loop {verdict.loop}", columns, rows
    for row, m in zip(rows, verdict.margins.values(), strict=True):
        row.append(lost_text(m))
    title = "All loops at once" if verdict.together else f"Margins of loop {verdict.loop}"
    return title, [*columns, lost_title(verdict)], rows


def lost_title(verdict: Verdict) -> str:
    """The head of `lost_text`."""
    return "lost by" if verdict.together else "0 dB crossings [Hz]"


def lost_text(margins: Margins) -> str:
    """By what change of each loop's gain and phase several loops are lost; of one loop where |L| crosses 0 dB."""
    lost = [f"{name} {x['gain_db']:+.2g} dB {x['phase_deg']:+.2g} deg" for name, x in margins.changes.items()]
    return ", ".join(lost) if margins.loops else crossings_text(margins)


def phase_budget_tables(verdict: Verdict, controller: Controller | Scheduled) -> Iterator[Table]:
    """What each block costs in degrees where the phase margin is least; nothing where no |L| crosses 0 dB."""
    seen = {name: m for name, m in verdict.margins.items() if m["phase_margin_deg"].at_hz is not None}
    if not seen or controller.loop != verdict.loop or not hasattr(controller, "phase_budget"):
        return
    worst = min(seen, key=lambda name: seen[name].phase_margin_deg)
    at_hz = seen[worst]["phase_margin_deg"].at_hz or 0.0
    rows: list[list[Any]] = [[k, *part] for k, part in enumerate(controller.phase_budget(at_hz), start=1)]
    title = f"Phase budget of loop {verdict.loop} at {at_hz:.4g} Hz, where the phase margin of {worst} is read"
    yield title, ["", "block", "phase [deg]", "magnitude [dB]"], rows


DETUNING = ["recording", "what moves", "up (what breaks)", "95 % interval", "down (what breaks)", "95 % interval"]


def detuning_rows(
    verdict: Verdict, notation: Notation = PRINTED, named: Callable[[str], str] = lambda name: name
) -> list[list[Any]]:
    """How far the plant's frequencies may move at each operating point, as a whole and one resonance alone."""
    rows = []
    for name, m in verdict.margins.items():
        if m.detuning is None:
            continue
        single = [(f"{x.frequency_hz:.4g} Hz, damping {x.damping:.2g}", x.up, x.down) for x in m.detuning.resonances]
        for what, *reaches in (("all frequencies", m.detuning.up, m.detuning.down), *single):
            ends = [(_reach(x, named(x.breaks)), notation.interval(x.interval_percent)) for x in reaches]
            rows.append([name, what, *ends[0], *ends[1]])
    return rows


def _reach(reach: Reach, breaks: str) -> str:
    """How far frequencies may move one way, and what breaks there: "1.2 % (phase_margin_deg)", "> 20 %"."""
    return f"> {reach.percent:.4g} %" if reach.beyond else f"{reach.percent:.3g} % ({breaks})"
