"""Recordings of a repeated move and a learning -> the feedforward of the next trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from loopshape.core.errors import WrongUseError
from loopshape.core.json_ready import Plain, keys
from loopshape.core.units import Array
from loopshape.data.signal.channel import Channel
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.learning.noun import Learning


@dataclass(frozen=True, eq=False)
class NextTrial(Plain):
    """What learning makes of a recorded trial: `feedforward` (n,) at the plant's input, in `unit`, for the next one.

    `error_rms` is that of the recorded error. Of several repetitions `repeated_rms` is that of what they have in common
    and `scatter_rms` (None of one repetition) that of the rest, which nothing can learn. `expected_rms` is the next
    trial's: each frequency of the error times the learning's `factor`, what lies above the band as it is, and the
    scatter. That holds for a linear loop whose FRF is right, until what is left lies at the band's end alone.
    """

    IN_JSON: ClassVar[Mapping[str, str]] = keys(
        "loop", "unit", "rate_hz", "repetitions", "error_rms", "repeated_rms", "scatter_rms", "expected_rms"
    )

    feedforward: Array
    unit: str
    rate_hz: float
    loop: str
    repetitions: int
    error_rms: float
    repeated_rms: float
    scatter_rms: float | None
    expected_rms: float

    def __repr__(self) -> str:
        """One line: the error of this trial and of the next."""
        apart = "" if self.scatter_rms is None else f", {self.scatter_rms:.3g} of it not repeated"
        return f"NextTrial: error rms {self.error_rms:.4g}{apart}; next {self.expected_rms:.4g} expected"


@dataclass(frozen=True, eq=False)
class _Repetitions:
    """One move, (repetitions, n): the setpoint and what was injected are one for all."""

    setpoint: Array
    injected: Array
    error: Array
    control: Array


def next_trial(
    L: Learning,
    run: Run,
    *,
    loop: str | None = None,
    recordings: Sequence[str] = (),
    period_s: float | None = None,
) -> NextTrial:
    """The feedforward of the next trial from recordings of the last one: of all the run's, or of those named.

    Error (setpoint less output) and controller's output are averaged over the recordings, and with `period_s` over the
    whole periods of a move that repeats within each. What was injected at the plant's input counts as this trial's
    feedforward, none as zero. `loop` is by default the one of `L`, or the run's only one.

    Raises WrongUseError for recordings of different moves or feedforwards, in open loop, with an excitation at another
    place, without a logged setpoint, or at another rate. Misleads where the logged control holds the feedforward
    already: `run.toml` has it before the injection.

    Examples
    --------
    >>> import numpy as np, loopshape as ls
    >>> f_hz = np.geomspace(0.1, 200.0, 150)
    >>> P = ls.FRF.from_arrays(f_hz, 20.0 / (2j * np.pi * f_hz), relative_std=0.02, rate_hz=1000.0)
    >>> C = ls.controller(ls.gain(0.5), rate_hz=1000.0, loop="axis")
    >>> L = ls.learning(P, C, band_hz=(0.1, 20.0))
    >>> r = np.interp(np.arange(8000) / 1000.0, [2.0, 3.0], [0.0, 1.0])
    >>> y = np.convolve(np.r_[np.zeros(500), r], 0.01 * np.exp(-0.01 * np.arange(500)), mode="valid")[-8000:]
    >>> move = ls.Run.from_arrays(u=0.5 * (r - y), y=y, reference=r, rate_hz=1000.0, loop="axis")
    >>> trial = ls.learning.next_trial(L, move)
    >>> bool(trial.expected_rms < 0.5 * trial.error_rms), trial.feedforward.shape
    (True, (8000,))
    """
    setup = run.loop(loop or L.filter.loop or (run.loops[0].name if len(run.loops) == 1 else ""))
    chosen = [run.recording(name) for name in recordings] or list(run.recordings)
    if not chosen:
        raise WrongUseError("a trial is learned from its recording", "a run without one", "measure the move first")
    found = [_signals(one, setup, L.filter.rate_hz) for one in chosen]
    every = _alike([part for one in found for part in _folded(one, period_s, run.rate_hz)])
    made = L.next(every.injected[0], every.error.mean(axis=0), every.control.mean(axis=0))
    many, rows = every.error.shape[0], found[0].shape[1]
    apart = every.error.std(axis=0, ddof=1) if many > 1 else np.zeros(rows)
    scatter, mean = _rms(apart), every.error.mean(axis=0)
    return NextTrial(
        np.resize(made, rows), Channel.from_column(setup.control).unit, run.rate_hz, setup.name, many,
        _rms(every.error), float(np.sqrt(max(_rms(mean) ** 2 - scatter**2 / many, 0.0))),
        scatter if many > 1 else None, float(np.hypot(_rms(_left(L, mean)), scatter)),
    )  # fmt: skip


def _signals(recording: Recording, loop: LoopSetup, rate_hz: float) -> Array:
    """(4, n): setpoint, what was injected at the plant's input, error, control."""
    place, name = recording.info.injection, recording.info.name
    if place not in ("plant_input", "reference") or recording.info.excites is not None or loop.reference is None:
        raise WrongUseError(
            "learning takes a recording of a move with the loop closed, its setpoint logged",
            f"{name}: injection {place}, excites {recording.info.excites or 'nothing'}, setpoint {loop.reference}",
            "name the move's recordings, and the column of its setpoint in [[loop]]",
        )
    if recording.rate_hz != rate_hz:
        raise WrongUseError(
            "a trial is recorded at the rate of its filters", f"{recording.rate_hz:g} and {rate_hz:g} Hz",
            "make the filters from an FRF at the recording's rate",
        )  # fmt: skip
    r, control = recording.column(loop.reference), recording.column(loop.control)
    known = place == "plant_input" and loop.injected in recording.columns
    u = recording.column(str(loop.injected)) if known else np.zeros(r.size)
    return np.stack([r, u, r - recording.output(loop.output), control])


def _folded(signals: Array, period_s: float | None, rate_hz: float) -> list[Array]:
    """The whole periods (4, period) of one recording; itself without a period."""
    if period_s is None:
        return [signals]
    n, rows = round(period_s * rate_hz), signals.shape[1]
    if not (16 <= n <= rows and abs(n - period_s * rate_hz) < 1e-6 * n):
        raise WrongUseError(
            "the period of a move is a whole number of samples, 16 at least, that the recording holds",
            f"{period_s:g} s at {rate_hz:g} Hz of {rows / rate_hz:g} s",
        )
    return [signals[:, k : k + n] for k in range(0, rows - n + 1, n)]


def _alike(parts: Sequence[Array]) -> _Repetitions:
    """All repetitions; refuses those of another move, or under another feedforward."""
    lengths = {part.shape[1] for part in parts}
    if len(lengths) > 1:
        raise WrongUseError("repetitions of a move have one length", f"{sorted(lengths)} samples", "cut them alike")
    r, u, e, z = np.stack(parts, axis=1)
    alike = 1e-6  # of a signal's reach: how far repetitions of one move may lie apart in setpoint and feedforward
    for what, values in (("setpoint", r), ("feedforward", u)):
        if np.ptp(values, axis=0).max() > alike * np.abs(values).max():
            raise WrongUseError(
                f"the recordings differ in their {what}, so they are no repetitions of one move",
                f"up to {np.ptp(values, axis=0).max():.3g} apart", "name those of the last trial",
            )  # fmt: skip
    return _Repetitions(r, u, e, z)


def _left(L: Learning, error: Array) -> Array:
    """An error (n,) as large as the next trial leaves it: times the factor, and whole where Q is 0."""
    f = np.fft.rfftfreq(error.size, 1.0 / L.filter.rate_hz)
    kept, above = np.abs(np.fft.rfft(error)), np.abs(np.fft.rfft(error - L.smoothed(error)))
    return np.fft.irfft(np.interp(f, L.frequency_hz, L.factor, right=0.0) * kept + above, error.size)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
