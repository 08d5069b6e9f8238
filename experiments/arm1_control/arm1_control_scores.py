"""Rows for the scoreboard: tables 5.1 to 5.3, figures 5.3 to 5.7, H.1 and H.2."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from arm1_loops import Judged, PressurePlant, Spread, implied_pressure_gain, meets
from arm1_motion import Crossing, Followed, Moved, fastest_rise_s, pressure_rates, stiffness_line_deg_s
from arm1_scores import AGREES, APART, DIFFERS, PARTLY, Score, holds, judged

from loopshape.core.units import rad
from loopshape.data.result.margins import Margins
from loopshape.data.result.step import Indicators
from loopshape.loop.loop import Loop
from loopshape.toolbox.arm.source import number, value

WORDS = {
    "source": "table 5.1",
    "alike": "table 5.1 and every FRF scaled to one kappa",
    "shipped": "shipped controller",
}
REQUIRED = "phase {required.phase_margin}, gain {required.gain_margin}, |S| {required.sensitivity}, everywhere"
BANDWIDTH = "{table_5_1.bandwidth_low} to {table_5_1.bandwidth_high}"
ANGLE_LOOPS = (("nominal", "source"), ("gas_law", "source"), ("matched", "source"), ("closest", "source"),
               ("closest", "alike"),
               ("nominal", "shipped"))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Results:
    """What the study found, as its scores need it."""

    printed: Sequence[tuple[str, str, float, Loop, Margins]]
    angle: Mapping[tuple[str, str], Judged]
    spreads: Mapping[str, Spread]
    pressure: Mapping[str, Judged]
    moves: Mapping[str, Moved]
    crossings: Mapping[str, Crossing]
    followed: Mapping[str, Followed]
    computed: Mapping[str, Indicators]
    asked_bar: float
    rules: Mapping[str, float]


def all_scores(r: Results) -> list[Score]:
    """Every row, in the order of the source."""
    rows = [*_table_5_1(r), *_table_5_2(r), *_table_5_3(r), *_figures_5_3(r), *_figure_5_5(r), *_figure_5_6(r)]
    return [*rows, *_figure_5_7(r), *_pressure_plants(r)]


def every_one(keys: str, values: Sequence[float], partly_within: float) -> str:
    """Agrees where every value does, or comes within the share; partly where one does; differs where none."""
    near = [judged(keys, x, x, partly_within) != DIFFERS for x in values]
    return AGREES if all(near) else PARTLY if any(near) else DIFFERS


def _words(m: Margins) -> str:
    return f"{m.stable}, {m.phase_margin_deg:.0f} deg, {m.gain_margin_db:.1f} dB, |S| {m.sensitivity_peak_db:.1f} dB"


def _table_5_1(r: Results) -> Iterator[Score]:
    """The controller on the plants that the source measured, and its variant on those that it simulated."""
    for kind, variant, source in (
        ("measured", "notch as printed", REQUIRED),
        ("simulated", "notch of figure 5.7", "used in its simulation, with the notch at {figure_5_7.notch}"),
    ):
        rows = [row for row in r.printed if row[1] == variant and number(f"{row[0]}.f").kind == kind]
        good = [meets(m) if kind == "measured" else m.stable == "stable" for *_, m in rows]
        text = "; ".join(f"{value(f'{p}.f'):g} Hz, delay {1e3 * d:g} ms: {_words(m)}" for p, _, d, _, m in rows)
        verdict = holds(sum(good) / len(good))
        why = "kappa of its own simulated fits is too large for table 5.1's gain: hardly any margin is left"
        yield Score("table 5.1", f"plants that it {kind}, {variant}", source, text, verdict, _unless(verdict, why))


def _unless(verdict: str, why: str) -> str:
    return "" if verdict == AGREES else why


def _table_5_2(r: Results) -> Iterator[Score]:
    for j in r.pressure.values():
        verdict = holds(j.meeting / len(j.loops))
        text = f"{j.meeting} of {len(j.loops)} points as required"
        yield Score("table 5.2", f"requirements of the pressure loop, {j.arm.label}", REQUIRED, text, verdict)


def _table_5_3(r: Results) -> Iterator[Score]:
    for m in r.moves.values():
        yield from _angle_rows(r, m)
        yield from _pressure_rows(r, m)


def _angle_rows(r: Results, m: Moved) -> Iterator[Score]:
    steps, size = [m.step("theta2", k).measured for k in (0, 1)], value("step_5_3.theta2")
    gain, linear, limited = stiffness_line_deg_s("figure_4_12"), r.computed["linear"], r.computed["limited"]
    causes = {
        "tr": f"|z| = 1 V moves the printed plant at {gain:.0f} deg/s, which takes {fastest_rise_s(gain, size):.2f} s; "
        f"table 5.1 on it gives {linear.rise_time_s:.2f} s without that limit, {limited.rise_time_s:.2f} with it",
        "ts": f"valves wide open, then ringing; the printed plant with |z| <= 1 V: {limited.settling_time_s:.2f} s",
        "overshoot": f"how long the valves stay open; the limited printed plant: {limited.overshoot * size:.1f} deg",
        "ess": "smaller than the source's: the simulated joint has no dry friction, the dead zone alone remains",
    }
    found = {
        "tr": [x.rise_time_s for x in steps], "ts": [x.settling_time_s for x in steps],
        "overshoot": [x.overshoot * size for x in steps], "ess": [abs(x.steady_state_error) * size for x in steps],
    }  # fmt: skip
    for key, values in found.items():
        yield _measured(r, f"table_5_3.theta2.{key}", f"angle, {NAMES[key]}", m, values, causes[key], "out, back")


def _pressure_rows(r: Results, m: Moved) -> Iterator[Score]:
    steps, size = [m.step("p_ab", k).measured for k in (0, 1)], value("step_5_3.p_ab")
    limit, (up, down) = fastest_rise_s(implied_pressure_gain(), size), pressure_rates(m.arm)
    causes = {
        "tr": f"wide open, valves give {up:.2f} bar/s up (one throttle feeds both muscles) and {down:.2f} down; "
        f"the printed bandwidth and gain themselves would need {limit:.2f} s",
        "ts": "valves wide open most of the way, see the rise time",
        "ess": "smaller than the source's: sensors and valves without offset",
    }
    found = {"tr": [x.rise_time_s for x in steps], "ts": [x.settling_time_s for x in steps],
             "ess": [abs(x.steady_state_error) * size for x in steps]}  # fmt: skip
    for key, values in found.items():
        yield _measured(r, f"table_5_3.p_ab.{key}", f"pressure, {NAMES[key]}", m, values, causes[key], "up, down")


NAMES = {"tr": "rise time", "ts": "settling time (2 %)", "overshoot": "overshoot", "ess": "static error"}


def _measured(
    r: Results, key: str, name: str, m: Moved, values: Sequence[float], why: str, where: str, item: str = "table 5.3"
) -> Score:
    verdict = every_one(key, values, r.rules["partly_within"])
    text = ", ".join(f"{x:.2g}" for x in values)
    who = f"{m.arm.label}; {m.controllers}"
    return Score(
        item,
        f"{name}, {m.arm.label}",
        f"{{{key}}}",
        f"{text} {number(key).unit} ({where}; {who})",
        verdict,
        _unless(verdict, why),
    )


def _figures_5_3(r: Results) -> Iterator[Score]:
    low, high = value("table_5_1.bandwidth_low"), value("table_5_1.bandwidth_high")
    half = r.rules["bandwidth_error_hz"]
    for arm, name in ANGLE_LOOPS:
        j, cause = r.angle[arm, name], f"{r.spreads[arm]}; causes.csv moves them one at a time"
        if name == "alike":
            cause = f"f is {r.spreads[arm].f_words} times the measured at (0 deg, 1.0 bar), the notch stays"
        ours = j.bandwidths_hz()
        inside = low - half <= ours[0] and ours[1] <= high + half
        whole = j.stable == len(j.loops)
        span = DIFFERS if not whole else AGREES if inside else PARTLY
        words = f"{WORDS[name]}, {j.arm.label}"
        where = f"{ours[0]:.2f} to {ours[1]:.2f} Hz over the {j.stable} stable points"
        yield Score("figure 5.3", f"bandwidth, {words}", BANDWIDTH, where, span, _unless(span, cause))
        yield _requirements(j, words, cause)
        stable = holds(j.stable / len(j.loops))
        text = f"stable at {j.stable} of {len(j.loops)}"
        yield Score(
            "figure 5.4", f"stability, {words}", "stable at every equilibrium", text, stable, _unless(stable, cause)
        )


def _requirements(j: Judged, words: str, cause: str) -> Score:
    met = holds(j.meeting / len(j.loops))
    phase, peak = min(m.phase_margin_deg for m in j.margins), max(m.sensitivity_peak_db for m in j.margins)
    text = f"{j.meeting} of {len(j.loops)} points; worst phase margin {phase:.0f} deg, |S| {peak:.1f} dB"
    return Score("figure 5.3", f"requirements, {words}", REQUIRED, text, met, _unless(met, cause))


def _figure_5_5(r: Results) -> Iterator[Score]:
    for j in r.pressure.values():
        ours = j.bandwidths_hz()
        verdict = every_one("table_5_2.bandwidth", ours, r.rules["partly_within"])
        up, down = pressure_rates(j.arm)
        why = (
            f"the printed bandwidth and gain mean {implied_pressure_gain():.1f} bar/s per V, the simulated plant has "
            f"{PressurePlant.of(j).gain:.2f}: {up:.2f} up, where one throttle feeds both muscles, {down:.2f} down"
        )
        text, cause = f"{ours[0]:.2f} to {ours[1]:.2f} Hz over 4 pressures", _unless(verdict, why)
        yield Score("figure 5.5", f"bandwidth, {j.arm.label}", "{table_5_2.bandwidth}", text, verdict, cause)
        peak = max(m.sensitivity_peak_db for m in j.margins)
        met = holds(sum(m.sensitivity_peak_db <= value("required.sensitivity") for m in j.margins) / len(j.margins))
        yield Score("figure 5.5", f"|S|, {j.arm.label}", "below {required.sensitivity}", f"{peak:.1f} dB at most", met)


INFEASIBLE = "lower by more than a fifth; the source's setpoint is not in the text, and the supply is 1 bar"


def _figure_5_6(r: Results) -> Iterator[Score]:
    for name, c in r.crossings.items():
        who, rules = r.moves[name].arm.label, r.rules
        free = AGREES if c.angle_by_pressure_deg < rules["affected_deg"] else DIFFERS
        yield Score("figure 5.6", f"angle under a pressure step, {who}", "not affected",
                    f"{c.angle_by_pressure_deg:.2f} deg at 0 deg", free)  # fmt: skip
        moves = AGREES if c.pressure_by_angle_bar > rules["affected_bar"] else DIFFERS
        yield Score("figure 5.6", f"pressure under an angle step, {who}", "affected",
                    f"{c.pressure_by_angle_bar:.2f} bar", moves)  # fmt: skip
        short = 1.0 - c.end_deg / value("step_5_3.theta2"), 1.0 - c.end_bar / r.asked_bar
        lower = DIFFERS if min(short) <= 0.0 else AGREES if max(short) <= rules["slightly"] else PARTLY
        text = f"asked for 30 deg and {r.asked_bar:g} bar, ends at {c.end_deg:.1f} deg and {c.end_bar:.2f} bar"
        words, why = "both settle a little below what was asked", _unless(lower, INFEASIBLE)
        yield Score("figure 5.6", f"infeasible setpoint, {who}", words, text, lower, why)


def _figure_5_7(r: Results) -> Iterator[Score]:
    least = r.rules["overshoot_deg"]
    lag = 1.0 / (value("table_5_1.gain") * float(rad(stiffness_line_deg_s("figure_4_12"))))
    why = (
        f"valves wide open: the profile asks for more than they give; below that the printed plant lags by {lag:.3f} s"
    )
    for name, f in r.followed.items():
        m = r.moves[name]
        yield _measured(r, "figure_5_7.delay", "delay of tracking", m, [f.delay_s], why, "whole profile", "figure 5.7")
        large, near = max(f.overshoots_deg[:2]), f.overshoots_deg[2]
        yield Score("figure 5.7", f"overshoot at large angles, {m.arm.label}", "some, in its simulation",
                    f"{large:.1f} deg at 30 deg", AGREES if large > least else DIFFERS)  # fmt: skip
        yield Score("figure 5.7", f"overshoot near 0 deg, {m.arm.label}", "some, in its experiment",
                    f"{near:.1f} deg", AGREES if near > least else DIFFERS)  # fmt: skip
        yield Score("figure 5.7", f"p_AB while tracking, {m.arm.label}", "its model predicts it accurately; no number",
                    f"{f.lowest_bar:.2f} to {f.highest_bar:.2f} bar", APART, "the text gives no number")  # fmt: skip


def _pressure_plants(r: Results) -> Iterator[Score]:
    for j in r.pressure.values():
        plant = PressurePlant.of(j)
        alike = AGREES if plant.span_db <= r.rules["alike_db"] else PARTLY
        yield Score("figure H.1", f"plants at 0 deg, {j.arm.label}", "approximately identical at varying p_AB",
                    f"levels within {plant.span_db:.1f} dB from 0.8 to 1.4 bar", alike,
                    _unless(alike, "filling slows down towards the supply's pressure"))  # fmt: skip
        slope = AGREES if max(abs(s + 1.0) for s in plant.slopes) <= r.rules["slope"] else PARTLY
        text = f"{plant.slopes.min():.2f} to {plant.slopes.max():.2f} from 0.5 to 5 Hz"
        yield Score("figure H.1", f"slope, {j.arm.label}", "-1 over all frequencies", text, slope)
        stable = holds(j.stable / len(j.loops))
        yield Score("figure H.2", f"stability, {j.arm.label}", "stable closed loop",
                    f"stable at {j.stable} of {len(j.loops)}", stable)  # fmt: skip
