"""The same work on many jobs, in one process or several: the results are the same, and a stop ends in order.

Work and jobs are pickled, so the work is a function of a module. A worker is a fresh interpreter, which costs about a
second: several processes pay off where the jobs take longer than that together.
"""

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context, parent_process
from threading import Thread
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from leactl.errors import InputError, LeactlError

Job = tuple[Any, ...]
Progress = Callable[[str], None]
Value = TypeVar("Value")
FEWEST_JOBS = 2  # for which a worker is started
# for each worker, how many jobs are handed out or done and not asked for yet: memory stays flat however many there are
AHEAD = 16


@dataclass(frozen=True)
class Done(Generic[Value]):
    """What came of a job: its result, or the lines that say why its input cannot be used."""

    result: Value | None
    faults: list[str]

    def value(self) -> Value:
        """The result.

        Raises
        ------
        InputError : there is none.
        """
        if self.faults:
            raise InputError(self.faults)
        return self.result  # type: ignore[return-value]  # a job without faults has its result, which may be None


class Workers:
    """Processes that do jobs while the block lasts; one process is this one, which needs no block.

    Raises
    ------
    LeactlError : a worker was ended from outside.
    """

    def __init__(self, processes: int = 1) -> None:
        self._processes = processes
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def in_order(self, work: Callable[..., Value], jobs: Sequence[Job]) -> Iterator[Done[Value]]:
        """What comes of each job, in the order of the jobs; in this process each is done when it is asked for."""
        if self._are_done_here(jobs):
            yield from (tried(work, job) for job in jobs)
            return
        with _named_where_a_worker_ends():
            pool = self._started()
            yield from in_order(lambda job: pool.submit(tried, work, job), jobs, AHEAD * self._processes)

    def as_done(self, work: Callable[..., Value], jobs: Sequence[Job]) -> Iterator[Done[Value]]:
        """What comes of each job, as soon as it is there."""
        if self._are_done_here(jobs):
            yield from (tried(work, job) for job in jobs)
            return
        with _named_where_a_worker_ends():
            pool, waiting = self._started(), iter(jobs)
            running = {pool.submit(tried, work, job) for job in islice(waiting, AHEAD * self._processes)}
            while running:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                while done:
                    yield done.pop().result()
                    running |= {pool.submit(tried, work, job) for job in islice(waiting, 1)}

    def _are_done_here(self, jobs: Sequence[Job]) -> bool:
        return self._processes == 1 or (self._pool is None and len(jobs) < FEWEST_JOBS)

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # fresh interpreters: a fork would carry the threads of libraries along
            self._pool = ProcessPoolExecutor(self._processes, get_context("spawn"), _prepare)
        return self._pool


HERE = Workers()


def each(work: Callable[..., None], jobs: Sequence[Job], workers: Workers, verb: str, progress: Progress) -> None:
    """Do every job; each writes its own result, so that one that fails or a stop costs no other.

    The time that is left is told after each.

    Raises
    ------
    InputError : jobs whose input cannot be used, all of them at the end.
    """
    began, faults = time.monotonic(), []
    for count, done in enumerate(workers.as_done(work, jobs), start=1):
        faults += done.faults
        left = (time.monotonic() - began) / count * (len(jobs) - count)
        progress(f"{count} of {len(jobs)} {verb}, about {left / 60:.1f} min left")
    if faults:
        raise InputError(faults)


def in_order(submit: Callable[[Job], Any], jobs: Iterable[Job], window: int) -> Iterator[Any]:
    """The result of each job's future, in the order of the jobs; at most `window` futures are there at a time."""
    waiting = iter(jobs)
    running = deque(map(submit, islice(waiting, window)))
    while running:
        yield running.popleft().result()
        running.extend(map(submit, islice(waiting, 1)))


def tried(work: Callable[..., Value], job: Job) -> Done[Value]:
    """Do a job."""
    try:
        return Done(work(*job), [])
    except InputError as error:  # as lines: pickled, an error of several lines would be an error of one
        return Done(None, error.faults)


@contextmanager
def _named_where_a_worker_ends() -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool:
        ended = "a worker process was ended from outside, as the system does where memory runs out"
        raise LeactlError(f"{ended}; fewer --processes need less") from None


def _prepare() -> None:
    # Ctrl-C reaches every process of a terminal: the first one lets the others finish the job they are at
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_the_first, daemon=True).start()


def _end_with_the_first() -> None:
    # a worker waits for jobs on a pipe whose other end it holds itself, and would wait for ever
    first = parent_process()
    if first is not None:
        first.join()
        os._exit(LeactlError.exit_status)
