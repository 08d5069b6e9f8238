"""Scoreboard lines of joint 1 alone: what the source says, what was found, and whether both agree."""

from __future__ import annotations

from collections.abc import Sequence

from loopshape.data.response.model import Fit
from loopshape.data.result.margins import Margins
from loopshape.data.result.verdict import Verdict
from loopshape.toolbox.arm.source import number, value

#: "about so many Hz" agrees within this factor; two spans agree where one lies in the other, partly where they meet
ABOUT = 1.5


def scores(
    verdicts: dict[str, Verdict], fits: Sequence[Fit], cycle: tuple[float, float], causes: Sequence[Sequence]
) -> list[list]:
    """Rows of `scores.csv`."""
    printed, tuned = verdicts["table H.1"], verdicts["tuned"]
    modes = sorted(fit["f_hz"].value for fit in fits)
    met = f"stable at {stable(printed)} of {len(printed.margins)} points; largest |S| {worst(printed):.1f} dB"
    pressure = span(verdicts["p_CD, the plant's own"])
    near = all(1.0 / ABOUT <= hz / value("table_h_1.bandwidth_high") <= ABOUT for hz in pressure)
    required = "|S| {required.sensitivity}, phase {required.phase_margin}, gain {required.gain_margin}"
    why = (
        "Our mode lies above the notch and not at it, is damped 0.01 and not about 0.05, and the gain is too high for "
        f"the bandwidth. All three changed together: largest |S| {causes[-1][5]} dB, phase margin {causes[-1][4]} deg; "
        "no two of them do."
    )
    return [
        ["table H.1", "controller on the plant", f"all margins met: {required}", met, holds(printed), why],
        [
            "table H.1", "its structure, tuned on our plant", f"all margins met: {required}",
            f"stable at {stable(tuned)} of {len(tuned.margins)} points; largest |S| {worst(tuned):.1f} dB, "
            f"least phase margin {min(m.phase_margin_deg for m in tuned.margins.values()):.0f} deg",
            holds(tuned), reasons(tuned),
        ],
        [
            "table H.1", "pressure loop", "about {table_h_1.bandwidth_high}, like theta1's",
            f"{pressure[0]:.2f} to {pressure[1]:.2f} Hz (gain and low-pass of table 5.6 on both muscles)",
            "agrees" if near else "differs", f"about: within a factor {ABOUT:g}",
        ],
        [
            "figure H.3", "frequency of the mode", "notch at {table_h_1.notch}",
            f"{modes[0]:.2f} to {modes[-1]:.2f} Hz, six points",
            "agrees" if among(value("table_h_1.notch"), modes) else "differs",
            "The printed numbers give a stiffer joint 1; the source tells the notch's frequency only.",
        ],
        [
            "figure H.3", "bandwidth", "{table_h_1.bandwidth_low} to {table_h_1.bandwidth_high}",
            f"{spoken(printed)}, first 0 dB crossing of a loop that is stable at {stable(printed)} of "
            f"{len(printed.margins)} points", in_a_stable_loop(within(span(printed)), printed),
            "no bandwidth where the loop is unstable: |L| rises above 1 again at the mode; partly at best",
        ],
        [
            "figure H.3", "bandwidth, tuned", "{table_h_1.bandwidth_low} to {table_h_1.bandwidth_high}",
            spoken(tuned), within(span(tuned)), "the tuning asks for as much as the margins leave",
        ],
        [
            "figure H.3", "largest |S|", "below {required.sensitivity}", f"{worst(printed):.1f} dB", holds(printed),
            "the same loop and causes as table H.1",
        ],
        [
            "figure H.4", "Nichols diagram", "a stable loop that keeps off the circle",
            f"through the circle on the far side; the simulated arm swings by {cycle[0]:.1f} deg at {cycle[1]:.1f} Hz",
            holds(printed), "the same loop and causes as table H.1",
        ],
    ]  # fmt: skip


def in_a_stable_loop(said: str, verdict: Verdict) -> str:
    """A crossing of a loop that is not stable everywhere agrees partly at best."""
    return "partly" if said == "agrees" and stable(verdict) < len(verdict.margins) else said


def stable(verdict: Verdict) -> int:
    """How many points are stable."""
    return sum(m.stable == "stable" for m in verdict.margins.values())


def worst(verdict: Verdict) -> float:
    """Largest |S| of all points in dB."""
    return max(m.sensitivity_peak_db for m in verdict.margins.values())


def holds(verdict: Verdict) -> str:
    """Agrees where every margin is met at every point, partly where the data cannot decide some, else differs."""
    return {"passed": "agrees", "undecided": "partly"}.get(verdict.outcome, "differs")


def reasons(verdict: Verdict) -> str:
    """Why a verdict is not passed."""
    lines = [f"{line.quantity} {line.outcome}" for line in verdict.lines if line.outcome != "passed"]
    open_points = [name for name, m in verdict.margins.items() if m.stable != "stable"]
    lines += [f"stability at {name} not decided by these lines" for name in open_points]
    return "; ".join(lines)


def span(verdict: Verdict) -> tuple[float, float]:
    """Least and largest bandwidth in Hz."""
    every: list[Margins] = list(verdict.margins.values())
    return min(m.bandwidth_hz for m in every), max(m.bandwidth_hz for m in every)


def spoken(verdict: Verdict) -> str:
    """The span in words."""
    return "{:.2f} to {:.2f} Hz".format(*span(verdict))


def among(asked: float, found: Sequence[float]) -> bool:
    """Whether a printed frequency lies among those found, half its last digit allowed."""
    room = number("table_h_1.notch").half_digit
    return min(found) - room <= asked <= max(found) + room


def within(found: tuple[float, float]) -> str:
    """Whether bandwidths lie in the source's span, meet it, or neither; half a printed digit is allowed."""
    ends = number("table_h_1.bandwidth_low"), number("table_h_1.bandwidth_high")
    low, high = ends[0].value - ends[0].half_digit, ends[1].value + ends[1].half_digit
    if low <= found[0] and found[1] <= high:
        return "agrees"
    return "partly" if found[0] <= high and found[1] >= low else "differs"
