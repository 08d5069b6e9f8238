"""H1 and H2 of one loop from records in open loop: two estimates that err to opposite sides.

With u = x + m and y = H x + n, noises m and n uncorrelated with x and with each other, and any number of averages,

    H1 = Phi_yu / Phi_uu = H / (1 + Phi_mm/Phi_xx)         too small where the input is measured with noise,
    H2 = Phi_yy / Phi_uy = H (1 + Phi_nn/(|H|² Phi_xx))    too large where the output is,

so that |H| lies between both, both have the phase of H, and H1/H2 is the coherence (Bendat and Piersol, Random Data,
4th ed. 2010, 6.1 and 9.2). Under feedback y reaches u, neither holds, and |H| need not lie between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import Array, ComplexArray
from loopshape.data.response.frf import FRF, joined
from loopshape.data.response.frf_arrays import valid_lines
from loopshape.data.signal.experiment import LoopSetup
from loopshape.data.signal.recording import Recording
from loopshape.identify.answers import Answers
from loopshape.identify.quality.quality import stayed_bounded
from loopshape.identify.settings import Settings
from loopshape.identify.signals import LoopSignals, loop_signals
from loopshape.identify.spectra.welch import by_welch


@dataclass(frozen=True, eq=False)
class TwoEstimates:
    """H1 and H2 (1 x 1) on the same lines; each one's covariance is that about its own, biased, expectation."""

    h1: FRF
    h2: FRF

    @property
    def coherence(self) -> Array:
        """H1/H2, (nf,): the share of the output's power that the input explains."""
        return np.asarray((self.h1.siso / self.h2.siso).real)


def h1_h2(recordings: Sequence[Recording], loop: LoopSetup, settings: Settings | None = None) -> TwoEstimates:
    """H1 and H2 of one loop by Welch's segments, spectra averaged over records of one operating point.

    All lines are kept but the two lowest and the last, also those above the excitation: `valid` marks what the
    input feeds and is known to 10 %. The covariance is noise's; a bias that both share (leakage, a resonance sharper
    than the resolution) no difference between them shows. Refuses records in closed loop, sweeps, records with a
    period, or at different rates.
    """
    for recording in recordings:
        _refuse(recording, recordings[0].rate_hz)
    if not recordings:
        raise WrongUseError("H1 and H2 need a record", "none", "give one recording or several of one point")
    settings = settings or Settings()
    parts = [loop_signals(r, loop) for r in recordings]
    answers = [by_welch(r, [s.y, s.u], [s.u], settings) for r, s in zip(recordings, parts, strict=True)]
    longest = max(a.frequency_hz.size for a in answers)
    if any(a.frequency_hz.size < longest for a in answers):  # segments became longer in some
        alike = replace(settings, segment_samples=2 * (longest - 1))
        answers = [by_welch(r, [s.y, s.u], [s.u], alike) for r, s in zip(recordings, parts, strict=True)]
    power = np.mean([a.power for a in answers], axis=0)
    fed = np.logical_and.reduce([a.excited for a in answers])
    averages = float(sum(a.averages for a in answers))
    yy, uu, yu = power[:, 0, 0].real, power[:, 1, 1].real, power[:, 0, 1]
    lines = np.flatnonzero((yy > 0.0) & (uu > 0.0) & (np.abs(yu) > 0.0))
    lines = lines[(lines >= 2) & (lines < yy.size - 1)]
    if not lines.size:
        raise BadSignalError(
            f"no frequency of recording {recordings[0].info.file} has power in input and output",
            answers[0].method,
            "check the columns",
        )
    noise = _Spectra(answers[0], yy[lines], uu[lines], yu[lines], averages, fed[lines], lines)
    return TwoEstimates(
        h1=_frf(noise, noise.yu / noise.uu, "H1", recordings, loop, parts[0]),
        h2=_frf(noise, noise.yy / noise.yu.conj(), "H2", recordings, loop, parts[0]),
    )


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Averaged powers (nf,) on the kept lines."""

    first: Answers
    yy: Array
    uu: Array
    yu: ComplexArray
    averages: float
    fed: np.ndarray
    lines: np.ndarray

    @property
    def coherence(self) -> Array:
        return np.clip(np.abs(self.yu) ** 2 / (self.yy * self.uu), 0.0, 1.0)


def _refuse(recording: Recording, rate_hz: float) -> None:
    info = recording.info
    if info.closed_loop:
        raise WrongUseError(
            f"H1 and H2 are for records in open loop: under feedback both are biased and bracket nothing ({info.file})",
            "closed_loop = true",
            "use estimate_frf, which takes the injected signal as its instrument",
        )
    if info.kind == "sweep":
        raise WrongUseError(
            f"recording {info.file} is a sweep: its segments are not alike, and no variance follows from a coherence",
            "kind = 'sweep'",
            "use estimate_frf",
        )
    if info.period_s is not None:
        raise WrongUseError(
            f"recording {info.file} repeats: whole periods separate noise from signal better than segments do",
            f"period_s = {info.period_s:g}",
            "use estimate_frf",
        )
    if recording.rate_hz != rate_hz:
        raise WrongUseError("records that are averaged share a rate", f"{recording.rate_hz:g} and {rate_hz:g} Hz")


def _frf(
    s: _Spectra,
    response: ComplexArray,
    name: str,
    recordings: Sequence[Recording],
    loop: LoopSetup,
    part: LoopSignals[Array],
) -> FRF:
    """The noun; to first order both scatter by the same share, (1 - coherence)/coherence over the averages."""
    relative = (1.0 - s.coherence) / (s.coherence * max(s.averages - 1.0, 1.0))
    frequency_hz = s.first.frequency_hz[s.lines]
    return FRF(
        frequency_hz=frequency_hz,
        response=response[:, None, None],
        covariance=(np.abs(response) ** 2 * relative)[:, None, None].astype(complex),
        valid=valid_lines(frequency_hz, np.sqrt(relative), s.fed),
        inputs=(part.input_channel.column,),
        outputs=(part.output_channel.column,),
        method=f"{name}, {s.averages:.1f} averages in all; each record by {s.first.method}",
        recording=joined([r.info.name for r in recordings]),
        recordings=tuple(r.info.name for r in recordings),
        loop=loop.name,
        rate_hz=recordings[0].rate_hz,
        operating_point=dict(recordings[0].info.operating_point),
        coherence=s.coherence,
        input_power=s.uu,
        output_power=s.yy,
        cross_power=s.yu,
        power_per=s.first.power_per,
        line_overlap=s.first.line_overlap,
        variance_freedom=2.0 * max(s.averages - 1.0, 1.0),
        averages=s.averages,
        notes=s.first.notes,
        open_loop=stayed_bounded(recordings, [loop], [loop.output]),
    )
