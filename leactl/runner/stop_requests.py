"""Requests from people to a run: to stop it, by a signal or another source; to pause it; to record a remark."""

import signal
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from leactl.errors import Stopped

StopSource = Callable[[], str]
"""Called once a cycle; returns the cause for which the run has to stop, or an empty text."""


@dataclass(frozen=True)
class OperatorInput:
    """What people at the bench ask of a run besides its end; the loop calls both functions again and again."""

    pause_wanted: Callable[[], bool] = lambda: False  # a call may read the keys pressed since the last one
    new_remarks: Callable[[], Sequence[str]] = tuple  # for the record, since the last call


class StopRequest:
    """Collects requests to end a run, from signals and from sources."""

    def __init__(self) -> None:
        self.cause = ""
        self._sources: list[StopSource] = []

    def add_source(self, source: StopSource) -> None:
        """Add a source, which every `check` calls."""
        self._sources.append(source)

    def note(self, number: int, _frame: object = None) -> None:
        """Handle a signal: the first one becomes the cause, later ones change nothing."""
        self.cause = self.cause or f"stopped by {signal.Signals(number).name}"

    def check(self) -> None:
        """Raise if a signal or a source has asked for the end of the run.

        Raises
        ------
        Stopped : with the first cause.
        """
        for source in self._sources:
            cause = source()
            if cause:  # writing an empty text could erase the cause of a signal that came during the call
                self.cause = self.cause or cause
        if self.cause:
            raise Stopped(self.cause)


OperatorPrompt = Callable[[str], Callable[[], bool]]
"""Asks the operator to do something; the function that it returns tells whether they have confirmed it."""


@dataclass(frozen=True)
class RunControl:
    """What connects a run to people: requests to stop it, pauses and remarks, and prompts to the operator."""

    stop: StopRequest
    operator_input: OperatorInput
    prompt: OperatorPrompt


@contextmanager
def handled_signals() -> Iterator[StopRequest]:
    """Handle SIGINT, SIGTERM, SIGQUIT and SIGHUP until the block is left; an ignored SIGHUP (nohup) stays ignored.

    The stop request that is yielded begins with the cause of a `StopRequest` that handled these signals before. An
    ignored SIGINT is handled: a shell script starts background jobs with SIGINT ignored, but whoever sends one means to
    stop the bench.
    """
    request = StopRequest()
    previous_handlers = _handle_signals(request)
    for handler in previous_handlers.values():
        owner = getattr(handler, "__self__", None)
        if isinstance(owner, StopRequest):
            request.cause = request.cause or owner.cause
    try:
        yield request
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


@contextmanager
def between_runs() -> Iterator[Callable[[], None]]:
    """Yield a function that raises `Stopped` after a signal, for calls between the runs of a block.

    A run that is closing its file still handles signals, but no longer checks for them. Therefore each signal number is
    also read from Python's wakeup descriptor.
    """
    receiver, wakeup = socket.socketpair()
    receiver.setblocking(False)
    wakeup.setblocking(False)
    with receiver, wakeup, handled_signals() as request:
        previous_descriptor = signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)

        def check() -> None:
            request.check()
            try:
                numbers = receiver.recv(4096)
            except BlockingIOError:
                return
            raise Stopped(f"stopped by {signal.Signals(numbers[0]).name}")

        try:
            yield check
        finally:
            signal.set_wakeup_fd(previous_descriptor)


@contextmanager
def signals_kept_to_the_end() -> Iterator[None]:
    """Store signals during the block, for the next `handled_signals` in it, and ignore signals after the block.

    After the block a command only prints a line or two about its result. The system's default action, to kill the
    process, would lose these lines and the exit status; Python restores that default for each of its own handlers while
    it shuts down, but leaves ignored signals ignored.
    """
    handled = _handle_signals(StopRequest())
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_IGN)


def _handle_signals(request: StopRequest) -> dict[signal.Signals, Any]:
    """Make a stop request the handler of all signals that end a run; return the previous handler of each."""
    numbers = [signal.SIGINT, signal.SIGTERM]
    # Windows has neither SIGQUIT nor SIGHUP
    numbers += [getattr(signal, name) for name in ("SIGQUIT",) if hasattr(signal, name)]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    return {number: signal.signal(number, request.note) for number in numbers}
