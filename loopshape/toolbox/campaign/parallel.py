"""Recordings of many machines: what is to be made, and how it is shared out.

Whoever makes a job makes the same to the last bit, so workers that die cost time and nothing else.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from loopshape.core.errors import WrongUseError
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.campaign.cluster import by_cluster
from loopshape.toolbox.campaign.processes import Work, by_processes
from loopshape.toolbox.rig.effects import moves
from loopshape.toolbox.rig.simulated import Planned, Rig, experiment
from loopshape.toolbox.rig.study import Study

R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class Job:
    """One recording to make: of which machine, under which study, and with which hidden parameters."""

    machine: str
    study: Study
    planned: Planned
    hidden: Mapping[str, float]


def done(plant: Rig, job: Job) -> Recording:
    """The recording of a job, in one thread; the same wherever it is made."""
    e = experiment(job.study, plant, job.planned)
    changes = {**job.study.changes, **job.hidden, **moves(plant, job.study.effects)}
    return plant.simulate([e], solver=job.study.solver, changes=changes, threads=1)[0]


def carried_out(
    work: Work[Job, R], jobs: Iterable[Job], workers: int = 0, cluster: str | None = None
) -> Generator[tuple[Job, R]]:
    """Jobs and what came of the work on each, as it comes; the work leaves what is large on a disk.

    `workers` processes here (0: one a core), or those of the Dask scheduler at `cluster`. Refuses a number of workers
    that `check_workers` refuses, a cluster without its extra, and one that does not answer. A job that ends two
    workers ends the work. Whoever stops taking results closes this, and the workers end.
    """
    check_workers(workers)
    if cluster is not None:
        return by_cluster(work, jobs, cluster)
    return by_processes(work, jobs, workers or os.cpu_count() or 1)


def check_workers(workers: int) -> None:
    """Refuse a negative number of processes, and more than a machine can hold."""
    most = 8 * (os.cpu_count() or 1)  # processes: each takes some 200 MB and a start of seconds
    if not 0 <= workers <= most:
        raise WrongUseError(
            "the number of workers is not one of this machine", str(workers), f"use 1 to {most}, or 0 (one per core)"
        )
