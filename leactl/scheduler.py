"""Run jobs on other machines: a Dask scheduler sends them to its workers, and the job of a lost worker to another one.

Workers must see the files under the same paths, and are started as `dask worker ADDRESS --nthreads 1`, since the
working directory and the state of HDF5 are shared by all threads of a process. Dask sends jobs as pickles, so that
anyone who can reach its scheduler can run any code there.
"""

import logging
import os
import platform
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from leactl import __version__
from leactl.errors import InputError, LeactlError
from leactl.processes import JOBS_AHEAD, Done, Job, Value, Workers, results_in_order, run_job

DASK_MISSING: Final = "--scheduler needs Dask: pip install 'leactl[dask]'"
CONNECT_TIMEOUT_S: Final = 5
ADDRESS: Final = re.compile(r"(tcp|tls)://(\[[0-9A-Fa-f:.]+\]|[\w.-]+):\d{1,5}")


class ScheduledWorkers(Workers):
    """Context manager of the workers of a Dask scheduler.

    Raises
    ------
    InputError : the scheduler cannot be reached, has no worker, or has a worker that is not fit for the jobs.
    LeactlError : a job has ended one worker after another.
    """

    def __init__(self, address: str) -> None:
        super().__init__()
        self._address = address
        self._client: Any = None

    def __enter__(self) -> Self:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(DASK_MISSING) from None
        # a job of a lost worker runs again, so that the loss concerns nobody
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            self._client = Client(self._address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
        except OSError as fault:
            reason = " ".join(str(fault).split())
            raise InputError(f"--scheduler {self._address}: cannot be reached: {reason}") from None
        try:
            self._refuse_unfit_workers()
        except BaseException:
            self._client.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()  # releases its futures, so that the scheduler drops the jobs that have not finished

    def in_order(self, work: Callable[..., Value], jobs: Sequence[Job]) -> Iterator[Done[Value]]:
        """Yield the outcome of each job, in the order of the jobs."""
        with _lost_worker_reported():
            yield from results_in_order(self._submitter(work), jobs, self._futures_ahead())

    def as_done(self, work: Callable[..., Value], jobs: Sequence[Job]) -> Iterator[Done[Value]]:
        """Yield the outcome of each job as soon as it is known, in any order."""
        from distributed import as_completed

        with _lost_worker_reported():
            submit, jobs_left = self._submitter(work), iter(jobs)
            futures = as_completed(
                [submit(job) for job in islice(jobs_left, self._futures_ahead())], loop=self._client.loop
            )
            for future in futures:
                yield future.result()
                for job in islice(jobs_left, 1):
                    futures.add(submit(job))

    def _futures_ahead(self) -> int:
        """Return the number of jobs that are submitted and whose results are not read yet."""
        return JOBS_AHEAD * max(1, len(self._client.nthreads()))

    def _submitter(self, work: Callable[..., Value]) -> Callable[[Job], Any]:
        """Return a function that submits a job and returns its future."""
        directory = Path.cwd()
        # not pure: of two equal jobs, both run, since files may have changed in between
        return lambda job: self._client.submit(_run_job_in, directory, work, job, pure=False)

    def _refuse_unfit_workers(self) -> None:
        """Check the workers that the scheduler has now; those that join it later are not checked.

        Raises
        ------
        InputError : there is no worker, or one has several threads, cannot run a function, or has other versions.
        """
        thread_counts = self._client.nthreads()
        if not thread_counts:
            raise InputError(f"--scheduler {self._address}: has no worker; dask worker {self._address} --nthreads 1")
        faults = [
            f"worker {name}: {count} threads; --nthreads 1 was expected"
            for name, count in thread_counts.items()
            if count != 1
        ]
        own_versions = _package_versions()
        for name, versions in ({} if faults else self._client.run(_package_versions, on_error="return")).items():
            if isinstance(versions, Exception):
                faults.append(f"worker {name}: cannot do the work: {' '.join(str(versions).split())}")
                continue
            differences = [
                f"{package} {versions[package]}; {own_versions[package]}, as here,"
                for package in own_versions
                if versions[package] != own_versions[package]
            ]
            faults += [f"worker {name}: has {difference} was expected" for difference in differences]
        if faults:
            raise InputError([f"--scheduler {self._address}: {fault}" for fault in faults])


def workers_of(processes: int, scheduler: str) -> Workers:
    """Return the workers for a command's options `--processes` and `--scheduler` (empty for none).

    Raises
    ------
    InputError : both options are given, or the scheduler's address is not one.
    """
    if not scheduler:
        return Workers(processes)
    if processes > 1:
        raise InputError(f"--processes {processes}: of this machine, and --scheduler {scheduler}; give one of both")
    if not ADDRESS.fullmatch(scheduler):
        raise InputError(f"--scheduler {scheduler}: an address such as tcp://192.168.0.5:8786 was expected")
    return ScheduledWorkers(scheduler)


def _package_versions() -> dict[str, str]:
    """Return the versions that have to be equal on both sides, since jobs and results are sent as pickles."""
    import distributed

    python = ".".join(platform.python_version_tuple()[:2])
    return {"leactl": __version__, "Python": python, "distributed": distributed.__version__}


def _run_job_in(directory: Path, work: Callable[..., Value], job: Job) -> Done[Value]:
    """Run a job in a working directory.

    Raises
    ------
    InputError : the worker cannot enter the directory.
    """
    try:
        os.chdir(directory)  # the job's paths are relative to it
    except OSError as fault:
        raise InputError(f"{directory}: cannot be entered by a worker on {platform.node()}: {fault.strerror}") from None
    return run_job(work, job)


@contextmanager
def _lost_worker_reported() -> Iterator[None]:
    """Convert Dask's error on a job that has ended several workers to a LeactlError of one line."""
    from distributed import KilledWorker

    try:
        yield
    except KilledWorker as error:
        raise LeactlError(
            f"a job has ended one worker after the other, the last on {error.last_worker.address}"
        ) from None
