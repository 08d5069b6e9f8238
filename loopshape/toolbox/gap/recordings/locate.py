"""Where: the block with probabilities, the channel, the band and the operating points that show the gap."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import welch

from loopshape.core.units import Array
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose.decide import Candidate
from loopshape.toolbox.gap.diagnose.evidence import Cell, Evidence
from loopshape.toolbox.gap.nouns.gap_report import Where
from loopshape.toolbox.gap.nouns.plant import SimulationModel


def where(
    run: Run, evidence: Evidence, none: Candidate, probabilities: Mapping[str, float], nearest: str = "unknown"
) -> Where:
    """The place of a gap, from the healthy model's residuals and the probabilities of the effects.

    `nearest` is where something unknown would act.
    """
    plant = evidence.plant
    blocks = block_probabilities(plant, probabilities, nearest)
    verdict = next(iter(probabilities))
    excess = np.maximum(none.fitted.mean_squares - 1.0, 0.0)
    channels = {c.channel: 0.0 for c in evidence.cells}
    for cell, value in zip(evidence.cells, excess, strict=True):
        channels[cell.channel] += float(np.log1p(value))
    channel = max(channels, key=lambda name: channels[name])
    mine = [(c, e) for c, e in zip(evidence.cells, excess, strict=True) if c.channel == channel]
    worst = max(e for _, e in mine)
    clear = [c for c, e in mine if e >= 0.25 * worst]
    points = {tuple(sorted(_point(run, c.recording).items())): None for c in clear}
    return Where(
        block="+".join(sorted(block_of(plant, part, nearest) for part in verdict.split("+"))),
        blocks=blocks,
        channel=channel,
        band_hz=_band(clear, none.fitted.residual, plant.residual_rate_hz(evidence.prepared[0], channel)),
        operating_points=[dict(p) for p in points],
        places=free_disturbances(evidence, none),
    )


def free_disturbances(evidence: Evidence, none: Candidate) -> dict[str, float]:
    """Residual if the equation at each place had an arbitrary disturbance, in channels that it does not reach: rms
    relative to the noise floor.

    A submodel follows what was measured everywhere but in its own channel, so a disturbance that makes its state do
    so too explains that channel and leaves the others as they are.
    """
    squares = none.fitted.mean_squares
    out = {}
    for place, freed in evidence.plant.places.items():
        rest = [0.0] + [ms for cell, ms in zip(evidence.cells, squares, strict=True) if cell.channel not in freed]
        out[place] = float(np.sqrt(np.sum(rest) / max(len(rest) - 1, 1)))
    return dict(sorted(out.items(), key=lambda item: item[1]))


def _point(run: Run, recording: str) -> Mapping[str, float]:
    """The operating point of a recording, or of the longest-named one that it is a piece of."""
    whole = {r.info.name: r.info.operating_point for r in run.recordings}
    if recording in whole:
        return whole[recording]
    parents = [name for name in whole if recording.startswith(f"{name}-")]
    return whole[max(parents, key=len)] if parents else {}


def block_of(plant: SimulationModel, effect: str, nearest: str = "unknown") -> str:
    """The block an effect lives in; none is its own, and unknown lives at `nearest`."""
    return next((f.block for f in plant.effects if f.effect == effect), nearest if effect == "unknown" else effect)


def block_probabilities(
    plant: SimulationModel, probabilities: Mapping[str, float], nearest: str = "unknown"
) -> dict[str, float]:
    """Probabilities summed over the effects and pairs of each block (a+b for pairs), most probable first."""
    out: dict[str, float] = {}
    for name, value in probabilities.items():
        block = "+".join(sorted(block_of(plant, part, nearest) for part in name.split("+")))
        out[block] = out.get(block, 0.0) + value
    return dict(sorted(out.items(), key=lambda item: -item[1]))


def _band(cells: list[Cell], residual: Array, rate_hz: float) -> tuple[float, float]:
    """The band that holds the middle four fifths of the power which the cells' noise does not explain."""
    total: dict[float, float] = {}
    for cell in cells:
        values = residual[cell.part]
        length = min(values.size, round(rate_hz * 8.0))
        f, power = welch(values - values.mean(), rate_hz, nperseg=length)
        noise = cell.floor**2 / (0.5 * rate_hz)
        for frequency, p in zip(f[1:], power[1:], strict=True):
            total[float(frequency)] = total.get(float(frequency), 0.0) + max(float(p) - noise, 0.0)
    frequencies = np.array(sorted(total))
    cumulated = np.cumsum([total[f] for f in frequencies])
    if not cumulated[-1] > 0.0:
        return float(frequencies[0]), float(frequencies[-1])
    share = cumulated / cumulated[-1]
    return float(frequencies[np.searchsorted(share, 0.1)]), float(frequencies[np.searchsorted(share, 0.9)])
