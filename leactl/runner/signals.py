"""What asks a run to stop: signals, which set a flag, and sources that the loop looks at; neither breaks its end."""

import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from leactl.errors import Stopped

StopSource = Callable[[], str]
"""Looked at once a cycle: the cause to stop for, or an empty text."""


class StopRequest:
    """Whether a person or the system wants the run to end."""

    def __init__(self) -> None:
        self.cause = ""
        self._sources: list[StopSource] = []

    def heed(self, source: StopSource) -> None:
        """Look at this source too, every time."""
        self._sources.append(source)

    def note(self, number: int, _frame: object = None) -> None:
        """Take a signal; the first one is the cause, later ones change nothing."""
        self.cause = self.cause or f"stopped by {signal.Signals(number).name}"

    def check(self) -> None:
        """End the run where somebody asked for it.

        Raises
        ------
        Stopped : with the cause.
        """
        for source in self._sources:
            cause = source()
            if cause:  # nothing is written otherwise: a signal may have come while the source was looked at
                self.cause = self.cause or cause
        if self.cause:
            raise Stopped(self.cause)


@contextmanager
def listening() -> Iterator[StopRequest]:
    """Take SIGINT, SIGTERM, SIGQUIT and SIGHUP until the block is left; a hangup that is ignored (nohup) stays ignored.

    A shell script's background job begins with SIGINT ignored; who sends it one still means to stop the bench.
    """
    request = StopRequest()
    before = {number: signal.signal(number, request.note) for number in _heeded()}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def between_runs() -> Iterator[Callable[[], None]]:
    """Run after run: what is yielded raises `Stopped` where a signal came that no run of them has taken.

    One that comes while a run closes its file is noted by that run, which looks no more: the descriptor hears it.
    """
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    theirs.setblocking(False)
    with ours, theirs, listening():
        before = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)

        def check() -> None:
            try:
                numbers = ours.recv(4096)
            except BlockingIOError:
                return
            raise Stopped(f"stopped by {signal.Signals(numbers[0]).name}")

        try:
            yield check
        finally:
            signal.set_wakeup_fd(before)


@contextmanager
def to_the_end() -> Iterator[None]:
    """A signal that no run takes raises `Stopped`; once the block is left, signals are ignored for good.

    What remains then is to tell what was made. The system's own answer, to kill the process, would lose the exit
    status, and Python gives back to it every handler of its own while it shuts down.
    """
    heeded = _heeded()

    def ignore() -> None:
        for number in heeded:
            signal.signal(number, signal.SIG_IGN)

    def stop(number: int, _frame: object) -> None:
        ignore()  # a second one would break the end that the first one asked for
        raise Stopped(f"stopped by {signal.Signals(number).name}")

    for number in heeded:
        signal.signal(number, stop)
    try:
        yield
    finally:
        ignore()


def _heeded() -> list[signal.Signals]:
    always = [signal.SIGINT, signal.SIGTERM, signal.SIGQUIT]
    return always if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else [*always, signal.SIGHUP]
