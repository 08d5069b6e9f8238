"""What the scoreboard says of appendix D, each verdict by a rule."""

from __future__ import annotations

from typing import Any

import numpy as np
from pneumatic_tables import AGREES, DIFFERS, NOT_COMPARABLE, PARTLY, verdict

from loopshape.toolbox.arm.source import number

SOURCE = "Bogacki-Shampine"  # the third-order method of fixed steps that the source simulates its arm with
TUNED_WORSE = 5.0  # Poiseuille has the wrong shape where its best fit is so many times as far off as PTS3
SMALL_BAR = 0.02  # PTS3 is as good as PTS2 within this


def scores(found: dict[str, Any]) -> list[list[str]]:
    """Rows of scores.csv."""
    return [*_poiseuille(found), *_throttles(found), *_pulses(found), *_flows(found), *_without(found)]


def _shape(found: dict[str, Any], name: str) -> dict[str, float]:
    columns = ("t50", "t90", "t99", "ratio", "rms", "max", "least_p_c", "peak", "reynolds")
    return dict(zip(columns, map(float, next(r for r in found["shapes"] if r[0] == name)[1:]), strict=True))


def _rattles(found: dict[str, Any], model: str, method: str = SOURCE, kind: str = "float64") -> dict[float, Any]:
    """Rattles by step in s."""
    return {float(row[3]): r for row, r in found["rattles"] if row[:3] == [model, method, kind]}


def _poiseuille(found: dict[str, Any]) -> list[list[str]]:
    tuned, pts2, pts3, bare = (_shape(found, name) for name in ("tuned", "pts2", "pts3", "pts1"))
    steps = _rattles(found, "pts1")
    bad = [h for h, r in steps.items() if not r.finite or r.off > 0.1 * bare["peak"]]
    good = [h for h in steps if h not in bad]
    fast = f"{1e3 * bare['t99']:.0f} ms against {pts2['t99']:.2f} s"
    return [
        [
            "figure D.8",
            "Poiseuille with hose dimensions",
            "unstable with the hoses' dimensions",
            f"third-order steps of {1e3 * min(bad):g} ms and more fall over, of {1e3 * max(good):g} ms do not; "
            f"Radau solves it: p_m at 99 % in {fast}",
            verdict(bool(bad) and bool(good), otherwise=DIFFERS),
            "unstable is the solver, not the model; the model is wrong all the same: it lets "
            f"{bare['peak'] / pts2['peak']:.0f} "
            f"times the flow through, at Reynolds {bare['reynolds']:.0f}, where no flow is laminar",
        ],
        [
            "figure D.8",
            "best fit of Poiseuille",
            "no parameters make Poiseuille describe the pressure over time",
            f"best fit off by {tuned['rms']:.3f} bar rms, PTS3 by {pts3['rms']:.4f}; t99/t50 {tuned['ratio']:.1f} "
            f"against {pts2['ratio']:.1f}",
            verdict(tuned["rms"] > TUNED_WORSE * pts3["rms"]),
            "PTS2 stands in for the measurement, which is drawn only; rule: best fit at least 5 times as far off "
            "as PTS3; "
            "feature: a tail without end where a throttle fills with a knee",
        ],
    ]


def _throttles(found: dict[str, Any]) -> list[list[str]]:
    pts2, steps = _shape(found, "pts2"), _rattles(found, "pts2")
    onset = number("figure_d_9.unstable_from")
    near = [h for h, r in steps.items() if abs(r.onset_s - onset.value) <= onset.half_digit]
    true = found["runs"]["pts2"]
    times = {h: round(r.onset_s, 2) for h, r in steps.items() if np.isfinite(r.onset_s)}
    said = ", ".join(f"{t:g} s at {1e3 * h:g} ms" for h, t in times.items())
    return [
        [
            "figure D.9",
            "PTS2 against the measurement",
            "good resemblance with throttles of reduction valve and solenoid valve",
            f"p_m at 50, 90, 99 % after {pts2['t50']:.2f}, {pts2['t90']:.2f}, {pts2['t99']:.2f} s; p_c dips to "
            f"{pts2['least_p_c']:.3f} bar",
            NOT_COMPARABLE,
            "the measurement is drawn only, volume and hoses are not published; the volume was chosen so that "
            "the pressures meet where the source's do",
        ],
        [
            "figure D.9",
            "instability of PTS2",
            "slightly unstable after {figure_d_9.unstable_from}",
            f"a third-order solver rattles from {said}; Radau ({true.evaluations} evaluations) never",
            PARTLY if near else DIFFERS,
            "that it starts where the pressures meet is reproduced, at the time of the text with steps of "
            f"{', '.join(f'{1e3 * h:g}' for h in near) or 'no'} ms; it is numerical as the source says, but not "
            "cancellation (figure D.11)",
        ],
    ]


def _pulses(found: dict[str, Any]) -> list[list[str]]:
    a, b = (found["runs"][f"{name}_pulsed"] for name in ("pts2", "pts3"))
    return [
        [
            "figure D.10",
            "PTS2 under a block signal of {} Hz".format(number("figure_d_10.frequency").printed),
            "good match, {figure_d_10.frequency}, duty {figure_d_10.duty}",
            f"p_m {a.p_bar[-1, -1]:.2f} bar at the figure's end, in steps of up to {1e3 * _largest_step(a):.0f} mbar; "
            f"PTS3 off by {1e3 * np.abs(a.p_bar[:, -1] - b.p_bar[:, -1]).max():.1f} mbar at most",
            NOT_COMPARABLE,
            "the measurement is drawn only; volume and hoses are not published",
        ]
    ]


def _largest_step(run: Any) -> float:
    rows = round(1.0 / number("figure_d_10.frequency").value / (run.t_s[1] - run.t_s[0]))
    return float(np.max(run.p_bar[rows:, -1] - run.p_bar[:-rows, -1]))


def _flows(found: dict[str, Any]) -> list[list[str]]:
    steps, onset = _rattles(found, "pts2"), number("figure_d_11.fluctuates_from")
    shown = {h: r for h, r in steps.items() if np.isfinite(r.onset_s)}
    quiet = all(r.supply_off < 0.02 * r.off for r in shown.values())
    near = min(shown, key=lambda h: abs(shown[h].onset_s - onset.value))
    over = [r.off / r.onset_flow for r in shown.values()]
    spans = np.array([[h, r.off] for h, r in steps.items()])
    order = float(np.polyfit(np.log(spans[:, 0]), np.log(spans[:, 1]), 1)[0])
    kinds = {k: next(iter(_rattles(found, "pts2", kind=k).values())).off for k in ("float32", "longdouble")}
    one = steps[float(next(row[3] for row, _ in found["rattles"] if row[2] == "float32"))].off
    same = all(abs(v / one - 1.0) < 0.1 for v in kinds.values())
    return [
        [
            "figure D.11",
            "which flows fluctuate",
            "q_1 and q_2, not q_in (from about {figure_d_11.fluctuates_from}, see D.9)",
            f"q_1 from {shown[near].onset_s:.2f} s at a step of {1e3 * near:g} ms, {1e4 * shown[near].off:.2f}e-4 "
            "kg/s off at the end; "
            f"q_in by at most {100 * max(r.supply_off / r.off for r in shown.values()):.1f} % of that",
            verdict(quiet, otherwise=PARTLY),
            "rule: q_in's error within 2 % of q_1's at every step that rattles",
        ],
        [
            "figure D.11",
            "size of the fluctuations",
            "an axis from {figure_d_11.flow_low} to {figure_d_11.flow_high}, units of 1e-4 kg/s",
            f"{1e4 * shown[near].off:.2f}e-4 kg/s where the onset fits; at every step {min(over):.1f} to "
            f"{max(over):.1f} times the true flow at the onset",
            verdict(shown[near].off > 0.5 * abs(number("figure_d_11.flow_low").value) * 1e-4),
            "fixed steps cannot have both: rattling starts where the flow falls to 0.4 of what it rattles "
            "by, and so wide an axis "
            "would mean an onset at half the peak flow or more; a solver that lengthens its steps is left; "
            "rule: at least half the axis's lower end",
        ],
        [
            "figure D.11",
            "cause of the fluctuations",
            "cancellation (lost digits), together with stiffness",
            f"the amplitude goes with the step to the power {order:.2f}; float32, float64, longdouble: "
            f"{1e4 * kinds['float32']:.3f}, {1e4 * one:.3f}, {1e4 * kinds['longdouble']:.3f}e-4 kg/s at 0.1 ms",
            PARTLY if same else AGREES,
            "stiffness, yes; cancellation, no: seven or nineteen digits rattle alike. A throttle's slope is "
            "without bound at equal "
            "pressures, so every explicit step is too long there",
        ],
    ]


def _without(found: dict[str, Any]) -> list[list[str]]:
    pts3, steps = _shape(found, "pts3"), _rattles(found, "pts3")
    step, r = max(steps.items())
    share = r.off / pts3["peak"]
    good = pts3["max"] < SMALL_BAR and share < 0.01
    alone = float(found["small"][2][4])
    return [
        [
            "figure D.12",
            "PTS3 is accurate and stable",
            "accurate and stable",
            f"p_m within {1e3 * pts3['max']:.1f} mbar of PTS2; third-order steps of {1e3 * step:g} ms are off by "
            f"{100 * share:.3f} % of the largest flow",
            verdict(good, otherwise=PARTLY),
            "rule: within 20 mbar of PTS2, rattling below 1 %; accurate against PTS2, as the measurement is drawn "
            "only; with the "
            f"valve's throttle alone, hoses left out, {1e3 * alone:.0f} mbar",
        ]
    ]
