"""Somebody else's recording as a run: a file and a map in, a `Run` with one recording out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from loopshape.core.errors import BadSignalError, WrongUseError
from loopshape.core.stretches import LongColumns, LongSignal, Signal, stretches
from loopshape.core.units import Array
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.io.config_table import said_in
from loopshape.io.files import short
from loopshape.io.run.tables import TIME
from loopshape.io.stamps import ON_GRID, Stamps, check_rate, read_stamps
from loopshape.toolbox.formats.tables.import_map import ColumnRule, ImportMap, read_map
from loopshape.toolbox.formats.tables.made_columns import make_columns
from loopshape.toolbox.formats.tables.sources import Source, open_source

_GAP = 1.5  # median steps


def import_file(file: Path, map_file: Path, beside: Path | None = None, *, accept_draft: bool = False) -> Run:
    """The run that a map makes of a file, of one recording or one of each episode; `run_folder.write_run` stores it.

    The recording is in memory; a long one is read from its file as it is asked for, of CSV from a copy of its numbers
    on the disk of the folder `beside`. What has to be resampled is held whole.

    Reads CSV and other text (.csv, .csv.gz, .txt, .tsv, .dat), MAT up to v7 and v7.3, Parquet, NPZ and MDF; the
    keys of the map stand in `import_map`. Refuses whatever the map does not say (`WrongUseError`), damaged files
    (`UnreadableInputError`), and values or stamps that are no recording (`BadSignalError`). Where
    stamps jitter or were resampled, `extra["notes"]` says how, how many gaps there were and how long. A map that is a
    draft is refused unless `accept_draft`; then the notes hold each of its guesses.
    """
    rules = read_map(map_file, file.name.split(".")[0], accept_draft=accept_draft)
    places = [rule.place for rule in (*rules.columns, rules.time) if rule is not None]
    source = open_source(file, rules.csv, places, beside)
    if not source.pieces and not rules.episodes:
        return _one(file, source, rules)
    if unknown := sorted({*rules.episodes} - {*source.pieces}):
        raise WrongUseError(
            f"{file.name} does not hold these episodes of [recording]", short(", ".join(map(str, unknown))),
            f"it holds {short(', '.join(map(str, source.pieces))) or 'one recording'}: name those, or none",
        )  # fmt: skip
    runs = []
    for k in rules.episodes or source.pieces:
        info = replace(rules.info, file=f"{rules.info.name}-episode-{k}.parquet")
        runs.append(_one(file, source.piece(k), replace(rules, info=info)))
    notes = [note for run in runs for note in run.extra["notes"]]
    recordings = tuple(recording for run in runs for recording in run.recordings)
    return replace(runs[0], recordings=recordings, extra={**runs[0].extra, "notes": notes})


def _one(file: Path, source: Source, rules: ImportMap) -> Run:
    """The run with one recording that a map makes of a file's arrays."""
    columns: Mapping[str, Signal] = {rule.stored: _signal(source, rule) for rule in rules.columns}
    notes = [f"{rules.info.name}: imported from {file.name}"]
    if rules.guesses:
        notes.append(f"{rules.info.name}: from a draft map that was not confirmed: {' '.join(rules.guesses)}")
    stamps = _signal(source, rules.time) if rules.time else None
    for rule in rules.columns:
        if rule.own_time is not None:
            columns, note = _to_one_rate(columns, rule, source, stamps, file)
            notes.append(f"{rules.info.name}: {note}")
    _check_lengths(columns, file)
    if stamps is not None:
        _check_lengths({TIME: stamps, **columns}, file)
        stamps = _cut(stamps, rules, file)
    columns = {name: _cut(values, rules, file) for name, values in columns.items()}
    if stamps is not None and rules.resample:
        whole = {name: np.asarray(values) for name, values in columns.items()}
        columns, note = _resample(np.asarray(stamps), whole, rules.rate_hz, file.name)
        notes.append(f"{rules.info.name}: {note}")
    elif stamps is not None and (note := check_rate(stamps, rules.rate_hz, file.name)):
        notes.append(f"{rules.info.name}: {note}")
    columns, made = make_columns(columns, rules.made, rules.loops)
    return _run(rules, columns, [*notes, *(f"{rules.info.name}: {note}" for note in made)])


def _run(rules: ImportMap, columns: Mapping[str, Signal], notes: list[str]) -> Run:
    n = next(iter(columns.values())).size
    time: Signal = LongSignal(n, lambda start, stop: np.arange(start, stop) / rules.rate_hz)
    if any(isinstance(values, LongSignal) for values in columns.values()):
        table: Mapping[str, Array] = LongColumns({TIME: time, **columns})
    else:
        table = {TIME: np.asarray(time), **{name: np.asarray(values) for name, values in columns.items()}}
    parameters = {"parameters": dict(rules.parameters)} if rules.parameters else {}
    return Run(
        rate_hz=rules.rate_hz,
        loops=rules.loops,
        recordings=(Recording(rules.info, rules.rate_hz, table),),
        plant=rules.plant,
        pwm=rules.pwm,
        extra={**parameters, "notes": notes},
        outputs=rules.outputs,
    )


def _signal(source: Source, rule: ColumnRule) -> Signal:
    with said_in(rule.stored):
        found = source.signal(rule.place)
    if isinstance(found, LongSignal):
        return LongSignal(found.size, lambda start, stop: rule.scale * found[start:stop] + rule.shift)
    return rule.scale * found + rule.shift


def _to_one_rate(
    columns: Mapping[str, Signal], rule: ColumnRule, source: Source, stamps: Signal | None, file: Path
) -> tuple[Mapping[str, Signal], str]:
    """A column with stamps of its own at the recording's stamps, by straight lines, and what that costs."""
    own = np.asarray(source.signal(rule.own_time or rule.place))
    if stamps is None or own.size < 2 or not np.all(np.diff(own) > 0.0):
        raise WrongUseError(
            f"{rule.stored} of {file.name} has stamps of its own",
            "no time of the recording, or stamps that do not rise",
            "write time = { from = ..., unit = ... } for the recording too",
        )  # fmt: skip
    values, t = np.asarray(columns[rule.stored]), np.asarray(stamps)
    _check_lengths({rule.stored: values, "its stamps": own}, file)
    step = float(np.median(np.diff(own)))
    note = (
        f"{rule.stored} was brought from its own {1.0 / step:.4g} Hz to the recording's stamps by straight lines: it is"
        f" smoothed above {0.1 / step:.3g} Hz, and its delay is known to {0.5 * step:.2g} s"
    )
    return {**columns, rule.stored: np.interp(t, own, values)}, note


def _check_lengths(columns: Mapping[str, Signal], file: Path) -> None:
    if len({values.size for values in columns.values()}) != 1:
        raise WrongUseError(
            f"the columns taken from {file.name} differ in length",
            ", ".join(f"{name} {values.size}" for name, values in columns.items()),
            "take columns of one recording",
        )


def _cut(values: Signal, rules: ImportMap, file: Path) -> Signal:
    """The rows that the map takes; refuses rows that are not there and values that are not numbers."""
    last = rules.to_row if rules.to_row is not None else values.size
    if not rules.from_row + 1 < last <= values.size:
        raise WrongUseError(
            f"{file.name} has {values.size} rows", f"rows {rules.from_row + 1} to {last}", "take at least two of them"
        )
    out = _rows_of(values, rules.from_row, last)
    bad, first, row = 0, 0, rules.from_row
    for (part,) in stretches(out):
        wrong = np.flatnonzero(~np.isfinite(part))
        if wrong.size and not bad:
            first = row + int(wrong[0]) + 1
        bad, row = bad + wrong.size, row + part.size
    if bad:
        raise BadSignalError(
            f"a column taken from {file.name} holds {bad} values that are not numbers",
            f"the first in row {first}",
            "repair the file, or cut it with from_row and to_row",
        )
    return out


def _rows_of(values: Signal, first: int, last: int) -> Signal:
    if not isinstance(values, LongSignal):
        return values[first:last]
    return LongSignal(last - first, lambda start, stop: values[first + start : first + stop])


def _resample(stamps: Array, columns: dict[str, Array], rate_hz: float, file: str) -> tuple[dict[str, Array], str]:
    """Columns on a grid of `rate_hz`, and a sentence about how they came there.

    Even stamps, rounded or jittering, are no reason to bend a period: rows that keep the rate are taken as they are,
    others by a smooth spline from the rate of all stamps. Across gaps, and between uneven stamps, by straight lines.
    """
    if stamps.size > 3 and 0.0 < (mean := float(np.ptp(stamps)) / (stamps.size - 1)) < np.inf:
        found = read_stamps(stamps, 1.0 / float(np.median(np.diff(stamps)) or mean))
        found = read_stamps(stamps, found.rate_hz if np.isfinite(found.rate_hz) else 1.0 / mean)
        if found.even and (found.rounding_alone or np.diff(stamps).min() > 0.0):
            return _evenly(stamps, columns, rate_hz, found, file)
    return _by_straight_lines(stamps, columns, rate_hz, file)


def _evenly(
    stamps: Array, columns: dict[str, Array], rate_hz: float, found: Stamps, file: str
) -> tuple[dict[str, Array], str]:
    """Columns of even stamps: as they are where they keep the rate, else by splines through their true times."""
    scatter = f"{stamps.size} stamps that keep {found.rate_hz:.6g} Hz in all and scatter by {found.jitter_s:.2g} s rms"
    slack = ON_GRID + found.unsure
    if abs(found.rate_hz / rate_hz - 1.0) * stamps.size <= slack and found.rounding_alone:
        return columns, f"not resampled: {scatter}, which is {rate_hz:g} Hz"
    from scipy.interpolate import make_interp_spline

    times = np.arange(stamps.size) / found.rate_hz if found.rounding_alone else stamps - stamps[0]
    grid = np.arange(_rows(times, rate_hz, file)) / rate_hz
    made = {
        name: make_interp_spline(times, values, k=min(5, stamps.size - 1))(grid) for name, values in columns.items()
    }
    return made, f"resampled to {rate_hz:g} Hz by splines from {scatter}{_folded(rate_hz, found.rate_hz)}"


def _rows(stamps: Array, rate_hz: float, file: str) -> int:
    """Rows at `rate_hz` between the first stamp and the last; refuses far more than there were, and fewer than two."""
    n = np.floor((stamps[-1] - stamps[0]) * rate_hz + 1e-9) + 1
    if not 2 <= n <= 50 * stamps.size:  # times the file's rows; more comes from a wrong unit of the stamps
        raise WrongUseError(
            f"{stamps.size} rows of {file} would become {n:.0f} at {rate_hz:g} Hz",
            f"stamps over {stamps[-1] - stamps[0]:g} s",
            "check the unit of time and rate_hz",
        )
    return int(n)


def _by_straight_lines(
    stamps: Array, columns: dict[str, Array], rate_hz: float, file: str
) -> tuple[dict[str, Array], str]:
    """Columns on a grid of `rate_hz` by linear interpolation, and a sentence about the gaps."""
    steps = np.diff(stamps)
    late = np.flatnonzero(steps <= 0.0)
    if late.size:
        raise BadSignalError(
            f"the time stamps of {file} do not rise at row {late[0] + 2} of those taken",
            f"a step of {steps[late[0]]:.6g} s",
            "sort the file, or cut it with from_row and to_row",
        )
    grid = stamps[0] + np.arange(_rows(stamps, rate_hz, file)) / rate_hz
    return {name: np.interp(grid, stamps, values) for name, values in columns.items()}, _gap_note(steps, rate_hz)


def _gap_note(steps: Array, rate_hz: float) -> str:
    median = float(np.median(steps))
    gaps = steps[steps > _GAP * median]
    stamps = f"{steps.size + 1} stamps, {1.0 / median:.6g} Hz in the median"
    note = f"resampled to {rate_hz:g} Hz by linear interpolation from {stamps}"
    if gaps.size:
        note += f"; {gaps.size} gaps of over {_GAP:g} steps, the largest {gaps.max():.6g} s, {gaps.sum():.6g} s in all"
    return note + _folded(rate_hz, 1.0 / median)


def _folded(rate_hz: float, file_rate_hz: float) -> str:
    if rate_hz >= 0.9 * file_rate_hz:
        return ""
    return "; the rate is lower than the file's and nothing was filtered, so faster content is folded down"
