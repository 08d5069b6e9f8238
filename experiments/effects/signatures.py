"""What each effect should do, claim by claim, from the table of signatures; and whether a sheet shows it.

A claim gives one number and whether it holds. Bounds are common rules, made before scoring: a gain counts from 0.3 dB,
a phase from 1 deg, a static shift from 1 mbar, a distortion that rises by 6 dB; "none" in amplitude is less than a
quarter of the change itself between the small and the large excitation (1 to 7.5), "strong" more than half.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from loopshape.toolbox.gap.nouns.effect_sheet import EffectSheet, FrfChange

LOW, MID, RESONANCE, HIGH, BROAD = (0.15, 0.8), (1.0, 3.0), (3.5, 7.0), (8.0, 12.5), (0.3, 8.0)
U_T, U_P, P_T = "u -> theta2", "u -> p", "p -> theta2"
Answer = tuple[float, bool]


@dataclass(frozen=True)
class Claim:
    """What a signature says of an effect: the column of the table, words, the number's unit, and the test."""

    effect: str
    column: str
    words: str
    unit: str
    test: Callable[[EffectSheet], Answer]


def band(s: EffectSheet, path: str, where: tuple[float, float], recording: str = "middle") -> FrfChange:
    """A path's change in a band."""
    return s.frfs[recording, path].between(*where)


def gain(s: EffectSheet, path: str, where: tuple[float, float], recording: str = "middle") -> float:
    """Median change of the gain, dB."""
    found = band(s, path, where, recording).gain_db
    return float(np.median(found)) if found.size else float("nan")


def phase(s: EffectSheet, path: str, where: tuple[float, float], recording: str = "middle") -> float:
    """Median change of the phase, deg."""
    found = band(s, path, where, recording).phase_deg
    return float(np.median(found)) if found.size else float("nan")


def size(s: EffectSheet, path: str, recording: str = "middle", where: tuple[float, float] = BROAD) -> float:
    """Rms change relative to the response, %."""
    return 100.0 * band(s, path, where, recording).size


def quotient(one: float, two: float) -> float:
    """One size over another, no size being taken for less than 0.1 %."""
    return max(one, 0.1) / max(two, 0.1)


def by_amplitude(s: EffectSheet, path: str) -> float:
    """Rms difference of the change at small and at large excitation, over the larger of both changes."""
    small, large = band(s, path, BROAD, "small"), band(s, path, BROAD, "large")
    shared = np.intersect1d(small.frequency_hz, large.frequency_hz)
    if not shared.size:
        return float("nan")
    a, b = (x.ratio[np.isin(x.frequency_hz, shared)] for x in (small, large))
    noise = sum(float(np.mean(x.noise**2)) for x in (small, large))
    apart = float(np.sqrt(max(float(np.mean(np.abs(a - b) ** 2)) - noise, 0.0)))
    return apart / max(small.size, large.size, 1e-9)


def rise(s: EffectSheet, path: str, kind: str, recording: str = "middle") -> float:
    """By how much odd or even distortion rises, dB; nan where it cannot be told."""
    without, changed = s.distortion.get((recording, path, kind), (float("nan"), float("nan")))
    return changed - without


def static_mbar(s: EffectSheet) -> tuple[float, float]:
    """Median and half the 5-95 % span of the change of p_A - p_B at the same slowly moving setpoint, mbar."""
    change = s.times["statics", "p_d"]
    d = 1e3 * (change.changed - change.without)
    low, middle, high = np.percentile(d, [5.0, 50.0, 95.0])
    return float(middle), float(0.5 * (high - low))


def _of(effect: str, *claims: tuple[str, str, str, Callable[[EffectSheet], Answer]]) -> list[Claim]:
    return [Claim(effect, *claim) for claim in claims]


def no_amplitude(path: str) -> tuple[str, str, str, Callable[[EffectSheet], Answer]]:
    """The change is the same at small and at large excitation."""
    return ("amplitude", "none", "1", lambda s: (v := by_amplitude(s, path), v < 0.25))


def amplitude(word: str, path: str, least: float, most: float = np.inf) -> tuple:
    """The change depends on the amplitude, by at least and at most this share."""
    return ("amplitude", word, "1", lambda s: (v := by_amplitude(s, path), least <= v <= most))


def odd(path: str) -> tuple[str, str, str, Callable[[EffectSheet], Answer]]:
    """Odd distortion rises, and more than even does."""
    return ("odd/even", "odd", "dB", lambda s: (v := rise(s, path, "odd"), v > 6.0 and v > rise(s, path, "even")))


def even(path: str) -> tuple[str, str, str, Callable[[EffectSheet], Answer]]:
    """Even distortion rises."""
    return ("odd/even", "even", "dB", lambda s: (v := rise(s, path, "even"), v > 6.0))


def only(path: str, quiet: str) -> tuple[str, str, str, Callable[[EffectSheet], Answer]]:
    """Shows in one path and hardly in another: less than a third."""
    return (
        "shows in", f"{path}, not {quiet}", "1",
        lambda s: (v := quotient(size(s, quiet, where=RESONANCE), size(s, path, where=RESONANCE)), v < 0.33),
    )  # fmt: skip


def more_at(one: str, two: str, path: str, words: str) -> tuple[str, str, str, Callable[[EffectSheet], Answer]]:
    """Larger at one operating point than at another, by a quarter at least."""
    return ("depends on", words, "1", lambda s: (v := quotient(size(s, path, one), size(s, path, two)), v > 1.25))


def alike(one: str, two: str, path: str, words: str) -> tuple[str, str, str, Callable[[EffectSheet], Answer]]:
    """As large at one operating point as at another, within a third."""
    return (
        "depends on",
        words,
        "1",
        lambda s: (v := quotient(size(s, path, one), size(s, path, two)), 0.75 < v < 1.33),
    )


def below(words: str, path: str, where: tuple[float, float], db: float, recording: str = "middle") -> tuple:
    """The gain falls by so many dB at least."""
    return ("FRF", words, "dB", lambda s: (v := gain(s, path, where, recording), v < -db))


def moves_gain(words: str, path: str, where: tuple[float, float], db: float = 0.3, recording: str = "middle") -> tuple:
    """The gain moves by so many dB at least."""
    return ("FRF", words, "dB", lambda s: (v := gain(s, path, where, recording), abs(v) > db))


def lags(words: str, path: str, where: tuple[float, float], deg: float = 1.0, recording: str = "middle") -> tuple:
    """The phase falls by so many degrees at least."""
    return ("FRF", words, "deg", lambda s: (v := phase(s, path, where, recording), v < -deg))


def leads(words: str, path: str, where: tuple[float, float], deg: float = 1.0, recording: str = "middle") -> tuple:
    """The phase rises by so many degrees at least."""
    return ("FRF", words, "deg", lambda s: (v := phase(s, path, where, recording), v > deg))


def quiet(words: str, path: str, percent: float = 3.0) -> tuple:
    """The path changes by less than this."""
    return ("FRF", words, "%", lambda s: (v := size(s, path), v < percent))


def linear_phase(path: str) -> tuple:
    """A delay: the lag at 8-12.5 Hz is that at 3.5-7 Hz times the ratio of frequencies, within a fifth; no gain."""

    def test(s: EffectSheet) -> Answer:
        one, two = band(s, path, RESONANCE), band(s, path, HIGH)
        delays = [float(np.median(-x.phase_deg / (0.36 * x.frequency_hz))) for x in (one, two)]  # deg/(deg/ms)
        return delays[0], delays[0] > 0.5 and abs(delays[1] / delays[0] - 1.0) < 0.2

    return ("FRF", "linear phase", "ms", test)


def shifts(words: str = "static offset") -> tuple:
    """Another pressure difference holds the same angle, on average."""
    return ("shows in", words, "mbar", lambda s: (v := static_mbar(s)[0], abs(v) > 1.0))


def bends(words: str) -> tuple:
    """... or one that grows with the angle."""
    return ("shows in", words, "mbar", lambda s: (v := static_mbar(s)[1], v > 1.5))


def drifts(words: str, signal: str, factor: float, unit: str, least: float) -> tuple:
    """With the valves shut a signal goes where it did not, in 4 s."""

    def test(s: EffectSheet) -> Answer:
        change = s.times["shut", signal]
        v = factor * float(change.changed[-1] - change.without[-1])
        return v, abs(v) > least

    return ("shows in", words, unit, test)


def _sum_gain(s: EffectSheet) -> float:
    found = s.frfs["pressure", U_P].between(0.2, 3.0)
    return float(np.median(found.gain_db))


def _inverse(s: EffectSheet) -> Answer:
    v = phase(s, U_P, RESONANCE) + phase(s, P_T, RESONANCE)
    return v, abs(v) < 2.0 and phase(s, U_P, RESONANCE) < -5.0


def _level(s: EffectSheet) -> Answer:
    """Braking friction holds a band of pressure differences open."""
    v = static_mbar(s)[1]
    return v, v > 2.0


CLAIMS: list[Claim] = [
    *_of("joint_friction", below("resonance damped", P_T, RESONANCE, 1.0),
         below("gain drops when small", P_T, LOW, 0.5, "small"),
         amplitude("1/A", P_T, 0.5), odd(P_T), alike("soft", "stiff", P_T, "not co-contraction"), only(P_T, U_P)),
    *_of("braid_hysteresis", lags("lag that stays as f -> 0", P_T, LOW),
         below("stiffer when small", P_T, LOW, 0.5, "small"),
         amplitude("medium", P_T, 0.25), odd(P_T), more_at("stiff", "soft", P_T, "pressure"), only(P_T, U_P),
         ("shows in", "statics open", "mbar", _level)),
    *_of("muscle_creep", lags("lag below 1 Hz", P_T, LOW), no_amplitude(P_T), more_at("stiff", "soft", P_T, "pressure"),
         only(P_T, U_P), drifts("drift, valves shut", "theta2", 57.2958, "deg", 0.05)),
    *_of("stiffness_error", leads("resonance", P_T, RESONANCE, 3.0), moves_gain("low-frequency gain", P_T, LOW),
         no_amplitude(P_T), bends("statics")),
    *_of("muscle_mismatch", shifts(), no_amplitude(P_T), even(P_T)),
    *_of("nominal_length_offset", shifts(), no_amplitude(P_T), even(P_T)),
    *_of("gas_law", leads("closed-valve stiffness", U_T, RESONANCE, 3.0), more_at("soft", "stiff", U_T, "low pressure"),
         more_at("wide", "upright", U_T, "large angle"), no_amplitude(U_T), even(U_P),
         ("shows in", "u -> p with motion", "%", lambda s: (v := size(s, U_P, where=RESONANCE), v > 5.0)),
         ("shows in", "little of it without motion", "dB", lambda s: (v := _sum_gain(s), abs(v) < 0.5))),
    *_of("dead_volume", below("u -> p gain down", U_P, MID, 0.3), no_amplitude(U_P), only(U_P, P_T),
         ("FRF", "and of the sum", "dB", lambda s: (v := _sum_gain(s), v < -0.3))),
    *_of("choked_flow", moves_gain("gains bend", U_P, MID), amplitude("medium", U_P, 0.25), even(U_P),
         more_at("stiff", "soft", U_P, "pressure"), only(U_P, P_T)),
    *_of("supply_droop", below("gain loss", U_P, MID, 0.3), amplitude("strong", U_P, 0.5), even(U_P),
         ("FRF", "couples A and B: the sum too", "dB", lambda s: (v := _sum_gain(s), v < -0.3)), only(U_P, P_T)),
    *_of("leak", leads("integrator becomes low-pass", U_P, LOW, 1.0), more_at("stiff", "soft", U_P, "pressure"),
         drifts("decay, valves shut", "p_s", 1e3, "mbar", 5.0), only(U_P, P_T)),
    *_of("hose_lag", lags("first-order lag", U_P, RESONANCE), amplitude("weak", U_P, 0.0, 0.5),
         more_at("soft", "stiff", U_P, "pressure"), only(U_P, P_T)),
    *_of("valve_delay", linear_phase(U_P), moves_gain("duty bias at small duty", U_P, MID, 0.3, "small"),
         amplitude("bias at small duty", U_P, 0.5), even(U_P), only(U_P, P_T)),
    *_of("loop_delay", linear_phase(U_P), no_amplitude(U_P), only(U_P, P_T),
         ("FRF", "both muscles: the sum lags alike", "deg",
          lambda s: (v := float(np.median(s.frfs["pressure", U_P].between(*RESONANCE).phase_deg)), v < -3.0))),
    *_of("angle_sensor_lag", lags("lag of theta", U_T, RESONANCE), lags("... and p -> theta", P_T, RESONANCE),
         no_amplitude(P_T), only(P_T, U_P)),
    *_of("pressure_sensor_lag", lags("lag u -> p", U_P, RESONANCE), leads("lead p -> theta", P_T, RESONANCE),
         ("shows in", "both, inverse", "deg", _inverse), no_amplitude(U_P), quiet("u -> theta alone unchanged", U_T)),
    *_of("backlash", below("gain drop when small", P_T, LOW, 0.3, "small"),
         lags("lag when small", P_T, MID, 1.0, "small"),
         amplitude("strong", P_T, 0.5), odd(P_T), only(P_T, U_P)),
    *_of("payload", lags("resonance down", P_T, RESONANCE, 3.0), below("mass line down", P_T, HIGH, 0.3),
         no_amplitude(P_T), bends("gravity sag, by angle"), even(P_T), only(P_T, U_P)),
    *_of("coupling_flexibility",
         ("FRF", "low frequency unchanged", "dB", lambda s: (v := gain(s, P_T, LOW), abs(v) < 0.3)),
         moves_gain("pole and zero at 8-25 Hz", P_T, HIGH, 1.0),
         no_amplitude(P_T), only(P_T, U_P)),
    *_of("hose_stiffness", below("stiffer", P_T, LOW, 0.3), bends("statics, off-centre"), shifts("statics, off-centre"),
         amplitude("weak", P_T, 0.0, 0.5), more_at("soft", "stiff", P_T, "independent of pressure, so more where soft"),
         even(P_T), only(P_T, U_P)),
    *_of("base_tilt", quiet("none", P_T), shifts(), even(P_T)),
]  # fmt: skip
