"""The generic catalogue: kinds of effects times the places of a user's machine.

Magnitudes do not depend on the form: sliding friction, stiffness at rest, low-frequency delay, whole play. Bounds and
starts go with the scales of the recordings. A saturation below what the machine is asked for half of the time is no
hypothesis: a motion that such a limit allows would not follow its commands at all.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from loopshape.toolbox.gap.nouns.effect import EffectForm, Free, Spread
from loopshape.toolbox.gap.nouns.machine import NO_EFFECT, Input, Model, ModelParameter, Output, Port
from loopshape.toolbox.gap.own.composed import CHANGE, INPUT, OUTPUT, PORT

BEYOND = 1.5  # tolerances, below which an error of a parameter is ordinary
_HZ = (3.0, 6.0, 12.0, 24.0, 48.0)
_LARGE = 1e300  # no upper bound


@dataclass(frozen=True)
class PortScale:
    """Force that moves a port as far as it was seen moving, its speed, where it was, and the largest force to expect.

    The first is small where windows are long beside the motion; what an actuator gives is of the size of what it
    works against. `unit` is that of its position, where a sensor reads it.
    """

    force: float
    speed: float
    low: float
    high: float
    largest: float = 0.0
    unit: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "largest", max(self.largest, 3.0 * self.force))

    @property
    def travel(self) -> float:
        """Width of the range."""
        return self.high - self.low


@dataclass(frozen=True)
class Scales:
    """What occurs in a run: by input its largest command and the one exceeded half of the time, by output, by port.

    `rare` has commands that are exceeded seldom, from which a limit may be looked for.
    """

    window_s: float
    command: Mapping[str, tuple[float, float]]
    output: Mapping[str, float]
    port: Mapping[str, PortScale]
    rare: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


def forms(model: Model, s: Scales) -> tuple[EffectForm, ...]:
    """Every form of every kind at every place that can have it."""
    own = [f for i in model.inputs if i.acts for f in _actuator(i, s)
           if f.effect.split("@")[0] not in i.without]  # fmt: skip
    own += [f for o in model.outputs for f in _sensor(o, s)]
    own += [f for p in model.ports for f in _port(p, s)]
    own += [f for p in model.ports if p.motor_inertia for f in _coupling(p, model.values(), s)]
    own += [f for p in model.parameters if p.effect != NO_EFFECT for f in _parameter(p, model)]
    return tuple(f for f in own if f.effect.split("@")[0] not in model.without)


def spread(model: Model) -> tuple[Spread, ...]:
    """Manufacturing tolerances: of parameters, and of the gain of inputs."""
    scaled = [Spread(p.name, (p.name,), p.tolerance) for p in model.parameters if p.tolerance and p.value]
    gains = [Spread(i.name, (f"{INPUT}.{i.name}.gain",), i.tolerance, adds=True) for i in model.inputs if i.tolerance]
    return (*scaled, *gains)


def _form(
    kind: str, place: str, form: str, unit: str, free: tuple[Free, ...], fixed: Mapping[str, float] | None = None,
    usual: tuple[float, float] = (0.0, _LARGE), source: str = "",
) -> EffectForm:  # fmt: skip
    return EffectForm(f"{kind}@{place}", form, place, unit, free, fixed or {}, {}, 1.0, usual, source)


def _late(kind: str, place: str, at: str, s: Scales) -> Iterator[EffectForm]:
    longest, starts = 50.0 * s.window_s, (3.0 * s.window_s, 12.0 * s.window_s)
    delay, lag = (Free(f"{at}.{name}_ms", 0.0, longest, starts) for name in ("delay", "lag"))
    yield _form(f"{kind}_delay", place, "delay", "ms", (delay,), source="transport, computing")
    yield _form(f"{kind}_lag", place, "first order", "ms", (lag,), source="amplifier, filter")
    yield _form(f"{kind}_lag", place, "second order", "ms", (lag,), {f"{at}.lag_order": 2.0}, source="filter")


def _actuator(i: Input, s: Scales) -> Iterator[EffectForm]:
    at, (peak, usual) = f"{INPUT}.{i.name}", s.command[i.name]
    gain = Free(f"{at}.gain", -0.9, 3.0, (-0.15, 0.15))
    rare = (*s.rare.get(i.name, ()), *(share * peak for share in (0.95, 0.8, 0.65, 0.5)))
    limits = tuple(sorted({v for v in rare if usual < v <= peak})) or (0.99 * peak,)
    yield from _late("actuator", i.name, at, s)
    yield _form("actuator_gain_error", i.name, "gain", "1", (gain,), usual=(BEYOND * i.tolerance, _LARGE))
    yield _form("actuator_saturation", i.name, "cut", i.unit, (Free(f"{at}.limit", usual, peak, limits),))
    knee = Free(f"{at}.knee", 0.02, 1.0, (0.15,))
    yield _form("actuator_saturation", i.name, "bent", i.unit, (Free(f"{at}.limit", usual, 2.0 * peak, limits), knee))
    dead = (0.02 * peak, 0.3 * usual) if usual > 0.0 else (0.02 * peak,)
    yield _form("dead_zone", i.name, "subtracted", i.unit, (Free(f"{at}.dead", 0.0, 0.7 * peak, dead),))
    yield _form("dead_zone", i.name, "below a threshold", i.unit, (Free(f"{at}.jump", 0.0, 0.7 * peak, dead),))


def _sensor(o: Output, s: Scales) -> Iterator[EffectForm]:
    at, largest = f"{OUTPUT}.{o.name}", s.output[o.name]
    yield from _late("sensor", o.name, at, s)
    yield _form("sensor_gain", o.name, "gain", "1", (Free(f"{at}.gain", -0.9, 1.0, (-0.05, 0.05)),))
    offset = Free(f"{at}.offset", -largest, largest, (-0.1 * largest, 0.1 * largest))
    yield _form("sensor_offset", o.name, "constant", o.unit, (offset,))


def _per(p: Port, x: PortScale, seconds: str = "") -> str:
    """Unit of a port's force over its position, or its speed: "N m s/rad"."""
    if not x.unit:
        return f"{p.unit} per {'speed' if seconds else 'travel'}".strip()
    return f"{p.unit}{f' {seconds}' if seconds else ''}/{x.unit}"


def _dry(p: Port, s: Scales) -> Iterator[EffectForm]:
    """Coulomb friction; that of a gear grows with what it transmits, where its input gives anything."""
    at, x, kind = f"{PORT}.{p.name}", s.port[p.name], "coulomb_friction"
    level = Free(f"{at}.coulomb", 0.0, x.largest, (0.03 * x.force, 0.2 * x.force, 0.05 * x.largest))
    slow = Free(f"{at}.coulomb_speed", 1e-4 * x.speed, 0.3 * x.speed, (0.01 * x.speed,))
    bend = Free(f"{at}.bristle", 1e-5 * x.travel, 0.05 * x.travel, (3e-3 * x.travel,))
    share = Free(f"{at}.stribeck", 0.05, 3.0, (0.4,))
    fall = Free(f"{at}.stribeck_speed", 5e-3 * x.speed, x.speed, (0.1 * x.speed,))
    bias = Free(f"{at}.asymmetry", -0.6, 0.6, (0.1,))
    yield _form(kind, p.name, "tanh", p.unit, (level, slow), source="Coulomb")
    yield _form(kind, p.name, "bristles", p.unit, (level, bend), source="Dahl 1968")
    yield _form(kind, p.name, "higher at break-away", p.unit, (level, slow, share, fall), source="Stribeck 1902")
    yield _form(kind, p.name, "of each direction", p.unit, (level, slow, bias))
    yield _form(kind, p.name, "bristles, higher at break-away, of each direction", p.unit,
                (level, bend, share, fall, bias), source="Canudas de Wit 1995")  # fmt: skip
    if (most := s.command[p.input][0]) > 0.0:
        load, back = Free(f"{at}.load", 0.0, 1.0, (0.1,)), Free(f"{at}.driven_back", 0.0, 1.0, (0.1,))
        soft = replace(slow, starts=(0.03 * x.speed,))  # fits that start sharper stay in local minima
        stuck = Free(f"{at}.load_stribeck", 0.0, 5.0, (0.5,))
        square = Free(f"{at}.load_square", 0.0, 1.0 / most, (0.1 / most,))
        for form, more, source in (
            ("grows with the load", (), "Duclusaud 2024, M3"),
            ("grows with the load, more when driven back", (back,), "after Duclusaud 2024, M5"),
            ("grows with the load, either higher at break-away", (share, fall, stuck), "Duclusaud 2024, M4"),
            ("grows with the load and its square, more when driven back", (back, square), "after Duclusaud 2024, M6"),
        ):
            yield replace(_form(kind, p.name, form, p.unit, (level, soft, load, *more), source=source), extends=kind)


def _port(p: Port, s: Scales) -> Iterator[EffectForm]:
    at, x = f"{PORT}.{p.name}", s.port[p.name]
    per_speed, per_travel = x.force / x.speed, x.force / x.travel
    most_per_speed, most_per_travel = x.largest / x.speed, x.largest / x.travel
    viscous = Free(f"{at}.viscous", -per_speed, most_per_speed, (-0.1 * per_speed, 0.1 * per_speed))
    stiff = Free(f"{at}.stiffness", 0.0, 3.0 * most_per_travel, (0.1 * per_travel, 0.1 * most_per_travel))
    rests = tuple(x.low + share * x.travel for share in (0.2, 0.5, 0.8))
    rest = Free(f"{at}.rest", x.low - x.travel, x.high + x.travel, rests)
    hard = Free(f"{at}.hardening", 0.0, 30.0 / x.travel**2, (2.0 / x.travel**2,))
    constant = Free(f"{at}.offset", -x.largest, x.largest, (-0.1 * x.force, 0.1 * x.force))
    yield from _dry(p, s)
    power = Free(f"{at}.viscous_power", -0.5, 1.5, (-0.3, 0.6))  # below the root of the speed it is dry friction
    yield _form("viscous_error", p.name, "viscous", _per(p, x, "s"), (viscous,))
    yield _form("viscous_error", p.name, "power of the speed", _per(p, x, "s"), (viscous, power),
                {f"{at}.viscous_speed": x.speed})  # fmt: skip
    square = Free(f"{at}.viscous_square", 0.0, 1.0, (0.5,))
    yield _form("viscous_error", p.name, "linear and with the square of the speed", _per(p, x, "s"),
                (viscous, square), {f"{at}.viscous_speed": x.speed}, source="Morison 1950")  # fmt: skip
    yield _form("cable_stiffness", p.name, "linear", _per(p, x), (stiff, rest))
    yield _form("cable_stiffness", p.name, "hardening", _per(p, x), (stiff, rest, hard))
    yield _form("force_offset", p.name, "constant", p.unit, (constant,))


def _coupling(p: Port, values: Mapping[str, float], s: Scales) -> Iterator[EffectForm]:
    """A spring, or play, between motor and load; the nominal damping acts at the load, or at the motor."""
    at, x, inertia = f"{PORT}.{p.name}", s.port[p.name], values[str(p.motor_inertia)]
    per_hz2 = (2.0 * np.pi) ** 2 * inertia
    rigid = {f"{at}.inertia": inertia, f"{CHANGE}.{p.motor_inertia}": -inertia * (1.0 - 1e-6)}
    sides = {"": rigid}
    if p.motor_damping and (damping := values[p.motor_damping]) > 0.0:
        sides[", damped at the motor"] = rigid | {
            f"{at}.motor_damping": damping, f"{CHANGE}.{p.motor_damping}": -damping * (1.0 - 1e-6)
        }  # fmt: skip
    stiff = Free(f"{at}.coupling", per_hz2, 1e4 * per_hz2, tuple(per_hz2 * hz**2 for hz in _HZ), 0.05)
    loss = Free(f"{at}.coupling_damping", 0.0, 30.0 * inertia, (0.5 * inertia,))
    bend = x.force / per_hz2 / _HZ[-1] ** 2
    hard = Free(f"{at}.coupling_hardening", 0.0, 10.0 / bend**2, (0.1 / bend**2,))
    widths = tuple(share * x.travel for share in (0.003, 0.01, 0.03))
    play = Free(f"{at}.play", 0.0, 0.2 * x.travel, widths)
    stop = {f"{at}.coupling": 2e3 * per_hz2, f"{at}.coupling_damping": 200.0 * inertia}
    unit = _per(p, x)
    for side, fixed in sides.items():
        yield _form("joint_flexibility", p.name, f"spring{side}", unit, (stiff, loss), fixed, source="two inertias")
        yield _form("backlash", p.name, f"play before a stiff spring{side}", "", (play,), fixed | stop,
                    source="dead zone of a coupling")  # fmt: skip
    yield _form("joint_flexibility", p.name, "hardening spring", unit, (stiff, loss, hard), rigid)


def _parameter(p: ModelParameter, model: Model) -> Iterator[EffectForm]:
    """Absolute change of a parameter beyond its tolerance, alone and with the one that shapes it."""
    kind, _, place = p.effect.partition("@")
    free, least = _changed(p), BEYOND * p.tolerance * abs(p.value)
    yield _form(kind, place, f"change of {p.name}", p.unit, (free,), usual=(least, _LARGE))
    if p.shaped_by:
        other = next(o for o in model.parameters if o.name == p.shaped_by)
        yield _form(kind, place, f"change of {p.name} and {other.name}", p.unit, (free, _changed(other)),
                    usual=(least, _LARGE))  # fmt: skip


def _changed(p: ModelParameter) -> Free:
    low, high = p.range if p.range is not None else sorted((-0.8 * p.value, 4.0 * p.value))
    starts = tuple(v for v in (0.05 * low, 0.3 * low, 0.05 * high, 0.3 * high) if v != 0.0)
    if p.range is None:
        starts = (-0.15 * p.value, 0.15 * p.value)
    return Free(f"{CHANGE}.{p.name}", low, high, p.starts or starts)
