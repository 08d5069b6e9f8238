"""What the source says of its learner, beside what came out; verdicts by the rules stated in each line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from learning_tables import Results, Rows
from rivals import EXAMPLE
from trial_outcomes import Summary, interval_percent

from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.source import value
from loopshape.toolbox.rig.files.study import read_study
from loopshape.toolbox.rig.simulated import plan

ITEM = "section 5.4"
HUNDREDS = (100, 1000)
FEEDBACK = "feedback"


def scored(results: Results) -> Rows:
    """The rows of the scoreboard."""
    rows = [f(results) for f in (reached, trials_needed, identification, learner_rests, feedback_rests)]
    rows += [f(results) for f in (tracks, three_states, small_changes)]
    return [("item", "quantity", "source", "ours", "verdict", "why"), *([ITEM, *row] for row in rows)]


def rate(hits: int, trials: int) -> str:
    """A rate with its interval in words."""
    middle, low, high = interval_percent(hits, trials)
    return f"{middle:.0f} % ({low:.0f}-{high:.0f} %) of {trials}"


def reached(r: Results) -> list[str]:
    """Setpoints reached."""
    hits, trials = r.together("nominal", "reached")
    left, _ = r.together("nominal", "left_range")
    _, low, high = interval_percent(hits, trials)
    source = value("learning.reached")
    each = [r.tried[n, "nominal"][0].reached for n in r.learners]
    near = min(abs(source - low), abs(source - high)) <= 10.0
    verdict = "agrees" if low <= source <= high else ("partly" if near else "differs")
    hold, strict = r.rules.held_s, min(t for t in r.settings["final"]["tolerances_deg"])
    tight = sum(r.tried[n, "nominal"][1][strict, hold] for n in r.learners)
    feedback = r.tried[FEEDBACK, "nominal"][0]
    ours = (
        f"learner {rate(hits, trials)} (seeds {min(each)} to {max(each)} of {trials // len(each)}), "
        f"{left} left the range; "
        f"feedback {rate(feedback.reached, feedback.trials)}; within {r.rules.tolerance_deg:g} deg for {hold:g} s"
    )
    why = (
        "rule: agrees where the source's rate lies in the 95 % interval, partly within 10 points of it; another "
        "learner "
        "(model-free DQN), a simulated arm, and a tolerance that the source does not state: "
        f"within {strict:g} deg it is {rate(tight, trials)}"
    )
    return [
        "setpoints reached",
        "{learning.reached}, the rest broken off after {learning.limit} actions",
        ours,
        verdict,
        why,
    ]


def trials_needed(r: Results) -> list[str]:
    """Trials until the source's rate is reached."""
    needed = r.trials_to(value("learning.reached"))
    known = [n for n in needed.values() if n is not None]
    fits = [HUNDREDS[0] <= n < HUNDREDS[1] for n in known]
    verdict = "agrees" if len(fits) == len(needed) and all(fits) else ("partly" if any(fits) else "differs")
    ours = f"{', '.join(map(str, known))} trials (a seed each) until {value('learning.reached'):g} % are first reached"
    if len(known) < len(needed):
        ours += f"; {len(needed) - len(known)} never"
    why = f"rule: every seed between {HUNDREDS[0]} and {HUNDREDS[1]}"
    return ["trials needed", "hundreds (one hundred: {learning.trials})", ours, verdict, why]


def minutes() -> tuple[float, float]:
    """Length in minutes of the recordings that identify the arm at one equilibrium, and at all of them."""
    lengths: dict[tuple[float, ...], float] = {}
    for one in plan(read_study(EXAMPLE / "identify.toml"), Arm1()):
        t, at = one.template, tuple(one.operating_point.values())
        excited_s = t.excitation.duration_s if t.excitation else 0.0
        lengths[at] = lengths.get(at, 0.0) + (t.lead_s + excited_s + t.tail_s) / 60.0
    return next(iter(lengths.values())), sum(lengths.values())


def learning_minutes(r: Results) -> list[float]:
    """Minutes of motion that each learner needs until the source's rate, without the way back to the start."""
    needed = r.trials_to(value("learning.reached"))
    actions = [next((a for n, a, *_ in c if n == needed[seed]), None) for seed, c in r.curves.items()]
    return [a * r.rules.action_s / 60.0 for a in actions if a is not None]


def identification(r: Results) -> list[str]:
    """Time on the arm."""
    learner, (one, all_points) = learning_minutes(r), minutes()
    longest, shortest = max(learner, default=np.inf), min(learner, default=np.inf)  # none ever: longer than anything
    verdict = "agrees" if all_points < shortest else ("partly" if one < longest else "differs")
    ours = (
        f"learner {shortest:.0f} to {longest:.0f} min of motion; feedback {one:.0f} min of recordings at one "
        f"equilibrium, {all_points:.0f} min at the 24 for which the margins are shown"
    )
    why = "rule: agrees where all 24 take less than the fastest learner, partly where one takes less than the slowest"
    return ["time on the arm", "identification takes less than the learner's trials", ours, verdict, why]


def learner_rests(r: Results) -> list[str]:
    """The learner at its setpoint."""
    moving, trials = r.together("nominal", "moving")
    share = interval_percent(moving, trials)[0]
    moved = {n: [s for (m, _), (s, _) in r.variants.items() if m == n] for n in r.variant_curves}
    told = [
        f"{n.replace('_', ' ')} {sum(s.moving for s in found)} of {sum(s.trials for s in found)} (span at the 90 % "
        "point "
        f"up to {np.nanmax([s.span_90_deg for s in found]):.1f} deg)"
        for n, found in moved.items()
    ]
    worst = {seed: max(c, key=lambda at: at[3]) for seed, c in r.curves.items()}
    of = r.settings["learner"]["curve_trials"]
    on_the_way = all(at[3] > 0.5 * of for at in worst.values())
    verdict = "agrees" if share > 50.0 else ("partly" if share > 5.0 or on_the_way else "differs")
    ours = (
        f"{rate(moving, trials)} still move by more than {r.rules.moves_deg:g} deg, median span {span(r):.2f} deg; "
        "while "
        f"learning up to {', '.join(f'{at[3]} of {of} after {at[0]} trials ({at[4]:.1f} Hz)' for at in worst.values())}"
    )
    why = (
        "rule: agrees where more than half move in the end, partly where more than 5 % do or every seed's half did "
        "while learning; the limit cycle is the arm's mode in a relay's loop and goes as training goes on, because one "
        "of the nine actions shuts all valves. Moving with shorter training, and then one thing changed: "
        f"{'; '.join(told)}"
    )
    return ["learner at the setpoint", "severe limit cycle", ours, verdict, why]


def span(r: Results) -> float:
    """Median over the learners of their median span in deg."""
    return float(np.median([r.tried[n, "nominal"][0].span_deg for n in r.learners]))


def feedback_rests(r: Results) -> list[str]:
    """The feedback controller at its setpoint, with the dead zone and without."""
    there, without = r.tried[FEEDBACK, "nominal"][0], r.tried[FEEDBACK, "no_dead_zone"][0]
    rests, needs = there.moving == 0, without.moving > 0
    verdict = "agrees" if rests and needs else ("partly" if rests else "differs")
    ours = (
        f"{there.moving} of {there.trials} move, {there.edges_hz:.0f} valve edges per s, error "
        f"{there.static_deg:.3f} deg; "
        f"without the dead zone {without.moving} move, {without.edges_hz:.0f} edges per s, span "
        f"{without.span_deg:.2f} deg"
    )
    why = (
        "rule: agrees where none moves and without the dead zone some do, partly where none moves either way: the "
        "simulated "
        "arm needs the dead zone for its valves' rest, which noise would open and shut in every period, not for its own"
    )
    return ["feedback at the setpoint", "at rest thanks to the PWM's dead zone", ours, verdict, why]


def tracks(r: Results) -> list[str]:
    """A moving setpoint."""
    hz = r.settings["track"]["frequencies_hz"]
    learner = [float(np.median([r.tracking[n, f][0] for n in r.learners])) for f in hz]  # nan: one left its range
    feedback = [r.tracking[FEEDBACK, f][0] for f in hz]
    worse = [not a <= 2.0 * b for a, b in zip(learner, feedback, strict=True)]
    some = any(not a <= b for a, b in zip(learner, feedback, strict=True))
    verdict = "agrees" if all(worse) else ("partly" if some else "differs")
    told = [f"{f:g} Hz: {a:.1f} against {b:.1f} deg" for f, a, b in zip(hz, learner, feedback, strict=True)]
    size = r.settings["track"]["amplitude_deg"]
    ours = f"rms behind a sine of {size:g} deg, learner (median seed) against feedback: {'; '.join(told)}"
    why = (
        "rule: agrees where the learner's rms is twice the feedback's at every frequency, partly where it is larger at "
        "some; this learner sees the setpoint with every action and hops after it, shaking the arm; the feedback's "
        "error is "
        "its loop's smooth lag, without feedforward, and grows with frequency"
    )
    return ["trajectory tracking", "learner unsuitable, feedback correct", ours, verdict, why]


def counted(found: Sequence[Summary]) -> tuple[int, int]:
    """Setpoints reached and trials in all."""
    return sum(s.reached for s in found), sum(s.trials for s in found)


def three_states(r: Results) -> list[str]:
    """Whether three states are enough to cope with the mode."""
    hits, trials = r.together("nominal", "reached")
    one, same = ([s for (n, _), (s, _) in r.variants.items() if n == k] for k in ("one_state", "unchanged"))
    relays = [r.tried[n, "nominal"][0] for n in ("relay", "relay, ahead")]
    copes = (
        interval_percent(hits, trials)[0] >= value("learning.reached")
        and r.together("nominal", "moving")[0] < 0.05 * trials
    )
    ours = (
        f"three states {rate(hits, trials)}; with shorter training {rate(*counted(same))} against "
        f"{rate(*counted(one))} with "
        f"one state; a relay on the error {relays[0].reached} of {relays[0].trials}, on the error carried ahead "
        f"{relays[1].reached}"
    )
    why = (
        "rule: differs where the learner reaches the source's rate and fewer than 5 % move in the end; three "
        "states are "
        "needed, but a notch is not: in the trial shown it gives few pushes, timed against the mode, and shuts the "
        "valves"
    )
    return [
        "three states and the mode",
        "{learning.states} states are too few for what a notch does",
        ours,
        "differs" if copes else "agrees",
        why,
    ]


def small_changes(r: Results) -> list[str]:
    """The arm changed by a fifth."""
    hits, trials = r.together("nominal", "reached")
    _, low, _ = interval_percent(hits, trials)
    arms = [a for a in r.settings["changes"] if a != "nominal"]
    found = {a: r.together(a, "reached")[0] for a in arms}
    holds = [interval_percent(n, trials)[2] >= low for n in found.values()]
    verdict = "agrees" if all(holds) else ("partly" if any(holds) else "differs")
    feedback = [r.tried[FEEDBACK, a][0].reached for a in arms]
    told = ", ".join(f"{a} {100 * n / trials:.0f} %" for a, n in found.items())
    each, moving = trials // len(r.learners), [r.together(a, "moving")[0] for a in arms]
    ours = (
        f"learner: nominal {100 * hits / trials:.0f} %, {told}, moving in the end {', '.join(map(str, moving))} of "
        f"{trials}; "
        f"feedback {', '.join(map(str, feedback))} of {each}"
    )
    why = "rule: agrees where each rate's 95 % interval overlaps the nominal one's; payload and stiffness by 20 %"
    return ["small changes of the arm", "learner robust to them", ours, verdict, why]
