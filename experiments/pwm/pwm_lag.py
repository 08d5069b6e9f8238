"""The PWM's describing function: from a sine u = offset + a sin to the first harmonic of v, mean over its start.

Every pulse is integrated exactly; nothing is sampled. Two theories: a zero-order hold is late by half a period, a pulse
from the period's start by half its length.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.optimize import brentq

from loopshape.core.kernels.compiled import compiled
from loopshape.core.units import TWO_PI, angular, deg
from loopshape.toolbox.arm.dynamics import pwm
from loopshape.toolbox.arm.source import value


@compiled
def first_harmonic(
    f_hz: float, amplitude: float, offset: float, period_s: float, dead_zone: float, phases: int, periods: int
) -> complex:
    """First harmonic of v over that of u, mean over `phases` starts of the sine; `periods` make whole cycles."""
    w, total = 2.0 * np.pi * f_hz, 0.0j
    for j in range(phases):
        start = 2.0 * np.pi * j / phases
        for k in range(periods):
            u = offset + amplitude * np.sin(w * k * period_s + start)
            length = pwm.pulse_s(u, period_s, dead_zone)
            if length > 0.0:
                pulse = np.exp(-1j * w * k * period_s) * (1.0 - np.exp(-1j * w * length)) / (1j * w)
                total += np.sign(u) * pulse * np.exp(-1j * start)
    return total / (phases * periods * period_s) * 2.0j / amplitude


def gain(f_hz: float, amplitude: float, offset: float, dead_zone: float, settings: Mapping[str, Any]) -> complex:
    """The describing function at one frequency and amplitude."""
    period_s = 1.0 / value("pwm_frequency")
    periods = round(settings["cycles_s"] / period_s)
    return complex(first_harmonic(f_hz, amplitude, offset, period_s, dead_zone, settings["phases"], periods))


def lag_deg(response: complex) -> float:
    """Lag in deg, positive when late."""
    return -float(deg(np.angle(response)))


def hold_deg(f_hz: float) -> float:
    """Lag of a zero-order hold, half a period."""
    return float(deg(angular(f_hz))) * 0.5 / value("pwm_frequency")


def pulses_deg(f_hz: float, amplitude: float, offset: float, dead_zone: float) -> float:
    """Lag to first order in the frequency: half of each pulse, weighted by what it gives to the first harmonic.

    Of a small sine about an offset that is the whole mean pulse, because only its end moves; about 0 it is 8/(3 pi)
    times half the pulse of the amplitude.
    """
    sine = np.sin((np.arange(4000) + 0.5) * (TWO_PI / 4000))
    u = offset + amplitude * sine
    width = np.where(np.abs(u) > dead_zone, np.where(np.abs(u) > 1.0 - dead_zone, 1.0, np.abs(u)), 0.0)
    half = 0.5 * np.sum(np.sign(u) * width**2 * sine) / np.sum(np.sign(u) * width * sine)
    return float(deg(angular(f_hz)) * half / value("pwm_frequency"))


def table(settings: Mapping[str, Any]) -> list[list[Any]]:
    """Gain and lag over frequency, amplitude, offset and dead zone, with the theory of pulses."""
    rows = []
    for dead_zone in settings["dead_zones"]:
        for offset in settings["offsets"]:
            for a in settings["amplitudes"]:
                if a <= dead_zone and offset == 0.0:
                    continue  # nothing comes through
                for f in settings["frequencies_hz"]:
                    g = gain(f, a, offset, dead_zone, settings)
                    rows.append(
                        [dead_zone, offset, a, f, abs(g), lag_deg(g), pulses_deg(f, a, offset, dead_zone), hold_deg(f)]
                    )
    return rows


def amplitude_for(f_hz: float, wanted_deg: float, dead_zone: float, settings: Mapping[str, Any]) -> float:
    """Amplitude about 0 at which the lag is what is wanted."""
    return float(brentq(lambda a: lag_deg(gain(f_hz, a, 0.0, dead_zone, settings)) - wanted_deg, 0.1, 0.98, xtol=1e-4))


def offset_for(f_hz: float, wanted_deg: float, dead_zone: float, settings: Mapping[str, Any]) -> float:
    """Offset at which a small sine lags by what is wanted."""
    small = settings["small"]
    return float(brentq(lambda o: lag_deg(gain(f_hz, small, o, dead_zone, settings)) - wanted_deg, 0.1, 0.9, xtol=1e-4))
