"""Scoreboard lines of both joints: what the source says, what was found, and whether both agree."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from loopshape.data.result.verdict import Verdict
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.arm.source import number, value

MEASURED = Path(__file__).parent.parent / "arm2_interaction"  # answers figures 5.8 and H.7
#: numbers that the source gives as "about": agree within the first factor, partly within the second
NEAR, FAR = 1.3, 2.0
#: levels in dB alike; a joint at rest moves less than this share of the other's step
NEAR_DB, FAR_DB, STILL, STIRRED = 5.0, 10.0, 0.05, 0.10
OWN = "under the plant's own controllers: the source's do not hold it"
OWNED = " (own controllers)"
SMALLER = "smaller than the source's: the simulated joints have no dry friction and the sensors no offset"
LEVEL_WHY = {
    "P11": "our joint 1 is stiffer, its mode lies well above the source's notch (experiments/joint1_alone)",
    "P22": "the one-joint plant shows the same excess over the measured one (figure 4.14)",
    "P12": "not traced beyond the levels of P11 and P22",
    "P21": "not traced beyond the levels of P11 and P22",
}
CAPTION = {"5.10": " (its caption: about {figure_5_10.bandwidth})"}
LIMITS = "|S| {required.sensitivity}, phase {required.phase_margin}, gain {required.gain_margin}"
Rows = Sequence[Sequence]


@dataclass(frozen=True, eq=False)
class Found:
    """All results that are scored; tables as they are written."""

    verdicts: Mapping[str, Verdict]
    causes: Rows
    at_once: Rows
    steps: Rows
    moved: Rows
    runs: Mapping[str, Sequence[Recording]]
    linear: Rows
    simulated: Rows


def scores(found: Found) -> list[list]:
    """Rows of `scores.csv`."""
    out = [*levels(), coefficient()]
    for loop, table, page, chart in (("theta1", "5.4", "5.9", "H.8"), ("theta2", "5.5", "5.10", "H.9")):
        out += angle_rows(found, loop, table, page, chart)
    out += [pressure_row(found), together_row(found), *indicator_rows(found), *motion_rows(found)]
    return [*out, *damping_rows(found)]


def by_factor(ours: float, theirs: float) -> str:
    """Agrees, partly or differs by the ratio."""
    ratio = max(ours / theirs, theirs / ours) if ours > 0.0 else float("inf")
    return "agrees" if ratio <= NEAR else "partly" if ratio <= FAR else "differs"


def capped(verdict: str) -> str:
    """Partly at best."""
    return "partly" if verdict == "agrees" else verdict


def read(name: str) -> list[dict[str, str]]:
    """A table of the study that measured the matrix."""
    with (MEASURED / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def levels() -> list[list]:
    """Figure 5.8: levels of the four elements, one loop at a time."""
    mine = [row for row in read("elements.csv") if row["set"] == "angles one at a time"]
    rows = []
    for element in ("P11", "P22", "P12", "P21"):
        db = [float(row["level_db_0.2_to_1_hz"]) for row in mine if row["element"] == element]
        key = f"figure_5_8.{element.lower()}"
        apart = max(abs(x - value(key)) for x in db)
        verdict = "agrees" if apart <= NEAR_DB else "partly" if apart <= FAR_DB else "differs"
        why = f"{LEVEL_WHY[element]}; within {NEAR_DB:g} dB agrees, within {FAR_DB:g} dB partly, at the worst p_C"
        ours = "/".join(f"{x:.0f}" for x in db) + " dB at its three p_C (experiments/arm2_interaction)"
        rows.append(["figure 5.8", f"level of {element}", f"about {{{key}}} re rad/V", ours, verdict, why])
    return rows


def coefficient() -> list:
    """Figure H.7: where the interaction coefficient stays below the source's line."""
    mine = [row for row in read("interaction.csv") if row["set"] == "angles one at a time"]
    to_hz = value("figure_h_7.up_to")
    coupled = sorted({float(row["from_hz"]) for row in mine if row["verdict"] == "coupled"})
    below = bool(coupled) and coupled[0] < to_hz
    return [
        "figure H.7", "interaction coefficient", "below {figure_h_7.interaction} up to {figure_h_7.up_to}",
        f"coupled from the band that begins at {coupled[0]:g} Hz on (95 % bounds, experiments/arm2_interaction)",
        "differs" if below else "agrees",
        "joint 1's mode, damped 0.015 in the model, and joint 2's seen through it",
    ]  # fmt: skip


def angle_rows(found: Found, loop: str, table: str, page: str, chart: str) -> list[list]:
    """The controller of one angle on its own plant."""
    verdict = found.verdicts[f"source's {loop}"]
    every = list(verdict.margins.values())
    stable = sum(m.stable == "stable" for m in every)
    first = [m.bandwidth_hz for m in every]
    key = f"table_{table.replace('.', '_')}.bandwidth"
    causes = "; ".join(
        f"{row[1]}: |S| {row[4]} dB, linear damping {row[5]} at {row[6]} Hz" for row in found.causes if row[0] == loop
    )
    met = (
        f"{stable} of {len(every)} points stable; least phase margin {min(m.phase_margin_deg for m in every):.0f} deg, "
    )
    met += f"largest |S| {max(m.sensitivity_peak_db for m in every):.1f} dB"
    held = "agrees" if verdict.outcome == "passed" else "differs"
    worst = max(first, key=lambda hz: abs(hz - value(key)))
    alike = f"the same loop and causes as table {table}"
    return [
        [f"table {table}", f"{loop}'s controller on our plant", f"all margins met: {LIMITS}", met, held, causes],
        [
            f"figure {page}", "bandwidth", f"about {{{key}}}" + CAPTION.get(page, ""),
            f"{min(first):.2f} to {max(first):.2f} Hz, first 0 dB crossing of a loop that is stable at {stable} of "
            f"{len(every)} p_C",
            by_factor(worst, value(key)) if stable == len(every) else capped(by_factor(worst, value(key))),
            f"no bandwidth where the loop is unstable: partly at best; within a factor {NEAR:g} agrees, {FAR:g} "
            "partly, by the worst p_C",
        ],
        [f"figure {page}", "largest |S|", "below {required.sensitivity}", met, held, alike],
        [f"figure {chart}", "Nichols diagram", "stable, off the circle about -1", met, held, alike],
    ]  # fmt: skip


def pressure_row(found: Found) -> list:
    """Table 5.6: bandwidth of both pressure loops, each with the others closed."""
    verdicts = [found.verdicts[f"source's {loop}"] for loop in ("p_a", "p_c")]
    hz = [[m.crossings_hz[-1] for m in v.margins.values() if m.crossings_hz] for v in verdicts]
    peak = max(m.sensitivity_peak_db for v in verdicts for m in v.margins.values())
    asked = value("table_5_7.p_a.bandwidth")
    each = {by_factor(max(one, key=lambda x: abs(x - asked)), asked) for one in hz}
    return [
        "table 5.6", "bandwidth of p_A and p_C", "about {table_5_7.p_a.bandwidth}, both",
        f"p_A {min(hz[0]):.2f} to {max(hz[0]):.2f} Hz, p_C {min(hz[1]):.2f} to {max(hz[1]):.2f} Hz at {len(hz[1])} "
        f"of 3 points; largest |S| {peak:.1f} dB",
        each.pop() if len(each) == 1 else "partly",
        f"p_A's holds, p_C's not, by a factor {NEAR:g}: theta1 closed halves p_C's plant; the source's controllers on "
        "our arm, other loops closed by the plant's own",
    ]  # fmt: skip


def together_row(found: Found) -> list:
    """All four at once."""
    mine = [row for row in found.at_once if row[0] == "source's, all four"]
    own = [row for row in found.at_once if row[0] == "plant's own, all four"]
    damping, first = min(float(row[7]) for row in mine), min(r.column("t_s")[-1] for r in found.runs["source's"])
    return [
        "table 5.4", "tables 5.4 to 5.6 together", "the arm is stable",
        f"linearised, an oscillation at {mine[0][8]} Hz with damping {damping:.2f}; the simulated arm leaves its "
        f"range in {first:.1f} s",
        "differs" if damping < 0.0 else "agrees",
        f"as for tables 5.4 and 5.5; the plant's own four: disk margin {min(float(row[3]) for row in own):.2f}, stable",
    ]  # fmt: skip


INDICATORS = (
    ("tr", "rise time", 5, "s"),
    ("ts", "settling time", 6, "s"),
    ("overshoot", "overshoot", 8, ""),
    ("ess", "static error", 9, ""),
)


def indicator_rows(found: Found) -> list[list]:
    """Table 5.7, a row a loop and indicator, from the first step of each loop."""
    rows = []
    for loop in ("theta1", "p_c", "theta2", "p_a"):
        step = next(row for row in found.steps if row[1] == loop)
        rows.append(bandwidth_row(found, loop))
        rows += [indicator_row(loop, step, *one) for one in INDICATORS if has(f"table_5_7.{loop}.{one[0]}")]
        if loop == "theta2":
            ours = f"{step[8]} deg of {step[3]} deg{OWNED}"
            verdict = "agrees" if float(step[8]) == 0.0 else "differs"
            why = f"the PWM saturates at this step (figures/arm2_control/damping.png: 3 deg overshoots far less); {OWN}"
            rows.append(["table 5.7", "theta2: overshoot", "none", ours, verdict, why])
    return rows


def has(key: str) -> bool:
    """Whether the source prints this number."""
    name = key.rsplit(".", 1)
    return name[1] != "overshoot" or name[0].endswith("theta1")


def bandwidth_row(found: Found, loop: str) -> list:
    """Bandwidth under the controllers that hold the arm."""
    verdict = found.verdicts.get(f"plant's own {loop}") or found.verdicts[f"source's {loop}"]
    hz = [m.crossings_hz[-1 if loop.startswith("p_") else 0] for m in verdict.margins.values() if m.crossings_hz]
    key = f"table_5_7.{loop}.bandwidth"
    worst = max(hz, key=lambda x: abs(x - value(key)))
    return [
        "table 5.7", f"{loop}: bandwidth", f"{{{key}}}", f"{min(hz):.2f} to {max(hz):.2f} Hz{OWNED}",
        by_factor(worst, value(key)), f"within a factor {NEAR:g} agrees, {FAR:g} partly; {OWN}",
    ]  # fmt: skip


def indicator_row(loop: str, step: Sequence, short: str, name: str, place: int, unit: str) -> list:
    """One indicator of one loop."""
    key = f"table_5_7.{loop}.{short}"
    ours, theirs = abs(float(step[place])), number(key)
    why = SMALLER if short == "ess" and ours < theirs.value else f"within a factor {NEAR:g} agrees, {FAR:g} partly"
    size = f"{ours:g}" if ours else "below 0.001"
    shown = f"{size} {unit or step[4]}" + (f" ({step[7]} s to 5 %)" if short == "ts" else "") + OWNED
    return ["table 5.7", f"{loop}: {name}", f"{{{key}}}", shown, by_factor(ours, theirs.value), f"{why}; {OWN}"]


def motion_rows(found: Found) -> list[list]:
    """Figures 5.11 and 5.12: what the other joint and the other output of the joint do."""
    rows = []
    for page, stepped, other, held in (("5.11", "theta1", "theta2", "p_c"), ("5.12", "theta2", "theta1", "p_a")):
        mine = [row for row in found.moved if row[1] == stepped]
        apart = next(float(row[4]) for row in mine if row[3] == other) / value("step_5_7.angle")
        verdict = "agrees" if apart <= STILL else "partly" if apart <= STIRRED else "differs"
        rows.append([
            f"figure {page}", f"{other} while {stepped} steps", "no sign of coupling",
            f"moves by {100.0 * apart:.0f} % of the step{OWNED}", verdict,
            f"{100.0 * STILL:g} % of the step agrees, {100.0 * STIRRED:g} % partly; joint 1's mode carries it",
        ])  # fmt: skip
        own = next(float(row[4]) for row in found.moved if row[1] == held and row[3] == stepped)
        back = next(float(row[4]) for row in mine if row[3] == held)
        both = own > STILL * value("step_5_7.angle") and back > STILL * value("step_5_7.pressure")
        rows.append([
            f"figure {page}", f"{stepped} and {held} meet", "both outputs of the joint move each other",
            f"{own:.1f} deg by {held}'s step, {back:.2f} bar by {stepped}'s{OWNED}",
            "agrees" if both else "differs", "",
        ])  # fmt: skip
    return rows


def damping_rows(found: Found) -> list[list]:
    """Section 5.3.3: that the pressure loop damps, that a slow one does it, and that pairs do not have it."""
    dual, pairs = (
        [row for row in found.linear if row[0] == name and row[1] == 1.0] for name in ("dual", "pairs")
    )  # fmt: skip
    best = min(dual, key=lambda row: float(row[5]))
    slow, fast = dual[0], dual[-1]
    spread = max(float(r[5]) for r in pairs) - min(float(r[5]) for r in pairs)
    simulated = {(row[0], row[1], row[2]): float(row[3]) for row in found.simulated if row[3] != ""}
    small = min(row[1] for row in found.simulated)
    swept = [simulated[key] for key in simulated if key[:2] == ("dual", small)]
    beside = [simulated[key] for key in simulated if key[:2] == ("pairs", small)]
    large = max(row[1] for row in found.simulated)
    wide = [simulated[key] for key in simulated if key[:2] == ("pairs", large)]
    told = f"{slow[5]} % at {slow[3]} Hz, {best[5]} % at {best[3]} Hz, {fast[5]} % at {fast[3]} Hz"
    lower = float(slow[5]) < float(best[5]) + 1.0
    return [
        [
            "section 5.3.3", "a pressure loop damps its joint, dual strategy",
            "theta2 looks damped through p_A's loop",
            f"overshoot of theta2's step by p_A's bandwidth: {told}; "
            f"simulated {max(swept):.0f} % down to {min(swept):.0f} %",
            "agrees" if float(best[5]) < 0.5 * float(slow[5]) else "differs", "",
        ],
        [
            "section 5.3.3", "lowering its bandwidth adds damping", "the lower p_A's bandwidth, the more",
            f"most damping at {best[3]} Hz with theta2's loop at {best[4]} Hz; none left towards 0 Hz",
            "agrees" if lower else "differs",
            "The most damping comes where both loops are about equally fast. A slower pressure loop does nothing; a "
            "much faster one holds A and leaves half the gain. Lowering helps only from above.",
        ],
        [
            "section 5.3.3", "only in the dual strategy", "with decoupled outputs it does not work",
            f"pairs: overshoot changes by {spread:.1g} percentage points over three decades; simulated "
            f"{min(beside):.0f} to {max(beside):.0f} %",
            "agrees" if spread < 1.0 else "differs",
            f"judged by the linear loop; at {large:g} deg, where the PWM saturates, pairs overshoot {max(wide):.0f} "
            f"down to {min(wide):.0f} % too",
        ],
    ]  # fmt: skip
