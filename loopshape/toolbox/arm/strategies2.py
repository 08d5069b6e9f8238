"""How two joints are driven by four commands: what is measured, which muscles a command enters, and from where.

`DUAL` is the source's own way with four analog inputs (5.11-5.15): both angles, p_A and p_C are measured, and z_pA and
z_pC enter the muscle that is measured. `PAIRS` is the way of one joint (5.3-5.7) on both, which the source names as
what more inputs would allow (section 5.5): p_AB = p_A + p_B and p_CD = p_C + p_D are measured, and their commands enter
both muscles of the pair. Signs are those of ARM.md, section 1. The kernel knows the difference as one number, `shared`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from loopshape.core.units import Array
from loopshape.data.control.controller import Block
from loopshape.toolbox.arm.dynamics.equilibrium2 import pair_pressures2, pressures2
from loopshape.toolbox.arm.dynamics.linear2 import DECOUPLING, OUTPUTS, PAIR_DECOUPLING, PAIR_OUTPUTS

Blocks = tuple[Block, ...]
Four = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Strategy:
    """One way to drive both joints.

    `outputs` are the measured columns by loop, in the order of the loops; `point_keys` name an operating point: both
    angles and the two pressures that are held. `shared` is 1 where a pair's second muscle is measured and driven with
    the first, else 0. `decoupling` (4, 4) gives u_A to u_D from the four z, `seen` (4, 8) the outputs from the linear
    states of `linear2`. `four` gives (p_A, p_B, p_C, p_D) in bar at a point from the kernel's constants.
    """

    plant: str
    outputs: Mapping[str, str]
    point_keys: tuple[str, str, str, str]
    controllers: Mapping[str, Blocks]
    shared: float
    decoupling: Array
    seen: Array
    four: Callable[[Array, float, float, float, float], Four]

    @property
    def loops(self) -> tuple[str, ...]:
        """Names of the loops in order."""
        return tuple(self.outputs)


def angle_blocks(gain: float, lead: tuple[float, float], notch: tuple[float, float, float], low: Block) -> Blocks:
    """The source's structure of an angle controller: gain, lead-lag, notch (Hz and both dampings), low-pass."""
    f_hz, damping1, damping2 = notch
    return (
        Block("gain", {"gain": gain}),
        Block("lead_lag", {"f1_hz": lead[0], "f2_hz": lead[1]}),
        Block("notch", {"f1_hz": f_hz, "f2_hz": f_hz, "damping1": damping1, "damping2": damping2}),
        low,
    )


def _low_pass(f_hz: float, damping: float) -> Block:
    return Block("low_pass_2", {"f_hz": f_hz, "damping": damping})


def _pressure(gain: float, f_hz: float) -> Blocks:
    return (Block("gain", {"gain": gain}), Block("low_pass_1", {"f_hz": f_hz}))


#: the source's structures with numbers that hold the printed model (ARM.md, section 10)
_DUAL: dict[str, Blocks] = {
    "theta1": angle_blocks(9.9, (0.22, 8.0), (1.65, 0.1, 4.0), _low_pass(6.0, 0.8)),
    "theta2": angle_blocks(5.7, (3.7, 18.0), (4.5, 0.06, 4.7), _low_pass(12.0, 0.8)),
    "p_a": _pressure(5.0, 4.0),
    "p_c": _pressure(5.0, 4.0),
}
#: the same structures for pairs; the numbers are not the source's. Its notch lies below joint 1's mode (1.7 to 2.1 Hz),
#: so that the mode is damped and not hidden. Set on the linearisation with 4 ms of delay at eight points (theta1 within
#: 8 deg, theta2 within 15 deg, 0.8 to 1.6 bar): every |S| with all loops closed peaks below 6 dB
_PAIRS: dict[str, Blocks] = {
    "theta1": angle_blocks(5.0, (0.22, 14.0), (1.6, 0.1, 4.0), _low_pass(16.0, 0.8)),
    "theta2": angle_blocks(4.2, (3.7, 14.0), (4.6, 0.06, 4.7), _low_pass(16.0, 0.8)),
    "p_ab": _pressure(5.0, 4.0),
    "p_cd": _pressure(5.0, 4.0),
}

DUAL = Strategy(
    "arm-2dof",
    {"theta1": "theta1_rad", "theta2": "theta2_rad", "p_a": "p_a_bar", "p_c": "p_c_bar"},
    ("theta1_deg", "theta2_deg", "p_a_bar", "p_c_bar"),
    _DUAL,
    0.0,
    DECOUPLING,
    OUTPUTS,
    pressures2,
)
PAIRS = Strategy(
    "arm-2dof-pairs",
    {"theta1": "theta1_rad", "theta2": "theta2_rad", "p_ab": "p_a_bar + p_b_bar", "p_cd": "p_c_bar + p_d_bar"},
    ("theta1_deg", "theta2_deg", "p_ab_bar", "p_cd_bar"),
    _PAIRS,
    1.0,
    PAIR_DECOUPLING,
    PAIR_OUTPUTS,
    pair_pressures2,
)
