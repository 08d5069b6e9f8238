"""Recordings of many machines: what is to be made, and how it is shared out, to processes or a Dask cluster.

Whoever makes a job makes the same to the last bit, so workers that die cost time and nothing else. To a cluster it
goes in batches of seconds, as the scheduler takes up to a millisecond a task.
"""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeVar

from loopshape.core.errors import RigError, WrongUseError
from loopshape.data.signal.recording import Recording
from loopshape.toolbox.campaign.processes import Work, by_processes
from loopshape.toolbox.rig.effects import moves
from loopshape.toolbox.rig.simulated import Planned, Rig, experiment
from loopshape.toolbox.rig.study import Study

R = TypeVar("R")
BATCH_S = 2.0  # of work in a task of a cluster


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


def by_cluster(work: Work[Job, R], jobs: Iterable[Job], address: str) -> Generator[tuple[Job, R]]:
    """Jobs and what came of `work`, as it comes; raises what it raises.

    A task is as many jobs as take some two seconds by what was measured so far. The scheduler does the tasks of a lost
    worker again. Refuses an installation without distributed, and a cluster that does not answer or has no worker.
    """
    client = _client(address)
    from distributed import KilledWorker, as_completed

    left, count, open_tasks = iter(jobs), 1, 0
    with client, _message(address, KilledWorker):
        client.wait_for_workers(1, timeout=30)  # for the first worker
        coming = as_completed()
        tasks: dict[str, Sequence[Job]] = {}
        ahead = 2  # tasks a thread of the cluster: one at work, one waiting
        while True:
            while open_tasks < ahead * _threads(client) and (batch := list(islice(left, count))):
                future = client.submit(_batch, work, batch, pure=False)
                tasks[future.key] = batch
                coming.add(future)
                open_tasks += 1
            if not open_tasks:
                return
            future = next(coming)
            open_tasks -= 1
            answers, seconds = future.result()
            count = _next_count(len(answers), seconds)
            yield from zip(tasks.pop(future.key), answers, strict=True)


def _batch(work: Work[Job, R], jobs: Sequence[Job]) -> tuple[list[R], float]:
    """What came of the work on each, and the seconds that all took."""
    start_s = time.perf_counter()
    with ThreadPoolExecutor(1) as disk:
        answers = [disk.submit(work(job)) for job in jobs]
    return [answer.result() for answer in answers], time.perf_counter() - start_s


def _next_count(jobs: int, seconds: float) -> int:
    """Jobs of the next task, by how long those of one took."""
    return max(1, min(1000, int(BATCH_S * jobs / max(seconds, 1e-9))))  # jobs in a task


def _threads(client: Any) -> int:
    return max(1, sum(client.nthreads().values()))


@contextmanager
def _message(address: str, killed: type[Exception]) -> Generator[None]:
    try:
        yield
    except killed as error:
        raise RigError(
            "a task ended several workers of the cluster",
            str(error)[:160],
            "look at their memory; the same command goes on",
        ) from None
    except TimeoutError:
        raise RigError("the cluster has no worker", address, "start one: dask worker " + address) from None


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise WrongUseError(
            "a cluster needs dask.distributed", address, "install it: pip install 'loopshape[cluster]'"
        ) from None
    try:
        return Client(address, timeout=10)
    except (OSError, ValueError, TimeoutError) as error:
        raise RigError(
            "no cluster answers there", f"{address}: {error}", "start dask scheduler, or check the address"
        ) from None
