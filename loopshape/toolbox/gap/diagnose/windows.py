"""How long a machine is followed before it is set to the recording again, and the floor that a good one shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from loopshape.core.errors import BadSignalError, LoopshapeError
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.diagnose import attribute
from loopshape.toolbox.gap.diagnose.ceiling import nameless
from loopshape.toolbox.gap.diagnose.evidence import Evidence
from loopshape.toolbox.gap.nouns.plant import SimulationModel, Statable

FIRST_S, SHORTEST_S, LONGEST_S = 0.2, 0.025, 25.6
Log = Callable[[str], None]


def chosen(
    plant: SimulationModel, run: Run, names: Sequence[str], threads: int | None, say: Log, baseline: Run | None = None
) -> SimulationModel:
    """The plant with the window in which a nameless push at one place takes most of the gap away.

    Short windows show little beside the noise, in long ones a model runs away for reasons of its own: from 0.2 s the
    windows are doubled, or halved, as long as the mean logarithm of the gap before over after grows. A plant that
    follows as it was told to comes back as it is. A `baseline` gives the floor in windows of any length.
    """
    windowed = getattr(plant, "windowed", None)
    if windowed is None or not getattr(plant, "open_window", False):
        return against(plant, baseline, threads, say)
    ticks = 20  # of the slowest recording, in a window
    least = max(SHORTEST_S, ticks / min(run.recording(name).rate_hz for name in names))
    gains: dict[float, float] = {}

    def look(window_s: float) -> float:
        if window_s not in gains:
            say(f"windows of {window_s:g} s")
            allowed = least <= window_s <= LONGEST_S
            gains[window_s] = _gain(windowed(window_s), window_s, run, names, threads, baseline) if allowed else -np.inf
        return gains[window_s]

    best = max(FIRST_S, float(least))
    way = 2.0 if look(2.0 * best) > look(best) else 0.5
    while look(way * best) > look(best):
        best *= way
    tried = tuple(sorted(w for w, gain in gains.items() if np.isfinite(gain)))
    return against(windowed(best, tried), baseline, threads, say)


def against(
    plant: SimulationModel, baseline: Run | None, threads: int | None, say: Log = lambda step: None
) -> SimulationModel:
    """The plant whose floors are what it leaves of a machine known to be good, tolerances fitted there too."""
    if baseline is None or not isinstance(plant, Statable):
        return plant
    say("baseline")
    try:
        ready, run, names = plant.readied(baseline, [r.info.name for r in baseline.recordings])
        evidence = Evidence.of(ready, run, names, np.inf, threads)
    except LoopshapeError as error:
        raise type(error)(f"the baseline: {error.what}", error.received, error.way_out) from None
    good = attribute.healthy(evidence)
    return plant.leaving(plant.left(evidence.prepared, good.hypothesis.moves(good.phi)))


def _gain(
    plant: SimulationModel, window_s: float, run: Run, names: Sequence[str], threads: int | None, baseline: Run | None
) -> float:
    """Mean over cells of the logarithm of the gap over what a nameless push leaves; -inf where nothing can be told."""
    try:
        ready, run, names = against(plant, baseline, threads).readied(run, names)
        look_windows, look_s = 5.0, 3.0  # of each recording: so many windows, or seconds if these are more
        longest = max(look_s, look_windows * window_s)
        evidence = Evidence.of(ready, run, names, longest, threads, longest)
    except BadSignalError:  # shorter than a window
        return -np.inf
    fitted = attribute.healthy(evidence)
    found = nameless(evidence, fitted.hypothesis.moves(fitted.phi), fitted.residual)
    if found is None:
        return -np.inf
    return float(np.mean(np.log1p(fitted.mean_squares) - np.log1p(found.best.squares)))
