"""The clock of a bench, which all its parts use; an emulated bench has its own clock with the same interface."""

import time
from typing import Protocol


class Clock(Protocol):
    """A monotonic clock in seconds."""

    def now(self) -> float:
        """Return the time since an arbitrary moment [s], which never decreases."""

    def sleep_until(self, moment: float) -> None:
        """Return at a moment [s on this clock], or at once if it has passed."""


class MonotonicClock:
    """The host's monotonic clock."""

    now = staticmethod(time.monotonic)

    def sleep_until(self, moment: float) -> None:
        """Return at a moment [s on this clock], or at once if it has passed."""
        seconds_left = moment - time.monotonic()
        if seconds_left > 0:
            time.sleep(seconds_left)
