"""Recordings of many machines, by processes on this machine or by a Dask cluster, the same to the last bit.

The unit of work is one recording. Results come in the order of the jobs, so what is written does not depend on who
was faster. A worker that dies costs time: the cluster does its jobs again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from loopshape.errors import RigError, WrongUseError
from loopshape.recording import Recording
from loopshape.rigs.effects import moves
from loopshape.rigs.simulated import Planned, Rig, experiment
from loopshape.study import Study


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
    plant: Rig, jobs: Iterable[Job], workers: int = 0, cluster: str | None = None
) -> Iterator[tuple[Job, Recording]]:
    """Jobs and their recordings, in order, a few ahead in memory.

    `workers` processes here (0: one a core), or those of the Dask scheduler at `cluster`. Refuses a cluster without its
    extra, and one that does not answer; a worker that dies here ends the work, with what was written kept.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    listed = list(jobs)
    with _executor(cluster):
        parallel = Parallel(n_jobs=workers or -1, return_as="generator", pre_dispatch="2*n_jobs", max_nbytes=None)
        try:
            yield from zip(listed, parallel(delayed(done)(plant, job) for job in listed), strict=True)
        except TerminatedWorkerError:
            raise RigError(
                "a worker process ended unasked", "killed, or out of memory", "the same command goes on; use fewer"
            ) from None


@contextmanager
def _executor(cluster: str | None) -> Iterator[None]:
    """Where joblib sends its work."""
    from joblib import parallel_config

    if cluster is None:
        yield
        return
    with _client(cluster), parallel_config(backend="dask", wait_for_workers_timeout=30):
        yield


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise WrongUseError(
            "a cluster needs dask.distributed", address, "install it: pip install 'loopshape[cluster]'"
        ) from None
    try:
        return Client(address, timeout=10, set_as_default=True)
    except (OSError, ValueError, TimeoutError) as error:
        raise RigError(
            "no cluster answers there", f"{address}: {error}", "start dask scheduler, or check the address"
        ) from None
