"""The study that shows what effects do to the 1-DoF arm, and the signals that it looks at.

Its own controllers hold the arm; multisines enter at the plant's input, so that the notch leaves the resonance excited.
Their lines are odd multiples of 0.05 Hz, thinned out, so that odd and even distortion show in between.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from loopshape.core.units import Array, rad
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.rig.excitation.multisine import Multisine
from loopshape.toolbox.rig.excitation.setpoints import Profile, Staircase
from loopshape.toolbox.rig.study import ExperimentTemplate, Study

MIDDLE = {"theta2_deg": 15.0, "p_ab_bar": 1.0}
POINTS = {  # where one recording of medium amplitude is made
    "middle": MIDDLE,
    "upright": {"theta2_deg": 0.0, "p_ab_bar": 1.0},
    "wide": {"theta2_deg": 30.0, "p_ab_bar": 1.0},
    "soft": {"theta2_deg": 15.0, "p_ab_bar": 0.8},
    "stiff": {"theta2_deg": 15.0, "p_ab_bar": 1.4},
}
AMPLITUDES_V = {"small": 0.08, "middle": 0.25, "large": 0.6}
PERIOD_S, PERIODS = 20.0, 3
#: paths by the signals at their ends; what was injected is the instrument
PATHS = {"u -> theta2": ("u_d", "theta2"), "u -> p": ("u_d", "p_d"), "p -> theta2": ("p_d", "theta2")}
SUM_PATH = {"u -> p": ("u_s", "p_s")}  # where the pressure loop is excited and the joint hardly moves
SETPOINTS_DEG = 25.0
SPEED_DEG_S = 1.5


def lines_hz() -> tuple[float, ...]:
    """Odd multiples of 1/period, about nine an octave below 1 Hz and twelve above, 0.15 to 15 Hz."""
    wanted = np.geomspace(0.15, 15.0, 56) * PERIOD_S
    odd = 2 * np.round((wanted - 1.0) / 2.0).astype(int) + 1
    chosen = [int(k) for k in np.unique(odd)]
    kept = [k for i, k in enumerate(chosen) if k > 21 or i % 4 != 3]  # low lines lie close: leave every fourth out
    return tuple(k / PERIOD_S for k in kept)


def effect_study(seed: int = 7) -> Study:
    """The study, without effects."""
    at = {"small": MIDDLE, "large": MIDDLE} | POINTS
    experiments = [_excited(name, "theta2", AMPLITUDES_V.get(name, 0.25), point) for name, point in at.items()]
    experiments.append(_excited("pressure", "p_ab", 0.25, MIDDLE))
    return Study("simulated", "arm-1dof", (*experiments, _statics(), _steps(), _shut()), (MIDDLE,), seed=seed)


def _excited(name: str, loop: str, amplitude_v: float, point: Mapping[str, float]) -> ExperimentTemplate:
    signal = Multisine(0.1, 16.0, PERIOD_S, amplitude_v, PERIODS, 3, ramp_s=2.0, lines_hz=lines_hz())
    return ExperimentTemplate(name, "multisine", "plant_input", loop, signal, lead_s=8.0, operating_points=(point,))


def _statics() -> ExperimentTemplate:
    """Slowly up, down, and back: what pressure difference holds which angle."""
    way = float(rad(SETPOINTS_DEG))
    speed = float(rad(SPEED_DEG_S))
    quarter = SETPOINTS_DEG / SPEED_DEG_S + 2.0
    slow = Profile((2.0, 2.0 + quarter, 2.0 + 3.0 * quarter), (way, -way, 0.0), speed, speed, 2.0 * speed)
    start = {"theta2_deg": 0.0, "p_ab_bar": 1.0}
    return ExperimentTemplate(
        "statics", "profile", "reference", references={"theta2": slow}, duration_s=2.0 + round(4.0 * quarter + 1.0),
        operating_points=(start,),
    )  # fmt: skip


def _steps() -> ExperimentTemplate:
    """Ten degrees up, then 0.2 bar more."""
    up = Staircase((1.0,), (float(rad(15.0)),))
    more = Staircase((5.0,), (1.2,))
    return ExperimentTemplate(
        "steps", "staircase", "reference", references={"theta2": up, "p_ab": more}, duration_s=9.0,
        operating_points=({"theta2_deg": 5.0, "p_ab_bar": 1.0},),
    )  # fmt: skip


def _shut() -> ExperimentTemplate:
    """Valves shut, nothing commanded."""
    nothing = Staircase((0.0,), (0.0,))
    return ExperimentTemplate("shut", "open_loop", "control", control={"theta2": nothing}, duration_s=4.0)


def signals(recording: Recording) -> dict[str, Array]:
    """The signals of `PATHS`: u_d, u_s half of what the valves get apart and together (V); p_d, p_s (bar); theta2."""
    c = recording.column
    u_a, u_b, p_a, p_b = c("u_a_v"), c("u_b_v"), c("p_a_bar"), c("p_b_bar")
    return {
        "u_d": 0.5 * (u_a - u_b),
        "u_s": 0.5 * (u_a + u_b),
        "p_d": p_a - p_b,
        "p_s": p_a + p_b,
        "theta2": c("theta2_rad"),
    }


def paths(recording: Recording) -> Mapping[str, tuple[str, str]]:
    """The paths that a recording shows."""
    return SUM_PATH if recording.info.excites == "p_ab" else PATHS
