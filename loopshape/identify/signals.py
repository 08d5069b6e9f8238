"""Which signals of a recording an estimate uses: plant input, output, and the signal that only we moved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from loopshape.core.errors import BadSignalError
from loopshape.core.stretches import Signal, constant, equal, extent, stretches
from loopshape.core.units import Array, ComplexArray
from loopshape.data.signal.channel import Channel, sum_terms
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.tolerances import TOL

S = TypeVar("S", bound=Signal)


@dataclass(frozen=True, eq=False)
class LoopSignals(Generic[S]):
    """Plant input u, output y and instrument n (n,) of one loop, as drawn in `loopshape.loop.loop`.

    u is what enters the plant (z, plus n where n enters there). `instrument` is the injected signal, the
    moving reference, or u itself in open loop. `feedback` tells whether a loop was closed around them.
    """

    u: S
    y: S
    instrument: S
    feedback: bool
    input_channel: Channel
    output_channel: Channel


def loop_signals(recording: Recording, loop: LoopSetup) -> LoopSignals[Array]:
    """As `read_signals`, each whole."""
    s = read_signals(recording, loop)
    u, y, source = (np.asarray(x) for x in (s.u, s.y, s.instrument))
    return LoopSignals(u, y, source, s.feedback, s.input_channel, s.output_channel)


def read_signals(recording: Recording, loop: LoopSetup) -> LoopSignals[Signal]:
    """Signals of a loop in a recording that excites it; those of a long recording are read a stretch at a time.

    Refuses a closed loop without a signal that only we moved (there the data cannot tell plant from
    inverse controller), constant signals, an output that is the same column as another signal, and a control that was
    logged behind the injection and is not stated to be.
    """
    info = recording.info
    refuse_alike(recording, loop)
    refuse_sum(recording, loop)
    u, y = input_signal(recording, loop), recording.signal(loop.output)
    source = moved_signal(recording, loop)
    for signal, what in ((u, "input"), (y, "output"), (source, "injected signal")):
        if constant(signal):
            raise BadSignalError(
                f"the {what} of loop {loop.name} in recording {info.file} is constant",
                f"{float(signal[:1][0]):g} in every row",
                "check the cable, the map, or which loop the recording excites",
            )
    return LoopSignals(u, y, source, info.closed_loop, Channel.from_column(loop.control), output_channel(loop))


def refuse_alike(recording: Recording, loop: LoopSetup) -> None:
    """Refuse an output that holds the same numbers as the control, injected or reference column."""
    y = recording.signal(loop.output)
    for name in dict.fromkeys((loop.control, loop.injected, loop.reference)):
        if (
            name in recording.columns
            and equal(y, recording.signal(str(name)))
            and any(part.any() for (part,) in stretches(y))
        ):
            raise BadSignalError(
                f"{loop.output} and {name} of loop {loop.name} in {recording.info.file} hold the same numbers",
                f"{y.size} equal rows, the first {y[:1][0]:g}",
                "map each to a column of its own in the file",
            )


#: rows and samples of the past by which what a controller gave out is told from its sum with the injection, and how
#: many times less must be left of the one than of the other; less than the last share of its power is rounding
SUM_ROWS, SUM_PAST, CLEARLY, SUM_ROUNDING = 20_000, 8, 10.0, 1e-14


def refuse_sum(recording: Recording, loop: LoopSetup) -> None:
    """Refuse a control that holds the injected signal where it is stated to be logged in front of it."""
    info = recording.info
    if info.injection != "plant_input" or loop.injected not in recording.columns:
        return
    u, n, y = (recording.signal(str(x))[:SUM_ROWS] for x in (loop.control, loop.injected, loop.output))
    if sum_was_logged(*(np.asarray(x, dtype=np.float64) for x in (u, n, y))):
        raise BadSignalError(
            f"{loop.control} of loop {loop.name} in {info.file} holds the injected signal, which would count twice",
            "it answers the injection in the same sample, one to one",
            f"give {loop.control} - {loop.injected} (Run.from_arrays: u - excitation), or in run.toml"
            ' injection = "reference" with the injected column as reference',
        )


def sum_was_logged(u: Array, n: Array, y: Array) -> bool:
    """Whether u (n,) is a controller's output plus the injected n, not the output itself, by which of both the measured
    y of the same sample and a short past of itself and of y predict far better.

    Not told (False) where noise that the controller never saw, or its nonlinearity, outweighs what is new in n.
    """
    if u.size < 20 * SUM_PAST or not n.any():
        return False
    alone, without = (_innovation_power(x, y) for x in (u, u - n))
    return alone > max(CLEARLY * without, SUM_ROUNDING * float(np.var(u)))


def _innovation_power(x: Array, y: Array) -> float:
    """Mean square of what the same sample of y (n,) and the past of x and y do not predict of x (n,)."""
    size = x.size - SUM_PAST
    past = [x[SUM_PAST - k :][:size] for k in range(1, SUM_PAST + 1)] + [
        y[SUM_PAST - k :][:size] for k in range(SUM_PAST + 1)
    ]
    basis = np.stack([*past, np.ones(size)], axis=1)
    basis /= np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    left = x[SUM_PAST:] - basis @ np.linalg.lstsq(basis, x[SUM_PAST:], rcond=None)[0]
    return float(np.mean(left**2))


def input_signal(recording: Recording, loop: LoopSetup) -> Signal:
    """What enters the plant (n,): z, plus the injected signal where it enters there."""
    if recording.info.injection == "plant_input" and loop.injected in recording.columns:
        return recording.signal(f"{loop.control} + {loop.injected}")
    return recording.signal(loop.control)


def _instrument_column(recording: Recording, loop: LoopSetup) -> str | None:
    info = recording.info
    if info.injection == "control" or not info.closed_loop:
        return loop.control
    return loop.reference if info.injection == "reference" else loop.injected


def has_instrument(recording: Recording, loop: LoopSetup) -> bool:
    """Whether the recording holds a signal that only we moved."""
    return _instrument_column(recording, loop) in recording.columns


def moved_signal(recording: Recording, loop: LoopSetup) -> Signal:
    """The signal (n,) that only we moved; refuses a closed loop without one."""
    name = _instrument_column(recording, loop)
    if name is None or name not in recording.columns:
        raise BadSignalError(
            f"recording {recording.info.file} was made in closed loop and has no injected signal for loop {loop.name}",
            f"columns {', '.join(recording.columns)}",
            "name the injected column, or ask for the direct estimator and take its bias",
        )
    return recording.signal(name)


def output_channel(loop: LoopSetup) -> Channel:
    """Channel of a loop's output; a sum of columns goes by the loop's name."""
    if len(sum_terms(loop.output)) > 1:
        return Channel(loop.name, loop.output_unit)
    return Channel.from_column(loop.output)


def held_note(recording: Recording, loop: LoopSetup) -> tuple[str, ...]:
    """A warning where the loop stood clearly elsewhere than its resting reference asked."""
    info = recording.info
    if loop.reference not in recording.columns or not info.closed_loop or info.injection == "reference":
        return ()
    required, found = extent(recording.signal(str(loop.reference))), extent(recording.signal(loop.output))
    gap = abs(required.mean - found.mean)
    if required.most > required.least or gap <= max(0.1 * abs(required.mean), 3.0 * found.std):
        return ()
    unit = loop.output_unit
    return (
        f"loop {loop.name} did not hold its setpoint: {required.least:.3g} {unit} asked,"
        f" {found.mean:.3g} {unit} on average; the FRF is that of where it stood",
    )


def wiring_notes(
    recording: Recording,
    loop: LoopSetup,
    frequency_hz: Array,
    z: ComplexArray,
    y: ComplexArray,
    z_std: Array | None = None,
) -> tuple[str, ...]:
    """Warnings where the log contradicts its description; z, y (nf,) are responses to the instrument.

    With a known controller, z must be its answer to the error; where it is not, the injection or the
    controller is other than stated. Frequencies at which z, with `z_std` (nf,), is mostly noise say nothing of that.
    """
    injection, controller = recording.info.injection, loop.controller
    if not recording.info.closed_loop or injection == "control" or not frequency_hz.size:
        return ()
    notes: tuple[str, ...] = ()
    below = frequency_hz < 0.45 * recording.rate_hz
    if z_std is not None:
        below &= z_std < TOL.known_control_std * np.abs(z)
    if controller is not None and below.any():
        error = -y[below] if injection == "plant_input" else 1.0 - y[below]
        apart = np.abs(z[below] - controller.response(frequency_hz[below]) * error) / np.abs(z[below])
        few = min(5, apart.size)  # a median over neighbouring lines: one bad line is no contradiction
        off = float(np.median(np.lib.stride_tricks.sliding_window_view(apart, few), axis=1).max())
        if off > 0.15:
            notes += (
                f"the logged control of loop {loop.name} is not its controller's answer to the error (off by"
                f" {100.0 * off:.0f} % where it is worst): check injection, controller, units and signs",
            )
    return notes
