"""What names of columns say in many houses' habits: a unit, and the part that a signal plays in a loop."""

from __future__ import annotations

import re
import unicodedata
from enum import StrEnum

from loopshape.core.units import UNITS


class Role(StrEnum):
    """The part of a signal in a loop, as drawn in `loopshape.loop.loop`; each is also its word."""

    TIME = "time"
    REFERENCE = "reference"
    INJECTED = "injected"
    CONTROL = "control"
    OUTPUT = "output"
    ERROR = "error"


_UNIT_WORDS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sek": "s", "msec": "ms", "usec": "us", "µs": "us",
    "μs": "us", "microseconds": "us", "milliseconds": "ms", "nsec": "ns", "°": "deg", "degree": "deg", "degrees": "deg",
    "grad": "deg", "radian": "rad", "radians": "rad", "rads": "rad", "volt": "V", "volts": "V", "amp": "A", "amps": "A",
    "ampere": "A", "newton": "N", "newtons": "N", "µm": "um", "μm": "um", "micron": "um", "microns": "um", "meter": "m",
    "metre": "m", "meters": "m", "n·m": "Nm", "n*m": "Nm", "n.m": "Nm", "n-m": "Nm", "rad/sec": "rad/s",
    "rad/s": "rad/s", "°/s": "deg/s", "deg/s": "deg/s", "dps": "deg/s", "1/min": "rpm", "u/min": "rpm", "m/s^2": "m/s2",
    "m/s²": "m/s2", "m/s/s": "m/s2", "-": "1", "none": "1", "count": "1", "counts": "1", "inc": "1", "%": "1",
    "pu": "1", "p.u.": "1", "norm": "1", "arms": "A", "a rms": "A", "apk": "A", "a pk": "A", "vrms": "V", "v rms": "V",
    "vpk": "V",
}  # fmt: skip
_LOWER = {unit.lower(): unit for unit in UNITS if unit not in ("Pa", "MPa", "nm", "Nm", "N m", "1", "m", "MPa")}
_BRACKETED = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")
_AFTER_SLASH = re.compile(r"\s+/\s*(\S.*)$")
_TAIL = re.compile(r"[_ ]([^_ ]+)$")

_TIME = {"t", "time", "zeit", "timestamp", "timestamps", "stamp", "temps", "tiempo", "clock", "date", "datetime",
         "uhrzeit", "zeitstempel", "utc", "elapsed", "sec", "secs", "seconds", "ms", "us"}  # fmt: skip
#: words of a role and their weight: what says which signal goes before what says of what quantity it is
_WEIGHTS: dict[Role, dict[str, float]] = {
    Role.REFERENCE: {
        **dict.fromkeys(("r", "ref", "reference", "setpoint", "sp", "soll", "sollwert", "target", "targets",
                         "desired", "des", "demand", "goal", "trajectory", "traj", "setp", "consigne", "riferimento",
                         "referencia", "referentie", "führungsgröße", "fuehrungsgroesse"), 6.0),
        **dict.fromkeys(("cmd", "command", "commanded", "set", "profile", "input", "w"), 2.5),
    },
    Role.INJECTED: {
        **dict.fromkeys(("inj", "injected", "injection", "exc", "excitation", "chirp", "sweep", "prbs", "multisine",
                         "dither", "perturbation", "stimulus", "anregung", "störgröße", "stoergroesse", "disturbance",
                         "noise", "probe"), 6.0),
        **dict.fromkeys(("dist", "n", "d"), 2.5),
    },
    Role.CONTROL: {
        **dict.fromkeys(("u", "control", "ctrl", "controller", "effort", "duty", "pwm", "dac", "stell", "stellgroesse",
                         "stellgröße", "actuator", "plantinput", "mv", "co", "comando", "commande"), 4.0),
        **dict.fromkeys(("voltage", "volt", "volts", "current", "iq", "torque", "force", "drive", "motor", "strom",
                         "spannung", "moment", "thrust", "z", "valve", "amp", "i", "trq"), 2.0),
        **dict.fromkeys(("sum", "pidsum"), 3.0),
    },
    Role.OUTPUT: {
        **dict.fromkeys(("y", "actual", "act", "ist", "istwert", "meas", "measured", "measurement", "feedback", "fb",
                         "fbk", "pv", "response", "sensor", "mesure", "misura", "medida", "sortie", "uscita",
                         "salida", "regelgröße", "regelgroesse"), 4.0),
        **dict.fromkeys(("pos", "position", "angle", "theta", "phi", "enc", "encoder", "velocity", "vel", "speed", "x",
                         "displacement", "gap", "height", "temperature", "pressure", "winkel", "weg", "drehzahl",
                         "acceleration", "accel", "acc", "gyro", "rate", "level", "output", "out", "q", "posizione",
                         "posicion", "hoek"), 2.0),
    },
    Role.ERROR: dict.fromkeys(("e", "err", "error", "regelabweichung", "regeldifferenz", "following",
                               "deviation", "schleppfehler"), 9.0),
}  # fmt: skip


#: a weight from which on a name alone tells a part; what weighs less is a hint, which measurements must confirm
TELLING = 3.5
_LETTERS = "uyre"  # that stand before a word in names as yref, ymeas, ucmd
_AXES = {"x", "y", "z"}  # behind another word: an axis of space, as in pose_z
_INFLECTED = {"s", "es", "e", "en", "er", "ed", "ing", "n"}
_FROM_OUTSIDE = {Role.REFERENCE, Role.INJECTED, Role.ERROR}
#: words of what is worked out of signals, or tells of them: such a column has no part in a loop
_NO_SIGNAL = {"psd", "asd", "csd", "spectrum", "coherence", "efficiency", "wirkungsgrad", "std", "var", "variance",
              "covariance", "status", "state", "flag", "flags", "mode", "index", "counter", "checksum", "crc",
              "quality", "snr", "fft", "frequency", "freq", "frequenz"}  # fmt: skip
_DRIVING = {"V", "mV", "A", "mA", "N", "kN", "Nm", "N m"}
_ORDERS = {"cmd", "command", "commanded", "input", "reference", "ref"}
_CONTAINERS = {"values", "value", "data", "signals", "time"}


def unit_of_word(word: str) -> str | None:
    """The unit that a word stands for, as `core.units` writes it; None for one that is not known."""
    plain = word.strip().strip("[]()").strip()
    if plain in UNITS:
        return plain
    return _UNIT_WORDS.get(plain.lower()) or _LOWER.get(plain.lower())


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without its unit, and the word for the unit that it bears ("" for none)."""
    if found := _BRACKETED.search(name):
        return name[: found.start()].strip() or name, found[1].strip()
    if found := _AFTER_SLASH.search(name):
        return name[: found.start()].strip(), found[1].strip()
    for tail in ("rad_s2", "rad_s", "deg_s", "m_s2", "m_s"):
        if name.lower().endswith("_" + tail):
            return name[: -len(tail) - 1], tail.replace("_", "/", 1)
    found = _TAIL.search(name)
    if found and len(found[1]) > 0 and (unit := unit_of_word(found[1])) and unit != "1" and found.start() > 0:
        stem = name[: found.start()]
        return stem, "Nm" if found[1] == "nm" and _drives(stem) else found[1]
    return name, ""


def _drives(stem: str) -> bool:
    """Whether the words of a name say that something is driven: behind them nm is N m, not nanometres."""
    weights = _WEIGHTS[Role.CONTROL]
    return any(word in weights for word in re.split(r"[^a-zäöüß]+", stem.lower()))


def words_of(name: str) -> tuple[str, ...]:
    """The words of a name in lower case: parts between signs, figures and humps."""
    humps = re.sub(r"(?<=[a-zäöüß])(?=[A-Z])", " ", split_unit(name)[0])
    words = [word for word in re.split(r"[^A-Za-zÄÖÜäöüß]+", humps.lower()) if word]
    return tuple(part for word in words for part in _parted(word))


def _parted(word: str) -> tuple[str, ...]:
    """A signal's letter and the word behind it, of a name such as yref; any other word itself."""
    letter, rest = word[:1], word[1:]
    known = any(rest in weights for weights in _WEIGHTS.values())
    whole = any(word in weights for weights in _WEIGHTS.values())
    return (letter, rest) if letter in _LETTERS and len(rest) > 2 and known and not whole else (word,)


def is_time(name: str) -> bool:
    """Whether a name says time."""
    words = words_of(name)
    return bool(set(words) & _TIME) and not role_weights(name)


def role_weights(name: str) -> dict[Role, float]:
    """How strongly the words of a name speak for each part in a loop; nothing where none does."""
    parts = parts_of(name) or [name]
    last, whole = _weights(parts[-1]), _weights(" ".join(parts))
    if len(parts) == 1 or words_of(parts[-1]) in [("x",), ("z",)]:  # an axis, of what stands before it
        return whole
    outer = any(_weights(part).keys() & _FROM_OUTSIDE for part in parts[:-1])  # cmd.position is no position
    return (whole if outer else last) or whole


def parts_of(name: str) -> list[str]:
    """The parts of a path such as `rec.enc1 (mm).Data`, without what says only that something is held."""
    inner = re.split(r"[./](?![^\[(]*[\])])", name)
    return [part for part in inner if part and part.strip().lower() not in _CONTAINERS]


def _weights(name: str) -> dict[Role, float]:
    words = words_of(name)
    if set(words) & _NO_SIGNAL:
        return {}
    shares = _shares(words)
    found = {
        role: sum(share * _weight(weights, word) for word, share in zip(words, shares, strict=True))
        for role, weights in _WEIGHTS.items()
    }
    drives = found[Role.CONTROL] > 0.0 or unit_of_word(split_unit(name)[1] or "?") in _DRIVING
    moves = found[Role.OUTPUT] > 0.0
    if drives and not moves and set(words) & _ORDERS:  # a commanded voltage is the control, a position the reference
        found[Role.CONTROL] += found[Role.REFERENCE]
        found[Role.REFERENCE] = 0.0
    return {role: weight for role, weight in found.items() if weight > 0.0}


def _shares(words: tuple[str, ...]) -> tuple[float, ...]:
    """How far each word counts: a letter whole alone or beside known words, half beside others, an axis not at all."""
    others = [word for word in words if len(word) > 1]
    known = all(any(_weight(weights, word) for weights in _WEIGHTS.values()) for word in others)
    return tuple(
        1.0 if len(word) > 1 else 0.0 if k and word in _AXES else 1.0 if known else 0.5 for k, word in enumerate(words)
    )


def _weight(weights: dict[str, float], word: str) -> float:
    """A word's weight; one that goes on behind a known one of three letters or more counts half.

    What follows must be an ending or a known word, unless the known one is long: a distance is no disturbance.
    """
    if word in weights:
        return weights[word]
    stems = (known for known in weights if len(known) > 2 and word.startswith(known) and _goes_on(word, known))
    return 0.5 * max((weights[known] for known in stems), default=0.0)


def _goes_on(word: str, known: str) -> bool:
    rest = word[len(known) :]
    whole_stem = 6  # letters of a known word from which on whatever begins with it is meant
    return len(known) >= whole_stem or rest in _INFLECTED or any(rest in weights for weights in _WEIGHTS.values())


#: letters that ASCII writes with two
_WRITTEN = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "ø": "oe", "æ": "ae"})


def column_name(name: str, suffix: str, taken: set[str]) -> str:
    """A stored column's name: letters, figures and underscores, its unit at the end, and no other column's."""
    plain = unicodedata.normalize("NFKD", split_unit(name)[0].lower().translate(_WRITTEN))
    plain = re.sub(r"[^a-z0-9]+", "_", re.sub("[\u0300-\u036f]", "", plain)).strip("_") or "column"
    plain = f"c_{plain}" if plain[0].isdigit() else plain
    made, k = f"{plain}_{suffix}", 2
    while made in taken or made == "t_s":
        made, k = f"{plain}_{k}_{suffix}", k + 1
    return made
