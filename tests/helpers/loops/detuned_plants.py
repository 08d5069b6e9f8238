"""Plants whose transfer functions are known, their FRFs, and by brute force how far their frequencies may move.

The truth needs nothing of loopshape: closed-loop poles are roots of polynomials, |S| is read on a dense grid. The
controllers run at 20 kHz, where Tustin's rule moves nothing below 100 Hz by more than 1e-4.
"""

from dataclasses import dataclass

import numpy as np
from bench_nouns import Block, BlockTemplate

import loopshape as ls

RATE_HZ = 20000.0
TWO_PI = 2.0 * np.pi


@dataclass(frozen=True)
class Mode:
    f_hz: float
    damping: float
    size: float = 1.0

    def polynomials(self, shift):
        w = TWO_PI * self.f_hz * (1.0 + shift)
        return np.array([self.size * w * w]), np.array([1.0, 2.0 * self.damping * w, w * w])


#: a mode of little damping beyond a double integrator, and what is added to it: (1 + sum of modes)/s² k
BENCH = (Mode(58.84, 0.0039, 0.6),)
CANCELLED = (Mode(58.84, 0.0039, 3.0),)
TWO_MODES = (Mode(58.84, 0.0039, 0.6), Mode(140.0, 0.01, -0.05))
#: a structure that may cancel the mode, and limits of its loop
ASKED = ls.Requirements(
    "axis", sensitivity_peak_db=6.0, phase_margin_deg=40.0, unstable_poles=0,
    structure=tuple(
        BlockTemplate.from_table(table)
        for table in (
            {"kind": "gain", "gain": {"min": 0.001, "max": 10.0}},
            {"kind": "lead_lag", "f1_hz": {"min": 1.0, "max": 30.0}, "f2_hz": {"min": 10.0, "max": 200.0}},
            {"kind": "notch", "f1_hz": {"min": 30.0, "max": 90.0}, "f2_hz": "f1_hz",
             "damping1": {"min": 0.002, "max": 1.0}, "damping2": {"min": 0.05, "max": 5.0}},
            {"kind": "low_pass", "order": 2, "f_hz": {"min": 50.0, "max": 500.0}, "damping": {"min": 0.4, "max": 1.2}},
        )
    ),
)  # fmt: skip


def polynomials(modes, shifts, whole=0.0, k=4000.0):
    """num, den of k/s² (1 + modes), each mode on an axis stretched by its own shift, all by `whole`."""
    num, den = np.array([1.0]), np.array([1.0])
    for mode, shift in zip(modes, shifts, strict=True):
        n, d = mode.polynomials(shift)
        num, den = np.polyadd(np.polymul(num, d), np.polymul(n, den)), np.polymul(den, d)
    num, den = k * num, np.polymul(den, [1.0, 0.0, 0.0])
    if whole:  # P'(s) = P(s/(1 + whole))
        num = num * (1.0 + whole) ** -np.arange(num.size - 1, -1, -1.0)
        den = den * (1.0 + whole) ** -np.arange(den.size - 1, -1, -1.0)
    return num, den


def continuous(controller):
    """num, den of the controller's blocks, descending powers of s."""
    num, den = np.array([1.0]), np.array([1.0])
    for block in controller.blocks:
        n, d = block.section()
        num, den = np.polymul(num, n[::-1]), np.polymul(den, d[::-1])
    return np.trim_zeros(num, "f"), np.trim_zeros(den, "f")


def frf_of(modes, f_hz, relative=1e-4, seed=0, shifts=None):
    """FRF on f_hz with circular errors of a relative standard deviation."""
    num, den = polynomials(modes, shifts or (0.0,) * len(modes))
    s = TWO_PI * 1j * f_hz
    P = np.polyval(num, s) / np.polyval(den, s)
    rng = np.random.default_rng(seed)
    noise = (rng.standard_normal(f_hz.size) + 1j * rng.standard_normal(f_hz.size)) / np.sqrt(2.0)
    std = relative * np.abs(P)
    return ls.FRF(
        frequency_hz=f_hz,
        response=(P + std * noise)[:, None, None],
        covariance=(std**2 + 0j)[:, None, None],
        valid=np.ones(f_hz.size, dtype=bool),
        inputs=("u",),
        outputs=("y",),
        method="analytic",
        recording="r1",
        loop="axis",
        rate_hz=RATE_HZ,
    )


def controller_with(*notches, gain=0.2, crossover_hz=12.0):
    """A lead about the crossover, notches (f_hz, damping1, damping2), and a low-pass."""
    blocks = [
        Block("gain", {"gain": gain}),
        Block("lead_lag", {"f1_hz": crossover_hz / 3.5, "f2_hz": crossover_hz * 3.5}),
        *(Block("notch", {"f1_hz": f, "f2_hz": f, "damping1": d1, "damping2": d2}) for f, d1, d2 in notches),
        Block("low_pass_2", {"f_hz": 300.0, "damping": 0.7}),
    ]
    return ls.Controller("axis", tuple(blocks), RATE_HZ)


def closed(modes, shifts, controller, whole=0.0):
    """Whether the closed loop is stable, and max |S| in dB over a dense grid."""
    (num, den), (cn, cd) = polynomials(modes, shifts, whole), continuous(controller)
    L_num, L_den = np.polymul(num, cn), np.polymul(den, cd)
    stable = bool(np.roots(np.polyadd(L_num, L_den)).real.max() < 0.0)
    near = [m.f_hz * (1.0 + s) * (1.0 + whole) * (1.0 + np.linspace(-0.05, 0.05, 801)) for m, s in
            zip(modes, shifts, strict=True)]  # fmt: skip
    s = TWO_PI * 1j * np.concatenate([np.geomspace(0.5, 900.0, 1500), *near])
    L = np.polyval(L_num, s) / np.polyval(L_den, s)
    return stable, float(20.0 * np.log10(np.max(1.0 / np.abs(1.0 + L))))


def true_reach(modes, controller, most_db, way, one=None, step=0.02, most=20.0):
    """The largest shift in per cent one way up to which the loop is stable with |S| below `most_db`: step by step."""
    for percent in np.arange(step, most + step / 2, step):
        shift = way * percent / 100.0
        shifts = tuple(shift if k == one else 0.0 for k in range(len(modes)))
        stable, peak_db = closed(modes, shifts, controller, shift if one is None else 0.0)
        if not stable or peak_db > most_db:
            return float(percent - step / 2)
    return most
