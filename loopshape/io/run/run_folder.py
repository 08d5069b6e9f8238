"""Run folders: one `run.toml` and a table per recording, written so that a kill leaves a readable run.

A table is written whole before `run.toml` names it. What is named is therefore complete; a table that is
not named yet is written again when the work resumes.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError, WrongUseError
from loopshape.core.stretches import LongSignal, Signal, equal
from loopshape.data.control.controller import Controller
from loopshape.data.signal.recording import Recording
from loopshape.data.signal.run import Run
from loopshape.io.config_table import ConfigTable, read_words, refuse_doubles
from loopshape.io.files import PART, inside, leave_memory, make_folder, reading, remove_part, short, write_toml
from loopshape.io.folder_lock import alone as alone
from loopshape.io.folder_lock import hold_of, locked
from loopshape.io.provenance import KEY, file_sha256, versions
from loopshape.io.run.journal import ARRIVING, EARLIER, next_earlier, note, note_all, read_journal
from loopshape.io.run.journal import FILE as JOURNAL
from loopshape.io.run.run_signals import check_recordings as check_recordings
from loopshape.io.run.run_tables import loop_table, read_loops, read_outputs, read_recording, recording_table
from loopshape.io.run.tables import TIME, TableColumns, check_rate, fill_table, read_about
from loopshape.io.toml_text import toml_text

FORMAT = "loopshape-run/1"
RUN_TOML = "run.toml"
#: the table of a campaign, beside the folders of its runs
INDEX = "index.csv"
#: `run.toml` of the run that this process holds, as it was last written, and the hold
_WRITTEN: dict[Path, tuple[object, Mapping[str, Any]]] = {}
_KEYS = ("format", "plant", "rate_hz", "outputs", "pwm", "loop", "recording")


def read_run(folder: Path) -> Run:
    """The run in a folder; columns load when asked for, and their stamps are checked then.

    Refuses another format, missing keys, unknown keys in a loop or a recording (unknown keys at the top
    stay in `extra`), `outputs` without a known unit, a recording whose file is missing or lies outside the folder.
    """
    words = read_run_words(folder)
    rate_hz = words.positive("rate_hz")
    loops = read_loops(words, rate_hz)
    tables = words.tables("recording")
    _check_extra(words)
    infos = [read_recording(table, loops) for table in tables]
    refuse_doubles((info.name for info in infos), words.where, "recordings")
    return Run(
        rate_hz=rate_hz,
        loops=loops,
        recordings=tuple(
            Recording(info, rate_hz, _table(folder, words, entry)) for info, entry in zip(infos, tables, strict=True)
        ),
        plant=words.maybe_text("plant"),
        pwm=words.numbers("pwm"),
        extra={key: value for key, value in words.table.items() if key not in _KEYS},
        outputs=read_outputs(words),
    )


def _table(folder: Path, words: ConfigTable, entry: ConfigTable) -> TableColumns:
    """A recording's table; its mark stands on the table, on what is stated of it, on loops and outputs."""
    further = (words.table["outputs"],) if "outputs" in words.table else ()
    stated = repr((words.table["rate_hz"], words.table.get("loop"), *further))
    return TableColumns(
        _existing(folder, entry.text("file")),
        words.positive("rate_hz"),
        entry.maybe_text("sha256"),
        stated + repr(sorted(entry.table.items(), key=str)),
    )


def _check_extra(words: ConfigTable) -> None:
    """Refuse further keys that others read from `extra`, where they are of another kind."""
    words.numbers("parameters")
    words.numbers("effects")
    words.list_of_texts("notes")


def recorded_under(run: Path) -> tuple[Controller, ...]:
    """Controllers under which a run was recorded, as far as it knows them."""
    loops = read_run(run).loops if (run / RUN_TOML).exists() else ()
    return tuple(loop.controller for loop in loops if loop.controller is not None)


def has_run(folder: Path) -> bool:
    """Whether a folder has a `run.toml`, readable or not; refuses one that cannot be looked into."""
    with reading(folder, "a run's folder"):
        return (folder / RUN_TOML).exists()


def read_run_words(folder: Path) -> ConfigTable:
    """The words of `run.toml`; refuses a folder that holds none of this format."""
    with reading(folder, "a run's folder"):
        is_folder, what = folder.is_dir(), "is a file" if folder.exists() else "does not exist"
    if not is_folder:
        raise UnreadableInputError("a run is a folder", f"{folder}, which {what}", "name the folder with run.toml")
    path = folder / RUN_TOML
    hold, last = hold_of(folder), _WRITTEN.get(path)
    if hold is not None and last is not None and last[0] is hold:
        return ConfigTable(tomllib.loads(toml_text(last[1])), path.name)  # as it reads back, and a copy
    if not has_run(folder):
        if any((folder / "frf").glob("*.npz")):
            raise UnreadableInputError(
                "a run has recordings, and this folder holds FRFs alone, of import-frf", folder.resolve().name,
                "fit, tune, check, figures, compare (with another one) and gap --model take it as it is; ls.read needs"
                " recordings (loopshape import), and"
                " ls.formats.read_frf reads the file that it was made from",
            )  # fmt: skip
        way = "write one (docs/files.md, Run), or let loopshape import make the folder"
        raise UnreadableInputError("a run's folder has a run.toml", f"{folder.resolve().name} without one", way)
    words = read_words(path, FORMAT)
    words.need("rate_hz")
    return words


def _write(folder: Path, table: Mapping[str, Any]) -> None:
    """Write `run.toml`, and remember it while the run is held: nobody else changes it."""
    write_toml(folder / RUN_TOML, table)
    _WRITTEN.clear()
    if (hold := hold_of(folder)) is not None:
        _WRITTEN[folder / RUN_TOML] = hold, table


def _existing(folder: Path, file: str) -> Path:
    path = inside(folder, file, "the file of a recording")
    with reading(path, "a recording"):
        is_file = path.is_file()
    if not is_file:
        raise UnreadableInputError(
            "a recording named in run.toml is missing", str(path), "put the file back or take its entry out"
        )
    return path


def finished(folder: Path) -> set[str]:
    """Names of the recordings that `run.toml` lists; empty where there is no run yet."""
    if not has_run(folder):
        return set()
    return {recording.info.name for recording in read_run(folder).recordings}


def whole(folder: Path) -> set[str]:
    """Names of the finished recordings that did not end early."""
    return {r.info.name for r in read_run(folder).recordings if not r.info.ended_early} if has_run(folder) else set()


def holds(folder: Path, recording: Recording) -> bool:
    """Whether a run lists this very recording: same words, same columns, same numbers."""
    if recording.info.name not in finished(folder):
        return False
    there = read_run(folder).recording(recording.info.name)
    wanted = _timed(recording)
    same = there.info == recording.info and there.rate_hz == recording.rate_hz and set(there.columns) == set(wanted)
    return same and all(equal(there.signal(name), values) for name, values in wanted.items())


def marks_as_read(run: Run, names: Iterable[str]) -> dict[str, str]:
    """The marks of recordings of a run as it was read, whatever lies in its folder by now."""
    found = {name: run.recording(name).columns for name in names}
    return {name: columns.mark for name, columns in found.items() if isinstance(columns, TableColumns)}


def excited_names(run: Run) -> set[str]:
    """Names of the estimation recordings from which a loop's FRF follows: they excite one, and did not end early."""
    infos = (recording.info for recording in run.recordings)
    return {i.name for i in infos if i.alone and i.role == "estimation" and i.ended_early is None}


def start_run(folder: Path, run: Run, tables: Sequence[str] = ()) -> None:
    """Make a run folder without recordings, or resume one whose header is the same.

    `run.recordings` are not written; `tables` may lie there before the run does. Refuses a folder that holds other
    things, one that another process is writing, and a run whose loops, rate, plant, outputs or further keys differ
    (`extra["notes"]` may: new notes are added).
    """
    header = _header(run)
    make_folder(folder)
    with locked(folder):
        sweep(folder)
        if has_run(folder):
            _resume(folder, header)
            return
        refuse_foreign(folder, tables)
        _write(folder, header)


def refuse_foreign(folder: Path, tables: Sequence[str] = ()) -> None:
    """Refuse a folder without a run that holds other things than a run's own, and `tables`."""
    ours = (PART, "figures", "frf", "matrix", JOURNAL, EARLIER, ARRIVING, *tables)
    if foreign := [p.name for p in folder.iterdir() if not p.name.endswith(ours)]:
        raise WrongUseError(
            "a folder that is no run is not written into",
            f"{folder}, which holds {', '.join(sorted(foreign)[:5])}",
            "choose a new or an empty folder",
        )


def sweep(folder: Path) -> None:
    """Remove what writes that were killed left in a folder."""
    for left in folder.glob(f".*{PART}"):
        remove_part(left)


def _resume(folder: Path, header: Mapping[str, Any]) -> None:
    words = read_run_words(folder)
    _check_extra(words)
    old = dict(words.table)
    _refuse_lost(folder, words)
    if not old.get("recording"):  # nothing was recorded under the old header
        _write(folder, dict(header))
        return
    _refuse_other(folder, words, header)
    notes = [note for note in header.get("notes", []) if note not in old.get("notes", [])]
    if notes:
        _write(folder, old | {"notes": old.get("notes", []) + notes})


def _refuse_other(folder: Path, words: ConfigTable, header: Mapping[str, Any]) -> None:
    """Refuse a folder that has the run of another header."""
    old = words.table
    differing = sorted(
        key
        for key in (set(old) | set(header)) - {"recording", "notes", KEY}
        if key not in old or key not in header or old[key] != header[key]
    )
    if differing:
        raise WrongUseError(
            f"{folder} already holds another run",
            f"different {short(', '.join(differing))}",
            "choose another folder, or delete this one",
        )


def refuse_other(folder: Path, run: Run) -> None:
    """Refuse a folder in which recordings of another run are, and change nothing."""
    if has_run(folder) and (words := read_run_words(folder)).table.get("recording"):
        _refuse_other(folder, words, _header(run))


def _refuse_lost(folder: Path, words: ConfigTable) -> None:
    """Refuse a run that no longer lists what its journal calls finished: going on would write over it."""
    lines, _ = read_journal(folder)
    listed = _listed(words)
    done = dict.fromkeys(str(line.get("recording")) for line in lines if line["event"] == "finished")
    if lost := [name for name in done if name not in listed]:
        raise UnreadableInputError(
            f"{folder / RUN_TOML} no longer lists recordings that were finished",
            ", ".join(lost[:5]) + (f" and {len(lost) - 5} more" if len(lost) > 5 else ""),
            f"put it back; to record them anew on purpose, delete {JOURNAL}",
        )


def _header(run: Run) -> dict[str, Any]:
    """`run.toml` without recordings, as it reads back."""
    if taken := set(run.extra) & set(_KEYS):
        raise WrongUseError("a run's further keys must not be its own", ", ".join(sorted(taken)))
    table: dict[str, Any] = {"format": FORMAT, "plant": run.plant, "rate_hz": float(run.rate_hz)}
    table["outputs"] = list(read_outputs(ConfigTable({"outputs": list(run.outputs)}, "the run"))) or None
    table |= dict(run.extra) | {"pwm": dict(run.pwm) or None, "loop": [loop_table(loop) for loop in run.loops] or None}
    return tomllib.loads(toml_text(table))


def add_recording(folder: Path, recording: Recording, *, again: bool = False) -> None:
    """Write a recording's table, then name it in `run.toml`; a kill in between leaves the run as it was.

    Made `again`, it takes the place of one of its name that ended early, whose table goes to the folder `earlier`.
    Refuses a run that another process is writing, a recording that is there already, another rate, stamps off the
    rate, a file that does not end in `.parquet`, and words that `read_run` would refuse.
    """
    with locked(folder):
        words = read_run_words(folder)
        there = next((e.table for e in words.tables("recording") if _name(e.table) == recording.info.name), None)
        if there is None:
            _list(folder, words.table, [_written(folder, words, recording)])
        elif again and there.get("ended_early"):
            _put_in_place_of(there, folder, words, recording)
        else:
            raise WrongUseError(
                f"{folder} already holds a recording of this name", repr(recording.info.name), "give it another"
            )


def _put_in_place_of(old: Mapping[str, Any], folder: Path, words: ConfigTable, recording: Recording) -> None:
    """Write a recording under a file of its own, name it where the old one was, and keep that one's table."""
    name, listed = recording.info.name, list(words.table["recording"])
    kept = next_earlier(folder, name)
    file = f"{name}.again-{kept.stem.rpartition('-')[2]}.parquet"
    entry = _written(folder, words, replace(recording, info=replace(recording.info, file=file)))
    others = [one for one in listed if _name(one) != name]
    _list(folder, dict(words.table) | {"recording": others}, [entry], [_name(one) for one in listed])
    os.replace(inside(folder, old["file"], "the file of a recording"), kept)
    note(folder, "kept", recording=name, file=f"{EARLIER}/{kept.name}", ended_early=old["ended_early"])


def fill_unlisted(folder: Path, run: Run, recording: Recording) -> Callable[[], dict[str, Any]]:
    """Write a recording's table into the folder of a run; what this gives puts it in place, whole, and tells its words.

    Those are for `adopt`, which names it in `run.toml`. Needs no hold on the folder, and no `run.toml`. Refuses what
    `add_recording` refuses of a recording.
    """
    make_folder(folder)
    entry, put_in_place = _filled(folder, ConfigTable(_header(run), "the run"), recording)

    def adopted() -> dict[str, Any]:
        put_in_place()
        leave_memory(folder / entry["file"])
        return entry

    return adopted


def read_unlisted(folder: Path, run: Run, name: str) -> dict[str, Any] | None:
    """The words of a table that `fill_unlisted` left whole, made by these versions for this run; None without one."""
    path = folder / f"{name}.parquet"
    if not path.is_file():
        return None
    with suppress(UnreadableInputError):
        about = read_about(path)
        entry = about.get("recording")
        if isinstance(entry, dict) and about == _about(ConfigTable(_header(run), "the run"), entry):
            return entry | {"sha256": file_sha256(path)}
    return None


def adopt(folder: Path, run: Run, entries: Sequence[Mapping[str, Any]], order: Sequence[str]) -> None:
    """Name tables of `fill_unlisted` in a run's `run.toml`, in the `order` of names, and begin it where it is missing.

    Refuses a run that another process is writing, and one whose header differs. What is named is not named again.
    """
    with locked(folder):
        header = _header(run)
        words = read_run_words(folder) if has_run(folder) else ConfigTable(header, "the run")
        _refuse_other(folder, words, header)
        there = _listed(words)
        _list(folder, words.table, [entry for entry in entries if _name(entry) not in there], order)


def entries_of(folder: Path, run: Run) -> dict[str, dict[str, Any]]:
    """The words of a run's recordings by name, for another folder's `adopt`; refuses a run of another header."""
    words = read_run_words(folder)
    _refuse_other(folder, words, _header(run))
    for entry in words.tables("recording"):
        _existing(folder, entry.text("file"))
    return {_name(entry.table): dict(entry.table) for entry in words.tables("recording")}


def _name(entry: Mapping[str, Any]) -> str:
    return str(entry.get("file", "")).split(".")[0]


def _listed(words: ConfigTable) -> set[str]:
    return {_name(entry.table) for entry in words.tables("recording")}


def _list(
    folder: Path, table: Mapping[str, Any], entries: Sequence[Mapping[str, Any]], order: Sequence[str] = ()
) -> None:
    """Name tables that are whole in `run.toml`, and in the journal."""
    place = {name: k for k, name in enumerate(order)}
    both = sorted([*table.get("recording", []), *entries], key=lambda entry: place.get(_name(entry), len(place)))
    _write(folder, dict(table) | {"recording": both})
    note_all(
        folder,
        "finished",
        [{"recording": _name(e), "sha256": e["sha256"], "ended_early": e.get("ended_early")} for e in entries],
    )


def _written(folder: Path, words: ConfigTable, recording: Recording) -> dict[str, Any]:
    """Write a table of the run that `words` begin; gives its words for `run.toml`."""
    entry, put_in_place = _filled(folder, words, recording)
    put_in_place()
    return entry


def _filled(folder: Path, words: ConfigTable, recording: Recording) -> tuple[dict[str, Any], Callable[[], None]]:
    """The first half of `_written`: the words, and the second half, which puts the table in place."""
    rate_hz = words.positive("rate_hz")
    entry = _entry(recording)
    info = read_recording(ConfigTable(entry, f"recording {recording.info.name!r}"), read_loops(words, rate_hz))
    if not info.file.endswith(".parquet") or recording.rate_hz != rate_hz:
        raise WrongUseError(
            f"a recording of this run is a .parquet file at {rate_hz:g} Hz", f"{info.file} at {recording.rate_hz:g} Hz"
        )
    path = inside(folder, info.file, "the file of a recording")
    digest, put_in_place = fill_table(path, _timed(recording), _about(words, entry))
    return entry | {"sha256": digest}, put_in_place


def _about(words: ConfigTable, entry: Mapping[str, Any]) -> dict[str, Any]:
    """What a table says of itself."""
    return {"made_by": versions(), "recording": entry, **_origin(words)}


def _origin(words: ConfigTable) -> dict[str, Any]:
    return {key: words.table[key] for key in ("study_sha256", KEY) if key in words.table}


def _entry(recording: Recording) -> dict[str, Any]:
    loaded = tomllib.loads(toml_text({"recording": [recording_table(recording.info)]}))
    return dict(loaded["recording"][0])


def _timed(recording: Recording) -> dict[str, Signal]:
    """The columns, with `t_s` in front; given stamps are checked, missing ones are made from the rate."""
    columns = {name: recording.stored(name) for name in recording.columns}
    if TIME in columns:
        check_rate(columns[TIME], recording.rate_hz, recording.info.file)
        return columns
    n = next(iter(columns.values())).size if columns else 0
    if any(isinstance(values, LongSignal) for values in columns.values()):
        return {TIME: LongSignal(n, lambda start, stop: np.arange(start, stop) / recording.rate_hz), **columns}
    return {TIME: np.arange(n) / recording.rate_hz, **columns}


def write_run(folder: Path, run: Run) -> None:
    """Write a run with all its recordings, or add its recordings to the same run that is there already."""
    start_run(folder, run)
    for recording in run.recordings:
        add_recording(folder, recording)
