"""What a run may be struck by: its processes, what it may use, its driver, and the files that it keeps state in."""

import os
import resource
import shutil
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

SUSPENDED_S = 0.6  # longer than any drive waits for its host


class End(StrEnum):
    """How a run ends that is struck by one thing alone."""

    LATCHED = "latched"  # by itself or by its watchdog
    UNTOLD = "untold"  # nobody is left to say a word: the next start finds out
    IN_ORDER = "in order"
    NONE = "none"  # it goes on


@dataclass(frozen=True)
class Struck:
    """A run under way, and where it keeps things."""

    process: int
    watchdog: int
    folder: Path  # of its file
    state: Path
    trigger: Path  # that makes a driver's call get stuck

    @property
    def latch(self) -> Path:
        """The file that latches its bench."""
        return self.state / "killed.trip.json"


Fall = Callable[[Struck], object]


@dataclass(frozen=True)
class Strike:
    """One thing that befalls a run."""

    end: End
    fall: Fall


def signalled(number: signal.Signals, both: bool = False) -> Fall:
    """A signal to the run, or to its watchdog and the run."""

    def fall(run: Struck) -> None:
        for process in (run.watchdog, run.process) if both else (run.process,):
            os.kill(process, number)

    return fall


def without(limit: int, most: int) -> Fall:
    """No more of something than so much, for the run alone."""
    return lambda run: resource.prlimit(run.process, limit, (most, resource.prlimit(run.process, limit)[1]))


def stuck(how: str) -> Fall:
    """A driver's call that never returns, or raises."""
    return lambda run: run.trigger.write_text(how)


def suspended(run: Struck) -> None:
    """Stopped, and continued after longer than a drive waits for its host."""
    os.kill(run.process, signal.SIGSTOP)
    time.sleep(SUSPENDED_S)
    os.kill(run.process, signal.SIGCONT)


def exchanged(path: Callable[[Struck], Path], make: Callable[[Path], object]) -> Fall:
    """Another thing in the place of a file of state."""

    def fall(run: Struck) -> None:
        there = path(run)
        there.unlink(missing_ok=True)
        make(there)

    return fall


def files_removed(pattern: str) -> Fall:
    """Files of state that are gone."""

    def fall(run: Struck) -> None:
        for path in run.state.rglob(pattern):
            path.unlink()

    return fall


def latch_removed(run: Struck) -> None:
    """A latch that is gone, whatever another strike has made of it."""
    with suppress(IsADirectoryError, PermissionError):
        run.latch.unlink(missing_ok=True)
        return
    run.latch.rmdir()


def to_zeros(path: Path) -> None:
    """A link that has no end."""
    path.symlink_to("/dev/zero")


STRIKES = {
    "kill -9": Strike(End.LATCHED, signalled(signal.SIGKILL)),
    "kill -9, watchdog too": Strike(End.UNTOLD, signalled(signal.SIGKILL, both=True)),
    "SIGSTOP": Strike(End.LATCHED, signalled(signal.SIGSTOP)),
    "SIGSTOP, watchdog too": Strike(End.UNTOLD, signalled(signal.SIGSTOP, both=True)),
    "suspended and continued": Strike(End.LATCHED, suspended),
    "SIGSEGV": Strike(End.LATCHED, signalled(signal.SIGSEGV)),
    "SIGABRT": Strike(End.LATCHED, signalled(signal.SIGABRT)),
    "SIGQUIT": Strike(End.IN_ORDER, signalled(signal.SIGQUIT)),
    "SIGALRM": Strike(End.LATCHED, signalled(signal.SIGALRM)),
    "SIGTERM": Strike(End.IN_ORDER, signalled(signal.SIGTERM)),
    "SIGINT": Strike(End.IN_ORDER, signalled(signal.SIGINT)),
    "SIGHUP": Strike(End.IN_ORDER, signalled(signal.SIGHUP)),
    "watchdog killed": Strike(End.LATCHED, lambda run: os.kill(run.watchdog, signal.SIGKILL)),
    "watchdog stopped": Strike(End.NONE, lambda run: os.kill(run.watchdog, signal.SIGSTOP)),
    "driver call sleeping": Strike(End.LATCHED, stuck("sleeping")),
    "driver call spinning": Strike(End.LATCHED, stuck("spinning")),
    "driver call holding the GIL": Strike(End.LATCHED, stuck("holding the GIL")),
    "driver call failing": Strike(End.IN_ORDER, stuck("failing")),
    "driver call broken": Strike(End.IN_ORDER, stuck("broken")),
    "no memory": Strike(End.NONE, without(resource.RLIMIT_AS, 1)),
    "no descriptors": Strike(End.NONE, without(resource.RLIMIT_NOFILE, 0)),
    "no room for the file": Strike(End.LATCHED, without(resource.RLIMIT_FSIZE, 1)),
    "run's folder removed": Strike(End.NONE, lambda run: shutil.rmtree(run.folder)),
    "run's own file removed": Strike(End.NONE, files_removed("*.run")),
    "winding memory removed": Strike(End.NONE, files_removed("thermal/*")),
    "latch removed": Strike(End.NONE, latch_removed),
    "latch a link to zeros": Strike(End.NONE, exchanged(lambda run: run.latch, to_zeros)),
    "latch a pipe": Strike(End.NONE, exchanged(lambda run: run.latch, os.mkfifo)),
    "latch a folder": Strike(End.NONE, exchanged(lambda run: run.latch, Path.mkdir)),
}
UNSEEN = ("watchdog killed", "watchdog stopped")
STANDING = ("SIGSTOP", "driver call sleeping", "driver call spinning", "driver call holding the GIL")
ENDING = [name for name, strike in STRIKES.items() if strike.end is not End.NONE]


def expected(names: Sequence[str]) -> End:
    """How a run ends that is struck by all of these: by the worst; standing still unwatched is worst of all."""
    if set(UNSEEN) & set(names) and set(STANDING) & set(names):
        return End.UNTOLD
    ends = [STRIKES[name].end for name in names]
    return next(end for end in (End.UNTOLD, End.LATCHED, End.IN_ORDER, End.NONE) if end in ends)
