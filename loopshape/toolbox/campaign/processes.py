"""Work shared out to processes of this machine: started anew, ended with their parent, replaced when one dies.

Each process has a pipe of its own to the parent and no other thing: no queue, lock or folder that a kill could leave.
"""

from __future__ import annotations

import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from threading import Thread
from typing import Any, Generic, TypeVar

from loopshape.core.errors import RigError

J = TypeVar("J")
R = TypeVar("R")
#: does a job's work, and gives what waits for the disk and tells what came of it: the next job is at work meanwhile
Work = Callable[[J], Callable[[], R]]


def by_processes(work: Work[J, R], jobs: Iterable[J], processes: int) -> Generator[tuple[J, R]]:
    """Jobs and what came of `work`, as it comes; raises what it raises.

    The job of a process that dies is done again by another; a job that ends two of them raises `RigError`.
    """
    left, deaths = _Remaining(jobs), Counter[int]()
    team: list[_Process[J]] = []
    try:
        while True:
            while len(team) < processes and (first := left.take(1)):
                team.append(_Process(work, first))
            if not team:
                return
            ready = wait([one.pipe for one in team])
            for one in [one for one in team if one.pipe in ready]:
                job = one.jobs[0]
                try:
                    answer = one.answer()
                except (EOFError, OSError):
                    deaths[id(job)] += 1
                    _refuse_deadly(deaths[id(job)])
                    team.remove(one)
                    one.end()
                    left.put_back(one.jobs)
                    continue
                # jobs that a process has: one waits for the disk, one is at work, one is there when its answer is read
                ahead = 3
                if not one.give(left.take(ahead - len(one.jobs))):
                    team.remove(one)
                    one.end()
                yield job, answer
    finally:
        for one in team:
            one.end()


def _refuse_deadly(deaths: int) -> None:
    if deaths >= 2:  # of processes over one job, from which on it is the job's fault
        raise RigError(
            "a worker process ended unasked", "killed, or out of memory, twice over one recording",
            "the same command goes on; use fewer workers",
        )  # fmt: skip


class _Remaining(Generic[J]):
    """Jobs that nobody has: those put back come first."""

    def __init__(self, jobs: Iterable[J]) -> None:
        self._again: deque[J] = deque()
        self._jobs = iter(jobs)

    def take(self, count: int) -> list[J]:
        """As many of the next ones as there are."""
        again = [self._again.popleft() for _ in range(min(count, len(self._again)))]
        return again + list(islice(self._jobs, count - len(again)))

    def put_back(self, jobs: Iterable[J]) -> None:
        """Jobs of a process that died."""
        self._again.extend(jobs)


class _Process(Generic[J]):
    """A process at work, with the jobs that it has not answered."""

    def __init__(self, work: Work[J, Any], first: list[J]) -> None:
        self.pipe, theirs = get_context("spawn").Pipe()
        self._process = get_context("spawn").Process(target=_serve, args=(work, theirs), daemon=True)
        with _without_interrupts():
            self._process.start()
        theirs.close()
        self.jobs: deque[J] = deque()
        self.give(first)

    def give(self, jobs: list[J]) -> bool:
        """Send further jobs; False where it has none then. One that died is found out when it is to answer."""
        for job in jobs:
            self.jobs.append(job)
            try:
                self.pipe.send(job)
            except OSError:
                break
        return bool(self.jobs)

    def answer(self) -> Any:
        """What came of the first of its jobs; raises what that raised, `EOFError` where it died."""
        failed, answer = self.pipe.recv()
        self.jobs.popleft()
        if failed:
            raise answer
        return answer

    def end(self) -> None:
        """End it, at work or not."""
        self.pipe.close()
        self._process.kill()
        self._process.join()
        self._process.close()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """What is started meanwhile hears no Ctrl-C: its parent does, and ends it."""
    resource_tracker.ensure_running()  # which else comes with the first process and lifts the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(work: Work[Any, Any], pipe: Connection) -> None:
    """Answer jobs until there are no more, or the parent is gone, however it went."""
    Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError), ThreadPoolExecutor(1) as disk:  # its end closed: in order, or with answers unread
        while True:
            failed, done = _tried(partial(work, pipe.recv()))
            disk.submit(_answer, pipe, failed, done)


def _answer(pipe: Connection, failed: bool, done: Any) -> None:
    """Tell what came of a job, in the order of jobs."""
    pipe.send((True, done) if failed else _tried(done))


def _tried(work: Callable[[], Any]) -> tuple[bool, Any]:
    """Whether it raised, and what it gave or raised: the parent raises it where the answer is read."""
    try:
        return False, work()
    except Exception as error:  # of any kind
        return True, error


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
