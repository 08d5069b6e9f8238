"""What the source publishes of its own controllers (tables of chapter 5)."""

from __future__ import annotations

from loopshape.controller import Block, Controller


def angle_controller(gain: float = 55.0, notch_hz: float = 6.1, rate_hz: float = 1000.0) -> Controller:
    """Table 5.1, angle of the 1-DoF arm; figure 5.7 has its notch at 4.5 Hz for the simulated arm."""
    return Controller(
        "theta2",
        (
            Block("gain", {"gain": gain}),
            Block("lead_lag", {"f1_hz": 1.0, "f2_hz": 15.0}),
            Block("notch", {"f1_hz": notch_hz, "f2_hz": notch_hz, "damping1": 0.05, "damping2": 5.0}),
            Block("low_pass_2", {"f_hz": 15.0, "damping": 0.7}),
        ),
        rate_hz,
    )
