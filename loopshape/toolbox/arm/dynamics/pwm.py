"""Pulses of the valves (3.13-3.15): from the period's start, as long as the command says."""

from __future__ import annotations

from loopshape.core.kernels.compiled import compiled_in_line


@compiled_in_line
def pulse_s(command: float, period_s: float, dead_zone: float) -> float:
    """Length of the pulse in s: |u| T, none up to the dead zone, the whole period within it of 1."""
    size = abs(command)
    if not size > dead_zone:
        return 0.0
    return period_s if size > 1.0 - dead_zone else size * period_s


@compiled_in_line
def is_open(command: float, phase: float, dead_zone: float) -> bool:
    """Whether the pulse of `command` is on at `phase` (0 to 1) of its period, by the sawtooth's rule."""
    return abs(command) > min(max(phase, dead_zone), 1.0 - dead_zone)
