"""Two runs of one machine -> GapTable: the same estimators on both, and nothing assumed of the machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.units import db
from loopshape.data.response.frf import FRF
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.toolbox.gap.nouns.gap_table import DistortionLevels, GapRow, GapTable, NuGapRow
from loopshape.toolbox.gap.two_runs.level_dependence import LevelDependence
from loopshape.toolbox.gap.two_runs.levels import at_level, dependences, level_of
from loopshape.toolbox.gap.two_runs.nu_gap import NuGap, nu_gap, order_of, shaped
from loopshape.toolbox.gap.two_runs.table_pairs import Pair, check_runs, pair_recordings
from loopshape.toolbox.gap.two_runs.table_paths import (
    Path,
    PathFrfs,
    bands_hz,
    common_frfs,
    difference,
    in_band,
    known_lines,
    on_common_lines,
    paths_of,
)
from loopshape.toolbox.gap.two_runs.table_times import time_rows
from loopshape.toolbox.rig.distortion import Distortion, distortion

#: lines that a band needs for a row
FEWEST = 2

Frfs = tuple[Pair, FRF, FRF]


def compare(
    real: Run, sim: Run, *, bands: str = "third_decade", real_name: str = "real", sim_name: str = "sim"
) -> GapTable:
    """What separates two runs: FRFs of every path by band and operating point, nu-gaps, and time responses.

    Recordings are matched by file name, else by kind, injection, excited loop, operating point and order. `bands`
    is "third_decade" or "octave". What does not match, or cannot be estimated, is reported in the table. Held-out
    recordings are compared too: nothing is fitted here. Excitations that differ in size or phases give differences
    of their own where the machine is not linear: replay the real run's.

    Raises WrongUseError for runs at different rates, without a common loop, and another kind of band.
    """
    bands_hz(bands, 1.0, 2.0)
    notes = list(check_runs(real, sim))
    pairs, unmatched = pair_recordings(real.recordings, sim.recordings)
    rows: list[GapRow] = []
    own: list[Frfs] = []
    times = []
    for pair in pairs:
        notes += _early(pair)
        if pair.real.info.excites is None:
            found, why = time_rows(real, pair)
            times += found
            notes += [why] if why else []
            continue
        for path in paths_of(real, pair.real):
            try:
                frfs = common_frfs((real, sim), (pair.real, pair.sim), path)
            except (BadSignalError, WrongUseError) as error:
                notes.append(f"{pair.real.info.name}, {path.name}: {error}")
                continue
            rows += _path_rows(real, sim, pair, path, frfs, bands)
            notes += _seen_once(pair, path, frfs.real, frfs.sim)
            own += [(pair, frfs.real, frfs.sim)] if path.loop is not None else []
    return GapTable(
        real=real_name,
        sim=sim_name,
        rows=tuple(rows),
        nu_gaps=tuple(_nu_rows(real, own)),
        times=tuple(times),
        unmatched=unmatched,
        notes=tuple(dict.fromkeys(notes)),
        levels=_level_dependences(real, sim, own),
    )


def _level_dependences(real: Run, sim: Run, own: Sequence[Frfs]) -> tuple[LevelDependence, ...]:
    """Those of the real run; where it has one level only, of both runs as of one machine."""
    ours = [at_level(real, pair.real, one) for pair, one, _ in own]
    return dependences(ours) or dependences([*ours, *(at_level(sim, pair.sim, two) for pair, _, two in own)])


def _early(pair: Pair) -> list[str]:
    return [f"{r.info.name} ended early: {r.info.ended_early}" for r in (pair.real, pair.sim) if r.info.ended_early]


def _path_rows(real: Run, sim: Run, pair: Pair, path: Path, frfs: PathFrfs, bands: str) -> list[GapRow]:
    """One row for each band with lines that both runs know."""
    one = frfs.real
    known = known_lines(one, frfs.sim)
    if not known.any():
        return []
    common = _common(real, pair, path)
    bent = [_distortion(r, run, path) for r, run in ((pair.real, real), (pair.sim, sim))]
    seen = one.frequency_hz[known]
    rows = []
    for band in bands_hz(bands, float(seen[0]), float(seen[-1])):
        lines = in_band(one, known, band)
        if np.count_nonzero(lines) >= FEWEST:
            found = asdict(difference(frfs.select(lines)))
            levels = [_levels(x, band) for x in bent]
            rows.append(
                GapRow(band_hz=band, distortion_real=levels[0], distortion_sim=levels[1], **common, **found)  # type: ignore[arg-type]
            )
    return rows


def _common(real: Run, pair: Pair, path: Path) -> dict[str, object]:
    """What all rows of a path in one pair of recordings share."""
    info, loop = pair.real.info, real.loop(str(pair.real.info.excites))
    level, unit = level_of(pair.real, loop)
    return {
        "path": path.name,
        "recording": info.name,
        "simulated": pair.sim.info.name,
        "loop": loop.name,
        "operating_point": dict(info.operating_point),
        "amplitude": level,
        "amplitude_unit": unit,
        "parameters": dict(info.parameters),
    }


def _distortion(recording: Recording, run: Run, path: Path) -> Distortion | None:
    """Distortion of a loop's own path, where its excitation shows any."""
    if path.loop is None or recording.info.period_s is None:
        return None
    try:
        found = distortion(recording, run.loop(path.loop))
    except BadSignalError:
        return None
    return found if found.decidable else None


def _levels(found: Distortion | None, band: tuple[float, float]) -> DistortionLevels | None:
    """Odd and even distortion in a band re the linear response there, in dB; None where there are no such lines."""
    linear = None if found is None or found.excited is None else found.excited.between(*band).rms
    if found is None or not linear:
        return None
    odd, even = (None if x is None else x.between(*band).rms for x in (found.odd, found.even))
    levels = [float(db(x / linear)) if x else None for x in (odd, even)]
    return None if levels == [None, None] else DistortionLevels(*levels)


def _seen_once(pair: Pair, path: Path, one: FRF, two: FRF) -> list[str]:
    """A note where only one of both runs knows a band: a gap may hide there."""
    known = known_lines(one, two)
    alone = [(x.valid & ~known, word) for x, word in ((one, "real"), (two, "simulated"))]
    return [
        f"{pair.real.info.name}, {path.name}: {np.count_nonzero(rows)} lines are known in the {word} run alone, from"
        f" {one.frequency_hz[rows][0]:.3g} to {one.frequency_hz[rows][-1]:.3g} Hz"
        for rows, word in alone
        if np.count_nonzero(rows) > 0.1 * np.count_nonzero(known)
    ]


def _nu_rows(real: Run, own: Sequence[Frfs]) -> list[NuGapRow]:
    """Nu-gap of real against sim at each operating point, and as its scale between neighbouring real ones."""
    rows = []
    for pair, one, two in own:
        if real.loop(str(pair.real.info.excites)).controller is None:
            continue
        found = _shaped_gap(real, one, two)
        if found is None:
            continue
        scale, near = _neighbour(real, pair, one, own)
        rows.append(
            NuGapRow(
                loop=one.loop,
                recording=pair.real.info.name,
                operating_point=dict(pair.real.info.operating_point),
                value=found.value,
                interval=found.interval,
                at_hz=found.at_hz,
                winding=found.winding,
                reason=found.reason,
                scale=scale,
                scale_to=near,
            )
        )
    return rows


def _shaped_gap(real: Run, one: FRF, two: FRF) -> NuGap | None:
    """Nu-gap of two plants under the real run's controller, on lines that both know; None without any."""
    controller = real.loop(one.loop).controller
    known = known_lines(one, two)
    if controller is None or not known.any():
        return None
    plants = [x.select(known) for x in (one, two)]
    orders = [order_of(x) for x in plants]
    more = controller.integrators()
    integrators = tuple(None if k is None else k + more for k in orders)
    return nu_gap(
        shaped(plants[0], controller), shaped(plants[1], controller), integrators=(integrators[0], integrators[1])
    )


def _neighbour(real: Run, pair: Pair, one: FRF, own: Sequence[Frfs]) -> tuple[float | None, Mapping[str, float] | None]:
    """Nu-gap to the nearest other real operating point of the same loop, and that point."""
    here = pair.real.info.operating_point
    others = [(p, frf) for p, frf, _ in own if frf.loop == one.loop and _elsewhere(p, pair)]
    if not others:
        return None, None
    points = np.array([[p.real.info.operating_point[k] for k in here] for p, _ in others])
    away = points - np.array(list(here.values()))
    spans = np.maximum(np.abs(away).max(axis=0), 1e-12)
    nearest, frf = others[int(np.argmin(((away / spans) ** 2).sum(axis=1)))]
    try:
        found = _shaped_gap(real, *on_common_lines(one, frf))
    except WrongUseError:
        return None, None
    return (None if found is None else found.value), dict(nearest.real.info.operating_point)


def _elsewhere(other: Pair, pair: Pair) -> bool:
    """Whether another pair was made alike at another operating point in the same coordinates."""
    there, here = other.real.info, pair.real.info
    alike = (there.kind, there.period_s) == (here.kind, here.period_s)
    moved = set(there.operating_point) == set(here.operating_point)
    return alike and moved and dict(there.operating_point) != dict(here.operating_point)
