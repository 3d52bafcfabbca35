"""What asks a run to stop: signals, which set a flag, and sources that the loop looks at; neither breaks its end."""

import signal
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
    heeded = [signal.SIGINT, signal.SIGTERM, signal.SIGQUIT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        heeded.append(signal.SIGHUP)
    before = {number: signal.signal(number, request.note) for number in heeded}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
