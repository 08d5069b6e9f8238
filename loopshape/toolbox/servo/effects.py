"""The servo axis' catalogue of effects: every form, its bounds and its source.

Magnitudes do not depend on the form: Coulomb level (the mean of both directions) of the frictions, constant force,
N/m3, whole play, largest force, free-free frequency, low-frequency delay. Bounds and starts go with the scales of the
recordings, since an axis may carry grams or tonnes. What makes a friction asymmetric, or Stribeck's, is bounded away
from zero: at zero it would be Coulomb friction by another name.
"""

from __future__ import annotations

from collections.abc import Mapping

from loopshape.toolbox.gap.nouns.effect import EffectForm, Free
from loopshape.toolbox.servo.nominal import Scales

#: a stroke of 0.25 m under some 100 N at 1 kHz: the scales of an axis of which no recording is at hand
USUAL = Scales(55.0, 150.0, 0.12, -0.125, 0.125, 1000.0)

_BLOCKS = {
    "guide": ("coulomb_friction", "asymmetric_friction", "stribeck_friction"),
    "spring": ("hardening_stiffness",),
    "drive": ("force_offset", "force_saturation"),
    "transmission": ("backlash", "flexibility"),
    "controller": ("loop_delay",),
}
_JANOT = "Janot, Gautier and Brunot 2019"
BLOCKS: Mapping[str, str] = {effect: block for block, effects in _BLOCKS.items() for effect in effects}


def _form(
    effect: str,
    form: str,
    unit: str,
    *free: Free,
    fixed: Mapping[str, float] | None = None,
    scale: float = 1.0,
    source: str = "",
) -> EffectForm:
    usual = (free[0].low * scale, free[0].high * scale)
    extends = "coulomb_friction" if effect in ("asymmetric_friction", "stribeck_friction") else ""
    block = BLOCKS.get(effect, "guide")
    return EffectForm(effect, form, block, unit, free, fixed or {}, {}, scale, usual, source, extends)


def _free(parameter: str, low: float, high: float, *starts: float) -> Free:
    step = 0.01 if parameter.endswith("_hz") else 0.1  # a tenth would step over a resonance
    return Free(parameter, low, high, starts, step)


def forms(s: Scales = USUAL) -> tuple[EffectForm, ...]:
    """All forms of all effects at these scales."""
    return (*_frictions(s), *_forces(s), *_transmissions(s), *_delays())


def _frictions(s: Scales) -> tuple[EffectForm, ...]:
    level = _free("coulomb_n", 0.0, s.peak_n, 0.1 * s.force_n, 0.4 * s.force_n)
    speed = _free("coulomb_m_s", 1e-4 * s.speed_m_s, 0.2 * s.speed_m_s, 0.01 * s.speed_m_s)
    dahl = _free("presliding_n", 0.0, s.peak_n, 0.1 * s.force_n, 0.4 * s.force_n)
    travel = _free("presliding_m", 1e-6 * s.travel_m, 2e-2 * s.travel_m, 1e-4 * s.travel_m)
    either = _free("coulomb_asymmetry", -1.0, 1.0, -0.1, 0.1)
    up, down = (0.05, 1.0, 0.2), (-1.0, -0.05, -0.2)
    share = _free("stribeck_share", 0.1, 4.0, 0.5)
    stribeck = _free("stribeck_m_s", 5e-3 * s.speed_m_s, 0.5 * s.speed_m_s, 0.05 * s.speed_m_s)
    return (
        _form("coulomb_friction", "tanh Coulomb", "N", level, speed, source="Coulomb"),
        _form("coulomb_friction", "presliding", "N", dahl, travel, source="Dahl 1968"),
        _form("asymmetric_friction", "level higher upwards", "N", level, speed, _free("coulomb_asymmetry", *up),
              source=_JANOT),
        _form("asymmetric_friction", "level higher downwards", "N", level, speed, _free("coulomb_asymmetry", *down),
              source=_JANOT),
        _form("asymmetric_friction", "more viscous upwards", "N", level, speed, _free("viscous_asymmetry", *up), either,
              source=_JANOT),
        _form("asymmetric_friction", "more viscous downwards", "N", level, speed, _free("viscous_asymmetry", *down),
              either, source=_JANOT),
        _form("stribeck_friction", "Gaussian", "N", level, speed, share, stribeck,
              source="Stribeck 1902, Armstrong-Helouvry 1991"),
        _form("stribeck_friction", "exponential", "N", level, speed, share, stribeck,
              fixed={"stribeck_power": 1.0}, source="Stribeck 1902, Tustin 1947"),
    )  # fmt: skip


def _forces(s: Scales) -> tuple[EffectForm, ...]:
    offset = _free("force_offset_n", -s.peak_n, s.peak_n, -0.1 * s.force_n, 0.1 * s.force_n)
    travel_m = max(abs(s.low_m), abs(s.high_m))
    centre = _free("cubic_centre_m", s.low_m, s.high_m, *(s.low_m + share * s.travel_m for share in (0.3, 0.7)))
    about_zero = s.force_n / travel_m**3
    about_middle = s.force_n / (0.5 * s.travel_m) ** 3
    limit = _free("force_limit_n", 0.01 * s.peak_n, 1.05 * s.peak_n, *(0.9 * 0.65**k * s.peak_n for k in range(9)))
    soft = _free("force_limit_n", 0.01 * s.peak_n, 10.0 * s.peak_n, *(3.0 * 0.5**k * s.peak_n for k in range(8)))
    return (
        _form("force_offset", "constant", "N", offset, source="weight, drive's zero"),
        _form("hardening_stiffness", "cubic about zero", "N/m3",
              _free("cubic_n_m3", 0.0, 10.0 * about_zero, 0.1 * about_zero, about_zero), source="Duffing 1918"),
        _form("hardening_stiffness", "cubic about a centre", "N/m3",
              _free("cubic_n_m3", 0.0, 10.0 * about_middle, 0.1 * about_middle, about_middle),
              centre, source="Duffing 1918"),
        _form("force_saturation", "cut", "N", limit, source="amplifier's limit"),
        _form("force_saturation", "bent", "N", soft, fixed={"force_limit_soft": 1.0}, source="saturating iron"),
    )  # fmt: skip


def _transmissions(s: Scales) -> tuple[EffectForm, ...]:
    widest = 0.05 * s.travel_m
    fine = [5e-5 * s.travel_m * 1.35**k for k in range(20)]  # a play and a resonance are seen from near alone
    coarse = fine[::3]
    rate = s.rate_hz
    lowest = min(2.0, 0.006 * rate)
    hz = _free("flexible_hz", lowest, 0.25 * rate, *(0.006 * rate * 1.2**k for k in range(15)))
    damping = _free("flexible_damping", 0.0, 0.5, 0.1)
    stiff = {"flexible_share": 0.5, "flexible_hz": 0.05 * rate, "flexible_damping": 0.3}
    return (
        _form("backlash", "before the sensor", "mm", _free("sensor_play_m", 0.0, widest, *fine), scale=1e3,
              source="play operator"),
        _form("backlash", "before half the mass", "mm", _free("drive_play_m", 0.0, widest, *coarse), fixed=stiff,
              scale=1e3, source="dead zone of a stiff coupling"),
        _form("flexibility", "30 % of the mass beyond", "Hz", hz, damping, fixed={"flexible_share": 0.3},
              source="two masses, position of the driven one"),
        _form("flexibility", "a share of the mass beyond", "Hz", hz, damping,
              _free("flexible_share", 0.02, 0.9, 0.15, 0.4), source="two masses, position of the driven one"),
    )  # fmt: skip


def _delays() -> tuple[EffectForm, ...]:
    return (
        _form("loop_delay", "the force comes late", "ms", _free("loop_delay_ms", 0.0, 60.0, 2.0, 8.0),
              source="computing and transport"),
        _form("loop_delay", "the force lags", "ms", _free("force_lag_ms", 0.0, 60.0, 2.0, 8.0),
              source="first-order amplifier"),
    )  # fmt: skip


def quadratic_drag(s: Scales = USUAL) -> EffectForm:
    """A rival that is no effect of this plant: drag with the square of the speed, of either sign."""
    usual = s.force_n / s.speed_m_s**2
    return _form("quadratic_drag", "square of the speed", "N s2/m2",
                 _free("drag_ns2_m2", -5.0 * usual, 5.0 * usual, -usual, usual))  # fmt: skip
