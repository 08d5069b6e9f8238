"""The arm behind the emulated target: its board in C (`board/arm_emulator.c`), and what that must know of a plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import rad
from loopshape.toolbox.arm.arm1 import Arm1
from loopshape.toolbox.arm.effect import effect_parameters as e
from loopshape.toolbox.arm.parameters import ARM1_PARAMETERS, EXPONENT, constants, sensor_constants
from loopshape.toolbox.arm.simulation import period_ticks
from loopshape.toolbox.rig.emulator import Board

_EXTRA = (
    e.DEAD_A, e.DEAD_B, e.TWO_L_A, e.TWO_L_B, e.COMPRESSION, e.LEAK_A, e.LEAK_B, e.TILT_SINE, e.TILT_COSINE
)  # fmt: skip
#: places of the kernel's constants that the emulator's model computes with, in its order
KNOWN = (*range(EXPONENT + 1), *_EXTRA)


def plant_file(
    changes: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    rate_hz: float = 1000.0,
) -> str:
    """Text of the plant's file: constants as hexadecimal floats, and the point (theta2_deg, p_ab_bar) where it stands.

    Refuses changes of parameters that the emulator's model does not know (what remembers, delays or rubs), and a point
    where the arm cannot stand.
    """
    vector = ARM1_PARAMETERS.vector(changes)
    p = dict(zip(ARM1_PARAMETERS.names, vector.tolist(), strict=True))
    point = {"theta2_deg": 0.0, "p_ab_bar": 1.0} | dict(start or {})
    c = constants(vector)
    _check_known(changes or {}, c)
    Arm1().check_operating_point(point, changes)
    period_ticks(rate_hz, p["pwm_frequency_hz"])
    rows: dict[str, Sequence[float]] = {
        "rate_hz": [rate_hz],
        "pwm_hz": [p["pwm_frequency_hz"]],
        "dead_zone": [p["pwm_dead_zone"]],
        "start": [float(rad(point["theta2_deg"])), point["p_ab_bar"]],
        "constants": c[list(KNOWN)].tolist(),
        "sensors": sensor_constants(vector)[:-1],  # without the limit of another joint
    }
    lines = [f"{name} {' '.join(float(v).hex() for v in values)}" for name, values in rows.items()]
    return "\n".join(["loopshape-plant 1", *lines, "end", ""])


def _check_known(changes: Mapping[str, float], c: np.ndarray) -> None:
    neutral = constants(ARM1_PARAMETERS.vector({k: v for k, v in changes.items() if k in _plain_names()}))
    others = [k for k in range(c.size) if k not in KNOWN]
    if not np.array_equal(c[others], neutral[others]):
        raise WrongUseError(
            "the emulated arm does not know every effect",
            ", ".join(sorted(set(changes) - _plain_names())),
            "simulate it instead, or leave what remembers, delays or rubs at its neutral value",
        )


def _plain_names() -> set[str]:
    effects = {row.name for row in e.EFFECT_ROWS}
    return set(ARM1_PARAMETERS.names) - effects


BOARD = Board(
    "loopshape.toolbox.arm",
    ("board/arm1_model.h", "board/arm_options.h", "board/arm_options.c", "board/arm_emulator.c"),
    plant_file,
)
