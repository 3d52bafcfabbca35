"""Jobs on other machines: a Dask scheduler hands them to its workers, and to another one where a worker is lost.

Workers see the files under the same paths, and start as `dask worker ADDRESS --nthreads 1`: what HDF5 and the working
directory are to one job they are to all jobs of a process. Dask sends jobs as pickles, so that whoever reaches its
scheduler can do anything there.
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
from leactl.processes import AHEAD, Done, Job, Value, Workers, in_order, tried

MISSING: Final = "--scheduler needs Dask: pip install 'leactl[dask]'"
REACHED_WITHIN_S: Final = 5
ADDRESS: Final = re.compile(r"(tcp|tls)://(\[[0-9A-Fa-f:.]+\]|[\w.-]+):\d{1,5}")


class ScheduledWorkers(Workers):
    """The workers of a Dask scheduler, while the block lasts.

    Raises
    ------
    InputError : the scheduler cannot be reached, has no worker, or one that cannot do the work.
    LeactlError : a job has ended one worker after the other.
    """

    def __init__(self, address: str) -> None:
        super().__init__()
        self._address = address
        self._client: Any = None

    def __enter__(self) -> Self:
        try:
            from distributed import Client
        except ImportError:
            raise InputError(MISSING) from None
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # of lost workers the answer need not tell
        try:
            self._client = Client(self._address, timeout=REACHED_WITHIN_S, set_as_default=False)
        except OSError as fault:
            why = " ".join(str(fault).split())
            raise InputError(f"--scheduler {self._address}: cannot be reached: {why}") from None
        try:
            self._refuse_unfit_workers()
        except BaseException:
            self._client.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()  # which lets go of what it still has to do

    def in_order(self, work: Callable[..., Value], jobs: Sequence[Job]) -> Iterator[Done[Value]]:
        """What comes of each job, in the order of the jobs."""
        with _named_where_workers_end():
            yield from in_order(self._sender(work), jobs, self._window())

    def as_done(self, work: Callable[..., Value], jobs: Sequence[Job]) -> Iterator[Done[Value]]:
        """What comes of each job, as soon as it is there."""
        from distributed import as_completed

        with _named_where_workers_end():
            send, waiting = self._sender(work), iter(jobs)
            running = as_completed([send(job) for job in islice(waiting, self._window())], loop=self._client.loop)
            for future in running:
                yield future.result()
                for job in islice(waiting, 1):
                    running.add(send(job))

    def _window(self) -> int:
        return AHEAD * max(1, len(self._client.nthreads()))

    def _sender(self, work: Callable[..., Value]) -> Callable[[Job], Any]:
        here = Path.cwd()
        # not pure: of two jobs alike each is done, since files may have changed
        return lambda job: self._client.submit(_tried_in, here, work, job, pure=False)

    def _refuse_unfit_workers(self) -> None:
        """Look at every worker once: later ones are taken as they are."""
        threads = self._client.nthreads()
        if not threads:
            raise InputError(f"--scheduler {self._address}: has no worker; dask worker {self._address} --nthreads 1")
        faults = [
            f"worker {name}: {count} threads; --nthreads 1 was expected"
            for name, count in threads.items()
            if count != 1
        ]
        here = _versions()
        for name, there in ({} if faults else self._client.run(_versions, on_error="return")).items():
            if isinstance(there, Exception):
                faults.append(f"worker {name}: cannot do the work: {' '.join(str(there).split())}")
                continue
            others = [f"{what} {there[what]}; {here[what]}, as here," for what in here if there[what] != here[what]]
            faults += [f"worker {name}: has {other} was expected" for other in others]
        if faults:
            raise InputError([f"--scheduler {self._address}: {fault}" for fault in faults])


def workers_of(processes: int, scheduler: str) -> Workers:
    """Those that the options of a command ask for.

    Raises
    ------
    InputError : both are given, or what is no address.
    """
    if not scheduler:
        return Workers(processes)
    if processes > 1:
        raise InputError(f"--processes {processes}: of this machine, and --scheduler {scheduler}; give one of both")
    if not ADDRESS.fullmatch(scheduler):
        raise InputError(f"--scheduler {scheduler}: an address such as tcp://192.168.0.5:8786 was expected")
    return ScheduledWorkers(scheduler)


def _versions() -> dict[str, str]:
    """What jobs and results, which are pickles, have to find alike on both sides."""
    import distributed

    python = ".".join(platform.python_version_tuple()[:2])
    return {"leactl": __version__, "Python": python, "distributed": distributed.__version__}


def _tried_in(directory: Path, work: Callable[..., Value], job: Job) -> Done[Value]:
    try:
        os.chdir(directory)  # in which the paths of the job begin
    except OSError as fault:
        raise InputError(f"{directory}: cannot be entered by a worker on {platform.node()}: {fault.strerror}") from None
    return tried(work, job)


@contextmanager
def _named_where_workers_end() -> Iterator[None]:
    from distributed import KilledWorker

    try:
        yield
    except KilledWorker as lost:
        raise LeactlError(
            f"a job has ended one worker after the other, the last on {lost.last_worker.address}"
        ) from None
