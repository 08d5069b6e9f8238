"""Figures C.2 to C.4 in simulation: a fixed volume filled through one valve by a block signal.

The volume, the hoses and the valve are the pneumatic test setup's second model (PTS2): p_valve is its p_2.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.units import Array
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.source import value

sys.path.insert(0, str(Path(__file__).parent.parent / "pneumatic_test_setup"))

import pneumatic_models as models

FIGURES = ("figure_c_2", "figure_c_3", "figure_c_4")


def fill(b: models.Bench, f_hz: float, *, late: bool = False, dead_zone: float = 0.0) -> models.Filling:
    """The filling under the PWM of a constant duty; `late` valves open and close with the source's responses."""
    on_s = pwm.pulse_s(value("figure_c_2.duty"), 1.0 / f_hz, dead_zone)
    longer_s = 1e-3 * (value("valve_response_close") - value("valve_response_open")) if late else 0.0
    end_s = value("figure_c_2.duration") * max(b.volume_l / models.bench().volume_l, 1.0)
    return models.pulsed(models.pts2(b), end_s, models.block_edges(f_hz, on_s * f_hz, end_s, longer_s))


def ripple_mbar(run: models.Filling, f_hz: float, column: int, share: float) -> float:
    """Peak to peak about a straight line, over the two periods on each side of where p_out passes a share of p_in."""
    level = share * models.arm_value("supply_bar")
    width = round(2.0 / f_hz / (run.t_s[1] - run.t_s[0]))
    middle = int(np.argmax(run.p_bar[:, 3] >= level))
    part = slice(middle - width, middle + width)
    t, p = run.t_s[part], run.p_bar[part, column]
    return float(1e3 * np.ptp(p - np.polyval(np.polyfit(t, p, 1), t)))


def rise_s(run: models.Filling) -> float:
    """Time of p_out from 10 to 90 % of the supply."""
    supply = models.arm_value("supply_bar")
    return run.reaches_s(0.9 * supply) - run.reaches_s(0.1 * supply)


def cases(settings: Mapping[str, Any]) -> list[tuple[str, models.Bench, bool]]:
    """Words, bench, and whether the valves are late."""
    out = [("assumed", models.bench(), False), ("late valves", models.bench(), True)]
    out += [(f"volume {v:g} l", models.bench(volume_l=v), False) for v in settings["volumes_l"]]
    out += [(f"hose radius {r:g} mm", models.bench(hose_radius_mm=r), False) for r in settings["hose_radii_mm"]]
    return out + [(f"hose length {x:g} m", models.bench(hose_length_m=x), False) for x in settings["hose_lengths_m"]]


def table(settings: Mapping[str, Any]) -> tuple[list[list[Any]], dict[str, models.Filling]]:
    """Ripple and rise by case and frequency, and the runs of the assumed bench by figure."""
    rows, runs = [], {}
    for words, b, late in cases(settings):
        for figure in FIGURES:
            f = value(f"{figure}.frequency")
            run = fill(b, f, late=late)
            ripple = [ripple_mbar(run, f, k, settings["offset_share"]) for k in (0, 2, 3)]
            rows.append([words, f, *ripple, rise_s(run)])
            if words == "assumed":
                runs[figure] = run
    return rows, runs


def steps_mbar(rows: list[list[Any]], words: str) -> Array:
    """Ripple of p_out by frequency in one case."""
    return np.array([float(r[4]) for r in rows if r[0] == words])
