"""Cascades of drives: one loop's parameters in the drive's own names as blocks, and back.

| drive | loop | law on the error | parameters |
|---|---|---|---|
| `odrive` | position | K, rad to rad/s | `pos_gain` |
| | velocity | (P + I T/(z-1))/(2 pi), rad/s to N m; gains are per turn/s | `vel_gain`, `vel_integrator_gain` |
| | current | w (L + R T/(z-1)), A to V | `current_control_bandwidth`, `phase_inductance`, `phase_resistance` |
| `sercos` | position | Kv, in 1/s | `S-0-0104` |
| | velocity, current | K (1 + 1/(Tn s)), Tn in ms, by Tustin's rule | `S-0-0100`, `S-0-0101`; `S-0-0106`, `S-0-0107` |

ODrive's are its equations (controller.cpp, motor.cpp), exact to rounding; of SERCOS drives (TwinCAT's AX5000) the names
are those of the standard's parameters, and how a drive makes its law discrete is its maker's matter. Feed-forward,
limits, anti-windup, gain scheduling and filters behind are outside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.units import TWO_PI
from loopshape.data.control.block import Block
from loopshape.data.control.controller import Controller
from loopshape.toolbox.formats.controllers.controller_words import about
from loopshape.toolbox.formats.controllers.firmware import FIRMWARE, controller_of, proportional_integral

_MS = 1e-3


@dataclass(frozen=True)
class DriveLoop:
    """Names of a loop's parameters and how they become P and I (per s) in SI, and back; without I one name."""

    names: tuple[str, ...]
    per: float = 1.0
    reset_ms: bool = False
    by_motor: bool = False

    def gains(self, parameters: Sequence[float]) -> tuple[float, float]:
        """P and I."""
        if self.by_motor:
            bandwidth, inductance, resistance = parameters
            return bandwidth * inductance, bandwidth * resistance
        p, i = (*parameters, 0.0)[:2]
        if self.reset_ms:
            return p, p / (_MS * i) if i > 0.0 else 0.0
        return p / self.per, i / self.per

    def parameters(self, p: float, i: float) -> tuple[float, ...]:
        """The parameters of P and I; refuses loops whose gains follow from the motor."""
        if self.by_motor:
            raise WrongUseError(
                "the gains of this loop follow from the motor", ", ".join(self.names), "set the bandwidth in the drive"
            )
        if self.reset_ms:
            return p, p / (_MS * i) if i else 0.0
        return (self.per * p, self.per * i)[: len(self.names)]


#: drives by name: whether the integral is the sum of before this sample (else Tustin's rule), and the loops
DRIVES: dict[str, tuple[bool, dict[str, DriveLoop]]] = {
    "odrive": (True, {
        "position": DriveLoop(("pos_gain",)),
        "velocity": DriveLoop(("vel_gain", "vel_integrator_gain"), TWO_PI),
        "current": DriveLoop(("current_control_bandwidth", "phase_inductance", "phase_resistance"), by_motor=True),
    }),
    "sercos": (False, {
        "position": DriveLoop(("S-0-0104",)),
        "velocity": DriveLoop(("S-0-0100", "S-0-0101"), reset_ms=True),
        "current": DriveLoop(("S-0-0106", "S-0-0107"), reset_ms=True),
    }),
}  # fmt: skip


def controller_of_parameters(parameters: Mapping[str, float | str], of: str, loop: str, rate_hz: float) -> Controller:
    """The controller of one loop of a drive, or of a flight firmware's rate loop (`firmware.controller_of`).

    Refuses unknown names, missing parameters, and a name that several axes of one file have.
    """
    if of not in DRIVES:
        if of not in FIRMWARE:
            raise WrongUseError(
                "a firmware's controller is not known", repr(of), f"use {', '.join((*FIRMWARE, *DRIVES))}"
            )
        return controller_of(parameters, of, loop, rate_hz)
    forward, law = _loop(of, loop)
    p, i = law.gains([_found(parameters, name) for name in law.names])
    if forward:
        return Controller(loop, tuple(proportional_integral(p, i, rate_hz)), rate_hz)
    reset = [Block("pi", {"f_hz": i / (TWO_PI * p)})] if i else []
    return Controller(loop, (Block("gain", {"gain": p}), *reset), rate_hz)


def drive_parameters(controller: Controller, of: str) -> dict[str, float]:
    """Parameters of a controller of a gain and at most one `pi`, whose loop is called as the drive's."""
    forward, law = _loop(of, controller.loop)
    kinds = sorted(block.kind for block in controller.blocks)
    if kinds not in (["gain"], ["gain", "pi"]) or (len(kinds) > len(law.names)):
        raise WrongUseError(
            f"the {controller.loop} loop of {of} is a gain{' and pi' if len(law.names) > 1 else ''}",
            ", ".join(kinds), "leave other blocks out, or set them by their own names",
        )  # fmt: skip
    z = np.exp(1j * np.array([0.01, 0.4]))
    integral = 1.0 / (controller.rate_hz * (z - 1.0)) if forward else (z + 1.0) / (2.0 * controller.rate_hz * (z - 1.0))
    C = controller.response(controller.rate_hz * np.angle(z) / TWO_PI)
    p, i = np.linalg.solve(np.stack([np.ones(2), integral], axis=1), C).real
    i = float(i) if "pi" in kinds else 0.0
    return dict(zip(law.names, law.parameters(float(p), i), strict=True))


def drive_text(controller: Controller, of: str) -> str:
    """Lines for odrivetool, or a list of a SERCOS drive's parameters."""
    place = {"current": "motor"}.get(controller.loop, "controller")
    line = {"odrive": f"odrv0.axis0.{place}.config.{{}} = {{!r}}", "sercos": "{} = {!r}"}[of]
    rows = [line.format(name, value) for name, value in drive_parameters(controller, of).items()]
    return "\n".join([*(f"# {note}" for note in about(controller)), *rows]) + "\n"


def _loop(of: str, loop: str) -> tuple[bool, DriveLoop]:
    forward, loops = DRIVES[of]
    if loop not in loops:
        raise WrongUseError(f"{of} has no loop of this name", repr(loop), f"its loops are {', '.join(loops)}")
    return forward, loops[loop]


def _found(parameters: Mapping[str, float | str], name: str) -> float:
    """The number of this name, or of the one name that ends in it (`axis0.controller.config.vel_gain`)."""
    values = [value for key, value in parameters.items() if key == name or key.endswith(f".{name}")]
    if len(values) != 1 or not isinstance(values[0], float | int):
        raise WrongUseError(
            f"the parameter {name} stands once, as a number", f"{len(values)} of them", "write a file of one axis"
        )
    return float(values[0])
