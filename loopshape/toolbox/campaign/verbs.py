"""One study on many simulated machines, a run folder each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from loopshape.toolbox.campaign.machines import Part
from loopshape.verbs.watch import Unwatched, Watch

if TYPE_CHECKING:
    from loopshape.data.signal.run import Run
    from loopshape.toolbox.campaign.machines import Campaign, Machine
    from loopshape.toolbox.campaign.parallel import Job
    from loopshape.toolbox.rig.simulated import Rig
    from loopshape.toolbox.rig.study import Study

NAMED_S = 1.0  # so long may tables that are whole wait to be named in run.toml: naming them together costs it once


def campaign(
    file: str | Path,
    out: str | Path,
    *,
    workers: int = 0,
    cluster: str | None = None,
    part: tuple[int, int] | None = None,
    merge: bool = False,
    watch: Watch | None = None,
) -> Recorded:
    """Record a campaign file: its study on many simulated machines, by tolerance, amplitudes and effects, into `out`.

    What `out` holds already is not made again. `workers` are processes (0: one a core), `cluster` the address of a Dask
    scheduler in their place. `part` (2, 8) makes the second of eight parts in a folder of its own, `merge` joins all
    parts once they are recorded. Processes import the script that calls this: guard its body by
    `if __name__ == "__main__":`. Raises WrongUseError for what the machines cannot do, before anything is written.
    """
    from loopshape.io.files import make_folder
    from loopshape.io.run.run_folder import alone
    from loopshape.toolbox.campaign.parallel import check_workers

    check_workers(workers)
    planned = _planned(Path(file))
    of = None if part is None else Part(*part)
    folder = Path(out) / of.name if of else Path(out)
    make_folder(folder)
    with alone(folder):
        made = (
            _merge(folder, planned) if merge else _record(folder, planned, of, (workers, cluster), watch or Unwatched())
        )
    return Recorded(folder, len(planned.machines), made)


@dataclass(frozen=True)
class Recorded:
    """The folder of a campaign (or of its part), its number of machines, and how many recordings were made now."""

    folder: Path
    machines: int
    recordings: int


@dataclass(frozen=True, eq=False)
class _Planned:
    """A campaign that was checked: its machines, each with the recordings of `names`, in order."""

    machines: Sequence[Machine]
    plant: Rig
    origin: Mapping[str, Any]
    names: tuple[str, ...]

    @property
    def recordings(self) -> int:
        """Number of all."""
        return len(self.machines) * len(self.names)


def _planned(file: Path) -> _Planned:
    """Read and check a campaign; refuses what its machines cannot do, before anything is written."""
    from loopshape.io.provenance import file_sha256
    from loopshape.toolbox.rig import registry
    from loopshape.toolbox.rig.simulated import plan

    asked, study_file = _read(file)
    plant = registry.plant(asked.study.plant)
    machines = list(asked.machines(getattr(plant, "spread", ()), plant.parameters))
    for machine in machines[: len(asked.amplitudes) * len(asked.effects)]:
        names = tuple(one.name for one in plan(machine.study, plant))
    return _Planned(machines, plant, {"study": study_file.name, "study_sha256": file_sha256(study_file)}, names)


def _read(file: Path) -> tuple[Campaign, Path]:
    from loopshape.toolbox.campaign.files import read_campaign
    from loopshape.toolbox.rig import registry
    from loopshape.toolbox.rig.effects import asked

    def of(plant: str, words: Iterable[str]) -> dict[str, float]:
        listed = list(words)
        return asked(registry.plant(plant), listed) if listed else {}

    return read_campaign(file, of)


def _record(out: Path, planned: _Planned, part: Part | None, by: tuple[int, str | None], watch: Watch) -> int:
    """Make what is missing of a campaign or a part of it; workers write tables, and the runs are told of them here."""
    from loopshape.io.run.run_folder import refuse_other, sweep
    from loopshape.toolbox.campaign.files import index_of
    from loopshape.toolbox.campaign.parallel import carried_out

    write_index, there = index_of(out, planned.machines), {path.name for path in out.iterdir()}
    for one in planned.machines:
        if one.name in there:  # what is refused leaves the table of machines as it was
            refuse_other(out / one.name, _run(one.study, one.name, planned.plant, planned.origin))
    write_index()
    wanted = part.recordings(planned.recordings) if part else range(planned.recordings)
    work = partial(_make, out.resolve(), planned.plant, planned.origin)
    started, made = set[str](), 0
    try:
        with (
            closing(_Naming(out, planned)) as naming,
            watch.progress("campaign", len(wanted)) as step,
            closing(carried_out(work, _todo(out, planned, wanted, step, started), *by)) as results,
        ):
            for job, entry in results:
                naming.add(job, entry)
                made += 1
                step(f"{job.machine} {job.planned.name}")
    finally:
        for machine in started:
            sweep(out / machine)
    return made


class _Naming:
    """Names tables that are whole in `run.toml`, those of a second together, while workers make the next ones."""

    def __init__(self, out: Path, planned: _Planned) -> None:
        self._out, self._planned = out, planned
        self._waiting: dict[str, tuple[Study, list[dict[str, Any]]]] = {}
        self._thread = ThreadPoolExecutor(1)
        self._last = self._thread.submit(self._name, {})
        self._next_s = monotonic() + NAMED_S

    def add(self, job: Job, entry: dict[str, Any]) -> None:
        """A table to be named soon; raises what kept an earlier one from being named."""
        self._waiting.setdefault(job.machine, (job.study, []))[1].append(entry)
        if self._last.done() and monotonic() > self._next_s:
            self._last.result()
            self._last = self._thread.submit(self._name, self._waiting)
            self._waiting, self._next_s = {}, monotonic() + NAMED_S

    def close(self) -> None:
        """Name all that are left."""
        with self._thread:
            self._last.result()
            self._name(self._waiting)

    def _name(self, waiting: Mapping[str, tuple[Study, list[dict[str, Any]]]]) -> None:
        from loopshape.io.run.run_folder import adopt

        for machine, (study, entries) in waiting.items():
            run = _run(study, machine, self._planned.plant, self._planned.origin)
            adopt(self._out / machine, run, entries, self._planned.names)


def _todo(out: Path, planned: _Planned, wanted: range, step: Any, started: set[str]) -> Iterator[Job]:
    """What is missing of the recordings with the numbers `wanted`; notes of which machines."""
    from loopshape.io.run.run_folder import finished, start_run
    from loopshape.toolbox.campaign.parallel import Job
    from loopshape.toolbox.rig.simulated import listed

    count = len(planned.names)
    there = {path.name for path in out.iterdir()}
    for k, machine in enumerate(planned.machines):
        mine = range(max(wanted.start - k * count, 0), min(wanted.stop - k * count, count))
        if not mine:
            continue
        have: set[str] = set()
        if machine.name in there:
            run = _run(machine.study, machine.name, planned.plant, planned.origin)
            start_run(out / machine.name, run, [f"{name}.parquet" for name in planned.names])
            have = finished(out / machine.name)
        for one in listed(machine.study, planned.plant)[mine.start : mine.stop]:
            if one.name in have:
                step(f"{machine.name} {one.name}")
            else:
                started.add(machine.name)
                yield Job(machine.name, machine.study, one, machine.hidden)


def _make(out: Path, plant: Rig, origin: Mapping[str, Any], job: Job) -> Callable[[], dict[str, Any]]:
    """What a worker does with a job: fill its table; what this gives puts that in the run's folder and tells of it."""
    from loopshape.core.errors import RigError
    from loopshape.io.run.run_folder import fill_unlisted, read_unlisted
    from loopshape.toolbox.campaign.files import INDEX
    from loopshape.toolbox.campaign.parallel import done

    if not (out / INDEX).is_file():
        raise RigError(
            "a worker does not see the campaign's folder",
            str(out),
            "put it on a disk that all workers mount, or use --part",
        )
    run = _run(job.study, job.machine, plant, origin)
    there = read_unlisted(out / job.machine, run, job.planned.name)
    return (lambda: there) if there else fill_unlisted(out / job.machine, run, done(plant, job))


def _run(study: Study, machine: str, plant: Rig, origin: Mapping[str, Any]) -> Run:
    """The run of a machine, without recordings."""
    from loopshape.io.provenance import KEY, versions
    from loopshape.toolbox.rig.simulated import header

    provenance = {**versions(), "study": origin["study"], "seed": study.seed, "machine": machine}
    return header(study, plant, {"study_sha256": origin["study_sha256"], KEY: provenance})


def _merge(out: Path, planned: _Planned) -> int:
    """Join the recordings of all parts in the runs of a whole campaign, then remove the parts."""
    from loopshape.io.run.run_folder import finished
    from loopshape.toolbox.campaign.files import refuse_parts_at_work, remove_parts, write_index

    refuse_parts_at_work(out)
    write_index(out, planned.machines)
    lacking = [machine for machine in planned.machines if not finished(out / machine.name).issuperset(planned.names)]
    made = _joined(out, planned, lacking) if lacking else 0
    remove_parts(out)
    return made


def _joined(out: Path, planned: _Planned, lacking: Iterable[Machine]) -> int:
    """Join the parts' recordings of machines that lack some; gives how many."""
    from loopshape.io.run.run_folder import adopt, finished
    from loopshape.toolbox.campaign.files import parts, write_index

    folders = parts(out)
    for folder in folders:
        write_index(folder, planned.machines)  # refuses another campaign's
    made = 0
    for machine in lacking:
        run = _run(machine.study, machine.name, planned.plant, planned.origin)
        have = finished(out / machine.name)
        entries = _collected([folder / machine.name for folder in folders], out / machine.name, run, have)
        adopt(out / machine.name, run, entries, planned.names)
        made += len(entries)
        _refuse_incomplete(machine.name, finished(out / machine.name), planned.names)
    return made


def _collected(sources: Iterable[Path], target: Path, run: Run, have: set[str]) -> list[Mapping[str, Any]]:
    """Put the tables of a machine's parts into its run's folder, which does not list them yet; gives their words."""
    from loopshape.io.files import make_folder
    from loopshape.io.run.run_folder import entries_of, has_run
    from loopshape.toolbox.campaign.files import same_file

    make_folder(target)
    found = {}
    for source in sources:
        if source.is_dir() and has_run(source):
            for name, entry in entries_of(source, run).items():
                if name not in have:
                    same_file(source / str(entry["file"]), target / str(entry["file"]))
                    found[name] = entry
    return list(found.values())


def _refuse_incomplete(machine: str, have: set[str], names: Sequence[str]) -> None:
    from loopshape.core.errors import WrongUseError

    if missing := [name for name in names if name not in have]:
        raise WrongUseError(
            "the parts do not hold the whole campaign",
            f"{machine} lacks {', '.join(missing[:5])}" + (" and more" if len(missing) > 5 else ""),
            "let all parts come to their end, then merge again",
        )
