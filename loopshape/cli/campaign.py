"""`loopshape campaign`: one study on many simulated machines, a run folder each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from loopshape.cli.interrupts import interrupts
from loopshape.cli.output import AsJson, Output, Quiet

if TYPE_CHECKING:
    from loopshape.campaign import Campaign, Machine
    from loopshape.rigs.many import Job
    from loopshape.rigs.simulated import Rig


def campaign(
    file: Annotated[Path, typer.Argument(help="A campaign (TOML).", show_default=False)],
    out: Annotated[Path, typer.Option(help="The folder of run folders to write; an interrupted campaign goes on.")],
    workers: Annotated[int, typer.Option(help="Processes on this machine; 0 for one a core.")] = 0,
    cluster: Annotated[str | None, typer.Option(help="Address of a Dask scheduler, in place of processes.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Do a study to many simulated machines: draws of the ordinary spread, amplitudes, effects."""
    import time

    from loopshape import registry
    from loopshape.rigs.many import check_workers
    from loopshape.rigs.simulated import plan
    from loopshape.store.campaigns import write_index
    from loopshape.store.files import make_folder
    from loopshape.store.run_folder import alone

    check_workers(workers)
    output = Output(as_json, quiet)
    asked, study_file = _read(file)
    plant = registry.plant(asked.study.plant)
    machines = list(asked.machines(getattr(plant, "spread", ()), plant.parameters))
    for machine in machines[: len(asked.amplitudes) * len(asked.effects)]:
        plan(machine.study, plant)  # refuses before anything is written
    make_folder(out)
    started = time.monotonic()
    with alone(out), interrupts():
        write_index(out, machines)
        try:
            todo = [job for machine in machines for job in _todo(out, machine, plant, study_file)]
            _record(out, todo, plant, (workers, cluster), output)
        except KeyboardInterrupt:
            output.warn(["interrupted; what the runs list is kept, the same command goes on"])
            raise typer.Exit(130) from None
    wall_s = time.monotonic() - started
    output.say(f"{len(machines)} machines, {len(todo)} recordings made in {wall_s:.1f} s, in {out}")
    output.json({"machines": len(machines), "recordings": len(todo), "wall_s": wall_s})


def _record(out: Path, todo: Sequence[Job], plant: Rig, by: tuple[int, str | None], output: Output) -> None:
    """Do all jobs and write what comes, in order."""
    from loopshape.rigs.many import carried_out
    from loopshape.store.run_folder import add_recording

    with output.progress("campaign", len(todo)) as step, closing(carried_out(plant, todo, *by)) as made:
        for job, recording in made:
            add_recording(out / job.machine, recording)
            step(f"{job.machine} {recording.info.name}")


def _read(file: Path) -> tuple[Campaign, Path]:
    from loopshape import registry
    from loopshape.rigs.effects import asked
    from loopshape.store.campaigns import read_campaign

    def of(plant: str, words: Iterable[str]) -> dict[str, float]:
        listed = list(words)
        return asked(registry.plant(plant), listed) if listed else {}

    return read_campaign(file, of)


def _todo(out: Path, machine: Machine, plant: Rig, study_file: Path) -> Iterator[Job]:
    """What is missing of a machine's run, which is begun where it is not there."""
    from loopshape.rigs.many import Job
    from loopshape.rigs.simulated import header, plan
    from loopshape.store.provenance import KEY, file_sha256, versions
    from loopshape.store.run_folder import finished, start_run

    provenance = {**versions(), "study": study_file.name, "seed": machine.study.seed, "machine": machine.name}
    start_run(
        out / machine.name, header(machine.study, plant, {"study_sha256": file_sha256(study_file), KEY: provenance})
    )
    have = finished(out / machine.name)
    for planned in plan(machine.study, plant):
        if planned.name not in have:
            yield Job(machine.name, machine.study, planned, machine.hidden)
