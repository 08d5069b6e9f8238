"""The linearised 2-DoF arm under its controllers as they run: poles and steps of all four loops at once.

The plant behind a zero-order hold at the controllers' rate, the controllers as their biquads, and a delay of whole
samples at the plant's inputs in the place of the PWM (ARM.md, section 10: half the mean pulse). The loop is one linear
recursion. What the linearisation leaves out is left out here: dead zone, saturation, filling unlike exhaust, the
common throttle and the pulses' 50 Hz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from loopshape.core.errors import WrongUseError
from loopshape.core.units import Array, ComplexArray, hz
from loopshape.data.control.controller import Controller
from loopshape.toolbox.arm.dynamics.linear2 import Linearisation2


@dataclass(frozen=True, eq=False)
class ClosedLinear2:
    """x(k+1) = `dynamics` x(k) + `inputs` r(k), y(k) = `outputs` x(k), at `rate_hz`; r and y (4,) as the loops."""

    dynamics: Array
    inputs: Array
    outputs: Array
    rate_hz: float

    def poles(self) -> ComplexArray:
        """Poles in rad/s, ln z times the rate; those at z = 0, which a delay leaves, are no poles of the loop."""
        z = np.linalg.eigvals(self.dynamics).astype(complex)
        return np.asarray(np.log(z[np.abs(z) > 1e-6]) * self.rate_hz)

    @property
    def stable(self) -> bool:
        """Whether every pole decays."""
        return bool(np.all(np.abs(np.linalg.eigvals(self.dynamics)) < 1.0))

    def modes(self) -> tuple[tuple[float, float], ...]:
        """Frequency in Hz and damping ratio of each oscillation, lowest first; negative damping grows."""
        swinging = sorted((p for p in self.poles() if p.imag > 1e-6), key=abs)
        return tuple((hz(abs(p)), float(-p.real / abs(p))) for p in swinging)

    def step(self, loop: int, seconds: float) -> Array:
        """Answer (n, 4) of all outputs to a unit step of one loop's reference at time 0, from rest."""
        x = np.zeros(self.dynamics.shape[0])
        out = np.empty((round(seconds * self.rate_hz), 4))
        for k in range(out.shape[0]):
            out[k] = self.outputs @ x
            x = self.dynamics @ x + self.inputs[:, loop]
        return out


def close2(lin: Linearisation2, controllers: Sequence[Controller], delay_samples: int = 0) -> ClosedLinear2:
    """The loop of a linearised arm and its four controllers, in the order of its strategy's loops.

    Refuses other than four controllers of one rate, and a negative delay.
    """
    rates = {c.rate_hz for c in controllers}
    if len(controllers) != 4 or len(rates) != 1 or delay_samples < 0:
        raise WrongUseError(
            "the linearised 2-DoF arm is closed by four controllers of one rate, with a delay from 0 samples",
            f"{len(controllers)} of {', '.join(f'{r:g}' for r in sorted(rates))} Hz, {delay_samples} samples",
        )
    rate_hz = rates.pop()
    a, b, c = _delayed(*_held(lin, rate_hz), lin.outputs, delay_samples)
    ac, bc, cc, dc = _stacked([_controller(one.biquads()) for one in controllers])
    loop = np.block([[a - b @ dc @ c, b @ cc], [-bc @ c, ac]])
    return ClosedLinear2(loop, np.vstack([b @ dc, bc]), np.hstack([c, np.zeros((4, ac.shape[0]))]), rate_hz)


def _held(lin: Linearisation2, rate_hz: float) -> tuple[Array, Array]:
    """The plant behind a zero-order hold."""
    whole = np.zeros((12, 12))
    whole[:8, :8], whole[:8, 8:] = lin.dynamics, lin.inputs
    found = expm(whole / rate_hz)
    return found[:8, :8], found[:8, 8:]


def _delayed(a: Array, b: Array, c: Array, samples: int) -> tuple[Array, Array, Array]:
    """The plant with so many samples of delay at each input."""
    for _ in range(samples):
        n, m = b.shape
        a = np.block([[a, b], [np.zeros((m, n + m))]])
        b, c = np.vstack([np.zeros((n, m)), np.eye(m)]), np.hstack([c, np.zeros((c.shape[0], m))])
    return a, b, c


def _controller(sections: Array) -> tuple[Array, Array, Array, Array]:
    """State space of a cascade of biquads (n, 5), direct form II transposed."""
    a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    for b0, b1, b2, a1, a2 in sections:
        own_a, own_b = np.array([[-a1, 1.0], [-a2, 0.0]]), np.array([[b1 - a1 * b0], [b2 - a2 * b0]])
        a = np.block([[a, np.zeros((a.shape[0], 2))], [own_b @ c, own_a]])
        b = np.vstack([b, own_b @ d])
        c, d = np.hstack([b0 * c, np.array([[1.0, 0.0]])]), b0 * d
    return a, b, c, d


def _stacked(parts: Sequence[tuple[Array, Array, Array, Array]]) -> tuple[Array, Array, Array, Array]:
    """Controllers side by side, each from its own error to its own z."""
    n = sum(a.shape[0] for a, *_ in parts)
    a, b, c, d = np.zeros((n, n)), np.zeros((n, 4)), np.zeros((4, n)), np.zeros((4, 4))
    at = 0
    for k, (own_a, own_b, own_c, own_d) in enumerate(parts):
        here = slice(at, at + own_a.shape[0])
        a[here, here], b[here, k], c[k, here], d[k, k] = own_a, own_b[:, 0], own_c[0], own_d[0, 0]
        at = here.stop
    return a, b, c, d
