"""Excitations and setpoints of a study file: user's units at the door, stored units inside.

| kind | keys |
|---|---|
| sweep | f_low_hz, f_high_hz, duration_s, amplitude_<unit>, ramp_s, spacing ("linear" or "logarithmic") |
| multisine | f_low_hz, f_high_hz, period_s, amplitude_<unit>, periods, seed, odd, ramp_s, lines_hz, crest_iterations, |
|           | turn, turns (phase added to every line in cycles, one of so many equal turns), levels (of each line) |
| prbs | order, clock_s, amplitude_<unit>, periods, seed |
| noise | f_low_hz, f_high_hz, duration_s, amplitude_<unit> (standard deviation), seed, ramp_s |
| staircase | times_s, values_<unit> |
| profile | times_s, values_<unit>, velocity_<unit>_s, acceleration_<unit>_s2, jerk_<unit>_s3 |

A unit is written in lower case (`amplitude_deg`, `values_mbar`); `nm` is N m. `excitations` is a table by loop of
multisines, or of noises; the first is the loop that a recording `excites`, the others those that it `excites_also`.
"""

from __future__ import annotations

from dataclasses import fields

from loopshape.core.errors import WrongUseError
from loopshape.core.units import to_stored
from loopshape.io.config_table import ConfigTable, said_in
from loopshape.io.schema import read
from loopshape.toolbox.rig.excitation.excitation import BandNoise, Excitation, Prbs, Sweep
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.excitation.setpoints import Profile, Staircase
from loopshape.toolbox.rig.files.excitation_sets import LOOP_STEP
from loopshape.toolbox.rig.study import Setpoint

_EXCITATIONS: dict[str, type[Sweep | Multisine | Prbs | BandNoise]] = {
    "sweep": Sweep,
    "multisine": Multisine,
    "prbs": Prbs,
    "noise": BandNoise,
}
#: a unit in a key -> the unit's name in `units`
KEY_UNITS = {unit.lower(): unit for unit in ("deg", "rad", "mrad", "bar", "mbar", "kPa", "psi", "V", "mV", "A", "mA")}
KEY_UNITS |= {"n": "N", "kn": "kN", "nm": "N m", "m": "m", "mm": "mm", "um": "um", "rpm": "rpm"}
_LIMITS = {"velocity": "_s", "acceleration": "_s2", "jerk": "_s3"}


def _unit_of(words: ConfigTable, quantity: str) -> str:
    """The unit in a key such as `amplitude_deg`; refuses none, two, and unknown ones."""
    keys = [key for key in words.table if key == quantity or key.startswith(quantity + "_")]
    unit = keys[0].removeprefix(quantity + "_") if keys else ""
    if len(keys) != 1 or unit not in KEY_UNITS:
        raise WrongUseError(
            f"{words.where}: {quantity} is written once, with its unit",
            ", ".join(keys) or f"no {quantity}",
            f"write {quantity}_ and one of {', '.join(KEY_UNITS)}",
        )
    return unit


def read_excitation(words: ConfigTable, seed: int) -> tuple[Excitation, str]:
    """An excitation with its amplitude in the stored unit, and that unit's suffix; `seed` if it has none.

    Refuses unknown kinds and keys, missing keys, and numbers that the excitation refuses.
    """
    kind = words.one_of("kind", tuple(_EXCITATIONS))
    make = _EXCITATIONS[kind]
    unit = _unit_of(words, "amplitude")
    suffix, factor = to_stored(KEY_UNITS[unit])
    own = [f for f in fields(make) if f.name not in ("kind", "amplitude") and f.default is not None]
    own += [f for f in fields(make) if f.name == "lines_hz"]
    words.only("kind", f"amplitude_{unit}", *(f.name for f in own))
    table = {f.name: words.table[f.name] for f in own if f.name in words.table}
    if any(f.name == "seed" for f in own):
        table.setdefault("seed", seed)
    return read(make, table, words.where, amplitude=factor * words.number(f"amplitude_{unit}")), suffix


def read_excitations(words: ConfigTable, seed: int) -> tuple[dict[str, Excitation], dict[str, str]]:
    """Excitations of several loops at once, by loop, and the suffix of each one's unit.

    A loop without a seed of its own gets `seed` and an offset that no other loop gets. Refuses what
    `read_excitation` refuses, and turns: over the recordings they follow from the number of loops.
    """
    read = {}
    for k, loop in enumerate(words.table, start=1):
        one = words.inner(loop)
        if given := sorted({"turn", "turns"} & set(one.table)):
            raise WrongUseError(
                f"{one.where}: loops that are excited at once are turned by their number",
                ", ".join(given),
                "leave it out, or write an [[experiment]] with an excitation for each loop",
            )
        read[loop] = read_excitation(one, seed + k * LOOP_STEP)
    return {loop: made for loop, (made, _) in read.items()}, {loop: suffix for loop, (_, suffix) in read.items()}


def read_setpoints(words: ConfigTable) -> tuple[dict[str, Setpoint], dict[str, str]]:
    """Setpoints by loop in stored units, and the suffix of each one's unit."""
    read = {loop: _setpoint(words.inner(loop)) for loop in words.table}
    return {loop: setpoint for loop, (setpoint, _) in read.items()}, {
        loop: suffix for loop, (_, suffix) in read.items()
    }


def _setpoint(words: ConfigTable) -> tuple[Setpoint, str]:
    kind = words.one_of("kind", ("staircase", "profile"))
    unit = _unit_of(words, "values")
    limits = {name: f"{name}_{unit}{per}" for name, per in _LIMITS.items()} if kind == "profile" else {}
    words.only("kind", "times_s", f"values_{unit}", *limits.values())
    words.need("times_s", *limits.values())
    suffix, factor = to_stored(KEY_UNITS[unit])
    times, values = (words.value(key, tuple[float, ...]) for key in ("times_s", f"values_{unit}"))
    if not times:
        raise WrongUseError(
            f"{words.where}: a setpoint goes somewhere", "no times_s", "give at least one time and value"
        )
    stored = tuple(factor * value for value in values)
    with said_in(words.where):
        if kind == "staircase":
            return Staircase(times, stored), suffix
        velocity, acceleration, jerk = (factor * words.number(key) for key in limits.values())
        return Profile(times, stored, velocity, acceleration, jerk), suffix
