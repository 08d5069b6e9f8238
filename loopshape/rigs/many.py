"""Recordings of many machines, by processes on this machine or by a Dask cluster, the same to the last bit.

The unit of work is one recording. Results come in the order of the jobs, so what is written does not depend on who
was faster. A worker that dies costs time: the cluster does its jobs again.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np

from loopshape.errors import RigError, WrongUseError
from loopshape.recording import Recording, RecordingInfo
from loopshape.rigs.effects import moves
from loopshape.rigs.simulated import Planned, Rig, experiment
from loopshape.study import Study

_AHEAD = 8  # recordings a worker that may wait to be written
_PER_CORE = 8  # processes: each takes some 200 MB and a start of seconds


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


Shelved = tuple[RecordingInfo, float, Path]


def _done(plant: Rig, job: Job, master: int, shelf: Path | None) -> Recording | Shelved:
    """A job in a worker, which ends with the process that it works for, however that ends."""
    if os.getppid() == master:
        _watch(master)
    recording = done(plant, job)
    return recording if shelf is None else _put(recording, shelf)


def _put(recording: Recording, shelf: Path) -> Shelved:
    """Columns in a file: what then goes through the pipe is so small that a kill cannot cut it in two."""
    path = shelf / f"{os.urandom(8).hex()}.npz"
    try:
        np.savez(path, **dict(recording.columns))  # type: ignore[arg-type]
    except OSError as error:
        raise RigError(
            "a worker cannot put its result down", f"{shelf}: {error.strerror}", "make room there, or set TMPDIR"
        ) from None
    return recording.info, recording.rate_hz, path


def _taken(result: Recording | Shelved) -> Recording:
    if isinstance(result, Recording):
        return result
    info, rate_hz, path = result
    with np.load(path, allow_pickle=False) as file:
        columns = {name: file[name] for name in file.files}
    path.unlink()
    return Recording(info, rate_hz, columns)


@cache
def _watch(master: int) -> None:
    def until_alone() -> None:
        while os.getppid() == master:
            time.sleep(0.5)
        os._exit(1)

    Thread(target=until_alone, daemon=True).start()


def carried_out(
    plant: Rig, jobs: Iterable[Job], workers: int = 0, cluster: str | None = None
) -> Generator[tuple[Job, Recording]]:
    """Jobs and their recordings, in order; some of each worker wait to be taken, in files of a temporary folder.

    `workers` processes here (0: one a core), or those of the Dask scheduler at `cluster`. Refuses a number of workers
    that `check_workers` refuses, a cluster without its extra, and one that does not answer; a worker that dies here
    ends the work, with what was written kept. Whoever stops taking results closes this, and the workers end.
    """
    from joblib import Parallel, delayed, effective_n_jobs
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    check_workers(workers)
    listed = list(jobs)
    warnings.filterwarnings("ignore", r"\d+ tasks ", UserWarning, "joblib")  # nobody takes them after an interrupt
    with _executor(cluster), TemporaryDirectory(prefix="loopshape-") as folder:
        shelf = Path(folder) if cluster is None else None
        processes = _processes(workers, len(listed), cluster)
        ahead = _AHEAD * effective_n_jobs(processes)
        try:
            with Parallel(n_jobs=processes, return_as="generator", max_nbytes=None) as parallel:
                for first in range(0, len(listed), ahead):  # joblib works ahead of whoever takes, without an end
                    part = listed[first : first + ahead]
                    results = parallel(delayed(_done)(plant, job, os.getpid(), shelf) for job in part)
                    yield from ((job, _taken(result)) for job, result in zip(part, results, strict=True))
        except TerminatedWorkerError:
            raise RigError(
                "a worker process ended unasked", "killed, or out of memory", "the same command goes on; use fewer"
            ) from None


def check_workers(workers: int) -> None:
    """Refuse a negative number of processes, and more than a machine can hold."""
    most = _PER_CORE * (os.cpu_count() or 1)
    if not 0 <= workers <= most:
        raise WrongUseError(
            "the number of workers is not one of this machine", str(workers), f"use 1 to {most}, or 0 for one a core"
        )


def _processes(workers: int, jobs: int, cluster: str | None) -> int:
    """Processes to start, no more than there is work for; -1 leaves it to a cluster."""
    return -1 if cluster is not None else max(1, min(workers or os.cpu_count() or 1, jobs))


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
