"""The same work on many cases, on several processes, with the time that is left told; what is done stays done."""

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

from leactl.errors import InputError

Job = tuple[Any, ...]
Progress = Callable[[str], None]


def each(work: Callable[..., None], jobs: Sequence[Job], processes: int, verb: str, progress: Progress) -> None:
    """Do every job; each writes its own result, so that one that fails or a stop costs no other.

    Raises
    ------
    InputError : jobs whose input cannot be used, all of them at the end.
    """
    began, faults = time.monotonic(), []
    for done, failed in enumerate(_outcomes(work, jobs, processes), start=1):
        faults += failed
        left = (time.monotonic() - began) / done * (len(jobs) - done)
        progress(f"{done} of {len(jobs)} {verb}, about {left / 60:.1f} min left")
    if faults:
        raise InputError(faults)


def _outcomes(work: Callable[..., None], jobs: Sequence[Job], processes: int) -> Iterator[list[str]]:
    if processes == 1:
        yield from (_tried(work, job) for job in jobs)
        return
    # fresh interpreters: a fork would carry the threads of libraries along
    pool = ProcessPoolExecutor(processes, get_context("spawn"), _leave_stops_alone)
    try:
        for future in as_completed([pool.submit(_tried, work, job) for job in jobs]):
            yield future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _tried(work: Callable[..., None], job: Job) -> list[str]:
    try:
        work(*job)
    except InputError as error:
        return error.faults
    return []


def _leave_stops_alone() -> None:
    # Ctrl-C reaches every process of a terminal: the first one lets the others finish the case they are at
    signal.signal(signal.SIGINT, signal.SIG_IGN)
