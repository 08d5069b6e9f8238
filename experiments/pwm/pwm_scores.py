"""What the scoreboard says of the PWM, each verdict by a rule."""

from __future__ import annotations

from typing import Any

import numpy as np
from pneumatic_tables import AGREES, DIFFERS, NOT_COMPARABLE, PARTLY, verdict

from loopshape.core.units import db
from loopshape.toolbox.arm.source import number, value

HARDLY_MBAR = 5.0  # half a percent of the figures' axis
CONDITION_IDEAL, CONDITION_OWN = "neither", "noise and converters"
CONDITION_LATE, CONDITION_LOST = "late valves, neither", "late valves that lose short pulses, noise and converters"


def scores(found: dict[str, Any]) -> list[list[str]]:
    """Rows of scores.csv."""
    return [*_examples(found), *_splitter(found), *_ripple(found), *_rules(found), *_rest(found), *_lag(found)]


def _examples(found: dict[str, Any]) -> list[list[str]]:
    rows = []
    for name, words in (("figure_3_3", "figure 3.3"), ("figure_c_6", "figure C.6")):
        e = found["examples"][name]
        good = bool((e["off_s"] <= e["resolution_s"]).all() and e["power_off"].max() < 1e-12)
        keys = f"{{{name}.pwm_frequency}}, dead zone {{{name}.dead_zone}}"
        rows.append(
            [
                words,
                "pulses by the threshold, equal power",
                f"valve open while the sampled u exceeds the threshold; {keys}",
                f"pulse and threshold agree to {1e6 * e['off_s'].max():.0f} us (grid "
                f"{1e6 * e['resolution_s'][0]:.0f}), mean of v equals u to "
                f"{e['power_off'].max():.0e}",
                verdict(good),
                "rule: within the grid; the example's signal is not published, ours is made up",
            ]
        )
        share = value(f"{name}.dead_zone") * value(f"{name}.pwm_frequency")
        rows.append(
            [
                words,
                "unit of the dead zone",
                f"the caption gives {{{name}.dead_zone}} in s",
                f"in s it would be {share:g} of a period",
                verdict(share < 0.5),
                "a threshold between tau and 1 - tau needs a share below 0.5: it is a share of the period, as the "
                "text's (C.8) and the "
                "code use it",
            ]
        )
    worst = max(s[4] for s in found["saturation"])
    rows.append(
        [
            "figure C.7",
            "saturation with any bounds from the standard one",
            "four examples of (C.15)",
            f"four pairs of bounds, equal to clipping within {worst:.0e}",
            verdict(worst < 1e-12),
            "the extraction lost the bounds' signs; those restored here are -1, 1; -1, 0; 0.1, 0.9; -1.5, 0.3",
        ]
    )
    return rows


def _splitter(found: dict[str, Any]) -> list[list[str]]:
    table = np.array([[float(v) for v in row] for row in found["splits"]])
    error, share = table[:, 8].max(), np.abs(table[:, 6] - table[:, 7]).max()
    both = table[(table[:, 2] == 1.0) & (table[:, 3] == 1.0) & (table[:, 0] == table[:, 1])]
    one = table[(table[:, 2] == 1.0) & (table[:, 3] == 0.0) & (table[:, 0] == table[:, 1])]
    ratio = float((both[:, 5] / one[:, 5]).max())
    return [
        [
            "table 3.1",
            "splitter pressure by valves",
            "p_c, the open muscle's pressure, the lower of both",
            f"the kernel's flow is the table's within {error:.0e} at {len(table)} states",
            verdict(error < 1e-12),
            f"as printed, two open valves pass {ratio:g} times what one passes; two valves of their own throttle "
            "each would pass 2 times",
        ],
        [
            "table 3.2",
            "share of muscle A by valves",
            "by the differences to p_c where both are open",
            f"the kernel's share is the table's within {share:.0e} at {len(table)} states",
            verdict(share < 1e-12),
            "muscles below p_c; above it the kernel bounds the shares, where the printed ones do not",
        ],
    ]


def _ripple(found: dict[str, Any]) -> list[list[str]]:
    rows = {(r[0], r[1]): r for r in found["ripples"]}
    f = {name: value(f"{name}.frequency") for name in ("figure_c_2", "figure_c_3", "figure_c_4")}
    own = {name: rows["assumed", hz] for name, hz in f.items()}
    rises, late = ([rows[words, hz][5] for hz in f.values()] for words in ("assumed", "late valves"))
    first, second, third = own.values()
    halves = abs(second[4] * f["figure_c_3"] / (first[4] * f["figure_c_2"]) - 1.0)
    note = "the measurement is drawn only; volume, hoses and valve are the pneumatic test setup's assumptions"

    def told(row: list[Any]) -> str:
        said = f"ripple of p_out {row[4]:.1f}, of p_valve {row[3]:.0f}, of p_in {row[2]:.2f} mbar"
        return f"{said} at half the supply, volume assumed"

    return [
        ["figure C.2", "ripple at {:g} Hz".format(f["figure_c_2"]), "drawn only", told(first), NOT_COMPARABLE, note],
        [
            "figure C.2",
            "the frequency does not affect the rise time",
            "no effect from {figure_c_2.frequency} to {figure_c_4.frequency}",
            "10 to 90 % in " + ", ".join(f"{r:.3f}" for r in rises) + " s",
            verdict(float(np.ptp(rises)) < 0.5 / f["figure_c_2"]),
            "rule: spread below half the longest period; with the source's own valve responses "
            f"({value('valve_response_open'):g} ms to open, {value('valve_response_close'):g} ms "
            "to close) every pulse "
            "is 1 ms longer, and it is " + ", ".join(f"{r:.2f}" for r in late) + " s",
        ],
        [
            "figure C.3",
            "ripple at {:g} Hz".format(f["figure_c_3"]),
            "smoothens rather well",
            told(second),
            verdict(halves < 0.15, otherwise=PARTLY),
            "rule: ripple over that at 25 Hz is the inverse of the frequencies within 15 %",
        ],
        [
            "figure C.4",
            "ripple at {:g} Hz".format(f["figure_c_4"]),
            "hardly any ripple",
            told(third),
            verdict(third[4] < HARDLY_MBAR),
            f"rule: below {HARDLY_MBAR:g} mbar, half a percent of the axis; it goes with 1/(volume frequency)",
        ],
    ]


def _rules(found: dict[str, Any]) -> list[list[str]]:
    pwm_hz, period_ms = value("pwm_frequency"), 1e3 / value("pwm_frequency")
    at = {
        f: [r for r in found["lags"] if r[3] == f and r[0] == 0.0 and r[1] == 0.0 and r[2] <= 1.0] for f in (5.0, 20.0)
    }
    loss = {f: -min(float(db(r[4])) for r in rows) for f, rows in at.items()}
    lags = [r[5] for r in at[5.0]]
    rule, used, code = (
        value("pwm_dead_zone_rule") / value("valve_frequency"),
        value("pwm_dead_zone"),
        "pwm_dead_zone_code",
    )
    as_number = any(0.5 <= tau / rule <= 2.0 for tau in (used, value(code)))
    as_time = 0.5 <= used / (rule * pwm_hz) <= 2.0
    return [
        [
            "appendix C",
            "bandwidth of the PWM",
            "{pwm_bandwidth_rule} of its frequency",
            f"at 5 Hz at most {loss[5.0]:.2f} dB lost and {min(lags):.1f} to {max(lags):.1f} deg late (u within "
            f"1); at 20 Hz at most {loss[20.0]:.1f} dB",
            PARTLY,
            "a rule of thumb without a definition: the gain gives no bandwidth below half the PWM frequency, the "
            "lag does, and it "
            "depends on the amplitude",
        ],
        [
            "appendix C",
            "dead zone by the valve's frequency",
            "by C.9 {pwm_dead_zone_rule} over {valve_frequency}; used {pwm_dead_zone}, in the code "
            "{pwm_dead_zone_code}",
            f"the rule gives {rule:.4f}: as s {1e3 * rule:.1f} ms, {rule * pwm_hz:.2f} of a period; used is "
            f"{used * period_ms:g} ms, {used:g} of a period",
            AGREES if as_time else PARTLY if as_number else DIFFERS,
            f"as bare numbers rule and use are alike (within a factor 2), as times not: captions and code give s, the "
            f"code compares the number with a sawtooth from 0 to 1, so what is used is {rule * pwm_hz / used:.0f} "
            f"times shorter than the rule and a tenth of the valve's {value('valve_response_open'):g} ms to open",
        ],
    ]


def _line(found: dict[str, Any], condition: str, dead_zone: float) -> dict[str, Any]:
    names = (
        "span",
        "largest",
        "mbar",
        "pulses",
        "answered",
        "error",
        "error_mbar",
        "line_hz",
        "repeat_s",
        "repeat",
        "growth",
        "kinds",
    )
    row = next(r for r in found["rest"] if r[0] == condition and float(r[1]) == dead_zone)
    return {n: v if n == "kinds" else float(v) for n, v in zip(names, row[2:], strict=True)}


def _rest(found: dict[str, Any]) -> list[list[str]]:
    tau = value("pwm_dead_zone")
    ideal, own, late, lost = (
        _line(found, c, 0.0) for c in (CONDITION_IDEAL, CONDITION_OWN, CONDITION_LATE, CONDITION_LOST)
    )
    small, used = _line(found, CONDITION_OWN, value("pwm_dead_zone_code")), _line(found, CONDITION_OWN, tau)
    used_lost = _line(found, CONDITION_LOST, tau)
    cycles = late["kinds"].endswith(" periodic") and late["span"] > 10.0 * ideal["span"]
    rests = ideal["largest"] < 1e-4
    errors = [float(r[7]) for r in found["rest"] if r[0] == CONDITION_IDEAL and float(r[1]) >= tau]
    return [
        [
            "section 5.5",
            "without dead zone the loop limit-cycles",
            "limit cycles and nervous behaviour with a smaller dead zone",
            f"printed model, no noise: rest ({ideal['largest']:.0e} deg); noise and converters: irregular, "
            f"{own['span']:.2f} deg peak to peak; late valves: "
            f"{late['kinds']}, {late['span']:.2f} deg, the same again after {late['repeat_s']:.2f} s",
            PARTLY if rests and cycles else verdict(cycles),
            "not the loop by itself: noise and converters keep it moving, and a limit cycle takes a smallest dose, "
            "which valves that close "
            "later than they open have",
        ],
        [
            "section 5.5",
            "a smaller dead zone makes it nervous",
            "{pwm_dead_zone} is quiet, a smaller one is not",
            f"pulses a second at 0, {value('pwm_dead_zone_code'):g}, {tau:g}: {own['pulses']:.0f}, "
            f"{small['pulses']:.0f}, {used['pulses']:.1f}; "
            "deg peak to peak "
            f"{own['span']:.3f}, {small['span']:.3f}, {used['span']:.3f}",
            verdict(own["pulses"] > 20.0 * used["pulses"]),
            "rule: 20 times as many pulses; almost none of these pulses is as long as the valve takes to open. "
            "Where shorter ones are "
            f"lost the dead zone decides nothing: {lost['span']:.3f} deg without it, {used_lost['span']:.3f} with",
        ],
        [
            "section 5.5",
            "the dead zone causes the static error",
            "assumed; {table_5_3.theta2.ess} measured",
            f"none without it ({ideal['error']:.0e} deg); up to {_line(found, CONDITION_IDEAL, tau)['error']:.3f} "
            f"deg with {tau:g}, rising to {errors[-1]:.2f} with 0.1",
            PARTLY if errors[-1] > errors[0] else DIFFERS,
            "cause as said, size not: at the dead zone used it is a third of the measured static error or less; "
            "the rest of it "
            "(friction, hysteresis) is not in the printed model",
        ],
    ]


def _lag(found: dict[str, Any]) -> list[list[str]]:
    claim = number("pwm_phase_lag_5hz")
    rows = [r for r in found["lags"] if r[3] == 5.0 and r[0] == value("pwm_dead_zone")]
    about_0 = {r[2]: r[5] for r in rows if r[1] == 0.0}
    lags_hold = rows[0][7]
    near = [a for a, x in about_0.items() if abs(x - claim.value) <= claim.half_digit]
    said = ", ".join(f"{x:.1f} at {a:g}" for a, x in about_0.items() if a in (0.05, 0.2, 0.4, 1.0, 3.0))
    return [
        [
            "chapter 6",
            "phase lag of the PWM at 5 Hz",
            "{pwm_phase_lag_5hz}",
            f"{said} V amplitude; {claim} at {found['amplitude']:.2f} about 0, or a small sine about "
            f"{found['offset']:.3f}; a zero-order hold {lags_hold:.0f} deg",
            PARTLY if near else DIFFERS,
            "the lag is no constant: half the mean pulse about 0, the whole mean pulse for a small signal about an "
            "offset, half a period when "
            "saturated; the source does not say for which signal its number holds",
        ]
    ]
