"""What an angle sweep on the 1-DoF arm should measure: the linearisation, corrected for how the valves were used.

Four things part a measured FRF from the linearisation at the setpoint, all in first harmonics:

- the loops hold mean commands so that no pressure drifts, because exhaust is faster than filling;
- around that mean, filling and exhaust share a sine unequally, and the dead zone cuts out its middle;
- a pulse acts half its length after the PWM period's start, on average over a sine of amplitude a
  (8/(3 pi)) a T/2 later: the weight of |sin|^3 against sin^2;
- the arm stands at its mean angle and pressure, not at the setpoint, and the pressure loop stays closed.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loopshape.core.units import Array, ComplexArray, angular, deg
from loopshape.data.response.frf import FRF
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.arm.dynamics.linear import linearise, ripple_gains
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, constants


def expected_angle_response(
    frf: FRF, recording: Recording, p_ab: LoopSetup, changes: Mapping[str, float] | None = None
) -> ComplexArray:
    """Response theta2/z_theta2 (nf,) in rad/V that a sweep of small amplitude should measure.

    `recording` is the one that `frf` comes from, `p_ab` the pressure loop under which it was made, `changes`
    the study's changes of the arm. The amplitude of z at each line is taken from the FRF's own input power
    relative to the injected signal. Misleads where the angle moves by more than a degree or two (the arm's
    stiffness bends), or where a muscle nears the supply's pressure.
    """
    vector = ARM1_PARAMETERS.vector(dict(changes or {}) | dict(recording.info.parameters))
    period_s = 1.0 / float(vector[ARM1_PARAMETERS.index("pwm_frequency_hz")])
    dead_zone = float(vector[ARM1_PARAMETERS.index("pwm_dead_zone")])
    moving = np.flatnonzero(recording.column("n_theta2_rad"))
    part = slice(int(moving[0]), int(moving[-1]) + 1)

    def mean(column: str) -> float:
        return float(recording.column(column)[part].mean())

    f = frf.frequency_hz
    theta2_deg = float(deg(mean("theta2_rad")))
    lin = linearise(constants(vector), theta2_deg, mean("p_a_bar") + mean("p_b_bar"))
    amplitude = command_amplitude(frf, recording)
    gains = ripple_gains(lin, np.array([mean("u_a_v"), mean("u_b_v")]), amplitude, dead_zone)
    delay_s = 8.0 / (3.0 * np.pi) * amplitude * 0.5 * period_s
    P = lin.response(f, gains) * np.exp(-1j * angular(f) * delay_s)[:, None, None]
    if p_ab.controller is None:
        return np.asarray(P[:, 0, 0])
    C = p_ab.controller.response(f)
    return np.asarray(P[:, 0, 0] - P[:, 0, 1] * C * P[:, 1, 0] / (1.0 + C * P[:, 1, 1]))


def command_amplitude(frf: FRF, recording: Recording) -> Array:
    """Amplitude (nf,) in V of z_theta2 while a sweep of constant amplitude passes each line."""
    injected = recording.column("n_theta2_rad")
    z = recording.column("z_theta2_v")
    length = round(recording.rate_hz / float(np.diff(frf.frequency_hz).min()))
    f = np.fft.rfftfreq(length, 1.0 / recording.rate_hz)
    starts = np.arange(0, z.size - length + 1, length // 4)
    window = np.hanning(length)
    Z, N = (np.abs(np.fft.rfft([x[k : k + length] * window for k in starts])) ** 2 for x in (z, injected))
    ratio = np.sqrt(Z.sum(0) / np.maximum(N.sum(0), 1e-300))
    return np.interp(frf.frequency_hz, f, ratio) * float(np.abs(injected).max())
