"""The PWM: examples, saturation, splitter, ripple, describing function, and the loop at rest over the dead zone."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.units import TWO_PI, Array
from loopshape.toolbox.arm import parameters as k
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.dynamics.model import flow, supply_flows
from loopshape.toolbox.arm.source import value

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "pneumatic_test_setup")]  # this study's files, and the other's models

import pwm_lag as lag  # noqa: E402
import pwm_pictures as pictures  # noqa: E402
import pwm_rest as rest  # noqa: E402
import pwm_ripple as ripple  # noqa: E402
from pneumatic_tables import SCORES, write  # noqa: E402
from pwm_scores import scores  # noqa: E402

SETTINGS = tomllib.loads((HERE / "settings.toml").read_text(encoding="utf-8"))
RESTS = ("condition", "dead_zone", "span_deg", "largest_span_deg", "span_mbar", "pulses_per_s", "answered_per_s",
         "largest_error_deg", "largest_error_mbar", "line_hz", "repeat_s", "repeat", "growth", "kinds")  # fmt: skip
LAGS = ("dead_zone", "offset", "amplitude", "frequency_hz", "gain", "lag_deg", "theory_pulses_deg", "theory_hold_deg")
RIPPLES = ("case", "frequency_hz", "ripple_p_in_mbar", "ripple_p_valve_mbar", "ripple_p_out_mbar", "rise_10_90_s")
SPLITS = ("p_a_bar", "p_b_bar", "in_a", "in_b", "p_s_table_bar", "q_s_kg_s", "share_a_table", "share_a", "q_s_error")


def main() -> None:
    """Do all parts, write tables and figures."""
    found: dict[str, Any] = {"examples": {name: example(name) for name in ("figure_3_3", "figure_c_6")}}
    found["saturation"] = [saturation(*bounds) for bounds in SETTINGS["saturation"]["bounds"]]
    found["splits"] = splits()
    write(HERE / "splitter.csv", SPLITS, found["splits"])
    found["ripples"], found["fillings"] = ripple.table(SETTINGS["ripple"])
    write(HERE / "ripple.csv", RIPPLES, found["ripples"])
    found["lags"] = lag.table(SETTINGS["lag"])
    few = [r for r in found["lags"] if r[3] in (1.0, 5.0, 10.0, 20.0) and r[0] in (0.0, value("pwm_dead_zone"))]
    write(HERE / "lag.csv", LAGS, few)
    wanted = 5.0, value("pwm_phase_lag_5hz"), value("pwm_dead_zone"), SETTINGS["lag"]
    found["amplitude"], found["offset"] = lag.amplitude_for(*wanted), lag.offset_for(*wanted)
    runs = list(rest.runs(HERE, SETTINGS["rest"]))
    found["rest_runs"] = runs
    found["rest"] = write(HERE / "rest.csv", RESTS, rest.summary(runs))
    write(HERE / "scores.csv", SCORES, scores(found))
    pictures.draw(found)


def example(name: str) -> dict[str, Array]:
    """A signal through the PWM of figure 3.3 or C.6: u, samples, threshold and valve, and how both rules agree.

    The source's signal is made up and not published; this one is too.
    """
    s = SETTINGS["example"]
    f, dead_zone = (value(f"{name}.{key}") for key in ("pwm_frequency", "dead_zone"))
    t = (np.arange(s["samples"]) + 0.5) * (s["span_s"] / s["samples"])

    def u(at: Array) -> Array:
        return s["offset"] + s["amplitude"] * np.sin(TWO_PI * s["frequency_hz"] * at)

    period = np.floor(t * f)
    held, saw = u(period / f), t * f - period
    valve = np.array([pwm.is_open(max(x, 0.0), phase, dead_zone) for x, phase in zip(held, saw, strict=True)])
    starts = np.arange(round(s["span_s"] * f)) / f
    lengths = np.array([pwm.pulse_s(max(x, 0.0), 1.0 / f, dead_zone) for x in u(starts)])
    counted = np.array([valve[period == n].mean() / f for n in range(starts.size)])
    kept = (u(starts) > dead_zone) & (u(starts) < 1.0 - dead_zone)
    return {
        "t": t, "u": u(t), "held": held, "threshold": np.clip(saw, dead_zone, 1.0 - dead_zone),
        "valve": valve.astype(float), "off_s": np.abs(counted - lengths),
        "power_off": np.abs(lengths * f - u(starts))[kept], "resolution_s": np.array([s["span_s"] / s["samples"]]),
    }  # fmt: skip


def saturation(low: float, high: float) -> tuple[float, float, Array, Array, float]:
    """The saturation made of the standard one (C.15-C.17): bounds, x, y, and the largest difference from clipping."""
    x = np.linspace(-2.0, 2.0, 401)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    y = half * np.clip((x - middle) / half, -1.0, 1.0) + middle
    return low, high, x, y, float(np.abs(y - np.clip(x, low, high)).max())


def splits() -> list[list[Any]]:
    """Tables 3.1 and 3.2 against the arm's kernel, muscles below p_c."""
    c, p_c = k.constants(k.ARM1_PARAMETERS.vector()), 1e5 * SETTINGS["splitter"]["p_c_bar"]
    bars, rows = SETTINGS["splitter"]["pressures_bar"], []
    for p_a, p_b in ((1e5 * a, 1e5 * b) for a in bars for b in bars):
        for in_a, in_b in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)):
            q_a, q_b = supply_flows(c, p_c, p_a, p_b, in_a, in_b)
            p_s, share = table_3_1(p_c, p_a, p_b, in_a, in_b), table_3_2(p_c, p_a, p_b, in_a, in_b)
            q_s = float(flow(c, c[k.BETA_S], p_c, p_s))
            total = q_a + q_b
            error = abs(total - q_s) / q_s if q_s else abs(total)
            rows.append(
                [1e-5 * p_a, 1e-5 * p_b, in_a, in_b, 1e-5 * p_s, total, share, q_a / total if total else 0.0, error]
            )
    return rows


def table_3_1(p_c: float, p_a: float, p_b: float, in_a: float, in_b: float) -> float:
    """Splitter pressure by (3.29)."""
    inner = np.array([[p_c, p_b], [p_a, min(p_a, p_b)]])
    return float(np.array([1.0 - in_a, in_a]) @ inner @ np.array([1.0 - in_b, in_b]))


def table_3_2(p_c: float, p_a: float, p_b: float, in_a: float, in_b: float) -> float:
    """Muscle A's share of the flow."""
    if in_a == 0.0:
        return 0.0
    return 1.0 if in_b == 0.0 else (p_c - p_a) / ((p_c - p_a) + (p_c - p_b))


if __name__ == "__main__":
    main()
