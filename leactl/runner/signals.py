"""What people ask of a run: to stop, by signals and sources that the loop looks at; to pause; to record a remark."""

import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from leactl.errors import Stopped

StopSource = Callable[[], str]
"""Looked at once a cycle: the cause to stop for, or an empty text."""


class Wishes:
    """What people want of a run beside its end: a pause, and remarks in its record."""

    def __init__(
        self,
        paused: Callable[[], bool] = lambda: False,
        remarks: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        self.paused = paused  # whether it is wanted now
        self.remarks = remarks  # those that came since it was called last


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


Operator = Callable[[str], Callable[[], bool]]
"""Asks for something to be done; what it returns says whether the operator has confirmed it."""


@dataclass(frozen=True)
class People:
    """Who may end or hold up a run, and who is asked during it."""

    stop: StopRequest
    wishes: Wishes
    operator: Operator


@contextmanager
def listening() -> Iterator[StopRequest]:
    """Take SIGINT, SIGTERM, SIGQUIT and SIGHUP until the block is left; a hangup that is ignored (nohup) stays ignored.

    What whoever listened before has noted by then counts here too. A shell script's background job begins with SIGINT
    ignored; who sends it one still means to stop the bench.
    """
    request = StopRequest()
    before = _noted_by(request)
    for handler in before.values():
        owner = getattr(handler, "__self__", None)
        if isinstance(owner, StopRequest):
            request.cause = request.cause or owner.cause
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
    with ours, theirs, listening() as request:
        before = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)

        def check() -> None:
            request.check()
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
    """For what a command makes: signals are noted for whoever listens next within the block, and ignored after it.

    What then remains is to tell what was made, a line or two. The system's own answer, to kill the process, would lose
    them and the exit status, and Python gives back to it every handler of its own while it shuts down.
    """
    noted = _noted_by(StopRequest())
    try:
        yield
    finally:
        for number in noted:
            signal.signal(number, signal.SIG_IGN)


def _noted_by(request: StopRequest) -> dict[signal.Signals, Any]:
    """Let a request take the signals; what took each of them before."""
    heeded = [signal.SIGINT, signal.SIGTERM]
    heeded += [getattr(signal, name) for name in ("SIGQUIT",) if hasattr(signal, name)]  # Windows has neither of these
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        heeded.append(signal.SIGHUP)
    return {number: signal.signal(number, request.note) for number in heeded}
