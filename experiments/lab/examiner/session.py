"""The session that every exam arm goes through: eleven recordings, their signals drawn anew from the seed.

Copied in design from the recordings of real sessions (kinds, roles, operating points, lengths, lines, levels); phases,
omitted lines, orders and sizes are drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from loopshape.core.units import Array, rad
from loopshape.data.control.controller import Block, Controller
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import RecordingInfo

from .excitations import multisine, profile, pulses, sweep

RATE_HZ = 1000.0

_ANGLE_BLOCKS = (
    Block("gain", {"gain": 11.0}),
    Block("lead_lag", {"f1_hz": 2.2, "f2_hz": 18.0}),
    Block("notch", {"f1_hz": 4.5, "f2_hz": 4.5, "damping1": 0.05, "damping2": 5.0}),
    Block("low_pass_2", {"f_hz": 19.0, "damping": 0.55}),
)
_PRESSURE_BLOCKS = (Block("gain", {"gain": 6.0}), Block("low_pass_1", {"f_hz": 10.0}))

ANGLE = Controller(loop="theta2", blocks=_ANGLE_BLOCKS, rate_hz=RATE_HZ)
PRESSURE = Controller(loop="p_ab", blocks=_PRESSURE_BLOCKS, rate_hz=RATE_HZ)
LOOPS = (
    LoopSetup("theta2", "r_theta2_rad", "n_theta2_rad", "z_theta2_v", "theta2_rad", ANGLE),
    LoopSetup("p_ab", "r_p_ab_bar", "n_p_ab_bar", "z_p_v", "p_a_bar + p_b_bar", PRESSURE),
)
PWM = {"frequency_hz": 50.0, "dead_zone": 0.01}


@dataclass(frozen=True, eq=False)
class Plan:
    """One recording to be made: its words, and (n, 2) setpoints, injected and forced signals (angle, pressure)."""

    info: RecordingInfo
    setpoints: Array
    injected: Array
    forced: Array


def plans(rng: np.random.Generator) -> list[Plan]:
    """The eleven recordings of a session."""
    return [make(f"rec{k:02d}.parquet", rng) for k, make in enumerate(_RECORDINGS, start=1)]


def _plan(
    info: RecordingInfo, n: int, angle: Array | float, pressure: Array | float,
    injected: Array | None = None, forced: Array | None = None,
) -> Plan:  # fmt: skip
    setpoints = np.empty((n, 2))
    setpoints[:, 0], setpoints[:, 1] = angle, pressure
    zero = np.zeros((n, 2))
    return Plan(info, setpoints, zero if injected is None else injected, zero if forced is None else forced)


def _beside(signal: Array, loop: int) -> Array:
    both = np.zeros((signal.size, 2))
    both[:, loop] = signal
    return both


def _multisine(design: str, theta_deg: float, p_bar: float) -> Callable[[str, np.random.Generator], Plan]:
    def make(file: str, rng: np.random.Generator) -> Plan:
        n = _beside(multisine(design, ANGLE, rng), 0)
        info = RecordingInfo(
            file, "multisine", "controller_input", excites="theta2",
            operating_point={"theta2_deg": theta_deg, "p_ab_bar": p_bar}, period_s=10.0, periodic_from_s=1.0,
        )  # fmt: skip
        return _plan(info, n.shape[0], float(rad(theta_deg)), p_bar, n)

    return make


def _sweep(loop: int, theta_deg: float, p_bar: float, role: str) -> Callable[[str, np.random.Generator], Plan]:
    def make(file: str, rng: np.random.Generator) -> Plan:
        setup = LOOPS[loop]
        assert setup.controller is not None
        n = _beside(sweep(setup.name, setup.controller), loop)
        info = RecordingInfo(
            file, "sweep", "controller_input", role, excites=setup.name,
            operating_point={"theta2_deg": theta_deg, "p_ab_bar": p_bar},
        )  # fmt: skip
        return _plan(info, n.shape[0], float(rad(theta_deg)), p_bar, n)

    return make


def _order(levels: list[float], most: float, rng: np.random.Generator) -> list[float]:
    """The levels in an order whose steps, the first from zero, are at most `most`."""
    while True:
        drawn = [float(x) for x in rng.permutation(levels)]
        if max(abs(b - a) for a, b in zip([0.0, *drawn], drawn, strict=False)) <= most:
            return drawn


def _held(n: int, before: float, times_s: list[float], values: list[float]) -> Array:
    at = np.searchsorted(np.asarray(times_s), np.arange(n) / RATE_HZ + 1e-9, side="right")
    return np.concatenate([[before], values])[at]


def _staircase_1(file: str, rng: np.random.Generator) -> Plan:
    angles = _order([-24.0, -16.0, -8.0, 8.0, 16.0, 24.0], 24.0, rng)
    drawn = rng.permutation([0.8, 0.9, 1.0, 1.1, 1.15, 1.2, 1.3])[:6]
    sums = [max(float(p), 0.8 + 0.01 * abs(a)) for p, a in zip(drawn, angles, strict=True)]
    info = RecordingInfo(file, "staircase", "reference", operating_point={"theta2_deg": 0.0, "p_ab_bar": 1.0})
    starts = [3.0 + 6.0 * k for k in range(7)]
    angle = _held(45000, 0.0, starts, [*rad(angles), 0.0])
    return _plan(info, 45000, angle, _held(45000, 1.0, [t + 3.0 for t in starts], [*sums, 1.0]))


def _staircase_2(file: str, rng: np.random.Generator) -> Plan:
    angles = _order([-20.0, -12.0, -5.0, 5.0, 12.0, 20.0], 25.0, rng)
    sums = [float(p) for p in np.round(rng.uniform(0.91, 1.25, 6), 3)]
    point = {"theta2_deg": 0.0, "p_ab_bar": 1.1}
    info = RecordingInfo(file, "staircase", "reference", "validation", operating_point=point)
    starts = [3.0 + 6.0 * k for k in range(6)]
    angle = _held(39000, 0.0, starts, [*rad(angles)])
    return _plan(info, 39000, angle, _held(39000, 1.1, [t + 3.0 for t in starts], sums))


def _open_loop(file: str, rng: np.random.Generator) -> Plan:
    point = {"theta2_deg": 0.0, "p_ab_bar": 1.0}
    info = RecordingInfo(file, "open_loop", "control", closed_loop=False, operating_point=point)
    return _plan(info, 7000, 0.0, 1.0, forced=pulses(7000, rng))


def _profile(file: str, rng: np.random.Generator) -> Plan:
    angle = profile(rng)
    point = {"theta2_deg": 0.0, "p_ab_bar": 1.0}
    info = RecordingInfo(file, "profile", "reference", "validation", operating_point=point)
    return _plan(info, angle.size, angle, 1.0)


_RECORDINGS: tuple[Callable[[str, np.random.Generator], Plan], ...] = (
    _multisine("weak", 0.0, 1.0),
    _multisine("strong", 0.0, 1.0),
    _multisine("bent", 20.0, 1.0),
    _multisine("bent", -20.0, 1.0),
    _multisine("stiff", 0.0, 1.4),
    _sweep(1, 0.0, 1.0, "estimation"),
    _staircase_1,
    _open_loop,
    _sweep(0, 10.0, 1.2, "validation"),
    _staircase_2,
    _profile,
)
