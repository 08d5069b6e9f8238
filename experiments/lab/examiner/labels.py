"""What an exam asks for: effects, their blocks and magnitudes, drawn cases, and the seal on a label."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from typing import NamedTuple

import numpy as np

from loopshape.core.errors import WrongUseError


class Effect(NamedTuple):
    """An effect's block, the smallest and largest magnitude that occur, whether both signs do, its unit."""

    block: str
    low: float
    high: float
    signed: bool
    unit: str


#: effects that the library knows, by name; blocks from FORMAT.md, magnitudes from GAP.md
EFFECTS: dict[str, Effect] = {
    "angle_sensor_lag": Effect("sensor", 5.0, 20.0, False, "ms"),
    "backlash": Effect("sensor", 0.25, 1.0, False, "deg"),
    "base_tilt": Effect("body", 4.0, 8.0, True, "deg"),
    "braid_hysteresis": Effect("muscle", 1.5, 8.0, False, "N"),
    "choked_flow": Effect("supply", 0.35, 0.6, False, "1"),
    "coupling_flexibility": Effect("body", 12.0, 18.0, False, "Hz"),
    "dead_volume": Effect("line", 20.0, 70.0, False, "ml"),
    "gas_law": Effect("gas", 0.6, 1.4, False, "1"),
    "hose_lag": Effect("line", 1.0, 5.0, False, "m"),
    "hose_stiffness": Effect("joint", 0.6, 4.0, False, "N m/rad"),
    "joint_friction": Effect("joint", 0.04, 0.25, False, "N m"),
    "leak": Effect("line", 0.1, 0.3, False, "mm"),
    "loop_delay": Effect("controller", 2.0, 10.0, False, "ms"),
    "muscle_creep": Effect("muscle", 0.1, 0.35, False, "1"),
    "muscle_mismatch": Effect("muscle", 0.12, 0.25, True, "1"),
    "nominal_length_offset": Effect("muscle", 2.0, 8.0, True, "mm"),
    "payload": Effect("body", 20.0, 90.0, False, "g"),
    "pressure_sensor_lag": Effect("sensor", 10.0, 60.0, False, "ms"),
    "stiffness_error": Effect("muscle", 0.1, 0.25, True, "1"),
    "supply_droop": Effect("supply", 0.05, 0.16, False, "bar"),
    "valve_delay": Effect("valve", 2.0, 6.0, False, "ms"),
}

#: effects that the library must not know: the answer to them is `unknown`
OUTSIDE: dict[str, Effect] = {
    "braid_contact": Effect("muscle", 1500.0, 4500.0, False, "N/m"),
    "end_stop_rubber": Effect("joint", 1.5, 4.0, False, "N m/rad"),
    "exhaust_clog": Effect("valve", 0.22, 0.38, False, "1"),
    "flow_drift": Effect("valve", 0.25, 0.45, False, "1"),
    "gauge_curvature": Effect("sensor", 0.03, 0.08, False, "bar"),
    "lost_commands": Effect("controller", 0.15, 0.4, False, "1"),
    "potentiometer_waves": Effect("sensor", 0.6, 1.5, False, "deg"),
    "sensor_crosstalk": Effect("sensor", 0.08, 0.2, False, "1"),
    "supply_ripple": Effect("supply", 0.15, 0.35, False, "bar"),
    "viscous_joint": Effect("joint", 0.15, 0.45, False, "N m s/rad"),
}

RANGES: dict[str, tuple[float, float, bool]] = {name: (e.low, e.high, e.signed) for name, e in EFFECTS.items()}
BLOCKS: dict[str, str] = {name: e.block for name, e in (EFFECTS | OUTSIDE).items()}
UNITS: dict[str, str] = {name: e.unit for name, e in (EFFECTS | OUTSIDE).items()}
KINDS = ("single", "healthy", "unknown", "pair")


def effect(name: str) -> Effect:
    """An effect of either table; refuses a name that stands in neither."""
    table = EFFECTS | OUTSIDE
    if name not in table:
        raise WrongUseError("the examiner has no such effect", repr(name), f"it has {', '.join(sorted(table))}")
    return table[name]


def draw_magnitude(name: str, rng: np.random.Generator) -> float:
    """A magnitude in the effect's range, uniform in its logarithm, of either sign where both occur."""
    e = effect(name)
    size = float(np.exp(rng.uniform(np.log(e.low), np.log(e.high))))
    size = float(f"{size:.4g}")
    return -size if e.signed and rng.random() < 0.5 else size


def draw_case(kind: str, rng: np.random.Generator) -> dict[str, float]:
    """Labels of a case: one effect, none, one from outside, or two whose blocks differ."""
    if kind == "healthy":
        return {}
    if kind in ("single", "unknown"):
        name = str(rng.choice(sorted(EFFECTS if kind == "single" else OUTSIDE)))
        return {name: draw_magnitude(name, rng)}
    if kind != "pair":
        raise WrongUseError("a case's kind is not known", repr(kind), f"use {', '.join(KINDS)}")
    first = str(rng.choice(sorted(EFFECTS)))
    others = [name for name in sorted(EFFECTS) if BLOCKS[name] != BLOCKS[first]]
    names = sorted((first, str(rng.choice(others))))
    return {name: draw_magnitude(name, rng) for name in names}


def verdict(labels: Mapping[str, float]) -> str:
    """The answer that a diagnosis should give: an effect, two joined by `+`, `none` or `unknown`."""
    if any(name in OUTSIDE for name in labels):
        return "unknown"
    return "+".join(sorted(labels)) or "none"


def canonical(labels: Mapping[str, float]) -> str:
    """Labels as JSON that is the same whatever the order in which they were given."""
    return json.dumps({k: float(v) for k, v in labels.items()}, sort_keys=True, separators=(",", ":"))


def seal(labels: Mapping[str, float], nonce: str) -> str:
    """SHA-256 of the labels and a nonce, as hexadecimal digits: printed before the diagnosis, opened after it."""
    return sha256(f"{nonce}:{canonical(labels)}".encode()).hexdigest()
