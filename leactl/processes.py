"""Run one function on many jobs in one process or in several; the results are the same, and a stop ends in order.

Functions and jobs are pickled, so that the function has to be one of a module. A worker is a fresh interpreter, which
takes about a second to start: several processes pay off if the jobs together take longer.
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

Job = tuple[Any, ...]  # arguments of the function
Progress = Callable[[str], None]
Value = TypeVar("Value")
FEWEST_JOBS = 2  # for which workers are started
# jobs of each worker that are submitted and whose results are not read yet; a fixed number bounds the memory of results
JOBS_AHEAD = 16


@dataclass(frozen=True)
class Done(Generic[Value]):
    """Outcome of a job: its result, or the faults of its input, one line each."""

    result: Value | None
    faults: list[str]

    def value(self) -> Value:
        """Return the result.

        Raises
        ------
        InputError : the job's input had faults.
        """
        if self.faults:
            raise InputError(self.faults)
        return self.result  # type: ignore[return-value]  # a job without faults has its result, which may be None


class Workers:
    """Context manager of the processes that run jobs; a single process is the present one and needs no `with`.

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
        """Yield the outcome of each job, in the order of the jobs; one process runs each job when it is asked for."""
        if self._runs_in_this_process(jobs):
            yield from (run_job(work, job) for job in jobs)
            return
        with _lost_worker_reported():
            pool = self._started_pool()
            yield from results_in_order(lambda job: pool.submit(run_job, work, job), jobs, JOBS_AHEAD * self._processes)

    def as_done(self, work: Callable[..., Value], jobs: Sequence[Job]) -> Iterator[Done[Value]]:
        """Yield the outcome of each job as soon as it is known, in any order."""
        if self._runs_in_this_process(jobs):
            yield from (run_job(work, job) for job in jobs)
            return
        with _lost_worker_reported():
            pool, jobs_left = self._started_pool(), iter(jobs)
            futures = {pool.submit(run_job, work, job) for job in islice(jobs_left, JOBS_AHEAD * self._processes)}
            while futures:
                done, futures = wait(futures, return_when=FIRST_COMPLETED)
                while done:
                    yield done.pop().result()
                    futures |= {pool.submit(run_job, work, job) for job in islice(jobs_left, 1)}

    def _runs_in_this_process(self, jobs: Sequence[Job]) -> bool:
        """Return whether jobs run in this process, because there is one process or too few jobs to start workers."""
        return self._processes == 1 or (self._pool is None and len(jobs) < FEWEST_JOBS)

    def _started_pool(self) -> ProcessPoolExecutor:
        """Return the pool of workers, which is started at the first call."""
        if self._pool is None:
            # fresh interpreters, since a fork would copy the locks of libraries' threads without the threads
            self._pool = ProcessPoolExecutor(self._processes, get_context("spawn"), _prepare_worker)
        return self._pool


HERE = Workers()


def each(work: Callable[..., None], jobs: Sequence[Job], workers: Workers, verb: str, progress: Progress) -> None:
    """Run every job; a job stores its own result, so that a failed job or a stop loses no other job's result.

    Parameters
    ----------
    verb : what was done to a job, for the lines of progress.
    progress : called after each job with the number of finished jobs and the estimated remaining time.

    Raises
    ------
    InputError : the faults of all jobs whose input cannot be used, after the last job.
    """
    start, faults = time.monotonic(), []
    for count, outcome in enumerate(workers.as_done(work, jobs), start=1):
        faults += outcome.faults
        remaining_s = (time.monotonic() - start) / count * (len(jobs) - count)
        progress(f"{count} of {len(jobs)} {verb}, about {remaining_s / 60:.1f} min left")
    if faults:
        raise InputError(faults)


def results_in_order(submit: Callable[[Job], Any], jobs: Iterable[Job], window: int) -> Iterator[Any]:
    """Yield the result of each job's future, in the order of the jobs; at most `window` futures exist at a time."""
    jobs_left = iter(jobs)
    futures = deque(map(submit, islice(jobs_left, window)))
    while futures:
        yield futures.popleft().result()
        futures.extend(map(submit, islice(jobs_left, 1)))


def run_job(work: Callable[..., Value], job: Job) -> Done[Value]:
    """Run a job; faults of its input become part of the outcome."""
    try:
        return Done(work(*job), [])
    except InputError as error:  # part of the outcome, since a raised error would end the other jobs
        return Done(None, error.faults)


@contextmanager
def _lost_worker_reported() -> Iterator[None]:
    """Convert the executor's error on a lost worker to a LeactlError of one line."""
    try:
        yield
    except BrokenProcessPool:
        reason = "a worker process was ended from outside, as the system does where memory runs out"
        raise LeactlError(f"{reason}; fewer --processes need less") from None


def _prepare_worker() -> None:
    """Make a worker ignore Ctrl-C, and exit when its parent process ends."""
    # Ctrl-C reaches every process of a terminal; the parent lets the workers finish their present jobs
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Wait for the end of the parent process, and exit."""
    # a worker waits for jobs on a pipe whose other end it has open too, and would outlive its parent for ever
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(LeactlError.exit_status)
