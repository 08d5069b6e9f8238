"""Rate controllers of flight firmware: parameters in the firmware's own names, as blocks that are exact to rounding.

Laws on the error e, z for a sample, T for 1/rate, A the first-order filter a z/(z - 1 + a) with a = T/(T + 1/(2 pi f)),
which firmware calls alpha filter, low-pass or PT1:

| firmware | law | gyro behind | source |
|---|---|---|---|
| `px4` | K (P + I T/(z-1) + D (1 - 1/z)/T A) | notches, two-pole low-pass | RateControl.cpp |
| `ardupilot` | A_E (P + I T z/(z-1) + D (1 - 1/z)/T A_D) | two-pole low-pass | AC_PID.cpp |
| `betaflight` | (P' + I' T z/(z-1) + D' (1 - 1/z)/T A_1 A_2)/1000, e in deg/s | PT1-3, biquads | pid.c, filter.c |

Feed-forward, limits, anti-windup and thrust-dependent scaling are outside; filters that change in flight are named
(`left_out`). A law whose zeros no block holds is refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.core.units import TWO_PI, Array, ComplexArray, deg, hz
from loopshape.data.control.block import Block
from loopshape.data.control.controller import Controller
from loopshape.io.files import reading, short
from loopshape.toolbox.formats.controllers.controller_words import about

AXES = ("roll", "pitch", "yaw")
_TWO_POLE_DAMPING = float(np.sqrt(0.5))


@dataclass(frozen=True)
class Firmware:
    """Names of one firmware's parameters; `{axis}` stands for the axis as the firmware writes it.

    `factor` is what multiplies P, I and D for an error in rad/s; `forward` says that the integral of before this sample
    counts. Filters: `common` on the whole error, `derivative` on D alone (both first order), `two_pole` on the gyro,
    `notches` (frequency, width) too. `changing` switch on filters that change in flight, which no block holds.
    """

    axes: Mapping[str, str]
    terms: tuple[str, str, str]
    factor: tuple[float, float, float]
    forward: bool
    scale: str | None = None
    common: tuple[str, ...] = ()
    derivative: tuple[str, ...] = ()
    two_pole: tuple[str, ...] = ()
    notches: tuple[tuple[str, str], ...] = ()
    changing: tuple[str, ...] = ()

    def named(self, name: str, axis: str) -> str:
        """A parameter's name for an axis."""
        return name.replace("{axis}", self.axes[axis])


_PER_DEG = float(deg(1.0)) / 1000.0  # Betaflight's sum is a thousandth, its error in deg/s
FIRMWARE: dict[str, Firmware] = {
    "px4": Firmware(
        dict(zip(AXES, ("ROLL", "PITCH", "YAW"), strict=True)),
        ("MC_{axis}RATE_P", "MC_{axis}RATE_I", "MC_{axis}RATE_D"), (1.0, 1.0, 1.0), True, "MC_{axis}RATE_K",
        derivative=("IMU_DGYRO_CUTOFF",), two_pole=("IMU_GYRO_CUTOFF",),
        notches=(("IMU_GYRO_NF0_FRQ", "IMU_GYRO_NF0_BW"), ("IMU_GYRO_NF1_FRQ", "IMU_GYRO_NF1_BW")),
        changing=("IMU_GYRO_DNF_EN",),
    ),
    "ardupilot": Firmware(
        dict(zip(AXES, ("RLL", "PIT", "YAW"), strict=True)),
        ("ATC_RAT_{axis}_P", "ATC_RAT_{axis}_I", "ATC_RAT_{axis}_D"), (1.0, 1.0, 1.0), False,
        common=("ATC_RAT_{axis}_FLTE",), derivative=("ATC_RAT_{axis}_FLTD",), two_pole=("INS_GYRO_FILTER",),
        changing=("INS_HNTCH_ENABLE", "INS_HNTC2_ENABLE", "ATC_RAT_{axis}_NEF", "ATC_RAT_{axis}_NTF"),
    ),
    "betaflight": Firmware(
        dict(zip(AXES, AXES, strict=True)), ("p_{axis}", "i_{axis}", "d_{axis}"),
        (0.032029 * _PER_DEG, 0.244381 * _PER_DEG, 0.000529 * _PER_DEG), False,
        common=("gyro_lpf1_static_hz", "gyro_lpf2_static_hz"),
        derivative=("dterm_lpf1_static_hz", "dterm_lpf2_static_hz"),
        changing=("gyro_lpf1_dyn_min_hz", "dterm_lpf1_dyn_min_hz", "dyn_notch_count", "rpm_filter_harmonics",
                  "gyro_notch1_hz", "gyro_notch2_hz", "dterm_notch_hz", "yaw_lowpass_hz"),
    ),
}  # fmt: skip
#: how many PT1 a filter of Betaflight is, and what its cutoff is multiplied by: 1/sqrt(2^(1/n) - 1), in its own digits
_IN_ROW = {"PT1": (1, 1.0), "PT2": (2, 1.553773974), "PT3": (3, 1.961459177)}


def read_parameters(path: Path) -> dict[str, float | str]:
    """Parameters by name of a ground station's file (QGroundControl, Mission Planner), `dump` of Betaflight, JSON."""
    found: dict[str, float | str] = {}
    with reading(path, "parameters"):
        text = path.read_text(encoding="utf-8")
    for line in text.splitlines():
        words = [word for word in re.split(r"[\s,=:\"{}]+", line.split("#")[0].strip()) if word and word != "set"]
        at = next((k for k, word in enumerate(words) if re.fullmatch(r"[A-Za-z_][\w.-]*", word)), len(words))
        if at + 1 < len(words):
            found[words[at]] = _value(words[at + 1])
    if not found:
        raise UnreadableInputError(f"{path.name} holds no parameters", short(text, 60), "write NAME VALUE, one a line")
    return found


def _value(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


def controller_of(parameters: Mapping[str, float | str], firmware: str, axis: str, rate_hz: float) -> Controller:
    """The loop's controller from the gyro's error in rad/s to the torque, of Betaflight to the sum of its terms.

    A cutoff of 0, or one that is not named, switches its filter off, as in the firmware. The loop is called after its
    axis. Refuses an unknown firmware or axis, missing terms, and a law that no blocks hold.
    """
    kind = _kind(firmware, axis)
    p, i, d = (factor * value for factor, value in zip(kind.factor, _terms(kind, parameters, axis), strict=True))
    two_pole = [f for name in kind.two_pole if (f := _number(parameters, name, 0.0)) > 0.0]
    common, more = _first_order(kind, kind.common, parameters, axis)
    inner, none = _first_order(kind, kind.derivative, parameters, axis)
    if none:
        raise WrongUseError(
            "a biquad on D does not come apart into blocks", f"at {none[0]:g} Hz", "PT1, PT2 and PT3 do"
        )
    blocks = _law(p, i, d, inner, rate_hz, forward=kind.forward)
    blocks += [_alpha(f, rate_hz) for f in common]
    for f in (*two_pole, *more):
        blocks.append(Block("low_pass_2", {"f_hz": _warped(f, rate_hz), "damping": _TWO_POLE_DAMPING}))
    for frequency, width in kind.notches:
        if (f := _number(parameters, frequency, 0.0)) > 0.0:
            blocks.append(_notch(f, _number(parameters, width, 20.0), rate_hz))
    return Controller(axis, tuple(blocks), rate_hz)


def _kind(firmware: str, axis: str) -> Firmware:
    if firmware not in FIRMWARE or axis not in AXES:
        raise WrongUseError(
            "a firmware's rate controller is not known", f"{axis!r} of {firmware!r}",
            f"use {', '.join(FIRMWARE)}; the axes, and the loops, are {', '.join(AXES)}",
        )  # fmt: skip
    return FIRMWARE[firmware]


def _terms(kind: Firmware, parameters: Mapping[str, float | str], axis: str) -> list[float]:
    scale = 1.0 if kind.scale is None else _number(parameters, kind.named(kind.scale, axis), 1.0)
    return [scale * _number(parameters, kind.named(name, axis)) for name in kind.terms]


def _number(parameters: Mapping[str, float | str], name: str, default: float | None = None) -> float:
    value = parameters.get(name, default)
    if not isinstance(value, float | int):
        raise WrongUseError(
            f"the parameter {name} is a number", repr(value) if value is not None else "none", "write it"
        )
    return float(value)


def _first_order(
    kind: Firmware, names: tuple[str, ...], parameters: Mapping[str, float | str], axis: str
) -> tuple[list[float], list[float]]:
    """Cutoffs in Hz of the first-order filters that these parameters switch on, and of biquads among them."""
    first, biquads = [], []
    for name in names:
        f = _number(parameters, kind.named(name, axis), 0.0)
        word = str(parameters.get(name.replace("_static_hz", "_type"), "PT1")) if name.endswith("_static_hz") else "PT1"
        if word not in (*_IN_ROW, "BIQUAD"):
            raise WrongUseError("a kind of filter is not known", repr(word), f"use {', '.join(_IN_ROW)} or BIQUAD")
        count, times = _IN_ROW.get(word, (0, 1.0))
        first += [times * f] * count if f > 0.0 else []
        biquads += [f] if f > 0.0 and not count else []
    return first, biquads


def left_out(parameters: Mapping[str, float | str], firmware: str, axis: str) -> tuple[str, ...]:
    """A sentence for each filter that is switched on and stands in no block, such as notches that follow the motors."""
    if firmware not in FIRMWARE:
        return ()
    kind = _kind(firmware, axis)
    names = [kind.named(name, axis) for name in kind.changing]
    on = [name for name in names if parameters.get(name, 0.0) not in (0.0, "OFF")]
    return tuple(
        f"{name} = {parameters[name]}: this filter is not in the controller, and its phase is missing; switch it off,"
        " or add it as it stood in the flight that was logged, a notch by --notch"
        for name in on
    )


def _warped(f_hz: float, rate_hz: float) -> float:
    """The corner at which Tustin's rule gives the filter that firmware makes exact at `f_hz`."""
    if not 0.0 < f_hz < 0.5 * rate_hz:
        raise WrongUseError(
            "a filter's frequency lies below half the rate", f"{f_hz:g} Hz at {rate_hz:g} Hz", "lower it"
        )
    return rate_hz / np.pi * float(np.tan(np.pi * f_hz / rate_hz))


def _notch(f_hz: float, width_hz: float, rate_hz: float) -> Block:
    """PX4's notch: (1 + 2 b/z + 1/z²)/(1 + a + 2 b/z + (1 - a)/z²), a = tan(pi width/rate), b = -cos(2 pi f/rate)."""
    warped, k = _warped(f_hz, rate_hz), float(np.tan(np.pi * f_hz / rate_hz))
    damping = float(np.tan(np.pi * width_hz / rate_hz)) * (1.0 + k**2) / (2.0 * k)
    return Block("notch", {"f1_hz": warped, "f2_hz": warped, "damping1": 0.0, "damping2": damping})


def with_notches(controller: Controller, words: Sequence[str], firmware: str) -> Controller:
    """A controller behind a bank of dynamic notches as they stand at one moment of a flight.

    Each word is FREQUENCY:WIDTH in Hz, of Betaflight FREQUENCY:Q. Its notch is (1 + 2 b/z + 1/z²)/(1 + a + 2 b/z
    + (1 - a)/z²), b = -cos(w), with PX4's a = tan(pi width/rate) or a = sin(w)/(2 Q). Refuses other words, and
    frequencies from half the rate on.
    """
    bank = []
    for word in words:
        match = re.fullmatch(r"(\d+\.?\d*):(\d+\.?\d*)", word)
        f_hz, second = (float(x) for x in match.groups()) if match else (0.0, 0.0)
        if not (0.0 < f_hz < 0.5 * controller.rate_hz and 0.0 < second < 0.5 * controller.rate_hz):
            what = "FREQUENCY:Q" if firmware == "betaflight" else "FREQUENCY:WIDTH in Hz"
            raise WrongUseError(f"a notch of a bank is {what}, below half the rate", repr(word), "as 140:25")
        notch = _notch(f_hz, second, controller.rate_hz)
        if firmware == "betaflight":
            notch = replace(notch, parameters={**notch.parameters, "damping2": 0.5 / second})
        bank.append(notch)
    return replace(controller, blocks=(*controller.blocks, *bank))


def _share(f_hz: float, rate_hz: float) -> float:
    """a of the first-order filter a z/(z - 1 + a)."""
    return 1.0 / (1.0 + rate_hz / (TWO_PI * f_hz))


def _alpha(f_hz: float, rate_hz: float) -> Block:
    """The first-order filter of firmware, whose zero lies at z = 0, as a lag with s = 2 rate (z-1)/(z+1)."""
    a = _share(f_hz, rate_hz)
    return Block("lead_lag", {"f1_hz": rate_hz / np.pi, "f2_hz": rate_hz / np.pi * a / (2.0 - a)})


def proportional_integral(p: float, i: float, rate_hz: float) -> list[Block]:
    """P + I T/(z-1) as blocks, the sum being that of before this sample; I is per s."""
    if i >= 2.0 * p * rate_hz:
        raise WrongUseError(
            "an integral this fast oscillates between samples", f"I {i:.4g}, P {p:.4g} at {rate_hz:g} Hz",
            "state the rate that the loop runs at",
        )  # fmt: skip
    return _law(p, i, 0.0, [], rate_hz, forward=True)


def _law(p: float, i: float, d: float, cutoffs: list[float], rate_hz: float, *, forward: bool) -> list[Block]:
    """P, I and D with first-order filters on D as blocks: the sum is multiplied out in z, its zeros looked for."""
    num, poles = _proportional_integral(p, i / rate_hz, forward=forward)
    if d:
        top, more = _derivative(cutoffs, rate_hz)
        whole = np.polyadd(np.polymul(num, np.poly(more)), d * np.polymul(np.poly(poles), top))
        return _blocks(np.asarray(whole), [*poles, *more], rate_hz)
    return _blocks(num, poles, rate_hz)


def _proportional_integral(p: float, step: float, *, forward: bool) -> tuple[Array, list[float]]:
    """Numerator and poles of P + `step`/(z-1), or of P + `step` z/(z-1); of P alone without an integral."""
    if not step:
        return np.array([p]), []
    return np.array([p, step - p] if forward else [p + step, -p]), [1.0]


def _derivative(cutoffs: list[float], rate_hz: float) -> tuple[Array, list[float]]:
    """Numerator and poles of rate (z-1)/z times a z/(z - 1 + a) for each cutoff."""
    shares = [_share(f, rate_hz) for f in cutoffs]
    num = rate_hz * float(np.prod(shares)) * np.array([1.0, -1.0])
    powers = max(len(cutoffs) - 1, 0)  # of z: one above for each filter, one below for the difference
    return np.append(num, np.zeros(powers)), [1.0 - a for a in shares] or [0.0]


def _blocks(num: Array, poles: list[float], rate_hz: float) -> list[Block]:
    """Blocks in series whose sections are num (in z, falling powers) over these poles, a gain first."""
    zeros = _in_s(np.roots(np.trim_zeros(num, "f")).astype(complex), rate_hz)
    made = _paired(list(zeros), list(_in_s(np.array(poles, dtype=complex), rate_hz)))
    z = np.exp(1j * np.pi / 4.0)
    rest = Controller("", tuple(made), rate_hz).response(np.array([rate_hz / 8.0]))[0] if made else 1.0
    gain = complex(np.polyval(num, z) / np.prod([z - pole for pole in poles]) / rest)
    return [Block("gain", {"gain": gain.real}), *made]


def _in_s(roots: ComplexArray, rate_hz: float) -> ComplexArray:
    """Roots in s = 2 rate (z-1)/(z+1); that at z = 1 is exactly 0."""
    s = 2.0 * rate_hz * (roots - 1.0) / (roots + 1.0)
    return np.asarray(np.where(np.abs(s) < 1e-7 * rate_hz, 0.0, s), dtype=complex)


def _paired(zeros: list[complex], poles: list[complex]) -> list[Block]:
    """Zeros with poles in the kinds of blocks that there are; refuses what none of them holds."""
    real = sorted((z.real for z in zeros if not z.imag), reverse=True)
    pairs = [z for z in zeros if z.imag > 0.0]
    lags = sorted((p.real for p in poles if not p.imag and p != 0.0), reverse=True)
    integrators = sum(p == 0.0 for p in poles)
    if any(z.real >= 0.0 for z in zeros) or integrators > 1:
        raise WrongUseError(
            "the law of a firmware's controller does not come apart into blocks",
            f"zeros at {', '.join(f'{z / TWO_PI:.3g}' for z in zeros)} Hz",
            "less I or D moves its zeros to the left half plane",
        )  # fmt: skip
    made = []
    if integrators and real:
        made.append(Block("pi", {"f_hz": float(hz(-real.pop(0)))}))
    elif integrators:
        made.append(_pair_over_an_integrator(pairs.pop(0), lags.pop(0)))
    for z in pairs:
        p, q = lags.pop(0), lags.pop(0)
        size = float(np.sqrt(p * q))
        words = {
            "f1_hz": hz(abs(z)),
            "damping1": -z.real / abs(z),
            "f2_hz": hz(size),
            "damping2": -(p + q) / (2.0 * size),
        }
        made.append(Block("notch", {name: float(value) for name, value in words.items()}))
    for zero in real:
        made.append(Block("lead_lag", {"f1_hz": float(hz(-zero)), "f2_hz": float(hz(-lags.pop(0)))}))
    return [*made, *(Block("low_pass_1", {"f_hz": float(hz(-p))}) for p in lags)]


def _pair_over_an_integrator(zero: complex, lag: float) -> Block:
    """A complex pair of zeros over an integrator and a lag, 1 at high frequency: what much I and D come to."""
    top, bottom = (abs(zero) ** 2, -2.0 * zero.real, 1.0), (0.0, -lag, 1.0)
    size = -lag * TWO_PI
    values = {f"{part}{k}": float(c / size) for part, row in (("n", top), ("d", bottom)) for k, c in enumerate(row)}
    return Block("section", values)


def _derivative_corner_hz(blocks: list[Block]) -> float | None:
    """Where the derivative of a rate controller rolls off: a lead's upper corner, a section's pole; None without."""
    for p in (block.parameters for block in blocks):
        if "f2_hz" in p:
            return p["f2_hz"]
        if p.get("d2"):
            return float(hz(p["d1"] / p["d2"]))
    return None


def parameters_of(controller: Controller, firmware: str) -> dict[str, float]:
    """Parameters of a controller of a gain, an integrator and a lead, whose loop is called after its axis.

    The lead's upper corner becomes the derivative's filter. Integrator and lead may be one section (complex zeros).
    Refuses other blocks: filters are set by their own names.
    """
    kind, rate = _kind(firmware, controller.loop), controller.rate_hz
    blocks = [block for block in controller.blocks if block.kind != "gain"]
    if sorted(block.kind for block in blocks) not in (["lead_lag", "pi"], ["pi"], ["lead_lag"], ["section"], []):
        raise WrongUseError(
            f"a rate controller of {firmware} is a gain, pi and one lead_lag, or a gain and one section",
            ", ".join(block.kind for block in controller.blocks), "leave filters out and set them by their own names",
        )  # fmt: skip
    corner_hz = _derivative_corner_hz(blocks)
    pole = 0.0 if corner_hz is None else (1.0 - np.pi * corner_hz / rate) / (1.0 + np.pi * corner_hz / rate)
    a = 1.0 - float(pole)
    z = np.exp(1j * np.array([0.01, 0.3, 1.1]))
    integral = 1.0 / (rate * (z - 1.0)) * (1.0 if kind.forward else z)
    columns = np.stack([np.ones(3), integral, a * rate * (z - 1.0) / (z - 1.0 + a)], axis=1)
    C = controller.response(rate * np.angle(z) / TWO_PI)
    rows, wanted = np.concatenate([columns.real, columns.imag]), np.concatenate([C.real, C.imag])
    terms = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    if (
        not 0.0 < a <= 1.0
        or np.abs(columns @ terms - C).max() > 1e-6 * np.abs(C).max()
        or (terms < -1e-9 * np.abs(terms).max()).any()
    ):
        raise WrongUseError(
            f"the controller is no rate controller of {firmware}", f"P, I, D {', '.join(f'{t:.3g}' for t in terms)}",
            "let the corner of pi lie below the lead, and the lead's upper corner below the rate over pi",
        )  # fmt: skip
    found = {
        kind.named(n, controller.loop): float(t / f) for n, t, f in zip(kind.terms, terms, kind.factor, strict=True)
    }
    cutoff = (
        {}
        if corner_hz is None or a == 1.0
        else {kind.named(kind.derivative[0], controller.loop): a * rate / (TWO_PI * (1.0 - a))}
    )
    return found | {name: float(value) for name, value in cutoff.items()}


#: how a ground station, or Betaflight's command line, writes a parameter
_LINES = {"px4": "1\t1\t{}\t{!r}\t9", "ardupilot": "{},{!r}", "betaflight": "set {} = {}"}


def parameters_text(controller: Controller, firmware: str) -> str:
    """A file of a controller's parameters as the firmware's ground station loads it; Betaflight takes whole numbers."""
    found: dict[str, float | int] = dict(parameters_of(controller, firmware))
    exact = [f"# {name} {value!r}, rounded" for name, value in found.items() if firmware == "betaflight"]
    if firmware == "betaflight":
        found = {name: round(value) for name, value in found.items()}
    rows = [_LINES[firmware].format(name, value) for name, value in found.items()]
    return "\n".join([*(f"# {line}" for line in about(controller)), *exact, *rows]) + "\n"
